//! Compositing of four frames. Where the two outer frames agree with the composite of the two middle frames, they
//! are averaged in, which halves the noise variance.

use super::FourFrames;
use super::blocks::BlockArea;
use super::costs::{CostPoints, PointGrid};
use super::motions::AffineMotion;
use crate::interpolation::warp::difference;
use crate::raster::Image;
use std::cell::OnceCell;

/// Excess of an outer frame's cost over the cost of the middle frames up to which the outer frame has full weight,
/// for pixel values of 0 to 1.
const OUTER_SLACK: f32 = 0.01;
/// Increase of the excess beyond [`OUTER_SLACK`] by which an outer frame's weight falls to 1/e.
const OUTER_SOFTNESS: f32 = 0.01;
/// Maximum mean excess of an outer frame's cost in a static block, as a fraction of [`OUTER_SLACK`].
const STATIC_EXCESS_FRACTION: f32 = 0.25;
/// Fraction of the largest weight below which a weight is neglected.
pub const NEGLIGIBLE_WEIGHT: f32 = 1e-3;

impl FourFrames<'_> {
    /// Returns the weight of each outer frame at a vertical position in pixels, if all four frames agree. The
    /// weight is 0 at a frame's time, so that the frame stays as filmed, and 1/4 halfway between the two middle
    /// frames.
    pub fn outer_weight(&self, y_px: f64) -> f32 {
        let fraction = self.fractions.at(y_px) as f32;
        0.25 * (4.0 * fraction * (1.0 - fraction))
    }
}

/// A block of the four frames, compensated by one motion. The frames are sampled at the cost points. They are also
/// sampled at the block's pixels when these samples are first needed.
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

/// A block's composite of the two middle frames, at the block's pixels and at the cost points.
pub struct MiddleFrames<'a> {
    pub at_pixels: Image,
    pub at_points: Image,
    /// Mean difference of the two middle frames over the window around each of the block's pixels.
    pub costs: &'a [f32],
}

/// Averages the outer frames into the composite of the middle frames. Each outer frame has a weight of at most
/// `outer_weight`. At each pixel, an outer frame is compensated by the motion for which it differs least from the
/// composite.
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

/// Returns whether nothing moves in a block. At each pixel, the costs of the outer frames must exceed the cost of
/// the middle frames by at most [`OUTER_SLACK`]. On average over the block, they must exceed it by at most
/// [`STATIC_EXCESS_FRACTION`] times this value. `outer_costs` and `costs` have one value for each pixel of the
/// image.
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

/// Returns the colours of a static block: `cross_faded`, which is the cross-fade of the middle frames, averaged
/// with the outer frames without motion compensation. The colours are 0 outside the image.
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
