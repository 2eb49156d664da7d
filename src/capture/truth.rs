//! `truth/`: the ground truth of a simulated capture. No stage reads it; only the comparison does.
//!
//! # A benchmark of sub-frame synchronization
//!
//! A capture with its truth is a test case for any method that synchronizes cameras.
//! `stlfr capture RIG --scene NAME --tracks 1000 -o CAPTURE` films one. The shutters are delayed by fractions of a frame, each with its jitter, by the rig's file.
//!
//! | where | what |
//! |---|---|
//! | `capture.json` | the input of a method: frames, cameras, nominal clocks |
//! | `truth/truth.json` `offsets` | time on the reference's clock = time on the camera's + `offset_s` |
//! | `shutter` | the true middle of every exposure, hidden jitter included |
//! | `views` | images of all cameras and of views beside them at common instants, with depth (metres along +z, +inf where there is nothing) and motion (the pixels that a surface point moves within a frame, the larger of before and after) |
//! | `video` | one view, evenly over time |
//! | `tracks` | points of the surfaces in 3D, their pixels and their visibility at every frame of every camera |
//!
//! `tracks/tracks.json`:
//!
//! ```json
//! { "format": "stlfr-tracks", "version": 1, "objects": ["wall", "ball"], "object": [0, 1, 1],
//!   "cameras": [ { "id": "cam0", "times_s": [0.0103, 0.0437],
//!                  "world": "cam0.world.npy", "pixels": "cam0.pixels.npy",
//!                  "visible": "cam0.visible.npy" } ] }
//! ```
//!
//! `object` has for each point the index of its object in `objects`. A point stays at its place on
//! the surface, which may move and bend. For each camera, with F frames and P points:
//!
//! | file | type | shape | |
//! |---|---|---|---|
//! | `world` | f64 | F, P, 3 | metres |
//! | `pixels` | f64 | F, P, 2 | the point's projection, also outside of the image or hidden; NaN behind the camera |
//! | `visible` | u8 | F, P | 1 where the point is inside the image and nothing occludes it |
//!
//! `times_s` are the true middles of the exposures. Files are relative to `truth/tracks/`.
//!
//! A method under test writes `{"reference": "cam3", "cameras": [{"id": "cam0", "offset_s":
//! 0.0123, "std_err_s": 0.0001}, …]}` (`null` for a camera whose offset is unknown), and
//! `stlfr compare CAPTURE --offsets FILE` prints each camera's error in frames, its error in
//! standard errors, the median and the maximum.

use crate::camera::{Camera, CameraFormat, CameraFormatError};
use crate::json::{self, JsonError};
use crate::text::check_id;
use serde::{Deserialize, Serialize};
use std::path::{Component, Path, PathBuf};

/// The contents of `truth/truth.json`. Paths are relative to `truth/`; times are on the reference
/// camera's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Always `stlfr-truth`.
    pub format: String,
    /// Always 1.
    pub version: u32,
    /// Name of the scene.
    pub scene: String,
    /// Name of the rig.
    pub rig: String,
    /// Every camera's clock.
    pub offsets: Vec<TruthOffset>,
    /// Every camera's exposures.
    pub shutter: Vec<TruthShutter>,
    /// True images.
    pub views: Vec<TruthView>,
    /// True images of one view over time.
    #[serde(default)]
    pub video: Option<TruthVideo>,
    /// `tracks.json` of the point tracks, relative to `truth/`.
    #[serde(default)]
    pub tracks: Option<String>,
    #[serde(skip)]
    folder: PathBuf,
}

/// The truth of one camera's clock: time_ref = time_cam + (time_cam − first_cam) · `rate_ppm` · 1e-6
/// + `offset_s`, with first_cam the camera's first time.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthOffset {
    /// The camera's id.
    pub id: String,
    /// Offset at the camera's first time, seconds.
    pub offset_s: f64,
    /// Drift, millionths.
    #[serde(default)]
    pub rate_ppm: f64,
    /// The numbers of the images before which a frame is missing, once for each frame, whether the
    /// camera's times show it or not.
    #[serde(default)]
    pub lost_before: Vec<u32>,
}

/// The true middle of every exposure of one camera, seconds on the reference's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthShutter {
    /// The camera's id.
    pub id: String,
    /// One time a frame, ascending.
    pub times_s: Vec<f64>,
}

/// Largest number of true images. Larger: comparing all names pairwise takes minutes. Smaller: a hundred
/// instants of a hundred cameras are refused.
const MAX_VIEWS: usize = 10_000;

