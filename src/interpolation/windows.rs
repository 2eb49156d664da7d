//! Per-pixel difference and cross-fade of two images, and the mean over windows.

use crate::raster::Image;

/// The absolute difference of two images of one shape, averaged over the channels, row by row.
pub(super) fn difference(a: &Image, b: &Image) -> Vec<f32> {
    let channels = a.channels();
    (a.data().chunks_exact(channels).zip(b.data().chunks_exact(channels)))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / channels as f32)
        .collect()
}

/// The largest value of a plane over a (2·radius + 1)² window, of its part inside the plane; `w` wide.
pub(super) fn largest_around(values: &[f32], w: usize, radius: usize) -> Vec<f32> {
    let h = values.len() / w;
    let mut across = values.to_vec();
    for (row, out) in values.chunks_exact(w).zip(across.chunks_exact_mut(w)) {
        for shift in 1..=radius.min(w - 1) {
            for x in 0..w - shift {
                out[x] = out[x].max(row[x + shift]);
                out[x + shift] = out[x + shift].max(row[x]);
            }
        }
    }
    let mut out = across.clone();
    for shift in 1..=radius.min(h - 1) {
        let n = w * (h - shift);
        for k in 0..n {
            out[k] = out[k].max(across[k + shift * w]);
            out[k + shift * w] = out[k + shift * w].max(across[k]);
        }
    }
    out
}

/// The cross-fade of two images of one shape: `a` at a fraction of 0, `b` at 1.
pub(super) fn cross_fade(a: &Image, b: &Image, fraction: f32) -> Image {
    let data = (a.data().iter().zip(b.data())).map(|(a, b)| a + (b - a) * fraction).collect();
    Image::from_data(a.width(), a.height(), a.channels(), data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_around_equals_a_search() {
        for (w, h, radius) in [(1, 1, 0), (1, 1, 3), (7, 5, 1), (16, 9, 2), (5, 12, 20)] {
            let values: Vec<f32> = (0..w * h).map(|k| ((k * 37) % 101) as f32).collect();
            for (k, largest) in largest_around(&values, w, radius).iter().enumerate() {
                let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
                let inside = (0..w * h).filter(|n| near(n % w, k % w) && near(n / w, k / w));
                let direct = inside.map(|n| values[n]).fold(0.0, f32::max);
                assert!(*largest == direct, "{w}×{h}, {radius}: {largest} {direct}");
            }
        }
    }
}
