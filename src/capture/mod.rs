//! What was filmed: a folder with `capture.json` and the cameras' frames.
//!
//! Everything that a user's file decides is checked when the folder is opened, so that the
//! stages see cameras, clocks and image sizes that hold. Pixels are decoded when they are used.
//!
//! Frames are an image sequence or a video file; a video is decoded once, into a cache.

mod clock;
mod format;
mod frames;
mod npy;
mod tracks;
mod truth;
mod video;

pub use clock::{Clock, MAX_DRIFT_PPM, bracket};
pub use format::{CaptureFormat, ClockFormat, Color, FilmedCameraFormat};
pub use npy::NpyError;
pub use tracks::{CameraTracks, TrackedPoint, Tracks};
pub use truth::{Truth, TruthError, TruthOffset, TruthVideo, TruthView, read_array};
pub use video::{MAX_FRAMES, VideoFile};

use crate::camera::{Camera, CameraFormatError};
use crate::json::{self, JsonError};
use crate::progress::Reporter;
use crate::raster::{BitDepth, Image, ImageFileError, read_image};
use crate::video::ffmpeg_on_path;
use std::path::{Path, PathBuf};

/// The file in a capture's folder that describes it.
pub const CAPTURE_FILE: &str = "capture.json";

/// A capture: its folder, and its cameras in the order of `capture.json`.
#[derive(Clone, Debug)]
pub struct Capture {
    pub name: String,
    pub folder: PathBuf,
    /// Index of the reference camera, whose clock is everybody's time.
    pub reference: usize,
    pub cameras: Vec<FilmedCamera>,
    /// The reference's first time stamp, seconds: what its file says minus what is used inside.
    pub time_origin_s: f64,
}

/// One camera of a capture, with what it filmed.
#[derive(Clone, Debug)]
pub struct FilmedCamera {
    pub id: String,
    pub camera: Camera,
    pub color: Color,
    pub clock: Clock,
    /// Frame files in order, inside the capture's folder: a video's lie in its cache.
    pub frames: Vec<PathBuf>,
    /// The video that they were decoded from.
    pub video: Option<VideoFile>,
    pub bit_depth: BitDepth,
}

/// What opening a capture needs where its cameras are videos.
#[derive(Clone, Copy)]
pub struct Opening<'a> {
    /// The ffmpeg that decodes them; without one, a video that isn't decoded yet is refused.
    pub ffmpeg: Option<&'a Path>,
    /// Where it is said that a video is being decoded.
    pub reporter: &'a Reporter,
}

/// What can be wrong with a capture's folder. Every message is one sentence with file and field.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{path}: {source}")]
    Json { path: PathBuf, source: JsonError },
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("{path}: {field}: {reason}")]
    Field { path: PathBuf, field: String, reason: String },
    #[error("{path}: {camera}.{source}")]
    Camera { path: PathBuf, camera: String, source: CameraFormatError },
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    #[error("{path}: is a video, and reading one needs ffmpeg: install it, or run stlfr setup")]
    NoFfmpeg { path: PathBuf },
}

/// The JSON Schema of `capture.json`.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(CaptureFormat).into()
}

impl Capture {
    /// Opens and checks a capture's folder; its videos are decoded by the system's ffmpeg.
    pub fn open(folder: &Path) -> Result<Self, CaptureError> {
        let (ffmpeg, reporter) = (ffmpeg_on_path(), &Reporter::silent());
        Self::open_with(folder, &Opening { ffmpeg: ffmpeg.as_deref(), reporter })
    }

