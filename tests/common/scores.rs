//! How far an image is from the one that a formula gives.

use stlfr::raster::Image;

/// The root mean square of the differences, over all but a border of `margin` pixels.
pub fn rms(a: &Image, b: &Image, margin: usize) -> f64 {
    assert_eq!((a.width(), a.height(), a.channels()), (b.width(), b.height(), b.channels()));
    let (mut sum, mut count) = (0.0, 0);
    for y in margin..a.height() - margin {
        for x in margin..a.width() - margin {
            for (a, b) in a.pixel(x, y).iter().zip(b.pixel(x, y)) {
                sum += f64::from(a - b).powi(2);
                count += 1;
            }
        }
    }
    (sum / f64::from(count)).sqrt()
}

/// The same as a peak signal-to-noise ratio, decibels.
pub fn psnr_db(a: &Image, b: &Image, margin: usize) -> f64 {
    -20.0 * rms(a, b, margin).log10()
}
