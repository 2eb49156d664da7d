//! Local contrast of an image, which doesn't depend on the camera's exposure and white balance.

use crate::raster::{Image, box_filter};

/// Value of a pixel that equals the mean of its surroundings.
const NEUTRAL: f32 = 0.5;
/// Value that is added to numerator and denominator. Smaller: the noise of black surfaces is amplified. Larger: the
/// contrast of dark surfaces depends on the exposure.
const DARK: f32 = 0.02;

/// Divides each value of a gamma-encoded image by the mean of the values of its channel up to `radius_px` pixels away
/// (maximum norm). A gain multiplies value and mean by about the same factor. Values that equal the mean become 0.5, and
/// values of at least twice the mean become 1.
pub fn local_contrast(image: &Image, radius_px: usize) -> Image {
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let mut contrast = image.clone();
    for c in 0..channels {
        let plane: Vec<f32> = image.data().iter().skip(c).step_by(channels).copied().collect();
        let means = box_filter(&plane, width, height, radius_px);
        let values = contrast.data_mut().iter_mut().skip(c).step_by(channels);
        for (value, mean) in values.zip(means) {
            // The denominator is positive.
            *value = (NEUTRAL * (*value + DARK) / (mean + DARK)).min(1.0);
        }
    }
    contrast
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
    fn black_and_plain_images_have_no_contrast() {
        for value in [0.0, 0.7] {
            let plain = local_contrast(&Image::filled(5, 4, 3, value), 3);
            assert!(plain.data().iter().all(|v| (v - 0.5).abs() < 1e-6));
        }
    }
}
