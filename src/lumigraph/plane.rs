//! The plane proxy of §6: the paper's "3D planar proxy in which the plane's depth can be interactively
//! controlled by the user. Its placement determines which region of the scene is in focus."
//!
//! In a view, the inverse depth of a plane is a linear function: `1/z = g · (x, y, 1)` on the ray (x, y, 1). All points
//! p of the plane, in the camera's frame, satisfy `g · p = 1`. Disparity is proportional to inverse depth. A
//! least-squares fit of inverse depths therefore minimizes errors of disparity in pixels.

use super::rays::ViewBounds;
use crate::camera::Camera;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

/// Margin around the camera's field of view within which points are used for a plane fit, as a fraction of the field of
/// view's width or height.
const MARGIN: f64 = 0.5;
/// Weight of the prior that a fitted plane has no tilt, as a fraction of the points' total weight.
const TILT_PRIOR: f64 = 1e-6;
/// Maximum number of reweighting iterations of a plane fit. About ten iterations are needed.
const ROUNDS: usize = 20;
/// Minimum inverse depth of a fitted plane anywhere in the view, as a fraction of its inverse depth at the points' mean
/// position.
const MIN_FRACTION: f64 = 0.1;

/// A plane in the world. Its points x satisfy `normal · x = d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal of the plane in world coordinates.
    pub normal: Vector3<f64>,
    /// Signed distance of the plane from the world's origin along the normal, metres.
    pub d: f64,
}

impl Plane {
    /// Returns the plane that is perpendicular to the camera's optical axis at the depth `depth_m`, metres.
    pub fn fronto_parallel(camera: &Camera, depth_m: f64) -> Self {
        let normal = camera.axis();
        Self { normal, d: normal.dot(&camera.center().coords) + depth_m }
    }

    /// Fits a plane to points in the world, by robust least squares of their inverse depths in a camera.
    ///
    /// Points behind the camera, far outside its image, or not finite are ignored. For a single point or collinear
    /// points, the result is the plane through them that is closest to perpendicular to the optical axis. Every ray of
    /// the view meets the plane in front of the camera. `None` if no point remains.
    pub fn fit(points: &[Point3<f64>], camera: &Camera) -> Option<Self> {
        let bounds = ViewBounds::of(camera)?;
        let counted = bounds.enlarged(MARGIN);
        let project = |point| ProjectedPoint::new(point, camera, &counted);
        let projections: Vec<ProjectedPoint> = points.iter().filter_map(project).collect();
        let g = fit_plane(&projections, PlaneLoss::Robust, &bounds)?;
        // The normal and d follow from g · (R x + t) = 1. The length of g is positive, because the plane's inverse
        // depth in the middle of the view is positive.
        let length = g.norm();
        let normal = camera.cam_from_world.rotation.inverse_transform_vector(&g) / length;
        let d = (1.0 - g.dot(&camera.cam_from_world.translation.vector)) / length;
        (normal.iter().all(|v| v.is_finite()) && d.is_finite()).then_some(Self { normal, d })
    }

    /// Returns the fronto-parallel plane at the median inverse depth of all points in front of the camera, including
    /// points outside its image. `None` if no point is in front of the camera.
    pub fn amid(points: &[Point3<f64>], camera: &Camera) -> Option<Self> {
        let mut inverse: Vec<f64> =
            points.iter().map(|p| 1.0 / (camera.cam_from_world * p).z).collect();
        inverse.retain(|v| *v > 0.0 && v.is_finite());
        inverse.sort_by(f64::total_cmp);
        Some(Self::fronto_parallel(camera, 1.0 / inverse.get(inverse.len() / 2)?))
    }

    /// Returns the plane as the vector g, 1/m, in the camera's axes. The inverse depth on the ray (x, y, 1) is g · (x,
    /// y, 1). `None` if the plane passes through the camera's centre.
    pub(super) fn inverse_depth(&self, camera: &Camera) -> Option<Vector3<f64>> {
        let distance = self.d - self.normal.dot(&camera.center().coords);
        let g = camera.cam_from_world.rotation * self.normal / distance;
        g.iter().all(|v| v.is_finite()).then_some(g)
    }
}

/// A 3D point, projected into a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProjectedPoint {
    /// Position of the projected point on the plane z = 1.
    pub at: Point2<f64>,
    /// Inverse depth of the point, 1/m, positive.
    pub inverse_depth: f64,
}

impl ProjectedPoint {
    /// Projects a point of the world into a camera. `None` if the point is behind the camera, outside `bounds`, or not
    /// finite.
    pub fn new(point: &Point3<f64>, camera: &Camera, bounds: &ViewBounds) -> Option<Self> {
        let p = camera.cam_from_world * point;
        let at = Point2::new(p.x / p.z, p.y / p.z);
        let inverse_depth = 1.0 / p.z;
        let counts = inverse_depth > 0.0 && inverse_depth.is_finite() && bounds.contains(&at);
        counts.then_some(Self { at, inverse_depth })
    }

    pub fn ray(&self) -> Vector3<f64> {
        Vector3::new(self.at.x, self.at.y, 1.0)
    }
}

