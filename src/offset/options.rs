//! Options of the offset estimation (§7).

use crate::method::methods;
use serde::{Deserialize, Serialize};

/// Options of the offset estimation (§7). The field names are those of the options file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffsetOptions {
    /// The estimator that combines the features' candidates. Files of earlier versions call it `rung`.
    #[serde(alias = "rung")]
    pub method: OffsetMethod,
    /// The number of nearest cameras that every camera is paired with. Larger adds redundancy, and pairs
    /// that are harder to match; smaller leaves wrong pairs undetected.
    pub neighbors: usize,
    /// The maximum number of frames of a camera that are used, evenly spread. Larger costs time;
    /// smaller gives larger standard errors.
    pub max_frames: usize,
    /// The maximum number of corners tracked per frame: the strongest of those around which the image
    /// changes. Larger costs time; smaller gives larger standard errors.
    pub max_features: usize,
    /// The RANSAC tolerance d of §7, as a fraction of Δt. Larger includes outliers; smaller excludes
    /// inliers of slow features.
    pub tolerance_share: f64,
    /// γ of eq. (12), times Δt. Larger weights the nearest candidates alone; smaller approaches the mean
    /// of RANSAC's inliers.
    pub gamma: f64,
    /// The smallest motion across the epipolar line from frame to frame that a candidate requires,
    /// pixels. Larger discards slow features; smaller admits candidates that are mostly noise.
    pub min_across_px: f64,
    /// The expected standard deviation of features' distances from their epipolar lines, pixels, at which
    /// the mixture of the joint methods starts. Larger lets outliers determine the start; smaller
    /// excludes inliers from it.
    pub residual_px: f64,
    /// The largest offset that is searched for, seconds, where recordings are long enough; 0: the nominal
    /// clocks are right to about a frame. Larger costs time and meets more motion that looks alike;
    /// smaller misses offsets beyond it.
    pub search_s: f64,
    /// The minimum overlap of two recordings in that search, seconds; shorter recordings are taken to be
    /// aligned to about a frame. Larger misses short overlaps; smaller correlates by chance.
    pub min_overlap_s: f64,
    /// The minimum number of inliers of a pair. Larger discards pairs with few features; smaller accepts
    /// agreement by chance.
    pub min_inliers: usize,
    /// The minimum fraction of inliers among a pair's candidates. Larger discards pairs with many
    /// mismatches; smaller accepts agreement by chance: of candidates spread over a few frames, any window
    /// of 2 × tolerance contains a fraction.
    pub min_inlier_share: f64,
    /// The largest standard error, frames: a pair beyond it is not used, and a camera beyond it has no
    /// offset. Larger reports uncertain offsets; smaller withholds usable ones.
    pub max_std_err_frames: f64,
}

/// The estimators of the temporal offsets, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OffsetMethod {
    /// The paper's (§7): straight trajectories, each camera against the reference camera, RANSAC and WLS
    /// for every frame, and the mean over the frames.
    Pairwise,
    /// Straight trajectories, and all pairs together, weighted by their information.
    Joint,
    /// Curved trajectories through up to four frames, and all pairs together.
    #[default]
    JointCurved,
}

methods!(OffsetMethod {
    Pairwise = "pairwise": "The paper's: straight motion, each camera against the reference, frame by frame",
    Joint = "joint": "Straight motion, all pairs together, weighted by their information",
    JointCurved = "joint-curved": "Curved motion through four frames, all pairs together",
});

impl Default for OffsetOptions {
    fn default() -> Self {
        Self {
            method: OffsetMethod::default(),
            neighbors: 2,
            max_frames: 30,
            max_features: 600,
            tolerance_share: 0.05,
            gamma: 70.0,
            min_across_px: 1.0,
            residual_px: 0.5,
            search_s: 5.0,
            min_overlap_s: 2.0,
            min_inliers: 12,
            min_inlier_share: 0.15,
            max_std_err_frames: 0.1,
        }
    }
}
