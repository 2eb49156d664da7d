//! §5.3: Beier and Neely's morph (SIGGRAPH '92) with boosted real edges, eqs. (7) and (8).
//!
//! Each edge defines a similarity transform of the plane, which maps the edge at the instant to the edge in the
//! source frame. A pixel's source position is the weighted mean of the positions that all edges give. The warp is
//! evaluated at the nodes of a grid, and interpolated bilinearly between them. At a node, near edges are summed one
//! by one. Far edges are approximated by [`clusters`].

mod clusters;

use super::Warp;
use super::edge_set::Edge;
use crate::simd::multiversion;
use clusters::Clusters;
use rayon::prelude::*;

/// The constant a of eq. (7), pixels. An edge's weight falls with the distance as 1/(a + distance)^b, with b = 4. The
/// exponent ρ is 0, so that an edge's length has no effect on its weight.
const A_PX: f32 = 0.5;
/// Minimum length of an edge, both in the interpolated image and in the source frame, in pixels. A shorter edge has no
/// direction and is ignored.
const MIN_LENGTH_PX: f64 = 1e-3;
/// τ of eq. (8). A real edge weighs up to 2^τ times as much as a virtual edge.
pub const EDGE_BOOST: f64 = 4.0;
/// Largest exponent of the boost, eq. (8). At distance 0, an edge then weighs up to 2^32/a^4 = 7e10, which is within
/// the range of f32.
const MAX_BOOST: f64 = 32.0;
/// Number of grid nodes that are computed at once: the f32 lanes of an AVX2 register.
const LANES: usize = 8;
/// Number of grid nodes along each side of a tile. The displacements of all nodes of a tile are sums over the same
/// clusters of edges.
const TILE: usize = LANES;

/// Returns the backward warp (§5.3) from the interpolated image to a source frame. The warp follows from the edges'
/// positions in both images. `size` is the width and height of the frame in pixels. A real edge weighs up to 2^boost
/// times as much as a virtual edge, eq. (8). Boosts over 32 count as 32.
///
/// `grid_px` is the distance between the nodes at which the warp is evaluated. With 1, every pixel is a node. If all
/// edges are too short to have a direction, the warp is the identity.
pub fn morph_warp(edges: &[Edge], size: [usize; 2], boost: f64, grid_px: usize) -> Warp {
    let [width, height] = size;
    let lines = lines(edges, boost.min(MAX_BOOST));
    if lines.is_empty() {
        return Warp::identity(width, height);
    }
    let grid = NodeGrid::new(size, grid_px.max(1));
    let clusters = Clusters::new(&lines);
    let bands = (0..grid.nodes[1].div_ceil(TILE)).into_par_iter();
    let bands: Vec<Vec<[f32; 2]>> = bands.map(|band| tile_row(&clusters, &grid, band)).collect();
    let displacements = bands.concat();
    let mut warp = Warp::identity(width, height);
    warp.source.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let (top, bottom, fy) = grid.nodes_around(y, 1);
        let nodes = |ny: usize| &displacements[ny * grid.nodes[0]..(ny + 1) * grid.nodes[0]];
        let (top, bottom) = (nodes(top), nodes(bottom));
        for (x, source) in row.iter_mut().enumerate() {
            let (left, right, fx) = grid.nodes_around(x, 0);
            for (axis, s) in source.iter_mut().enumerate() {
                let upper = top[left][axis] + (top[right][axis] - top[left][axis]) * fx;
                let lower = bottom[left][axis] + (bottom[right][axis] - bottom[left][axis]) * fx;
                *s += upper + (lower - upper) * fy;
            }
        }
    });
    warp
}

/// The grid of nodes at which a warp is evaluated. Nodes are at pixel centres, and the first node is at the centre
/// of the top-left pixel. The last nodes may be outside the image.
struct NodeGrid {
    step: usize,
    /// Number of nodes along the x axis and along the y axis.
    nodes: [usize; 2],
}

impl NodeGrid {
    fn new(size: [usize; 2], step: usize) -> Self {
        Self { step, nodes: size.map(|size| (size - 1).div_ceil(step) + 1) }
    }

    /// Returns the coordinate of node number `node` along either axis, in pixels.
    fn at(&self, node: usize) -> f32 {
        (node * self.step) as f32 + 0.5
    }