/// Loss function of a plane fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PlaneLoss {
    /// Cauchy loss with the median absolute residual as scale. The plane passes through the middle of the points.
    Robust,
    /// Asymmetric squared loss. Points in front of the plane have the given weight, and points behind the plane have
    /// the weight 1.
    Behind(f64),
}

/// Fits the vector g of a plane ([`Plane::inverse_depth`]) to points by iteratively reweighted least squares. In the
/// whole view, given by `bounds`, the plane lies in front of the camera. `None` without points.
pub(super) fn fit_plane(
    points: &[ProjectedPoint],
    loss: PlaneLoss,
    bounds: &ViewBounds,
) -> Option<Vector3<f64>> {
    let mut g = Vector3::new(0.0, 0.0, median(points, |p| p.inverse_depth)?);
    for _ in 0..ROUNDS {
        let scale = match loss {
            PlaneLoss::Robust => median(points, |p| residual(p, &g).abs())?,
            PlaneLoss::Behind(_) => 0.0,
        };
        let next = least_squares(points, |p| {
            let residual = residual(p, &g);
            match loss {
                PlaneLoss::Robust if scale > 0.0 => 1.0 / (1.0 + (residual / scale).powi(2)),
                PlaneLoss::Behind(weight) if residual > 0.0 => weight,
                _ => 1.0,
            }
        })?;
        if next == g {
            break;
        }
        g = next;
    }
    Some(flattened(g, points, bounds))
}

/// Returns a point's inverse depth minus the inverse depth of the plane `g` on the same ray, 1/m. The residual is
/// positive if the point is in front of the plane.
fn residual(p: &ProjectedPoint, g: &Vector3<f64>) -> f64 {
    p.inverse_depth - g.dot(&p.ray())
}

/// Fits the vector g of a plane by weighted least squares of inverse depths, with a prior of zero tilt. `None` if the
/// normal equations are singular.
fn least_squares(
    points: &[ProjectedPoint],
    weight: impl Fn(&ProjectedPoint) -> f64,
) -> Option<Vector3<f64>> {
    let (mut normal, mut right, mut total) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for p in points {
        let (w, ray) = (weight(p), p.ray());
        normal += ray * ray.transpose() * w;
        right += ray * (p.inverse_depth * w);
        total += w;
    }
    normal[(0, 0)] += TILT_PRIOR * total;
    normal[(1, 1)] += TILT_PRIOR * total;
    normal.cholesky().map(|c| c.solve(&right))
}

/// Reduces the tilt of the plane `g` about the points' mean position until the plane is in front of the camera in the
/// whole view. Returns the vector g of the new plane.
fn flattened(g: Vector3<f64>, points: &[ProjectedPoint], bounds: &ViewBounds) -> Vector3<f64> {
    let mean = |axis: usize| points.iter().map(|p| p.at[axis]).sum::<f64>() / points.len() as f64;
    let ray = Vector3::new(mean(0), mean(1), 1.0);
    let nearest = points.iter().map(|p| p.inverse_depth).fold(f64::INFINITY, f64::min);
    // The fit to positive inverse depths is positive at the mean position, except for rounding.
    let middle = g.dot(&ray).max(nearest);
    let mut fraction: f64 = 1.0;
    for corner in bounds.corners() {
        let change = g.x * (corner.x - ray.x) + g.y * (corner.y - ray.y);
        if change < 0.0 {
            fraction = fraction.min(middle * (1.0 - MIN_FRACTION) / -change);
        }
    }
    let tilt = g.xy() * fraction;
    Vector3::new(tilt.x, tilt.y, middle - tilt.dot(&ray.xy()))
}

/// Returns the lower median of `value` over the points. `None` without points.
fn median(points: &[ProjectedPoint], value: impl Fn(&ProjectedPoint) -> f64) -> Option<f64> {
    let mut values: Vec<f64> = points.iter().map(value).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied()
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
                Point3::from(center + ray * z)
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
        let plane = Plane::fit(&[one], &camera).unwrap();
        assert!(distance(&plane, &one) < 1e-9 && (plane.normal - Vector3::z()).norm() < 1e-9);

        let line: Vec<_> = (0..9).map(|k| Point3::new(0.05 * f64::from(k), 0.0, 2.0)).collect();
        let plane = Plane::fit(&line, &camera).unwrap();
        assert!((plane.normal - Vector3::z()).norm() < 1e-6, "collinear: {plane:?}");
        let plane = Plane::fit(&[one; 5], &camera).unwrap();
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
            assert_eq!(Plane::fit(&[Point3::from(p)], &camera), None, "{p:?}");
        }
    }

    #[test]
    fn a_plane_too_steep_is_flattened_until_the_view_sees_it_all() {
        let camera = pinhole_at([0.0; 3]);
        // The points are on a floor 0.3 m below the camera, which fills only the lower half of the image.
        let floor: Vec<_> = (0..50)
            .map(|k| Point3::new(0.1 * f64::from(k % 5), 0.3, 1.0 + 0.1 * f64::from(k)))
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
