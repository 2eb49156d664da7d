//! Fast samples of images between their pixels.

use super::{Image, catmull_rom};
use serde::{Deserialize, Serialize};

/// The interpolation of images between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// Linear in x and in y.
    Bilinear,
    /// Catmull–Rom's cubic: sharper.
    Cubic,
}

/// The image of C channels, 1 or 3, at a position in pixels. It equals [`Image::sample_cubic`] and
/// [`Image::sample_bilinear`] to rounding, and is faster where the filter lies inside the image.
#[inline(always)]
pub(crate) fn sample<const C: usize>(
    image: &Image,
    x: f32,
    y: f32,
    sampling: Sampling,
) -> [f32; C] {
    let mut out = [0.0; C];
    let (w, h) = (image.width(), image.height());
    let (left, top) = (x - 0.5, y - 0.5);
    // One pixel further on the right than the filter reaches, for reading four values at a time.
    let inside = left >= 1.0 && top >= 1.0 && left < w as f32 - 3.0 && top < h as f32 - 2.0;
    match (sampling, inside) {
        (Sampling::Bilinear, false) => image.sample_bilinear(x, y, &mut out),
        (Sampling::Cubic, false) => image.sample_cubic(x, y, &mut out),
        (Sampling::Bilinear, true) => {
            let (i, j) = (left as usize, top as usize);
            let (fx, fy) = (left - i as f32, top - j as f32);
            let at = (j * w + i) * C;
            let (a, b) = (&image.data()[at..][..2 * C], &image.data()[at + w * C..][..2 * C]);
            for k in 0..C {
                let upper = a[k] + (a[C + k] - a[k]) * fx;
                let lower = b[k] + (b[C + k] - b[k]) * fx;
                out[k] = upper + (lower - upper) * fy;
            }
        }
        (Sampling::Cubic, true) => {
            let (i, j) = (left as usize, top as usize);
            let (wx, wy) = (catmull_rom(left - i as f32), catmull_rom(top - j as f32));
            let mut sum = [0.0; 4];
            for (row, wy) in wy.into_iter().enumerate() {
                let at = ((j + row - 1) * w + i - 1) * C;
                let cells = &image.data()[at..][..if C == 1 { 4 } else { 13 }];
                let mut across = [0.0; 4];
                if C == 1 {
                    // The four sums are of four pixels.
                    across =
                        [cells[0] * wx[0], cells[1] * wx[1], cells[2] * wx[2], cells[3] * wx[3]];
                } else {
                    // The four sums are of the pixel's channels, and one that is not used.
                    for (column, wx) in wx.into_iter().enumerate() {
                        add(&mut across, wx, &cells[column * C..][..4]);
                    }
                }
                add(&mut sum, wy, &across);
            }
            if C == 1 {
                out[0] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
            } else {
                out.copy_from_slice(&sum[..C]);
            }
        }
    }
    out
}

#[inline(always)]
fn add(sum: &mut [f32; 4], weight: f32, values: &[f32]) {
    for (sum, v) in sum.iter_mut().zip(values) {
        *sum += weight * v;
    }
}

/// The image at these positions, into `out`, by Catmull–Rom's cubic: one value a channel for each.
pub(crate) fn sample_all(
    image: &Image,
    positions: impl Iterator<Item = [f32; 2]>,
    out: &mut [f32],
) {
    fn each<const C: usize>(
        image: &Image,
        positions: impl Iterator<Item = [f32; 2]>,
        out: &mut [f32],
    ) {
        for ([x, y], out) in positions.zip(out.chunks_exact_mut(C)) {
            out.copy_from_slice(&sample::<C>(image, x, y, Sampling::Cubic));
        }
    }
    match image.channels() {
        1 => each::<1>(image, positions, out),
        3 => each::<3>(image, positions, out),
        n => {
            for ([x, y], out) in positions.zip(out.chunks_exact_mut(n)) {
                image.sample_cubic(x, y, out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn equals_the_images_own_sampling() {
        let mut random = Random::new(41);
        let data = (0..9 * 7 * 3).map(|_| random.unit() as f32).collect();
        let rgb = Image::from_data(9, 7, 3, data);
        let gray = rgb.to_gray();
        for _ in 0..3000 {
            let x = random.in_range(-1.0, 10.0) as f32;
            let y = random.in_range(-1.0, 8.0) as f32;
            let (mut want, mut want_gray) = ([0.0; 3], [0.0; 1]);
            for sampling in [Sampling::Bilinear, Sampling::Cubic] {
                match sampling {
                    Sampling::Bilinear => {
                        rgb.sample_bilinear(x, y, &mut want);
                        gray.sample_bilinear(x, y, &mut want_gray);
                    }
                    Sampling::Cubic => {
                        rgb.sample_cubic(x, y, &mut want);
                        gray.sample_cubic(x, y, &mut want_gray);
                    }
                }
                let got: [f32; 3] = sample(&rgb, x, y, sampling);
                assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5));
                let [got] = sample(&gray, x, y, sampling);
                assert!((got - want_gray[0]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn images_of_one_pixel_and_positions_that_are_none() {
        let image = Image::filled(1, 1, 1, 0.5);
        for (x, y) in [(0.5, 0.5), (f32::NAN, f32::INFINITY), (-1e30, 1e30)] {
            for sampling in [Sampling::Bilinear, Sampling::Cubic] {
                assert_eq!(sample(&image, x, y, sampling), [0.5]);
            }
        }
    }
}
