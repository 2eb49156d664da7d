//! §5.1: real edges. A real edge is a segment between two features that follows an image edge in both frames.

use crate::registration::{Neighbors, PyramidLevel};
use nalgebra::{Point2, Vector2, center};
use rayon::prelude::*;

/// β of eq. (6): weight of the alignment between the image gradient and the edge's normal, in image values (0..=1)
/// per pixel.
const BETA: f64 = 0.05;
/// Minimum fitness, eq. (6), of every sample of a real edge, in image values (0..=1) per pixel.
const MIN_FITNESS: f64 = 0.08;
/// Maximum distance between the samples s_k of eq. (6) along an edge, pixels.
const SAMPLE_STEP_PX: f64 = 2.0;
/// Proportional term of the maximum change of a real edge's length between the two frames, as a fraction of the length.
/// [`MAX_LENGTH_CHANGE_PX`] is added to this term.
const MAX_LENGTH_CHANGE_FRACTION: f64 = 0.05;
/// Constant term, in pixels, of the maximum change of a real edge's length between the two frames. The maximum is this
/// value plus [`MAX_LENGTH_CHANGE_FRACTION`] times the length.
const MAX_LENGTH_CHANGE_PX: f64 = 0.5;
/// Maximum angle between a longer edge and an edge that counts as its duplicate and is removed, degrees.
const DUPLICATE_ANGLE_DEG: f64 = 10.0;
/// Maximum distance from a longer edge to the ends of an edge that counts as its duplicate and is removed, pixels.
const DUPLICATE_DISTANCE_PX: f64 = 2.0;

/// A tracked feature's positions in the two frames and in the interpolated image. The morph's edges connect such
/// features.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeFeature {
    /// Position in the source frame, which is the frame that is warped, in pixels.
    pub source: Point2<f64>,
    /// Position in the other frame of the pair, in pixels.
    pub other: Point2<f64>,
    /// Position in the interpolated image, at the instant between the frames, in pixels.
    pub target: Point2<f64>,
}

impl EdgeFeature {
    /// Interpolates linearly between this feature and another feature, in both frames and in the interpolated image.
    /// `fraction` is 0 at this feature and 1 at the other feature.
    pub fn lerp(&self, to: &Self, fraction: f64) -> Self {
        let interpolate = |a: Point2<f64>, b: Point2<f64>| a + (b - a) * fraction;
        Self {
            source: interpolate(self.source, to.source),
            other: interpolate(self.other, to.other),
            target: interpolate(self.target, to.target),
        }
    }
}

/// A real edge (§5.1): a segment between two features that follows an image edge in both frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RealEdge {
    /// Indices of the features at the segment's two ends.
    pub ends: [usize; 2],
    /// f̄ of eq. (8): the mean fitness of the edge's samples in the source frame, in image values (0..=1) per
    /// pixel.
    pub mean_fitness: f64,
}

/// Finds the real edges among features (§5.1). A real edge is a segment of at most `max_length_px` whose fitness,
/// eq. (6), exceeds a threshold in both frames. Its length is almost equal in both frames. Of near-parallel segments on
/// the same image edge, only the longest is returned (§5.2).
///
/// `source` and `other` are the two frames' pyramid levels of full resolution. The order of the result does not depend
/// on the number of threads. Two features at the same position are not connected by a real edge.
pub fn real_edges(
    features: &[EdgeFeature],
    source: &PyramidLevel,
    other: &PyramidLevel,
    max_length_px: f64,
) -> Vec<RealEdge> {
    let neighbors = Neighbors::new(features.iter().map(|f| f.source));
    let candidates: Vec<RealEdge> = (0..features.len())
        .into_par_iter()
        .flat_map_iter(|a| {
            let mut edges = Vec::new();
            neighbors.each_within(&features[a].source, max_length_px, |b| {
                if b > a {
                    let ends = [&features[a], &features[b]];
                    edges.extend(real_edge([a, b], ends, source, other));
                }
            });
            edges
        })
        .collect();
    without_duplicates(candidates, features)
}