    /// Returns the indices of the nodes before and after a pixel along an axis (0: x, 1: y). The third value is the
    /// fraction of the distance between these nodes at which the pixel is.
    fn nodes_around(&self, pixel: usize, axis: usize) -> (usize, usize, f32) {
        let before = pixel / self.step;
        let after = (before + 1).min(self.nodes[axis] - 1);
        (before, after, (pixel % self.step) as f32 / self.step as f32)
    }
}

/// Returns the displacements, in pixels, by which the warp moves the nodes of one row of tiles. `tile_row` is the index
/// of this row of tiles. The result is ordered by rows of nodes.
fn tile_row(clusters: &Clusters, grid: &NodeGrid, tile_row: usize) -> Vec<[f32; 2]> {
    let [across, down] = grid.nodes;
    let first_row = tile_row * TILE;
    let rows = TILE.min(down - first_row);
    let mut displacements = vec![[0.0; 2]; rows * across];
    for first in (0..across).step_by(TILE) {
        let lanes = TILE.min(across - first);
        let tile = clusters::Tile {
            xs: std::array::from_fn(|lane| grid.at(first + lane)),
            ys: (0..rows).map(|r| grid.at(first_row + r)).collect(),
            lanes,
        };
        for (row, sums) in displacements.chunks_mut(across).zip(clusters.sums(&tile)) {
            row[first..first + lanes].copy_from_slice(&sums.means()[..lanes]);
        }
    }
    displacements
}

/// An edge in the form that [`line_sums`] needs. The edge displaces a position X by map·(X − p) + shift. `p` is the
/// edge's first end in the interpolated image, pixels.
#[derive(Clone, Copy, Debug)]
struct Line {
    p: [f32; 2],
    /// Unit direction of the edge in the interpolated image.
    direction: [f32; 2],
    length: f32,
    /// Linear part of the displacement, a 2×2 matrix row by row.
    map: [f32; 4],
    /// Displacement at the position `p`, pixels.
    shift: [f32; 2],
    /// Factor of eq. (8) on the edge's weight: the boost of a real edge, and 1 for a virtual edge.
    strength: f32,
}

/// Converts edges to [`Line`]s with the boost of eq. (8). Edges that are too short to have a direction are left out.
fn lines(edges: &[Edge], boost: f64) -> Vec<Line> {
    let fitness = || edges.iter().filter_map(|e| e.mean_fitness);
    let min = fitness().fold(f64::INFINITY, f64::min);
    let range = fitness().fold(f64::NEG_INFINITY, f64::max) - min;
    let line = |edge: &Edge| {
        let [a, b] = &edge.ends;
        let (e, e_source) = (b.target - a.target, b.source - a.source);
        let (length, source_length) = (e.norm(), e_source.norm());
        if !(length >= MIN_LENGTH_PX && source_length >= MIN_LENGTH_PX) {
            return None;
        }
        // Beier and Neely's coordinate u along the edge is a fraction of the edge's length. Their coordinate v
        // across the edge is in pixels. Let e be the edge vector at the instant and e' the edge vector in the
        // source frame, with lengths L and L', and let ⊥ mark perpendicular vectors. Then the source position X' of
        // a position X is
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
            boost * ratio.ln_1p()
        });
        let direction = e / length;
        let shift = a.source - a.target;
        Some(Line {
            p: [a.target.x as f32, a.target.y as f32],
            direction: [direction.x as f32, direction.y as f32],
            length: length as f32,
            map: map.map(|v| v as f32),
            shift: [shift.x as f32, shift.y as f32],
            strength: log_boost.exp() as f32,
        })
    };
    edges.iter().filter_map(line).collect()
}

/// The sums of eq. (7) over edges, at eight positions of a row: the sum of the weights, and the sums of the weighted
/// displacements along x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
struct WarpSums {
    weights: [f32; LANES],
    x: [f32; LANES],
    y: [f32; LANES],
}

impl WarpSums {
    fn plus(&self, other: &Self) -> Self {
        let add = |a: [f32; LANES], b: [f32; LANES]| std::array::from_fn(|l| a[l] + b[l]);
        let (x, y) = (add(self.x, other.x), add(self.y, other.y));
        Self { weights: add(self.weights, other.weights), x, y }
    }

