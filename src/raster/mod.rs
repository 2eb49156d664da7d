//! Images in memory, and image files.
//!
//! Samples are f32 from 0 to 1, display-encoded (sRGB) as in files. Channels are interleaved. Positions are in pixels,
//! and the centre of the top-left pixel is (0.5, 0.5).

mod color;
mod exr;
mod file;
mod filter;
mod png;
mod quantized;
mod sample;
mod tiles;

pub use color::{LUMINANCE, encoded_from_linear, gray_from_rgb, linear_from_encoded, luma};
pub use exr::{Displacements, ExrLayers, write_exr};
pub use file::{ImageFileError, MAX_PIXELS, StillFormat, read_image, write_image, write_still};
pub(crate) use file::{encode_png, encode_png_8, read_hashed_image, read_header, write_webp};
pub(crate) use filter::{box_filter, max_filter, padded};
pub use quantized::{Quantized, Samples};
pub use sample::Sampling;
pub(crate) use sample::{sample, sample_all, sample_each};
pub use tiles::Tiles;

/// Number of bits per sample of an image file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BitDepth {
    Eight,
    Sixteen,
}

/// An image of 1 (grey) or 3 (RGB) channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    channels: usize,
    data: Vec<f32>,
}

impl Image {
    /// Makes an image whose samples all have the same value.
    ///
    /// # Panics
    /// If a dimension is 0.
    pub fn filled(width: usize, height: usize, channels: usize, value: f32) -> Self {
        Self::from_data(width, height, channels, vec![value; width * height * channels])
    }

    /// Makes an image from its samples, row by row, with interleaved channels.
    ///
    /// # Panics
    /// If a dimension is 0, or if the product of the dimensions differs from the number of samples.
    pub fn from_data(width: usize, height: usize, channels: usize, data: Vec<f32>) -> Self {
        assert!(width > 0 && height > 0 && channels > 0, "an image has no empty dimension");
        assert_eq!(data.len(), width * height * channels, "samples of a {width}×{height} image");
        Self { width, height, channels, data }
    }

    /// Returns the width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the number of samples per pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Returns all samples, row by row, with interleaved channels.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Returns all samples for modification, row by row, with interleaved channels.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// Returns the samples of row `y`. Panics if there is no such row.
    pub fn row(&self, y: usize) -> &[f32] {
        let n = self.width * self.channels;
        &self.data[y * n..(y + 1) * n]
    }

    /// Returns the samples of the pixel in column `x` and row `y`. Panics outside of the image.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.data[at..at + self.channels]
    }

    /// Converts the image to one channel: the luma of each pixel of an RGB image ([`luma`]). A grey image is copied.
    pub fn to_gray(&self) -> Image {
        if self.channels == 1 {
            return self.clone();
        }
        let data = self.data.chunks_exact(self.channels).map(luma).collect();
        Image { width: self.width, height: self.height, channels: 1, data }
    }

    /// Converts the image to three channels. A grey value is repeated in all three channels.
    pub fn to_rgb(&self) -> Image {
        if self.channels == 3 {
            return self.clone();
        }
        let data = self.data.iter().flat_map(|&v| [v; 3]).collect();
        Image { width: self.width, height: self.height, channels: 3, data }
    }

    /// Interpolates the image bilinearly at the position (x, y), pixels. Writes one value per channel into `out`.
    /// Outside of the image, border pixels are repeated. A NaN coordinate is treated like 0.
    pub fn sample_bilinear(&self, x: f32, y: f32, out: &mut [f32]) {
        let split = |v: f32, size: usize| {
            let v = (v - 0.5).max(0.0).min((size - 1) as f32);
            let floor = v as usize;
            (floor, (floor + 1).min(size - 1), v - floor as f32)
        };
        let (x0, x1, fx) = split(x, self.width);
        let (y0, y1, fy) = split(y, self.height);
        let (a, b) = (self.pixel(x0, y0), self.pixel(x1, y0));
        let (c, d) = (self.pixel(x0, y1), self.pixel(x1, y1));
        for (k, out) in out.iter_mut().enumerate() {
            let top = a[k] + (b[k] - a[k]) * fx;
            let bottom = c[k] + (d[k] - c[k]) * fx;
            *out = top + (bottom - top) * fy;
        }
    }

    /// Interpolates the image by Catmull–Rom splines at the position (x, y), pixels. Writes one value per channel into
    /// `out`. The interpolant passes through the pixels' values, and may overshoot the range 0..=1. Positions outside
    /// of the image and NaN are treated as in [`Self::sample_bilinear`].
    pub fn sample_cubic(&self, x: f32, y: f32, out: &mut [f32]) {
        let split = |v: f32, size: usize| {
            let v = (v - 0.5).max(0.0).min((size - 1) as f32);
            let floor = v as usize;
            let at = |k: isize| (floor as isize + k).clamp(0, size as isize - 1) as usize;
            ([at(-1), at(0), at(1), at(2)], catmull_rom(v - floor as f32))
        };
        let (xs, wx) = split(x, self.width);
        let (ys, wy) = split(y, self.height);
        out.fill(0.0);
        for (&y, wy) in ys.iter().zip(wy) {
            for (&x, wx) in xs.iter().zip(wx) {
                for (out, v) in out.iter_mut().zip(self.pixel(x, y)) {
                    *out += wx * wy * v;
                }
            }
        }
    }
}