    /// Opens and checks a capture's folder, whose cameras may be videos.
    pub fn open_with(folder: &Path, opening: &Opening) -> Result<Self, CaptureError> {
        let path = folder.join(CAPTURE_FILE);
        let format: CaptureFormat = json::read(&path)
            .map_err(|source| CaptureError::Json { path: path.clone(), source })?;
        format.check(&path)?;

        let root = folder
            .canonicalize()
            .map_err(|source| CaptureError::Read { path: folder.to_owned(), source })?;
        let reference = format.reference_index(&path)?;
        let mut cameras = Vec::with_capacity(format.cameras.len());
        for (index, filmed) in format.cameras.iter().enumerate() {
            cameras.push(filmed.open(&path, &root, index, opening)?);
        }
        let time_origin_s = cameras[reference].clock.times_s[0];
        for (index, camera) in cameras.iter_mut().enumerate() {
            camera.clock.rebase(time_origin_s);
            camera.clock.ascends().map_err(|reason| CaptureError::Field {
                path: path.clone(),
                field: format!("cameras[{index}] ({}).clock", camera.id),
                reason,
            })?;
        }
        Ok(Self { name: format.name, folder: folder.to_owned(), reference, cameras, time_origin_s })
    }

    /// The camera of that id.
    pub fn camera_index(&self, id: &str) -> Option<usize> {
        self.cameras.iter().position(|c| c.id == id)
    }

    /// The times of a camera's frames as its file has them (to the last digits), seconds on its own
    /// clock.
    pub fn times_in_file_s(&self, camera: usize) -> Vec<f64> {
        self.cameras[camera].clock.times_s.iter().map(|t| t + self.time_origin_s).collect()
    }

    /// Whether every camera took one frame: a static light field, which is the same at any time.
    pub fn is_static(&self) -> bool {
        self.cameras.iter().all(|c| c.frames.len() == 1)
    }

    /// Refuses a capture of one camera, which has no offsets.
    pub fn require_two_cameras(&self) -> Result<(), CaptureError> {
        if self.cameras.len() > 1 {
            return Ok(());
        }
        Err(CaptureError::Field {
            path: self.folder.join(CAPTURE_FILE),
            field: "cameras".into(),
            reason: "there is one, and an offset is between two".into(),
        })
    }

    /// Decodes one frame, as RGB or grey as the camera's `color` says.
    pub fn read_frame(&self, camera: usize, frame: usize) -> Result<Image, CaptureError> {
        let filmed = &self.cameras[camera];
        let path = &filmed.frames[frame];
        let (image, _) = read_image(path)?;
        let (w, h) = (filmed.camera.width, filmed.camera.height);
        if (image.width(), image.height()) != (w, h) {
            return Err(ImageFileError::Content {
                path: path.clone(),
                reason: format!(
                    "is {}×{} pixels, its camera {w}×{h}",
                    image.width(),
                    image.height()
                ),
            }
            .into());
        }
        Ok(match filmed.color {
            Color::Rgb => image.to_rgb(),
            Color::Gray => image.to_gray(),
        })
    }

    /// The duration between two frames of the reference camera: the unit "frame".
    pub fn frame_s(&self) -> f64 {
        self.cameras[self.reference].clock.frame_s()
    }

    /// The bit depth that results are written in: the largest of the inputs'.
    pub fn bit_depth(&self) -> BitDepth {
        self.cameras.iter().map(|c| c.bit_depth).max().unwrap_or(BitDepth::Eight)
    }

    /// A hash of everything that an estimate from this capture rests on: `capture.json` and the
    /// frames' or videos' bytes.
    pub fn content_hash(&self) -> Result<String, CaptureError> {
        let mut hasher = blake3::Hasher::new();
        let mut add = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        };
        let read = |path: &Path| {
            std::fs::read(path)
                .map_err(|source| CaptureError::Read { path: path.to_owned(), source })
        };
        add(&read(&self.folder.join(CAPTURE_FILE))?);
        for camera in &self.cameras {
            match &camera.video {
                Some(video) => add(video.hash.as_bytes()),
                None => camera.frames.iter().try_for_each(|f| read(f).map(|b| add(&b)))?,
            }
        }
        Ok(hasher.finalize().to_hex().to_string())
    }
}

#[cfg(test)]
mod tests;