/// A true image of a view at an instant.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthView {
    /// The view's id.
    pub id: String,
    /// The instant, seconds on the reference's clock.
    pub time_s: f64,
    /// Id of the filming camera that the view is of, if it is of one.
    pub like: Option<String>,
    /// Lens and pose.
    pub camera: CameraFormat,
    /// File of the image.
    pub image: String,
    /// npy, f32, H×W: metres along the camera's +z.
    pub depth: String,
    /// npy, f32, H×W: pixels that the surface point moves within ±1 frame.
    pub motion: String,
}

/// True images of one view over time.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthVideo {
    /// The view's id.
    pub view: String,
    /// Times of the images, seconds on the reference's clock.
    pub times_s: Vec<f64>,
    /// Lens and pose.
    pub camera: CameraFormat,
    /// Pattern of the image files, such as `video/%04d.png`.
    pub images: String,
}

/// An error of `truth/`. Every message is one sentence with the file.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// A file can't be read.
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// A file is no JSON of the right shape.
    #[error("{path}: {source}")]
    Json { path: PathBuf, source: JsonError },
    /// A file's contents are refused.
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
    /// A view's calibration is refused.
    #[error("{path}: views[{index}].camera.{source}")]
    Camera { path: PathBuf, index: usize, source: CameraFormatError },
}

impl Truth {
    /// Reads `CAPTURE/truth/truth.json`; `None` if the capture has no truth.
    pub fn open(capture: &Path) -> Result<Option<Self>, TruthError> {
        let folder = capture.join("truth");
        let path = folder.join("truth.json");
        let mut truth: Self = match json::read(&path) {
            Err(JsonError::Read(e)) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(TruthError::Json { path, source }),
            Ok(truth) => truth,
        };
        if truth.format != "stlfr-truth" || truth.version != 1 {
            return Err(TruthError::Content {
                path,
                reason: "format and version must be 'stlfr-truth' and 1".into(),
            });
        }
        if truth.views.len() > MAX_VIEWS {
            let reason = format!("views: are {}, at most {MAX_VIEWS} are read", truth.views.len());
            return Err(TruthError::Content { path, reason });
        }
        truth.check_ids().map_err(|reason| TruthError::Content { path: path.clone(), reason })?;
        for (index, view) in truth.views.iter().enumerate() {
            view.camera().map_err(|source| TruthError::Camera {
                path: path.clone(),
                index,
                source,
            })?;
        }
        truth.folder = folder;
        Ok(Some(truth))
    }

    /// The ids that are printed and drawn are names, as in `capture.json`. The error is a reason.
    fn check_ids(&self) -> Result<(), String> {
        let checked = |list: &str, index: usize, field: &str, id: &str| {
            check_id(id).map_err(|reason| format!("{list}[{index}].{field}: {reason}"))
        };
        let mut offsets = self.offsets.iter().enumerate();
        offsets.try_for_each(|(n, o)| checked("offsets", n, "id", &o.id))?;
        let mut shutter = self.shutter.iter().enumerate();
        shutter.try_for_each(|(n, s)| checked("shutter", n, "id", &s.id))?;
        let mut views = self.views.iter().enumerate();
        views.try_for_each(|(n, v)| checked("views", n, "id", &v.id))?;
        let video = self.video.iter().map(|v| check_id(&v.view));
        video.collect::<Result<(), _>>().map_err(|reason| format!("video.view: {reason}"))
    }

    /// The true offset of a camera, seconds; `None` for an unknown id.
    pub fn offset_s(&self, id: &str) -> Option<f64> {
        self.clock(id).map(|o| o.offset_s)
    }

    /// The truth of a camera's clock; `None` for an unknown id.
    pub fn clock(&self, id: &str) -> Option<&TruthOffset> {
        self.offsets.iter().find(|o| o.id == id)
    }

    /// The true middle of every exposure of a camera, seconds on the reference's clock; `None` for an
    /// unknown id.
    pub fn shutter_s(&self, id: &str) -> Option<&[f64]> {
        self.shutter.iter().find(|s| s.id == id).map(|s| s.times_s.as_slice())
    }

    /// The path of a file of the truth. An error if it doesn't exist, or lies outside of `truth/`.
    pub fn file(&self, relative: &str) -> Result<PathBuf, TruthError> {
        let path = self.folder.join(relative);
        let inside = Path::new(relative).components().all(|c| matches!(c, Component::Normal(_)));
        let root = self.folder.canonicalize();
        let real = path.canonicalize();
        match (inside, root, real) {
            (true, Ok(root), Ok(real)) if real.starts_with(&root) => Ok(real),
            (true, _, Err(source)) => Err(TruthError::Read { path, source }),
            _ => Err(TruthError::Content { path, reason: "must stay inside truth/".into() }),
        }
    }
}

impl TruthView {
    /// The view's camera, which [`Truth::open`] has checked.
    pub fn camera(&self) -> Result<Camera, CameraFormatError> {
        self.camera.camera()
    }
}
