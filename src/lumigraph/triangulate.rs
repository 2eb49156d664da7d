//! Triangulation of a 3D point from its images in several cameras at one instant.
//!
//! The unknowns are a direction (u, v) from the first camera and an inverse distance ρ:
//! `X = C_0 + s (r + u e_1 + v e_2) / ρ`. Here C_i are the cameras' centres, r is the unit ray of the first camera, e_1
//! and e_2 complete r to an orthonormal basis, and s is the largest distance of any camera from the first camera.
//! Camera i, with the rotation R_i, sees X in the direction `R_i (r + u e_1 + v e_2 + ρ (C_0 − C_i) / s)`. This
//! direction is linear in (u, v, ρ), and finite for a point at infinity, where ρ = 0. The linear solution is well
//! conditioned, and independent of the world's origin and scale.

use crate::camera::Camera;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

/// A triangulated point with measures of its accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// Position of the point in the world, metres.
    pub point: Point3<f64>,
    /// Root mean square reprojection error over the observations, pixels.
    pub rms_px: f64,
    /// Largest angle between the rays of any two observations, radians.
    pub max_angle_rad: f64,
}

/// Minimum parallax of a triangulated point, pixels: the largest angle between two of its rays, in radians, times the
/// longest focal length of the cameras. It is about the resolution of feature trackers.
const MIN_PARALLAX_PX: f64 = 0.07;
/// Maximum number of Levenberg–Marquardt steps of a triangulation. 2 to 5 steps are needed.
const MAX_ITERATIONS: usize = 20;
/// Length of a Levenberg–Marquardt step in (u, v, ρ) below which a triangulation ends.
const MIN_STEP: f64 = 1e-14;

/// An observation of a point by camera i, as an equation in the unknowns (u, v, ρ). The module's documentation defines
/// the symbols.
struct ObservationEquation {
    /// Rotation R_i times the basis (e_1, e_2, r). It transforms from this basis to the axes of camera i.
    rotation: Matrix3<f64>,
    /// Vector (C_0 − C_i) / s, from the centre of camera i to the first camera's centre, scaled, in the axes of camera
    /// i.
    shift: Vector3<f64>,
    /// Observed position of the point on the plane z = 1.
    observed: Point2<f64>,
    /// Focal lengths in x and y, pixels.
    focal: (f64, f64),
}

impl ObservationEquation {
    /// Returns the direction from the camera to the point p = (u, v, ρ), in the camera's axes. Its length is the
    /// distance times ρ / s.
    fn direction(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * Vector3::new(p.x, p.y, 1.0) + self.shift * p.z
    }

    /// Returns the derivative of [`Self::direction`] with respect to (u, v, ρ).
    fn derivative(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&[
            self.rotation.column(0).into_owned(),
            self.rotation.column(1).into_owned(),
            self.shift,
        ])
    }
}

/// Triangulates a point of the world from its pixel positions in several cameras. Minimizes the squared reprojection
/// errors, in pixels without lens distortion.
///
/// `None` if there are fewer than two observations or fewer than two distinct camera centres, if a pixel's ray can't be
/// computed, if all rays are parallel to within 0.07 px, or if the point is at infinity or behind a camera.
pub fn triangulate(observations: &[(&Camera, Point2<f64>)]) -> Option<Triangulated> {
    let rays: Vec<Vector3<f64>> = observations
        .iter()
        .map(|(camera, pixel)| Some(camera.ray_world(pixel)?.normalize()))
        .collect::<Option<_>>()?;
    let max_angle_rad = max_angle(&rays);
    let center = observations.first()?.0.center();
    let scale = observations
        .iter()
        .map(|(camera, _)| (camera.center() - center).norm())
        .fold(0.0, f64::max);
    let focal_px = observations.iter().map(|(camera, _)| camera.focal_px()).fold(0.0, f64::max);
    // The negated comparison also rejects NaN coordinates. Focal lengths are positive.
    if !(max_angle_rad * focal_px >= MIN_PARALLAX_PX && scale > 0.0 && scale.is_finite()) {
        return None;
    }

    let axes = axes_along(&rays[0]);
    let equations: Vec<ObservationEquation> = observations
        .iter()
        .map(|(camera, pixel)| {
            let rotation = camera.cam_from_world.rotation.to_rotation_matrix();
            let (fx, fy, ..) = camera.model.intrinsics();
            Some(ObservationEquation {
                rotation: rotation.matrix() * axes,
                shift: rotation * ((center - camera.center()) / scale),
                observed: camera.model.normalized_from_pixel(pixel)?,
                focal: (fx, fy),
            })
        })
        .collect::<Option<_>>()?;

    let start = linear(&equations)?;
    let p = refine(&equations, start);
    // At a smaller ρ, the point's distance exceeds s divided by the square of the minimum angle, and its parallax is
    // far below the minimum.
    if !(p.z > (MIN_PARALLAX_PX / focal_px).powi(2))
        || equations.iter().any(|e| !(e.direction(&p).z > 0.0))
    {
        return None;
    }
    let point = center + axes * Vector3::new(p.x, p.y, 1.0) * (scale / p.z);
    let mut sum = 0.0;
    for (camera, pixel) in observations {
        sum += (camera.project(&point)? - pixel).norm_squared();
    }
    let rms_px = (sum / observations.len() as f64).sqrt();
    Some(Triangulated { point, rms_px, max_angle_rad })
}

