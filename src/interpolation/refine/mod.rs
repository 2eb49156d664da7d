//! Beyond the paper: motion and visibility per pixel where the two warped frames disagree, and the mean of
//! four frames, which has less noise, where they agree.
//!
//! Beside a moving outline the warp interpolates between the motions on both sides, and the cross dissolve
//! mixes a frame that shows the background with one that does not. The method, in the order of the files:
//!
//! 1. [`blocks`]: the image is divided into overlapping blocks, which fade into each other.
//! 2. [`motions`]: a block's hypotheses of motion are affine motions, each fitted to nearby tracks that move
//!    alike.
//! 3. [`costs`]: a motion's cost is the difference of the compensated frames, averaged over a window. It is
//!    computed at points, a few in a window, and interpolated between them.
//! 4. [`hypotheses`]: each motion has three hypotheses of visibility. Either both middle frames see the
//!    surface, and agree. Or only the earlier does, and agrees with the frame before it. Or only the later
//!    does, and agrees with the frame after it. The latter two have a prior cost, which grows towards the
//!    frame that misses the surface. All cost more where another motion explains their pixels better:
//!    otherwise two similar bodies, at one position in successive frames, are matched to each other. A pixel
//!    is the mean of all hypotheses and of the warped frames' cross-fade, with weights that fall
//!    exponentially with cost.
//! 5. [`four_frames`]: the outer frames are averaged in where they agree with the middle ones. Static blocks
//!    are the mean of the four frames.
//!
//! Each pixel's motion and its cost are the same weighted means.
//!
//! Known limits: a surface that none of the four frames shows is not found. One that a single frame shows
//! can't be verified. Outlines are accurate to about two pixels, because a window of a few pixels decides.

mod blocks;
mod costs;
mod four_frames;
mod hypotheses;
mod motions;
#[cfg(test)]
mod tests;

use super::InterpolationOptions;
use super::tracked_pair::TrackMotion;
use super::warp::{Warp, cross_fade, difference, warped};
use crate::raster::{Image, Tiles, box_filter};
use blocks::{BlockGrid, BlockRow};
use costs::CostPoints;
pub use costs::PairCosts;
use four_frames::{is_static, static_mean};
use hypotheses::BlockHypotheses;
use motions::MotionHypotheses;
use rayon::prelude::*;
use std::ops::Range;

/// Maximum mean difference of the warped frames, values 0..=1, over the windows of a block that agrees.
const MAX_AGREEING_COST: f32 = 0.03;
/// Maximum number of motions by which the outer frames are compensated in a block that agrees.
const MAX_AGREEING_MOTIONS: usize = 2;

/// The frames around an instant. All images have the same size and channels.
pub(super) struct FourFrames<'a> {
    /// The frame before the earlier one, if it exists.
    pub before: Option<&'a Image>,
    /// The frame at t.
    pub earlier: &'a Image,
    /// The frame at t + Δt.
    pub later: &'a Image,
    /// The frame after the later one, if it exists.
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt of the instant t': 0 at the earlier frame, 1 at the later.
    pub fraction: f32,
    /// The tiles of the image that are needed, `None` for all. Tiles far from them are black.
    pub parts: Option<&'a Tiles>,
    /// Whether the pixels' motions are wanted.
    pub with_motions: bool,
}

impl<'a> FourFrames<'a> {
    /// The frames 0 to 3: before, earlier, later, after.
    fn images(&self) -> [Option<&'a Image>; 4] {
        [self.before, Some(self.earlier), Some(self.later), self.after]
    }
}

/// A pixel's motion: the weighted mean of its hypotheses' motions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PixelMotion {
    /// Motion between the earlier and the later frame, pixels.
    pub motion_px: f32,
    /// Change of the motion from one frame to the next, pixels per frame: the larger of the changes at the two
    /// frames. 0 where it is unknown.
    pub change_px: f32,
    /// Cost of the hypotheses, 0..=1: the mean difference of frames over a window, and prior costs. At rest it is
    /// at least the warped frames' difference. 0 if the frames agree.
    pub cost: f32,
}

impl PixelMotion {
    fn times(self, weight: f32) -> Self {
        let Self { motion_px, change_px, cost } = self;
        Self { motion_px: weight * motion_px, change_px: weight * change_px, cost: weight * cost }
    }

