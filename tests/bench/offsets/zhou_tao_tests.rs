//! The estimator of Zhou and Tao on simulated motions.

use super::zhou_tao::{FourPoints, cross_ratio_offset};
use nalgebra::{Isometry3, Point3, Vector3};
use stlfr::camera::{Camera, CameraModel};
use stlfr::random::Random;

/// A camera of a row along the x axis, at x metres.
fn camera(x: f64) -> Camera {
    Camera {
        width: 640,
        height: 480,
        model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
        cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
    }
}

fn four_points(
    cameras: [&Camera; 2],
    at: impl Fn(f64) -> Point3<f64>,
    t: f64,
    frame_s: [f64; 2],
) -> FourPoints {
    let pixel = |c: &Camera, t: f64| c.project(&at(t)).unwrap();
    FourPoints {
        in_i: [0.0, frame_s[0]].map(|t| pixel(cameras[0], t)),
        in_j: [t, t + frame_s[1]].map(|t| pixel(cameras[1], t)),
    }
}

/// Uniform motion in space and in depth, whose speed in the image is not constant.
#[test]
fn candidates_are_exact_for_thousands_of_uniform_motions() {
    let (i, j) = (camera(0.0), camera(0.06));
    let random = &mut Random::new(3);
    for _ in 0..5000 {
        let mut signed = || 2.0 * random.unit() - 1.0;
        let (p, v) = (
            Point3::new(0.3 * signed(), 0.3 * signed(), 2.0 + 0.4 * signed()),
            Vector3::new(signed(), 0.4 + 0.5 * signed().abs(), 0.5 * signed()),
        );
        let frame_s = [1.0 / 30.0, 1.0 / 30.0 + 0.01 * signed()];
        // At t̃ near 0 both solutions coincide, and cannot be told apart.
        let fraction = 0.3 + 0.65 * signed().abs();
        let t = if signed() > 0.0 { fraction * frame_s[0] } else { -fraction * frame_s[1] };
        let points = four_points([&i, &j], |t| p + v * t, t, frame_s);
        let candidate = cross_ratio_offset([&i, &j], &points, frame_s).unwrap();
        assert!((candidate - t).abs() < 1e-8, "{candidate} {t} {frame_s:?}");
    }
}

#[test]
fn motion_along_the_line_and_none_have_no_solution() {
    let (i, j) = (camera(0.0), camera(0.06));
    let frame_s = [0.03, 0.03];
    for v in [Vector3::new(1.0, 0.0, 0.0), Vector3::zeros()] {
        let points = four_points([&i, &j], |t| Point3::new(0.1, 0.1, 2.0) + v * t, 0.01, frame_s);
        assert_eq!(cross_ratio_offset([&i, &j], &points, frame_s), None);
    }
}

#[test]
fn common_centres_and_backward_motion_have_no_solution() {
    let (i, j) = (camera(0.0), camera(0.06));
    let frame_s = [0.03, 0.03];
    let at = |t: f64| Point3::new(0.1, 0.1 + t, 2.0);
    let points = four_points([&i, &j], at, 0.01, frame_s);
    assert_eq!(cross_ratio_offset([&i, &i], &points, frame_s), None);
    let back = FourPoints { in_j: [points.in_j[1], points.in_j[0]], ..points };
    assert_eq!(cross_ratio_offset([&i, &j], &back, frame_s), None);
}