/// Returns the largest angle between any two of the rays, radians.
fn max_angle(rays: &[Vector3<f64>]) -> f64 {
    let mut largest: f64 = 0.0;
    for (i, a) in rays.iter().enumerate() {
        for b in &rays[i + 1..] {
            largest = largest.max(a.cross(b).norm().atan2(a.dot(b)));
        }
    }
    largest
}

/// Returns an orthonormal basis, as the columns (e_1, e_2, r), for a unit vector r.
fn axes_along(r: &Vector3<f64>) -> Matrix3<f64> {
    // The coordinate axis with the smallest component along r is used. Its cross product with r has a length of at
    // least sqrt(2/3).
    let e1 = r.cross(&Vector3::ith_axis(r.iamin())).normalize();
    Matrix3::from_columns(&[e1, r.cross(&e1), *r])
}

/// Solves the equations `x · q_z − q_x = 0` and `y · q_z − q_y = 0` of all observations by linear least squares. (x, y)
/// is the observed point, and q is the direction, which is linear in (u, v, ρ). Returns (u, v, ρ). `None` if the system
/// is singular.
fn linear(equations: &[ObservationEquation]) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for e in equations {
        let (d, q) = (e.derivative(), e.rotation.column(2));
        for (row, observed, f) in [(0, e.observed.x, e.focal.0), (1, e.observed.y, e.focal.1)] {
            let a = (d.row(2) * observed - d.row(row)).transpose() * f;
            let b = -(q[2] * observed - q[row]) * f;
            normal += a * a.transpose();
            right += a * b;
        }
    }
    normal.cholesky().map(|c| c.solve(&right))
}

/// Computes the sum of squared reprojection errors at p = (u, v, ρ), in pixels without distortion, its gradient, and
/// its Gauss–Newton matrix. The sum is infinite if the point is behind a camera.
fn cost(equations: &[ObservationEquation], p: &Vector3<f64>) -> (f64, Vector3<f64>, Matrix3<f64>) {
    let (mut sum, mut gradient, mut normal) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for e in equations {
        let q = e.direction(p);
        if !(q.z > 0.0) {
            return (f64::INFINITY, gradient, normal);
        }
        let d = e.derivative();
        for (row, observed, f) in [(0, e.observed.x, e.focal.0), (1, e.observed.y, e.focal.1)] {
            let residual = (q[row] / q.z - observed) * f;
            let j = (d.row(row) - d.row(2) * (q[row] / q.z)).transpose() * (f / q.z);
            sum += residual * residual;
            gradient += j * residual;
            normal += j * j.transpose();
        }
    }
    (sum, gradient, normal)
}

