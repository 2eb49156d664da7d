//! A treecode (Barnes and Hut 1986) for the sums of eq. (7): edges that are far from a position are approximated by
//! clusters of edges. The sums are computed for square tiles of grid nodes. All nodes of a tile use the same clusters.
//!
//! An edge's weight in the sums is its strength, the boost of eq. (8), times a function of the distance. An edge's
//! displacement is affine in the position. The strength-weighted sum of a cluster's displacements is therefore one
//! affine map, without error. Only the function of the distance is approximated: every edge of the cluster gets the
//! value for an edge of length 0 at the cluster's centre.
//!
//! **The error.** Let `e` be the largest error of this function in a cluster, over all nodes of a tile. Let `d` be the
//! displacement by an edge, `D′` the approximate mean displacement, and `W` the exact sum of weights. Then the error of
//! the mean displacement is at most Σ strength·e·|d − D′| / W. Let `W′` be the approximate sum of weights, and `D₀` any
//! constant displacement, preferably close to D′. Then this bound can be computed from sums per cluster:
//!
//! ```text
//! error ≤ (P + Q·|D′ − D₀|) / (W′ − Q),   P = Σ strength·e·|d − D₀|,   Q = Σ strength·e
//! ```
//!
//! The clusters with the largest terms are opened, which means that their children replace them. This is repeated until
//! the bound is at most [`TOLERANCE_PX`] at every node of the tile.
//!
//! Known limit: the bound does not include the rounding errors of f32, which are about 1e-4 px.

use super::{A_PX, LANES, Line, WarpSums, line_sums};
use std::collections::BinaryHeap;
use std::ops::Range;

/// Maximum error of a mean displacement due to the approximation by clusters, pixels.
pub(super) const TOLERANCE_PX: f64 = 0.02;
/// A cluster may approximate its edges if the distance from the tile to the cluster's centre is more than this multiple
/// of the cluster's radius.
const FAR_RADII: f64 = 2.0;
/// Maximum number of edges in a leaf of the tree.
const LEAF_SIZE: usize = 8;

/// A cluster of edges: a node of a binary tree over the edges' midpoints.
struct Cluster {
    /// A single edge that approximates the cluster. Its `p` is the cluster's centre.
    line: Line,
    /// Upper bound of the distances from the cluster's centre to the edges' ends, pixels.
    radius: f64,
    /// Sum over the cluster's edges of strength·|displacement at the centre − mean displacement at the centre|, pixels.
    /// The mean is weighted by strength.
    deviation: f64,
    /// Sum over the cluster's edges of strength·‖linear part of the displacement‖ (Frobenius norm).
    slope: f64,
    /// Range of the cluster's edges in [`Clusters::lines`].
    range: Range<usize>,
    /// Indices of the two child clusters; `None` for a leaf.
    children: Option<[usize; 2]>,
}

/// A binary tree of clusters over all edges. The last cluster is the root.
pub(super) struct Clusters {
    lines: Vec<Line>,
    clusters: Vec<Cluster>,
}

/// A tile of grid nodes: the x coordinates of its columns and the y coordinates of its rows, pixels. All nodes of a
/// tile use the same clusters.
pub(super) struct Tile {
    pub xs: [f32; LANES],
    pub ys: Vec<f32>,
    /// Number of entries of `xs` that are nodes of the grid. The other entries are padding.
    pub lanes: usize,
}

impl Tile {
    /// Returns a lower and an upper bound of the distances from the tile's nodes to a point, pixels.
    fn distances(&self, [px, py]: [f32; 2]) -> (f64, f64) {
        let along = |first: f32, last: f32, p: f32| {
            let (before, after) = (f64::from(first - p), f64::from(p - last));
            (before.max(after).max(0.0), before.abs().max(after.abs()))
        };
        let (near_x, far_x) = along(self.xs[0], self.xs[self.lanes - 1], px);
        let (near_y, far_y) = along(self.ys[0], self.ys[self.ys.len() - 1], py);
        (norm([near_x, near_y]), norm([far_x, far_y]))
    }
}

/// A cluster that is far from a tile, with its terms of the error bound in the module's documentation.
#[derive(Clone, Copy)]
struct FarCluster {
    cluster: usize,
    /// The cluster's term of P in the error bound, pixels: an upper bound of its sum of strength·e·|d − D₀|. e is the
    /// error of the distance function, d an edge's displacement, and D₀ a constant displacement.
    p: f64,
    /// The cluster's term of Q in the error bound: an upper bound of its sum of strength·e. e is the error of the
    /// distance function.
    q: f64,
    /// Lower bound of the cluster's exact weight at the tile's nodes.
    weight: f64,
    /// The cluster's term of the error bound's numerator P + Q·|D′ − D₀|, pixels, for an assumed maximum of |D′ − D₀|.
    bound: f64,
}

