//! Space-time light field rendering (Wang, Sun, Yang, IEEE TVCG 13(4), 2007): the view from
//! anywhere, at any instant, from the videos of cameras that are not synchronized.
//!
//! | paper | module |
//! |---|---|
//! | the calibrated array, and all conventions | [`camera`] |
//! | its videos, and a simulator's truth | [`capture`] |
//! | §4 image registration | [`registration`] |
//! | §7 temporal offsets | [`offset`] |
//! | §5 temporal interpolation | [`interpolation`] |
//! | §6 view synthesis | [`lumigraph`] |
//! | Fig. 2, the whole pipeline | [`render`] |
//! | §8 results, beside the truth | [`compare`] |
//!
//! [`plan`] chooses the rungs that a capture requires, [`tradeoff`] measures what each costs and gives. Beside these: [`rig`] describes and generates simulated arrays, [`exchange`] reads and writes
//! other programs' calibrations, [`raster`] holds images as the stages work on them, [`progress`]
//! reports long work, [`chart`] draws charts, [`json`] reads files, [`video`] reads and writes video through an ffmpeg,
//! [`random`] makes numbers that are the same everywhere.
//!
//! # Conventions
//!
//! Metres, seconds, right-handed world; COLMAP's camera axes and models; the centre of the
//! top-left pixel is (0.5, 0.5); transforms are named `target_from_source`; units are suffixes
//! (`_px`, `_s`, `_m`, `_deg`). f64 for geometry and time, f32 for pixels. Time is seconds on the
//! reference camera's clock, inside the program from the capture's start.

pub mod camera;
pub mod capture;
pub mod chart;
pub mod compare;
pub mod exchange;
pub mod host;
pub mod interpolation;
pub mod json;
pub mod light_field;
pub mod lumigraph;
pub mod method;
pub mod metrics;
pub mod offset;
pub mod options;
pub mod pipeline;
pub mod plan;
pub mod progress;
#[cfg(feature = "python")]
mod python;
pub mod random;
pub mod raster;
pub mod registration;
pub mod rig;
pub mod toolchain;
pub mod tradeoff;
pub mod video;
