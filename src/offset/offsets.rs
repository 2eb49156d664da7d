//! The temporal offsets of all cameras, and the frame times that follow from them.

use super::clock::{ClockModel, NominalClock};
use crate::capture::{Capture, are_frame_times};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Temporal offsets of all cameras of a capture, relative to the reference camera's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Offsets {
    /// The id of the reference camera.
    pub reference: String,
    /// The offset of each camera, in the order of the capture's cameras.
    pub cameras: Vec<CameraOffset>,
}

/// One camera's clock relative to the reference camera's clock, as stored in `offsets.json` and returned by the Python
/// module.
///
/// `time_ref = time_cam + (time_cam − first_cam)·rate_ppm·1e-6 + offset_s`. `time_ref` is a time on the reference
/// camera's clock, `time_cam` the same time on this camera's clock, and `first_cam` the time of this camera's first
/// frame on its own clock. If the camera lost frames, `time_cam` of an image is the image's nominal time plus one
/// frame period for each frame missing before the image. If both clocks read 0 at their first frames, a camera that
/// starts after the reference camera has a positive offset.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraOffset {
    /// The camera's id.
    pub id: String,
    /// The offset, seconds: the time on the reference camera's clock minus the time on this camera's clock, at this
    /// camera's first frame. `None` if the offset can't be determined from the capture.
    pub offset_s: Option<f64>,
    /// The standard error of the offset, seconds; 0 if the offset is known exactly, `None` if it is unknown.
    pub std_err_s: Option<f64>,
    /// The rate of change of the offset, parts per million. `None` if the offset is unknown, or if the capture states
    /// that the camera's clock does not drift.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_ppm: Option<f64>,
    /// The standard error of the clock's rate, parts per million. `None` if there is no rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_std_err_ppm: Option<f64>,
    /// The readout time of the camera's rolling shutter, seconds, estimated together with the offsets. It replaces the
    /// capture's. `None` if it was not estimated, because the capture states the readout time as exact or because no
    /// offsets are estimated; the capture's readout time then holds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readout_s: Option<f64>,
    /// The standard error of `readout_s`, seconds. `None` if there is no `readout_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readout_std_err_s: Option<f64>,
    /// The indices of the images directly before which a frame is missing, ascending; an index occurs once for each
    /// missing frame. `None` if the capture states that the camera loses no frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_before: Option<Vec<usize>>,
    /// The reason why the offset is unknown, as a sentence; `None` if the offset is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl CameraOffset {
    /// Returns the clock model that converts times on the camera's clock to the reference camera's clock. `None` if
    /// the offset is unknown.
    pub fn clock(&self, nominal: &NominalClock) -> Option<ClockModel> {
        let mut clock = ClockModel {
            offset_s: self.offset_s?,
            rate: 1e-6 * self.rate_ppm.unwrap_or(0.0),
            reference_s: 0.0,
            lost_before: self.lost_before.clone().unwrap_or_default(),
        };
        clock.reference_s = clock.own_time_s(nominal, 0)?;
        Some(clock)
    }
}

impl Offsets {
    /// Returns the offsets of a capture whose cameras share one clock: 0 for every camera, with a standard error of 0.
    pub fn known(capture: &Capture) -> Self {
        let camera = |id: &String| CameraOffset {
            id: id.clone(),
            offset_s: Some(0.0),
            std_err_s: Some(0.0),
            ..CameraOffset::default()
        };
        Self {
            reference: capture.cameras[capture.reference].id.clone(),
            cameras: capture.cameras.iter().map(|c| camera(&c.id)).collect(),
        }
    }

    /// Returns offsets that are unknown for all cameras except the reference camera, with the same reason for each.
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

    /// Returns, for each camera, the clock model that converts times on the camera's clock to the reference camera's
    /// clock. `None` for a camera whose offset is unknown.
    pub fn clocks(&self, capture: &Capture) -> Vec<Option<ClockModel>> {
        let clock = |(c, camera): (usize, &CameraOffset)| {
            camera.clock(&NominalClock::of_camera(capture, c))
        };
        self.cameras.iter().take(capture.cameras.len()).enumerate().map(clock).collect()
    }

    /// Returns, for each camera, the times of all its images on the reference camera's clock, seconds. `None` for a
    /// camera whose offset is unknown. If a camera has a single frame, an unknown offset counts as 0, since the frame
    /// is valid at any time.
    pub fn common_times_s(&self, capture: &Capture) -> Vec<Option<Vec<f64>>> {
        let times_s = |(c, known): (usize, Option<ClockModel>)| {
            let nominal = NominalClock::of_camera(capture, c);
            let is_static = nominal.times_s.len() == 1;
            let clock = known.or_else(|| is_static.then(ClockModel::default))?;
            Some(clock.own_times_s(&nominal).into_iter().map(|t| clock.apply(t)).collect())
        };
        self.clocks(capture).into_iter().enumerate().map(times_s).collect()
    }

    /// Returns a capture whose cameras have the readout times that were estimated together with the offsets, in place of
    /// their own. Returns `capture` itself if no readout time was estimated.
    pub fn with_readouts(&self, capture: &Arc<Capture>) -> Arc<Capture> {
        if self.cameras.iter().all(|camera| camera.readout_s.is_none()) {
            return capture.clone();
        }
        let mut with_readouts = Capture::clone(capture);
        for (filmed, estimated) in with_readouts.cameras.iter_mut().zip(&self.cameras) {
            filmed.clock.readout_s = estimated.readout_s.unwrap_or(filmed.clock.readout_s);
        }
        Arc::new(with_readouts)
    }

    /// Returns whether these offsets belong to the capture's cameras, in the capture's order, and give every camera's
    /// frames ascending times on the reference camera's clock.
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