/// Returns the weights of four neighbouring samples for Catmull–Rom interpolation. `f`, from 0 to 1, is the
/// interpolated position between the second and the third sample.
pub(crate) fn catmull_rom(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [
        0.5 * (-f + 2.0 * f2 - f3),
        0.5 * (2.0 - 5.0 * f2 + 3.0 * f3),
        0.5 * (f + 4.0 * f2 - 3.0 * f3),
        0.5 * (f3 - f2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Image {
        let data = (0..5 * 4).flat_map(|k| [(k % 5) as f32 * 0.1, (k / 5) as f32 * 0.2]).collect();
        Image::from_data(5, 4, 2, data)
    }

    #[test]
    fn samples_at_pixel_centres_are_the_pixels() {
        let image = ramp();
        let mut out = [0.0; 2];
        for y in 0..4 {
            for x in 0..5 {
                image.sample_bilinear(x as f32 + 0.5, y as f32 + 0.5, &mut out);
                assert_eq!(out, *image.pixel(x, y));
                image.sample_cubic(x as f32 + 0.5, y as f32 + 0.5, &mut out);
                assert_eq!(out, *image.pixel(x, y));
            }
        }
    }

    #[test]
    fn a_ramp_is_reproduced_between_centres() {
        let mut out = [0.0; 2];
        ramp().sample_bilinear(2.25, 1.75, &mut out);
        assert!((out[0] - 0.175).abs() < 1e-6 && (out[1] - 0.25).abs() < 1e-6);
        ramp().sample_cubic(2.25, 2.25, &mut out);
        assert!((out[0] - 0.175).abs() < 1e-6 && (out[1] - 0.35).abs() < 1e-6);
    }

    #[test]
    fn outside_takes_the_border() {
        let mut out = [0.0; 2];
        for (x, y) in [(-1e30, 9.0), (f32::NEG_INFINITY, f32::INFINITY), (f32::NAN, 1e9)] {
            ramp().sample_bilinear(x, y, &mut out);
            assert_eq!(out, *ramp().pixel(0, 3), "{x} {y}");
            ramp().sample_cubic(x, y, &mut out);
            assert!((out[0] - 0.0).abs() < 0.02 && (out[1] - 0.6).abs() < 0.02, "{x} {y} {out:?}");
        }
    }

    #[test]
    fn gray_weights_sum_to_one() {
        let white = Image::filled(2, 1, 3, 1.0).to_gray();
        assert!(white.data().iter().all(|v| (v - 1.0).abs() < 1e-6));
        assert_eq!(Image::filled(1, 1, 1, 0.3).to_rgb().data(), [0.3; 3]);
    }
}
