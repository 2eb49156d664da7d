//! §5.3: Beier and Neely's morph (SIGGRAPH '92) with boosted real edges, eqs. (7) and (8).
//!
//! Every edge maps the plane so that its line at the instant goes to its line in the source frame. A pixel's
//! source is the weighted mean of the sources by all edges. The warp is evaluated at the nodes of a
//! grid and bilinearly interpolated between them (a grid of 1 pixel is exact). At a node, near edges count one by
//! one and far ones in clusters, as far as [`MorphOptions::tolerance_px`] allows ([`clusters`]).

mod clusters;
mod line;

use super::edge_set::Edge;
use super::{MorphOptions, Warp};
use clusters::Clusters;
use line::{Line, lines};
use rayon::prelude::*;

/// Nodes along each side of a tile, which share one selection of clusters. Larger: more edges are near to some
/// node of the tile; smaller: more selections. A row of a tile is computed at once.
const TILE: usize = line::LANES;

/// The warp (§5.3) that takes a source frame of `width`×`height` pixels to the instant, by the edges' lines in
/// both and their weights, eqs. (7) and (8). Without edges that have a direction it is the identity.
pub fn morph_warp(edges: &[Edge], width: usize, height: usize, options: &MorphOptions) -> Warp {
    let lines = lines(edges, options);
    if lines.is_empty() {
        return Warp::identity(width, height);
    }
    let grid = Grid::new(width, height, options.grid_px.max(1));
    let bands: Vec<Vec<[f32; 2]>> = match Clusters::new(&lines, options) {
        Some(clusters) => {
            let rows = (0..grid.nodes[1].div_ceil(TILE)).into_par_iter();
            rows.map(|band| clustered_band(&clusters, &grid, band, options)).collect()
        }
        None => {
            let rows = (0..grid.nodes[1]).into_par_iter();
            rows.map(|ny| exact_row(&lines, &grid, ny, options)).collect()
        }
    };
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

/// The nodes that a warp is evaluated at. They stand on pixel centres, the first on the first pixel's; the last
/// beyond the image.
struct Grid {
    step: usize,
    /// Across, down.
    nodes: [usize; 2],
}

impl Grid {
    fn new(width: usize, height: usize, step: usize) -> Self {
        Self { step, nodes: [width, height].map(|size| (size - 1).div_ceil(step) + 1) }
    }

    /// The coordinate of a node, pixels.
    fn at(&self, node: usize) -> f32 {
        (node * self.step) as f32 + 0.5
    }

    /// The coordinates of the nodes that are computed at once.
    fn lanes(&self, first: usize) -> [f32; line::LANES] {
        std::array::from_fn(|lane| self.at(first + lane))
    }

    /// The nodes before and behind a pixel along an axis, and its fraction of the way between them.
    fn nodes_around(&self, pixel: usize, axis: usize) -> (usize, usize, f32) {
        let before = pixel / self.step;
        let behind = (before + 1).min(self.nodes[axis] - 1);
        (before, behind, (pixel % self.step) as f32 / self.step as f32)
    }
}

/// The displacements at one row of nodes, from every edge.
fn exact_row(lines: &[Line], grid: &Grid, ny: usize, options: &MorphOptions) -> Vec<[f32; 2]> {
    let mut row = Vec::with_capacity(grid.nodes[0].next_multiple_of(line::LANES));
    while row.len() < grid.nodes[0] {
        row.extend(line::displacements(lines, &grid.lanes(row.len()), grid.at(ny), options));
    }
    row.truncate(grid.nodes[0]);
    row
}

/// The displacements at [`TILE`] rows of nodes, or at those that the grid still has.
fn clustered_band(
    clusters: &Clusters,
    grid: &Grid,
    band: usize,
    options: &MorphOptions,
) -> Vec<[f32; 2]> {
    let [across, down] = grid.nodes;
    let first_row = band * TILE;
    let rows = TILE.min(down - first_row);
    let mut found = vec![[0.0; 2]; rows * across];
    for first in (0..across).step_by(TILE) {
        let lanes = TILE.min(across - first);
        let tile = clusters::Tile {
            xs: grid.lanes(first),
            ys: (0..rows).map(|r| grid.at(first_row + r)).collect(),
            lanes,
        };
        for (row, sums) in found.chunks_mut(across).zip(clusters.sums(&tile, options)) {
            row[first..first + lanes].copy_from_slice(&sums.means()[..lanes]);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::edges::Feature;
    use super::line::{LANES, displacement_exact, displacements, sums_any};
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
                    let portable = sums_any(&lines, &xs, y, a as f32, b as i32).means();
                    assert_eq!(fast, portable);
                    for (x, d) in xs.iter().zip(fast) {
                        let exact = displacement_exact(&lines, *x, y, &options);
                        assert!((d[0] - exact[0]).abs() < 1e-3 && (d[1] - exact[1]).abs() < 1e-3);
                    }
                }
            }
        }
    }

    /// Triangles over an image, some with a boost, whose features move as if filmed with noise.
    fn many(size: f64, spacing: f64, noise: f64) -> Vec<Edge> {
        let count = (size / spacing) as usize;
        let mut random = Random::new(5);
        let features: Vec<Feature> = (0..count * count)
            .map(|k| {
                let mut jitter = |by: f64| by * (random.unit() - 0.5);
                let (x, y) = ((k % count) as f64, (k / count) as f64);
                let at = Point2::new(x * spacing + jitter(spacing), y * spacing + jitter(spacing));
                let moved = Vector2::new(
                    12.0 * (at.y * 0.03).sin(),
                    if at.x < size / 2.0 { 9.0 } else { -9.0 },
                );
                let source = at + moved + Vector2::new(jitter(noise), jitter(noise));
                Feature { source, other: source, target: at }
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
            // One that outweighs its cluster, at its side.
            edges[0].mean_fitness = Some(9.0);
            for (b, a, grid_px) in [(4.0, 0.5, 4), (4.0, 0.0, 1), (3.0, 1.0, 4), (2.0, 0.5, 7)] {
                let warp = |tolerance_px: f64| {
                    let options =
                        MorphOptions { a, b, grid_px, tolerance_px, ..Default::default() };
                    morph_warp(&edges, 150, 130, &options).source
                };
                let exact = warp(0.0);
                if spacing < 10.0 && b == 4.0 {
                    assert_ne!(warp(0.5), exact);
                }
                for tolerance_px in [0.001, 0.02, 0.5] {
                    let errors = warp(tolerance_px)
                        .into_iter()
                        .zip(&exact)
                        .map(|(p, q)| f64::from(p[0] - q[0]).hypot(f64::from(p[1] - q[1])));
                    let worst = errors.fold(0.0, f64::max);
                    // Beside the tolerance, the sums' rounding.
                    let limit = tolerance_px + 1e-3;
                    assert!(worst <= limit, "{size} {spacing} {b} {a} {tolerance_px}: {worst}");
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
            let options = MorphOptions { a, b, rho, tau, ..Default::default() };
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