    fn add(&mut self, weight: f32, other: Self) {
        self.motion_px += weight * other.motion_px;
        self.change_px += weight * other.change_px;
        self.cost += weight * other.cost;
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
    /// Motion of each pixel by the warps, if motions are wanted.
    motion_px: Option<&'a [f32]>,
    /// Mean differences of the frames before and after, not compensated, from the cross-fade. `None` if the frame
    /// does not exist or has no weight.
    outer_costs: [Option<Vec<f32>>; 2],
    grid: BlockGrid,
    points: CostPoints,
}

/// A refined block, row by row. Pixels outside the image are undefined.
struct RefinedBlock {
    colors: Vec<f32>,
    /// `None` where the warps' motion holds, or if motions are not wanted.
    motions: Option<Vec<PixelMotion>>,
}

/// The image at the instant: the cross dissolve of the two warped frames, refined where they disagree, and
/// averaged with the outer frames where these agree. Values are in 0..=1. If wanted, each pixel's motion.
///
/// `warps` take the earlier and the later frame to the instant. `motions` are those of the tracks at the
/// instant; without any, only static blocks are averaged.
pub(super) fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: Vec<TrackMotion>,
    pair_costs: &PairCosts,
    options: &InterpolationOptions,
) -> (Image, Option<Vec<PixelMotion>>) {
    let (w, h) = (frames.earlier.width(), frames.earlier.height());
    let options = options.scaled_to([w, h]);
    let radius = options.window_radius_px;
    let grid = BlockGrid::new([w, h], radius);
    // Blocks that touch needed tiles, with the windows around their pixels and around these windows.
    let near = frames.parts.map(|parts| parts.grown(grid.side + 2 * radius));
    let warped = [(frames.earlier, warps[0]), (frames.later, warps[1])]
        .map(|(image, warp)| warped(image, warp, near.as_ref()));
    let cross_faded = cross_fade(&warped[0], &warped[1], frames.fraction);
    let cost = |a: &Image, b: &Image| box_filter(&difference(a, b), w, h, radius);
    let costs = cost(&warped[0], &warped[1]);
    let outer_counts = frames.outer_weight() > 0.0;
    let outer_costs = [frames.before, frames.after]
        .map(|f| f.filter(|_| outer_counts).map(|f| cost(f, &cross_faded)));

    let motion_px = frames.with_motions.then(|| motion_px(warps));
    let shared = SharedInputs {
        frames,
        motions: MotionHypotheses::new(motions, options.search_radius_px),
        pair_costs,
        cross_faded: &cross_faded,
        costs: &costs,
        motion_px: motion_px.as_deref(),
        outer_costs,
        grid,
        points: CostPoints::new(radius, grid.side),
    };
    let blocks: Vec<Option<RefinedBlock>> =
        (0..grid.count()).into_par_iter().map(|k| refined_block(&shared, k)).collect();

    let pixel_motion = |(&motion_px, cost)| PixelMotion { motion_px, change_px: 0.0, cost };
    let motions = motion_px.as_ref().map(|motion_px| {
        let of_warps: Vec<PixelMotion> = motion_px.iter().zip(costs).map(pixel_motion).collect();
        blended_motions(&of_warps, &blocks, &grid)
    });
    (blended(&cross_faded, &blocks, &grid), motions)
}

/// The distance between each pixel's sources in the two frames, row by row.
pub(super) fn motion_px(warps: [&Warp; 2]) -> Vec<f32> {
    let sources = warps[0].source.iter().zip(&warps[1].source);
    sources.map(|([ax, ay], [bx, by])| (ax - bx).hypot(ay - by)).collect()
}

/// Refines one block. `None` where the cross-fade holds: no track is near, the block is not needed, or there is
/// no outer frame to average.
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

/// Blends the blocks into an image. Where there is no block, the cross-faded frames stay.
fn blended(cross_faded: &Image, blocks: &[Option<RefinedBlock>], grid: &BlockGrid) -> Image {
    let (w, h, channels) = (cross_faded.width(), cross_faded.height(), cross_faded.channels());
    let weights: Vec<f32> =
        grid.column_weights().into_iter().flat_map(|v| std::iter::repeat_n(v, channels)).collect();
    let mut data = vec![0.0; w * h * channels];
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        for BlockRow { block, row: block_row, first, columns, weight } in grid.row(y) {
            let Range { start, end } = columns;
            let from = match &blocks[block] {
                Some(block) => &block.colors[(block_row * grid.side + first) * channels..],
                None => &cross_faded.row(y)[start * channels..],
            };
            let out = row[start * channels..end * channels].iter_mut();
            let weights = &weights[first * channels..];
            out.zip(from).zip(weights).for_each(|((out, v), w)| *out += w * weight * v);
        }
        row.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    });
    Image::from_data(w, h, channels, data)
}

/// Blends the blocks' motions. Where there is none, the motions of the warps stay.
fn blended_motions(
    of_warps: &[PixelMotion],
    blocks: &[Option<RefinedBlock>],
    grid: &BlockGrid,
) -> Vec<PixelMotion> {
    let (w, weights) = (grid.image[0], grid.column_weights());
    let mut motions = vec![PixelMotion::default(); of_warps.len()];
    motions.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
        for BlockRow { block, row: block_row, first, columns, weight } in grid.row(y) {
            let own = blocks[block].as_ref().and_then(|block| block.motions.as_deref());
            let from = match own {
                Some(motions) => &motions[block_row * grid.side + first..],
                None => &of_warps[y * w + columns.start..],
            };
            let out = row[columns].iter_mut().zip(from);
            out.zip(&weights[first..]).for_each(|((out, v), w)| out.add(w * weight, *v));
        }
    });
    motions
}