    /// Returns the weighted mean displacements at the eight positions, in pixels. Up to a distance of 2^16 pixels, the
    /// weight of a line is at least 1/(2^16)^4 ≥ 5e-20, so that the sum of weights isn't 0. Without lines, the means
    /// are NaN.
    fn means(&self) -> [[f32; 2]; LANES] {
        std::array::from_fn(|l| [self.x[l] / self.weights[l], self.y[l] / self.weights[l]])
    }
}

multiversion! {
    /// Computes the sums of eq. (7) over edges at the eight positions (x, y) with x from `xs`.
    fn line_sums(lines: &[Line], xs: &[f32; LANES], y: f32) -> WarpSums = line_sums_by
}

#[inline(always)]
fn line_sums_by(lines: &[Line], xs: &[f32; LANES], y: f32) -> WarpSums {
    let mut sums = WarpSums { weights: [0.0; LANES], x: [0.0; LANES], y: [0.0; LANES] };
    for line in lines {
        let py = y - line.p[1];
        let [m0, m1, m2, m3] = line.map;
        for (l, x) in xs.iter().enumerate() {
            let px = x - line.p[0];
            let along = px * line.direction[0] + py * line.direction[1];
            let across = py * line.direction[0] - px * line.direction[1];
            let beyond = along - along.max(0.0).min(line.length);
            let distance = (beyond * beyond + across * across).sqrt();
            let inverse = 1.0 / (A_PX + distance);
            let weight = line.strength * ((inverse * inverse) * (inverse * inverse));
            sums.weights[l] += weight;
            sums.x[l] += weight * (m0 * px + m1 * py + line.shift[0]);
            sums.y[l] += weight * (m2 * px + m3 * py + line.shift[1]);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::super::edges::EdgeFeature;
    use super::*;
    use crate::random::Random;
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
            EdgeFeature { source, other: source, target }
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
            for (boost, grid_px) in [(0.0, 1), (4.0, 4), (9.0, 7), (32.0, 3)] {
                let warp = morph_warp(&edges, [40, 30], boost, grid_px);
                for (k, source) in warp.source.iter().enumerate() {
                    let at = Point2::new((k % 40) as f64 + 0.5, (k / 40) as f64 + 0.5);
                    let expected = move_by(at);
                    let error =
                        (Point2::new(f64::from(source[0]), f64::from(source[1])) - expected).norm();
                    assert!(error < 1e-3, "{boost} {at} {error}");
                }
            }
        }
    }

    /// Returns the displacement of eq. (7) at one position, computed in f64.
    fn exact_displacement(lines: &[Line], x: f32, y: f32) -> [f64; 2] {
        let mut sums = [0.0; 3];
        for line in lines {
            let (px, py) = (f64::from(x - line.p[0]), f64::from(y - line.p[1]));
            let d = line.direction.map(f64::from);
            let along = px * d[0] + py * d[1];
            let across = py * d[0] - px * d[1];
            let distance = (along - along.clamp(0.0, f64::from(line.length))).hypot(across);
            let weight = f64::from(line.strength) * (f64::from(A_PX) + distance).powi(-4);
            let m = line.map.map(f64::from);
            sums[0] += weight;
            sums[1] += weight * (m[0] * px + m[1] * py + f64::from(line.shift[0]));
            sums[2] += weight * (m[2] * px + m[3] * py + f64::from(line.shift[1]));
        }
        [sums[1] / sums[0], sums[2] / sums[0]]
    }

    #[test]
    fn the_fast_sums_agree_with_the_exact_ones() {
        let bend: fn(Point2<f64>) -> Point2<f64> =
            |p| Point2::new(p.x + 3.0 * (p.y * 0.2).sin(), p.y + 2.0 * (p.x * 0.15).cos());
        let edges = scattered(bend);
        for boost in [0.0, 4.0, 32.0] {
            let lines = lines(&edges, boost);
            for y in [0.5, 13.5, 29.5] {
                let xs: [f32; LANES] = std::array::from_fn(|l| l as f32 * 5.0 + 0.5);
                let fast = line_sums(&lines, &xs, y).means();
                assert_eq!(fast, line_sums_by(&lines, &xs, y).means());
                for (x, d) in xs.iter().zip(fast) {
                    let exact = exact_displacement(&lines, *x, y);
                    let error = [0, 1].map(|k| (f64::from(d[k]) - exact[k]).abs());
                    assert!(error[0] < 1e-3 && error[1] < 1e-3);
                }
            }
        }
    }

    /// Returns edges between features near the nodes of a grid that covers a square image. Some edges have a boost.
    /// The motion of the features has noise.
    fn many(size: f64, spacing: f64, noise: f64) -> Vec<Edge> {
        let count = (size / spacing) as usize;
        let mut random = Random::new(5);
        let features: Vec<EdgeFeature> = (0..count * count)
            .map(|k| {
                let mut jitter = |by: f64| by * (random.unit() - 0.5);
                let (x, y) = ((k % count) as f64, (k / count) as f64);
                let at = Point2::new(x * spacing + jitter(spacing), y * spacing + jitter(spacing));
                let moved = Vector2::new(
                    12.0 * (at.y * 0.03).sin(),
                    if at.x < size / 2.0 { 9.0 } else { -9.0 },
                );
                let source = at + moved + Vector2::new(jitter(noise), jitter(noise));
                EdgeFeature { source, other: source, target: at }
            })
            .collect();
        let neighbors = |k: usize| [k + 1, k + count, k + count + 1];
        let ends = (0..features.len()).flat_map(|k| neighbors(k).map(|n| (k, n)));
        ends.filter(|&(_, n)| n < features.len())
            .map(|(k, n)| Edge {
                ends: [features[k], features[n]],
                mean_fitness: (n % 5 == 0).then_some(0.1 + 0.01 * (k % 7) as f64),
            })
            .collect()
    }

    #[test]
    fn clusters_are_within_their_tolerance_and_are_used() {
        for (size, spacing, noise) in [(200.0, 8.0, 0.0), (200.0, 6.0, 2.0), (90.0, 30.0, 5.0)] {
            let mut edges = many(size, spacing, noise);
            // An edge far from its cluster's centre that outweighs the cluster's other edges.
            edges[0].mean_fitness = Some(9.0);
            for (boost, grid_px) in [(4.0, 4), (0.0, 1), (10.0, 7)] {
                let warp = morph_warp(&edges, [150, 130], boost, grid_px);
                let lines = lines(&edges, boost);
                let (mut worst, mut is_exact) = (0.0_f64, true);
                for y in (0..130).step_by(grid_px) {
                    for x in (0..150).step_by(grid_px) {
                        let [px, py] = [x, y].map(|v| v as f32 + 0.5);
                        let exact = exact_displacement(&lines, px, py);
                        let source = warp.source[y * 150 + x];
                        let found = [source[0] - px, source[1] - py].map(f64::from);
                        worst = worst.max((found[0] - exact[0]).hypot(found[1] - exact[1]));
                        let all = line_sums(&lines, &[px; LANES], py).means()[0];
                        is_exact &= source == [px + all[0], py + all[1]];
                    }
                }
                assert!(!is_exact, "clusters count: {size} {spacing} {boost}");
                // The sums are rounded, which adds 1e-3 px to the tolerance.
                assert!(worst <= clusters::TOLERANCE_PX + 1e-3, "{size} {boost}: {worst}");
            }
        }
    }

    #[test]
    fn extreme_boosts_stay_finite() {
        let edges = scattered(|p| p + Vector2::new(1.0, 1.0));
        for boost in [0.0, 10.0, 32.0, 1e9] {
            let mut edges = edges.clone();
            // An edge as long as the largest image.
            edges.push(edge([0.0, 0.0], [1e4, 0.0], Some(0.3), |p| p));
            let warp = morph_warp(&edges, [40, 30], boost, 4);
            assert!(warp.source.iter().flatten().all(|v| v.is_finite()), "{boost}");
        }
    }

    #[test]
    fn points_and_empty_sets_give_the_identity() {
        let point = edge([5.0, 5.0], [5.0, 5.0], Some(1.0), |p| p + Vector2::new(9.0, 9.0));
        assert_eq!(morph_warp(&[point], [8, 6], 4.0, 4), Warp::identity(8, 6));
        assert_eq!(morph_warp(&[], [1, 1], 4.0, 4), Warp::identity(1, 1));
    }
}
