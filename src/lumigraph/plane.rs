//! The plane proxy of §6: the paper's "3D planar proxy in which the plane's depth can be interactively
//! controlled by the user. Its placement determines which region of the scene is in focus."

use super::inverse_depth::{ProjectedPoint, Through, fit_plane};
use super::rays::ViewBounds;
use crate::camera::Camera;
use nalgebra::{Point2, Point3, Vector3};

/// The plane of the points with `normal · x = d` in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Of unit length.
    pub normal: Vector3<f64>,
    /// Signed distance from the world's origin along the normal, metres.
    pub d: f64,
}

/// Margin around the camera's image in which points count for a plane, as a fraction of the image's
/// size. Larger: points that no view shows tilt the plane. Smaller: few points remain near the border.
const MARGIN: f64 = 0.5;

impl Plane {
    /// The plane at a depth along the camera's axis, and perpendicular to it.
    pub fn fronto_parallel(camera: &Camera, depth_m: f64) -> Self {
        let normal = camera.axis();
        Self { normal, d: normal.dot(&camera.center().coords) + depth_m }
    }

    /// The plane nearest to weighted points in the inverse depth of `camera`, a camera amid the rig,
    /// with outliers discounted: it blurs the blended view the least. A weight is 1, or the part of
    /// the view that the point represents.
    ///
    /// Points behind the camera, far outside its image, not finite or without positive weight are
    /// ignored. One point, or points on a line, give the plane through them that is nearest to facing
    /// the camera. No plane is tilted so far that a ray of the view misses it. `None` if no point
    /// remains.
    pub fn fit(points: &[(Point3<f64>, f64)], camera: &Camera) -> Option<Self> {
        let bounds = ViewBounds::of(camera)?;
        let counted = bounds.enlarged(MARGIN);
        let projections: Vec<ProjectedPoint> = points
            .iter()
            .filter_map(|(point, weight)| {
                let p = camera.cam_from_world * point;
                let at = Point2::new(p.x / p.z, p.y / p.z);
                let counts = p.z > 0.0
                    && (1.0 / p.z) > 0.0
                    && (1.0 / p.z).is_finite()
                    && counted.contains(&at)
                    && *weight > 0.0
                    && weight.is_finite();
                counts.then_some(ProjectedPoint { at, inverse_depth: 1.0 / p.z, weight: *weight })
            })
            .collect();
        let g = fit_plane(&projections, Through::Middle, &bounds)?;
        // g · (R x + t) = 1. |g| is at least its inverse depth amid the view, which is positive.
        let length = g.norm();
        let normal = camera.cam_from_world.rotation.inverse_transform_vector(&g) / length;
        let d = (1.0 - g.dot(&camera.cam_from_world.translation.vector)) / length;
        (normal.iter().all(|v| v.is_finite()) && d.is_finite()).then_some(Self { normal, d })
    }

    /// The plane that faces the camera at the median inverse depth of the points in front of it, in
    /// its view or beside: a fallback for a view without points. `None` if all points are behind the
    /// camera, or not finite.
    pub fn amid(points: &[Point3<f64>], camera: &Camera) -> Option<Self> {
        let mut inverse: Vec<f64> =
            points.iter().map(|p| 1.0 / (camera.cam_from_world * p).z).collect();
        inverse.retain(|v| *v > 0.0 && v.is_finite());
        inverse.sort_by(f64::total_cmp);
        Some(Self::fronto_parallel(camera, 1.0 / inverse.get(inverse.len() / 2)?))
    }

