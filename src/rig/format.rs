//! The format of rig files (`rigs/*.json`).

use super::limits::*;
use crate::camera::{CameraModel, PoseFormat};
use crate::method::methods;
use crate::text::MAX_ID_LENGTH;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A simulated camera array: filming cameras with their shutters and sensors, and virtual cameras from which ground
/// truth is rendered.
///
/// The rig's frame has COLMAP's axes: x right, y down, z forward. Lengths are in metres, and times in seconds. World
/// time 0 is the scene's start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "stlfr rig")]
pub struct Rig {
    /// Name of the file format, always [`FORMAT`].
    #[schemars(extend("const" = FORMAT))]
    pub format: String,
    /// Version of the file format, always [`VERSION`].
    #[schemars(extend("const" = VERSION))]
    pub version: u32,
    /// Name of the rig. It is also written into a capture's ground truth.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub name: String,
    /// Id of the reference camera. All times are given on the clock of this camera. Its clock has no drift, and its
    /// time stamps have a gap at every lost frame.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub reference: String,
    /// Seed of the random errors in exposure times, and of the sensors' noise.
    #[schemars(range(max = MAX_SEED))]
    pub seed: u64,
    /// Cameras that film the scene, at least one.
    #[schemars(length(min = 1))]
    pub cameras: Vec<RigCamera>,
    /// Virtual cameras from which ground truth is rendered, in addition to the filming cameras.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<RigView>,
}

/// A filming camera: lens, pose, shutter and sensor.
///
/// The exposure of frame k is centred on the world time `delay_s + c_k + (c_k − c_0) · drift_ppm · 1e-6`, in seconds.
/// Here `c_k = k / rate_hz + jitter_k` is the time of the frame on the camera's own clock, and `jitter_k` is a random
/// error with the standard deviation `jitter_s`. k counts from 0, and also counts lost frames. With a rolling shutter,
/// the world time is that of the middle row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Id of the camera, and name of its folder in a capture.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub id: String,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub width: u32,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub height: u32,
    #[schemars(range(min = *LENS_MM.start(), max = *LENS_MM.end()))]
    pub lens_mm: f64,
    /// Length of the sensor along the image's longer side, millimetres.
    #[schemars(range(min = *SENSOR_MM.start(), max = *SENSOR_MM.end()))]
    pub sensor_width_mm: f64,
    /// Lens shift to the right: displacement of the image window in the image plane, as a fraction of the image's
    /// longer side.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_x: f64,
    /// Lens shift upwards: displacement of the image window in the image plane, as a fraction of the image's longer
    /// side.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_y: f64,
    /// Lens distortion, by COLMAP's OPENCV model. It must be invertible everywhere on the image's border.
    #[serde(default, skip_serializing_if = "RigDistortion::is_none")]
    pub distortion: RigDistortion,
    /// Pose of the camera: the transform from the rig's frame to the camera's frame.
    pub cam_from_rig: PoseFormat,
    #[schemars(range(min = *RATE_HZ.start(), max = *RATE_HZ.end()))]
    pub rate_hz: f64,
    /// Time from the scene's start to the camera's first frame, seconds.
    #[schemars(range(min = *TIME_S.start(), max = *TIME_S.end()))]
    pub delay_s: f64,
    /// Standard deviation of the random error in the time of every exposure, seconds. At most [`MAX_JITTER_FRAMES`] of
    /// a frame interval.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub jitter_s: f64,
    /// Whether the camera's time stamps include the jitter, the random errors in the times of exposures. Otherwise, the
    /// camera states only nominal times, which are evenly spaced.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub jitter_stamped: bool,
    /// Drift of the camera's clock, parts per million. Positive if this clock is slower than the reference clock.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *DRIFT_PPM.start(), max = *DRIFT_PPM.end()))]
    pub drift_ppm: f64,
    /// Numbers of the frames that are never recorded, ascending. Frames are numbered from 0, and frame 0 is always
    /// recorded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(inner(range(min = *LOST_FRAME.start(), max = *LOST_FRAME.end())))]
    pub lost_frames: Vec<u32>,
    /// Whether a lost frame leaves a gap in the camera's time stamps. Otherwise, the time stamps don't show the loss.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub lost_stamped: bool,
    /// Whether the camera runs on the clock that all cameras with this setting share. The shared clock shows world
    /// time. The camera's temporal offset is then known, and not estimated.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub clock_shared: bool,
    /// Time for which the shutter is open, seconds, centred on the frame's time. 0 means an instantaneous exposure. At
    /// most a frame interval.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub exposure_s: f64,
    /// Readout time of a rolling shutter, from the first row's time to the last row's, seconds. 0 for a global shutter.
    /// At most a frame interval.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub readout_s: f64,
    /// Gain: factor on the linear light, before display encoding.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schemars(range(min = *GAIN.start(), max = *GAIN.end()))]
    pub gain: f64,
    /// Rates of change of the logarithm of `gain` for red, green and blue, per second. They simulate automatic exposure
    /// or white balance. The change starts at the nominal time of the first frame. The changing gains stay within the
    /// allowed range of `gain`. The ground truth is rendered without this change.
    #[serde(default, skip_serializing_if = "are_zero")]
    #[schemars(inner(range(min = *GAIN_DRIFT_PER_S.start(), max = *GAIN_DRIFT_PER_S.end())))]
    pub gain_drift_per_s: [f64; 3],
    /// Standard deviation of the sensor's Gaussian noise, on the scale of display-encoded pixel values from 0 to 1.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *NOISE.start(), max = *NOISE.end()))]
    pub noise: f64,
    /// Whether the camera records colours or luminance alone.
    #[serde(default, skip_serializing_if = "RigColor::is_rgb")]
    pub color: RigColor,
    /// Bits per channel of the images: 8 or 16.
    #[serde(default = "eight", skip_serializing_if = "is_eight")]
    #[schemars(extend("enum" = [8, 16]))]
    pub bit_depth: u32,
}

