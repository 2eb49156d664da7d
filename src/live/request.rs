//! Parses the address of a picture: `picture?method=st&t=0.1&x=0&y=0&z=0&w=640&h=400`.
//!
//! | name | value |
//! |---|---|
//! | `method` | `st`, `lfr`, `truth`, `sources`, `weights`, `depth` |
//! | `level` | `quick`; `full`: the chosen options; `saved`: the same without loss, as `stlfr render` writes it |
//! | `t` | seconds on the reference's clock, as in the capture's file |
//! | `x`, `y`, `z` | to the right, up, ahead, metres: see [`super::RigFrame`] |
//! | `at` | instead of `x`, `y` and `z`: `cN` for the place of camera N, `tN` for that of the truth's image N |
//! | `yaw`, `pitch` | rotation to the right and up, degrees |
//! | `zoom` | focal length as a multiple of the reference's |
//! | `w`, `h` | pixels |
//! | `sync`, `proxy` | methods other than the chosen options', by name, except at the level `quick`. Optional |
//! | `viewer`, `slot` | viewer, and part of the page: a request replaces the last one with the same two. Optional |
//!
//! Names and values consist of letters, digits and `.+-`, so that nothing is escaped.

use super::LiveError;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::options::ProxyMethod;

/// The source of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PictureMethod {
    /// The light field, with the chosen options.
    SpaceTime,
    /// Traditional light field rendering, from each camera's nearest frame.
    Traditional,
    /// The true image, if there is one.
    Truth,
    /// The cameras from which each pixel is blended, as stripes of their colours.
    Sources,
    /// The blending weights of the cameras as numbers, encoded by [`super::overlays::Weights::picture`].
    Weights,
    /// The depths as colours.
    Depth,
}

/// The quality of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// Fast, for a moving viewpoint: the options of `draft`, or the chosen ones if their results are cached.
    Quick,
    /// By the chosen options.
    Full,
    /// Like [`Self::Full`], encoded as `stlfr render` writes it.
    Saved,
}

/// A viewpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// A position in the rig's axes, metres.
    Free([f64; 3]),
    /// The viewpoint of a camera, by its index.
    Camera(usize),
    /// The viewpoint of a true image, by its index.
    Truth(usize),
}

/// Direction, zoom and size of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDirection {
    /// Rotation to the right and up, degrees.
    pub turn_deg: [f64; 2],
    /// Focal length as a multiple of the reference's.
    pub zoom: f64,
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
}

/// A requested picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureRequest {
    pub method: PictureMethod,
    pub level: Level,
    /// Seconds on the reference's clock, as in the capture's file.
    pub time_s: f64,
    pub place: Place,
    pub view: ViewDirection,
    /// Sync method in place of that of the chosen options; `None` leaves theirs.
    pub sync: Option<SyncMethod>,
    pub proxy: Option<ProxyMethod>,
    /// Names the viewer and the part of the page. A request replaces the earlier one with the same name,
    /// unless the name is empty.
    pub viewer: String,
}

/// Maximum length of a viewer's name with its slot, bytes.
const MAX_VIEWER_LENGTH: usize = 40;

impl PictureRequest {
    /// Whether the level is [`Level::Quick`].
    pub fn is_quick(&self) -> bool {
        self.level == Level::Quick
    }

    /// Parses the query, the part of an address after `?`. Repeated and unknown names are errors.
    pub fn parse(query: &str) -> Result<Self, LiveError> {
        let mut fields = Fields::new(query)?;
        let method = fields.choice(
            "method",
            &[
                ("st", PictureMethod::SpaceTime),
                ("lfr", PictureMethod::Traditional),
                ("truth", PictureMethod::Truth),
                ("sources", PictureMethod::Sources),
                ("weights", PictureMethod::Weights),
                ("depth", PictureMethod::Depth),
            ],
        )?;
        let levels = [("full", Level::Full), ("quick", Level::Quick), ("saved", Level::Saved)];
        let level = fields.choice("level", &levels)?;
        let place = match fields.take("at") {
            Some(at) => named_place(at)?,
            None => Place::Free([
                fields.number("x", 0.0)?,
                fields.number("y", 0.0)?,
                fields.number("z", 0.0)?,
            ]),
        };
        let view = ViewDirection {
            turn_deg: [fields.number("yaw", 0.0)?, fields.number("pitch", 0.0)?],
            zoom: fields.number("zoom", 1.0)?,
            size: [fields.size("w")?, fields.size("h")?],
        };
        let time_s = fields.number("t", 0.0)?;
        let (sync, proxy) = (fields.method("sync")?, fields.method("proxy")?);
        let slot = fields.take("slot").unwrap_or_default();
        let viewer = fields.take("viewer").map_or_else(String::new, |v| format!("{v}.{slot}"));
        if viewer.len() > MAX_VIEWER_LENGTH {
            return Err(wrong("viewer", "is too long"));
        }
        fields.finish()?;
        Ok(Self { method, level, time_s, place, view, sync, proxy, viewer })
    }
}

/// Parses a place such as `c3` or `t12`.
fn named_place(at: &str) -> Result<Place, LiveError> {
    let number = |digits: &str| digits.parse().ok();
    let place = match at.split_at_checked(1) {
        Some(("c", digits)) => number(digits).map(Place::Camera),
        Some(("t", digits)) => number(digits).map(Place::Truth),
        _ => None,
    };
    place.ok_or_else(|| wrong("at", "must be like c3 or t0"))
}

