//! What is imported, and how.

use std::path::Path;

/// The clock of every imported camera, as far as it is given.
#[derive(Clone, Copy, Debug)]
pub struct ImportClock {
    /// Frame rate, hertz; `None` if the frames' times come from a file or the videos.
    pub rate_hz: Option<f64>,
    /// Time of the first frame, seconds. It is added to the videos' own times, too.
    pub first_s: f64,
    /// Whether all cameras share one clock.
    pub shared: bool,
}

/// What is imported.
#[derive(Clone, Copy, Debug)]
pub struct ImportRequest<'a> {
    /// The folder with a sub-folder of images or a video for each camera.
    pub images: &'a Path,
    /// A table of cameras and their recordings; without one, they are paired by name or number.
    pub table: Option<&'a Path>,
    /// A table of all frames' times.
    pub times: Option<&'a Path>,
    pub clock: ImportClock,
    /// Whether images smaller than the calibration's are its top left part. Otherwise they are refused, unless they are
    /// the whole image at another resolution.
    pub is_cropped: bool,
    /// Whether the cameras' lenses and poses are placeholders, as of a [`Draft`](super::Draft): the lens becomes a
    /// guess at the images' size.
    pub is_uncalibrated: bool,
}
