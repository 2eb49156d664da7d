//! Patches. A patch is the neighbourhood of a pixel, reduced to the pixels that probably belong to the same surface.

use super::matching_image::{
    MatchingImage, MatchingSample, WEIGHTS, dequantized, similarities, similarity_by,
};
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
        let table = similarities();
        let center = image.pixel(x, y);
        let (mut count, mut sum) = (0, 0.0);
        for (dy, by_row) in (-REACH..=REACH).map(|n| n * step).zip(FALLOFF) {
            // A negative row or column becomes a large one, which no image has.
            let v = (y as i32 + dy) as usize;
            let Some(row) = image.row(v) else { continue };
            for (dx, by_column) in (-REACH..=REACH).map(|n| n * step).zip(FALLOFF) {
                let u = (x as i32 + dx) as usize;
                let Some(&sample) = row.get(u) else { continue };
                // What was not filmed has no say, but the centre's weight is always 1.
                if (dx, dy) != (0, 0) && !image.films_pixel(u, v) {
                    continue;
                }
                let weight = similarity_by(table, &sample, &center) * by_row * by_column;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;

    #[test]
    fn a_patch_ends_at_the_borders_and_where_nothing_was_filmed() {
        let (width, height) = (12, 8);
        let image = Image::filled(width, height, 3, 0.5);
        let offsets = |at: (usize, usize), filmed: Option<&[bool]>| {
            let pyramid = MatchingImage::pyramid(&image, 1, None, filmed);
            let mut patch = Patch::empty();
            patch.fill(&pyramid[0], at, true);
            let place = |k: usize| (patch.offset_x[k] as i32, patch.offset_y[k] as i32);
            (0..patch.count).map(place).collect::<Vec<_>>()
        };
        let first = offsets((0, 0), None);
        assert_eq!(first, [(0, 0), (2, 0), (4, 0), (0, 2), (2, 2), (4, 2), (0, 4), (2, 4), (4, 4)]);
        let last = offsets((width - 1, height - 1), None);
        assert!(last.len() == 9 && last.iter().all(|&(dx, dy)| dx <= 0 && dy <= 0));
        let right: Vec<bool> = (0..width * height).map(|k| k % width > 5).collect();
        let beside = offsets((5, 4), Some(&right));
        assert!(
            beside.contains(&(0, 0)) && beside.iter().all(|&(dx, dy)| dx > 0 || (dx, dy) == (0, 0))
        );
    }
}
