//! Textures in closed form, as a camera would store them.

use stlfr::random::Random;
use stlfr::raster::Image;

/// A texture of twelve waves; in colour, its channels differ.
pub fn waves(random: &mut Random, channels: usize) -> impl Fn(f64, f64, usize) -> f64 + use<> {
    let waves: Vec<[f64; 4]> = (0..12)
        .map(|_| {
            let angle = 6.3 * random.unit();
            let number = 0.15 + 0.55 * random.unit();
            [number * angle.cos(), number * angle.sin(), 6.3 * random.unit(), 0.1 * random.unit()]
        })
        .collect();
    move |x, y, c| {
        let phase = if channels == 1 { 0.0 } else { c as f64 };
        0.5 + waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2] + phase).sin()).sum::<f64>()
    }
}

/// A texture as a camera would store it: `steps` are 255 or 65535.
pub fn pictured(
    w: usize,
    h: usize,
    channels: usize,
    steps: f64,
    value: impl Fn(f64, f64, usize) -> f64,
) -> Image {
    let data = (0..w * h * channels)
        .map(|k| {
            let (x, y) = ((k / channels % w) as f64 + 0.5, (k / channels / w) as f64 + 0.5);
            ((value(x, y, k % channels).clamp(0.0, 1.0) * steps).round() / steps) as f32
        })
        .collect();
    Image::from_data(w, h, channels, data)
}
