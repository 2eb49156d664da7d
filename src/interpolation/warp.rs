//! Backward warps, the cross dissolve of two warped frames, eq. (9), and per-pixel operations on images.

use crate::raster::{Image, Tiles, padded, sample_all, sliding};
use rayon::prelude::*;

/// A backward warp: the source position of every pixel of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Warp {
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Positions `[x, y]` in the source frame, row by row, pixels. Outside the frame its border is repeated.
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

/// Warps a frame by cubic convolution; values may leave 0..=1. Black outside `parts`, if given.
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
/// earlier frame. Black outside `parts`, if given.
///
/// Both frames must have the same channels, and both warps the same size.
pub fn cross_dissolve(
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

/// The cross-fade of two images of one shape: `a` at a fraction of 0, `b` at 1.
pub(super) fn cross_fade(a: &Image, b: &Image, fraction: f32) -> Image {
    let data = (a.data().iter().zip(b.data())).map(|(a, b)| a + (b - a) * fraction).collect();
    Image::from_data(a.width(), a.height(), a.channels(), data)
}

/// The absolute difference of two images of one shape, averaged over the channels, row by row.
pub(super) fn difference(a: &Image, b: &Image) -> Vec<f32> {
    #[inline(always)]
    fn of_pixel(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
    }
    let (a_data, b_data) = (a.data(), b.data());
    match a.channels() {
        // The compiler knows the number of channels, and vectorizes.
        3 => (a_data.as_chunks::<3>().0.iter().zip(b_data.as_chunks::<3>().0))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
        n => (a_data.chunks_exact(n).zip(b_data.chunks_exact(n)))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
    }
}

/// The maximum filter of a plane of width `w` over a (2·radius + 1)² window, clipped at the borders.
pub(super) fn max_filter(values: &[f32], w: usize, radius: usize) -> Vec<f32> {
    let side = 2 * radius + 1;
    let along_rows = sliding(&padded(values, w, radius, f32::NEG_INFINITY), side, 1, f32::max);
    let mut padded_rows = vec![f32::NEG_INFINITY; values.len() + 2 * radius * w];
    let rows = padded_rows[radius * w..].chunks_exact_mut(w);
    for (row, out) in along_rows.chunks(w + 2 * radius).zip(rows) {
        out.copy_from_slice(&row[..w]);
    }
    sliding(&padded_rows, side, w, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_maximum_filter_equals_a_search() {
        for (w, h, radius) in [(1, 1, 0), (1, 1, 3), (7, 5, 1), (16, 9, 2), (5, 12, 20)] {
            let values: Vec<f32> = (0..w * h).map(|k| ((k * 37) % 101) as f32).collect();
            for (k, largest) in max_filter(&values, w, radius).iter().enumerate() {
                let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
                let inside = (0..w * h).filter(|n| near(n % w, k % w) && near(n / w, k / w));
                let direct = inside.map(|n| values[n]).fold(0.0, f32::max);
                assert!(*largest == direct, "{w}×{h}, {radius}: {largest} {direct}");
            }
        }
    }
}
