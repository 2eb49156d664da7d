//! The limits of a rig's fields, in the schema and in the checks alike. They keep typing errors
//! from asking for terabytes, and divisions from 0.

/// From `min` to `max`, both allowed.
pub(super) struct Range<T> {
    pub min: T,
    pub max: T,
}

pub(super) const FORMAT: &str = "stlfr-rig";
pub(super) const VERSION: u32 = 1;
/// Names of folders and files, everywhere.
pub(super) const IDENTIFIER: &str = r"^[A-Za-z0-9][A-Za-z0-9_-]*$";
/// A camera's id names its folder in the capture, beside these.
pub(super) const RESERVED: [&str; 3] = ["truth", "colmap", "review"];
/// What every JSON reader holds exactly.
pub(super) const MAX_SEED: u64 = 1 << 53;

pub(super) const SIZE_PX: Range<u32> = Range { min: 8, max: 16_384 };
pub(super) const LENS_MM: Range<f64> = Range { min: 1.0, max: 5000.0 };
pub(super) const SENSOR_MM: Range<f64> = Range { min: 1.0, max: 500.0 };
pub(super) const SHIFT: Range<f64> = Range { min: -10.0, max: 10.0 };
pub(super) const LENGTH_M: Range<f64> = Range { min: -1e6, max: 1e6 };
pub(super) const RATE_HZ: Range<f64> = Range { min: 1e-3, max: 1e5 };
pub(super) const TIME_S: Range<f64> = Range { min: -1e6, max: 1e6 };
/// Quartz is off by 100 at most; rolling counters by more.
pub(super) const DRIFT_PPM: Range<f64> = Range { min: -1e5, max: 1e5 };
pub(super) const LOST_FRAME: Range<u32> = Range { min: 1, max: 1_000_000_000 };
pub(super) const GAIN: Range<f64> = Range { min: 0.01, max: 100.0 };
pub(super) const NOISE: Range<f64> = Range { min: 0.0, max: 0.5 };
pub(super) const DISTORTION: Range<f64> = Range { min: -10.0, max: 10.0 };

/// Largest jitter deviation, in frames: above, two frames of one camera could swap.
pub(super) const MAX_JITTER_FRAMES: f64 = 0.1;
/// Blender's quaternions are single precision; what is further off is not a rotation.
pub(super) const MAX_QUATERNION_ERROR: f64 = 1e-3;
/// How much wider than the image a pinhole's must be to hold all that the lens sees; more costs
/// more than it shows.
pub(super) const MAX_SPREAD: f64 = 2.0;
/// Points on each side of the image's border where a distortion is tried.
pub(super) const BORDER_STEPS: u32 = 16;

/// The most cameras that a rig is generated with: a grid of a thousand rows and columns. More would
/// fill the memory, which is a typing error; fewer would refuse a grid of the command line's.
pub(super) const MAX_CAMERAS: usize = 1_000_000;
/// The most frames that lost ones are drawn from. More costs memory for every camera; fewer would
/// refuse what the command line takes.
pub(super) const MAX_LOSS_WITHIN: usize = 100_000;
