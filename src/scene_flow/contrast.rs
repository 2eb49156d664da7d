//! Local contrast of an image, which doesn't depend on the camera's exposure and white balance.

use crate::raster::Image;

/// Value of a pixel that equals the mean of its surroundings.
const NEUTRAL: f32 = 0.5;
/// Value that is added to the mean before the division by it, so that the noise of black surfaces isn't amplified.
const DARK: f32 = 0.02;

/// Divides each value of a gamma-encoded image by the mean of the values of its channel up to `radius_px` pixels away
/// (maximum norm). A gain multiplies both by about the same factor. Equal values become 0.5, and values from twice the
/// mean on become 1.
pub fn local_contrast(image: &Image, radius_px: usize) -> Image {
    let means = box_means(image, radius_px);
    let ratio = |(value, mean): (&f32, f32)| {
        // The denominator is positive.
        (NEUTRAL * (value + DARK) / (mean + DARK)).min(1.0)
    };
    let data = image.data().iter().zip(means).map(ratio).collect();
    Image::from_data(image.width(), image.height(), image.channels(), data)
}

/// Returns, for each value of an image, the mean of its channel's values up to `radius_px` pixels away (maximum norm).
fn box_means(image: &Image, radius_px: usize) -> Vec<f32> {
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let span =
        |at: usize, size: usize| at.saturating_sub(radius_px)..(at + radius_px + 1).min(size);
    let at = |x: usize, y: usize, c: usize| (y * width + x) * channels + c;
    // Means along rows, then along columns. Sums are prefix sums in f64, so that differences of them are exact enough.
    let along = |values: &[f32], size: usize, place: &dyn Fn(usize) -> usize, out: &mut [f32]| {
        let mut sums = vec![0.0; size + 1];
        (0..size).for_each(|k| sums[k + 1] = sums[k] + f64::from(values[place(k)]));
        for k in 0..size {
            let span = span(k, size);
            let sum: f64 = sums[span.end] - sums[span.start];
            out[place(k)] = (sum / span.len() as f64) as f32;
        }
    };
    let mut rows = vec![0.0; image.data().len()];
    let mut all = rows.clone();
    for c in 0..channels {
        (0..height).for_each(|y| along(image.data(), width, &|x| at(x, y, c), &mut rows));
        (0..width).for_each(|x| along(&rows, height, &|y| at(x, y, c), &mut all));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn textured(gain: f32) -> Image {
        let value = |k: usize| gain * (0.3 + 0.02 * ((7 * k) % 11) as f32);
        Image::from_data(9, 7, 3, (0..9 * 7 * 3).map(value).collect())
    }

    #[test]
    fn a_gain_hardly_changes_the_contrast() {
        let [one, other] = [1.0, 1.3].map(|gain| local_contrast(&textured(gain), 2));
        let difference = |(a, b): (&f32, &f32)| (a - b).abs();
        let worst = one.data().iter().zip(other.data()).map(difference).fold(0.0, f32::max);
        assert!(worst < 0.005, "{worst}");
        assert!(one.data().iter().any(|v| (v - 0.5).abs() > 0.05));
    }

    #[test]
    fn means_are_those_of_the_definition() {
        let image = textured(1.0);
        let means = box_means(&image, 2);
        for (x, y) in [(0, 0), (4, 3), (8, 6), (1, 5)] {
            let (mut sum, mut count) = (0.0, 0.0);
            for v in 0..7_usize {
                for u in 0..9_usize {
                    if u.abs_diff(x) <= 2 && v.abs_diff(y) <= 2 {
                        sum += image.pixel(u, v)[1];
                        count += 1.0;
                    }
                }
            }
            assert!((means[(y * 9 + x) * 3 + 1] - sum / count).abs() < 1e-6);
        }
    }

    #[test]
    fn black_and_plain_images_have_no_contrast() {
        for value in [0.0, 0.7] {
            let plain = local_contrast(&Image::filled(5, 4, 3, value), 3);
            assert!(plain.data().iter().all(|v| (v - 0.5).abs() < 1e-6));
        }
    }
}
