//! The pixels around a pixel that probably belong to its surface.

use super::frame::{MatchingImage, MatchingSample, WEIGHTS};
use crate::simd::LANES;

/// Colour difference from the patch's centre at which a pixel's weight falls to 1/e.
const PATCH_COLOR: f32 = 0.08;
/// Half-width of a patch at the finest level, and the step between its pixels; both in pixels.
const PATCH_FINEST: (i32, i32) = (4, 2);
/// Half-width of a patch at all other levels, and the step between its pixels; both in pixels of the level.
const PATCH_COARSE: (i32, i32) = (2, 1);
/// Minimum weight of a pixel in a patch. Pixels below it are left out: they are on another surface, or far
/// away.
const MIN_WEIGHT: f32 = 0.05;
/// Maximum number of pixels in a patch.
const PATCH_PIXELS: usize = 25;
/// Length of a patch's arrays: [`PATCH_PIXELS`] rounded up to whole SIMD vectors.
const PADDED_PIXELS: usize = PATCH_PIXELS.next_multiple_of(LANES);

/// The pixels around a pixel, weighted by how likely they belong to its surface. Entries from `count` on have
/// weight 0.
pub struct Patch {
    pub offset_x: [f32; PADDED_PIXELS],
    pub offset_y: [f32; PADDED_PIXELS],
    pub samples: [MatchingSample; PADDED_PIXELS],
    /// Each pixel's weight, repeated for every channel.
    pub weights: [MatchingSample; PADDED_PIXELS],
    /// Each pixel's weight.
    pub weight: [f32; PADDED_PIXELS],
    pub count: usize,
    /// The reciprocal of the sum of all weights.
    pub normalization: f32,
}

impl Patch {
    pub fn empty() -> Self {
        Self {
            offset_x: [0.0; PADDED_PIXELS],
            offset_y: [0.0; PADDED_PIXELS],
            samples: [[0.0; 4]; PADDED_PIXELS],
            weights: [[0.0; 4]; PADDED_PIXELS],
            weight: [0.0; PADDED_PIXELS],
            count: 0,
            normalization: 0.0,
        }
    }

    /// The sum of all weights.
    pub fn weight(&self) -> f32 {
        1.0 / self.normalization
    }

    /// The weighted sums over the patch of the products of its gradients of brightness: `[xx, xy, yy]`.
    pub fn structure(&self) -> [f32; 3] {
        let mut sums = [0.0; 3];
        for (sample, weight) in self.samples[..self.count].iter().zip(&self.weight) {
            let [gx, gy] = [sample[2] / WEIGHTS[2], sample[3] / WEIGHTS[3]];
            sums[0] += weight * gx * gx;
            sums[1] += weight * gx * gy;
            sums[2] += weight * gy * gy;
        }
        sums
    }

    /// Fills the patch with the pixels around `(x, y)` of an image of the pyramid.
    #[inline]
    pub fn fill(&mut self, image: &MatchingImage, (x, y): (usize, usize), is_finest: bool) {
        let (radius, step) = if is_finest { PATCH_FINEST } else { PATCH_COARSE };
        let (width, height) = (image.width as i32, image.height as i32);
        let center = image.pixel(x, y);
        let (mut count, mut sum) = (0, 0.0);
        for dy in (-radius..=radius).step_by(step as usize) {
            for dx in (-radius..=radius).step_by(step as usize) {
                let (u, v) = (x as i32 + dx, y as i32 + dy);
                if u < 0 || v < 0 || u >= width || v >= height {
                    continue;
                }
                let sample = image.pixel(u as usize, v as usize);
                let distance = (dx * dx + dy * dy) as f32 / (radius * radius) as f32;
                let difference = color_difference(&sample, &center) / PATCH_COLOR;
                let weight = (-difference - 0.5 * distance).exp();
                if weight < MIN_WEIGHT {
                    continue;
                }
                self.weight[count] = weight;
                (self.offset_x[count], self.offset_y[count]) = (dx as f32, dy as f32);
                (self.samples[count], self.weights[count]) = (sample, [weight; 4]);
                count += 1;
                sum += weight;
            }
        }
        self.weights[count..].fill([0.0; 4]);
        self.weight[count..].fill(0.0);
        self.count = count;
        // The sum is at least 1, the weight of the centre.
        self.normalization = 1.0 / sum;
    }
}

/// Sum of the absolute differences in brightness and in red minus blue.
#[inline(always)]
pub fn color_difference(a: &MatchingSample, b: &MatchingSample) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).abs()
}
