//! One edge's displacement of the plane and its weight, eqs. (7) and (8), and their sums.

use super::super::MorphOptions;
use super::super::edge_set::Edge;
use crate::simd::multiversion;

/// An edge as the inner loop uses it: the displacement at X is map·(X − p) + shift.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub p: [f32; 2],
    /// Unit direction at the instant.
    pub direction: [f32; 2],
    pub length: f32,
    /// The linear part of the displacement, row by row.
    pub map: [f32; 4],
    /// The displacement of p.
    pub shift: [f32; 2],
    /// The logarithm of L^(ρb) times the boost of eq. (8), which f64 holds for any exponents.
    pub log_strength: f64,
    /// L^(ρb) times the boost; used for the usual exponents only, where f32 holds it.
    pub strength: f32,
}

/// Minimum length of an edge, at the instant and in the source, pixels. Larger: short edges do not count;
/// smaller: the direction of coincident ends is rounding.
const MIN_LENGTH_PX: f64 = 1e-3;
/// Minimum of a + D in eq. (7), pixels, so that no weight is infinite. Larger: edges do not pass exactly where
/// `a` is 0; smaller: weights overflow f32.
pub(super) const MIN_DISTANCE_PX: f32 = 1e-3;

/// The edges that have a direction, with the boost of eq. (8).
pub(super) fn lines(edges: &[Edge], options: &MorphOptions) -> Vec<Line> {
    let fitness = || edges.iter().filter_map(|e| e.mean_fitness);
    let min = fitness().fold(f64::INFINITY, f64::min);
    let range = fitness().fold(f64::NEG_INFINITY, f64::max) - min;
    edges
        .iter()
        .filter_map(|edge| {
            let [a, b] = &edge.ends;
            let (e, e_source) = (b.target - a.target, b.source - a.source);
            let (length, source_length) = (e.norm(), e_source.norm());
            if !(length >= MIN_LENGTH_PX && source_length >= MIN_LENGTH_PX) {
                return None;
            }
            // Beier and Neely's u runs with the edge's length, their v is in pixels:
            // X' = P' + e'·(e·(X−P))/L² + e'⊥·(e⊥·(X−P))/(L·L').
            let (along, across) = (length * length, length * source_length);
            let map = [
                e_source.x * e.x / along + e_source.y * e.y / across - 1.0,
                e_source.x * e.y / along - e_source.y * e.x / across,
                e_source.y * e.x / along - e_source.x * e.y / across,
                e_source.y * e.y / along + e_source.x * e.x / across - 1.0,
            ];
            let log_boost = edge.mean_fitness.map_or(0.0, |f| {
                let ratio = if range > 0.0 { (f - min) / range } else { 0.0 };
                options.tau * ratio.ln_1p()
            });
            // The length is at least MIN_LENGTH_PX, so its logarithm is finite.
            let log_strength = options.rho * options.b * length.ln() + log_boost;
            let direction = e / length;
            let shift = a.source - a.target;
            Some(Line {
                p: [a.target.x as f32, a.target.y as f32],
                direction: [direction.x as f32, direction.y as f32],
                length: length as f32,
                map: map.map(|v| v as f32),
                shift: [shift.x as f32, shift.y as f32],
                log_strength,
                strength: log_strength.exp() as f32,
            })
        })
        .collect()
}

/// Number of nodes that are computed at once: what an AVX2 register holds. It does not change results.
pub(super) const LANES: usize = 8;

/// The sums of eq. (7) at eight positions of a row: the weights, and the displacements times them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sums {
    pub weights: [f32; LANES],
    pub x: [f32; LANES],
    pub y: [f32; LANES],
}

impl Sums {
    /// The sums over both.
    pub fn plus(&self, other: &Self) -> Self {
        let add = |a: &[f32; LANES], b: &[f32; LANES]| std::array::from_fn(|l| a[l] + b[l]);
        Self {
            weights: add(&self.weights, &other.weights),
            x: add(&self.x, &other.x),
            y: add(&self.y, &other.y),
        }
    }

