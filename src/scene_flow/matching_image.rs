//! Images for matching: pyramids of brightness, colour and gradients.

use super::noise;
use super::silhouette::{Shown, halved as halved_silhouettes};
use crate::raster::Image;
use crate::simd::Pixel;
use std::sync::LazyLock;

/// Weights of the four channels of a [`MatchingSample`]: brightness, red minus blue, and the two gradients of
/// brightness. Gradients locate outlines, and tolerate remaining differences in exposure.
pub const WEIGHTS: [f32; 4] = [1.0, 0.5, 1.5, 1.5];
/// Weights of red, green and blue in brightness.
const LUMA: [f32; 3] = [0.3, 0.59, 0.11];

/// Matching cost that noise alone causes, per standard deviation of the noise of brightness. It is computed for noise of
/// red, green and blue that is independent and normally distributed. Larger: wrong elements of noisy pixels count as
/// good. Smaller: noisy pixels are estimated anew in every pass.
const COST_BY_NOISE: f32 = 4.0;

/// Features of a pixel that matching compares: brightness, red minus blue, and the horizontal and vertical gradient
/// of brightness. Each is multiplied by its weight ([`WEIGHTS`]) and by [`UNITS`].
pub type MatchingSample = Pixel;

/// Value of a sample for white, before its weight. Samples are rounded to a thirtieth of a level of 8 bits.
pub const UNITS: f32 = 8192.0;
/// Largest magnitude of a sample, so that the difference of two fits in 16 bits: twice as bright as white.
const MAX_SAMPLE: f32 = 16383.0;
/// Colour difference of two pixels at which their similarity falls to 1/e.
const SIMILAR_COLOR: f32 = 0.08;
/// Number of entries of [`SIMILARITY`]. The last is 0.002, and stands for all larger differences.
const DIFFERENCES: usize = 4096;

/// Similarity of two pixels by the difference of their colours in units of 1/[`UNITS`].
static SIMILARITY: LazyLock<[f32; DIFFERENCES]> =
    LazyLock::new(|| std::array::from_fn(|d| (-(d as f32) / (SIMILAR_COLOR * UNITS)).exp()));

/// One level of an image pyramid for matching: a sample for each pixel, row by row.
pub struct MatchingImage {
    pub width: usize,
    pub height: usize,
    samples: Vec<MatchingSample>,
    /// For each pixel, whether it shows only static background. Empty if this is unknown.
    still: Vec<bool>,
    /// What each pixel shows, in a frame that has no such mask. Empty if this is unknown.
    silhouettes: Vec<Shown>,
    /// For each pixel, whether a part of it lies inside the camera's original image. Empty if all pixels do.
    filmed: Vec<bool>,
    /// Standard deviation of the noise of brightness.
    noise: f32,
}

impl MatchingImage {
    /// Returns the pyramid of an image, finest level first. Each level has half the width and height of the next
    /// finer level. `still` tells for each pixel whether it shows only static background; `None` if this is unknown.
    /// `filmed` tells for each pixel whether it lies inside the camera's original image; `None` if all do.
    pub fn pyramid(
        image: &Image,
        levels: usize,
        still: Option<&[bool]>,
        filmed: Option<&[bool]>,
    ) -> Vec<Self> {
        let (mut width, mut height) = (image.width(), image.height());
        let rgb = image.to_rgb();
        let mut pixels: Vec<[f32; 3]> =
            rgb.data().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let mut pyramid = vec![Self::new(width, height, &pixels)];
        for _ in 1..levels {
            pixels = halved(width, height, &pixels);
            (width, height) = (width / 2, height / 2);
            pyramid.push(Self::new(width, height, &pixels));
        }
        pyramid[0].still = still.unwrap_or_default().to_vec();
        pyramid[0].filmed = filmed.unwrap_or_default().to_vec();
        pyramid[0].noise = pyramid[0].measured_noise();
        for level in 1..pyramid.len() {
            let finer = &pyramid[level - 1];
            let still = halved_mask(&finer.still, finer.width, |four| four.iter().all(|v| *v));
            let filmed = halved_mask(&finer.filmed, finer.width, |four| four.iter().any(|v| *v));
            (pyramid[level].still, pyramid[level].filmed) = (still, filmed);
            // The mean of four pixels has half their noise.
            pyramid[level].noise = 0.5 * pyramid[level - 1].noise;
        }
        pyramid
    }

