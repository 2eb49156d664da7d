//! Drawing on images: lines, arrows, dots and magnified parts.

use nalgebra::{Point2, Vector2};
use stlfr::raster::Image;

pub type Color = [f32; 3];

pub const BLUE: Color = [0.05, 0.25, 0.95];
pub const RED: Color = [0.9, 0.08, 0.08];
pub const YELLOW: Color = [1.0, 0.85, 0.1];
pub const BLACK: Color = [0.05; 3];

/// A part of an image, pixels: left, top, width and height.
#[derive(Clone, Copy)]
pub struct Part(pub [usize; 4]);

/// The part, magnified by a whole factor by cubic convolution.
pub fn magnified(image: &Image, part: Part, factor: usize) -> Image {
    let [left, top, width, height] = part.0;
    let channels = image.channels();
    let mut data = vec![0.0; width * height * factor * factor * channels];
    for (k, out) in data.chunks_exact_mut(channels).enumerate() {
        let (x, y) = (k % (width * factor), k / (width * factor));
        let place = |v: usize, start: usize| start as f32 + (v as f32 + 0.5) / factor as f32;
        image.sample_cubic(place(x, left), place(y, top), out);
        out.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }
    Image::from_data(width * factor, height * factor, channels, data)
}

/// The image in grey and pale, so that drawings stand out.
pub fn pale(image: &Image) -> Image {
    let mut pale = image.to_gray().to_rgb();
    pale.data_mut().iter_mut().for_each(|v| *v = 0.35 + 0.6 * *v);
    pale
}

/// Mixes a colour into a pixel by `ink`, 0 to 1.
fn mix(image: &mut Image, x: usize, y: usize, ink: f32, color: Color) {
    let at = (y * image.width() + x) * 3;
    for (v, c) in image.data_mut()[at..at + 3].iter_mut().zip(color) {
        *v += (c - *v) * ink;
    }
}

/// A smooth line of a width in pixels, ends round.
pub fn line(image: &mut Image, [a, b]: [Point2<f64>; 2], color: Color, width_px: f64) {
    let reach = 0.5 * width_px + 1.0;
    let range = |p: f64, q: f64, size: usize| {
        let clamp = |v: f64| v.clamp(0.0, size as f64) as usize;
        clamp(p.min(q) - reach)..clamp((p.max(q) + reach).ceil())
    };
    if [a, b].iter().any(|p| !p.x.is_finite() || !p.y.is_finite()) {
        return;
    }
    let along = b - a;
    let squared = along.norm_squared().max(1e-12);
    for y in range(a.y, b.y, image.height()) {
        for x in range(a.x, b.x, image.width()) {
            let p = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            let nearest = a + along * ((p - a).dot(&along) / squared).clamp(0.0, 1.0);
            let ink = (0.5 * width_px + 0.5 - (p - nearest).norm()).clamp(0.0, 1.0);
            mix(image, x, y, ink as f32, color);
        }
    }
}

pub fn dot(image: &mut Image, at: Point2<f64>, color: Color, width_px: f64) {
    line(image, [at, at], color, width_px);
}

/// An arrow with an open head; without a head where it is shorter than one.
pub fn arrow(image: &mut Image, [from, to]: [Point2<f64>; 2], color: Color, width_px: f64) {
    const HEAD_PX: f64 = 5.0;
    line(image, [from, to], color, width_px);
    let along = to - from;
    if along.norm() > HEAD_PX {
        let back = along.normalize() * -HEAD_PX;
        let side = Vector2::new(-back.y, back.x) * 0.5;
        line(image, [to, to + back + side], color, width_px);
        line(image, [to, to + back - side], color, width_px);
    }
}

pub fn rectangle(image: &mut Image, part: Part, color: Color, width_px: f64) {
    let [x, y, w, h] = part.0.map(|v| v as f64);
    let corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)].map(|(x, y)| Point2::new(x, y));
    for k in 0..4 {
        line(image, [corners[k], corners[(k + 1) % 4]], color, width_px);
    }
}
