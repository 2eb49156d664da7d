//! A capture: a folder with the file `capture.json` and the frames of all cameras.
//!
//! Opening a capture checks every field of `capture.json`, every frame's header and every clock. Pixels are decoded
//! when they are used.
//!
//! The frames of a camera are an image sequence or a video file. A video is decoded once, into the capture's cache on
//! disk.

mod calibration;
mod clock;
mod content;
mod format;
mod frames;
mod named_view;
mod output_guard;
mod truth;
mod video;

pub use calibration::{
    CalibrationCovarianceFormat, CalibrationErrors, CalibrationStdFormat, LensGroup,
};
pub use clock::{Clock, FrameTimes, MAX_DRIFT_PPM, RowTimes, are_frame_times, bracket};
pub(crate) use content::Stored;
pub use format::{CaptureFormat, ClockFormat, Color, FilmedCameraFormat};
pub use named_view::NamedView;
pub use output_guard::OutputGuard;
pub use truth::{Truth, TruthOffset, TruthVideo, TruthView, read_array};
pub use video::{MAX_FRAMES, VideoFile};

use crate::camera::Camera;
use crate::host::{DiskCache, read_text};
use crate::json::{self, JsonError};
use crate::progress::Reporter;
use crate::raster::{BitDepth, Image, ImageFileError, read_hashed_image};
use crate::video::ffmpeg_on_path;
use content::{ContentHash, ContentHashes};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Name of the file that describes a capture, in the capture's folder.
pub const CAPTURE_FILE: &str = "capture.json";

/// An opened capture, which is the recording of a calibrated camera array: its folder, its cameras with their frames,
/// and the covariance of its calibration errors.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The capture's name in `capture.json`.
    pub name: String,
    /// The folder, as it was passed to [`Capture::open`].
    pub folder: PathBuf,
    /// Index of the reference camera. All times refer to the clock of this camera.
    pub reference: usize,
    /// All cameras, in the order of `capture.json`.
    pub cameras: Vec<FilmedCamera>,
    /// Time of the reference camera's first frame in `capture.json`, seconds. It is subtracted from all times in
    /// memory, so that the reference's first frame is at 0.
    pub time_origin_s: f64,
    /// Covariance of the calibration's errors. `None` if `capture.json` states no such errors.
    pub calibration_errors: Option<Arc<CalibrationErrors>>,
    /// The capture's cache on disk. Its keys lack the hash of the capture's content, which [`Capture::cache`] adds.
    cache: DiskCache,
    hashes: Arc<ContentHashes>,
    content: ContentHash,
}

/// A camera of a capture, with its frames.
#[derive(Clone, Debug)]
pub struct FilmedCamera {
    /// The camera's id, unique in the capture.
    pub id: String,
    /// Camera model and pose.
    pub camera: Camera,
    /// Whether frames are converted to RGB or to grey.
    pub color: Color,
    /// Times of the frames on the camera's own clock, and how this clock may differ from the reference's clock.
    pub clock: Clock,
    /// Frame files in the order of recording, inside the capture's folder. The decoded frames of a video lie in the
    /// capture's cache.
    pub frames: Vec<PathBuf>,
    /// The video file that the frames were decoded from. `None` for an image sequence.
    pub video: Option<VideoFile>,
    /// The largest bit depth among the camera's frames.
    pub bit_depth: BitDepth,
}

/// How videos are decoded while a capture is opened.
#[derive(Clone, Copy)]
pub struct Opening<'a> {
    /// Path of the ffmpeg program that decodes videos. If it is `None`, opening a video that isn't decoded yet is an
    /// error.
    pub ffmpeg: Option<&'a Path>,
    /// Receives the progress of decoding, and notes about damaged cache entries.
    pub reporter: &'a Reporter,
}

/// The folder of a capture that is being opened, with the means to decode its videos.
struct CaptureSource<'a> {
    /// Path of `capture.json`.
    description: &'a Path,
    /// Canonical path of the capture's folder.
    root: &'a Path,
    cache: &'a DiskCache,
    opening: &'a Opening<'a>,
}

