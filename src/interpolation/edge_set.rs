//! §5.2: the edge set. Real edges are split where they cross. A constrained Delaunay triangulation adds the virtual
//! edges.

use super::edges::{EdgeFeature, NearSegments, RealEdge, Segment};
use nalgebra::{Point2, Vector2};
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Triangulation};
use std::collections::{HashMap, HashSet};

/// An edge of the edge set (§5.2), with its two ends. The morph's warp follows from the motions of all edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    pub ends: [EdgeFeature; 2],
    /// Mean fitness f̄ of a real edge, eq. (8), in image values (0..=1) per pixel. `None` for a virtual edge.
    pub mean_fitness: Option<f64>,
}

/// Returns the edge set (§5.2) of a frame of `width`×`height` pixels. The first edges are the pieces of the real
/// edges between their crossings. The virtual edges follow. They are the other edges of the constrained Delaunay
/// triangulation in the source frame.
///
/// The triangulation's vertices are all features (in the paper, only the ends of real edges), the crossings and the
/// corners of the image. Of features at the same position, only the first is a vertex. Without features, the edges
/// are the border of the image and a diagonal.
pub fn edge_set(
    features: &[EdgeFeature],
    real: &[RealEdge],
    width: usize,
    height: usize,
) -> Vec<Edge> {
    let mut vertices = features.to_vec();
    let pieces = without_crossings(&mut vertices, real);
    for (x, y) in [(0, 0), (width, 0), (0, height), (width, height)] {
        let p = Point2::new(x as f64, y as f64);
        vertices.push(EdgeFeature { source: p, other: p, target: p });
    }

    let mut edges: Vec<Edge> = pieces
        .iter()
        .map(|p| Edge { ends: p.ends.map(|k| vertices[k]), mean_fitness: Some(p.mean_fitness) })
        .collect();
    let sources: Vec<_> = vertices.iter().map(|v| v.source).collect();
    let mesh = triangulation(&sources, pieces.iter().map(|p| p.ends));
    let added = mesh.undirected_edges().filter(|e| !e.is_constraint_edge());
    edges.extend(added.map(|e| Edge {
        ends: e.vertices().map(|v| vertices[v.data().index]),
        mean_fitness: None,
    }));
    edges
}

/// Returns the Delaunay triangles of these positions. Each triangle is three indices into `positions`.
pub(super) fn delaunay(positions: &[Point2<f64>]) -> Vec<[usize; 3]> {
    let mesh = triangulation(positions, std::iter::empty());
    mesh.inner_faces().map(|f| f.vertices().map(|v| v.data().index)).collect()
}

/// A vertex of the triangulation, with its index in the caller's list.
struct Site {
    position: spade::Point2<f64>,
    index: usize,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> spade::Point2<f64> {
        self.position
    }
}

/// Returns the Delaunay triangulation of those positions that are finite. The triangulation is constrained to
/// contain the segments of `constraints`, which are pairs of indices into `positions`.
fn triangulation(
    positions: &[Point2<f64>],
    constraints: impl Iterator<Item = [usize; 2]>,
) -> ConstrainedDelaunayTriangulation<Site> {
    let position = |k: usize| [positions[k].x, positions[k].y].map(accepted);
    // Of positions that coincide, only the first becomes a vertex.
    let mut seen = HashSet::with_capacity(positions.len());
    let is_vertex = |k: &usize| {
        let position = position(*k);
        let is_valid = position.iter().all(|v| spade::validate_coordinate(*v).is_ok());
        is_valid && seen.insert(position.map(f64::to_bits))
    };
    let vertices = (0..positions.len()).filter(is_vertex);
    let sites = vertices.map(|index| Site { position: position(index).into(), index }).collect();
    // `bulk_load` fails only on invalid coordinates, and there are none.
    let mut cdt = ConstrainedDelaunayTriangulation::bulk_load(sites).unwrap_or_default();
    let handles: HashMap<[u64; 2], FixedVertexHandle> =
        cdt.vertices().map(|v| (position(v.data().index).map(f64::to_bits), v.fix())).collect();
    for ends in constraints {
        let [a, b] = ends.map(|k| handles.get(&position(k).map(f64::to_bits)));
        if let (Some(a), Some(b)) = (a, b)
            && a != b
        {
            // A constraint that crosses another constraint because of rounding is not added. The morph uses its
            // edge nevertheless.
            let _ = cdt.try_add_constraint(*a, *b);
        }
    }
    cdt
}

/// Rounds a coordinate to 0 if its magnitude is below 1e-30, since spade refuses magnitudes below 2⁻¹⁴².
fn accepted(v: f64) -> f64 {
    if v.abs() < 1e-30 { 0.0 } else { v }
}

