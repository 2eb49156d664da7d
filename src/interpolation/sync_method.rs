//! The methods of making a synchronized image.

use crate::method::methods;
use serde::{Deserialize, Serialize};

/// How a synchronized image (a camera's image between two of its frames) is made, cheapest method first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SyncMethod {
    /// The frame nearest in time, as in traditional light field rendering.
    Nearest,
    /// The two frames around the instant, cross-faded without a warp.
    Crossfade,
    /// Both frames warped by a triangulation of the tracked features, and cross-faded (Fig. 10 (b)).
    Triangulation,
    /// The morph of §5.3, with all edges of equal strength.
    Morph,
    /// The paper's method: the morph of §5.3, with real edges boosted by eq. (8).
    EdgeMorph,
    /// Beyond the paper: `triangulation`, with motion and visibility per pixel at moving outlines.
    #[default]
    Refined,
    /// Beyond the paper: `refined`, with what other cameras filmed nearer to the instant, by `depth`.
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
    /// The method of the images that this one starts from, each of one camera's frames.
    pub fn of_one_camera(self) -> Self {
        if self == Self::AllCameras { Self::Refined } else { self }
    }

    /// Whether the method needs the frames' tracks.
    pub fn needs_tracks(self) -> bool {
        !matches!(self, Self::Nearest | Self::Crossfade)
    }
}
