//! What two images are compared by, pixel by pixel and over windows.

use crate::raster::Image;

/// Mean absolute difference of the channels, a pixel.
pub(super) fn difference(a: &Image, b: &Image) -> Vec<f32> {
    let channels = a.channels();
    (a.data().chunks_exact(channels).zip(b.data().chunks_exact(channels)))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / channels as f32)
        .collect()
}

/// Mean over a (2·radius + 1)² window, of what of it lies inside.
pub(super) fn box_mean(values: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    let span = |at: usize, size: usize| at.saturating_sub(radius)..(at + radius + 1).min(size);
    let mut across = vec![0.0; values.len()];
    for y in 0..h {
        let row = &values[y * w..(y + 1) * w];
        for x in 0..w {
            let range = span(x, w);
            let n = range.len() as f32;
            across[y * w + x] = row[range].iter().sum::<f32>() / n;
        }
    }
    let mut out = vec![0.0; values.len()];
    for y in 0..h {
        let range = span(y, h);
        let n = range.len() as f32;
        for from in range {
            for (out, v) in out[y * w..(y + 1) * w].iter_mut().zip(&across[from * w..]) {
                *out += v / n;
            }
        }
    }
    out
}

/// The two images' mean, `share` of it the second's.
pub(super) fn mixed(a: &Image, b: &Image, share: f32) -> Image {
    let data = (a.data().iter().zip(b.data())).map(|(a, b)| a + (b - a) * share).collect();
    Image::from_data(a.width(), a.height(), a.channels(), data)
}