fn wrong(name: &str, reason: &str) -> LiveError {
    LiveError::Request(format!("{name}: {reason}"))
}

/// The names and values of a query that have not been read yet.
struct Fields<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Fields<'a> {
    fn new(query: &'a str) -> Result<Self, LiveError> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "=&.+-".contains(c);
        if !query.chars().all(is_plain) {
            return Err(LiveError::Request("the address holds a character that none has".into()));
        }
        let mut fields: Vec<(&str, &str)> = Vec::new();
        for part in query.split('&').filter(|p| !p.is_empty()) {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            if fields.iter().any(|(n, _)| *n == name) {
                return Err(wrong(name, "is given twice"));
            }
            fields.push((name, value));
        }
        Ok(Self(fields))
    }

    fn take(&mut self, name: &str) -> Option<&'a str> {
        let at = self.0.iter().position(|(n, _)| *n == name)?;
        Some(self.0.swap_remove(at).1)
    }

    /// Reads one of several named values; if the name is missing, the first of them.
    fn choice<T: Copy>(&mut self, name: &str, all: &[(&str, T)]) -> Result<T, LiveError> {
        let Some(value) = self.take(name) else { return Ok(all[0].1) };
        let found = all.iter().find(|(n, _)| *n == value);
        let names: Vec<&str> = all.iter().map(|(n, _)| *n).collect();
        found
            .map(|(_, v)| *v)
            .ok_or_else(|| wrong(name, &format!("must be one of {}", names.join(", "))))
    }

    fn method<M: Method>(&mut self, name: &str) -> Result<Option<M>, LiveError> {
        let Some(value) = self.take(name) else { return Ok(None) };
        let wrong = || wrong(name, &format!("must be one of {}", M::names().join(", ")));
        M::from_name(value).ok_or_else(wrong).map(Some)
    }

    fn number(&mut self, name: &str, default: f64) -> Result<f64, LiveError> {
        let Some(value) = self.take(name) else { return Ok(default) };
        let number = value.parse::<f64>().ok().filter(|v| v.is_finite());
        number.ok_or_else(|| wrong(name, "must be a number"))
    }

    fn size(&mut self, name: &str) -> Result<u32, LiveError> {
        let value = self.take(name).ok_or_else(|| wrong(name, "is missing"))?;
        value.parse().map_err(|_| wrong(name, "must be a number of pixels"))
    }

    fn finish(self) -> Result<(), LiveError> {
        match self.0.first() {
            None => Ok(()),
            Some((name, _)) => Err(wrong(name, "is unknown")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_read_whole() {
        let query = "method=lfr&level=quick&t=-1.5e-1&x=0.1&y=-.2&z=3&yaw=1&pitch=-2&zoom=2&w=64&h=48&proxy=depth&viewer=a1&slot=b";
        let wanted = PictureRequest {
            method: PictureMethod::Traditional,
            level: Level::Quick,
            time_s: -0.15,
            place: Place::Free([0.1, -0.2, 3.0]),
            view: ViewDirection { turn_deg: [1.0, -2.0], zoom: 2.0, size: [64, 48] },
            sync: None,
            proxy: Some(ProxyMethod::Depth),
            viewer: "a1.b".into(),
        };
        assert_eq!(PictureRequest::parse(query).unwrap(), wanted);
        let short = PictureRequest::parse("w=64&h=48").unwrap();
        assert_eq!((short.method, short.level), (PictureMethod::SpaceTime, Level::Full));
        let at = |at: &str| PictureRequest::parse(&format!("w=64&h=48&at={at}")).unwrap().place;
        assert_eq!((at("c3"), at("t12")), (Place::Camera(3), Place::Truth(12)));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (query, words) in [
            ("", "w: is missing"),
            ("w=64", "h: is missing"),
            ("w=-1&h=48", "w: must be"),
            ("w=99999999999&h=48", "w: must be"),
            ("w=64&h=48&t=nan", "t: must be a number"),
            ("w=64&h=48&x=inf", "x: must be a number"),
            ("w=64&h=48&x=", "x: must be a number"),
            ("w=64&h=48&w=64", "w: is given twice"),
            ("w=64&h=48&at=x1", "at: must be like"),
            ("w=64&h=48&at=c", "at: must be like"),
            ("w=64&h=48&at=c-1", "at: must be like"),
            ("w=64&h=48&at=", "at: must be like"),
            ("w=64&h=48&at=c1&x=1", "x: is unknown"),
            ("w=64&h=48&method=best", "method: must be one of st, lfr"),
            ("w=64&h=48&sync=best", "sync: must be one of nearest"),
            ("w=64&h=48&more=1", "more: is unknown"),
            ("w=64&h=48&t=%2e", "a character that none has"),
            ("w=64&h=48&t=ä", "a character that none has"),
            (&format!("w=64&h=48&viewer={}", "a".repeat(50)), "viewer: is too long"),
        ] {
            let message = PictureRequest::parse(query).unwrap_err().to_string();
            assert!(message.contains(words), "{query}: {message}");
        }
    }
}
