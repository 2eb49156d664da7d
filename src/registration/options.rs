//! Options of registration (§4).

use crate::method::methods;
use crate::option::options;
use crate::simd::LANES;
use serde::{Deserialize, Serialize};

/// Whether the cameras' gains (exposure and white balance) are estimated from the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GainMethod {
    /// All gains are assumed to be 1.
    Equal,
    /// Gains are estimated, and images are corrected where gains differ significantly.
    #[default]
    Estimated,
}

methods!(GainMethod {
    Equal = "equal": "All cameras are taken as equally bright",
    Estimated = "estimated": "Estimated from the images, and corrected where they differ",
});

options! {
    /// Options of registration (§4).
    pub struct RegistrationOptions {
        /// Whether cameras are made equally bright before their images are compared and blended.
        gains: GainMethod = GainMethod::Estimated,
        /// Maximum number of corners per image, the strongest first.
        max_corners: usize [1..=100_000, "corners"] = 4000,
        /// Half-width of the tracker's window.
        window_radius_px: usize [1..=32, "px"] = 5,
        /// Maximum number of pyramid levels.
        levels: usize [1..=16, "levels"] = 4,
        /// Whether tracks unlike their neighbours, or with a large residual or forward–backward error, are
        /// removed. The paper relies on the epipolar test alone.
        consistency_checks: bool = true,
        /// Whether the epipolar test of eq. (3) is applied, where the clocks are known.
        epipolar_test: bool = true,
        /// ε of eq. (3): maximum distance of a correspondence from its epipolar line. The paper uses 3 to 5 at
        /// 640×480.
        epipolar_tolerance_px: f64 [0.0..=1000.0, "px"] = 3.0,
    }
}

/// Thresholds of the consistency checks, which a match must meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyThresholds {
    /// Maximum residual: the mean absolute difference between the grey values (0 to 1) of the windows in the source and
    /// the target frame.
    pub residual: f64,
    /// Maximum forward–backward error, pixels.
    pub forward_backward_error_px: f64,
    /// Minimum number of neighbours that must move like a point; otherwise, the point is an outlier. A point that has
    /// fewer neighbours is not checked. With 0, no point is checked.
    pub support: usize,
}

impl RegistrationOptions {
    /// Returns the width of the padding around each pyramid level that the tracker's windows need, in pixels.
    pub fn pad_px(&self) -> usize {
        self.window_radius_px + LANES + 3
    }

    /// Returns strict thresholds if [`Self::consistency_checks`] is true. Otherwise, returns thresholds that only a
    /// large residual fails.
    pub fn consistency(&self) -> ConsistencyThresholds {
        let [checked, unchecked] = [(0.06, 0.7, 2), (0.2, f64::INFINITY, 0)];
        let (residual, forward_backward_error_px, support) =
            if self.consistency_checks { checked } else { unchecked };
        ConsistencyThresholds { residual, forward_backward_error_px, support }
    }
}
