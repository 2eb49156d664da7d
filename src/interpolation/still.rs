//! Whether two frames show the same.

use super::windows::difference;
use crate::raster::Image;

/// Side of the blocks that are compared, pixels. Larger: small bodies hide in them; smaller: noise
/// is told less well from change.
const BLOCK: usize = 8;

/// The largest mean difference of a block of the two images, values 0..=1. Blocks at the right and
/// at the bottom may be narrower.
///
/// # Panics
/// If the images differ in size or in channels.
pub fn largest_change(a: &Image, b: &Image) -> f32 {
    let shape = |i: &Image| (i.width(), i.height(), i.channels());
    assert_eq!(shape(a), shape(b), "width, height and channels of both images");
    let w = a.width();
    let difference = difference(a, b);
    let rows_of_blocks = difference.chunks(BLOCK * w);
    let largest_of = |rows: &[f32]| {
        let mut sums = vec![0.0; w.div_ceil(BLOCK)];
        for row in rows.chunks_exact(w) {
            for (sum, block) in sums.iter_mut().zip(row.chunks(BLOCK)) {
                *sum += block.iter().sum::<f32>() / (block.len() * rows.len() / w) as f32;
            }
        }
        sums.into_iter().fold(0.0, f32::max)
    };
    rows_of_blocks.map(largest_of).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
