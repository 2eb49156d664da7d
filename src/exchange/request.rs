//! Requests of an [import](super::import()): recordings, and options of the import.

use std::path::Path;

/// The clock of the imported cameras. Values that the user leaves out are read from the recordings.
#[derive(Clone, Copy, Debug)]
pub struct ImportClock {
    /// Frame rate, hertz; `None` if the frames' times come from a file or the videos.
    pub rate_hz: Option<f64>,
    /// Time of the first frame on each camera's own clock, seconds. It is also added to the times of videos.
    pub first_s: f64,
    /// Whether all cameras share one clock.
    pub shared: bool,
    /// Readout time of the cameras' rolling shutters, seconds; `None` if it is unknown or they have none.
    pub readout_s: Option<f64>,
}

/// Recordings to import, and how.
#[derive(Clone, Copy, Debug)]
pub struct ImportRequest<'a> {
    /// The folder with a sub-folder of images or a video for each camera.
    pub images: &'a Path,
    /// A CSV table of cameras and their recordings. `None` pairs them by name or number.
    pub table: Option<&'a Path>,
    /// A CSV table of all frames' times.
    pub times: Option<&'a Path>,
    pub clock: ImportClock,
    /// Whether images smaller than the calibration's are cropped from its top left corner. Otherwise images of another
    /// aspect ratio are an error; those of the same aspect ratio are the whole image at another resolution.
    pub is_cropped: bool,
    /// Whether the cameras' lenses and poses are placeholders, as of a [`Draft`](super::Draft): the lens becomes a
    /// guess at the images' size.
    pub is_uncalibrated: bool,
}
