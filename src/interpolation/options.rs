//! Methods and options of temporal interpolation (§5).

use crate::method::methods;
use crate::option::options;
use serde::{Deserialize, Serialize};

/// Method that synthesizes a camera's image at an instant between two of its frames. The variants are ordered by cost,
/// cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SyncMethod {
    /// The frame nearest in time, as in traditional light field rendering.
    Nearest,
    /// The two frames around the instant, cross-faded without a warp.
    Crossfade,
    /// Both frames warped by a triangulation of the tracked features, and cross-faded (Fig. 10 (b)).
    Triangulation,
    /// The morph of §5.3 with equal weights of all edges.
    Morph,
    /// The paper's method: the morph of §5.3, with real edges boosted by eq. (8).
    EdgeMorph,
    /// Beyond the paper: `triangulation`, with motion and visibility estimated per pixel at moving outlines.
    #[default]
    Refined,
    /// Beyond the paper: `refined`, blended with the images of other cameras that filmed nearer to the instant. These
    /// images are warped into the camera's view by per-pixel depth.
    AllCameras,
}

methods!(SyncMethod {
    Nearest = "nearest": "The frame nearest in time: traditional light field rendering",
    Crossfade = "crossfade": "The two frames around the instant, cross-faded",
    Triangulation = "triangulation": "Tracked features, triangulated and warped",
    Morph = "morph": "The morph along edges, all of them with equal weights",
    EdgeMorph = "edge-morph": "The paper's: the morph with real edges boosted",
    Refined = "refined": "Beyond the paper: triangulation, with motion and visibility per pixel at moving outlines",
    AllCameras = "all-cameras": "Beyond the paper: refined, with what other cameras filmed nearer to the instant",
});

impl SyncMethod {
    /// Returns the single-camera method from which this method starts: `Refined` for `AllCameras`, and the method
    /// itself for all others.
    pub fn of_one_camera(self) -> Self {
        if self == Self::AllCameras { Self::Refined } else { self }
    }

    /// Returns whether the method needs feature tracks between the two frames.
    pub fn needs_tracks(self) -> bool {
        !matches!(self, Self::Nearest | Self::Crossfade)
    }
}

options! {
    /// Options of temporal interpolation (§5).
    pub struct InterpolationOptions {
        /// Whether features move on curves through up to four frames, or on straight lines as in eq. (2).
        curved: bool = true,
        /// Maximum mean difference of any 8×8 block between two frames that count as static. A static frame pair is
        /// cross-faded without registration. With 0, only identical frames count as static.
        still_change: f32 [0.0..=1.0, "of the value range"] = 0.0,
        /// Maximum length of a real edge, L_max of §5.1. The time grows with its square.
        max_edge_length_px: f64 [0.0..=200.0, "px"] = 24.0,
        /// Distance between the grid nodes at which the morph is evaluated. With 1, it is evaluated at every pixel.
        grid_px: usize [1..=256, "px"] = 4,
        /// Half-width of the window over which refinement compares frames, for images whose longer side is 320 pixels.
        /// It is scaled up for larger images.
        window_radius_px: usize [0..=16, "px"] = 2,
        /// Maximum distance of a block from the tracks whose motions are tried in the block, for images whose longer
        /// side is 320 pixels. It is scaled up for larger images.
        search_radius_px: f64 [0.0..=200.0, "px"] = 28.0,
    }
}

/// Longer side, in pixels, of the images to which `window_radius_px` and `search_radius_px` apply unscaled. For larger
/// images, both are scaled up. (On a moving magazine at 640×480, a window radius of 2 gives 29.1 dB and a radius of 4
/// gives 30.0 dB. At 320×240, a radius of 2 is best.)
const REFERENCE_SIZE_PX: f64 = 320.0;

impl InterpolationOptions {
    /// Returns these options with `window_radius_px` and `search_radius_px` scaled up to an image of this width and
    /// height.
    pub(super) fn scaled_to(&self, [width, height]: [usize; 2]) -> Self {
        let scale = (width.max(height) as f64 / REFERENCE_SIZE_PX).max(1.0);
        Self {
            window_radius_px: (self.window_radius_px as f64 * scale).round() as usize,
            search_radius_px: self.search_radius_px * scale,
            ..self.clone()
        }
    }
}