    /// `g` of [`super::inverse_depth`] in the camera's view; `None` if the plane passes through the
    /// camera's centre, where it is a line in the image, or all of it at depth 0.
    pub(super) fn inverse_depth(&self, camera: &Camera) -> Option<Vector3<f64>> {
        let distance = self.d - self.normal.dot(&camera.center().coords);
        let g = camera.cam_from_world.rotation * self.normal / distance;
        g.iter().all(|v| v.is_finite()).then_some(g)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;
    use crate::camera::tests::pinhole_at;

    fn distance(plane: &Plane, p: &Point3<f64>) -> f64 {
        (plane.normal.dot(&p.coords) - plane.d).abs()
    }

    #[test]
    fn fronto_parallel_is_at_its_depth() {
        let camera = pinhole_at([1.0, 2.0, 3.0]);
        let plane = Plane::fronto_parallel(&camera, 2.0);
        assert_eq!(plane, Plane { normal: Vector3::z(), d: 5.0 });
    }

    #[test]
    fn a_tilted_plane_is_fitted_among_outliers() {
        let mut random = Random::new(4);
        let camera = pinhole_at([0.1, -0.2, 0.3]);
        let truth = Plane { normal: Vector3::new(0.2, -0.3, 0.9).normalize(), d: 2.5 };
        let points: Vec<_> = (0..400)
            .map(|k| {
                let ray = Vector3::new(random.in_range(-0.4, 0.4), random.in_range(-0.3, 0.3), 1.0);
                let center = camera.center().coords;
                let on_plane = (truth.d - truth.normal.dot(&center)) / truth.normal.dot(&ray);
                let z = if k % 5 == 0 { random.in_range(1.0, 9.0) } else { on_plane };
                (Point3::from(center + ray * z), 1.0)
            })
            .collect();
        let got = Plane::fit(&points, &camera).unwrap();
        assert!((got.normal - truth.normal).norm() < 1e-3, "{got:?}");
        assert!((got.d - truth.d).abs() < 2e-3, "{got:?}");
    }

    #[test]
    fn few_points_give_a_plane_that_faces_the_camera() {
        let camera = pinhole_at([0.0; 3]);
        let one = Point3::new(0.1, 0.2, 2.0);
        let plane = Plane::fit(&[(one, 1.0)], &camera).unwrap();
        assert!(distance(&plane, &one) < 1e-9 && (plane.normal - Vector3::z()).norm() < 1e-9);

        let line: Vec<_> =
            (0..9).map(|k| (Point3::new(0.05 * f64::from(k), 0.0, 2.0), 1.0)).collect();
        let plane = Plane::fit(&line, &camera).unwrap();
        assert!((plane.normal - Vector3::z()).norm() < 1e-6, "collinear: {plane:?}");
        let plane = Plane::fit(&[(one, 1.0); 5], &camera).unwrap();
        assert!(distance(&plane, &one) < 1e-9, "duplicates: {plane:?}");
    }

    #[test]
    fn beside_the_view_there_is_a_depth_too() {
        let camera = pinhole_at([0.0; 3]);
        let points = [[9.0, 0.0, 2.0], [-9.0, 0.0, 2.0], [0.0, 0.0, -1.0], [0.0, 0.0, f64::NAN]];
        let plane = Plane::amid(&points.map(Point3::from), &camera).unwrap();
        assert_eq!(plane, Plane { normal: Vector3::z(), d: 2.0 });
        assert_eq!(
            Plane::amid(&points[2..].iter().map(|p| Point3::from(*p)).collect::<Vec<_>>(), &camera),
            None
        );
    }

    #[test]
    fn ignored_points_alone_give_none() {
        let camera = pinhole_at([0.0; 3]);
        assert_eq!(Plane::fit(&[], &camera), None);
        for p in [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [f64::NAN, 0.0, 1.0], [9.0, 0.0, 1.0]] {
            assert_eq!(Plane::fit(&[(Point3::from(p), 1.0)], &camera), None, "{p:?}");
        }
        assert_eq!(Plane::fit(&[(Point3::new(0.0, 0.0, 1.0), 0.0)], &camera), None);
    }

    #[test]
    fn a_plane_too_steep_is_flattened_until_the_view_sees_it_all() {
        let camera = pinhole_at([0.0; 3]);
        // A floor 0.3 m below the camera: it fills only the lower half of the image.
        let floor: Vec<_> = (0..50)
            .map(|k| (Point3::new(0.1 * f64::from(k % 5), 0.3, 1.0 + 0.1 * f64::from(k)), 1.0))
            .collect();
        let g = Plane::fit(&floor, &camera).unwrap().inverse_depth(&camera).unwrap();
        for corner in ViewBounds::of(&camera).unwrap().corners() {
            assert!(g.dot(&Vector3::new(corner.x, corner.y, 1.0)) > 0.0);
        }
    }

    #[test]
    fn a_plane_through_the_centre_has_no_inverse_depth() {
        let camera = pinhole_at([0.0; 3]);
        assert_eq!(Plane { normal: Vector3::x(), d: 0.0 }.inverse_depth(&camera), None);
    }
}
