//! Backward warps, the cross dissolve of two warped frames, eq. (9), and per-pixel operations on images.

use super::tracked_pair::RowFractions;
use crate::raster::{Image, Tiles, sample_all};
use rayon::prelude::*;

/// A backward warp: for every pixel of an image, a position in a source frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Warp {
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Positions `[x, y]` in the source frame, in pixels, one per pixel of the image, row by row. A position outside
    /// the frame shows the nearest border pixel.
    pub source: Vec<[f32; 2]>,
}

impl Warp {
    /// Returns the identity warp: each pixel's source position is the pixel's own centre.
    pub fn identity(width: usize, height: usize) -> Self {
        let source = (0..width * height)
            .map(|k| [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5])
            .collect();
        Self { width, height, source }
    }
}

/// Returns a frame warped by a backward warp, sampled by cubic convolution. Values may be outside 0..=1. If the tiles
/// `parts` are given, pixels outside them are black.
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

/// Returns the cross dissolve of two warped frames, eq. (9), clamped to 0..=1. `fractions` is the position (t' − t)/Δt
/// of the instant t' in the frame interval, for each row; it is 0 at the earlier frame. If the tiles `parts` are given,
/// pixels outside them are black.
///
/// Both frames must have the same channels, and both warps the same size.
pub fn cross_dissolve(
    [earlier, later]: [&Image; 2],
    [from_earlier, from_later]: [&Warp; 2],
    fractions: RowFractions,
    parts: Option<&Tiles>,
) -> Image {
    let [from, to] = [(earlier, from_earlier), (later, from_later)]
        .map(|(image, warp)| warped(image, warp, parts));
    let mut image = cross_fade_rows(&from, &to, fractions);
    image.data_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    image
}

/// Returns the cross-fade of two images of the same shape: `a` at fraction 0, `b` at fraction 1.
pub(super) fn cross_fade(a: &Image, b: &Image, fraction: f32) -> Image {
    let data = (a.data().iter().zip(b.data())).map(|(a, b)| a + (b - a) * fraction).collect();
    Image::from_data(a.width(), a.height(), a.channels(), data)
}

/// Returns the cross-fade of two images of the same shape, with a fraction for each row.
pub(super) fn cross_fade_rows(a: &Image, b: &Image, fractions: RowFractions) -> Image {
    if fractions.are_constant() {
        return cross_fade(a, b, fractions.at(0.0) as f32);
    }
    let width = a.width() * a.channels();
    let rows = a.data().chunks_exact(width).zip(b.data().chunks_exact(width)).enumerate();
    let data = rows.flat_map(|(y, (a, b))| {
        let fraction = fractions.at(y as f64 + 0.5) as f32;
        a.iter().zip(b).map(move |(a, b)| a + (b - a) * fraction)
    });
    Image::from_data(a.width(), a.height(), a.channels(), data.collect())
}

/// Returns the absolute difference of two images of the same shape, averaged over the channels. The result has one
/// value per pixel, row by row.
pub(super) fn difference(a: &Image, b: &Image) -> Vec<f32> {
    #[inline(always)]
    fn of_pixel(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
    }
    let (a_data, b_data) = (a.data(), b.data());
    match a.channels() {
        // If the number of channels is known at compile time, the loop is vectorized.
        3 => (a_data.as_chunks::<3>().0.iter().zip(b_data.as_chunks::<3>().0))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
        n => (a_data.chunks_exact(n).zip(b_data.chunks_exact(n)))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
    }
}
