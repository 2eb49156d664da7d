//! Images between their pixels, fast.

use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// How images are read between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    Bilinear,
    /// Catmull-Rom: sharper.
    Cubic,
}

/// The image of C channels at a position in pixels, as [`Image::sample_cubic`] and
/// [`Image::sample_bilinear`], with a shorter way where the filter lies
/// inside the image. C is 1 or 3.
#[inline(always)]
pub(super) fn sample<const C: usize>(
    image: &Image,
    x: f32,
    y: f32,
    sampling: Sampling,
) -> [f32; C] {
    let mut out = [0.0; C];
    let (w, h) = (image.width(), image.height());
    let (left, top) = (x - 0.5, y - 0.5);
    let inside = left >= 1.0 && top >= 1.0 && left < w as f32 - 2.0 && top < h as f32 - 2.0;
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
            let at = ((j - 1) * w + i - 1) * C;
            let rows: [&[f32]; 4] =
                std::array::from_fn(|k| &image.data()[at + k * w * C..][..4 * C]);
            // The columns first, all channels side by side: at most 12 values.
            let mut columns = [0.0; 12];
            for (k, column) in columns[..4 * C].iter_mut().enumerate() {
                *column = wy[0] * rows[0][k]
                    + wy[1] * rows[1][k]
                    + wy[2] * rows[2][k]
                    + wy[3] * rows[3][k];
            }
            for (k, out) in out.iter_mut().enumerate() {
                *out = wx[0] * columns[k]
                    + wx[1] * columns[C + k]
                    + wx[2] * columns[2 * C + k]
                    + wx[3] * columns[3 * C + k];
            }
        }
    }
    out
}

/// The four weights of Catmull-Rom's cubic at a fraction between the middle two samples.
fn catmull_rom(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [
        0.5 * (-f + 2.0 * f2 - f3),
        0.5 * (2.0 - 5.0 * f2 + 3.0 * f3),
        0.5 * (f + 4.0 * f2 - 3.0 * f3),
        0.5 * (f3 - f2),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

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