    fn new(width: usize, height: usize, pixels: &[[f32; 3]]) -> Self {
        let brightness: Vec<f32> = pixels.iter().map(brightness).collect();
        let mut samples = Vec::with_capacity(width * height);
        for y in 0..height {
            let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
            for x in 0..width {
                let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
                let at = |x: usize, y: usize| brightness[y * width + x];
                let color = pixels[y * width + x];
                samples.push(quantized([
                    WEIGHTS[0] * at(x, y),
                    WEIGHTS[1] * (color[0] - color[2]),
                    WEIGHTS[2] * 0.5 * (at(right, y) - at(left, y)),
                    WEIGHTS[3] * 0.5 * (at(x, below) - at(x, above)),
                ]));
            }
        }
        let [still, filmed] = [Vec::new(), Vec::new()];
        Self { width, height, samples, still, silhouettes: Vec::new(), filmed, noise: 0.0 }
    }

    /// Adds silhouettes to a pyramid. `finest` tells what each pixel of the image shows.
    pub fn add_silhouettes(pyramid: &mut [Self], finest: Vec<Shown>) {
        let mut silhouettes = finest;
        for level in pyramid {
            let coarser = halved_silhouettes(&silhouettes, level.width);
            level.silhouettes = std::mem::replace(&mut silhouettes, coarser);
        }
    }

    /// Returns what a pixel shows: by the mask of static background if the frame has one, otherwise by its silhouettes.
    #[inline(always)]
    pub fn shown(&self, x: usize, y: usize) -> Shown {
        match self.is_still(x, y) {
            Some(true) => Shown::Background,
            Some(false) => Shown::Body,
            None => self.silhouettes.get(y * self.width + x).copied().unwrap_or(Shown::Unknown),
        }
    }

    /// Returns whether a pixel shows only static background. `None` if this is unknown for the whole image.
    #[inline(always)]
    pub fn is_still(&self, x: usize, y: usize) -> Option<bool> {
        self.still.get(y * self.width + x).copied()
    }

    /// Returns whether the camera filmed what lies at a position, pixels; (0, 0) is the centre of the first pixel.
    #[inline(always)]
    pub fn films(&self, [x, y]: [f32; 2]) -> bool {
        let [max_x, max_y] = self.limit();
        let is_inside = x > 0.0 && y > 0.0 && x < max_x && y < max_y;
        let index = || (y + 0.5) as usize * self.width + (x + 0.5) as usize;
        is_inside && (self.filmed.is_empty() || self.filmed[index()])
    }

    /// Returns whether the camera filmed a part of a pixel.
    #[inline(always)]
    pub fn films_pixel(&self, x: usize, y: usize) -> bool {
        self.filmed.is_empty() || self.filmed[y * self.width + x]
    }

    fn measured_noise(&self) -> f32 {
        let brightness: Vec<f32> =
            self.samples.iter().map(|s| dequantized(s)[0] / WEIGHTS[0]).collect();
        noise::standard_deviation(self.width, &brightness, &self.filmed)
    }

    /// Returns the mean matching cost that noise alone causes.
    pub fn noise_cost(&self) -> f32 {
        COST_BY_NOISE * self.noise
    }

    /// Returns the size of the level in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.samples.as_slice())
            + self.still.len()
            + self.silhouettes.len()
            + self.filmed.len()
    }

    #[inline(always)]
    pub fn pixel(&self, x: usize, y: usize) -> MatchingSample {
        self.samples[y * self.width + x]
    }

    /// Returns the largest position `[x, y]` at which a bilinear sample can be read, pixels; (0, 0) is the centre of
    /// the first pixel.
    #[inline(always)]
    pub fn limit(&self) -> [f32; 2] {
        // Slightly less than the centre of the last pixel, so that rounding never reaches beyond the image.
        [self.width, self.height].map(|size| (size as f32 - 1.001).max(0.0))
    }

    /// Returns the index of the last pixel that is at the top left of 2×2 pixels.
    ///
    /// # Panics
    /// If the image has no such pixel. An image that films a position ([`Self::films`]) has one.
    #[inline(always)]
    pub fn last_corner(&self) -> u32 {
        let last = self.samples.len().checked_sub(self.width + 2);
        u32::try_from(last.expect("a filmed position has four pixels around it"))
            .unwrap_or(u32::MAX)
    }

    /// Returns the samples of a row of pixels; `None` if the image has no such row.
    #[inline(always)]
    pub fn row(&self, y: usize) -> Option<&[MatchingSample]> {
        if y < self.height { self.samples.get(y * self.width..(y + 1) * self.width) } else { None }
    }

    /// Returns the samples of all pixels, row by row.
    #[inline(always)]
    pub fn samples(&self) -> &[MatchingSample] {
        &self.samples
    }
}

