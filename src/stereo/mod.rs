//! Depth per pixel by multi-view stereo at one instant (beyond the paper).
//!
//! ```text
//! images ── census ── cost volume ── semi-global ── refinement ── InverseDepths of each camera ── fuse(view)
//! ```
//!
//! Known limits: where the background has little texture, foreground depths extend one or two pixels beyond the
//! foreground's outline. Where synchronization fails, the images have no common geometry, and depths are wrong. Depths
//! are not smoothed over time.
//!
//! | file | step |
//! |---|---|
//! | `census.rs` | pixel descriptors that tolerate brightness changes, in an image pyramid |
//! | `cost_volume.rs` | matching cost of every pixel at every depth hypothesis |
//! | `semi_global.rs` | smoothing of the costs, except at image edges (Hirschmüller 2008) |
//! | `refine.rs` | refinement of inverse depths to fractions of a hypothesis step |
//! | `inverse_depths.rs` | these steps in order, for one camera |
//! | `fusion.rs` | the depths of a new view, splatted from all cameras (Merrell et al. 2007) |

mod census;
mod cost_volume;
mod fusion;
mod inverse_depths;
mod refine;
mod relative_pose;
mod semi_global;

pub use fusion::{Surface, fuse};
pub use inverse_depths::{InverseDepths, Matcher};

use crate::camera::Camera;
use crate::option::options;
use crate::raster::Image;

/// Number of additional cameras that are used only as partners: other cameras are matched with them, but their own
/// depths are not estimated. They are the cameras nearest to the view, after the [`StereoOptions::cameras`] whose
/// depths are estimated.
pub const FURTHER_CAMERAS: usize = 2;

options! {
    /// Options of multi-view stereo matching, which estimates depth per pixel.
    pub struct StereoOptions {
        /// Number of cameras nearest to the view whose depths are estimated and fused.
        cameras: usize [1..=1_000_000, "cameras"] = 6,
        /// Maximum number of neighbours that each camera is matched with.
        partners: usize [1..=1_000_000, "cameras"] = 4,
        /// Disparity between two successive depth hypotheses, in the farthest camera that is matched.
        step_px: f64 [0.25..=16.0, "px"] = 1.0,
        /// How many times images are halved before matching.
        halvings: usize [0..=8, "halvings"] = 0,
    }
}

/// One input of stereo matching: a camera, and its image at the matched instant.
#[derive(Clone, Copy, Debug)]
pub struct StereoImage<'a> {
    /// Lens and pose of the camera.
    pub camera: &'a Camera,
    /// The camera's image. Its size must be the camera's.
    pub image: &'a Image,
}

#[cfg(test)]
mod tests;
