//! The fields of a rig file (`rigs/*.json`).

use super::limits::*;
use crate::camera::{CameraModel, PoseFormat};
use crate::method::methods;
use crate::text::MAX_ID_LENGTH;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A simulated camera array: cameras, their shutters and sensors, and virtual views that truth is
/// rendered from.
///
/// The rig's frame has COLMAP's axes (x right, y down, z forward); metres and seconds. World time 0
/// is the scene's start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "stlfr rig")]
pub struct Rig {
    /// Always [`FORMAT`].
    #[schemars(extend("const" = FORMAT))]
    pub format: String,
    /// Always [`VERSION`].
    #[schemars(extend("const" = VERSION))]
    pub version: u32,
    /// Name of the rig, also written into a capture's truth.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub name: String,
    /// Id of the camera whose clock all times refer to. That clock neither drifts nor loses frames
    /// without a trace.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub reference: String,
    /// Seed of the jitter and of the noise.
    #[schemars(range(max = MAX_SEED))]
    pub seed: u64,
    /// The filming cameras, at least one.
    #[schemars(length(min = 1))]
    pub cameras: Vec<RigCamera>,
    /// Virtual cameras that truth is rendered from besides the filming ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<RigView>,
}

/// A camera that films: lens, pose, shutter and sensor.
///
/// Frame k, its nominal number with lost frames counted, is exposed around `delay_s + c + (c − c_0) ·
/// drift_ppm · 1e-6` in world time, where `c = k / rate_hz + jitter_k` is the time on the camera's
/// own clock. With a rolling shutter, that is the time of its middle row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Names the camera's folder in a capture.
    #[schemars(regex(pattern = IDENTIFIER), length(max = MAX_ID_LENGTH))]
    pub id: String,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub width: u32,
    #[schemars(range(min = *SIZE_PX.start(), max = *SIZE_PX.end()))]
    pub height: u32,
    #[schemars(range(min = *LENS_MM.start(), max = *LENS_MM.end()))]
    pub lens_mm: f64,
    /// Size of the sensor along the image's longer side.
    #[schemars(range(min = *SENSOR_MM.start(), max = *SENSOR_MM.end()))]
    pub sensor_width_mm: f64,
    /// Shift of the image's window over the image plane, to the right, as a fraction of the image's
    /// longer side.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_x: f64,
    /// Shift of the window upwards, as a fraction of the image's longer side.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *SHIFT.start(), max = *SHIFT.end()))]
    pub shift_y: f64,
    /// Distortion of the pinhole image, by COLMAP's OPENCV model. It must be invertible all along the
    /// image's border.
    #[serde(default, skip_serializing_if = "RigDistortion::is_none")]
    pub distortion: RigDistortion,
    pub cam_from_rig: PoseFormat,
    #[schemars(range(min = *RATE_HZ.start(), max = *RATE_HZ.end()))]
    pub rate_hz: f64,
    /// Time of the first frame after the scene's start.
    #[schemars(range(min = *TIME_S.start(), max = *TIME_S.end()))]
    pub delay_s: f64,
    /// Standard deviation of every exposure's time, at most [`MAX_JITTER_FRAMES`] of a frame's
    /// duration.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub jitter_s: f64,
    /// Whether the camera stamps its frames with their jitter. Otherwise only its nominal rate is
    /// known.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub jitter_stamped: bool,
    /// Excess of the reference clock's rate over that of this camera's clock, parts per million: positive if this
    /// camera's clock is slow.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *DRIFT_PPM.start(), max = *DRIFT_PPM.end()))]
    pub drift_ppm: f64,
    /// Nominal numbers, ascending and from 1, of the frames that are never recorded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(inner(range(min = *LOST_FRAME.start(), max = *LOST_FRAME.end())))]
    pub lost_frames: Vec<u32>,
    /// Whether a lost frame leaves a gap in the camera's times. Otherwise it leaves no trace.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub lost_stamped: bool,
    /// Whether the camera is on the shared clock, which reads world time. If so, the camera's offset is known.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub clock_shared: bool,
    /// Duration for which the shutter is open, around the frame's time; 0 is an instant. At most a
    /// frame's duration.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub exposure_s: f64,
    /// Readout time of a rolling shutter: from the first row's time to the last row's; 0 for a global shutter. At
    /// most a frame's duration.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0))]
    pub readout_s: f64,
    /// Factor on the light, before display encoding.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schemars(range(min = *GAIN.start(), max = *GAIN.end()))]
    pub gain: f64,
    /// Rates of change of the logarithm of `gain` for red, green and blue, per second from the nominal time of the first
    /// frame on: an automatic exposure or white balance. The gains stay within the limits of `gain`. The truth is
    /// without this change.
    #[serde(default, skip_serializing_if = "are_zero")]
    #[schemars(inner(range(min = *GAIN_DRIFT_PER_S.start(), max = *GAIN_DRIFT_PER_S.end())))]
    pub gain_drift_per_s: [f64; 3],
    /// Standard deviation of the sensor's Gaussian noise, in display-encoded units of 0 to 1.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = *NOISE.start(), max = *NOISE.end()))]
    pub noise: f64,
    /// Whether the camera records colours.
    #[serde(default, skip_serializing_if = "RigColor::is_rgb")]
    pub color: RigColor,
    /// Bits a channel of the images: 8 or 16.
    #[serde(default = "eight", skip_serializing_if = "is_eight")]
    #[schemars(extend("enum" = [8, 16]))]
    pub bit_depth: u32,
}

/// A virtual pinhole camera on the rig. Its fields are as those of [`RigCamera`].
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

/// Coefficients of COLMAP's OPENCV model; without unit.
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

/// Whether a camera records colours, or luminance alone.
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
    /// The lens model in pixels: Blender's lens with sensor fit `AUTO`, and the distortion.
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
    /// Whether straight lines stay straight.
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
