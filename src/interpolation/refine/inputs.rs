//! What all blocks of an image share.

use super::best_costs::PairCosts;
use super::candidates::Candidates;
use super::cost_points::CostPoints;
use super::four_frames::FourFrames;
use super::layout::Layout;
use crate::interpolation::RefineOptions;
use crate::raster::Image;

/// What the refinement of every block starts from.
pub struct Inputs<'a> {
    pub frames: &'a FourFrames<'a>,
    /// The candidate motions.
    pub candidates: Candidates,
    /// How well motions explain the earlier and the later frame.
    pub best_costs: &'a PairCosts,
    /// The cross-fade of the two warped frames.
    pub cross_faded: &'a Image,
    /// Mean difference of the two warped frames over the window around each pixel, row by row.
    pub costs: &'a [f32],
    /// Distance of the places that each pixel comes from in the two frames, row by row, if motions are wanted.
    pub motion_px: Option<&'a [f32]>,
    /// Costs of the frame before and of the frame after, not warped, and the cross-fade; `None` if
    /// the frame does not exist or has no weight.
    pub outer_costs: [Option<Vec<f32>>; 2],
    /// With lengths scaled to the image's size.
    pub options: &'a RefineOptions,
    /// Where the blocks lie.
    pub layout: Layout,
    /// Where a block's costs are computed.
    pub points: CostPoints,
}
