//! Types of values on the command line, with their parsers: methods, sizes, instants and image files.

use super::CliError;
use crate::method::Method;
use crate::path::{MAX_RATE_HZ, MIN_RATE_HZ, ReadyMadePath, is_rate_hz};
use crate::raster::StillFormat;
use crate::video::Codec;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::fmt::{self, Display, Formatter};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The value `auto` of an argument that takes the name of a method. It leaves the choice of the method to
/// [`crate::plan`].
pub const AUTO: &str = "auto";

fn possible<T: Method>() -> impl Iterator<Item = PossibleValue> {
    T::ALL.iter().map(|m| PossibleValue::new(m.name()).help(m.help()))
}

/// Returns a parser that converts the name of a stage's method to the method.
pub fn method<T: Method>() -> impl TypedValueParser<Value = T> {
    // The inner parser accepts only names of methods, so that the default is never used.
    PossibleValuesParser::new(possible::<T>()).map(|name| T::from_name(&name).unwrap_or_default())
}

/// Returns a parser that accepts the names of a stage's methods, and `auto`.
pub fn method_or_auto<T: Method>() -> PossibleValuesParser {
    let auto =
        PossibleValue::new(AUTO).help("The cheapest that this capture requires: see stlfr plan");
    PossibleValuesParser::new(std::iter::once(auto).chain(possible::<T>()))
}

/// Parses an image size such as `320x240`, which is width and height in pixels.
pub fn image_size(text: &str) -> Result<(u32, u32), String> {
    let size = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    size.filter(|(width, height)| [width, height].iter().all(|n| (8..=99_999).contains(*n)))
        .ok_or_else(|| "is no size like 320x240, at least 8x8".into())
}

/// A displacement of a view to the right, down and forward along its own axes, in metres. It is parsed from `X,Y,Z`.
#[derive(Clone, Debug, PartialEq)]
pub struct Shift(pub [f64; 3]);

/// Largest absolute coordinate of a displacement, in metres. With this limit, the displaced pose is finite.
const MAX_SHIFT_M: f64 = 1e9;

impl FromStr for Shift {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let metres: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
        let shift = metres.ok().and_then(|metres| <[f64; 3]>::try_from(metres).ok());
        shift
            .filter(|shift| shift.iter().all(|m| m.abs() <= MAX_SHIFT_M))
            .map(Self)
            .ok_or_else(|| "is no shift like 0.03,0,0: metres right, down and ahead".into())
    }
}

/// Instants in seconds. They are parsed from `START:END:N`: N evenly spaced instants from START to END, both included.
#[derive(Clone, Debug, PartialEq)]
pub struct Times(pub Vec<f64>);

/// Largest number of instants, and of parts of a sequence. With this limit, a typing error can't ask for billions of
/// images.
const MAX_TIMES: usize = 1_000_000;

impl FromStr for Times {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(':').collect();
        let wrong = || "is no span of times like 0.1:0.4:30".to_owned();
        let &[start, end, count] = parts.as_slice() else { return Err(wrong()) };
        let start_s: f64 = start.parse().map_err(|_| wrong())?;
        let end_s: f64 = end.parse().map_err(|_| wrong())?;
        let count: usize = count.parse().map_err(|_| wrong())?;
        if !start_s.is_finite() || !end_s.is_finite() {
            return Err(wrong());
        }
        if count == 0 || count > MAX_TIMES {
            return Err(format!("asks for {count} images, must be from 1 to {MAX_TIMES}"));
        }
        // The last fraction is exactly 1, so that rounding can't exceed END. END − START is not used, because it could
        // overflow.
        let fraction = |k: usize| if count == 1 { 0.0 } else { k as f64 / (count - 1) as f64 };
        let instant_s = |k: usize| start_s * (1.0 - fraction(k)) + end_s * fraction(k);
        Ok(Self((0..count).map(instant_s).collect()))
    }
}

/// A time span in seconds. It is parsed from `START:END`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeSpan(pub f64, pub f64);

