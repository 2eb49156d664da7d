//! Offsets as a result: in memory, as JSON, and kept in the capture's folder.

use crate::capture::{Capture, CaptureError};
use crate::host::write_atomically;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The offset of every camera of a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offsets {
    /// The reference camera's id.
    pub reference: String,
    pub cameras: Vec<CameraOffset>,
}

/// time on the reference's clock = time on the camera's clock + `offset_s`; with a drift,
/// `time_ref = time_cam + (time_cam − first_cam)·rate_ppm·1e-6 + offset_s`, `first_cam` the time of
/// the camera's first frame; with lost frames, `time_cam` of an image is its nominal time plus a
/// frame for each one missing before it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraOffset {
    pub id: String,
    /// `None`: can't be seen in this capture.
    pub offset_s: Option<f64>,
    pub std_err_s: Option<f64>,
    /// How much faster the reference's clock runs, in millionths, where the capture says that the
    /// camera's drifts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_ppm: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_std_err_ppm: Option<f64>,
    /// The images before which a frame is missing, ascending, one that follows two missing frames
    /// twice; where the capture says that frames may be lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_before: Option<Vec<usize>>,
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

/// A camera's times with a median frame added for each one missing before an image.
pub(super) fn with_lost_frames(times_s: &[f64], lost_before: &[usize]) -> Vec<f64> {
    let mut gaps: Vec<f64> = times_s.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let frame_s = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
    let missing = |image: usize| lost_before.iter().filter(|&&n| n <= image).count() as f64;
    times_s.iter().enumerate().map(|(image, t)| t + frame_s * missing(image)).collect()
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
                    ..CameraOffset::default()
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
                let rate = 1e-6 * offset.rate_ppm.unwrap_or(0.0);
                let own = with_lost_frames(
                    &camera.clock.times_s,
                    offset.lost_before.as_deref().unwrap_or_default(),
                );
                let first_s = own[0];
                let common: Vec<f64> =
                    own.iter().map(|t| t + (t - first_s) * rate + offset_s).collect();
                Some(common)
            })
            .collect()
    }

    /// Every camera unknown, for the same reason, but the reference.
    pub(super) fn unknown(capture: &Capture, reason: &str) -> Self {
        let mut offsets = Self::known(capture);
        for (c, camera) in offsets.cameras.iter_mut().enumerate() {
            if c != capture.reference {
                (camera.offset_s, camera.std_err_s) = (None, None);
                camera.reason = Some(reason.to_owned());
            }
        }
        offsets
    }

    fn path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.json")
    }

    /// Where their plot is kept.
    pub fn plot_path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.svg")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_frames_move_what_follows_them() {
        let times = [0.0, 1.0, 2.0, 3.0];
        assert_eq!(with_lost_frames(&times, &[]), times);
        assert_eq!(with_lost_frames(&times, &[2]), [0.0, 1.0, 3.0, 4.0]);
        assert_eq!(with_lost_frames(&times, &[1, 3, 3]), [0.0, 2.0, 3.0, 6.0]);
        assert_eq!(with_lost_frames(&[5.0], &[0]), [5.0]);
    }

    #[test]
    fn fields_that_do_not_apply_are_left_out() {
        let plain = CameraOffset { id: "a".into(), ..CameraOffset::default() };
        assert_eq!(
            serde_json::to_string(&plain).unwrap(),
            r#"{"id":"a","offset_s":null,"std_err_s":null}"#
        );
        let text = r#"{"id":"a","offset_s":0.5,"std_err_s":0.1,"rate_ppm":30.0,
            "rate_std_err_ppm":2.0,"lost_before":[6]}"#;
        let drifting: CameraOffset = serde_json::from_str(text).unwrap();
        assert_eq!((drifting.rate_ppm, drifting.lost_before), (Some(30.0), Some(vec![6])));
    }
}
