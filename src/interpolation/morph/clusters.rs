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
use std::ops::Range;

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
    range: Range<usize>,
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
        let mut places: Vec<Place> =
            (0..lines.len()).map(|line| Place { middle: middle(&lines[line]), line }).collect();
        let mut nodes = Vec::with_capacity(lines.len() / 2);
        split(&mut places, 0, &mut nodes);
        let lines: Vec<Line> = places.iter().map(|place| lines[place.line]).collect();
        let cluster = |(range, parts): (Range<usize>, _)| {
            Cluster::new(&lines[range.clone()], &places[range.clone()], range, parts)
        };
        let clusters = nodes.into_iter().map(cluster).collect();
        Some(Self { lines, clusters, power })
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

/// Where an edge's middle is, pixels, and its index among the lines.
struct Place {
    middle: [f64; 2],
    line: usize,
}

/// Orders the edges so that every cluster's are neighbours, and adds the cluster of all after its parts: which
/// edges it has, the first of all being number `first`, and its parts. Its index.
fn split(
    places: &mut [Place],
    first: usize,
    nodes: &mut Vec<(Range<usize>, Option<[usize; 2]>)>,
) -> usize {
    let range = first..first + places.len();
    let parts = (places.len() > LEAF).then(|| {
        let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for axis in [0, 1] {
            for place in places.iter() {
                min[axis] = min[axis].min(place.middle[axis]);
                max[axis] = max[axis].max(place.middle[axis]);
            }
        }
        let axis = usize::from(max[1] - min[1] > max[0] - min[0]);
        let half = places.len() / 2;
        places.select_nth_unstable_by(half, |a, b| a.middle[axis].total_cmp(&b.middle[axis]));
        let (before, behind) = places.split_at_mut(half);
        [split(before, first, nodes), split(behind, first + half, nodes)]
    });
    nodes.push((range, parts));
    nodes.len() - 1
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
    fn new(
        lines: &[Line],
        places: &[Place],
        range: Range<usize>,
        parts: Option<[usize; 2]>,
    ) -> Self {
        let strengths = || lines.iter().map(|line| f64::from(line.strength));
        // Strengths are at least 1, so that their sum isn't 0.
        let strength: f64 = strengths().sum();
        let mut middles = [0.0; 2];
        for (strength, place) in strengths().zip(places) {
            middles = [0, 1].map(|k| middles[k] + strength * place.middle[k]);
        }
        // In f32 as the sums have it, so that the radius is around the very same point.
        let centre = middles.map(|sum| f64::from((sum / strength) as f32));
        let (mut maps, mut shifts) = ([0.0; 4], [0.0; 2]);
        let (mut slope, mut radius) = (0.0, 0.0_f64);
        for ((strength, line), place) in strengths().zip(lines).zip(places) {
            let map = line.map.map(f64::from);
            maps = [0, 1, 2, 3].map(|k| maps[k] + strength * map[k]);
            let shift = displacement(line, centre);
            shifts = [0, 1].map(|k| shifts[k] + strength * shift[k]);
            slope += strength * map.iter().map(|m| m * m).sum::<f64>().sqrt();
            let half = 0.5 * f64::from(line.length);
            radius = radius.max(norm([0, 1].map(|k| place.middle[k] - centre[k])) + half);
        }
        let shift = shifts.map(|sum| sum / strength);
        let deviation = strengths().zip(lines).map(|(strength, line)| {
            let d = displacement(line, centre);
            strength * norm([d[0] - shift[0], d[1] - shift[1]])
        });
        Self {
            radius,
            deviation: deviation.sum(),
            slope,
            line: Line {
                p: centre.map(|v| v as f32),
                direction: [1.0, 0.0],
                length: 0.0,
                map: maps.map(|sum| (sum / strength) as f32),
                shift: shift.map(|v| v as f32),
                log_strength: strength.ln(),
                strength: strength as f32,
            },
            range,
            parts,
        }
    }
}

/// An edge's displacement at a place, pixels.
fn displacement(line: &Line, place: [f64; 2]) -> [f64; 2] {
    let from = [0, 1].map(|k| place[k] - f64::from(line.p[k]));
    let m = line.map.map(f64::from);
    let by = |k: usize| m[2 * k] * from[0] + m[2 * k + 1] * from[1];
    [0, 1].map(|k| by(k) + f64::from(line.shift[k]))
}
