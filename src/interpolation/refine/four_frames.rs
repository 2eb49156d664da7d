//! Compositing of four frames. The middle frames are the two frames of the pair; the outer frames are the frame before
//! and the frame after the pair. Where the outer frames agree with the composite of the middle frames, they are
//! averaged in, which halves the noise variance.
//!
//! Whether they agree is decided by costs. The cost of the middle frames at a pixel is the mean absolute difference
//! between the two, after motion compensation, over a window. The cost of an outer frame is its mean absolute
//! difference from the composite over the same window. The excess of an outer frame is its cost minus the cost of the
//! middle frames.

use super::FourFrames;
use super::blocks::BlockArea;
use super::costs::{CostPoints, PointGrid};
use super::motions::AffineMotion;
use crate::interpolation::warp::difference;
use crate::raster::Image;
use std::cell::OnceCell;

/// Largest excess with which an outer frame (before or after the pair) has its full weight, for pixel values of 0 to 1.
/// The excess is the frame's mean difference from the composite of the pair, minus the mean difference between the
/// frames of the pair.
const OUTER_SLACK: f32 = 0.01;
/// Excess beyond [`OUTER_SLACK`] at which the weight of an outer frame (before or after the pair) falls to 1/e of its
/// full weight, for pixel values of 0 to 1. The excess is the frame's mean difference from the composite of the pair,
/// minus the mean difference between the frames of the pair.
const OUTER_SOFTNESS: f32 = 0.01;
/// Maximum excess of an outer frame (before or after the pair), averaged over a static block, as a fraction of
/// [`OUTER_SLACK`]. The excess is the frame's mean difference from the composite of the pair, minus the mean difference
/// between the frames of the pair.
const STATIC_EXCESS_FRACTION: f32 = 0.25;
/// Relative weight that is too small to be used. An outer frame is left out of the mean at pixels at which its weight
/// is at most this value (the weights of a mean sum to 1). A hypothesis is left out of a block if, at every pixel, its
/// weight is at most this fraction of the largest weight of any hypothesis.
pub const NEGLIGIBLE_WEIGHT: f32 = 1e-3;

impl FourFrames<'_> {
    /// Returns the weight that the frame before the pair and the frame after the pair each have at a vertical position
    /// in pixels, if all four frames agree. The weight is 0 at a frame's time, so that the frame stays as filmed, and
    /// 1/4 halfway between the two frames of the pair.
    pub fn outer_weight(&self, y_px: f64) -> f32 {
        let fraction = self.fractions.at(y_px) as f32;
        0.25 * (4.0 * fraction * (1.0 - fraction))
    }
}

/// A block of the four frames around an instant, compensated by one motion. The frames are sampled immediately at the
/// cost points, which are a coarse grid. They are sampled at the block's pixels when these samples are first needed.
pub struct CompensatedFrames<'a> {
    /// Affine motion, relative to the block's centre.
    pub motion: AffineMotion,
    frames: [Option<&'a Image>; 4],
    pixels: PointGrid,
    at_points: [Option<Image>; 4],
    at_pixels: [OnceCell<Image>; 4],
}

impl<'a> CompensatedFrames<'a> {
    /// Compensates a block of four frames by one motion. `pixels` is the grid of the block's pixels. `points` is
    /// the grid of cost points, at which the frames that are not `None` are sampled immediately.
    pub fn new(
        motion: AffineMotion,
        frames: [Option<&'a Image>; 4],
        pixels: PointGrid,
        points: PointGrid,
    ) -> Self {
        let at_points = std::array::from_fn(|n| Some(points.sample(frames[n]?, &motion, n)));
        Self { motion, frames, pixels, at_points, at_pixels: Default::default() }
    }

    /// Returns a frame (0 before, 1 earlier, 2 later, 3 after), sampled at the cost points. Returns `None` if the
    /// frame was not given.
    pub fn at_points(&self, frame: usize) -> Option<&Image> {
        self.at_points[frame].as_ref()
    }

    /// Returns a frame (0 before, 1 earlier, 2 later, 3 after), sampled at the block's pixels. Returns `None` if
    /// the frame was not given.
    pub fn at_pixels(&self, frame: usize) -> Option<&Image> {
        let image = self.frames[frame]?;
        let sample = || self.pixels.sample(image, &self.motion, frame);
        Some(self.at_pixels[frame].get_or_init(sample))
    }
}

/// A block's composite of the two middle frames (the frames of the pair), at the block's pixels and at the cost points.
pub struct MiddleFrames<'a> {
    pub at_pixels: Image,
    pub at_points: Image,
    /// Mean difference of the two middle frames over the window around each of the block's pixels.
    pub costs: &'a [f32],
}