/// Returns a sample in units of 1/[`UNITS`]. Values of more than twice white are clamped.
pub fn quantized(sample: [f32; 4]) -> MatchingSample {
    sample.map(|v| (v * UNITS).round().clamp(-MAX_SAMPLE, MAX_SAMPLE) as i16)
}

/// Returns a sample whose white is 1.
#[inline(always)]
pub fn dequantized(sample: &MatchingSample) -> [f32; 4] {
    sample.map(|v| f32::from(v) * (1.0 / UNITS))
}

/// Returns the sum of the absolute differences of two samples in brightness and in red minus blue, in units of
/// 1/[`UNITS`].
#[inline(always)]
pub fn difference(a: &MatchingSample, b: &MatchingSample) -> u32 {
    [0, 1].map(|c| i32::from(a[c]).abs_diff(i32::from(b[c]))).iter().sum()
}

/// Returns the sum of the absolute differences of two samples in brightness and in red minus blue.
#[inline(always)]
pub fn color_difference(a: &MatchingSample, b: &MatchingSample) -> f32 {
    difference(a, b) as f32 * (1.0 / UNITS)
}

/// Returns how similar the colours of two pixels are: 1 if they are the same, falling exponentially with their difference.
#[inline(always)]
pub fn similarity(a: &MatchingSample, b: &MatchingSample) -> f32 {
    similarity_by(&SIMILARITY, a, b)
}

/// Returns the table of similarities, so that a loop over many pixels fetches it once.
#[inline(always)]
pub fn similarities() -> &'static [f32; DIFFERENCES] {
    &SIMILARITY
}

/// Returns the [`similarity`] of two pixels, which it reads from the table [`similarities`].
#[inline(always)]
pub fn similarity_by(table: &[f32; DIFFERENCES], a: &MatchingSample, b: &MatchingSample) -> f32 {
    table[(difference(a, b) as usize).min(DIFFERENCES - 1)]
}

fn brightness(color: &[f32; 3]) -> f32 {
    LUMA.iter().zip(color).map(|(weight, value)| weight * value).sum()
}

/// Returns an image at half its size: the mean of each block of 2×2 pixels. An odd last row or column is dropped.
fn halved(width: usize, height: usize, pixels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (columns, rows) = (width / 2, height / 2);
    let mean = |k: usize| {
        let (x, y) = (2 * (k % columns), 2 * (k / columns));
        let at = |dx: usize, dy: usize| pixels[(y + dy) * width + x + dx];
        let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        [0, 1, 2].map(|c| 0.25 * four.iter().map(|p| p[c]).sum::<f32>())
    };
    (0..columns * rows).map(mean).collect()
}

/// Returns `of` the four pixels of each block of 2×2 pixels of a mask of this width. An odd last row or column is dropped.
fn halved_mask(mask: &[bool], width: usize, of: fn([bool; 4]) -> bool) -> Vec<bool> {
    let (columns, rows) = (width / 2, mask.len() / width / 2);
    let block = |k: usize| {
        let at = 2 * (k / columns) * width + 2 * (k % columns);
        of([at, at + 1, at + width, at + width + 1].map(|k| mask[k]))
    };
    (0..columns * rows).map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that is darker than the reference has values above white once its exposure is corrected.
    #[test]
    fn samples_up_to_twice_white_are_kept_and_brighter_ones_clamped() {
        let [bright, brighter] = [1.3, 1.5].map(|b| quantized([b, 0.1, -0.2, 0.3]));
        for (found, expected) in dequantized(&bright).into_iter().zip([1.3, 0.1, -0.2, 0.3]) {
            assert!((found - expected).abs() <= 0.5 / UNITS);
        }
        assert!((color_difference(&bright, &brighter) - 0.2).abs() < 2.0 / UNITS);
        let expected = (-0.2f32 / SIMILAR_COLOR).exp();
        assert!((similarity(&bright, &brighter) - expected).abs() < 1e-3);
        assert_eq!(quantized([9.0, -9.0, 2.1, 0.0]), [16383, -16383, 16383, 0]);
        assert!(similarity(&[0; 4], &quantized([9.0; 4])) < 0.003);
    }
}
