//! Beyond the paper: refines the image where the two warped frames disagree, by motion and visibility per pixel.
//! Where they agree, the image is the mean of four frames, which has less noise.
//!
//! At a moving outline, the paper's warp interpolates between the motions on both sides. Its cross dissolve mixes a
//! frame that shows the background with a frame that does not. This method has these steps, in the order of the
//! files:
//!
//! 1. [`blocks`]: the image is divided into overlapping blocks, which are blended.
//! 2. [`motions`]: a block has several candidate motions. Each is affine and fitted to nearby tracks that move
//!    alike.
//! 3. [`costs`]: the cost of a motion is the difference of the motion-compensated frames, averaged over a window.
//!    It is computed on a grid of points, and interpolated between them.
//! 4. [`hypotheses`]: each motion has three hypotheses of visibility. Either both middle frames see the surface,
//!    and agree. Or only the earlier one sees it, and agrees with the frame before. Or only the later one sees it,
//!    and agrees with the frame after. The last two hypotheses have a prior cost, which is larger if the instant is
//!    nearer to the frame that does not see the surface. Every hypothesis costs more where another motion explains
//!    its pixels better. Without this, two similar bodies that take the same position in successive frames would be
//!    matched to each other. A pixel is the weighted mean of all hypotheses and of the cross-fade of the two warped
//!    frames. Weights fall exponentially with cost.
//! 5. [`four_frames`]: the outer frames, which are those before and after the pair, are averaged in where they
//!    agree with the middle frames. Static blocks are the mean of the four frames.
//!
//! The motion and the cost of each pixel are means with the weights of step 4 too.
//!
//! Known limits: a surface that none of the four frames shows is not found. A surface that only one frame shows
//! can't be verified. Outlines are accurate to about two pixels, because costs are means over windows.

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

/// Maximum cost at the pixels of a block in which the two warped frames count as equal, for pixel values of 0 to 1. The
/// cost of a pixel is the mean absolute difference of the two warped frames over the window around the pixel.
const MAX_AGREEING_COST: f32 = 0.03;
/// Maximum number of candidate motions by which the frames before and after the pair are compensated, in a block in
/// which the two warped frames agree.
const MAX_AGREEING_MOTIONS: usize = 2;
/// Number of channels of an image that holds each pixel's motion. Each channel is the weighted mean over the pixel's
/// hypotheses of motion and visibility:
///
/// 1. The length of the motion between the earlier and the later frame, pixels.
/// 2. The change of the motion from one frame interval to the next, pixels per frame. It is the larger of the
///    changes at the earlier and at the later frame, and 0 if it is unknown.
/// 3. The cost, for pixel values of 0 to 1: the mean difference of the compared frames over a window, plus the
///    other terms of a hypothesis's cost. For a static surface, it is at least the mean difference of the two
///    warped frames.
///
/// At pixels that are not refined, the channels are those of [`warp_motions`].
pub(super) const MOTION_CHANNELS: usize = 3;

/// The four frames around an instant. All images have the same size and channels.
pub(super) struct FourFrames<'a> {
    /// Frame before the pair's earlier frame; `None` if it does not exist.
    pub before: Option<&'a Image>,
    /// The pair's earlier frame, at the time t.
    pub earlier: &'a Image,
    /// The pair's later frame, at the time t + Δt.
    pub later: &'a Image,
    /// Frame after the pair's later frame; `None` if it does not exist.
    pub after: Option<&'a Image>,
    /// Fraction (t' − t)/Δt of the instant t' in each image row: 0 at the earlier frame, 1 at the later frame.
    pub fractions: RowFractions,
    /// Tiles of the image that are needed; `None` for the whole image. Tiles far from the needed tiles are black.
    pub parts: Option<&'a Tiles>,
}

impl<'a> FourFrames<'a> {
    /// Returns the four frames in order of time: before, earlier, later, after.
    fn images(&self) -> [Option<&'a Image>; 4] {
        [self.before, Some(self.earlier), Some(self.later), self.after]
    }
}

/// Inputs of the refinement that are the same for all blocks.
struct SharedInputs<'a> {
    frames: &'a FourFrames<'a>,
    motions: MotionHypotheses,
    pair_costs: &'a PairCosts,
    /// Cross-fade of the two warped frames.
    cross_faded: &'a Image,
    /// Mean difference of the two warped frames over the window around each pixel, one value per pixel, row by row.
    costs: &'a [f32],
    /// Motion of each pixel according to the two warps: an image with [`MOTION_CHANNELS`] channels, as the function
    /// [`warp_motions`] returns it.
    warp_motions: &'a Image,
    /// For the frame before and the frame after the pair: the mean difference between this frame, without motion
    /// compensation, and the cross-fade of the two warped frames, over the window around each pixel. `None` if the
    /// frame does not exist or has no weight.
    outer_costs: [Option<Vec<f32>>; 2],
    grid: BlockGrid,
    points: CostPoints,
}

/// A refined block of pixels, row by row. Values at pixels outside the image are undefined.
struct RefinedBlock {
    colors: Vec<f32>,
    /// Motions of the pixels, [`MOTION_CHANNELS`] values per pixel. `None` if they are the motions that the warps give.
    motions: Option<Vec<f32>>,
}

/// Returns the interpolated image, and an image of its pixels' motions with [`MOTION_CHANNELS`] channels. The
/// interpolated image is the cross dissolve of the two warped frames, refined where these disagree. It is averaged with
/// the frames before and after the pair where these agree with it. Its values are in 0..=1.
///
/// `warps` map the interpolated image to the earlier and to the later frame. `motions` are the motions of the tracks,
/// measured from the tracks' positions at the instant. Without tracks, only static blocks differ from the cross
/// dissolve.
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
    // The needed tiles, grown by the blocks that touch the tiles, by the windows around the blocks' pixels, and by
    // the windows around the pixels of these windows.
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

/// Returns an image of the pixels' motions according to two warps, with [`MOTION_CHANNELS`] channels. The first channel
/// is the distance between the pixel's source positions in the two frames. The second, the change of the motion, is
/// unknown and set to 0. The third is `costs`, row by row.
pub(super) fn warp_motions(warps: [&Warp; 2], costs: &[f32]) -> Image {
    let sources = warps[0].source.iter().zip(&warps[1].source);
    let motions = sources.map(|([ax, ay], [bx, by])| (ax - bx).hypot(ay - by));
    let data = motions.zip(costs).flat_map(|(motion_px, cost)| [motion_px, 0.0, *cost]).collect();
    Image::from_data(warps[0].width, warps[0].height, MOTION_CHANNELS, data)
}

/// Refines block number `block`. Returns `None` if the block stays as the cross-fade of the two warped frames. This is
/// so in three cases: its pixels are not needed; it has no candidate motions; or the warped frames agree, and neither
/// the frame before nor the frame after the pair can be used.
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

/// Returns a copy of `image` with the refined blocks blended in, by the weights of the grid ([`BlockGrid::weights`]).
/// `block` returns the values of a block by its number. A block for which it returns `None` keeps the image's own
/// values.
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
