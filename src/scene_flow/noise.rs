//! Noise of an image (Immerkær, *Fast noise variance estimation*, 1996): the response to a mask that is zero on linear
//! brightness. Textures have a response too, so that only the smoothest parts of the image are used.
//!
//! Known limit: noise is taken as independent from pixel to pixel. That of compressed videos isn't, and is larger than what is
//! measured.

/// Side of the blocks in which the noise is measured, pixels. Larger: fewer blocks are free of texture. Smaller: the smoothest
/// blocks are smooth by chance.
const BLOCK: usize = 12;
/// Fraction of the blocks with a smaller response than the one whose response counts. Larger: textures count as noise.
/// Smaller: single blocks decide.
const QUANTILE: f64 = 0.05;
/// Response of the block at [`QUANTILE`], as a fraction of the mean response of blocks that show nothing but noise.
const SMOOTHEST: f32 = 0.87;
/// Range of a block's mean brightness, 0 to 1. Beyond it, noise is clipped.
const UNCLIPPED: [f32; 2] = [0.06, 0.94];
/// Standard deviation of the response of the mask to noise with a standard deviation of 1.
const RESPONSE: f32 = 6.0;
/// Standard deviation of a normal distribution with a mean magnitude of 1: √(π/2).
const DEVIATION: f32 = 1.253_314_1;
/// Standard deviation up to which the response may be that of fine textures and of rounding to 8 bits. In films without
/// noise that are textured everywhere, it is up to 0.0021.
const TEXTURE: f32 = 0.0025;

/// Returns the standard deviation of the noise of an image's brightness. `brightness` is from 0 to 1, row by row. The
/// result is 0 if the noise can't be told from rounding and textures, and if the whole image is dark or bright. `filmed`
/// tells which pixels were filmed; it is empty if all were.
pub fn standard_deviation(width: usize, brightness: &[f32], filmed: &[bool]) -> f32 {
    let height = brightness.len() / width.max(1);
    let columns = width.saturating_sub(2) / BLOCK;
    let rows = height.saturating_sub(2) / BLOCK;
    let of = |k: usize| {
        block(width, (brightness, filmed), (1 + k % columns * BLOCK, 1 + k / columns * BLOCK))
    };
    let mut responses: Vec<f32> = (0..columns * rows).filter_map(of).collect();
    if responses.is_empty() {
        return 0.0;
    }
    let at = (QUANTILE * responses.len() as f64) as usize; // less than the length
    let (_, response, _) = responses.select_nth_unstable_by(at, f32::total_cmp);
    let deviation = DEVIATION * *response / (RESPONSE * SMOOTHEST);
    (deviation * deviation - TEXTURE * TEXTURE).max(0.0).sqrt()
}

/// Returns the mean magnitude of the mask's response in the block from pixel `(x, y)` on. `None` if the block is too dark
/// or too bright, or not filmed as a whole.
fn block(
    width: usize,
    (brightness, filmed): (&[f32], &[bool]),
    (x, y): (usize, usize),
) -> Option<f32> {
    let is_filmed = |v: usize| filmed[v * width..][x - 1..x + BLOCK + 1].iter().all(|f| *f);
    if !(filmed.is_empty() || (y - 1..y + BLOCK + 1).all(is_filmed)) {
        return None;
    }
    let (mut sum, mut mean) = (0.0, 0.0);
    for v in y..y + BLOCK {
        for u in x..x + BLOCK {
            let at = |dx: usize, dy: usize| brightness[(v + dy - 1) * width + u + dx - 1];
            let corners = at(0, 0) + at(2, 0) + at(0, 2) + at(2, 2);
            let sides = at(1, 0) + at(0, 1) + at(2, 1) + at(1, 2);
            sum += (corners - 2.0 * sides + 4.0 * at(1, 1)).abs();
            mean += at(1, 1);
        }
    }
    let pixels = (BLOCK * BLOCK) as f32;
    let [min, max] = UNCLIPPED;
    (min..=max).contains(&(mean / pixels)).then_some(sum / pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const WIDTH: usize = 160;

    /// Returns an image that is half a ramp and half stripes, with noise and rounded to 8 bits.
    fn image(noise: f64) -> Vec<f32> {
        let mut random = Random::new(7);
        let value = |k: usize| {
            let (x, y) = ((k % WIDTH) as f64, (k / WIDTH) as f64);
            let clean = if y < 60.0 { 0.2 + 0.003 * x } else { 0.5 + 0.3 * (1.9 * x).sin() };
            ((255.0 * (clean + noise * random.gaussian())).round() / 255.0) as f32
        };
        (0..WIDTH * 120).map(value).collect()
    }

    #[test]
    fn noise_is_measured_beside_textures() {
        for noise in [0.005, 0.01, 0.03] {
            let found = f64::from(standard_deviation(WIDTH, &image(noise), &[]));
            let expected = (noise * noise - f64::from(TEXTURE * TEXTURE)).sqrt();
            assert!((0.8..1.15).contains(&(found / expected)), "{noise}: {found}");
        }
    }

    #[test]
    fn what_was_not_filmed_says_nothing_of_noise() {
        let mut image = image(0.01);
        let mut filmed = vec![true; image.len()];
        // The margins are plain.
        let is_margin = |k: usize| k % WIDTH < 20 || k % WIDTH >= WIDTH - 20;
        for k in (0..image.len()).filter(|&k| is_margin(k)) {
            (image[k], filmed[k]) = (0.5, false);
        }
        assert!(standard_deviation(WIDTH, &image, &filmed) > 0.007);
        assert_eq!(standard_deviation(WIDTH, &image, &[]), 0.0);
    }

    #[test]
    fn rounding_is_no_noise() {
        assert_eq!(standard_deviation(WIDTH, &image(0.0), &[]), 0.0);
    }

    #[test]
    fn black_and_tiny_images_have_no_noise() {
        assert_eq!(standard_deviation(WIDTH, &vec![0.0; WIDTH * 120], &[]), 0.0);
        assert_eq!(standard_deviation(3, &[0.5; 9], &[]), 0.0);
        assert_eq!(standard_deviation(0, &[], &[]), 0.0);
    }
}
