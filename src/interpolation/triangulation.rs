//! Direct triangulation (Fig. 10 (b)): the image warped triangle by triangle, the method below the morph.

use super::Warp;
use super::edge_set::triangles;
use super::edges::Feature;
use nalgebra::{Matrix3, Vector3};

/// The piecewise affine warp that takes every Delaunay triangle of the features and of the image's corners
/// from a source frame of `width`×`height` pixels to the instant.
///
/// Triangles that flip between the two, or have no area, are skipped. The warp is the identity at pixels
/// that no triangle covers.
pub fn triangulation_warp(features: &[Feature], width: usize, height: usize) -> Warp {
    let mut vertices = features.to_vec();
    let triangles = triangles(&mut vertices, width, height);
    let mut warp = Warp::identity(width, height);
    for triangle in triangles {
        fill(&mut warp, triangle.map(|k| vertices[k]));
    }
    warp
}

/// Sets the warp at the pixels of one triangle.
fn fill(warp: &mut Warp, corners: [Feature; 3]) {
    let column = |k: usize| {
        let p = corners[k].target;
        Vector3::new(p.x, p.y, 1.0)
    };
    let target = Matrix3::from_columns(&[column(0), column(1), column(2)]);
    let source_area = {
        let (u, v) = (corners[1].source - corners[0].source, corners[2].source - corners[0].source);
        u.x * v.y - u.y * v.x
    };
    // Twice the area, square pixels. A triangle below a thousandth covers no pixel's centre.
    let area = target.determinant();
    if area.abs() < 1e-3 || area.signum() != source_area.signum() {
        return;
    }
    let Some(barycentric) = target.try_inverse() else { return };
    let bounds = |of: fn(&Feature) -> f64, size: usize| {
        let low = corners.iter().map(of).fold(f64::INFINITY, f64::min);
        let high = corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
        // The pixels whose centres are inside.
        let first = (low - 0.5).ceil().max(0.0) as usize;
        let end = ((high - 0.5).floor() + 1.0).max(0.0) as usize;
        first..end.min(size)
    };
    for y in bounds(|f| f.target.y, warp.height) {
        for x in bounds(|f| f.target.x, warp.width) {
            let weights = barycentric * Vector3::new(x as f64 + 0.5, y as f64 + 0.5, 1.0);
            if weights.min() < -1e-9 {
                continue;
            }
            let source = corners
                .iter()
                .zip(weights.iter())
                .fold(nalgebra::Vector2::zeros(), |sum, (f, w)| sum + f.source.coords * *w);
            warp.source[y * warp.width + x] = [source.x as f32, source.y as f32];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;

    #[test]
    fn inside_the_features_an_affine_motion_is_reproduced() {
        let move_by = |p: Point2<f64>| Point2::new(1.05 * p.x + 0.1 * p.y + 1.0, 0.97 * p.y - 2.0);
        let features: Vec<Feature> = (0..30)
            .map(|k| {
                let k = f64::from(k);
                let source =
                    Point2::new(20.0 + 12.0 * (k * 1.3).sin(), 20.0 + 12.0 * (k * 2.1).cos());
                Feature { source, other: source, target: move_by(source) }
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
        let features: Vec<Feature> = [(10.0, 10.0), (20.0, 10.0), (15.0, 20.0)]
            .map(|(x, y)| {
                let source = Point2::new(x, y);
                Feature { source, other: source, target: Point2::new(30.0 - x, y) }
            })
            .into();
        let warp = triangulation_warp(&features, 30, 30);
        assert!(warp.source.iter().flatten().all(|v| v.is_finite()));
    }
}
