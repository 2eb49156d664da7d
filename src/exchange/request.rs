//! The request of an [import](super::import()): the recordings, and the options of the import.

use std::path::Path;

/// The clock of the imported cameras. Values that the user leaves out are read from the recordings.
#[derive(Clone, Copy, Debug)]
pub struct ImportClock {
    /// Frame rate, in hertz; `None` if the times of the frames are read from a file or from the videos.
    pub rate_hz: Option<f64>,
    /// Time of the first frame on each camera's own clock, in seconds. If a video's own time stamps are used, this time
    /// is added to them.
    pub first_s: f64,
    /// True if all cameras share one clock.
    pub shared: bool,
    /// Readout time of the cameras' rolling shutters, in seconds; `None` if it is unknown or the shutters are global.
    pub readout_s: Option<f64>,
    /// Standard error of the readout time, in seconds; `None` if the readout time is exact.
    pub readout_std_s: Option<f64>,
}

/// The recordings to import, and the options of the import.
#[derive(Clone, Copy, Debug)]
pub struct ImportRequest<'a> {
    /// Folder that has a sub-folder of images or a video for each camera.
    pub images: &'a Path,
    /// CSV table of cameras and their recordings. If it is `None`, cameras and recordings are paired by name or number.
    pub table: Option<&'a Path>,
    /// CSV table with the times of all frames; `None` if no such table is given.
    pub times: Option<&'a Path>,
    pub clock: ImportClock,
    /// True if images that are smaller than the calibrated image, and of another aspect ratio, are the top left part of
    /// the calibrated image. If false, such images are an error. Images of the same aspect ratio are always the whole
    /// calibrated image at another resolution.
    pub is_cropped: bool,
    /// True if the lenses and poses of the cameras are placeholders, as in a [`Draft`](super::Draft). The lenses are
    /// then guessed from the size of the images.
    pub is_uncalibrated: bool,
}
