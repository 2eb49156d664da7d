//! Offsets as a result, and what they say of the images' times.

use crate::capture::{Capture, are_frame_times};
use serde::{Deserialize, Serialize};

/// The offset of every camera of a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offsets {
    /// The reference camera's id.
    pub reference: String,
    /// By camera, in the capture's order.
    pub cameras: Vec<CameraOffset>,
}

/// One camera's clock relative to the reference's.
///
/// `time_ref = time_cam + (time_cam − first_cam)·rate_ppm·1e-6 + offset_s`, where `first_cam` is the
/// time of the camera's first frame, and the rate is 0 for clocks without drift. For a camera that lost
/// frames, `time_cam` of an image is its nominal time plus one frame period for each frame missing
/// before it. A camera that starts later than the reference, both at 0 on their own clocks, has a
/// positive offset.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraOffset {
    /// The camera's id.
    pub id: String,
    /// The offset, seconds; `None` if this capture does not determine it.
    pub offset_s: Option<f64>,
    /// The standard error of the offset, seconds; 0 where nothing is estimated.
    pub std_err_s: Option<f64>,
    /// How much faster the reference's clock runs, parts per million; only for cameras whose clock
    /// drifts by the capture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_ppm: Option<f64>,
    /// The standard error of the rate, parts per million.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_std_err_ppm: Option<f64>,
    /// The images before which a frame is missing, ascending, one entry for each frame; only for cameras
    /// that may lose frames by the capture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_before: Option<Vec<usize>>,
    /// Why the offset is unknown, as a sentence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// A camera's times, seconds, with its median frame period added for each frame missing before an
/// image; `lost_before` ascends.
pub(super) fn with_lost_frames(times_s: &[f64], lost_before: &[usize]) -> Vec<f64> {
    let mut gaps: Vec<f64> = times_s.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let frame_s = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
    let missing = |image: usize| lost_before.partition_point(|&n| n <= image) as f64;
    times_s.iter().enumerate().map(|(image, t)| t + frame_s * missing(image)).collect()
}

impl Offsets {
    /// The offsets of a capture whose clocks need no estimate: 0 for every camera, with a standard error
    /// of 0.
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

    /// By camera: the times of all its images on the reference's clock, seconds; `None` if its offset
    /// is unknown. A camera with one frame has that frame at any time, so that an unknown offset of it
    /// counts as 0.
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

    /// Unknown offsets for all cameras but the reference, with the same reason.
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

    /// Whether these can be offsets of a capture: of its cameras, and such that all their frames have
    /// times on the reference's clock.
    pub fn fits(&self, capture: &Capture) -> bool {
        self.cameras.len() == capture.cameras.len()
            && self.cameras.iter().zip(&capture.cameras).all(|(o, c)| o.id == c.id)
            && self.common_times_s(capture).iter().flatten().all(|times| are_frame_times(times))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_frames_delay_all_later_images() {
        let times = [0.0, 1.0, 2.0, 3.0];
        assert_eq!(with_lost_frames(&times, &[]), times);
        assert_eq!(with_lost_frames(&times, &[2]), [0.0, 1.0, 3.0, 4.0]);
        assert_eq!(with_lost_frames(&times, &[1, 3, 3]), [0.0, 2.0, 3.0, 6.0]);
        assert_eq!(with_lost_frames(&[5.0], &[0]), [5.0]);
    }

    #[test]
    fn fields_that_do_not_apply_are_omitted() {
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
