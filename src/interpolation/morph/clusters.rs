//! Far edges counted in clusters: a treecode (Barnes and Hut 1986).
//!
//! Displacements are linear in the place, so that the sum of a cluster's is one linear map. What differs is
//! the edges' weights: their distances from a place are within the cluster's radius of the distance from its
//! centre. So a cluster counts as one edge of no length at its centre, with the sum of the strengths.
//!
//! **The error.** With `e` the largest error of a cluster's weight, `d` an edge's displacement, `D′` the mean that
//! the clusters give, and `W` the exact sum of weights, the mean is off by at most Σ strength·e·|d − D′| / W. With `W′`
//! the sum that the clusters give, and `D₀` a fixed displacement near the tile, so that a cluster's part of the sum is
//! known without its edges:
//!
//! ```text
//! error ≤ (P + Q·|D′ − D₀|) / (W′ − Q),   P = Σ strength·e·|d − D₀|,   Q = Σ strength·e
//! ```
//!
//! Clusters with the largest part are opened until that is at most [`MorphOptions::tolerance_px`] at every node of a
//! tile.
//!
//! Known limit: the bound leaves out the rounding of f32, about 1e-4 px.

use super::MorphOptions;
use super::line::{LANES, Line, MIN_DISTANCE_PX, Sums, integer_power, sums};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A cluster is far from a tile at this many times its radius. Larger: more edges count one by one; smaller: clusters
/// that are opened anyway are tried first.
const FAR_RADII: f64 = 2.0;
/// Largest number of edges of a cluster that is not split. Larger: more far edges count one by one; smaller: the
/// tree is larger than the edges.
const LEAF: usize = 8;

/// A cluster of edges: a node of a binary tree over their middles.
struct Cluster {
    /// As one edge: `p` is its centre.
    line: Line,
    /// How far the ends of its edges are from the centre at most, pixels.
    radius: f64,
    /// Σ strength·|displacement at the centre − their mean|.
    deviation: f64,
    /// Σ strength·‖linear part of the displacement‖.
    slope: f64,
    /// Its edges, by their order in [`Clusters::lines`].
    range: std::ops::Range<usize>,
    /// Its two parts, by index. `None` for a leaf.
    parts: Option<[usize; 2]>,
}

/// All edges in clusters; the last is the whole.
pub(super) struct Clusters {
    lines: Vec<Line>,
    clusters: Vec<Cluster>,
    power: i32,
}

/// Nodes that share one selection of clusters: their coordinates.
pub(super) struct Tile {
    pub xs: [f32; LANES],
    pub ys: Vec<f32>,
    /// How many of `xs` are nodes of the grid.
    pub lanes: usize,
}

impl Tile {
    /// The minimum and the maximum distance of the tile's nodes from a point: bounds.
    fn distances(&self, [px, py]: [f32; 2]) -> (f64, f64) {
        let along = |first: f32, last: f32, p: f32| {
            let (before, behind) = (f64::from(first - p), f64::from(p - last));
            (before.max(behind).max(0.0), before.abs().max(behind.abs()))
        };
        let (near_x, far_x) = along(self.xs[0], self.xs[self.lanes - 1], px);
        let (near_y, far_y) = along(self.ys[0], self.ys[self.ys.len() - 1], py);
        (norm([near_x, near_y]), norm([far_x, far_y]))
    }
}

/// A cluster that counts as one edge, for a tile.
struct FarCluster {
    cluster: usize,
    /// Its parts of P and Q, and the minimum weight of its edges.
    p: f64,
    q: f64,
    weight: f64,
    /// Its part of the bound's numerator, where the mean is as far from D₀ as is expected.
    bound: f64,
}

impl PartialEq for FarCluster {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for FarCluster {}

impl PartialOrd for FarCluster {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for FarCluster {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.total_cmp(&other.bound).then(self.cluster.cmp(&other.cluster))
    }
}

impl Clusters {
    /// `None` where every edge is to count by itself: no tolerance, or exponents that are computed otherwise.
    pub fn new(lines: &[Line], options: &MorphOptions) -> Option<Self> {
        let power = integer_power(options).filter(|_| options.tolerance_px > 0.0)?;
        let mut found = Self { lines: lines.to_vec(), clusters: Vec::new(), power };
        found.split(0..lines.len());
        Some(found)
    }

