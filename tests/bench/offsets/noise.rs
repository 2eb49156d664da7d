//! Noise and quantization of a camera's sensor.

use stlfr::random::Random;
use stlfr::raster::Image;

/// The seed of a frame's noise. Noise of different frames is independent.
pub fn seed(camera: usize, frame: usize) -> u64 {
    (1000 * camera + frame) as u64
}

/// The image with Gaussian noise, clipped to 0..=1 and then quantized. `std` is the noise's standard deviation, a
/// fraction of full scale.
pub fn noisy(image: &Image, std: f64, bits: u32, seed: u64) -> Image {
    let random = &mut Random::new(seed);
    let levels = f64::from((1_u32 << bits) - 1);
    let data = image.data().iter().map(|v| {
        let noisy = f64::from(*v) + std * random.gaussian();
        ((noisy.clamp(0.0, 1.0) * levels).round() / levels) as f32
    });
    Image::from_data(image.width(), image.height(), image.channels(), data.collect())
}
