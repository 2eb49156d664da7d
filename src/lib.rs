//! Space-time light field rendering (Wang, Sun, Yang, IEEE TVCG 13(4), 2007): the view from
//! anywhere, at any instant, from the videos of cameras that are not synchronized.

pub mod camera;
pub mod capture;
pub mod compare;
pub mod interpolation;
pub mod lumigraph;
pub mod offset;
pub mod progress;
#[cfg(feature = "python")]
mod python;
pub mod raster;
pub mod registration;
pub mod render;
pub mod toolchain;