/// Minimizes [`cost`] over (u, v, ρ) by Levenberg–Marquardt. A start behind a camera is returned unchanged.
fn refine(equations: &[ObservationEquation], start: Vector3<f64>) -> Vector3<f64> {
    let mut p = start;
    let (mut error, mut gradient, mut normal) = cost(equations, &p);
    if !error.is_finite() {
        return p;
    }
    let mut damping = 1e-9;
    for _ in 0..MAX_ITERATIONS {
        let mut damped = normal;
        for k in 0..3 {
            damped[(k, k)] *= 1.0 + damping;
        }
        let Some(factors) = damped.cholesky() else { break };
        let step = -factors.solve(&gradient);
        let next = p + step;
        let (next_error, next_gradient, next_normal) = cost(equations, &next);
        if next_error <= error {
            (p, error, gradient, normal) = (next, next_error, next_gradient, next_normal);
            damping *= 0.1;
        } else {
            damping = (damping * 100.0).max(1e-6);
        }
        if step.norm() <= MIN_STEP {
            break;
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;
    use crate::camera::tests::pinhole_at;
    use nalgebra::{Translation3, UnitQuaternion};

    fn rig(random: &mut Random, count: usize) -> Vec<Camera> {
        (0..count)
            .map(|_| {
                let mut camera = pinhole_at([0.0; 3]);
                let turn = UnitQuaternion::from_euler_angles(
                    random.in_range(-0.2, 0.2),
                    random.in_range(-0.2, 0.2),
                    random.in_range(-3.0, 3.0),
                );
                let at = Vector3::from_fn(|_, _| random.in_range(-0.5, 0.5));
                camera.cam_from_world.rotation = turn;
                camera.cam_from_world.translation = Translation3::from(-(turn * at));
                camera
            })
            .collect()
    }

    #[test]
    fn thousands_of_random_points_are_found() {
        let mut random = Random::new(1);
        let mut solved = 0;
        for _ in 0..5000 {
            let count = 2 + (random.unit() * 7.0) as usize;
            let cameras = rig(&mut random, count);
            let z = random.in_range(1.0, 20.0);
            let truth = Point3::new(random.in_range(-0.3, 0.3) * z, random.in_range(-0.3, 0.3), z);
            let observations: Option<Vec<_>> =
                cameras.iter().map(|c| Some((c, c.project(&truth)?))).collect();
            let Some(observations) = observations else { continue };
            let Some(got) = triangulate(&observations) else { continue };
            solved += 1;
            let tolerance = 1e-11 * z / got.max_angle_rad;
            assert!((got.point - truth).norm() < tolerance, "{got:?} {truth:?}");
            assert!(got.rms_px < 1e-8, "{got:?}");
        }
        assert!(solved > 4900, "{solved}");
    }

    #[test]
    fn noise_is_fitted_to_the_last_digit_of_the_reprojection_error() {
        let mut random = Random::new(2);
        for _ in 0..500 {
            let cameras = rig(&mut random, 5);
            let truth = Point3::new(random.in_range(-0.3, 0.3), 0.1, random.in_range(2.0, 4.0));
            let observations: Vec<_> = cameras
                .iter()
                .map(|c| {
                    let noise = nalgebra::Vector2::from_fn(|_, _| random.in_range(-0.5, 0.5));
                    (c, c.project(&truth).unwrap() + noise)
                })
                .collect();
            let Some(got) = triangulate(&observations) else { continue };
            let error = |p: &Point3<f64>| -> f64 {
                observations.iter().map(|(c, s)| (c.project(p).unwrap() - s).norm_squared()).sum()
            };
            let best = error(&got.point);
            for k in 0..6 {
                let mut beside = got.point;
                beside[k % 3] += if k < 3 { 1e-4 } else { -1e-4 };
                assert!(error(&beside) >= best);
            }
        }
    }

    #[test]
    fn shifting_and_scaling_the_world_changes_nothing() {
        let mut random = Random::new(3);
        let cameras = rig(&mut random, 4);
        let truth = Point3::new(0.1, 0.2, 3.0);
        let solve = |scale: f64, shift: Vector3<f64>| {
            let moved: Vec<Camera> = cameras
                .iter()
                .map(|c| {
                    let mut m = c.clone();
                    let center = c.center().coords * scale + shift;
                    m.cam_from_world.translation =
                        Translation3::from(-(c.cam_from_world.rotation * center));
                    m
                })
                .collect();
            let observations: Vec<_> = cameras
                .iter()
                .zip(&moved)
                .enumerate()
                .map(|(k, (c, m))| {
                    let off = nalgebra::Vector2::new(0.3, -0.2) * (k as f64);
                    (m, c.project(&truth).unwrap() + off)
                })
                .collect();
            let got = triangulate(&observations).unwrap();
            Point3::from((got.point.coords - shift) / scale)
        };
        let plain = solve(1.0, Vector3::zeros());
        assert!((solve(1e-6, Vector3::zeros()) - plain).norm() < 1e-9);
        assert!((solve(1e6, Vector3::zeros()) - plain).norm() < 1e-9);
        assert!((solve(1.0, Vector3::new(1e4, -1e4, 1e4)) - plain).norm() < 1e-6);
    }

    #[test]
    fn degenerate_observations_give_none() {
        let (a, b) = (pinhole_at([0.0; 3]), pinhole_at([0.06, 0.0, 0.0]));
        let p = Point2::new(300.0, 200.0);
        assert_eq!(triangulate(&[]), None, "nothing");
        assert_eq!(triangulate(&[(&a, p)]), None, "one ray");
        assert_eq!(triangulate(&[(&a, p), (&a, p)]), None, "a duplicate");
        let q = Point2::new(310.0, 200.0);
        assert_eq!(triangulate(&[(&a, p), (&a, q)]), None, "coincident centres");
        assert_eq!(triangulate(&[(&a, p), (&b, p)]), None, "parallel rays");
        assert_eq!(triangulate(&[(&a, p), (&b, q)]), None, "rays that meet behind");
        let nan = Point2::new(f64::NAN, 1.0);
        assert_eq!(triangulate(&[(&a, p), (&b, nan)]), None, "not a number");
        assert!(triangulate(&[(&a, q), (&b, p)]).is_some());
    }

    #[test]
    fn a_duplicated_observation_only_adds_weight() {
        let (a, b) = (pinhole_at([0.0; 3]), pinhole_at([0.06, 0.0, 0.0]));
        let (p, q) = (Point2::new(310.0, 200.0), Point2::new(300.0, 200.0));
        let once = triangulate(&[(&a, p), (&b, q)]).unwrap();
        let twice = triangulate(&[(&a, p), (&b, q), (&b, q)]).unwrap();
        assert!((once.point - twice.point).norm() < 1e-9);
    }
}
