//! How offsets are estimated.

use crate::method::methods;
use serde::{Deserialize, Serialize};

/// Options of §7.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffsetOptions {
    /// Which estimator combines the features' candidates. Files of earlier versions call it `rung`.
    #[serde(alias = "rung")]
    pub method: OffsetMethod,
    /// Every camera is paired with this many nearest ones. More pairs are more redundant, and the
    /// far ones harder to match.
    pub neighbors: usize,
    /// Frames of a camera used at most, evenly spread.
    pub max_frames: usize,
    /// Corners a frame followed at most, the strongest first of those around which the image
    /// changes: an interpolation needs many more.
    pub max_features: usize,
    /// RANSAC's tolerance d, as a share of Δt.
    pub tolerance_share: f64,
    /// γ of eq. (12), times Δt.
    pub gamma: f64,
    /// A feature has a candidate only if it moves at least this much across the epipolar line
    /// from frame to frame, pixels. Smaller: noise over almost nothing is any time at all.
    pub min_across_px: f64,
    /// How far from its epipolar line a feature is expected, pixels: where the best rung's estimate
    /// starts from. Larger lets outliers choose the start, smaller leaves inliers out of it.
    pub residual_px: f64,
    /// How far apart clocks may be, seconds, where films are long enough to find it. 0: they are
    /// right to about a frame. Further takes longer, and meets more motion that looks alike.
    pub search_s: f64,
    /// The least overlap of two films that is searched for, seconds; shorter ones are not searched.
    /// Less finds chance likeness.
    pub min_overlap_s: f64,
    /// A pair with fewer inliers than this is not used.
    pub min_inliers: usize,
    /// Nor one with a smaller share of inliers: by chance alone, candidates spread over a few
    /// frames put 2 × tolerance into any window.
    pub min_inlier_share: f64,
    /// A pair, or a camera, less certain than this share of a frame is not used, or unknown.
    pub max_std_err_frames: f64,
}

/// The estimators, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OffsetMethod {
    /// The paper's: straight motion, each camera against the reference camera, RANSAC and WLS per
    /// frame, the mean over the frames
    Pairwise,
    /// Straight motion, all pairs together, weighted by their information
    Joint,
    /// Motion on curves through four frames, all pairs together
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
