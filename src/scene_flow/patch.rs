//! Patches. A patch is the neighbourhood of a pixel, reduced to the pixels that probably belong to the same surface.

use super::matching_image::{MatchingImage, MatchingSample, WEIGHTS, dequantized, similarity};
use crate::simd::{LANES, Pixel};

/// Step between the pixels of a patch, pixels: at the finest pyramid level, and at all others.
const STEP_PX: [i32; 2] = [2, 1];
/// Half-width of a patch, in steps.
const REACH: i32 = 2;
/// Weight of a pixel by its column, or row, in the patch: `exp(-½(n/2)²)` for n steps from the centre.
const FALLOFF: [f32; 2 * REACH as usize + 1] =
    [0.606_530_7, 0.882_496_9, 1.0, 0.882_496_9, 0.606_530_7];
/// Weight of 1 in [`Patch::weights`].
pub const WEIGHT_UNITS: f32 = 16384.0;
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
    /// Weight of each pixel of the patch in units of 1/[`WEIGHT_UNITS`], repeated for every channel of its sample.
    pub weights: [Pixel; PADDED_PIXELS],
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
            samples: [[0; 4]; PADDED_PIXELS],
            weights: [[0; 4]; PADDED_PIXELS],
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
    /// gradients. A pixel counts if `used` returns true for its offset from the centre, pixels.
    pub fn structure(&self, used: impl Fn(f32, f32) -> bool) -> [f32; 3] {
        let mut sums = [0.0; 3];
        for (k, (sample, weight)) in self.samples[..self.count].iter().zip(&self.weight).enumerate()
        {
            if !used(self.offset_x[k], self.offset_y[k]) {
                continue;
            }
            let sample = dequantized(sample);
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
        let step = STEP_PX[usize::from(!is_finest)];
        let (width, height) = (image.width as i32, image.height as i32);
        let center = image.pixel(x, y);
        let (mut count, mut sum) = (0, 0.0);
        for (dy, by_row) in (-REACH..=REACH).map(|n| n * step).zip(FALLOFF) {
            for (dx, by_column) in (-REACH..=REACH).map(|n| n * step).zip(FALLOFF) {
                let (u, v) = (x as i32 + dx, y as i32 + dy);
                if u < 0 || v < 0 || u >= width || v >= height {
                    continue;
                }
                // What was not filmed has no say, but the centre's weight is always 1.
                if (dx, dy) != (0, 0) && !image.films_pixel(u as usize, v as usize) {
                    continue;
                }
                let sample = image.pixel(u as usize, v as usize);
                let weight = similarity(&sample, &center) * by_row * by_column;
                self.weight[count] = weight;
                (self.offset_x[count], self.offset_y[count]) = (dx as f32, dy as f32);
                // Adding a half rounds to the nearest, since weights are positive.
                (self.samples[count], self.weights[count]) =
                    (sample, [(weight * WEIGHT_UNITS + 0.5) as i16; 4]);
                // A light pixel is overwritten by the next one. This is faster than a branch, which can't be predicted.
                let is_kept = weight >= MIN_WEIGHT;
                count += usize::from(is_kept);
                sum += if is_kept { weight } else { 0.0 };
            }
        }
        self.weights[count..].fill([0; 4]);
        self.weight[count..].fill(0.0);
        self.count = count;
        // The sum is at least 1, the weight of the centre.
        self.normalization = 1.0 / sum;
    }
}
