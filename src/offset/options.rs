//! Options of the offset estimation (§7).

use crate::method::methods;
use crate::option::options;
use serde::{Deserialize, Serialize};

/// The method that estimates the temporal offsets. The variants are in ascending order of computing time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OffsetMethod {
    /// The paper's method (§7): straight trajectories, each camera paired with the reference camera only, RANSAC and
    /// weighted least squares for every frame, and the mean over the frames.
    Pairwise,
    /// Straight trajectories. All pairs of cameras, weighted by their information, determine the offsets together.
    Joint,
    /// Curved trajectories through up to four frames. All pairs of cameras determine the offsets together.
    #[default]
    JointCurved,
}

methods!(OffsetMethod {
    Pairwise = "pairwise": "The paper's: straight motion, each camera against the reference, frame by frame",
    Joint = "joint": "Straight motion, all pairs together, weighted by their information",
    JointCurved = "joint-curved": "Curved motion through four frames, all pairs together",
});

options! {
    /// Options of the offset estimation (§7).
    pub struct OffsetOptions {
        /// The method that estimates the offsets.
        method: OffsetMethod = OffsetMethod::JointCurved,
        /// The number of nearest cameras that every camera is paired with.
        neighbors: usize [1..=1_000_000, "cameras"] = 2,
        /// The maximum number of frames of a camera that are used, evenly spread.
        max_frames: usize [1..=1_000_000, "frames"] = 30,
        /// The maximum number of corners tracked per frame.
        max_features: usize [1..=100_000, "corners"] = 600,
        /// The largest offset that is searched for; 0 if the nominal clocks are right to about a frame.
        search_s: f64 [0.0..=3600.0, "s"] = 5.0,
    }
}
