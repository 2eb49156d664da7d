//! Backward warps, which give every pixel of an image its source position in a frame, and the cross dissolve
//! of two warped frames, eq. (9).

use super::windows::cross_fade;
use crate::raster::{Image, sample_all};
use rayon::prelude::*;

/// A backward warp: the source position of every pixel of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Warp {
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Positions `[x, y]` in the source frame, row by row, in pixels with the top-left pixel's centre at
    /// (0.5, 0.5). They may be outside the frame, whose border is repeated.
    pub source: Vec<[f32; 2]>,
}

impl Warp {
    /// The warp whose source positions are the pixels' centres.
    pub fn identity(width: usize, height: usize) -> Self {
        let source = (0..width * height)
            .map(|k| [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5])
            .collect();
        Self { width, height, source }
    }
}

/// The frame, warped, by cubic convolution; values may leave 0..=1.
pub(super) fn warped(image: &Image, warp: &Warp) -> Image {
    let channels = image.channels();
    let mut data = vec![0.0; warp.source.len() * channels];
    data.par_chunks_mut(warp.width * channels).enumerate().for_each(|(y, row)| {
        let positions = &warp.source[y * warp.width..][..warp.width];
        sample_all(image, positions.iter().copied(), row);
    });
    Image::from_data(warp.width, warp.height, channels, data)
}

/// The cross dissolve of two warped frames, eq. (9), clamped to 0..=1. `fraction` is (t' − t)/Δt, 0 at the
/// earlier frame.
///
/// Both frames must have the same channels, and both warps the same size.
pub fn cross_dissolve(
    [earlier, later]: [&Image; 2],
    [from_earlier, from_later]: [&Warp; 2],
    fraction: f32,
) -> Image {
    let mut image =
        cross_fade(&warped(earlier, from_earlier), &warped(later, from_later), fraction);
    image.data_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    image
}
