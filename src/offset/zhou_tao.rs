//! Zhou and Tao's estimator (CVPR 2003), beside the paper's: four points instead of three.
//!
//! A feature in uniform motion is seen at `p_i(t)`, `p_i(t+Δt_i)`, `p_j(t')` and `p_j(t'+Δt_j)`.
//! The two points of camera j lie on the path in camera i where their epipolar lines cross it. A
//! projection keeps the cross ratio of the four points, which uniform motion makes that of the
//! four times: no straight line in the image has to be travelled at constant speed, but a fourth
//! frame is needed at a known time.

use crate::camera::{Camera, EpipolarGeometry};
use nalgebra::Point2;

/// A feature's four points, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FourPoints {
    /// In camera i, at t and a frame later.
    pub in_i: [Point2<f64>; 2],
    /// In camera j, at t' and a frame later.
    pub in_j: [Point2<f64>; 2],
}

/// `t̃ = t' − t` of one feature, seconds, for `−Δt_j < t̃ < Δt_i`; `frame_s` are Δt_i and Δt_j.
///
/// `None` for points that have no epipolar line, for a path that both lines don't cross (it runs
/// along them), for no motion, and where noise leaves the cross ratio without a solution.
pub fn cross_ratio_offset(
    [camera_i, camera_j]: [&Camera; 2],
    points: &FourPoints,
    frame_s: [f64; 2],
) -> Option<f64> {
    let i_from_j = EpipolarGeometry::new(camera_j, camera_i)?;
    let [start, end] = points.in_i.map(|p| camera_i.model.ideal_from_pixel(&p));
    let (start, end) = (start?, end?);
    // Where the epipolar line crosses the path: 0 at its start, 1 at its end.
    let crossing = |p: Point2<f64>| {
        let line = i_from_j.line_in_j(&camera_j.model.ideal_from_pixel(&p)?)?;
        let (near, far) = (line.distance(&start), line.distance(&end));
        let at = near / (near - far);
        at.is_finite().then_some(at)
    };
    let (first, second) = (crossing(points.in_j[0])?, crossing(points.in_j[1])?);
    solve([first, second], frame_s)
}

/// `(1 − 0)(s₂ − s₁) / ((1 − s₁)(s₂ − 0)) = Δt_i Δt_j / ((Δt_i − t̃)(Δt_j + t̃))`, solved for `t̃`.
/// Of its two solutions the other one is beyond `Δt_i`, or before `−Δt_j`.
fn solve([s1, s2]: [f64; 2], [frame_i, frame_j]: [f64; 2]) -> Option<f64> {
    // The right side's inverse times Δt_i Δt_j. A second point not behind the first moves back.
    let product = frame_i * frame_j * (1.0 - s1) * s2 / (s2 - s1);
    // t̃² − (Δt_i − Δt_j) t̃ + product − Δt_i Δt_j = 0
    let half = 0.5 * (frame_i - frame_j);
    let under_root = half * half + frame_i * frame_j - product;
    let forward = s2 > s1 && under_root >= 0.0;
    let root = forward.then(|| under_root.sqrt())?;
    // Two solutions, as far on both sides of `half`: on which side the camera's point lies.
    let offset = if s1 >= symmetric(s1, s2) { half + root } else { half - root };
    (offset.is_finite() && offset > -frame_j && offset < frame_i).then_some(offset)
}

/// Where `s₁` is at the solutions' middle, for the same stretch between the two: there camera j's
/// two frames lie evenly around camera i's.
fn symmetric(s1: f64, s2: f64) -> f64 {
    0.5 * (1.0 - (s2 - s1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offset::tests::camera;
    use crate::random::Random;
    use nalgebra::{Point3, Vector3};

    fn seen(
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

    /// Uniform motion in space, in depth too, where the paper's straight line in the image is
    /// travelled at a changing speed.
    #[test]
    fn thousands_of_uniform_motions_come_back() {
        let (i, j) = (camera(0.0), camera(0.06));
        let random = &mut Random::new(3);
        for _ in 0..5000 {
            let mut signed = || 2.0 * random.unit() - 1.0;
            let (p, v) = (
                Point3::new(0.3 * signed(), 0.3 * signed(), 2.0 + 0.4 * signed()),
                Vector3::new(signed(), 0.4 + 0.5 * signed().abs(), 0.5 * signed()),
            );
            let frame_s = [1.0 / 30.0, 1.0 / 30.0 + 0.01 * signed()];
            // Where both solutions meet, at t̃ near 0, there is no telling them apart.
            let share = 0.3 + 0.65 * signed().abs();
            let t = if signed() > 0.0 { share * frame_s[0] } else { -share * frame_s[1] };
            let points = seen([&i, &j], |t| p + v * t, t, frame_s);
            let found = cross_ratio_offset([&i, &j], &points, frame_s).unwrap();
            assert!((found - t).abs() < 1e-8, "{found} {t} {frame_s:?}");
        }
    }

    #[test]
    fn motion_along_the_line_and_none_have_no_solution() {
        let (i, j) = (camera(0.0), camera(0.06));
        let frame_s = [0.03, 0.03];
        for v in [Vector3::new(1.0, 0.0, 0.0), Vector3::zeros()] {
            let points = seen([&i, &j], |t| Point3::new(0.1, 0.1, 2.0) + v * t, 0.01, frame_s);
            assert_eq!(cross_ratio_offset([&i, &j], &points, frame_s), None);
        }
    }

    #[test]
    fn cameras_in_one_place_and_points_that_move_back_have_none() {
        let (i, j) = (camera(0.0), camera(0.06));
        let frame_s = [0.03, 0.03];
        let at = |t: f64| Point3::new(0.1, 0.1 + t, 2.0);
        let points = seen([&i, &j], at, 0.01, frame_s);
        assert_eq!(cross_ratio_offset([&i, &i], &points, frame_s), None);
        let back = FourPoints { in_j: [points.in_j[1], points.in_j[0]], ..points };
        assert_eq!(cross_ratio_offset([&i, &j], &back, frame_s), None);
    }
}
