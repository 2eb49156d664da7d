//! SSIM: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to structural similarity",
//! IEEE TIP 13(4), 2004, with the constants of that paper.
//!
//! Implemented here, because the crate `image-compare` (0.5) takes 8 bits only, and `dssim` is a different metric.

use super::filter::{gaussian, normalized, separable};
use crate::raster::Image;
use rayon::prelude::*;

/// Standard deviation of the Gaussian window, pixels, as in the SSIM paper.
const WINDOW_SIGMA_PX: f64 = 1.5;
/// Radius of the window, pixels. The window has 11×11 pixels, as in the SSIM paper. If a pixel's window reaches beyond
/// the image, the pixel is excluded from mean SSIM.
pub const WINDOW_RADIUS_PX: usize = 5;
/// C₁ = (K₁L)² of the SSIM paper, with K₁ = 0.01 and L = 1, the range of the samples.
const C1: f64 = 0.01 * 0.01;
/// C₂ = (K₂L)² of the SSIM paper, with K₂ = 0.03 and L = 1, the range of the samples.
const C2: f64 = 0.03 * 0.03;

/// Returns the SSIM (eq. 13 of the SSIM paper) of two grey images with display-encoded values: one value per pixel,
/// row-major, in −1..=1.
///
/// Border pixels are replicated for windows that reach beyond the image. Use [`has_full_window`] to exclude the values
/// of these windows from a mean.
///
/// # Panics
/// If the images differ in size or are not grey.
pub fn ssim_map(a: &Image, b: &Image) -> Vec<f32> {
    assert_eq!((a.width(), a.height(), a.channels()), (b.width(), b.height(), 1));
    assert_eq!(a.channels(), 1);
    let window = normalized(&gaussian(WINDOW_SIGMA_PX, WINDOW_RADIUS_PX));
    // Computed in f64: a variance is a small difference of large means, of the order of C₂.
    let mean = |plane: &[f64]| separable(plane, a.width(), &window, &window);
    let product =
        |p: &[f64], q: &[f64]| mean(&p.iter().zip(q).map(|(p, q)| p * q).collect::<Vec<_>>());
    let samples = |image: &Image| image.data().iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let (x, y) = (samples(a), samples(b));
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let (mean_xx, mean_yy, mean_xy) = (product(&x, &x), product(&y, &y), product(&x, &y));
    (0..x.len())
        .into_par_iter()
        .map(|k| {
            let (mx, my) = (mean_x[k], mean_y[k]);
            let (vx, vy) = (mean_xx[k] - mx * mx, mean_yy[k] - my * my);
            let covariance = mean_xy[k] - mx * my;
            let similarity = (2.0 * mx * my + C1) * (2.0 * covariance + C2)
                / ((mx * mx + my * my + C1) * (vx + vy + C2));
            similarity as f32
        })
        .collect()
}

/// Returns whether the window around the pixel (x, y) lies within an image of this width and height.
pub fn has_full_window(x: usize, y: usize, width: usize, height: usize) -> bool {
    let r = WINDOW_RADIUS_PX;
    x >= r && y >= r && x + r < width && y + r < height
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(shift: usize) -> Image {
        let value = |k: usize| ((k * 7919 + shift * 31) % 97) as f32 / 96.0;
        Image::from_data(24, 20, 1, (0..480).map(value).collect())
    }

    #[test]
    fn identical_images_have_one_everywhere() {
        let map = ssim_map(&texture(0), &texture(0));
        assert!(map.iter().all(|v| (v - 1.0).abs() < 1e-6));
    }

    #[test]
    fn two_constants_leave_the_luminance_term() {
        let (a, b) = (Image::filled(16, 16, 1, 0.25), Image::filled(16, 16, 1, 0.75));
        let expected = (2.0 * 0.25 * 0.75 + 1e-4) / (0.25f32.powi(2) + 0.75f32.powi(2) + 1e-4);
        let map = ssim_map(&a, &b);
        assert!(map.iter().all(|v| (v - expected).abs() < 1e-4), "{} {expected}", map[0]);
    }

    #[test]
    fn equals_the_definition_where_the_window_fits() {
        let (a, b) = (texture(0), texture(5));
        let map = ssim_map(&a, &b);
        let (x0, y0) = (11usize, 9usize);
        let mut sums = [0.0f64; 6];
        for dy in -5isize..=5 {
            for dx in -5isize..=5 {
                let w = (-((dx * dx + dy * dy) as f64) / (2.0 * 1.5 * 1.5)).exp();
                let (x, y) = ((x0 as isize + dx) as usize, (y0 as isize + dy) as usize);
                let (p, q) = (f64::from(a.pixel(x, y)[0]), f64::from(b.pixel(x, y)[0]));
                for (sum, v) in sums.iter_mut().zip([1.0, p, q, p * p, q * q, p * q]) {
                    *sum += w * v;
                }
            }
        }
        let [_, mx, my, xx, yy, xy] = sums.map(|s| s / sums[0]);
        let expected = (2.0 * mx * my + 1e-4) * (2.0 * (xy - mx * my) + 9e-4)
            / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
        let value = f64::from(map[y0 * 24 + x0]);
        assert!((value - expected).abs() < 1e-5, "{value} {expected}");
    }

    #[test]
    fn windows_fit_from_the_fifth_pixel_on() {
        assert!(has_full_window(5, 5, 11, 11));
        assert!(!has_full_window(4, 5, 11, 11) && !has_full_window(6, 5, 11, 11));
        assert!(!has_full_window(3, 3, 8, 8));
    }
}
