//! Beyond the paper: motion and visibility per pixel where the two warped frames disagree, and the mean of
//! four frames, which has less noise, where they agree.
//!
//! Beside a moving outline the warp interpolates between the motions on both sides, and the cross dissolve
//! mixes a frame that shows the background with one that does not. There, blocks of pixels try the
//! motions of the tracks around them, each under three hypotheses. Either both frames see the point, and
//! agree with each other. Or only the earlier does, and agrees with the frame before it. Or only the
//! later does, and agrees with the frame after it. The nearer the instant is to a frame, the less likely
//! it is that only the other sees the point. A hypothesis costs more where another motion explains its
//! pixels better. Otherwise two similar bodies, at one place in successive frames, are matched to each
//! other. Every pixel is the mean of all hypotheses and of the warped frames' cross-fade, weighted by
//! agreement over a small window. That agreement is computed at points, a few in a window, and interpolated
//! between them. Blocks overlap and fade into each other, so that their borders do not
//! show. Static blocks are the mean of the four frames. Each pixel's motion and its cost are the same
//! weighted means.
//!
//! Known limits: a surface that none of the four frames shows is not found. One that a single frame shows can't
//! be verified. Outlines are accurate to about two pixels, because a window of a few pixels decides.

mod best_costs;
mod block;
mod candidates;
mod cost_points;
mod four_frames;
mod hypotheses;
mod inputs;
mod layout;
mod patch;
mod square;
mod static_block;
#[cfg(test)]
mod tests;
mod tried_motion;
mod weighted_sums;

use super::warp::{Warp, warped};
use super::windows::{cross_fade, difference};
use super::{Motion, RefineOptions};
use crate::raster::{Image, box_filter};
pub use best_costs::PairCosts;
use candidates::Candidates;
use cost_points::CostPoints;
pub use four_frames::FourFrames;
use inputs::Inputs;
use layout::Layout;
use rayon::prelude::*;
use std::ops::Range;
use weighted_sums::RefinedBlock;

/// How a pixel moves, by the hypotheses that it is the mean of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelMotion {
    /// Between the earlier and the later frame, pixels.
    pub motion_px: f32,
    /// The change of the motion from one frame to the next, pixels per frame: the larger of those at the two
    /// frames. 0 where it is not known.
    pub change_px: f32,
    /// The hypotheses' cost: the mean difference of the frames over a window, 0..=1, and what counts against a
    /// hypothesis besides; at rest at least the warped frames' difference. 0 if the frames agree.
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

/// The image at the instant: the cross dissolve of the two warped frames, refined where they disagree, and
/// averaged with the outer frames where these agree. Values are in 0..=1.
///
/// `warps` take the earlier and the later frame to the instant; they have the frames' size. `motions` are those
/// of the tracks at the instant, `best_costs` those of the pair. Without motions, only static blocks are averaged.
/// Beside the image, how each pixel moves, row by row, if that is wanted.
pub fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: &[Motion],
    best_costs: &PairCosts,
    options: &RefineOptions,
) -> (Image, Option<Vec<PixelMotion>>) {
    let (w, h) = (frames.earlier.width(), frames.earlier.height());
    let options = &options.scaled(w.max(h));
    let layout = Layout::new([w, h], options.window_radius_px);
    // A block that touches what is needed, the windows around its pixels, and the windows of their costs.
    let near = frames.parts.map(|parts| parts.grown(layout.side + 2 * options.window_radius_px));
    let warped = [(frames.earlier, warps[0]), (frames.later, warps[1])]
        .map(|(image, warp)| warped(image, warp, near.as_ref()));
    let cross_faded = cross_fade(&warped[0], &warped[1], frames.fraction);
    let cost = |a: &Image, b: &Image| box_filter(&difference(a, b), w, h, options.window_radius_px);
    let costs = cost(&warped[0], &warped[1]);
    let outer_counts = frames.outer_weight(options) > 0.0;
    let outer_costs = [frames.before, frames.after]
        .map(|f| f.filter(|_| outer_counts).map(|f| cost(f, &cross_faded)));

    let motion_px = frames.with_motions.then(|| motion_px(warps));
    let inputs = Inputs {
        frames,
        candidates: Candidates::new(motions.to_vec(), options),
        best_costs,
        cross_faded: &cross_faded,
        costs: &costs,
        motion_px: motion_px.as_deref(),
        outer_costs,
        options,
        layout,
        points: CostPoints::new(options.window_radius_px, layout.side),
    };
    let blocks: Vec<Option<RefinedBlock>> = (0..layout.count())
        .into_par_iter()
        .map(|k| block::refine(&inputs, layout.origin(k)))
        .collect();

    let pixel_motion = |(&motion_px, cost)| PixelMotion { motion_px, change_px: 0.0, cost };
    let motions = motion_px.as_ref().map(|motion_px| {
        let of_warps: Vec<PixelMotion> = motion_px.iter().zip(costs).map(pixel_motion).collect();
        blended_motions(&of_warps, &blocks, &layout)
    });
    (blended(&cross_faded, &blocks, &layout), motions)
}

/// The distance of the places that each pixel comes from in the two frames, row by row.
pub(super) fn motion_px(warps: [&Warp; 2]) -> Vec<f32> {
    let places = warps[0].source.iter().zip(&warps[1].source);
    places.map(|([ax, ay], [bx, by])| (ax - bx).hypot(ay - by)).collect()
}

/// The blocks, which fade into each other, and the cross-faded frames where there is none.
fn blended(cross_faded: &Image, blocks: &[Option<RefinedBlock>], layout: &Layout) -> Image {
    let (w, h, channels) = (cross_faded.width(), cross_faded.height(), cross_faded.channels());
    let weights: Vec<f32> =
        layout.weights().into_iter().flat_map(|v| std::iter::repeat_n(v, channels)).collect();
    let mut data = vec![0.0; w * h * channels];
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        for part in layout.parts(y) {
            let Range { start, end } = part.columns;
            let from = match &blocks[part.block] {
                Some(block) => &block.colors[(part.row * layout.side + part.first) * channels..],
                None => &cross_faded.row(y)[start * channels..],
            };
            let out = row[start * channels..end * channels].iter_mut();
            let weights = &weights[part.first * channels..];
            out.zip(from).zip(weights).for_each(|((out, v), w)| *out += w * part.weight * v);
        }
        row.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    });
    Image::from_data(w, h, channels, data)
}

/// The same of how pixels move; `of_warps` are the motions of the warped frames.
fn blended_motions(
    of_warps: &[PixelMotion],
    blocks: &[Option<RefinedBlock>],
    layout: &Layout,
) -> Vec<PixelMotion> {
    let (w, weights) = (layout.image[0], layout.weights());
    let mut motions = vec![PixelMotion::default(); of_warps.len()];
    motions.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
        for part in layout.parts(y) {
            let own = blocks[part.block].as_ref().and_then(|block| block.motions.as_deref());
            let from = match own {
                Some(motions) => &motions[part.row * layout.side + part.first..],
                None => &of_warps[y * w + part.columns.start..],
            };
            let out = row[part.columns].iter_mut().zip(from);
            out.zip(&weights[part.first..]).for_each(|((out, v), w)| out.add(w * part.weight, *v));
        }
    });
    motions
}