fn real_edge(
    ends: [usize; 2],
    [a, b]: [&EdgeFeature; 2],
    source: &PyramidLevel,
    other: &PyramidLevel,
) -> Option<RealEdge> {
    let length = (b.source - a.source).norm();
    let change = ((b.other - a.other).norm() - length).abs();
    if change > MAX_LENGTH_CHANGE_FRACTION * length + MAX_LENGTH_CHANGE_PX {
        return None;
    }
    let mean_fitness = mean_fitness(source, a.source, b.source)?;
    self::mean_fitness(other, a.other, b.other)?;
    Some(RealEdge { ends, mean_fitness })
}

/// Returns f̄, the mean of the samples of eq. (6) along the segment from `a` to `b`, in image values (0..=1) per
/// pixel. Returns `None` if a sample is at most [`MIN_FITNESS`]. Also returns `None` if the segment is shorter than
/// a pixel, since its direction is noise.
fn mean_fitness(level: &PyramidLevel, a: Point2<f64>, b: Point2<f64>) -> Option<f64> {
    let along = b - a;
    let length = along.norm();
    if !(length >= 1.0) {
        return None;
    }
    let normal = Vector2::new(-along.y, along.x) / length;
    let steps = (length / SAMPLE_STEP_PX).ceil().max(1.0) as usize;
    let mut sum = 0.0;
    for k in 0..=steps {
        let p = a + along * (k as f64 / steps as f64);
        let clamp = |v: f64, size: usize| (v.max(0.0) as usize).min(size - 1);
        let (gx, gy) = level.gradient(clamp(p.x, level.width), clamp(p.y, level.height));
        let gradient = Vector2::new(f64::from(gx), f64::from(gy));
        let magnitude = gradient.norm();
        // Where the gradient is 0, its direction is undefined, and the alignment term is set to 0.
        let agreement =
            if magnitude > 0.0 { (gradient.dot(&normal) / magnitude).abs() } else { 0.0 };
        let f = magnitude + BETA * agreement;
        if !(f > MIN_FITNESS) {
            return None;
        }
        sum += f;
    }
    Some(sum / (steps + 1) as f64)
}

/// Removes each edge that is close to a longer edge and near-parallel to it (§5.2, Fig. 8).
fn without_duplicates(mut edges: Vec<RealEdge>, features: &[EdgeFeature]) -> Vec<RealEdge> {
    let ends = |e: &RealEdge| e.ends.map(|k| features[k].source);
    let length = |e: &RealEdge| {
        let [a, b] = ends(e);
        (b - a).norm()
    };
    edges.sort_by(|x, y| length(y).total_cmp(&length(x)).then(x.ends.cmp(&y.ends)));
    let min_cosine = DUPLICATE_ANGLE_DEG.to_radians().cos();
    let is_duplicate = |e: &RealEdge, longer: &RealEdge| {
        let ([a, b], [c, d]) = (ends(longer), ends(e));
        let long = length(longer);
        let direction = (b - a) / long;
        let parallel = ((d - c).dot(&direction) / (d - c).norm()).abs() >= min_cosine;
        let near = |p: Point2<f64>| {
            let along = (p - a).dot(&direction).clamp(0.0, long);
            (p - (a + direction * along)).norm() <= DUPLICATE_DISTANCE_PX
        };
        parallel && near(c) && near(d)
    };
    let segments: Vec<Segment> = edges.iter().map(ends).collect();
    let near = NearSegments::new(&segments);
    let mut is_unique = vec![false; edges.len()];
    for (k, edge) in edges.iter().enumerate() {
        let mut longer = near.before(k, DUPLICATE_DISTANCE_PX).into_iter();
        is_unique[k] = !longer.any(|n| is_unique[n] && is_duplicate(edge, &edges[n]));
    }
    let mut is_unique = is_unique.into_iter();
    edges.retain(|_| is_unique.next() == Some(true));
    edges
}

