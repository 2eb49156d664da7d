//! Beyond the paper: motion and visibility per pixel where the two warped frames disagree, and the mean of
//! four frames, which has less noise, where they agree.
//!
//! At a moving outline, the paper's warp interpolates between the motions on both sides, and its cross
//! dissolve mixes a frame that shows the background with one that does not. This method has these steps, in
//! the order of the files:
//!
//! 1. [`blocks`]: the image is divided into overlapping blocks, which are blended.
//! 2. [`motions`]: a block's candidate motions are affine, each fitted to nearby tracks that move alike.
//! 3. [`costs`]: a motion's cost is the difference of the compensated frames, averaged over a window. It is
//!    computed on a grid of points, and interpolated between them.
//! 4. [`hypotheses`]: each motion has three hypotheses of visibility. Either both middle frames see the
//!    surface, and agree. Or only the earlier does, and agrees with the frame before it. Or only the later
//!    does, and agrees with the frame after it. The latter two have a prior cost, which grows towards the
//!    frame that misses the surface. Every hypothesis costs more where another motion explains its pixels
//!    better. Without this, two similar bodies that take the same position in successive frames are matched
//!    to each other. A pixel is the mean of all hypotheses and of the warped frames' cross-fade, with weights
//!    that fall exponentially with cost.
//! 5. [`four_frames`]: the outer frames are averaged in where they agree with the middle ones. Static blocks
//!    are the mean of the four frames.
//!
//! Each pixel's motion, and its cost, are averaged with the weights of step 4 too.
//!
//! Known limits: a surface that none of the four frames shows is not found. A surface that only one frame
//! shows can't be verified. Outlines are accurate to about two pixels, because costs are means over windows.

mod blocks;
mod costs;
mod four_frames;
mod hypotheses;
mod motions;
#[cfg(test)]
mod tests;

use super::InterpolationOptions;
use super::tracked_pair::{RowFractions, TrackMotion};
use super::warp::{Warp, cross_fade_rows, difference, warped};
use crate::raster::{Image, Tiles, box_filter};
use blocks::BlockGrid;
use costs::CostPoints;
pub use costs::PairCosts;
use four_frames::{is_static, static_mean};
use hypotheses::BlockHypotheses;
use motions::MotionHypotheses;
use rayon::prelude::*;

/// Maximum cost of the two warped frames in a block in which they agree: their mean absolute difference over
/// the window around each pixel, for pixel values of 0 to 1.
const MAX_AGREEING_COST: f32 = 0.03;
/// Maximum number of motions by which the outer frames are compensated, in a block in which the warped frames
/// agree.
const MAX_AGREEING_MOTIONS: usize = 2;
/// Channels of an image of motions. Each is the weighted mean over a pixel's hypotheses:
///
/// 1. The motion between the earlier and the later frame, pixels.
/// 2. The change of the motion from one frame interval to the next, pixels per frame: the larger of the
///    changes at the two frames. 0 where it is unknown.
/// 3. The cost of the hypotheses, 0..=1: the mean difference of frames over a window, plus prior costs. For a
///    static surface it is at least the warped frames' difference. 0 if the frames agree.
pub(super) const MOTION_CHANNELS: usize = 3;

/// The four frames around an instant. All images have the same size and channels.
pub(super) struct FourFrames<'a> {
    /// The frame before the earlier one, if it exists.
    pub before: Option<&'a Image>,
    /// The frame at t.
    pub earlier: &'a Image,
    /// The frame at t + Δt.
    pub later: &'a Image,
    /// The frame after the later one, if it exists.
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt of the instant t' in each row: 0 at the earlier frame, 1 at the later.
    pub fractions: RowFractions,
    /// The tiles of the image that are needed; `None` for all. Tiles far from them are black.
    pub parts: Option<&'a Tiles>,
}

impl<'a> FourFrames<'a> {
    /// The four frames in order of time: before, earlier, later, after.
    fn images(&self) -> [Option<&'a Image>; 4] {
        [self.before, Some(self.earlier), Some(self.later), self.after]
    }
}

/// Inputs that all blocks share.
struct SharedInputs<'a> {
    frames: &'a FourFrames<'a>,
    motions: MotionHypotheses,
    pair_costs: &'a PairCosts,
    /// The cross-fade of the two warped frames.
    cross_faded: &'a Image,
    /// Mean difference of the two warped frames over the window around each pixel.
    costs: &'a [f32],
    /// The pixels' motions according to the warps, [`MOTION_CHANNELS`] values per pixel.
    warp_motions: &'a Image,
    /// For the frame before and the frame after: its mean difference, without motion compensation, from the
    /// cross-fade over the window around each pixel. `None` if the frame does not exist or has no weight.
    outer_costs: [Option<Vec<f32>>; 2],
    grid: BlockGrid,
    points: CostPoints,
}

/// A refined block, row by row. Values at pixels outside the image are undefined.
struct RefinedBlock {
    colors: Vec<f32>,
    /// [`MOTION_CHANNELS`] values per pixel; `None` if the pixels' motions are those of the warps.
    motions: Option<Vec<f32>>,
}

