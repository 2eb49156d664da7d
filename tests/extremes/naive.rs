//! The paper's formulas as they stand, in f64, one pixel or one point at a time: the reference for
//! the fast code.

use nalgebra::{Point2, Vector2};
use stlfr::interpolation::Edge;
use stlfr::raster::Image;

/// An edge that is shorter is passed over, as `morph` documents it.
const MIN_PX: f64 = 1e-3;
/// a and b of eq. (7), β of eq. (6) and the distance of its samples, pixels.
const A_PX: f64 = 0.5;
const B: f64 = 4.0;
const BETA: f64 = 0.05;
const SAMPLE_STEP_PX: f64 = 2.0;
/// The minimum fitness of a real edge.
pub const MIN_FITNESS: f64 = 0.08;
/// How far the morph may be off, pixels, because far edges count in clusters.
pub const MORPH_TOLERANCE_PX: f64 = 0.02;

/// Where Beier and Neely's morph, eqs. (7) and (8), takes a pixel of the image from. `None` without
/// any edge that has a direction.
pub fn morph(edges: &[Edge], at: Point2<f64>, boost: f64) -> Option<Point2<f64>> {
    let fitness = || edges.iter().filter_map(|e| e.mean_fitness);
    let min = fitness().fold(f64::INFINITY, f64::min);
    let range = fitness().fold(f64::NEG_INFINITY, f64::max) - min;
    let mut found: Vec<(f64, Vector2<f64>)> = Vec::new();
    for edge in edges {
        let [p, q] = edge.ends.map(|e| e.target);
        let [p_source, q_source] = edge.ends.map(|e| e.source);
        let (line, line_source) = (q - p, q_source - p_source);
        let (length, length_source) = (line.norm(), line_source.norm());
        if length < MIN_PX || length_source < MIN_PX {
            continue;
        }
        let across = |v: Vector2<f64>| Vector2::new(-v.y, v.x);
        let u = (at - p).dot(&line) / line.norm_squared();
        let v = (at - p).dot(&across(line)) / length;
        let taken = p_source + u * line_source + v * across(line_source) / length_source;
        let distance = match u {
            u if u < 0.0 => (at - p).norm(),
            u if u > 1.0 => (at - q).norm(),
            _ => v.abs(),
        };
        let log_boost = edge.mean_fitness.map_or(0.0, |f| {
            let ratio = if range > 0.0 { (f - min) / range } else { 0.0 };
            boost * (1.0 + ratio).ln()
        });
        let log_weight = log_boost - B * (A_PX + distance).ln();
        found.push((log_weight, taken - at));
    }
    let largest = found.iter().map(|f| f.0).fold(f64::NEG_INFINITY, f64::max);
    let weights = found.iter().map(|(log, moved)| ((log - largest).exp(), moved));
    let (sum, moved) =
        weights.fold((0.0, Vector2::zeros()), |(sum, all), (w, moved)| (sum + w, all + w * moved));
    (sum > 0.0).then(|| at + moved / sum)
}

/// Scharr's gradient, from values around a place.
pub fn scharr(at: impl Fn(f64, f64) -> f64) -> Vector2<f64> {
    let along = |f: &dyn Fn(f64, f64) -> f64| {
        let side = |a: f64| 3.0 * f(a, -1.0) + 10.0 * f(a, 0.0) + 3.0 * f(a, 1.0);
        (side(1.0) - side(-1.0)) / 32.0
    };
    Vector2::new(along(&at), along(&|a, b| at(b, a)))
}

/// The same at a pixel of a grey image, borders repeated.
pub fn gradient(image: &Image, x: usize, y: usize) -> Vector2<f64> {
    scharr(|dx, dy| {
        let clamp =
            |v: usize, d: f64, size: usize| v.saturating_add_signed(d as isize).min(size - 1);
        f64::from(image.pixel(clamp(x, dx, image.width()), clamp(y, dy, image.height()))[0])
    })
}

/// Eq. (6), which is a minimum along a segment of a pixel or more, and the mean along it.
pub fn fitness(image: &Image, a: Point2<f64>, b: Point2<f64>) -> (f64, f64) {
    let line = b - a;
    let normal = Vector2::new(-line.y, line.x).normalize();
    let steps = (line.norm() / SAMPLE_STEP_PX).ceil().max(1.0) as usize;
    let values: Vec<f64> = (0..=steps)
        .map(|k| {
            let p = a + line * (k as f64 / steps as f64);
            let inside = |v: f64, size: usize| (v.max(0.0) as usize).min(size - 1);
            let g = gradient(image, inside(p.x, image.width()), inside(p.y, image.height()));
            let across = if g.norm() > 0.0 { g.dot(&normal).abs() / g.norm() } else { 0.0 };
            g.norm() + BETA * across
        })
        .collect();
    let min = values.iter().copied().fold(f64::INFINITY, f64::min);
    (min, values.iter().sum::<f64>() / values.len() as f64)
}

/// Catmull and Rom's cubic between pixels, borders repeated, as [`Image::sample_cubic`] documents it.
pub fn cubic(image: &Image, x: f64, y: f64, channel: usize) -> f64 {
    between(image, [x, y], channel, |f| {
        [
            0.5 * (-f + 2.0 * f * f - f * f * f),
            0.5 * (2.0 - 5.0 * f * f + 3.0 * f * f * f),
            0.5 * (f + 4.0 * f * f - 3.0 * f * f * f),
            0.5 * (f * f * f - f * f),
        ]
    })
}

/// The same, linearly.
pub fn bilinear(image: &Image, x: f64, y: f64, channel: usize) -> f64 {
    between(image, [x, y], channel, |f| [0.0, 1.0 - f, f, 0.0])
}

fn between(image: &Image, at: [f64; 2], channel: usize, weights: fn(f64) -> [f64; 4]) -> f64 {
    let split = |v: f64, size: usize| {
        let v = (v - 0.5).clamp(0.0, (size - 1) as f64);
        let places: [usize; 4] = std::array::from_fn(|k| {
            (v.floor() as isize + k as isize - 1).clamp(0, size as isize - 1) as usize
        });
        (places, weights(v.fract()))
    };
    let (columns, across) = split(at[0], image.width());
    let (rows, down) = split(at[1], image.height());
    let row = |y: usize| -> f64 {
        let values = columns.iter().map(|&x| f64::from(image.pixel(x, y)[channel]));
        values.zip(across).map(|(v, w)| v * w).sum()
    };
    rows.into_iter().zip(down).map(|(y, w)| w * row(y)).sum()
}