impl FromStr for TimeSpan {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let ends = text.split_once(':');
        let ends = ends.and_then(|(a, b)| Some((a.parse::<f64>().ok()?, b.parse::<f64>().ok()?)));
        ends.filter(|(start, end)| start.is_finite() && end.is_finite() && start <= end)
            .map(|(start, end)| Self(start, end))
            .ok_or_else(|| "is no span of time like 0.1:0.4".into())
    }
}

/// A range of parts of a sequence of images, parsed from `K-L/N`: parts K to L of N equal parts. Parts are counted from
/// 1, and both K and L are included.
#[derive(Clone, Debug, PartialEq)]
pub struct Parts {
    first: usize,
    last: usize,
    count: usize,
}

impl FromStr for Parts {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.parse().ok().filter(|n| (1..=MAX_TIMES).contains(n));
        let parsed = text.split_once('/').and_then(|(parts, count)| {
            let (first, last) = parts.split_once('-').unwrap_or((parts, parts));
            Some(Self { first: number(first)?, last: number(last)?, count: number(count)? })
        });
        parsed
            .filter(|parts| parts.first <= parts.last && parts.last <= parts.count)
            .ok_or_else(|| "is no range of parts like 3-6/100".into())
    }
}

impl Display for Parts {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        write!(f, "{}-{}/{}", self.first, self.last, self.count)
    }
}

impl Parts {
    /// Returns the indices of the images in these parts, for a sequence of `images` images.
    pub fn range(&self, images: usize) -> Range<usize> {
        (self.first - 1) * images / self.count..self.last * images / self.count
    }
}

/// A camera path: a ready-made path such as `orbit`, or a file.
#[derive(Clone, Debug, PartialEq)]
pub enum PathSource {
    ReadyMade(ReadyMadePath),
    Json(PathBuf),
    /// The animated camera of a Blender scene.
    Blend(PathBuf),
}

impl FromStr for PathSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(kind) = ReadyMadePath::from_name(text) {
            return Ok(Self::ReadyMade(kind));
        }
        let path = PathBuf::from(text);
        match path.extension().and_then(|e| e.to_str()) {
            Some("json") => Ok(Self::Json(path)),
            Some("blend") => Ok(Self::Blend(path)),
            _ => {
                let names: Vec<_> = ReadyMadePath::ALL.iter().map(|kind| kind.name()).collect();
                Err(format!("is no .json, no .blend and none of {}", names.join(", ")))
            }
        }
    }
}

/// Parses a frame rate in hertz.
pub fn rate_hz(text: &str) -> Result<f64, String> {
    let rate_hz = text.parse().ok().filter(|rate_hz| is_rate_hz(*rate_hz));
    rate_hz.ok_or_else(|| format!("must be a number from {MIN_RATE_HZ} to {MAX_RATE_HZ}"))
}

/// Parses a positive number, which must be from 0.000001 to 1000000.
pub fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (1e-6..=1e6).contains(number));
    number.ok_or_else(|| "must be a number from 0.000001 to 1000000".into())
}

/// The format of an image file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ImageFile {
    Still(StillFormat),
    /// OpenEXR, with depth and motion.
    Exr,
}

/// The output of rendered images: one image file, a numbered sequence of image files, or a video.
#[derive(Clone, Debug, PartialEq)]
pub enum ImageOutput {
    Image(PathBuf, ImageFile),
    /// A sequence with a printf pattern such as `out/%04d.png`.
    Sequence(PathBuf, ImageFile),
    Video(PathBuf, Codec),
}

impl FromStr for ImageOutput {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let suffix = path.extension().and_then(|e| e.to_str()).map(str::to_lowercase);
        let suffix = suffix.as_deref().unwrap_or_default();
        if let Some(codec) = Codec::of_suffix(suffix) {
            return Ok(Self::Video(path, codec));
        }
        let format = match (suffix, StillFormat::of_suffix(suffix)) {
            ("exr", _) => ImageFile::Exr,
            (_, Some(format)) => ImageFile::Still(format),
            _ => {
                let reason =
                    "must end in .png, .jpg or .exr, or for a video in .mp4, .webm, .gif or .mkv";
                return Err(reason.into());
            }
        };
        if !text.contains('%') {
            return Ok(Self::Image(path, format));
        }
        let output = Self::Sequence(path, format);
        output.file(0).map(|_| output).ok_or_else(|| "has no field like %04d".into())
    }
}

