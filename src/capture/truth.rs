//! `truth/`: what only a simulator knows. The method never reads it; `compare` does.

use super::npy::{NpyError, read_npy};
use crate::camera::{Camera, CameraFormat, CameraFormatError};
use crate::json::{self, JsonError};
use serde::{Deserialize, Serialize};
use std::path::{Component, Path, PathBuf};

/// `truth/truth.json`, as it stands in the file. Paths in it are relative to `truth/`; times are
/// on the reference camera's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    pub format: String,
    pub version: u32,
    pub scene: String,
    pub rig: String,
    pub offsets: Vec<TruthOffset>,
    pub shutter: Vec<TruthShutter>,
    pub views: Vec<TruthView>,
    #[serde(default)]
    pub video: Option<TruthVideo>,
    /// `tracks.json` of the point tracks, see [`Tracks`](super::Tracks).
    #[serde(default)]
    pub tracks: Option<String>,
    #[serde(skip)]
    folder: PathBuf,
}

/// The true offset of one camera, seconds.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthOffset {
    pub id: String,
    pub offset_s: f64,
}

/// The true middle of every exposure of one camera, seconds on the reference's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthShutter {
    pub id: String,
    pub times_s: Vec<f64>,
}

/// A true image from a camera at an instant; `like` names the filming camera that stands there.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthView {
    pub id: String,
    pub time_s: f64,
    pub like: Option<String>,
    pub camera: CameraFormat,
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
    pub view: String,
    pub times_s: Vec<f64>,
    pub camera: CameraFormat,
    pub images: String,
}

/// What can be wrong with `truth/`.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{path}: {source}")]
    Json { path: PathBuf, source: JsonError },
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
    #[error("{path}: views[{index}].camera.{source}")]
    Camera { path: PathBuf, index: usize, source: CameraFormatError },
}

impl From<NpyError> for TruthError {
    fn from(error: NpyError) -> Self {
        match error {
            NpyError::Read { path, source } => Self::Read { path, source },
            NpyError::Content { path, reason } => Self::Content { path, reason },
        }
    }
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

    /// The true offset of a camera.
    pub fn offset_s(&self, id: &str) -> Option<f64> {
        self.offsets.iter().find(|o| o.id == id).map(|o| o.offset_s)
    }

    /// A file of the truth, which must lie inside `truth/`.
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
    pub fn camera(&self) -> Result<Camera, CameraFormatError> {
        self.camera.camera()
    }
}

/// Reads an H×W array of little-endian f32 in numpy's format, version 1; returns (width, height,
/// values row by row).
pub fn read_array(path: &Path) -> Result<(usize, usize, Vec<f32>), TruthError> {
    let ([height, width], values) = read_npy(path)?;
    Ok((width, height, values))
}
