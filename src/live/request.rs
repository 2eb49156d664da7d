//! Parses the address of a requested picture: `picture?method=st&t=0.1&x=0&y=0&z=0&w=640&h=400`.
//!
//! | name | value |
//! |---|---|
//! | `method` | content of the picture: `st`, `lfr`, `truth`, `sources`, `weights`, `depth` ([`PictureMethod`]) |
//! | `level` | quality of the picture: `quick`, `full`, `saved` ([`Level`]) |
//! | `t` | seconds on the reference camera's clock, as in the capture's file |
//! | `x`, `y`, `z` | position in the rig's axes: right, up, ahead, metres ([`super::RigFrame`]) |
//! | `at` | instead of `x`, `y` and `z`: `cN` for the viewpoint of camera N, `tN` for the viewpoint of ground-truth image N |
//! | `yaw`, `pitch` | rotation to the right and up, degrees |
//! | `zoom` | focal length as a multiple of the reference camera's |
//! | `w`, `h` | width and height of the picture, pixels |
//! | `sync`, `proxy` | names of methods that replace the methods with which the server was started. Optional |
//! | `viewer`, `slot` | names of the viewer and of the part of the page: a request replaces the earlier request with the same two names. Optional |
//!
//! Names and values consist of letters, digits and `.+-`, so that no character needs escaping.

use super::LiveError;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::options::{ProxyMethod, RenderOptions};

/// Content of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PictureMethod {
    /// Space-time light field rendering with the options with which the server was started.
    SpaceTime,
    /// Traditional light field rendering: each camera's frame nearest in time is blended without synchronization.
    Traditional,
    /// The ground-truth image of a simulated scene. The request is an error if there is no ground-truth image with this
    /// viewpoint and time.
    Truth,
    /// The cameras from which each pixel is blended, as stripes in the cameras' colours.
    Sources,
    /// The blending weights of the cameras as numbers, encoded by [`super::overlays::Weights::picture`].
    Weights,
    /// The depth of each pixel, as a colour.
    Depth,
}

impl PictureMethod {
    /// Returns whether a picture is rendered by scene flow with these options.
    pub(super) fn is_by_flow(self, options: &RenderOptions) -> bool {
        options.proxy.method == ProxyMethod::SceneFlow
            && matches!(self, Self::SpaceTime | Self::Depth)
    }
}

/// Quality of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// Fast, for a moving viewpoint: rendered with the options for full quality if all intermediate results are cached,
    /// and otherwise with the preset `draft`.
    Quick,
    /// Full quality: rendered with the options with which the server was started.
    Full,
    /// Rendered like [`Self::Full`], and encoded as `stlfr render` writes it.
    Saved,
}

/// Viewpoint of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Position in the rig's axes: right, up, ahead, metres.
    Free([f64; 3]),
    /// Viewpoint of the camera with this index.
    Camera(usize),
    /// Viewpoint of the ground-truth image with this index.
    Truth(usize),
}

/// Direction, zoom and size of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewDirection {
    /// Rotation away from the viewpoint's direction, to the right and up, degrees.
    pub turn_deg: [f64; 2],
    /// Focal length as a multiple of the reference camera's focal length.
    pub zoom: f64,
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
}

/// A request for a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureRequest {
    pub method: PictureMethod,
    pub level: Level,
    /// Time that the picture shows: seconds on the reference camera's clock, as in the capture's file.
    pub time_s: f64,
    pub place: Place,
    pub view: ViewDirection,
    /// Synchronization method with which the picture is rendered. `None`: the method of the options with which the
    /// server was started.
    pub sync: Option<SyncMethod>,
    /// Proxy method with which the picture is rendered. `None`: the method of the options with which the server was
    /// started.
    pub proxy: Option<ProxyMethod>,
    /// Name of the viewer and of the part of its page that shows the picture, such as `a1.b`. A request replaces the
    /// earlier request with the same name, unless the name is empty.
    pub viewer: String,
}

/// Maximum length of [`PictureRequest::viewer`], bytes.
const MAX_VIEWER_LENGTH: usize = 40;

impl PictureRequest {
    /// Returns whether the quality is [`Level::Quick`].
    pub fn is_quick(&self) -> bool {
        self.level == Level::Quick
    }

    /// Parses a request from its query, which is the part of the address after `?`. Repeated and unknown names are
    /// errors.
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

/// Parses a viewpoint: `c3` is the viewpoint of camera 3, `t12` is the viewpoint of ground-truth image 12.
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

/// The fields of a query that have not been read yet, as pairs of name and value.
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

    /// Reads the field `name`, whose value must be one of the words in `all`, and returns the value that is paired with
    /// this word. If the query lacks the field, the first entry of `all` is chosen.
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