impl ImageOutput {
    /// Returns the paths of the first `images` images of a sequence; the single path if the output is one image or a
    /// video.
    pub fn files(&self, images: usize) -> impl Iterator<Item = PathBuf> {
        let files = if matches!(self, Self::Sequence(..)) { images } else { 1 };
        (0..files).filter_map(|index| self.file(index))
    }

    /// Returns the path of image `index`. If the output is one image or a video, the path is the same for all indices.
    /// Returns `None` for a sequence whose pattern has no number field.
    pub fn file(&self, index: usize) -> Option<PathBuf> {
        let (Self::Image(path, _) | Self::Sequence(path, _) | Self::Video(path, _)) = self;
        if !matches!(self, Self::Sequence(..)) {
            return Some(path.clone());
        }
        let text = path.to_str()?;
        let (before, rest) = text.split_once('%')?;
        let (digits, after) = rest.split_once('d')?;
        let width: usize = match digits {
            "" => 0,
            _ => digits.strip_prefix('0')?.parse().ok().filter(|w| *w <= 18)?,
        };
        (!after.contains('%')).then(|| PathBuf::from(format!("{before}{index:0width$}{after}")))
    }

    /// Returns the format of the images; `None` for a video.
    pub fn image_file(&self) -> Option<ImageFile> {
        match self {
            Self::Image(_, file) | Self::Sequence(_, file) => Some(*file),
            Self::Video(..) => None,
        }
    }

    /// Returns a copy of the output whose file name has `end` appended before the extension. A name that already ends
    /// with `end` is unchanged.
    #[must_use]
    pub fn ending(&self, end: &str) -> Self {
        let mut output = self.clone();
        let (Self::Image(path, _) | Self::Sequence(path, _) | Self::Video(path, _)) = &mut output;
        let mut name = path.file_stem().unwrap_or_default().to_owned();
        if !name.as_encoded_bytes().ends_with(end.as_bytes()) {
            name.push(end);
            name.push(".");
            name.push(path.extension().unwrap_or_default());
            path.set_file_name(name);
        }
        output
    }
}