/// The image at the instant: the cross dissolve of the two warped frames, refined where they disagree, and
/// averaged with the outer frames where these agree. Values are in 0..=1. The second image holds the pixels'
/// motions, [`MOTION_CHANNELS`] per pixel.
///
/// `warps` take the earlier and the later frame to the instant. `motions` are the tracks' motions from their
/// positions at the instant. If there are none, only static blocks change.
pub(super) fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: Vec<TrackMotion>,
    pair_costs: &PairCosts,
    options: &InterpolationOptions,
) -> (Image, Image) {
    let (w, h) = (frames.earlier.width(), frames.earlier.height());
    let options = options.scaled_to([w, h]);
    let radius = options.window_radius_px;
    let grid = BlockGrid::new([w, h], radius);
    // The needed tiles, grown by the blocks that touch them, by the windows around the blocks' pixels, and by
    // the windows around these windows' pixels.
    let near = frames.parts.map(|parts| parts.grown(grid.side + 2 * radius));
    let warped = [(frames.earlier, warps[0]), (frames.later, warps[1])]
        .map(|(image, warp)| warped(image, warp, near.as_ref()));
    let cross_faded = cross_fade_rows(&warped[0], &warped[1], frames.fractions);
    let cost = |a: &Image, b: &Image| box_filter(&difference(a, b), w, h, radius);
    let costs = cost(&warped[0], &warped[1]);
    let warp_motions = warp_motions(warps, &costs);
    let ends = [0.0, 0.5 * h as f64, h as f64];
    let outer_counts = ends.iter().any(|&y_px| frames.outer_weight(y_px) > 0.0);
    let shared = SharedInputs {
        frames,
        motions: MotionHypotheses::new(motions, options.search_radius_px),
        pair_costs,
        cross_faded: &cross_faded,
        costs: &costs,
        warp_motions: &warp_motions,
        outer_costs: [frames.before, frames.after]
            .map(|f| f.filter(|_| outer_counts).map(|f| cost(f, &cross_faded))),
        grid,
        points: CostPoints::new(radius, grid.side),
    };
    let blocks: Vec<Option<RefinedBlock>> =
        (0..grid.count()).into_par_iter().map(|k| refined_block(&shared, k)).collect();
    let colors = |k: usize| blocks[k].as_ref().map(|block| &block.colors[..]);
    let motions = |k: usize| blocks[k].as_ref()?.motions.as_deref();
    let (mut image, motions) = rayon::join(
        || blended(&cross_faded, colors, &grid),
        || blended(&warp_motions, motions, &grid),
    );
    image.data_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    (image, motions)
}

/// An image of the pixels' motions according to two warps, [`MOTION_CHANNELS`] per pixel. A motion is the
/// distance between the pixel's positions in the two frames; its change is unknown, 0. `costs` has the third
/// channel, row by row.
pub(super) fn warp_motions(warps: [&Warp; 2], costs: &[f32]) -> Image {
    let sources = warps[0].source.iter().zip(&warps[1].source);
    let motions = sources.map(|([ax, ay], [bx, by])| (ax - bx).hypot(ay - by));
    let data = motions.zip(costs).flat_map(|(motion_px, cost)| [motion_px, 0.0, *cost]).collect();
    Image::from_data(warps[0].width, warps[0].height, MOTION_CHANNELS, data)
}

/// Refines block number `block`. `None` if the block keeps the cross-fade of the two warped frames: no track
/// is near, its pixels are not needed, or there is no frame before or after the pair.
fn refined_block(shared: &SharedInputs, block: usize) -> Option<RefinedBlock> {
    let area = shared.grid.area(block);
    if shared.frames.parts.is_some_and(|parts| !parts.touches(area.origin, area.side)) {
        return None;
    }
    let max_cost = area.rows_of(shared.costs).flatten().copied().fold(0.0, f32::max);
    let agree = max_cost <= MAX_AGREEING_COST;
    if agree && shared.outer_costs.iter().all(Option::is_none) {
        return None;
    }
    if agree && is_static(&shared.outer_costs, shared.costs, area) {
        let colors = static_mean(shared.frames, shared.cross_faded, area);
        return Some(RefinedBlock { colors, motions: None });
    }
    let mut motions = shared.motions.around(&area.center());
    if motions.is_empty() {
        return None;
    }
    if agree {
        motions.truncate(MAX_AGREEING_MOTIONS);
    }
    Some(BlockHypotheses::new(shared, area, motions, agree).mean())
}

/// A copy of `image` with the refined blocks blended in, by the weights of the grid. `block` returns the
/// values of a block by its number; for `None`, the image's own values are blended.
fn blended<'a>(
    image: &Image,
    block: impl Fn(usize) -> Option<&'a [f32]>,
    grid: &BlockGrid,
) -> Image {
    let (w, h, channels) = (image.width(), image.height(), image.channels());
    let weights = grid.weights();
    let mut data = vec![0.0; w * h * channels];
    for k in 0..grid.count() {
        let block = block(k);
        for (first, columns, y) in grid.area(k).rows() {
            let span = columns.start * channels..columns.end * channels;
            let from = match block {
                Some(values) => &values[first * channels..],
                None => &image.row(y)[span.clone()],
            };
            let out = data[y * w * channels..][span].chunks_exact_mut(channels);
            let (row_weight, weights) = (weights[first / grid.side], &weights[first % grid.side..]);
            for ((out, from), w) in out.zip(from.chunks_exact(channels)).zip(weights) {
                out.iter_mut().zip(from).for_each(|(out, v)| *out += w * row_weight * v);
            }
        }
    }
    Image::from_data(w, h, channels, data)
}
