//! Limits of a rig's fields, for the JSON Schema and the checks.
//!
//! The limits prevent divisions by 0. They also keep a typing error in a rig file from taking terabytes of memory.
//! Further limits are those of captures and cameras: [`MAX_DRIFT_PPM`], [`MAX_FRAMES`](crate::capture::MAX_FRAMES),
//! [`MAX_PIXELS`](crate::raster::MAX_PIXELS), [`MAX_QUATERNION_ERROR`](crate::camera::MAX_QUATERNION_ERROR).

use crate::capture::MAX_DRIFT_PPM;
use std::ops::RangeInclusive;

/// Value of the field `format` in rig files.
pub const FORMAT: &str = "stlfr-rig";
/// Value of the field `version` in rig files.
pub const VERSION: u32 = 1;
/// Regular expression that ids and names in a rig file must match. They must be valid names of folders and files on
/// every system.
pub const IDENTIFIER: &str = r"^[A-Za-z0-9][A-Za-z0-9_-]*$";
/// Ids and names that are not allowed in a rig file, because captures contain folders with these names.
pub const RESERVED: [&str; 3] = ["truth", "colmap", "review"];
/// Maximum seed: 2⁵³. Up to this number, JSON readers that parse numbers as doubles represent all integers exactly.
pub const MAX_SEED: u64 = 1 << 53;
/// Maximum number of cameras of a generated rig.
pub const MAX_CAMERAS: usize = 1000;

/// Allowed width and height of an image, pixels. Their product is limited by [`MAX_PIXELS`](crate::raster::MAX_PIXELS).
pub const SIZE_PX: RangeInclusive<u32> = 8..=16_384;
/// Allowed focal length of a lens, millimetres.
pub const LENS_MM: RangeInclusive<f64> = 1.0..=5000.0;
/// Allowed length of the sensor's longer side, millimetres.
pub const SENSOR_MM: RangeInclusive<f64> = 1.0..=500.0;
/// Allowed lens shift, as a fraction of the image's longer side.
pub const SHIFT: RangeInclusive<f64> = -10.0..=10.0;
/// Allowed value of each coordinate of a translation, metres.
pub const LENGTH_M: RangeInclusive<f64> = -1e6..=1e6;
/// Allowed frame rate of a camera, hertz.
pub const RATE_HZ: RangeInclusive<f64> = 1e-3..=1e5;
/// Allowed time from the scene's start to a camera's first frame, seconds.
pub const TIME_S: RangeInclusive<f64> = -1e6..=1e6;
/// Allowed drift of a clock, parts per million: at most the drift that can be estimated.
pub const DRIFT_PPM: RangeInclusive<f64> = -MAX_DRIFT_PPM..=MAX_DRIFT_PPM;
/// Allowed number of a lost frame. Frames are numbered from 0, and frame 0 is never lost.
pub const LOST_FRAME: RangeInclusive<u32> = 1..=1_000_000_000;
/// Allowed gain of a camera: factor on the linear light, before display encoding.
pub const GAIN: RangeInclusive<f64> = 0.01..=100.0;
/// Allowed rate of change of the logarithm of the gain, per second.
pub const GAIN_DRIFT_PER_S: RangeInclusive<f64> = -10.0..=10.0;
/// Allowed standard deviation of the sensor's noise, in display-encoded values, as a fraction of full scale.
pub const NOISE: RangeInclusive<f64> = 0.0..=0.5;
/// Allowed value of each distortion coefficient.
pub const DISTORTION: RangeInclusive<f64> = -10.0..=10.0;

/// Maximum standard deviation of the jitter (the random errors in the times of exposures), as a fraction of a frame
/// interval. With more jitter, two frames of a camera could change their order.
pub const MAX_JITTER_FRAMES: f64 = 0.1;
/// Maximum width of the undistorted image that covers the view of a distorted lens, as a multiple of the width of the
/// lens's own image. The same limit holds for the height.
pub const MAX_SPREAD: f64 = 2.0;
/// Number of intervals into which each side of the image's border is divided. At their ends, it is checked that the
/// lens distortion can be inverted.
pub const BORDER_STEPS: u32 = 16;
/// Maximum number of frames among which a generated camera's lost frames are drawn at random.
pub const MAX_LOSS_WITHIN: usize = 100_000;
