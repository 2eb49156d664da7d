//! Options of registration (§4).

use super::{AffineOptions, CornerOptions};
use crate::simd::LANES;
use serde::{Deserialize, Serialize};

/// Whether the cameras' gains (exposure and white balance) are estimated from the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GainMethod {
    /// No: all gains are taken as 1.
    Equal,
    /// Yes, and images are corrected where gains differ significantly.
    #[default]
    Estimated,
}

/// Options of registration: corners, tracking, consistency checks, and the epipolar test (§4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationOptions {
    /// Whether cameras are made equally bright before their images are compared and blended.
    pub gains: GainMethod,
    /// Options of the corner detector.
    pub corners: CornerOptions,
    /// Options of the tracker.
    pub klt: KltOptions,
    /// Maximum forward-backward error: the distance, pixels, between a feature and the point that its
    /// correspondence is tracked back to. Larger: mismatches pass; smaller: noisy tracks are lost.
    pub max_back_error_px: f64,
    /// Correspondences of the forward and the backward flow within this distance of each other, at
    /// both ends, are merged, pixels. Larger: neighbouring features become one; smaller: a feature
    /// counts twice.
    pub merge_distance_px: f64,
    /// Maximum change of a track's displacement from one frame to the next, pixels, in addition to
    /// `max_motion_change_share`, where neighbours don't change alike: with these, any change is
    /// believed. Larger: tracks are extended by mismatches; smaller: accelerating features without
    /// neighbours are not extended, and move on straight lines.
    pub max_motion_change_px: f64,
    /// The same as a fraction of the displacement: the limit is the sum of both. Larger and smaller as
    /// for `max_motion_change_px`, for fast motion.
    pub max_motion_change_share: f64,
    /// Radius within which a track's neighbours are compared with it, pixels. Larger: neighbours on
    /// other surfaces support mismatches; smaller: too few neighbours to judge by.
    pub support_radius_px: f64,
    /// A neighbour supports a track if their displacements differ by at most this, pixels, plus
    /// `support_share` of the track's. Larger: mismatches find support; smaller: rotating surfaces
    /// lose tracks.
    pub support_px: f64,
    /// The part of that limit that grows with the track's displacement, as a fraction of it. Larger
    /// and smaller as for `support_px`, for fast motion.
    pub support_share: f64,
    /// Minimum number of supporting neighbours, of tracks that have as many neighbours; 0 switches the
    /// check off. Larger: small objects lose their tracks; smaller: mismatches that resemble each
    /// other pass.
    pub min_support: usize,
    /// Whether the epipolar test of eq. (3) is applied, where the clocks are known. Fig. 10 shows
    /// interpolation without it.
    pub epipolar_test: bool,
    /// ε of eq. (3), pixels; the paper's is 3 to 5 at 640×480. Larger: more wrong tracks pass;
    /// smaller: correct tracks of curved motion are rejected.
    pub epsilon_px: f64,
    /// σ of eq. (4): the distance, in units of the nearest camera's, that a frame of time counts as.
    /// Larger: reference cameras are far away and see other surfaces; smaller: they are far in time,
    /// where eq. (2) is less accurate.
    pub time_weight: f64,
    /// Maximum number of reference cameras per direction of the flow; 2 lets a grid test along its row
    /// and its column. Larger: time, and more correct tracks rejected by a mismatch; smaller: motion
    /// along the one reference's epipolar lines is not tested.
    pub max_references: usize,
    /// Number of further cameras that test, one after another, the tracks that the references cannot:
    /// they do not see the feature, or it moves along its epipolar line. Larger: time; smaller: more
    /// tracks remain untested.
    pub further_references: usize,
    /// A feature that moves by more than this, pixels, is testable only if it moves across its epipolar
    /// lines (`min_across_share`). Larger: motion along the line passes untested; smaller: static
    /// features become untestable by noise.
    pub min_test_motion_px: f64,
    /// Minimum motion across the epipolar lines of a testable feature, as a fraction of its motion.
    /// Larger: more tracks are untestable; smaller: wrong motion along the line passes.
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

/// Options of the pyramidal KLT tracker (§4.1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KltOptions {
    /// Half the side of the window, pixels. Larger: the motions on both sides of an edge are mixed;
    /// smaller: more noise.
    pub radius_px: usize,
    /// Maximum number of pyramid levels. Larger: small objects follow their surroundings; smaller:
    /// large motion is out of reach.
    pub levels: usize,
    /// Maximum number of iterations per level. Larger: time is spent on windows that do not converge;
    /// smaller: large motion is not reached.
    pub iterations: usize,
    /// A level has converged when a step is shorter than this, pixels. Larger: the error left is of this
    /// size; smaller: more iterations.
    pub epsilon_px: f64,
    /// Minimum eigenvalue of the window's structure tensor, per pixel, values 0..=1. Larger: faint
    /// texture is lost; smaller: tracks slide along edges.
    pub min_eigenvalue: f64,
    /// Maximum mean absolute difference of the two windows, values 0..=1. Larger: mismatches pass;
    /// smaller: noise and changes of brightness lose tracks.
    pub max_residual: f64,
    /// The affine last step, which lets the window deform; off by default (`radius_px` of 0). Inside
    /// rotating surfaces it halves the error, but its larger window crosses outlines: at 320×240,
    /// offsets, synchronized images and views are slightly worse with it.
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
    /// The border that a pyramid needs for these windows, pixels.
    pub fn pad_px(&self) -> usize {
        (self.radius_px + LANES + 3).max(self.affine.pad_px())
    }
}
