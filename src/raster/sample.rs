//! Fast interpolation of images at positions between pixels.

use super::{Image, catmull_rom};
#[cfg(target_arch = "x86_64")]
use crate::simd::has_avx2_and_fma;
use crate::simd::multiversion;
use serde::{Deserialize, Serialize};

/// Method of interpolation between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// Bilinear interpolation.
    Bilinear,
    /// Catmull–Rom cubic interpolation, which is sharper than bilinear interpolation.
    Cubic,
}

/// Interpolates an image of C channels (1 or 3) at a position, pixels. The result equals [`Image::sample_cubic`] or
/// [`Image::sample_bilinear`] up to rounding. This function is faster where the filter's support lies inside of the
/// image.
#[inline(always)]
pub(crate) fn sample<const C: usize>(
    image: &Image,
    x: f32,
    y: f32,
    sampling: Sampling,
) -> [f32; C] {
    let mut out = [0.0; C];
    let w = image.width();
    match (sampling, inside(image, x, y)) {
        (Sampling::Bilinear, None) => image.sample_bilinear(x, y, &mut out),
        (Sampling::Cubic, None) => image.sample_cubic(x, y, &mut out),
        (Sampling::Bilinear, Some((left, top))) => {
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
        #[cfg(target_arch = "x86_64")]
        (Sampling::Cubic, Some((left, top))) if C == 3 && has_avx2_and_fma() => {
            // Safe: `has_avx2_and_fma` has checked the processor.
            let rgb = unsafe { cubic_rgb_avx2(image.data(), w, left, top) };
            out.copy_from_slice(&rgb[..C]);
        }
        (Sampling::Cubic, Some((left, top))) => {
            let (i, j) = (left as usize, top as usize);
            let (wx, wy) = (catmull_rom(left - i as f32), catmull_rom(top - j as f32));
            let mut sum = [0.0; 4];
            for (row, wy) in wy.into_iter().enumerate() {
                let at = ((j + row - 1) * w + i - 1) * C;
                let cells = &image.data()[at..][..if C == 1 { 4 } else { 13 }];
                let mut across = [0.0; 4];
                if C == 1 {
                    // The four sums belong to the row's four pixels.
                    across =
                        [cells[0] * wx[0], cells[1] * wx[1], cells[2] * wx[2], cells[3] * wx[3]];
                } else {
                    // The first three sums belong to the pixel's channels. The fourth is unused.
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

/// Converts a position, pixels, to coordinates relative to the centre of the image's top left pixel. `None` if the
/// support of a cubic filter at the position reaches beyond the image.
#[inline(always)]
fn inside(image: &Image, x: f32, y: f32) -> Option<(f32, f32)> {
    let (w, h) = (image.width(), image.height());
    let (left, top) = (x - 0.5, y - 0.5);
    // At the right, one more pixel than the support is required, because four values are read at a time.
    let inside = left >= 1.0 && top >= 1.0 && left < w as f32 - 3.0 && top < h as f32 - 2.0;
    inside.then_some((left, top))
}

/// Interpolates an RGB image of width `w` by Catmull–Rom splines. The position (`left`, `top`), pixels, is relative to
/// the centre of the top left pixel. The result has the three channels, and an unused fourth value.
///
/// The weighted sums over the filter's four rows are computed first, for all four columns at once. Plain loops take
/// 40 % longer.
///
/// # Panics
/// If the support of the filter reaches beyond the image.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline]
fn cubic_rgb_avx2(data: &[f32], w: usize, left: f32, top: f32) -> [f32; 4] {
    use std::arch::x86_64::*;
    let (i, j) = (left as usize, top as usize);
    let first = ((j - 1) * w + i - 1) * 3;
    let (x, y) = (weights_avx2(left - i as f32), weights_avx2(top - j as f32));
    let of_rows = [
        _mm256_broadcastss_ps(y),
        _mm256_broadcastss_ps(_mm_permute_ps::<0b01>(y)),
        _mm256_broadcastss_ps(_mm_permute_ps::<0b10>(y)),
        _mm256_broadcastss_ps(_mm_permute_ps::<0b11>(y)),
    ];
    // Channels of the four summed pixels: `near` has r g b r g b r g, and `far` has b r g b.
    let (mut near, mut far) = (_mm256_setzero_ps(), _mm_setzero_ps());
    for (row, weight) in of_rows.into_iter().enumerate() {
        let cells = data[first + 3 * w * row..].first_chunk();
        let row: &[f32; 12] = cells.expect("the filter is inside the image");
        // Safe: a row has twelve values.
        let (a, b) = unsafe { (_mm256_loadu_ps(row.as_ptr()), _mm_loadu_ps(row[8..].as_ptr())) };
        near = _mm256_fmadd_ps(weight, a, near);
        far = _mm_fmadd_ps(_mm256_castps256_ps128(weight), b, far);
    }
    let columns = _mm256_setr_epi32(0, 0, 0, 1, 1, 1, 2, 2);
    let near = _mm256_mul_ps(near, _mm256_permutevar8x32_ps(_mm256_set_m128(x, x), columns));
    let far = _mm_mul_ps(far, _mm_permute_ps::<0b1111_1110>(x));
    let apart = _mm256_permutevar8x32_ps(near, _mm256_setr_epi32(3, 4, 5, 5, 6, 7, 7, 7));
    let second = _mm256_castps256_ps128(apart);
    let third = _mm_shuffle_ps::<0b0000_0100>(_mm256_extractf128_ps::<1>(apart), far);
    let fourth = _mm_permute_ps::<0b1111_1001>(far);
    let first_two = _mm_add_ps(_mm256_castps256_ps128(near), second);
    let sum = _mm_add_ps(first_two, _mm_add_ps(third, fourth));
    let mut out = [0.0; 4];
    // Safe: `out` has space for four values.
    unsafe { _mm_storeu_ps(out.as_mut_ptr(), sum) };
    out
}

/// Returns the weights of four pixels in a row or column by Catmull–Rom splines. `t` is the distance from the second one,
/// pixels.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline]
fn weights_avx2(t: f32) -> std::arch::x86_64::__m128 {
    use std::arch::x86_64::*;
    let t = _mm_set1_ps(t);
    let [c3, c2, c1, c0] = [
        _mm_setr_ps(-0.5, 1.5, -1.5, 0.5),
        _mm_setr_ps(1.0, -2.5, 2.0, -0.5),
        _mm_setr_ps(-0.5, 0.0, 0.5, 0.0),
        _mm_setr_ps(0.0, 1.0, 0.0, 0.0),
    ];
    _mm_fmadd_ps(_mm_fmadd_ps(_mm_fmadd_ps(c3, t, c2), t, c1), t, c0)
}

#[inline(always)]
fn add(sum: &mut [f32; 4], weight: f32, values: &[f32]) {
    for (sum, v) in sum.iter_mut().zip(values) {
        *sum += weight * v;
    }
}

/// Interpolates an image at many positions by Catmull–Rom splines. Writes one value per channel and position into
/// `out`.
pub(crate) fn sample_all(
    image: &Image,
    positions: impl Iterator<Item = [f32; 2]>,
    out: &mut [f32],
) {
    fn into_out<const C: usize>(
        image: &Image,
        positions: impl Iterator<Item = [f32; 2]>,
        out: &mut [f32],
    ) {
        let places = positions.zip(out.chunks_exact_mut(C));
        sample_each::<C, _>(image, places, Sampling::Cubic, |out, v| out.copy_from_slice(&v));
    }
    match image.channels() {
        1 => into_out::<1>(image, positions, out),
        _ => into_out::<3>(image, positions, out),
    }
}

multiversion! {
    /// Interpolates an image of C channels at many positions. Each element of `places` is a position, pixels, and any
    /// value of the caller. For each, `put` is called with the caller's value and the interpolated pixel.
    pub(crate) fn sample_each[const C: usize, T](
        image: &Image,
        places: impl Iterator<Item = ([f32; 2], T)>,
        sampling: Sampling,
        put: impl FnMut(T, [f32; C]),
    ) = sample_each_by
}

#[inline(always)]
fn sample_each_by<const C: usize, T>(
    image: &Image,
    places: impl Iterator<Item = ([f32; 2], T)>,
    sampling: Sampling,
    mut put: impl FnMut(T, [f32; C]),
) {
    for ([x, y], with) in places {
        put(with, sample(image, x, y, sampling));
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
