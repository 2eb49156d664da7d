//! How synchronized images are made.

use serde::{Deserialize, Serialize};

/// Options of §5.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InterpolationOptions {
    /// Whether features move on curves through three or four frames (method.md part 2) or, as in
    /// the paper, on straight lines between two.
    pub curved: bool,
    /// A frame pair in which no block of pixels changes by more than this, mean of values 0..=1, is
    /// dissolved, and the points of the scene's shape stand still in it, unregistered
    /// ([`super::largest_change`]). Larger: what moves by little is blurred; 0: only frames that are
    /// the same. `auto` sets it to what still pairs of the capture change by.
    pub still_change: f32,
    pub edges: EdgeOptions,
    pub morph: MorphOptions,
    pub refine: RefineOptions,
}

impl Default for InterpolationOptions {
    fn default() -> Self {
        Self {
            curved: true,
            still_change: 0.0,
            edges: EdgeOptions::default(),
            morph: MorphOptions::default(),
            refine: RefineOptions::default(),
        }
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

/// Beyond the paper: motion and visibility where the warped frames disagree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Half the side of the window that a hypothesis is judged over, pixels of an image
    /// [`Self::SIZE_PX`] large; in larger ones in proportion, as what they show is. Larger: outlines
    /// grow by as much; smaller: noise decides.
    pub window_radius_px: usize,
    /// How far around a place tracks are looked for, pixels of such an image. Smaller: in the gap
    /// between two surfaces one of them is not tried.
    pub search_radius_px: f64,
    /// Motions within this of each other, pixels a frame, are one.
    pub same_motion_px: f64,
    /// Tracks that a motion needs. 1: mismatches are tried too.
    pub min_tracks: usize,
    /// Motions tried a place at most.
    pub max_motions: usize,
    /// The warped frames disagree where their mean difference over the window is more than this,
    /// values 0..=1. Smaller costs time, and refines noise.
    pub min_difference: f32,
    /// A difference larger by this makes a hypothesis count 1/e as much. Larger: ghosts; smaller:
    /// jagged outlines.
    pub softness: f32,
    /// What it costs a hypothesis to be seen in one frame only, halfway; towards the other frame more,
    /// by the inverse of the time from it. Smaller: outlines are eaten by what is behind them;
    /// larger: ghosts beside them.
    pub one_frame_cost: f32,
    /// How much the frames before and after are averaged in, halfway between two frames, where
    /// they agree; 0: not at all, 1: as much as the middle two. Larger: less noise; smaller: less of
    /// the blur that four tracks' errors make.
    pub outer_share: f32,
    /// The outer frames count in full up to this much more difference than the middle two have
    /// between themselves, values 0..=1. Larger: what they show otherwise leaves a trace.
    pub outer_slack: f32,
    /// A difference larger by this makes an outer frame count 1/e as much.
    pub outer_softness: f32,
}

impl RefineOptions {
    /// The longer side of the image that lengths are given for, pixels. (Magazine scene, moving
    /// part: at 640×480 a radius of 2 gives 29.1 dB, of 4 30.0; at 320×240 2 is best.)
    pub const SIZE_PX: f64 = 320.0;
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            window_radius_px: 2,
            search_radius_px: 28.0,
            same_motion_px: 1.5,
            min_tracks: 2,
            max_motions: 6,
            min_difference: 0.03,
            softness: 0.02,
            one_frame_cost: 0.1,
            outer_share: 1.0,
            outer_slack: 0.01,
            outer_softness: 0.01,
        }
    }
}
