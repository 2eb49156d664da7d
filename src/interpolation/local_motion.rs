//! Motions of tracks, and the local affine motion that is fitted to those around a point.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Point2, Vector2, Vector3};

/// A track's position at an instant and its displacements to the four frames around it. Pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Position at the instant.
    pub at: Point2<f64>,
    /// Displacements from there to the positions in the frames before, earlier, later and after; 0 to
    /// a frame that does not exist.
    pub to: [Vector2<f64>; 4],
    /// The linear part of the motion from the earlier frame to the later one: the identity where the
    /// track's window only translated.
    pub deformation: Matrix2<f64>,
}

impl Motion {
    /// How far this motion, continued to where another track is, is from that track's between the earlier and
    /// the later frame; pixels.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        let from = |m: &Self| m.at + m.to[1];
        let by = |deformation: &Matrix2<f64>| {
            let apart = from(other) - from(self);
            let change = (other.to[2] - other.to[1]) - (self.to[2] - self.to[1]);
            (change - (deformation * apart - apart)).norm()
        };
        by(&self.deformation).min(by(&other.deformation))
    }
}

/// Exponent by which a track's weight falls with its distance. Larger: the nearest track alone decides, with
/// its error; smaller: the motion is the average of several surfaces.
const DISTANCE_POWER: i32 = 3;
/// Ridge of the fitted gradient: it counts as if tracks were spread by this much, pixels. Larger: rotation
/// and zoom are taken for translation; smaller: two close tracks' errors are taken for rotation.
const RIDGE_PX: f64 = 2.0;

/// An affine motion around a point: the displacements there, and their derivatives by position. By default none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LocalMotion {
    to: [Vector2<f64>; 4],
    per_px: [Matrix2<f64>; 4],
}

impl LocalMotion {
    /// The weighted least-squares fit to tracks, weighted by nearness to `center`. `None` without tracks,
    /// or if a coordinate is not finite.
    pub(super) fn fit(members: &[&Motion], center: &Point2<f64>) -> Option<Self> {
        let mut normal = Matrix3::zeros();
        let mut right = [Matrix3x2::zeros(); 4];
        for motion in members {
            let from = motion.at - center;
            let weight = 1.0 / (1.0 + from.norm()).powi(DISTANCE_POWER);
            let row = Vector3::new(1.0, from.x, from.y);
            normal += weight * row * row.transpose();
            for (right, to) in right.iter_mut().zip(&motion.to) {
                *right += weight * row * to.transpose();
            }
        }
        // With any track the diagonal is positive, and the system well-conditioned.
        let ridge = normal[(0, 0)] * RIDGE_PX.powi(2);
        normal[(1, 1)] += ridge;
        normal[(2, 2)] += ridge;
        let solver = normal.cholesky()?;
        let solved = right.map(|r| solver.solve(&r));
        Some(Self {
            to: solved.map(|s| s.row(0).transpose()),
            per_px: solved.map(|s| s.fixed_view::<2, 2>(1, 0).transpose()),
        })
    }

    /// The displacement, pixels, to frame 0 to 3 (before, earlier, later, after), at an offset from the
    /// centre.
    pub(super) fn at(&self, frame: usize, from_center: Vector2<f64>) -> Vector2<f64> {
        self.to[frame] + self.per_px[frame] * from_center
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(x: f64, y: f64, to: Vector2<f64>) -> Motion {
        Motion {
            at: Point2::new(x, y),
            to: [to * -1.5, to * -0.5, to * 0.5, to * 1.5],
            deformation: Matrix2::identity(),
        }
    }

    #[test]
    fn a_shift_is_found_exactly() {
        let shift = Vector2::new(3.0, -2.0);
        let tracks = [(4.0, 9.0), (12.0, 7.0), (8.0, 1.0)].map(|(x, y)| motion(x, y, shift));
        let fit = LocalMotion::fit(&tracks.each_ref(), &Point2::new(8.0, 8.0)).unwrap();
        for from in [Vector2::zeros(), Vector2::new(6.0, -3.0)] {
            assert!((fit.at(2, from) - 0.5 * shift).norm() < 1e-9);
            assert!((fit.at(0, from) + 1.5 * shift).norm() < 1e-9);
        }
    }

    #[test]
    fn a_turn_is_followed_better_than_by_a_shift() {
        let center = Point2::new(23.0, 23.0);
        let turn = |p: Point2<f64>| Vector2::new(-0.05 * (p.y - 23.0), 0.05 * (p.x - 23.0));
        let tracks: Vec<Motion> = (0..49)
            .map(|k| Point2::new(2.0 + 6.0 * (k % 7) as f64, 2.0 + 6.0 * (k / 7) as f64))
            .map(|p| motion(p.x, p.y, turn(p)))
            .collect();
        let fit = LocalMotion::fit(&tracks.iter().collect::<Vec<_>>(), &center).unwrap();
        let from = Vector2::new(8.0, 8.0);
        let error = (fit.at(2, from) - 0.5 * turn(center + from)).norm();
        assert!(error < 0.6 * 0.5 * turn(center + from).norm(), "{error}");
    }

    #[test]
    fn no_tracks_no_motion() {
        assert_eq!(LocalMotion::fit(&[], &Point2::origin()), None);
    }

    #[test]
    fn a_single_track_is_a_shift() {
        let one = motion(3.0, 3.0, Vector2::new(1.0, 0.0));
        let fit = LocalMotion::fit(&[&one], &Point2::new(3.0, 3.0)).unwrap();
        assert!((fit.at(3, Vector2::new(5.0, 5.0)) - Vector2::new(1.5, 0.0)).norm() < 1e-9);
    }
}