    /// Adds the cluster of these edges after its parts; its index.
    fn split(&mut self, range: std::ops::Range<usize>) -> usize {
        let parts = (range.len() > LEAF).then(|| {
            let lines = &mut self.lines[range.clone()];
            let extent = |axis: usize| {
                let middles = || lines.iter().map(|line| middle(line)[axis]);
                middles().fold(f64::NEG_INFINITY, f64::max)
                    - middles().fold(f64::INFINITY, f64::min)
            };
            let axis = usize::from(extent(1) > extent(0));
            let half = lines.len() / 2;
            lines.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
            let half = range.start + half;
            [self.split(range.start..half), self.split(half..range.end)]
        });
        let cluster = Cluster::new(&self.lines[range.clone()], range, parts);
        self.clusters.push(cluster);
        self.clusters.len() - 1
    }

    /// The sums of eq. (7) at the nodes of a tile, row by row.
    pub fn sums(&self, tile: &Tile, options: &MorphOptions) -> Vec<Sums> {
        let a = options.a as f32;
        let at = |lines: &[Line]| -> Vec<Sums> {
            tile.ys.iter().map(|&y| sums(lines, &tile.xs, y, a, self.power)).collect()
        };
        let root = self.clusters.len() - 1;
        let (mut near, mut far) = (Vec::new(), Vec::new());
        self.near(root, tile, &mut near, &mut far);
        let by_near = at(&near);
        let central = by_near[tile.ys.len() / 2].means()[tile.lanes / 2];
        let is_near = central.iter().all(|v| v.is_finite());
        let reference = if is_near { central } else { self.clusters[root].line.shift };
        let first = Nodes::of(&by_near, tile, reference);
        let far_cluster =
            |cluster: usize| self.far_cluster(cluster, tile, reference, first.farthest, options);
        let mut far: BinaryHeap<FarCluster> = far.into_iter().map(far_cluster).collect();

        let mut opened = Vec::new();
        let mut budget = options.tolerance_px;
        loop {
            let (mut bound, mut weight) = (0.0, first.weight);
            for cluster in &far {
                bound += cluster.bound;
                weight += cluster.weight - cluster.q;
            }
            // Also where rounding left no number.
            while !(bound <= budget * weight) {
                let Some(open) = far.pop() else { break };
                bound -= open.bound;
                weight -= open.weight - open.q;
                let cluster = &self.clusters[open.cluster];
                match cluster.parts {
                    Some(parts) => {
                        for part in parts.map(far_cluster) {
                            bound += part.bound;
                            weight += part.weight - part.q;
                            far.push(part);
                        }
                    }
                    None => {
                        opened.extend(&self.lines[cluster.range.clone()]);
                        weight += open.weight;
                    }
                }
            }
            let mut others = opened.clone();
            others.extend(far.iter().map(|c| self.clusters[c.cluster].line));
            let found: Vec<Sums> =
                by_near.iter().zip(at(&others)).map(|(near, other)| near.plus(&other)).collect();
            let (p, q) = far.iter().fold((0.0, 0.0), |(p, q), c| (p + c.p, q + c.q));
            let nodes = Nodes::of(&found, tile, reference);
            let is_within = p + q * nodes.farthest <= options.tolerance_px * (nodes.weight - q);
            if far.is_empty() || is_within {
                return found;
            }
            // The mean is farther from D₀ than was expected.
            budget *= 0.5;
        }
    }

    /// Parts a cluster into edges that are near to the tile and clusters that aren't.
    fn near(&self, k: usize, tile: &Tile, near: &mut Vec<Line>, far: &mut Vec<usize>) {
        let cluster = &self.clusters[k];
        let (min, _) = tile.distances(cluster.line.p);
        if min > FAR_RADII * cluster.radius {
            return far.push(k);
        }
        match cluster.parts {
            Some(parts) => parts.iter().for_each(|&part| self.near(part, tile, near, far)),
            None => near.extend(&self.lines[cluster.range.clone()]),
        }
    }

