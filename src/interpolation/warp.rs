//! Backward warps, which give every pixel of an image its source position in a frame, and the cross dissolve
//! of two warped frames, eq. (9).

use super::windows::cross_fade;
use crate::raster::{Image, Tiles, sample_all};
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

/// The frame, warped, by cubic convolution; values may leave 0..=1. Black outside `parts`, if not all of it is
/// needed.
pub(super) fn warped(image: &Image, warp: &Warp, parts: Option<&Tiles>) -> Image {
    let channels = image.channels();
    let mut data = vec![0.0; warp.source.len() * channels];
    data.par_chunks_mut(warp.width * channels).enumerate().for_each(|(y, row)| {
        let positions = &warp.source[y * warp.width..][..warp.width];
        let mut sample = |[from, end]: [usize; 2]| {
            let span = from..end.min(warp.width);
            let row = &mut row[span.start * channels..span.end * channels];
            sample_all(image, positions[span].iter().copied(), row);
        };
        match parts {
            Some(parts) => parts.spans(y).for_each(sample),
            None => sample([0, warp.width]),
        }
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
    cross_dissolve_in([earlier, later], [from_earlier, from_later], fraction, None)
}

/// The same in some parts of the image, if not all; the others are black.
pub(super) fn cross_dissolve_in(
    [earlier, later]: [&Image; 2],
    [from_earlier, from_later]: [&Warp; 2],
    fraction: f32,
    parts: Option<&Tiles>,
) -> Image {
    let [from, to] = [(earlier, from_earlier), (later, from_later)]
        .map(|(image, warp)| warped(image, warp, parts));
    let mut image = cross_fade(&from, &to, fraction);
    image.data_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    image
}