impl Clusters {
    pub fn new(lines: &[Line]) -> Self {
        let midpoint = |&line: &Line| Midpoint { at: midpoint(&line), line };
        let mut midpoints: Vec<Midpoint> = lines.iter().map(midpoint).collect();
        let mut clusters = Vec::with_capacity(lines.len() / 2);
        split(&mut midpoints, 0, &mut clusters);
        Self { lines: midpoints.into_iter().map(|m| m.line).collect(), clusters }
    }

    /// Returns the sums of eq. (7) at the nodes of a tile, one [`WarpSums`] for each row of nodes. The mean
    /// displacements that follow from these sums have an error of at most [`TOLERANCE_PX`].
    pub fn sums(&self, tile: &Tile) -> Vec<WarpSums> {
        let at = |lines: &[Line]| -> Vec<WarpSums> {
            tile.ys.iter().map(|&y| line_sums(lines, &tile.xs, y)).collect()
        };
        let root = self.clusters.len() - 1;
        let (mut near, mut far) = (Vec::new(), Vec::new());
        self.near(root, tile, &mut near, &mut far);
        let by_near = at(&near);
        let central = by_near[tile.ys.len() / 2].means()[tile.lanes / 2];
        let is_near = central.iter().all(|v| v.is_finite());
        let reference = if is_near { central } else { self.clusters[root].line.shift };
        let (near_weight, near_farthest) = node_bounds(&by_near, tile, reference);
        let far_cluster =
            |cluster: usize| self.far_cluster(cluster, tile, reference, near_farthest);
        let mut terms: Vec<FarCluster> = far.into_iter().map(far_cluster).collect();
        // Bounds are not negative. Their bit patterns, read as integers, therefore have the same order as the
        // numbers.
        let by_bound = |(n, term): (usize, &FarCluster)| (term.bound.to_bits(), term.cluster, n);
        let mut far: BinaryHeap<(u64, usize, usize)> =
            terms.iter().enumerate().map(by_bound).collect();

        let mut opened = Vec::new();
        let mut budget = TOLERANCE_PX;
        loop {
            let (mut bound, mut weight) = (0.0, near_weight);
            for &(.., n) in &far {
                bound += terms[n].bound;
                weight += terms[n].weight - terms[n].q;
            }
            // The condition is negated, so that clusters are also opened if the bound is NaN.
            while !(bound <= budget * weight) {
                let Some((.., n)) = far.pop() else { break };
                let open = terms[n];
                bound -= open.bound;
                weight -= open.weight - open.q;
                let cluster = &self.clusters[open.cluster];
                match cluster.children {
                    Some(children) => {
                        for child in children.map(far_cluster) {
                            bound += child.bound;
                            weight += child.weight - child.q;
                            far.push(by_bound((terms.len(), &child)));
                            terms.push(child);
                        }
                    }
                    None => {
                        opened.extend(&self.lines[cluster.range.clone()]);
                        weight += open.weight;
                    }
                }
            }
            let mut others = opened.clone();
            others.extend(far.iter().map(|&(_, cluster, _)| self.clusters[cluster].line));
            let all: Vec<WarpSums> =
                by_near.iter().zip(at(&others)).map(|(near, other)| near.plus(&other)).collect();
            let (p, q) =
                far.iter().fold((0.0, 0.0), |(p, q), &(.., n)| (p + terms[n].p, q + terms[n].q));
            let (weight, farthest) = node_bounds(&all, tile, reference);
            let is_within = p + q * farthest <= TOLERANCE_PX * (weight - q);
            if far.is_empty() || is_within {
                return all;
            }
            // |D′ − D₀| is larger than assumed: repeat with half the tolerance.
            budget *= 0.5;
        }
    }

    /// Divides cluster `k` for a tile: appends edges near the tile to `near`, and the indices of clusters far from it
    /// to `far`.
    fn near(&self, k: usize, tile: &Tile, near: &mut Vec<Line>, far: &mut Vec<usize>) {
        let cluster = &self.clusters[k];
        let (min, _) = tile.distances(cluster.line.p);
        if min > FAR_RADII * cluster.radius {
            return far.push(k);
        }
        match cluster.children {
            Some(children) => children.iter().for_each(|&child| self.near(child, tile, near, far)),
            None => near.extend(&self.lines[cluster.range.clone()]),
        }
    }

    /// Returns the far cluster `k` with its terms of the error bound for a tile. `reference` is D₀ of the error bound,
    /// and `farthest` is the assumed maximum of |D′ − D₀|. Both are in pixels.
    fn far_cluster(&self, k: usize, tile: &Tile, reference: [f32; 2], farthest: f64) -> FarCluster {
        let cluster = &self.clusters[k];
        let line = &cluster.line;
        let strength = f64::from(line.strength);
        let weight = |distance: f64| (f64::from(A_PX) + distance).powi(-4);
        let (min, max) = tile.distances(line.p);
        // The function of the distance is convex and decreasing, so that its error is largest at the nearest node.
        let error = weight((min - cluster.radius).max(0.0)) - weight(min.max(cluster.radius));
        let from_reference = distance(line.shift, reference);
        let p = error * (strength * from_reference + cluster.deviation + cluster.slope * max);
        let q = error * strength;
        let weight = strength * weight(max + cluster.radius);
        FarCluster { cluster: k, p, q, weight, bound: p + q * farthest }
    }
}

