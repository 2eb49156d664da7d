//! Options of temporal interpolation (§5).

use serde::{Deserialize, Serialize};

/// Options of temporal interpolation (§5).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InterpolationOptions {
    /// Whether features move on curves through three or four frames or, as in eq. (2) of the paper, on
    /// straight lines between two.
    pub curved: bool,
    /// Maximum change of a static frame pair: the mean absolute difference of a block of pixels, values
    /// 0..=1 ([`super::largest_change`]). A static pair is cross-faded without registration, and the
    /// points of the proxy do not move in it. Larger: slow motion is blurred; smaller: noise counts as
    /// motion, which costs time. 0: identical frames only. `auto` sets it to the change of the
    /// capture's static pairs.
    pub still_change: f32,
    /// Options of the edge set (§5.1, §5.2).
    pub edges: EdgeOptions,
    /// Options of the morph (§5.3).
    pub morph: MorphOptions,
    /// Options of the refinement (beyond the paper).
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

/// Options of the edge set that guides the morph (§5.1, §5.2).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EdgeOptions {
    /// `L_max`: maximum length of a real edge, pixels. Larger: time grows with its square, for few more
    /// edges; smaller: long image edges are not covered.
    pub max_length_px: f64,
    /// β of eq. (6), in the gradient's unit (values 0..=1 per pixel): the fitness that a gradient
    /// perpendicular to the edge adds. Larger: faint edges of the right direction pass; smaller:
    /// strong texture across the edge passes.
    pub beta: f64,
    /// Minimum fitness of a real edge, in the same unit. Larger: fewer edges; smaller: segments that
    /// follow no image edge.
    pub min_fitness: f64,
    /// Distance between the samples s_k of eq. (6) on an edge, pixels; at least 0.25. Larger: gaps in an
    /// edge are missed; smaller: time.
    pub sample_step_px: f64,
    /// Maximum change of a real edge's length between the two frames, as a fraction of it; the limit is
    /// the sum with `max_length_change_px`. Larger: edges of T-junctions, and between a static and a
    /// moving point, pass; smaller: edges that rotate in depth are lost.
    pub max_length_change: f64,
    /// The constant part of that limit, pixels, for the noise of the ends. Larger: short edges of wrong
    /// tracks pass; smaller: short edges are lost to noise.
    pub max_length_change_px: f64,
    /// Maximum angle between two real edges that are duplicates of each other, degrees. Larger: edges
    /// that meet at a sharp corner are removed; smaller: noisy duplicates remain, and count twice.
    pub duplicate_angle_deg: f64,
    /// Maximum distance of a duplicate's ends from the longer edge, pixels. Larger: parallel edges are
    /// removed; smaller: duplicates remain, and count twice.
    pub duplicate_distance_px: f64,
    /// Whether all features are vertices of the triangulation or, as in the paper, only the ends of real
    /// edges.
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

/// Options of the morph (§5.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MorphOptions {
    /// `a` of eq. (7), pixels: the distance below which an edge's weight is nearly constant. Larger: edges
    /// do not pass exactly, and the warp is smoother; smaller: the warp is rough where edges disagree.
    pub a: f64,
    /// `b` of eq. (7): the exponent by which influence falls with distance. Larger: the nearest edge alone
    /// counts, with its error; smaller: with edges all over the image, 2 and less lets the many far
    /// ones outweigh the few near.
    pub b: f64,
    /// ρ of eq. (7): the exponent of an edge's length. Larger: long edges outweigh the near ones; smaller:
    /// short edges, whose direction is noisier, count as much as long ones.
    pub rho: f64,
    /// τ of eq. (8): a real edge's weight is up to 2^τ times a virtual edge's. Larger: surfaces without
    /// real edges follow those of others; smaller: outlines are less straight.
    pub tau: f64,
    /// Distance between the nodes that the warp is evaluated at, pixels; 1 is exact. Larger: outlines are
    /// less sharp; smaller: time grows with its inverse square.
    pub grid_px: usize,
    /// How far a node's displacement may be from eq. (7) because far edges count in clusters, pixels; 0 is
    /// exact. Larger: displacements jump at the sides of tiles of 8×8 nodes; smaller: time, which for 0 grows
    /// with the number of edges.
    pub tolerance_px: f64,
}

impl Default for MorphOptions {
    fn default() -> Self {
        Self { a: 0.5, b: 4.0, rho: 0.0, tau: 4.0, grid_px: 4, tolerance_px: 0.02 }
    }
}

/// Options of the refinement (beyond the paper): motion and visibility where the warped frames disagree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Half the side of the window that a hypothesis is evaluated over, pixels of an image of
    /// [`Self::SIZE_PX`]; it grows in proportion with larger images. Larger: outlines are displaced by
    /// as much; smaller: noise decides.
    pub window_radius_px: usize,
    /// Radius around a block in which tracks are candidates for its motion, pixels of such an image.
    /// Larger: time, and motions of other objects; smaller: in the gap between two surfaces one of
    /// them is not tried.
    pub search_radius_px: f64,
    /// Maximum difference of two tracks' motions that are one candidate, pixels per frame. Larger: the
    /// motions of two surfaces are averaged; smaller: one surface has several candidates, which costs
    /// time.
    pub same_motion_px: f64,
    /// Minimum number of tracks of a candidate motion. Larger: small objects are not tried; smaller: at 1,
    /// mismatches are tried too.
    pub min_tracks: usize,
    /// Maximum number of candidate motions per block, nearest first. Larger: time; smaller: some surfaces
    /// are not tried.
    pub max_motions: usize,
    /// The warped frames disagree where their mean absolute difference over the window exceeds this,
    /// values 0..=1. Larger: faint outlines are not refined; smaller: noise is, which costs time.
    pub min_difference: f32,
    /// The difference, values 0..=1, by which a hypothesis's weight falls to 1/e. Larger: ghosts; smaller:
    /// jagged outlines.
    pub softness: f32,
    /// The cost, in the same unit, of the hypothesis that only one frame sees the point, halfway between
    /// the frames; near the other frame it grows with the inverse of the time to it. Larger: ghosts
    /// beside outlines; smaller: outlines are eroded by their background.
    pub one_frame_cost: f32,
    /// Weight of the frames before and after relative to the middle two, halfway between these, where all
    /// agree; 0 to 1. Larger: the errors of four tracks blur the image; smaller: more noise.
    pub outer_share: f32,
    /// The difference, values 0..=1, that an outer frame may have in excess of the middle two frames'
    /// without losing weight. Larger: what only the outer frames show leaves a trace; smaller: noise
    /// keeps them from being averaged.
    pub outer_slack: f32,
    /// The further difference by which an outer frame's weight falls to 1/e. Larger: what only the outer
    /// frames show leaves a trace; smaller: noise keeps them from being averaged.
    pub outer_softness: f32,
}

impl RefineOptions {
    /// The longer side, pixels, of the images that the lengths in these options are for. (On a moving
    /// magazine at 640×480, a radius of 2 gives 29.1 dB and one of 4 30.0 dB; at 320×240, 2 is best.)
    /// Larger: windows are too small in large images; smaller: too large.
    pub const SIZE_PX: f64 = 320.0;

    /// These options with their lengths scaled to an image whose longer side is `size_px`.
    pub(super) fn scaled(&self, size_px: usize) -> Self {
        let scale = (size_px as f64 / Self::SIZE_PX).max(1.0);
        Self {
            window_radius_px: (self.window_radius_px as f64 * scale).round() as usize,
            search_radius_px: self.search_radius_px * scale,
            ..self.clone()
        }
    }
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