    /// What a cluster that counts as one adds to the bound. The mean displacement is expected within
    /// `farthest` of the reference.
    fn far_cluster(
        &self,
        k: usize,
        tile: &Tile,
        reference: [f32; 2],
        farthest: f64,
        options: &MorphOptions,
    ) -> FarCluster {
        let cluster = &self.clusters[k];
        let line = &cluster.line;
        let strength = f64::from(line.strength);
        let weight = |distance: f64| {
            (options.a + distance).max(f64::from(MIN_DISTANCE_PX)).powi(-self.power)
        };
        let (min, max) = tile.distances(line.p);
        // The weight is convex and falls with distance: it is off the most towards the tile, and from its nearest
        // node, or from one that the cluster reaches.
        let error = weight((min - cluster.radius).max(0.0)) - weight(min.max(cluster.radius));
        let apart = apart(line.shift, reference);
        let p = error * (strength * apart + cluster.deviation + cluster.slope * max);
        let q = error * strength;
        let weight = strength * weight(max + cluster.radius);
        FarCluster { cluster: k, p, q, weight, bound: p + q * farthest }
    }
}

/// What a selection gives at the nodes of a tile.
struct Nodes {
    /// The least sum of weights.
    weight: f64,
    /// The largest distance of a displacement from the reference, pixels.
    farthest: f64,
}

impl Nodes {
    fn of(rows: &[Sums], tile: &Tile, reference: [f32; 2]) -> Self {
        let (mut weight, mut farthest) = (f64::INFINITY, 0.0_f64);
        for row in rows {
            for (d, w) in row.means().iter().zip(row.weights).take(tile.lanes) {
                weight = weight.min(f64::from(w));
                farthest = farthest.max(if w > 0.0 { apart(*d, reference) } else { 0.0 });
            }
        }
        Self { weight, farthest }
    }
}

fn middle(line: &Line) -> [f64; 2] {
    [0, 1]
        .map(|k| f64::from(line.p[k]) + 0.5 * f64::from(line.length) * f64::from(line.direction[k]))
}

/// Coordinates and displacements are of the images' size, so that no square leaves f64.
fn norm([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// How far two displacements are apart, pixels.
fn apart(a: [f32; 2], b: [f32; 2]) -> f64 {
    norm([0, 1].map(|k| f64::from(a[k] - b[k])))
}

impl Cluster {
    fn new(lines: &[Line], range: std::ops::Range<usize>, parts: Option<[usize; 2]>) -> Self {
        // Strengths are at least 1, so that their sum isn't 0.
        let strength: f64 = lines.iter().map(|line| f64::from(line.strength)).sum();
        let mean = |of: &dyn Fn(&Line) -> f64| {
            lines.iter().map(|line| f64::from(line.strength) * of(line)).sum::<f64>() / strength
        };
        // In f32 as the sums have it, so that the radius is around the very same point.
        let centre = [0, 1].map(|axis| mean(&|line| middle(line)[axis]) as f32).map(f64::from);
        let displacement = |line: &Line| -> [f64; 2] {
            let from = [0, 1].map(|k| centre[k] - f64::from(line.p[k]));
            let m = line.map.map(f64::from);
            let by = |k: usize| m[2 * k] * from[0] + m[2 * k + 1] * from[1];
            [0, 1].map(|k| by(k) + f64::from(line.shift[k]))
        };
        let shift = [0, 1].map(|axis| mean(&|line| displacement(line)[axis]));
        let sum = |of: &dyn Fn(&Line) -> f64| strength * mean(of);
        let radius = |line: &Line| {
            let half = 0.5 * f64::from(line.length);
            let m = middle(line);
            norm([m[0] - centre[0], m[1] - centre[1]]) + half
        };
        Self {
            radius: lines.iter().map(radius).fold(0.0, f64::max),
            deviation: sum(&|line| {
                let d = displacement(line);
                norm([d[0] - shift[0], d[1] - shift[1]])
            }),
            slope: sum(&|line| line.map.iter().map(|m| f64::from(*m).powi(2)).sum::<f64>().sqrt()),
            line: Line {
                p: centre.map(|v| v as f32),
                direction: [1.0, 0.0],
                length: 0.0,
                map: [0, 1, 2, 3].map(|k| mean(&|line| f64::from(line.map[k])) as f32),
                shift: shift.map(|v| v as f32),
                log_strength: strength.ln(),
                strength: strength as f32,
            },
            range,
            parts,
        }
    }
}