/// Returns the minimum sum of weights over a tile's nodes, and the maximum distance, in pixels, of a node's mean
/// displacement from `reference`.
fn node_bounds(rows: &[WarpSums], tile: &Tile, reference: [f32; 2]) -> (f64, f64) {
    let (mut weight, mut farthest) = (f64::INFINITY, 0.0_f64);
    for row in rows {
        for (d, w) in row.means().iter().zip(row.weights).take(tile.lanes) {
            weight = weight.min(f64::from(w));
            farthest = farthest.max(if w > 0.0 { distance(*d, reference) } else { 0.0 });
        }
    }
    (weight, farthest)
}

/// An edge with its midpoint, pixels.
struct Midpoint {
    at: [f64; 2],
    line: Line,
}

/// Builds a tree over edges by median splits, appends its clusters to `clusters`, and returns the index of the root.
/// The edges are reordered, so that the edges of each cluster are contiguous. `first` is the index that the first of
/// these edges will have in [`Clusters::lines`].
fn split(midpoints: &mut [Midpoint], first: usize, clusters: &mut Vec<Cluster>) -> usize {
    let range = first..first + midpoints.len();
    let children = (midpoints.len() > LEAF_SIZE).then(|| {
        let extent = |axis: usize| {
            let at = || midpoints.iter().map(|m| m.at[axis]);
            at().fold(f64::NEG_INFINITY, f64::max) - at().fold(f64::INFINITY, f64::min)
        };
        let axis = usize::from(extent(1) > extent(0));
        let half = midpoints.len() / 2;
        midpoints.select_nth_unstable_by(half, |a, b| a.at[axis].total_cmp(&b.at[axis]));
        let (before, after) = midpoints.split_at_mut(half);
        [split(before, first, clusters), split(after, first + half, clusters)]
    });
    clusters.push(Cluster::new(midpoints, range, children));
    clusters.len() - 1
}

fn midpoint(line: &Line) -> [f64; 2] {
    [0, 1]
        .map(|k| f64::from(line.p[k]) + 0.5 * f64::from(line.length) * f64::from(line.direction[k]))
}

/// Returns the length of a vector. Its components are pixel coordinates or displacements, whose squares do not
/// overflow.
fn norm([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// Returns the distance between two displacements, pixels.
fn distance(a: [f32; 2], b: [f32; 2]) -> f64 {
    norm([0, 1].map(|k| f64::from(a[k] - b[k])))
}

impl Cluster {
    fn new(edges: &[Midpoint], range: Range<usize>, children: Option<[usize; 2]>) -> Self {
        let with_strengths = || edges.iter().map(|edge| (f64::from(edge.line.strength), edge));
        // Strengths are at least 1, so that their sum is positive.
        let strength: f64 = with_strengths().map(|(strength, _)| strength).sum();
        let mut centre = [0.0; 2];
        for (strength, edge) in with_strengths() {
            centre = [0, 1].map(|k| centre[k] + strength * edge.at[k]);
        }
        // The centre is rounded to f32 as in the sums, so that the radius is measured from the same centre.
        let centre = centre.map(|sum| f64::from((sum / strength) as f32));
        let (mut maps, mut shifts) = ([0.0; 4], [0.0; 2]);
        let (mut slope, mut radius) = (0.0, 0.0_f64);
        for (strength, edge) in with_strengths() {
            let map = edge.line.map.map(f64::from);
            maps = [0, 1, 2, 3].map(|k| maps[k] + strength * map[k]);
            let shift = displacement(&edge.line, centre);
            shifts = [0, 1].map(|k| shifts[k] + strength * shift[k]);
            slope += strength * map.iter().map(|m| m * m).sum::<f64>().sqrt();
            let half = 0.5 * f64::from(edge.line.length);
            radius = radius.max(norm([0, 1].map(|k| edge.at[k] - centre[k])) + half);
        }
        let shift = shifts.map(|sum| sum / strength);
        let deviation = with_strengths().map(|(strength, edge)| {
            let d = displacement(&edge.line, centre);
            strength * norm([d[0] - shift[0], d[1] - shift[1]])
        });
        let line = Line {
            p: centre.map(|v| v as f32),
            direction: [1.0, 0.0],
            length: 0.0,
            map: maps.map(|sum| (sum / strength) as f32),
            shift: shift.map(|v| v as f32),
            strength: strength as f32,
        };
        Self { line, radius, deviation: deviation.sum(), slope, range, children }
    }
}

/// Returns the displacement, in pixels, of the position `at` by an edge's transform.
fn displacement(line: &Line, at: [f64; 2]) -> [f64; 2] {
    let from = [0, 1].map(|k| at[k] - f64::from(line.p[k]));
    let m = line.map.map(f64::from);
    let by = |k: usize| m[2 * k] * from[0] + m[2 * k + 1] * from[1];
    [0, 1].map(|k| by(k) + f64::from(line.shift[k]))
}
