//! §5.3: Beier and Neely's morph (SIGGRAPH '92) with boosted real edges, eqs. (7) and (8).
//!
//! Every edge maps the plane so that its line at the instant goes to its line in the source frame. A pixel's
//! source is the weighted mean of the sources by all edges. The warp is evaluated at the nodes of a
//! grid and bilinearly interpolated between them (a grid of 1 pixel is exact).

use super::edge_set::Edge;
use super::{MorphOptions, Warp};
use rayon::prelude::*;

/// An edge as the inner loop uses it: the displacement at X is map·(X − p) + shift.
#[derive(Clone, Copy, Debug)]
struct Line {
    p: [f32; 2],
    /// Unit direction at the instant.
    direction: [f32; 2],
    length: f32,
    /// The linear part of the displacement, row by row.
    map: [f32; 4],
    /// The displacement of p.
    shift: [f32; 2],
    /// The logarithm of L^(ρb) times the boost of eq. (8), which f64 holds for any exponents.
    log_strength: f64,
    /// L^(ρb) times the boost; used for the usual exponents only, where f32 holds it.
    strength: f32,
}

/// Minimum length of an edge, at the instant and in the source, pixels. Larger: short edges do not count;
/// smaller: the direction of coincident ends is rounding.
const MIN_LENGTH_PX: f64 = 1e-3;
/// Minimum of a + D in eq. (7), pixels, so that no weight is infinite. Larger: edges do not pass exactly where
/// `a` is 0; smaller: weights overflow f32.
const MIN_DISTANCE_PX: f32 = 1e-3;

/// The warp (§5.3) that takes a source frame of `width`×`height` pixels to the instant, by the edges' lines in
/// both and their weights, eqs. (7) and (8). Without edges that have a direction it is the identity.
pub fn morph_warp(edges: &[Edge], width: usize, height: usize, options: &MorphOptions) -> Warp {
    let lines = lines(edges, options);
    if lines.is_empty() {
        return Warp::identity(width, height);
    }
    let step = options.grid_px.max(1);
    // Nodes stand on pixel centres, the first on the first pixel's; the last beyond the image.
    let nodes_x = (width - 1).div_ceil(step) + 1;
    let nodes_y = (height - 1).div_ceil(step) + 1;
    let node_rows: Vec<Vec<[f32; 2]>> = (0..nodes_y)
        .into_par_iter()
        .map(|ny| displacement_row(&lines, nodes_x, step, (ny * step) as f32 + 0.5, options))
        .collect();
    let mut warp = Warp::identity(width, height);
    warp.source.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let (ny, fy) = (y / step, (y % step) as f32 / step as f32);
        let (top, bottom) = (&node_rows[ny], &node_rows[(ny + 1).min(nodes_y - 1)]);
        for (x, source) in row.iter_mut().enumerate() {
            let (nx, fx) = (x / step, (x % step) as f32 / step as f32);
            let right = (nx + 1).min(nodes_x - 1);
            for (axis, s) in source.iter_mut().enumerate() {
                let upper = top[nx][axis] + (top[right][axis] - top[nx][axis]) * fx;
                let lower = bottom[nx][axis] + (bottom[right][axis] - bottom[nx][axis]) * fx;
                *s += upper + (lower - upper) * fy;
            }
        }
    });
    warp
}

