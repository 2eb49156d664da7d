//! Methods and options of temporal interpolation (§5).

use crate::method::methods;
use crate::option::options;
use serde::{Deserialize, Serialize};

/// How a camera's image between two of its frames is made, cheapest method first.
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
    /// Beyond the paper: `triangulation`, with motion and visibility per pixel at moving outlines.
    #[default]
    Refined,
    /// Beyond the paper: `refined`, blended by `depth` with images of cameras that filmed nearer to the instant.
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
    /// The single-camera method that this method starts from: `Refined` for `AllCameras`; every other method itself.
    pub fn of_one_camera(self) -> Self {
        if self == Self::AllCameras { Self::Refined } else { self }
    }

    /// Whether the method needs the frames' tracks.
    pub fn needs_tracks(self) -> bool {
        !matches!(self, Self::Nearest | Self::Crossfade)
    }
}

options! {
    /// Options of temporal interpolation (§5).
    pub struct InterpolationOptions {
        /// Whether features move on curves through up to four frames, or on straight lines as in eq. (2).
        curved: bool = true,
        /// Largest mean difference of an 8×8 block in a static frame pair, which is cross-faded without
        /// registration. 0: identical frames only.
        still_change: f32 [0.0..=1.0, "of the value range"] = 0.0,
        /// Maximum length of a real edge, L_max of §5.1. The time grows with its square.
        max_edge_length_px: f64 [0.0..=200.0, "px"] = 24.0,
        /// Distance of the grid nodes at which the morph is evaluated; 1 is exact.
        grid_px: usize [1..=256, "px"] = 4,
        /// Half-width of the window over which refinement compares frames, in images of 320 pixels; larger
        /// images scale it.
        window_radius_px: usize [0..=16, "px"] = 2,
        /// Distance up to which tracks are candidate motions of a block, in images of 320 pixels; larger
        /// images scale it.
        search_radius_px: f64 [0.0..=200.0, "px"] = 28.0,
    }
}

/// The longer side, pixels, of the images that lengths of the refinement are given for. (On a moving
/// magazine at 640×480, a window radius of 2 gives 29.1 dB and one of 4 30.0 dB; at 320×240, 2 is best.)
const REFERENCE_SIZE_PX: f64 = 320.0;

impl InterpolationOptions {
    /// These options with the refinement's lengths scaled to an image of this width and height.
    pub(super) fn scaled_to(&self, [width, height]: [usize; 2]) -> Self {
        let scale = (width.max(height) as f64 / REFERENCE_SIZE_PX).max(1.0);
        Self {
            window_radius_px: (self.window_radius_px as f64 * scale).round() as usize,
            search_radius_px: self.search_radius_px * scale,
            ..self.clone()
        }
    }
}
