//! Offsets as a result: in memory, as JSON, and kept in the capture's folder.

use crate::capture::{Capture, CaptureError, write_atomically};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The offset of every camera of a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offsets {
    /// The reference camera's id.
    pub reference: String,
    pub cameras: Vec<CameraOffset>,
}

/// time on the reference's clock = time on the camera's clock + `offset_s`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraOffset {
    pub id: String,
    /// `None`: can't be seen in this capture.
    pub offset_s: Option<f64>,
    pub std_err_s: Option<f64>,
    /// Why it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// `CAPTURE/offsets.json`: the offsets, and a hash of all that they rest on.
#[derive(Serialize, Deserialize)]
struct Kept {
    #[serde(flatten)]
    offsets: Offsets,
    options: serde_json::Value,
    hash: String,
}

impl Offsets {
    /// Nothing to estimate: every camera's clock is the reference's.
    pub fn known(capture: &Capture) -> Self {
        Self {
            reference: capture.cameras[capture.reference].id.clone(),
            cameras: capture
                .cameras
                .iter()
                .map(|c| CameraOffset {
                    id: c.id.clone(),
                    offset_s: Some(0.0),
                    std_err_s: Some(0.0),
                    reason: None,
                })
                .collect(),
        }
    }

    /// The frame times of every camera on the reference's clock; `None` for a camera whose offset
    /// is unknown. A camera of one frame has that frame at any time, so that its offset doesn't
    /// matter: an unknown one is taken for 0.
    pub fn common_times_s(&self, capture: &Capture) -> Vec<Option<Vec<f64>>> {
        capture
            .cameras
            .iter()
            .zip(&self.cameras)
            .map(|(camera, offset)| {
                let is_static = camera.clock.times_s.len() == 1;
                let offset_s = offset.offset_s.or(is_static.then_some(0.0))?;
                Some(camera.clock.times_s.iter().map(|t| t + offset_s).collect())
            })
            .collect()
    }

    fn path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.json")
    }

    /// The hash that offsets of this capture, estimated with these options, are kept under.
    pub fn hash(capture: &Capture, options: &impl Serialize) -> Result<String, CaptureError> {
        let options = serde_json::to_string(options).unwrap_or_default();
        let mut hasher = blake3::Hasher::new();
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        hasher.update(capture.content_hash()?.as_bytes());
        hasher.update(options.as_bytes());
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// What was kept under that hash; `None` if there is none, or it is of something else.
    pub fn load(capture: &Capture, hash: &str) -> Option<Self> {
        let text = std::fs::read_to_string(Self::path(capture)).ok()?;
        let kept: Kept = serde_json::from_str(&text).ok()?;
        let same = kept.hash == hash
            && kept.offsets.cameras.len() == capture.cameras.len()
            && kept.offsets.cameras.iter().zip(&capture.cameras).all(|(o, c)| o.id == c.id);
        same.then_some(kept.offsets)
    }

    /// Keeps them in the capture's folder.
    pub fn save(
        &self,
        capture: &Capture,
        options: &impl Serialize,
        hash: &str,
    ) -> Result<(), CaptureError> {
        let path = Self::path(capture);
        let kept = Kept {
            offsets: self.clone(),
            options: serde_json::to_value(options).unwrap_or_default(),
            hash: hash.to_owned(),
        };
        let text = serde_json::to_string_pretty(&kept)
            .map_err(|error| CaptureError::Write { path: path.clone(), source: error.into() })?;
        write_atomically(&path, text.as_bytes())
            .map_err(|source| CaptureError::Write { path, source })
    }
}
