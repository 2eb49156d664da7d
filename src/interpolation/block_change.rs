//! Detects change between two frames of a camera, in blocks of pixels.

use super::warp::difference;
use crate::raster::Image;

/// Side of a block, pixels.
const BLOCK: usize = 8;

/// Minimum ratio of a changed block's mean difference to the noise. The noise is estimated as the lower quartile of all
/// blocks' mean differences. (Noise varies by a factor of 2 to 4 between light and dark parts, and between flat and
/// textured parts.)
const MIN_NOISE_RATIO: f32 = 6.0;

/// Minimum mean absolute difference in a changed block, for pixel values of 0 to 1. It equals 1.5 steps of 8-bit
/// values.
const MIN_CHANGE: f32 = 1.5 / 255.0;

/// Returns the mean absolute difference between two images in the block of 8×8 pixels in which it is largest. Pixel
/// values are 0 to 1. Blocks at the right and the bottom border may be smaller.
///
/// # Panics
/// If the images differ in size or in channels.
pub fn largest_change(a: &Image, b: &Image) -> f32 {
    block_means(a, b).into_iter().flatten().fold(0.0, f32::max)
}

/// Returns the fraction, 0..=1, of the 8×8 blocks in which two images differ by more than noise. Blocks that extend
/// beyond the image's border are not counted. Returns 0 if no whole block fits into the image.
///
/// # Panics
/// If the images differ in size or in channels.
pub(crate) fn changed_fraction(a: &Image, b: &Image) -> f64 {
    let changed = changed_blocks(a, b);
    let count = changed.iter().flatten().filter(|c| **c).count();
    let all = changed.iter().flatten().count();
    if count == 0 { 0.0 } else { count as f64 / all as f64 }
}

/// Returns, for each pixel, row by row, whether two images differ by more than noise in the pixel's 8×8 block. The
/// value is `false` in blocks that extend beyond the image's border.
///
/// # Panics
/// If the images differ in size or in channels.
pub(crate) fn changed_pixels(a: &Image, b: &Image) -> Vec<bool> {
    let changed = changed_blocks(a, b);
    let w = a.width();
    let block = |k: usize| changed.get(k / w / BLOCK)?.get(k % w / BLOCK);
    (0..w * a.height()).map(|k| block(k).is_some_and(|changed| *changed)).collect()
}

/// Returns the mean absolute difference of two images in every 8×8 block, as one vector for each row of blocks.
fn block_means(a: &Image, b: &Image) -> Vec<Vec<f32>> {
    let shape = |i: &Image| (i.width(), i.height(), i.channels());
    assert_eq!(shape(a), shape(b), "width, height and channels of both images");
    let w = a.width();
    let means_of = |rows: &[f32]| {
        let mut means = vec![0.0; w.div_ceil(BLOCK)];
        for row in rows.chunks_exact(w) {
            for (mean, block) in means.iter_mut().zip(row.chunks(BLOCK)) {
                *mean += block.iter().sum::<f32>() / (block.len() * rows.len() / w) as f32;
            }
        }
        means
    };
    difference(a, b).chunks(BLOCK * w).map(means_of).collect()
}

/// Returns, for each whole 8×8 block, whether the luma of two images differs by more than noise, as one vector for each
/// row of blocks.
fn changed_blocks(a: &Image, b: &Image) -> Vec<Vec<bool>> {
    let (across, down) = (a.width() / BLOCK, a.height() / BLOCK);
    let mut means = block_means(&a.to_gray(), &b.to_gray());
    means.truncate(down);
    means.iter_mut().for_each(|row| row.truncate(across));
    let mut sorted: Vec<f32> = means.iter().flatten().copied().collect();
    sorted.sort_by(f32::total_cmp);
    let Some(noise) = sorted.get(sorted.len() / 4) else { return Vec::new() };
    let limit = (MIN_NOISE_RATIO * noise).max(MIN_CHANGE);
    means.iter().map(|row| row.iter().map(|d| *d > limit).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn a_change_counts_wherever_it_is() {
        for (w, h) in [(1, 1), (8, 8), (17, 9), (3, 30)] {
            let before = Image::filled(w, h, 3, 0.5);
            assert_eq!(largest_change(&before, &before), 0.0);
            for at in [0, w * h - 1] {
                let mut after = before.clone();
                after.data_mut()[3 * at..][..3].fill(0.75);
                let (x, y) = (at % w, at / w);
                let side = |at: usize, size: usize| (size - at / BLOCK * BLOCK).min(BLOCK);
                let expected = 0.25 / (side(x, w) * side(y, h)) as f32;
                let got = largest_change(&before, &after);
                assert!((got - expected).abs() < 1e-6, "{w}×{h}, {at}: {got}");
            }
            let brighter = Image::filled(w, h, 3, 0.6);
            assert!((largest_change(&before, &brighter) - 0.1).abs() < 1e-6);
        }
    }

    #[test]
    fn noise_is_no_change_and_a_small_body_is() {
        let mut random = Random::new(7);
        let mut static_frame = || {
            let data = (0..160 * 120).map(|k| {
                let edge = if (k % 160) / 20 % 2 == 0 { 0.3 } else { 0.7 };
                edge + 0.05 * random.signed() as f32
            });
            Image::from_data(160, 120, 1, data.collect())
        };
        let (a, mut b) = (static_frame(), static_frame());
        assert_eq!(changed_fraction(&a, &b), 0.0);
        for y in 40..56 {
            for x in 64..80 {
                b.data_mut()[y * 160 + x] = 1.0;
            }
        }
        assert!(changed_fraction(&a, &b) > 0.0);
        let tiny = Image::filled(3, 3, 3, 0.5);
        assert_eq!(changed_fraction(&tiny, &tiny), 0.0);
    }
}