/// The two ends of a segment, pixels.
pub(super) type Segment = [Point2<f64>; 2];

/// Spatial index of segments, searched by the segments' midpoints.
pub(super) struct NearSegments<'a> {
    segments: &'a [Segment],
    midpoints: Neighbors,
    longest_px: f64,
}

impl<'a> NearSegments<'a> {
    /// Indexes segments. Their ends must be finite.
    pub fn new(segments: &'a [Segment]) -> Self {
        let midpoints = Neighbors::new(segments.iter().map(|[a, b]| center(a, b)));
        let longest_px = segments.iter().map(|[a, b]| (b - a).norm()).fold(0.0, f64::max);
        Self { segments, midpoints, longest_px }
    }

    /// Returns the indices below `k` of segments that may lie within `distance_px` of segment `k`, in ascending order.
    /// No segment within this distance is missing, but some of the returned segments may be farther away.
    pub fn before(&self, k: usize, distance_px: f64) -> Vec<usize> {
        let [a, b] = &self.segments[k];
        let reach = 0.5 * ((b - a).norm() + self.longest_px) + distance_px;
        let mut found = Vec::new();
        self.midpoints.each_within(&center(a, b), reach, |n| {
            if n < k {
                found.push(n);
            }
        });
        found.sort_unstable();
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;
    use crate::registration::Pyramid;

    /// Renders a step edge: dark to the left of x = 30, bright to the right.
    fn step() -> Pyramid {
        let data = (0..60 * 50).map(|k| if k % 60 < 30 { 0.2 } else { 0.9 }).collect();
        Pyramid::new(&Image::from_data(60, 50, 1, data), 1, 4)
    }

    fn at_rest(x: f64, y: f64) -> EdgeFeature {
        let p = Point2::new(x, y);
        EdgeFeature { source: p, other: p, target: p }
    }

    fn edge_ends(features: &[EdgeFeature]) -> Vec<[usize; 2]> {
        let pyramid = step();
        let level = &pyramid.levels[0];
        let edges = real_edges(features, level, level, 24.0);
        edges.iter().map(|e| e.ends).collect()
    }

    #[test]
    fn segments_on_the_step_are_edges_and_others_are_not() {
        assert_eq!(edge_ends(&[at_rest(30.0, 10.0), at_rest(30.0, 25.0)]), [[0, 1]]);
        assert!(edge_ends(&[at_rest(10.0, 10.0), at_rest(10.0, 25.0)]).is_empty());
        assert!(edge_ends(&[at_rest(22.0, 10.0), at_rest(38.0, 25.0)]).is_empty());
        assert!(
            edge_ends(&[at_rest(30.0, 5.0), at_rest(30.0, 45.0)]).is_empty(),
            "longer than L_max"
        );
    }

    #[test]
    fn of_three_points_on_one_edge_the_longest_pair_is_kept() {
        assert_eq!(
            edge_ends(&[at_rest(30.0, 10.0), at_rest(30.3, 18.0), at_rest(30.0, 28.0)]),
            [[0, 2]]
        );
    }

    #[test]
    fn an_edge_whose_length_changes_is_no_edge() {
        let mut moved = at_rest(30.0, 25.0);
        moved.other.y += 4.0;
        assert!(edge_ends(&[at_rest(30.0, 10.0), moved]).is_empty());
    }

    #[test]
    fn zero_gradients_have_no_direction_and_coincident_features_no_length() {
        let flat = Pyramid::new(&Image::filled(60, 50, 1, 0.5), 1, 4);
        let level = &flat.levels[0];
        let (a, b) = (Point2::new(10.0, 10.0), Point2::new(20.0, 10.0));
        assert_eq!(mean_fitness(level, a, b), None);
        assert_eq!(
            mean_fitness(&step().levels[0], Point2::new(30.0, 10.0), Point2::new(30.0, 10.0)),
            None
        );
        assert!(edge_ends(&[at_rest(30.0, 10.0), at_rest(30.0, 10.0)]).is_empty());
    }
}
