//! The refinement of one block of pixels: what of it is required.

use super::hypotheses::Block;
use super::inputs::Inputs;
use super::square::Square;
use super::static_block::{average, is_static};
use super::weighted_sums::RefinedBlock;

/// Maximum number of motions that the outer frames are warped by where the middle ones agree. Larger: time;
/// smaller: at the border of two surfaces one of them is not averaged.
const MAX_AGREEING_MOTIONS: usize = 2;

/// The refined block with this top-left pixel; `None` if no track is near, or it is not needed.
pub fn refine(inputs: &Inputs, origin: [isize; 2]) -> Option<RefinedBlock> {
    let side = inputs.layout.side;
    if inputs.frames.parts.is_some_and(|parts| !parts.touches(origin, side)) {
        return None;
    }
    let square = Square { origin, side, image: inputs.layout.image };
    let max_cost = square.rows_of(inputs.costs).flatten().copied().fold(0.0, f32::max);
    let agree = max_cost <= inputs.options.min_difference;
    // Where the middle frames agree, only the outer frames remain to be averaged in.
    if agree && inputs.outer_costs.iter().all(Option::is_none) {
        return None;
    }
    if agree && is_static(&inputs.outer_costs, inputs.costs, inputs.options.outer_slack, square) {
        let outer_weight = inputs.frames.outer_weight(inputs.options);
        let colors = average(inputs.frames, inputs.cross_faded, outer_weight, square);
        return Some(RefinedBlock { colors, motions: None });
    }
    let mut candidates = inputs.candidates.around(&square.center());
    if candidates.is_empty() {
        return None;
    }
    if agree {
        candidates.truncate(MAX_AGREEING_MOTIONS);
    }
    Some(Block::new(inputs, square, candidates, !agree).mean())
}