/// The edges that have a direction, with the boost of eq. (8).
fn lines(edges: &[Edge], options: &MorphOptions) -> Vec<Line> {
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
const LANES: usize = 8;

/// The displacements at the nodes of one row of the grid, at `y` pixels.
fn displacement_row(
    lines: &[Line],
    nodes: usize,
    step: usize,
    y: f32,
    options: &MorphOptions,
) -> Vec<[f32; 2]> {
    let mut row = Vec::with_capacity(nodes.next_multiple_of(LANES));
    while row.len() < nodes {
        let xs: [f32; LANES] = std::array::from_fn(|l| ((row.len() + l) * step) as f32 + 0.5);
        row.extend(displacements(lines, &xs, y, options));
    }
    row.truncate(nodes);
    row
}

/// The displacements at eight positions of a row.
fn displacements(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    options: &MorphOptions,
) -> [[f32; 2]; LANES] {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has the feature. The operations are the same, and so the results.
        return unsafe { displacements_avx2(lines, xs, y, options) };
    }
    displacements_any(lines, xs, y, options)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn displacements_avx2(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    options: &MorphOptions,
) -> [[f32; 2]; LANES] {
    displacements_any(lines, xs, y, options)
}

#[inline(always)]
fn displacements_any(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    options: &MorphOptions,
) -> [[f32; 2]; LANES] {
    let a = options.a as f32;
    // f32 holds the weights of the usual exponents: (1/MIN_DISTANCE)⁴ · 2^32 = 4e21.
    if options.tau <= 32.0 && options.rho == 0.0 {
        if options.b == 2.0 {
            return accumulate(lines, xs, y, a, |r| r * r);
        }
        if options.b == 3.0 {
            return accumulate(lines, xs, y, a, |r| r * r * r);
        }
        if options.b == 4.0 {
            return accumulate(lines, xs, y, a, |r| (r * r) * (r * r));
        }
    }
    xs.map(|x| displacement_exact(lines, x, y, options))
}

/// Eq. (7), vectorized: Σ weight · displacement / Σ weight; `power` is 1/distance ↦ 1/distance^b.
#[inline(always)]
fn accumulate(
    lines: &[Line],
    xs: &[f32; LANES],
    y: f32,
    a: f32,
    power: impl Fn(f32) -> f32,
) -> [[f32; 2]; LANES] {
    let (mut sum, mut sum_x, mut sum_y) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    for line in lines {
        let py = y - line.p[1];
        let [m0, m1, m2, m3] = line.map;
        for l in 0..LANES {
            let px = xs[l] - line.p[0];
            let along = px * line.direction[0] + py * line.direction[1];
            let across = py * line.direction[0] - px * line.direction[1];
            let beyond = along - along.max(0.0).min(line.length);
            let distance = (beyond * beyond + across * across).sqrt();
            let weight = line.strength * power(1.0 / (a + distance).max(MIN_DISTANCE_PX));
            sum[l] += weight;
            sum_x[l] += weight * (m0 * px + m1 * py + line.shift[0]);
            sum_y[l] += weight * (m2 * px + m3 * py + line.shift[1]);
        }
    }
    // A weight is at least 1/(2^16)^4 · strength ≥ 5e-20, so the sum is not 0.
    std::array::from_fn(|l| [sum_x[l] / sum[l], sum_y[l] / sum[l]])
}

/// Eq. (7): the displacement at one position for any exponents, in f64. The weights' logarithms are relative to the
/// largest, so that none overflows and not all vanish.
fn displacement_exact(lines: &[Line], x: f32, y: f32, options: &MorphOptions) -> [f32; 2] {
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

#[cfg(test)]
mod tests {
    use super::super::edges::Feature;
    use super::*;
    use nalgebra::{Point2, Rotation2, Vector2};

    fn edge(
        a: [f64; 2],
        b: [f64; 2],
        fitness: Option<f64>,
        move_by: fn(Point2<f64>) -> Point2<f64>,
    ) -> Edge {
        let feature = |p: [f64; 2]| {
            let target = Point2::from(p);
            let source = move_by(target);
            Feature { source, other: source, target }
        };
        Edge { ends: [feature(a), feature(b)], mean_fitness: fitness }
    }

    fn scattered(move_by: fn(Point2<f64>) -> Point2<f64>) -> Vec<Edge> {
        (0..40)
            .map(|k| {
                let k = f64::from(k);
                let a = [20.0 + 18.0 * (k * 1.7).sin(), 15.0 + 13.0 * (k * 2.9).cos()];
                let b = [a[0] + 5.0 * (k * 0.9).cos(), a[1] + 5.0 * (k * 0.9).sin()];
                edge(a, b, (k % 3.0 == 0.0).then_some(0.1 + k * 0.01), move_by)
            })
            .collect()
    }

    #[test]
    fn similarities_are_reproduced_whatever_the_weights() {
        let shift: fn(Point2<f64>) -> Point2<f64> = |p| p + Vector2::new(3.0, -2.0);
        let turn: fn(Point2<f64>) -> Point2<f64> =
            |p| Rotation2::new(0.1) * p + Vector2::new(1.0, 0.5);
        for move_by in [shift, turn] {
            let edges = scattered(move_by);
            for (b, grid_px) in [(2.0, 1), (4.0, 4), (3.0, 7), (2.5, 3)] {
                let options = MorphOptions { b, grid_px, ..Default::default() };
                let warp = morph_warp(&edges, 40, 30, &options);
                for (k, source) in warp.source.iter().enumerate() {
                    let at = Point2::new((k % 40) as f64 + 0.5, (k / 40) as f64 + 0.5);
                    let expected = move_by(at);
                    let error =
                        (Point2::new(f64::from(source[0]), f64::from(source[1])) - expected).norm();
                    assert!(error < 1e-3, "{b} {at} {error}");
                }
            }
        }
    }

    #[test]
    fn the_fast_sums_agree_with_the_exact_ones() {
        let bend: fn(Point2<f64>) -> Point2<f64> =
            |p| Point2::new(p.x + 3.0 * (p.y * 0.2).sin(), p.y + 2.0 * (p.x * 0.15).cos());
        let edges = scattered(bend);
        for b in [2.0, 3.0, 4.0] {
            for a in [0.0, 0.5, 1.0] {
                let options = MorphOptions { a, b, ..Default::default() };
                let lines = lines(&edges, &options);
                for y in [0.5, 13.5, 29.5] {
                    let xs: [f32; LANES] = std::array::from_fn(|l| l as f32 * 5.0 + 0.5);
                    let fast = displacements(&lines, &xs, y, &options);
                    let portable = displacements_any(&lines, &xs, y, &options);
                    assert_eq!(fast, portable);
                    for (x, d) in xs.iter().zip(fast) {
                        let exact = displacement_exact(&lines, *x, y, &options);
                        assert!((d[0] - exact[0]).abs() < 1e-3 && (d[1] - exact[1]).abs() < 1e-3);
                    }
                }
            }
        }
    }

    #[test]
    fn on_an_edge_with_a_of_zero_that_edge_alone_counts() {
        let edges = [
            edge([10.5, 5.5], [10.5, 25.5], None, |p| p + Vector2::new(2.0, 0.0)),
            edge([30.5, 5.5], [30.5, 25.5], None, |p| p),
        ];
        let options = MorphOptions { a: 0.0, grid_px: 1, ..Default::default() };
        let warp = morph_warp(&edges, 40, 30, &options);
        let [x, y] = warp.source[15 * 40 + 10];
        assert!((x - 12.5).abs() < 1e-4 && (y - 15.5).abs() < 1e-4);
    }

    #[test]
    fn extreme_exponents_stay_finite() {
        let edges = scattered(|p| p + Vector2::new(1.0, 1.0));
        for (a, b, tau, rho) in [
            (0.0, 32.0, 32.0, 1.0),
            (0.0, 0.0, 0.0, 0.0),
            (1.0, 4.0, 32.0, 0.0),
            (0.0, 4.0, 10.0, 0.5),
        ] {
            let options = MorphOptions { a, b, rho, tau, grid_px: 4 };
            let mut edges = edges.clone();
            // As long as the largest image: L^(ρb) is 1e128.
            edges.push(edge([0.0, 0.0], [1e4, 0.0], Some(0.3), |p| p));
            let warp = morph_warp(&edges, 40, 30, &options);
            assert!(warp.source.iter().flatten().all(|v| v.is_finite()), "{options:?}");
        }
    }

    #[test]
    fn points_and_empty_sets_give_the_identity() {
        let point = edge([5.0, 5.0], [5.0, 5.0], Some(1.0), |p| p + Vector2::new(9.0, 9.0));
        assert_eq!(morph_warp(&[point], 8, 6, &MorphOptions::default()), Warp::identity(8, 6));
        assert_eq!(morph_warp(&[], 1, 1, &MorphOptions::default()), Warp::identity(1, 1));
    }
}
