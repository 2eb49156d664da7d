//! Direct triangulation (Fig. 10 (b)): piecewise affine warps on the Delaunay triangles of tracked features.

use super::Warp;
use super::edge_set::delaunay;
use super::edges::EdgeFeature;
use super::tracked_pair::flow_tracks;
use crate::registration::Track;
use nalgebra::{Matrix3, Point2, RowVector3, Vector2};

/// The Delaunay triangles of a frame pair's tracks, first in the earlier frame, then in the later frame. They are
/// the same for all instants. A triangle is three vertex indices. In the earlier frame, the vertices are the tracks
/// of the forward flow, in order, followed by the corners of the image, row by row. In the later frame, they are
/// the tracks of the backward flow, followed by the same corners.
#[derive(Clone, Debug, PartialEq)]
pub struct Triangles(pub [Vec<[usize; 3]>; 2]);

impl Triangles {
    /// Triangulates the tracks of a frame pair. The frames have `width`×`height` pixels.
    pub fn new(tracks: &[Track], width: usize, height: usize) -> Self {
        Self([true, false].map(|forward| {
            let source = |t: &Track| if forward { t.earlier } else { t.later };
            triangulated(flow_tracks(tracks, forward).map(source), width, height)
        }))
    }
}

/// Returns the Delaunay triangles of these positions and the four corners of the image. Each triangle is three vertex
/// indices. The positions have the first indices, and the corners the last four, row by row.
pub fn triangulated(
    positions: impl Iterator<Item = Point2<f64>>,
    width: usize,
    height: usize,
) -> Vec<[usize; 3]> {
    delaunay(&positions.chain(corners(width, height)).collect::<Vec<_>>())
}

/// Returns the piecewise affine backward warp from the interpolated image to a source frame of `width`×`height` pixels.
/// Each triangle is three vertex indices, first of `features`, then of the four corners of the image.
///
/// Triangles that flip between the source frame and the interpolated image, or have no area, are skipped. The warp is
/// the identity at pixels that no triangle covers.
pub fn triangulation_warp(
    triangles: &[[usize; 3]],
    features: &[EdgeFeature],
    width: usize,
    height: usize,
) -> Warp {
    let still = corners(width, height).map(|p| EdgeFeature { source: p, other: p, target: p });
    let vertex = |k: usize| features.get(k).copied().unwrap_or_else(|| still[k - features.len()]);
    let mut warp = Warp::identity(width, height);
    for triangle in triangles {
        fill_triangle(&mut warp, triangle.map(vertex));
    }
    warp
}

fn corners(width: usize, height: usize) -> [Point2<f64>; 4] {
    [(0, 0), (width, 0), (0, height), (width, height)].map(|(x, y)| Point2::new(x as f64, y as f64))
}

/// Tolerance, in barycentric coordinates, by which a pixel's centre may be outside a triangle that covers the pixel. It
/// prevents gaps due to rounding.
const OUTSIDE: f64 = 1e-9;