/// Error of reading a capture's folder, including its ground truth in `truth/`. Every message is one sentence that
/// starts with the path of the file.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A file or folder can't be read.
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// A file is not JSON, or has missing or wrong fields.
    #[error("{path}: {source}")]
    Json { path: PathBuf, source: JsonError },
    /// A file in the capture's folder can't be written: a cached result or a decoded video.
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    /// The contents of a file are refused. The reason starts with the name of the wrong field, if it is known.
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
    /// A frame can't be read, or its size in pixels differs from its camera's size.
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    /// A frame has changed since the capture was opened, or a video has changed while it was decoded.
    #[error("{path}: changed while it was being used")]
    Changed { path: PathBuf },
    /// A video isn't decoded yet, and no ffmpeg is available.
    #[error("{path}: is a video, and reading one needs ffmpeg: install it, or run stlfr setup")]
    NoFfmpeg { path: PathBuf },
}

impl CaptureError {
    pub(crate) fn content(path: &Path, reason: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), reason: reason.into() }
    }
}

/// Returns the JSON Schema of `capture.json`.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(CaptureFormat).into()
}

impl Capture {
    /// Opens a capture's folder and checks its contents. Videos that aren't decoded yet are decoded by the first ffmpeg
    /// on `PATH`.
    pub fn open(folder: &Path) -> Result<Self, CaptureError> {
        let (ffmpeg, reporter) = (ffmpeg_on_path(), &Reporter::silent());
        Self::open_with(folder, &Opening { ffmpeg: ffmpeg.as_deref(), reporter })
    }

    /// Opens a capture's folder and checks its contents. Videos that aren't decoded yet are decoded by the ffmpeg in
    /// `opening`.
    pub fn open_with(folder: &Path, opening: &Opening) -> Result<Self, CaptureError> {
        let path = folder.join(CAPTURE_FILE);
        let failed = |source| CaptureError::Json { path: path.clone(), source };
        let text = read_text(&path, json::MAX_BYTES).map_err(|error| match error.kind() {
            ErrorKind::NotFound if folder.join(output_guard::FILM).is_dir() => {
                let reason = "is not filmed to its end: the same stlfr capture continues it";
                CaptureError::content(folder, reason)
            }
            ErrorKind::NotADirectory => {
                CaptureError::content(folder, "is a file, and a capture is a folder")
            }
            _ => failed(JsonError::Read(error)),
        })?;
        let format: CaptureFormat =
            json::parse(&text).map_err(JsonError::Content).map_err(failed)?;
        let refused = |reason: String| CaptureError::content(&path, reason);
        let reference = format.check().map_err(refused)?;
        let root = folder
            .canonicalize()
            .map_err(|source| CaptureError::Read { path: folder.to_owned(), source })?;
        let reporter = *opening.reporter;
        let cache = DiskCache::new(&root, move |sentence| reporter.note(sentence));
        let source = CaptureSource { description: &path, root: &root, cache: &cache, opening };
        let filmed = format.cameras.iter().enumerate();
        let mut cameras =
            filmed.map(|(k, camera)| camera.open(k, &source)).collect::<Result<Vec<_>, _>>()?;
        let time_origin_s = cameras[reference].clock.times_s[0];
        for (index, camera) in cameras.iter_mut().enumerate() {
            // The subtraction keeps the precision: an f64 resolves 1e-16 s near 0, but only 2.4e-7 s at Unix times.
            camera.clock.times_s.iter_mut().for_each(|t| *t -= time_origin_s);
            let ascends = camera.clock.ascends();
            ascends.map_err(|e| refused(format!("cameras[{index}] ({}).clock: {e}", camera.id)))?;
        }
        let stated: Vec<_> = format.cameras.iter().map(|c| c.calibration_std).collect();
        let calibrated: Vec<&Camera> = cameras.iter().map(|c| &c.camera).collect();
        let covariance = format.calibration_covariance.as_ref();
        let calibration_errors = CalibrationErrors::open(covariance, &stated, &calibrated, &path)?;
        let hashes = Arc::new(ContentHashes::new(&text, &cameras));
        Ok(Self {
            name: format.name,
            folder: folder.to_owned(),
            reference,
            cameras,
            time_origin_s,
            calibration_errors: calibration_errors.map(Arc::new),
            cache,
            hashes,
            content: ContentHash::default(),
        })
    }