/// Averages the outer frames (before and after the pair) into a block's composite of the middle frames (the pair). Each
/// outer frame has a weight of at most `outer_weight`. At each pixel, an outer frame is compensated by the one motion
/// in `compensated` with which it differs least from the composite.
pub fn fuse(
    MiddleFrames { at_pixels: middle, at_points, costs }: MiddleFrames,
    compensated: &[CompensatedFrames],
    points: &CostPoints,
    outer_weight: f32,
) -> Image {
    if outer_weight <= 0.0 {
        return middle;
    }
    let mut fused = middle.clone();
    let channels = fused.channels();
    for frame in [0, 3] {
        // For each pixel: the index of the motion with the smallest cost, and this cost.
        let mut best = vec![(0, f32::INFINITY); costs.len()];
        for (index, frames) in compensated.iter().enumerate() {
            let Some(outer) = frames.at_points(frame) else { continue };
            let means = points.window_means(&difference(outer, &at_points));
            for (best, cost) in best.iter_mut().zip(points.at_pixels(&means)) {
                if cost < best.1 {
                    *best = (index, cost);
                }
            }
        }
        let weight = |((_, cost), own): (&(usize, f32), &f32)| {
            let excess = (cost - own - OUTER_SLACK).max(0.0);
            outer_weight * (-excess / OUTER_SOFTNESS).exp()
        };
        let weights: Vec<f32> = best.iter().zip(costs).map(weight).collect();
        for (index, frames) in compensated.iter().enumerate() {
            let takes = |k: usize| best[k].0 == index && weights[k] > NEGLIGIBLE_WEIGHT;
            if !(0..costs.len()).any(takes) {
                continue;
            }
            let Some(outer) = frames.at_pixels(frame) else { continue };
            let pixels = fused.data_mut().chunks_exact_mut(channels).enumerate();
            for (k, out) in pixels.filter(|(k, _)| takes(*k)) {
                let span = k * channels..(k + 1) * channels;
                let colors = outer.data()[span.clone()].iter().zip(&middle.data()[span]);
                for (out, (outer, middle)) in out.iter_mut().zip(colors) {
                    *out += weights[k] * (outer - middle);
                }
            }
        }
    }
    fused
}

/// Returns whether nothing moves in a block. The outer frames (before and after the pair) are compared without motion
/// compensation. Their excess is their cost minus the cost of the middle frames (the pair). In a static block, the
/// excess of each outer frame is at most [`OUTER_SLACK`] at every pixel. Its mean over the block is at most
/// [`STATIC_EXCESS_FRACTION`] times [`OUTER_SLACK`]; for this mean, a negative excess counts as 0.
///
/// `outer_costs` are the costs of the outer frames, and `costs` is the cost of the middle frames. Each has one value
/// for every pixel of the image. An outer frame whose costs are `None` is not checked.
pub fn is_static(outer_costs: &[Option<Vec<f32>>; 2], costs: &[f32], area: BlockArea) -> bool {
    outer_costs.iter().flatten().all(|outer| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (outer, own) in area.rows_of(outer).zip(area.rows_of(costs)) {
            for (outer, own) in outer.iter().zip(own) {
                let excess = outer - own;
                if excess > OUTER_SLACK {
                    return false;
                }
                (sum, count) = (sum + excess.max(0.0), count + 1.0);
            }
        }
        sum <= STATIC_EXCESS_FRACTION * OUTER_SLACK * count
    })
}

/// Returns the colours of a static block: a weighted mean of `cross_faded`, which is the cross-fade of the pair's
/// warped frames, and of the frames before and after the pair without motion compensation. The colours are 0 outside
/// the image.
pub fn static_mean(frames: &FourFrames, cross_faded: &Image, area: BlockArea) -> Vec<f32> {
    let weight = frames.outer_weight(area.center().y);
    let crop = |image: &Image| area.crop(image.data(), image.channels());
    let middle = crop(cross_faded);
    let mut colors = middle.clone();
    for outer in [frames.before, frames.after].into_iter().flatten().map(crop) {
        for ((out, outer), middle) in colors.iter_mut().zip(outer).zip(&middle) {
            *out += weight * (outer - middle);
        }
    }
    colors
}
