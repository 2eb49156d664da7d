//! Depth per pixel by multi-view stereo, with its uncertainty, at one instant (beyond the paper).
//!
//! ```text
//! images ── census ── cost volume ── semi-global ── refinement ── InverseDepths of each camera ── fuse(view)
//! ```
//!
//! Known limits: foreground swells over its outline by one or two pixels where the background has little
//! texture. Where synchronization failed, the images have no common geometry, and depths are wrong. Depths
//! are not smoothed over time.
//!
//! | file | step |
//! |---|---|
//! | `census.rs` | descriptors of pixels that tolerate brightness changes, over an image pyramid |
//! | `cost_volume.rs` | matching cost of every pixel at every inverse depth |
//! | `semi_global.rs` | smoothness except at image edges (Hirschmüller 2008) |
//! | `refine.rs` | sub-level inverse depths and their standard errors |
//! | `inverse_depths.rs` | these steps in order, for one camera |
//! | `fusion.rs` | the depths of a new view, splatted from all cameras (Merrell et al. 2007) |

mod census;
mod cost_volume;
mod fusion;
mod inverse_depths;
mod refine;
mod relative_pose;
mod semi_global;

pub use census::CensusPyramid;
pub use fusion::{Surface, fuse};
pub use inverse_depths::{InverseDepths, Matcher, halvings, inverse_depths, partners};

use crate::camera::Camera;
use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// Number of cameras beyond [`StereoOptions::cameras`] that only serve as partners.
pub const FURTHER_CAMERAS: usize = 2;

/// Options of depth per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StereoOptions {
    /// Number of cameras whose depths are estimated and fused: those nearest to the view.
    pub cameras: usize,
    /// Largest number of neighbours that each camera is matched with.
    pub partners: usize,
    /// Distance between two depth hypotheses, pixels of disparity to the farthest partner.
    pub step_px: f64,
    /// How many times images are halved before matching.
    pub halvings: usize,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self { cameras: 6, partners: 4, step_px: 1.0, halvings: 0 }
    }
}

/// A camera and its image at the instant.
#[derive(Clone, Copy, Debug)]
pub struct CameraImage<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// Image of the camera's size.
    pub image: &'a Image,
}

#[cfg(test)]
mod tests;