    /// Makes a capture of cameras without frame files. The first camera is the reference.
    #[cfg(test)]
    pub(crate) fn without_files(cameras: Vec<FilmedCamera>) -> Self {
        Self {
            name: String::new(),
            folder: PathBuf::new(),
            reference: 0,
            time_origin_s: 0.0,
            calibration_errors: None,
            cache: DiskCache::new(Path::new(""), |_| ()),
            hashes: Arc::new(ContentHashes::new("", &cameras)),
            content: ContentHash::default(),
            cameras,
        }
    }

    /// Returns the index of the camera with this id. `None` if no camera has the id.
    pub fn camera_index(&self, id: &str) -> Option<usize> {
        self.cameras.iter().position(|c| c.id == id)
    }

    /// Returns the times of a camera's frames as they are in `capture.json`, up to rounding: seconds on the camera's
    /// own clock.
    pub fn times_in_file_s(&self, camera: usize) -> Vec<f64> {
        self.cameras[camera].clock.times_s.iter().map(|t| t + self.time_origin_s).collect()
    }

    /// Returns whether every camera has exactly one frame. The light field is then constant in time.
    pub fn is_static(&self) -> bool {
        self.cameras.iter().all(|c| c.frames.len() == 1)
    }

    /// Returns an error if the capture has only one camera: a temporal offset needs two cameras.
    pub fn require_two_cameras(&self) -> Result<(), CaptureError> {
        if self.cameras.len() > 1 {
            return Ok(());
        }
        let reason = "cameras: there is one, and an offset is between two";
        Err(CaptureError::content(&self.folder.join(CAPTURE_FILE), reason))
    }

    /// Decodes one frame and converts it to RGB or grey, according to [`FilmedCamera::color`].
    ///
    /// # Errors
    /// If the file can't be read, if its size in pixels differs from the camera's size, or if the file has changed
    /// since the capture was opened.
    pub fn read_frame(&self, camera: usize, frame: usize) -> Result<Image, CaptureError> {
        let filmed = &self.cameras[camera];
        let path = &filmed.frames[frame];
        let (image, read) = read_hashed_image(path)?;
        self.hashes.require_unchanged(path, &read)?;
        require_size(path, [image.width(), image.height()], &filmed.camera)?;
        Ok(match (filmed.color, image.channels()) {
            (Color::Rgb, 1) => image.to_rgb(),
            (Color::Gray, 3) => image.to_gray(),
            _ => image,
        })
    }

    /// Returns the reference camera's frame interval: the median time between its frames, seconds. Offsets that are
    /// stated in frames are in units of this interval. 0 if the reference has one frame.
    pub fn frame_s(&self) -> f64 {
        self.cameras[self.reference].clock.frame_s()
    }

    /// Returns the bit depth of rendered images: the largest bit depth of all cameras' frames.
    pub fn bit_depth(&self) -> BitDepth {
        self.cameras.iter().map(|c| c.bit_depth).max().unwrap_or(BitDepth::Eight)
    }
}

/// Returns an error if an image's size, `[width, height]` in pixels, differs from the size of its camera.
pub(crate) fn require_size(
    path: &Path,
    [width, height]: [usize; 2],
    camera: &Camera,
) -> Result<(), ImageFileError> {
    if [width, height] == [camera.width, camera.height] {
        return Ok(());
    }
    let reason =
        format!("is {width}×{height} pixels, its camera {}×{}", camera.width, camera.height);
    Err(ImageFileError::Content { path: path.to_owned(), reason })
}

#[cfg(test)]
mod tests;