/// Splits real edges where they cross (§5.2), and returns the pieces. Each crossing becomes a vertex that is appended
/// to `vertices`. The vertex is on the edge of larger mean fitness in both frames and in the interpolated image, so
/// that this edge stays straight.
fn without_crossings(vertices: &mut Vec<EdgeFeature>, real: &[RealEdge]) -> Vec<RealEdge> {
    let mut order: Vec<usize> = (0..real.len()).collect();
    order.sort_by(|&a, &b| real[b].mean_fitness.total_cmp(&real[a].mean_fitness).then(a.cmp(&b)));
    let segments: Vec<Segment> =
        order.iter().map(|&k| real[k].ends.map(|v| vertices[v].source)).collect();
    let near = NearSegments::new(&segments);
    // For each edge, its splits: the fraction along the edge, and the index of the vertex at the crossing.
    let mut splits: Vec<Vec<(f64, usize)>> = vec![Vec::new(); order.len()];
    for k in 0..order.len() {
        for fitter in near.before(k, 0.0) {
            let [c, d] = real[order[fitter]].ends;
            if real[order[k]].ends.iter().any(|end| [c, d].contains(end)) {
                continue;
            }
            let Some((along, along_fitter)) = crossing(segments[k], segments[fitter]) else {
                continue;
            };
            splits[k].push((along, vertices.len()));
            splits[fitter].push((along_fitter, vertices.len()));
            vertices.push(vertices[c].lerp(&vertices[d], along_fitter));
        }
    }
    let mut pieces = Vec::with_capacity(real.len());
    for (k, mut cuts) in splits.into_iter().enumerate() {
        let edge = &real[order[k]];
        cuts.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let mut from = edge.ends[0];
        for to in cuts.into_iter().map(|(_, vertex)| vertex).chain([edge.ends[1]]) {
            pieces.push(RealEdge { ends: [from, to], mean_fitness: edge.mean_fitness });
            from = to;
        }
    }
    pieces
}

/// Returns the crossing of two segments, as the fractions (0 to 1) along each segment. Returns `None` if the
/// segments are parallel, do not cross, or touch at an end.
fn crossing([a, b]: Segment, [c, d]: Segment) -> Option<(f64, f64)> {
    let (u, v) = (b - a, d - c);
    let cross = |p: Vector2<f64>, q: Vector2<f64>| p.x * q.y - p.y * q.x;
    let determinant = cross(u, v);
    // The segments are parallel if the sine of their angle is below 1e-9.
    if !(determinant.abs() > 1e-9 * u.norm() * v.norm()) {
        return None;
    }
    let (s, t) = (cross(c - a, v) / determinant, cross(c - a, u) / determinant);
    let inside = |x: f64| x > 1e-6 && x < 1.0 - 1e-6;
    (inside(s) && inside(t)).then_some((s, t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn feature(x: f64, y: f64, dx: f64) -> EdgeFeature {
        let p = Point2::new(x, y);
        let q = Point2::new(x + dx, y);
        EdgeFeature { source: p, other: q, target: q }
    }

    #[test]
    fn without_features_the_corners_and_a_diagonal_remain() {
        let edges = edge_set(&[], &[], 40, 30);
        assert_eq!(edges.len(), 5);
        assert!(edges.iter().all(|e| e.mean_fitness.is_none()));
    }

    #[test]
    fn a_crossing_follows_the_fitter_edge() {
        let features = [
            feature(10.0, 10.0, 2.0),
            feature(20.0, 20.0, 2.0),
            feature(10.0, 20.0, 0.0),
            feature(20.0, 10.0, 0.0),
        ];
        let real = [
            RealEdge { ends: [0, 1], mean_fitness: 0.9 },
            RealEdge { ends: [2, 3], mean_fitness: 0.5 },
        ];
        let edges = edge_set(&features, &real, 40, 30);
        let pieces: Vec<_> = edges.iter().filter(|e| e.mean_fitness.is_some()).collect();
        assert_eq!(pieces.len(), 4);
        let middle = Point2::new(15.0, 15.0);
        for piece in pieces {
            let at = piece.ends.iter().find(|f| (f.source - middle).norm() < 1e-9).unwrap();
            assert_eq!(at.target, Point2::new(17.0, 15.0));
        }
    }

    #[test]
    fn collinear_duplicate_and_hundreds_of_random_edges_stay_finite() {
        let line: Vec<_> = (0..20).map(|k| feature(f64::from(k % 10), 5.0, 0.0)).collect();
        assert!(edge_set(&line, &[], 40, 30).len() >= 5);
        let mut numbers = Random::new(7);
        let mut random = || numbers.unit();
        for _ in 0..20 {
            let features: Vec<_> =
                (0..60).map(|_| feature((random() * 40.0).round(), random() * 30.0, 1.0)).collect();
            let real: Vec<_> = (0..120)
                .map(|k| RealEdge { ends: [k % 60, (k * 7 + 1) % 60], mean_fitness: random() })
                .filter(|e| e.ends[0] != e.ends[1])
                .collect();
            let edges = edge_set(&features, &real, 40, 30);
            assert!(edges.iter().flat_map(|e| e.ends).all(|f| f.target.x.is_finite()));
        }
    }
}
