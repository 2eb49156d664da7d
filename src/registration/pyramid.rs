//! §4.1: grey image pyramids. A pyramid stores only grey values. Gradients are recomputed from windows in the
//! processor's cache, which is faster than reading stored gradients.

use super::gradient::{SCHARR_SCALE, scharr};
use crate::raster::Image;
use crate::simd::{F32x8, LANES, Scalar};
use std::iter::repeat_n;

/// A grey image pyramid (§4.1). The first level has full size. Each further level has half the width and height of
/// the level before.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// The levels, full-sized level first. There is at least one level.
    pub levels: Vec<PyramidLevel>,
}

/// One level of a [`Pyramid`]: luma in 0..=1, padded on every side by copies of the nearest border pixel.
#[derive(Clone, Debug)]
pub struct PyramidLevel {
    /// Width without the padding, pixels.
    pub width: usize,
    /// Height without the padding, pixels.
    pub height: usize,
    /// Width of the padding on every side, pixels.
    pub(super) pad: usize,
    /// Width of a row including the padding, samples.
    pub(super) stride: usize,
    /// The padded plane, row-major.
    pub(super) value: Vec<f32>,
}

/// Minimum length of a level's shorter side, pixels.
const MIN_LEVEL_PX: usize = 16;

impl Pyramid {
    /// Builds the pyramid of an image's luma. The pyramid has at most `levels` levels. Levels whose shorter side
    /// would be less than 16 pixels are left out, except for the first level. `pad` is the width of the padding
    /// that the largest window needs, in pixels ([`super::RegistrationOptions::pad_px`]).
    pub fn new(image: &Image, levels: usize, pad: usize) -> Self {
        let size = [image.width(), image.height()];
        let full = PyramidLevel::new(size, image.to_gray().data(), pad);
        let all = std::iter::successors(Some(full), |level| Some(level.halved()));
        Self { levels: all.take(Self::sizes(size, levels).len()).collect() }
    }

    /// Returns the width and height, in pixels, of every level of the pyramid of an image of size `full`.
    pub(super) fn sizes(full: [usize; 2], levels: usize) -> Vec<[usize; 2]> {
        let halved = |size: &[usize; 2]| {
            (size[0].min(size[1]) >= 2 * MIN_LEVEL_PX).then(|| size.map(|v| v.div_ceil(2)))
        };
        std::iter::successors(Some(full), halved).take(levels.max(1)).collect()
    }

    /// Returns the width of the full-sized level, in pixels.
    pub fn width(&self) -> usize {
        self.levels[0].width
    }

    /// Returns the height of the full-sized level, in pixels.
    pub fn height(&self) -> usize {
        self.levels[0].height
    }
}

impl PyramidLevel {
    /// Creates a level from its values, which are given row by row. `pad` is the width of the padding, in pixels. A
    /// value below [`LANES`] is raised to [`LANES`], since gradients at the border are read in vectors of this
    /// length.
    fn new([width, height]: [usize; 2], values: &[f32], pad: usize) -> Self {
        let mut value = Vec::with_capacity(Self::samples([width, height], pad));
        let pad = pad.max(LANES);
        for y in 0..height + 2 * pad {
            let row = &values[y.saturating_sub(pad).min(height - 1) * width..][..width];
            value.extend(repeat_n(row[0], pad));
            value.extend_from_slice(row);
            value.extend(repeat_n(row[width - 1], pad));
        }
        Self { width, height, pad, stride: width + 2 * pad, value }
    }

    /// Returns the number of samples of a level of this size, including the padding.
    pub(super) fn samples([width, height]: [usize; 2], pad: usize) -> usize {
        let pad = pad.max(LANES);
        (width + 2 * pad) * (height + 2 * pad)
    }

