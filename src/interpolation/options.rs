//! How synchronized images are made.

use serde::{Deserialize, Serialize};

/// Options of §5.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InterpolationOptions {
    /// Whether features move on curves through three or four frames (method.md part 2) or, as in
    /// the paper, on straight lines between two.
    pub curved: bool,
    pub edges: EdgeOptions,
    pub morph: MorphOptions,
}

impl Default for InterpolationOptions {
    fn default() -> Self {
        Self { curved: true, edges: EdgeOptions::default(), morph: MorphOptions::default() }
    }
}

/// §5.1 and §5.2: which edges guide the morph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EdgeOptions {
    /// `L_max`, pixels: the longest real edge. Larger costs time with its square and finds little.
    pub max_length_px: f64,
    /// β of eq. (6), in the gradient's unit (values 0..=1 per pixel): what a gradient square to
    /// the edge adds. Larger trusts direction, smaller strength.
    pub beta: f64,
    /// Least fitness of a real edge, in the same unit. Larger: fewer edges, all certain.
    pub min_fitness: f64,
    /// Distance between the samples on an edge, pixels.
    pub sample_step_px: f64,
    /// A real edge's length may change by this share,
    pub max_length_change: f64,
    /// and by this much more, pixels, for the noise of its ends.
    pub max_length_change_px: f64,
    /// Real edges nearer to parallel than this, degrees,
    pub duplicate_angle_deg: f64,
    /// and nearer to each other than this, pixels, are the same edge; the longest is kept.
    pub duplicate_distance_px: f64,
    /// Whether all features are vertices of the triangulation, or (as in the paper) only the ends
    /// of real edges.
    pub all_features: bool,
}

impl Default for EdgeOptions {
    fn default() -> Self {
        Self {
            max_length_px: 24.0,
            beta: 0.05,
            min_fitness: 0.08,
            sample_step_px: 2.0,
            max_length_change: 0.05,
            max_length_change_px: 0.5,
            duplicate_angle_deg: 10.0,
            duplicate_distance_px: 2.0,
            all_features: true,
        }
    }
}

/// §5.3: the morph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MorphOptions {
    /// `a` of eq. (7), pixels: how near to an edge only that edge counts. 0: exactly on it.
    pub a: f64,
    /// `b` of eq. (7): how fast influence falls with distance. With edges all over the image it
    /// must be over 2, or the many far ones outweigh the few near.
    pub b: f64,
    /// ρ of eq. (7): how much more a long edge counts.
    pub rho: f64,
    /// τ of eq. (8): a real edge counts up to 2^τ times as much.
    pub tau: f64,
    /// Distance between the points that the warp is evaluated at, pixels; between them it is
    /// interpolated. 1: everywhere.
    pub grid_px: usize,
}

impl Default for MorphOptions {
    fn default() -> Self {
        Self { a: 0.5, b: 4.0, rho: 0.0, tau: 4.0, grid_px: 4 }
    }
}
