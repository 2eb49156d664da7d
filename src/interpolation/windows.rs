//! Per-pixel difference and cross-fade of two images, and the mean over windows.

use crate::raster::{Image, padded, sliding};

/// The absolute difference of two images of one shape, averaged over the channels, row by row.
pub(super) fn difference(a: &Image, b: &Image) -> Vec<f32> {
    #[inline(always)]
    fn of_pixel(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
    }
    let (a_data, b_data) = (a.data(), b.data());
    match a.channels() {
        // The compiler knows the number. It then takes many pixels at a time.
        3 => (a_data.as_chunks::<3>().0.iter().zip(b_data.as_chunks::<3>().0))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
        n => (a_data.chunks_exact(n).zip(b_data.chunks_exact(n)))
            .map(|(a, b)| of_pixel(a, b))
            .collect(),
    }
}

/// The largest value of a plane over a (2·radius + 1)² window, of its part inside the plane; `w` wide.
pub(super) fn largest_around(values: &[f32], w: usize, radius: usize) -> Vec<f32> {
    let side = 2 * radius + 1;
    let largest = sliding(&padded(values, w, radius, f32::NEG_INFINITY), side, 1, f32::max);
    let mut across = vec![f32::NEG_INFINITY; values.len() + 2 * radius * w];
    let rows = across[radius * w..].chunks_exact_mut(w);
    for (row, out) in largest.chunks(w + 2 * radius).zip(rows) {
        out.copy_from_slice(&row[..w]);
    }
    sliding(&across, side, w, f32::max)
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
