//! Images quantized to the integer samples of image files.

use super::{BitDepth, Image};

/// Integer samples of an image: row by row, with interleaved channels.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
}

/// An image quantized to the integer samples of an image file.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantized {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Number of samples per pixel. With 2 or 4 channels, the last one is alpha.
    pub channels: usize,
    pub samples: Samples,
}

/// Rounds a value from 0 to 1 to an 8-bit sample. The cast to an integer truncates, so 0.5 is added. The cast also
/// saturates, and converts NaN to 0.
fn eight(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

fn sixteen(value: f32) -> u16 {
    (value * 65535.0 + 0.5) as u16
}

/// Quantizes all samples of an image by the function `round`. With a coverage mask, an alpha channel is added, and all
/// samples of pixels that aren't covered become 0.
fn rounded<T>(image: &Image, coverage: Option<&[bool]>, round: impl Fn(f32) -> T) -> Vec<T> {
    let channels = image.channels() + usize::from(coverage.is_some());
    let mut samples = Vec::with_capacity(image.width() * image.height() * channels);
    for (k, pixel) in image.data().chunks_exact(image.channels()).enumerate() {
        let is_covered = coverage.is_none_or(|c| c[k]);
        samples.extend(pixel.iter().map(|&v| round(if is_covered { v } else { 0.0 })));
        if coverage.is_some() {
            samples.push(round(f32::from(u8::from(is_covered))));
        }
    }
    samples
}

impl Quantized {
    /// Quantizes an image to integer samples of the bit depth `depth`. Values are clamped to the range from 0 to 1, and
    /// NaN becomes 0.
    ///
    /// `coverage` has one value per pixel, row by row. If it is given, an alpha channel is added, and all samples of a
    /// pixel with `false` are 0.
    pub fn new(image: &Image, coverage: Option<&[bool]>, depth: BitDepth) -> Self {
        let channels = image.channels() + usize::from(coverage.is_some());
        let samples = match depth {
            BitDepth::Eight => Samples::Eight(rounded(image, coverage, eight)),
            BitDepth::Sixteen => Samples::Sixteen(rounded(image, coverage, sixteen)),
        };
        Self { width: image.width(), height: image.height(), channels, samples }
    }

    /// Makes a black image of 1 or 3 channels, without alpha. `[width, height]` is its size, pixels.
    pub fn blank([width, height]: [usize; 2], channels: usize, depth: BitDepth) -> Self {
        let count = width * height * channels;
        let samples = match depth {
            BitDepth::Eight => Samples::Eight(vec![0; count]),
            BitDepth::Sixteen => Samples::Sixteen(vec![0; count]),
        };
        Self { width, height, channels, samples }
    }

    /// Quantizes `image` and copies it into this image, so that its top left pixel is at the pixel (x, y). Pixels that
    /// `coverage` doesn't cover become black. Without `coverage`, all pixels are covered.
    ///
    /// # Panics
    /// If `image` reaches beyond this image, or if the two images differ in their numbers of channels.
    pub fn place(&mut self, image: &Image, coverage: Option<&[bool]>, [x, y]: [usize; 2]) {
        assert_eq!(image.channels(), self.channels, "a part has the channels of the whole");
        assert!(x + image.width() <= self.width && y + image.height() <= self.height);
        let (channels, length) = (self.channels, image.width() * self.channels);
        for row in 0..image.height() {
            let start = ((y + row) * self.width + x) * channels;
            let values = image.row(row).iter().enumerate().map(|(k, value)| {
                let is_covered = coverage.is_none_or(|c| c[row * image.width() + k / channels]);
                if is_covered { *value } else { 0.0 }
            });
            match &mut self.samples {
                Samples::Eight(all) => {
                    let part = all[start..start + length].iter_mut();
                    part.zip(values).for_each(|(sample, value)| *sample = eight(value));
                }
                Samples::Sixteen(all) => {
                    let part = all[start..start + length].iter_mut();
                    part.zip(values).for_each(|(sample, value)| *sample = sixteen(value));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_placed_by_their_top_left_pixel() {
        let mut whole = Quantized::blank([4, 3], 1, BitDepth::Eight);
        let part = Image::from_data(2, 2, 1, vec![1.0, 0.5, 2.0, f32::NAN]);
        whole.place(&part, Some(&[true, true, true, false]), [1, 1]);
        assert_eq!(whole.samples, Samples::Eight(vec![0, 0, 0, 0, 0, 255, 128, 0, 0, 255, 0, 0]));
        let mut deep = Quantized::blank([2, 2], 1, BitDepth::Sixteen);
        deep.place(&part, None, [0, 0]);
        assert_eq!(deep, Quantized::new(&part, None, BitDepth::Sixteen));
    }
}
