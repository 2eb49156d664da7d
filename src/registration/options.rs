//! How registration works.

use super::lanes::LANES;
use super::{AffineOptions, CornerOptions, GainMethod};
use serde::{Deserialize, Serialize};

/// Options of §4.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationOptions {
    /// Whether cameras are made equally bright before they are compared, and blended.
    pub gains: GainMethod,
    pub corners: CornerOptions,
    pub klt: KltOptions,
    /// Largest distance between a feature and where it is tracked back to. Larger keeps
    /// mismatches, smaller drops what noise moved.
    pub max_back_error_px: f64,
    /// Correspondences of the two runs this near at both ends are one.
    pub merge_distance_px: f64,
    /// A track's motion from frame to frame may change by this much,
    pub max_motion_change_px: f64,
    /// and by this share of itself; beyond, the further frame is a mismatch.
    pub max_motion_change_share: f64,
    /// Neighbours within this radius vote on a track;
    pub support_radius_px: f64,
    /// they agree if their motion differs by no more than this,
    pub support_px: f64,
    /// plus this share of it;
    pub support_share: f64,
    /// and this many must, where there are as many. 0: no vote.
    pub min_support: usize,
    /// Whether eq. (3) is applied, where the clocks are known (Fig. 10 leaves it out).
    pub epipolar_test: bool,
    /// ε of eq. (3), pixels; the paper's is 3 to 5 at 640×480. Larger passes more wrong tracks,
    /// smaller drops right ones whose motion is curved.
    pub epsilon_px: f64,
    /// σ of eq. (4): how many times the nearest camera's distance a frame of time counts for.
    pub time_weight: f64,
    /// References a flow at most: 2 lets a grid test along its row and its column.
    pub max_references: usize,
    /// Cameras further away that are asked, one after another, for tracks that those can't tell:
    /// they don't see the feature, or it moves along its line.
    pub further_references: usize,
    /// A feature that moves more than this,
    pub min_test_motion_px: f64,
    /// and less than this share of it across its epipolar lines, can't be tested there.
    pub min_across_share: f64,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        Self {
            gains: GainMethod::default(),
            corners: CornerOptions::default(),
            klt: KltOptions::default(),
            max_back_error_px: 0.7,
            merge_distance_px: 1.0,
            max_motion_change_px: 2.0,
            max_motion_change_share: 0.5,
            support_radius_px: 20.0,
            support_px: 1.5,
            support_share: 0.2,
            min_support: 2,
            epipolar_test: true,
            epsilon_px: 3.0,
            time_weight: 1.0,
            max_references: 2,
            further_references: 1,
            min_test_motion_px: 1.0,
            min_across_share: 0.1,
        }
    }
}

/// How windows are tracked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KltOptions {
    /// Half the side of the window, pixels. Larger: steadier, but blends the motions on both
    /// sides of an edge; smaller: noisier.
    pub radius_px: usize,
    /// Pyramid levels at most. More reach larger motion, and confuse small things with their
    /// surroundings.
    pub levels: usize,
    /// Iterations a level at most.
    pub iterations: usize,
    /// A level has converged when a step is below this, pixels.
    pub epsilon_px: f64,
    /// Least eigenvalue of the window's structure tensor, per pixel, values 0..=1. Smaller: tracks
    /// that slide along edges; larger: faint texture is lost.
    pub min_eigenvalue: f64,
    /// Largest mean absolute difference of the two windows, values 0..=1.
    pub max_residual: f64,
    /// The last step, that allows the window to deform; off unless asked for (`radius_px`). Inside
    /// turning bodies it halves the error, but its larger window crosses outlines: on the magazine
    /// film at 320×240 offsets, synchronized images and views all come out slightly worse with it.
    pub affine: AffineOptions,
}

impl Default for KltOptions {
    fn default() -> Self {
        Self {
            radius_px: 5,
            levels: 4,
            iterations: 20,
            epsilon_px: 0.003,
            min_eigenvalue: 2e-6,
            max_residual: 0.06,
            affine: AffineOptions { radius_px: 0, ..AffineOptions::default() },
        }
    }
}

impl KltOptions {
    /// The border that a pyramid needs for these windows.
    pub fn pad_px(&self) -> usize {
        (self.radius_px + LANES + 3).max(self.affine.pad_px())
    }
}
