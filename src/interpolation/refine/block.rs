//! The refinement of one block of pixels: what of it is required.

use super::best_costs::PairCosts;
use super::candidates::Candidates;
use super::cost_points::CostPoints;
use super::four_frames::FourFrames;
use super::hypotheses::Block;
use super::layout::Layout;
use super::square::Square;
use super::static_block::{average, is_static};
use super::weighted_sums::RefinedBlock;
use crate::interpolation::RefineOptions;
use crate::raster::Image;

/// Maximum number of motions that the outer frames are warped by where the middle ones agree. Larger: time;
/// smaller: at the border of two surfaces one of them is not averaged.
const MAX_AGREEING_MOTIONS: usize = 2;

/// Refines the blocks of an image.
pub struct BlockRefiner<'a> {
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

impl BlockRefiner<'_> {
    /// The refined block with this top-left pixel; `None` if no track is near, or it is not needed.
    pub fn refine(&self, origin: [isize; 2]) -> Option<RefinedBlock> {
        let side = self.layout.side;
        if self.frames.parts.is_some_and(|parts| !parts.touches(origin, side)) {
            return None;
        }
        let square = Square { origin, side, image: self.layout.image };
        let max_cost = square.rows_of(self.costs).flatten().copied().fold(0.0, f32::max);
        let agree = max_cost <= self.options.min_difference;
        // Where the middle frames agree, only the outer frames remain to be averaged in.
        if agree && self.outer_costs.iter().all(Option::is_none) {
            return None;
        }
        if agree && is_static(&self.outer_costs, self.costs, self.options.outer_slack, square) {
            let outer_weight = self.frames.outer_weight(self.options);
            let colors = average(self.frames, self.cross_faded, outer_weight, square);
            return Some(RefinedBlock { colors, motions: None });
        }
        let mut candidates = self.candidates.around(&square.center());
        if candidates.is_empty() {
            return None;
        }
        if agree {
            candidates.truncate(MAX_AGREEING_MOTIONS);
        }
        Some(Block::new(self, square, candidates, !agree).mean())
    }
}
