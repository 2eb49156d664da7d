//! The limits of a rig's fields, for the JSON Schema and the checks.
//!
//! They prevent divisions by 0, and the use of terabytes of memory because of a typing error. Further limits
//! are those of captures and cameras: [`MAX_DRIFT_PPM`], [`MAX_FRAMES`](crate::capture::MAX_FRAMES),
//! [`MAX_PIXELS`](crate::raster::MAX_PIXELS), [`MAX_QUATERNION_ERROR`](crate::camera::MAX_QUATERNION_ERROR).

use crate::capture::MAX_DRIFT_PPM;
use std::ops::RangeInclusive;

/// The value of a rig file's field `format`.
pub const FORMAT: &str = "stlfr-rig";
/// The value of a rig file's field `version`.
pub const VERSION: u32 = 1;
/// Regular expression of ids and names, which must be valid names of folders and files on every system.
pub const IDENTIFIER: &str = r"^[A-Za-z0-9][A-Za-z0-9_-]*$";
/// Ids that no camera can have, because captures contain folders with these names.
pub const RESERVED: [&str; 3] = ["truth", "colmap", "review"];
/// Maximum seed. JSON readers that parse numbers as doubles represent integers up to it exactly.
pub const MAX_SEED: u64 = 1 << 53;
/// Maximum number of cameras of a generated rig.
pub const MAX_CAMERAS: usize = 1000;

/// Width and height of an image, pixels; their product is limited by
/// [`MAX_PIXELS`](crate::raster::MAX_PIXELS).
pub const SIZE_PX: RangeInclusive<u32> = 8..=16_384;
/// Focal length, millimetres.
pub const LENS_MM: RangeInclusive<f64> = 1.0..=5000.0;
/// Length of the sensor's longer side, millimetres.
pub const SENSOR_MM: RangeInclusive<f64> = 1.0..=500.0;
/// Lens shift, as a fraction of the image's longer side.
pub const SHIFT: RangeInclusive<f64> = -10.0..=10.0;
/// Each coordinate of a translation, metres.
pub const LENGTH_M: RangeInclusive<f64> = -1e6..=1e6;
/// Frame rate, hertz.
pub const RATE_HZ: RangeInclusive<f64> = 1e-3..=1e5;
/// Delay of a camera's first frame, seconds after the scene's start.
pub const TIME_S: RangeInclusive<f64> = -1e6..=1e6;
/// Drift of a clock, ppm: at most the drift that can be estimated.
pub const DRIFT_PPM: RangeInclusive<f64> = -MAX_DRIFT_PPM..=MAX_DRIFT_PPM;
/// Nominal number of a lost frame.
pub const LOST_FRAME: RangeInclusive<u32> = 1..=1_000_000_000;
/// Factor on the light, applied before display encoding.
pub const GAIN: RangeInclusive<f64> = 0.01..=100.0;
/// Rate of change of the logarithm of the gain, per second.
pub const GAIN_DRIFT_PER_S: RangeInclusive<f64> = -10.0..=10.0;
/// Standard deviation of the sensor's noise in display-encoded values, as a fraction of full scale.
pub const NOISE: RangeInclusive<f64> = 0.0..=0.5;
/// Each coefficient of the distortion.
pub const DISTORTION: RangeInclusive<f64> = -10.0..=10.0;

/// Maximum standard deviation of the jitter, as a fraction of a frame interval. With more, two frames of a
/// camera could swap.
pub const MAX_JITTER_FRAMES: f64 = 0.1;
/// Maximum size of the pinhole image that covers the view of a distorted lens, relative to the size of the
/// lens's own image.
pub const MAX_SPREAD: f64 = 2.0;
/// Number of points on each side of the image's border at which a distortion is checked.
pub const BORDER_STEPS: u32 = 16;
/// Maximum number of frames of a recording whose lost frames are chosen at random.
pub const MAX_LOSS_WITHIN: usize = 100_000;