    /// The displacements. With an edge, a weight is at least 1/(2^16)^4 · strength ≥ 5e-20, so that the divisor isn't 0;
    /// without, they are no numbers.
    pub fn means(&self) -> [[f32; 2]; LANES] {
        std::array::from_fn(|l| [self.x[l] / self.weights[l], self.y[l] / self.weights[l]])
    }
}

/// The power of the distance, b of eq. (7), for which f32 holds all weights: (1/MIN_DISTANCE)⁴ · 2^32 = 4e21.
/// `None` for other exponents.
pub(super) fn integer_power(options: &MorphOptions) -> Option<i32> {
    let is_whole = [2.0, 3.0, 4.0].contains(&options.b);
    (is_whole && options.tau <= 32.0 && options.rho == 0.0).then_some(options.b as i32)
}

/// The displacements at eight positions of a row.
pub(super) fn displacements(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    options: &MorphOptions,
) -> [[f32; 2]; LANES] {
    match integer_power(options) {
        Some(power) => sums(lines, xs, y, options.a as f32, power).means(),
        None => xs.map(|x| displacement_exact(lines, x, y, options)),
    }
}

multiversion! {
    /// Eq. (7) for an exponent of [`integer_power`], vectorized.
    pub(super) fn sums(lines: &[Line], xs: &[f32; LANES], y: f32, a: f32, power: i32) -> Sums = sums_any
}

#[inline(always)]
pub(super) fn sums_any(lines: &[Line], xs: &[f32; LANES], y: f32, a: f32, power: i32) -> Sums {
    match power {
        2 => accumulate(lines, xs, y, a, |r| r * r),
        3 => accumulate(lines, xs, y, a, |r| r * r * r),
        _ => accumulate(lines, xs, y, a, |r| (r * r) * (r * r)),
    }
}

/// Σ weight, Σ weight · displacement; `power` is 1/distance ↦ 1/distance^b.
#[inline(always)]
fn accumulate(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    a: f32,
    power: impl Fn(f32) -> f32,
) -> Sums {
    let mut sums = Sums { weights: [0.0; LANES], x: [0.0; LANES], y: [0.0; LANES] };
    for line in lines {
        let py = y - line.p[1];
        let [m0, m1, m2, m3] = line.map;
        for (l, x) in xs.iter().enumerate() {
            let px = x - line.p[0];
            let along = px * line.direction[0] + py * line.direction[1];
            let across = py * line.direction[0] - px * line.direction[1];
            let beyond = along - along.max(0.0).min(line.length);
            let distance = (beyond * beyond + across * across).sqrt();
            let weight = line.strength * power(1.0 / (a + distance).max(MIN_DISTANCE_PX));
            sums.weights[l] += weight;
            sums.x[l] += weight * (m0 * px + m1 * py + line.shift[0]);
            sums.y[l] += weight * (m2 * px + m3 * py + line.shift[1]);
        }
    }
    sums
}

/// Eq. (7): the displacement at one position for any exponents, in f64. The weights' logarithms are relative to the
/// largest, so that none overflows and not all vanish.
pub(super) fn displacement_exact(
    lines: &[Line],
    x: f32,
    y: f32,
    options: &MorphOptions,
) -> [f32; 2] {
    let log_weight = |line: &Line| {
        let (px, py) = (f64::from(x - line.p[0]), f64::from(y - line.p[1]));
        let d = line.direction.map(f64::from);
        let along = px * d[0] + py * d[1];
        let across = py * d[0] - px * d[1];
        let distance = (along - along.clamp(0.0, f64::from(line.length))).hypot(across);
        line.log_strength - options.b * (options.a + distance).max(f64::from(MIN_DISTANCE_PX)).ln()
    };
    let largest = lines.iter().map(log_weight).fold(f64::NEG_INFINITY, f64::max);
    let mut sums = [0.0; 3];
    for line in lines {
        let (px, py) = (f64::from(x - line.p[0]), f64::from(y - line.p[1]));
        let weight = (log_weight(line) - largest).exp();
        let m = line.map.map(f64::from);
        sums[0] += weight;
        sums[1] += weight * (m[0] * px + m[1] * py + f64::from(line.shift[0]));
        sums[2] += weight * (m[2] * px + m[3] * py + f64::from(line.shift[1]));
    }
    [(sums[1] / sums[0]) as f32, (sums[2] / sums[0]) as f32]
}