/// Returns a path as a word that the shells and templates of all farm engines leave unchanged. A path that contains
/// `{{` or control characters, or that is not UTF-8, is an error.
pub fn job_word(path: &Path) -> Result<String, CliError> {
    let text =
        path.to_str().filter(|text| !text.contains("{{") && !text.contains(char::is_control));
    text.map(str::to_owned).ok_or_else(|| {
        let shown = path.display();
        CliError::BadInput(format!(
            "{shown}: can't be named in a job: it must be UTF-8, without {{{{ and line breaks"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_and_auto() {
        use crate::options::ProxyMethod;
        use clap::{Arg, Command};
        let command =
            || Command::new("c").arg(Arg::new("p").value_parser(method_or_auto::<ProxyMethod>()));
        let parsed = |text: &str| {
            let found = command().try_get_matches_from(["c", text]).ok()?;
            found.get_one::<String>("p").cloned()
        };
        assert_eq!(parsed("auto"), Some("auto".into()));
        assert_eq!(parsed("plane"), Some("plane".into()));
        assert_eq!(parsed("sphere"), None);
    }

    #[test]
    fn sizes() {
        assert_eq!(image_size("320x240"), Ok((320, 240)));
        for wrong in ["320", "0x240", "320x", "320X240", "-1x5", "4x4", "320x240x3"] {
            assert!(image_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn spans_of_times() {
        let Times(instants) = "0.1:0.4:4".parse().unwrap();
        assert_eq!((instants.len(), instants[0], instants[3]), (4, 0.1, 0.4));
        assert!((instants[1] - 0.2).abs() < 1e-12);
        assert_eq!("-1:1:1".parse(), Ok(Times(vec![-1.0])));
        assert_eq!("-1e308:1e308:3".parse(), Ok(Times(vec![-1e308, 0.0, 1e308])));
        assert_eq!("1:0:2".parse(), Ok(Times(vec![1.0, 0.0])));
        for wrong in ["", "1:2", "1:2:0", "nan:1:2", "0:inf:2", "0:1:2:3", "0:1:-4", "0:1:9999999"]
        {
            assert!(wrong.parse::<Times>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn spans() {
        assert_eq!("-0.5:2".parse(), Ok(TimeSpan(-0.5, 2.0)));
        assert_eq!("1:1".parse(), Ok(TimeSpan(1.0, 1.0)));
        for wrong in ["", "1", "2:1", "nan:1", "0:inf", "0:1:2"] {
            assert!(wrong.parse::<TimeSpan>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn shifts() {
        assert_eq!("-0.03, 0,1e-3".parse(), Ok(Shift([-0.03, 0.0, 0.001])));
        for wrong in ["", "1", "1,2", "1,2,3,4", "nan,0,0", "1e10,0,0", "right,0,0"] {
            assert!(wrong.parse::<Shift>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn parts_cover_each_image_once() {
        let part = |text: &str| text.parse::<Parts>();
        assert_eq!(part("3-6/100").unwrap().range(200), 4..12);
        assert_eq!(part("2/3").unwrap().to_string(), "2-2/3");
        for images in [0, 1, 7, 100, 101] {
            let ranges = ["1-2/9", "3/9", "4-9/9"].map(|text| part(text).unwrap().range(images));
            assert_eq!(ranges.into_iter().flatten().collect::<Vec<_>>(), Vec::from_iter(0..images));
        }
        for wrong in ["", "1", "0/3", "4/3", "3-2/3", "1-2-3/4", "-1/3", "1/9999999"] {
            assert!(part(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn outputs() {
        let output = |text: &str| text.parse::<ImageOutput>();
        assert_eq!(output("out/%04d.png").unwrap().file(7), Some("out/0007.png".into()));
        assert_eq!(
            output("a.PNG"),
            Ok(ImageOutput::Image("a.PNG".into(), ImageFile::Still(StillFormat::Png)))
        );
        let jpeg = ImageFile::Still(StillFormat::Jpeg);
        assert_eq!(output("a.jpg"), Ok(ImageOutput::Image("a.jpg".into(), jpeg)));
        assert_eq!(output("a.exr"), Ok(ImageOutput::Image("a.exr".into(), ImageFile::Exr)));
        for codec in Codec::ALL {
            let path = PathBuf::from(format!("a.{}", codec.suffix()));
            assert_eq!(output(&path.display().to_string()), Ok(ImageOutput::Video(path, codec)));
        }
        for wrong in ["a", "a.bmp", "%s.png", "%4d.png", "%04d%d.png"] {
            assert!(output(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn ends_of_names_are_added_once() {
        for (given, ended) in [
            ("out/a.b.png", "out/a.b_qs8x6a0.75.png"),
            ("a_qs8x6a0.75.mp4", "a_qs8x6a0.75.mp4"),
            ("out/%04d.jpg", "out/%04d_qs8x6a0.75.jpg"),
        ] {
            let output = given.parse::<ImageOutput>().unwrap().ending("_qs8x6a0.75");
            assert_eq!(output, ended.parse().unwrap());
        }
    }

    #[test]
    fn paths_are_names_or_files() {
        assert_eq!("orbit".parse(), Ok(PathSource::ReadyMade(ReadyMadePath::Orbit)));
        assert_eq!("a/b.json".parse(), Ok(PathSource::Json("a/b.json".into())));
        assert_eq!("b.blend".parse(), Ok(PathSource::Blend("b.blend".into())));
        assert!(
            "spiral"
                .parse::<PathSource>()
                .unwrap_err()
                .contains("sweep, orbit, bullet-time, dolly")
        );
    }
}