/// Sets the warp at the pixels of one triangle, row by row. The triangle's vertices are `corners`.
fn fill_triangle(warp: &mut Warp, corners: [EdgeFeature; 3]) {
    let target = Matrix3::from_columns(&corners.map(|f| f.target.to_homogeneous()));
    let source_area =
        (corners[1].source - corners[0].source).perp(&(corners[2].source - corners[0].source));
    // Twice the triangle's area, in square pixels. A triangle with a value below a thousandth covers no pixel's
    // centre.
    let area = target.determinant();
    if area.abs() < 1e-3 || area.signum() != source_area.signum() {
        return;
    }
    let Some(barycentric) = target.try_inverse() else { return };
    // Each of the two row vectors maps (x, y, 1) at the instant to one coordinate in the source frame.
    let [to_x, to_y] = [0, 1].map(|axis| {
        RowVector3::from_iterator(corners.iter().map(|f| f.source[axis])) * barycentric
    });
    let [a, b, c] = corners.map(|f| f.target);
    let (low, high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
    // The range of pixels along an axis whose centres are inside the bounding box of the triangle.
    let bounds = |axis: usize, size: usize| {
        let first = (low[axis] - 0.5).ceil().max(0.0) as usize;
        let end = ((high[axis] - 0.5).floor() + 1.0).max(0.0) as usize;
        [first, end.min(size)]
    };
    let ([left, right], [top, bottom]) = (bounds(0, warp.width), bounds(1, warp.height));
    for y in top..bottom {
        let center_y = y as f64 + 0.5;
        let Some([from, to]) = span(&barycentric, center_y) else { continue };
        let first = ((from - 0.5).ceil().max(0.0) as usize).max(left);
        let end = (((to - 0.5).floor() + 1.0).max(0.0) as usize).min(right);
        let start = Vector2::new(
            to_x[1] * center_y + to_x[2] + 0.5 * to_x[0],
            to_y[1] * center_y + to_y[2] + 0.5 * to_y[0],
        );
        let row = y * warp.width;
        for x in first..end {
            let at = x as f64;
            let source = [start.x + to_x[0] * at, start.y + to_y[0] * at];
            warp.source[row + x] = source.map(|v| v as f32);
        }
    }
}

/// Returns the interval of x, in pixels, in which the horizontal line at height `y` (pixels) is inside a triangle.
/// `barycentric` maps (x, y, 1) to barycentric coordinates. Returns `None` if the line misses the triangle.
fn span(barycentric: &Matrix3<f64>, y: f64) -> Option<[f64; 2]> {
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for corner in barycentric.row_iter() {
        let (slope, at_zero) = (corner[0], corner[1] * y + corner[2]);
        let end = (-OUTSIDE - at_zero) / slope;
        if slope > 0.0 {
            from = from.max(end);
        } else if slope < 0.0 {
            to = to.min(end);
        } else if at_zero < -OUTSIDE {
            return None;
        }
    }
    (from <= to).then_some([from, to])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;

    fn triangulation_warp(features: &[EdgeFeature], width: usize, height: usize) -> Warp {
        let triangles = triangulated(features.iter().map(|f| f.source), width, height);
        super::triangulation_warp(&triangles, features, width, height)
    }

    #[test]
    fn inside_the_features_an_affine_motion_is_reproduced() {
        let move_by = |p: Point2<f64>| Point2::new(1.05 * p.x + 0.1 * p.y + 1.0, 0.97 * p.y - 2.0);
        let features: Vec<EdgeFeature> = (0..30)
            .map(|k| {
                let k = f64::from(k);
                let source =
                    Point2::new(20.0 + 12.0 * (k * 1.3).sin(), 20.0 + 12.0 * (k * 2.1).cos());
                EdgeFeature { source, other: source, target: move_by(source) }
            })
            .collect();
        let warp = triangulation_warp(&features, 50, 40);
        for (x, y) in [(20, 17), (22, 14), (25, 20)] {
            let [sx, sy] = warp.source[y * 50 + x];
            let back = move_by(Point2::new(f64::from(sx), f64::from(sy)));
            let at = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            assert!((back - at).norm() < 1e-4, "{back} {at}");
        }
    }

    #[test]
    fn without_features_the_warp_is_the_identity() {
        assert_eq!(triangulation_warp(&[], 9, 7), Warp::identity(9, 7));
    }

    #[test]
    fn flipped_triangles_are_skipped() {
        let features: Vec<EdgeFeature> = [(10.0, 10.0), (20.0, 10.0), (15.0, 20.0)]
            .map(|(x, y)| {
                let source = Point2::new(x, y);
                EdgeFeature { source, other: source, target: Point2::new(30.0 - x, y) }
            })
            .into();
        let warp = triangulation_warp(&features, 30, 30);
        assert!(warp.source.iter().flatten().all(|v| v.is_finite()));
    }
}