    /// Returns the next level: this level smoothed by [1 4 6 4 1]/16 in both directions, then subsampled by two.
    /// Pixel i of the next level has the same centre as pixel 2i of this level. Borders are mirrored, as in OpenCV.
    fn halved(&self) -> Self {
        let width = self.width;
        let half = [width.div_ceil(2), self.height.div_ceil(2)];
        let mut values = Vec::with_capacity(half[0] * half[1]);
        // A vertically smoothed row, with two additional columns on the left and up to three on the right.
        let mut smooth = vec![0.0; 2 * half[0] + 4];
        for y in 0..half[1] {
            let [a, b, c, d, e] =
                [-2, -1, 0, 1, 2].map(|k| self.row(mirrored(2 * y as isize + k, self.height)));
            for (x, out) in smooth[2..width + 2].iter_mut().enumerate() {
                *out = 6.0 * c[x] + 4.0 * (b[x] + d[x]) + (a[x] + e[x]);
            }
            for k in [-2, -1, width as isize, width as isize + 1] {
                smooth[(k + 2) as usize] = smooth[mirrored(k, width) + 2];
            }
            let (pairs, _) = smooth.as_chunks::<2>();
            let triples = pairs.iter().zip(&pairs[1..]).zip(&pairs[2..]);
            values.extend(
                triples
                    .map(|(([a, b], [c, d]), [e, _])| (6.0 * c + 4.0 * (b + d) + (a + e)) / 256.0),
            );
        }
        Self::new(half, &values, self.pad)
    }

    /// Returns the index of a pixel in the padded plane. The pixel may be up to `pad` pixels outside the image.
    pub(super) fn index(&self, x: isize, y: isize) -> usize {
        let at = |v: isize| (v + self.pad as isize) as usize;
        at(y) * self.stride + at(x)
    }

    /// Returns row `y`, without the padding.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.value[self.index(0, y as isize)..][..self.width]
    }

    /// Returns the gradient `(∂/∂x, ∂/∂y)` at a pixel of the image, in grey values (0 to 1) per pixel of this
    /// level, by Scharr's 3×3 kernels. Outside the image, the nearest border pixel is used.
    pub fn gradient(&self, x: usize, y: usize) -> (f32, f32) {
        let [dx, dy] =
            scharr::<Scalar>(&self.value, self.index(x as isize, y as isize), self.stride);
        (dx.to_array()[0] / SCHARR_SCALE, dy.to_array()[0] / SCHARR_SCALE)
    }
}

/// Returns the index in `0..size` to which index `v` is mirrored at the ends. The pixel at an end is not repeated.
fn mirrored(v: isize, size: usize) -> usize {
    let last = size as isize - 1;
    let v = v.abs();
    (if v > last { (2 * last - v).max(0) } else { v }) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Image {
        let data = (0..width * height)
            .map(|k| (k % width) as f32 * 0.01 + (k / width) as f32 * 0.02)
            .collect();
        Image::from_data(width, height, 1, data)
    }

    #[test]
    fn gradients_are_per_pixel() {
        let pyramid = Pyramid::new(&ramp(40, 33), 1, 4);
        let (dx, dy) = pyramid.levels[0].gradient(7, 9);
        assert!((dx - 0.01).abs() < 1e-6 && (dy - 0.02).abs() < 1e-6);
    }

    #[test]
    fn half_sized_pixels_are_centred_on_even_ones() {
        let pyramid = Pyramid::new(&ramp(65, 64), 2, 4);
        let half = &pyramid.levels[1];
        assert_eq!((half.width, half.height), (33, 32));
        let v = half.value[half.index(10, 12)];
        assert!((v - (20.0 * 0.01 + 24.0 * 0.02)).abs() < 1e-5);
    }

    #[test]
    fn tiny_images_have_one_level() {
        for (w, h) in [(1, 1), (1, 50), (31, 31), (3, 2)] {
            let pyramid = Pyramid::new(&ramp(w, h), 5, 9);
            assert_eq!(pyramid.levels.len(), 1);
        }
        assert_eq!(Pyramid::new(&ramp(640, 480), 9, 9).levels.len(), 5);
    }
}
