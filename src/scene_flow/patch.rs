//! Patches. A patch is the neighbourhood of a pixel, reduced to the pixels that probably belong to the same surface.

use super::frame::{MatchingImage, MatchingSample, WEIGHTS};
use crate::simd::LANES;

/// Colour difference between a pixel and the centre of its patch at which the colour term of the pixel's weight falls
/// to 1/e.
const PATCH_COLOR: f32 = 0.08;
/// Half-width of a patch at the finest pyramid level, and the step between its pixels; both in pixels.
const PATCH_FINEST: (i32, i32) = (4, 2);
/// Half-width of a patch at all pyramid levels except the finest, and the step between the patch's pixels. Both are in
/// pixels of the level.
const PATCH_COARSE: (i32, i32) = (2, 1);
/// Minimum weight of a pixel in a patch. A pixel with a smaller weight probably shows another surface, or is far from
/// the centre, and is left out.
const MIN_WEIGHT: f32 = 0.05;
/// Maximum number of pixels in a patch.
const PATCH_PIXELS: usize = 25;
/// Length of a patch's arrays: [`PATCH_PIXELS`] rounded up to whole SIMD vectors.
const PADDED_PIXELS: usize = PATCH_PIXELS.next_multiple_of(LANES);

/// Pixels around a centre pixel, weighted by how likely they belong to the same surface. Entries from `count` on have
/// weight 0.
pub struct Patch {
    pub offset_x: [f32; PADDED_PIXELS],
    pub offset_y: [f32; PADDED_PIXELS],
    pub samples: [MatchingSample; PADDED_PIXELS],
    /// Weight of each pixel of the patch, repeated for every channel of its sample.
    pub weights: [MatchingSample; PADDED_PIXELS],
    /// Weight of each pixel of the patch.
    pub weight: [f32; PADDED_PIXELS],
    pub count: usize,
    /// Reciprocal of the sum of the weights of all pixels of the patch.
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

    /// Returns the sum of the weights of all pixels of the patch.
    pub fn weight(&self) -> f32 {
        1.0 / self.normalization
    }

    /// Returns the structure tensor of the patch, `[xx, xy, yy]`: the weighted sums of the products of the brightness
    /// gradients.
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

    /// Fills the patch with the pixels around pixel `(x, y)` of a pyramid level. `is_finest` tells whether this is the
    /// finest level, where patches are larger.
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
                // What was not filmed has no say, but the centre's weight is always 1.
                if (dx, dy) != (0, 0) && !image.films_pixel(u as usize, v as usize) {
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

/// Returns the sum of the absolute differences of two samples in brightness and in red minus blue.
#[inline(always)]
pub fn color_difference(a: &MatchingSample, b: &MatchingSample) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).abs()
}
