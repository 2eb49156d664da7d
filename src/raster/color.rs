//! Colour conversions: the sRGB transfer function (IEC 61966-2-1), and Rec. 709 luminance.

use nalgebra::RealField;

/// Rec. 709 luminance weights of linear red, green and blue. They sum to 1.
pub const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Converts a display-encoded (sRGB) value to linear light, both from 0 to 1. Negative values, which cubic filters
/// produce by overshoot, are converted by the linear segment of the curve.
pub fn linear_from_encoded<T: RealField + Copy>(v: T) -> T {
    let c = nalgebra::convert::<f64, T>;
    if v <= c(0.04045) { v / c(12.92) } else { ((v + c(0.055)) / c(1.055)).powf(c(2.4)) }
}

/// Converts linear light to a display-encoded (sRGB) value, both from 0 to 1. This is the inverse of
/// [`linear_from_encoded`].
pub fn encoded_from_linear<T: RealField + Copy>(v: T) -> T {
    let c = nalgebra::convert::<f64, T>;
    if v <= c(0.0031308) { v * c(12.92) } else { c(1.055) * v.powf(c(1.0 / 2.4)) - c(0.055) }
}

/// Returns the Rec. 709 weighted sum of an RGB pixel: the luma of display-encoded values, or the luminance of linear
/// values.
#[inline(always)]
pub fn luma(pixel: &[f32]) -> f32 {
    const WEIGHTS: [f32; 3] = [LUMINANCE[0] as f32, LUMINANCE[1] as f32, LUMINANCE[2] as f32];
    WEIGHTS[0] * pixel[0] + WEIGHTS[1] * pixel[1] + WEIGHTS[2] * pixel[2]
}

/// Converts a display-encoded RGB colour to the display-encoded grey value of the same luminance. A grey camera would
/// record this value.
pub fn gray_from_rgb(rgb: [f32; 3]) -> f32 {
    encoded_from_linear(luma(&rgb.map(linear_from_encoded)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_and_decoding_are_inverse() {
        for k in 0..=1000 {
            let v = f64::from(k) / 1000.0;
            assert!((encoded_from_linear(linear_from_encoded(v)) - v).abs() < 1e-7, "{v}");
        }
    }

    #[test]
    fn below_zero_the_curve_is_a_line() {
        assert_eq!(linear_from_encoded(-0.01_f64), -0.01 / 12.92);
        assert!((encoded_from_linear(linear_from_encoded(-0.01_f32)) + 0.01).abs() < 1e-7);
    }

    #[test]
    fn white_is_as_bright_as_each_of_its_channels() {
        assert!((luma(&[0.5; 3]) - 0.5).abs() < 1e-6);
        assert!((gray_from_rgb([0.5; 3]) - 0.5).abs() < 1e-6);
        assert!(gray_from_rgb([0.0, 1.0, 0.0]) > gray_from_rgb([1.0, 0.0, 0.0]));
    }
}