/// A virtual pinhole camera on the rig, from which ground truth is rendered. Its fields have the same meaning as those
/// of [`RigCamera`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RigView {
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub id: String,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub width: u32,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub height: u32,
    #[schemars(range(min = *LENS_MM.start(), max = *LENS_MM.end()))]
    pub lens_mm: f64,
    #[schemars(range(min = *SENSOR_MM.start(), max = *SENSOR_MM.end()))]
    pub sensor_width_mm: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_x: f64,
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_y: f64,
    pub cam_from_rig: PoseFormat,
}

/// Distortion coefficients of COLMAP's OPENCV model, without unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RigDistortion {
    #[schemars(range(min = *DISTORTION.start(), max = *DISTORTION.end()))]
    pub k1: f64,
    #[schemars(range(min = *DISTORTION.start(), max = *DISTORTION.end()))]
    pub k2: f64,
    #[schemars(range(min = *DISTORTION.start(), max = *DISTORTION.end()))]
    pub p1: f64,
    #[schemars(range(min = *DISTORTION.start(), max = *DISTORTION.end()))]
    pub p2: f64,
}

/// Whether a camera records colours or luminance alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RigColor {
    #[default]
    Rgb,
    Gray,
}

methods!(RigColor {
    Rgb = "rgb": "Colours",
    Gray = "gray": "Luminance",
});

impl RigCamera {
    /// Returns the camera's lens model, with focal length and principal point in pixels. As with Blender's sensor fit
    /// `AUTO`, the sensor's width spans the longer side of the image.
    pub fn model(&self) -> CameraModel {
        let side = f64::from(self.width.max(self.height));
        let f = self.lens_mm / self.sensor_width_mm * side;
        let cx = 0.5 * f64::from(self.width) - self.shift_x * side;
        let cy = 0.5 * f64::from(self.height) + self.shift_y * side;
        let RigDistortion { k1, k2, p1, p2 } = self.distortion;
        if self.distortion.is_none() {
            CameraModel::Pinhole { fx: f, fy: f, cx, cy }
        } else {
            CameraModel::OpenCv { fx: f, fy: f, cx, cy, k1, k2, p1, p2 }
        }
    }
}

impl RigColor {
    fn is_rgb(&self) -> bool {
        *self == Self::Rgb
    }
}

impl RigDistortion {
    /// Returns whether all coefficients are 0, so that the lens has no distortion.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

fn yes() -> bool {
    true
}
fn is_yes(value: &bool) -> bool {
    *value
}
fn one() -> f64 {
    1.0
}
fn is_one(value: &f64) -> bool {
    *value == 1.0
}
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}
fn are_zero(values: &[f64; 3]) -> bool {
    *values == [0.0; 3]
}
fn eight() -> u32 {
    8
}
fn is_eight(value: &u32) -> bool {
    *value == 8
}
