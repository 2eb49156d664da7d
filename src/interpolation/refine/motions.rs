//! Candidate motions of a block. Each is affine and fitted to nearby tracks that move alike.

use crate::interpolation::tracked_pair::TrackMotion;
use crate::registration::Neighbors;
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Point2, Vector2, Vector3};

/// Maximum difference between the motions of two tracks to which one affine motion is fitted, pixels per frame.
const SAME_MOTION_PX: f64 = 1.5;
/// Minimum number of tracks to which a motion is fitted. With a minimum of 1, motions of mismatched tracks would be
/// tried too.
const MIN_TRACKS: usize = 2;
/// Maximum number of candidate motions per block. The motions with the nearest tracks are used.
const MAX_MOTIONS: usize = 6;
/// Exponent of a track's weight in a fit, (1 + distance)^−exponent. The distance is from the block's centre, pixels.
const DISTANCE_POWER: i32 = 3;
/// Ridge regularization, in pixels, of the gradient of a fitted affine motion. It pulls the gradient towards 0, like
/// additional tracks at this distance from the centre whose motions equal the motion of the centre. A larger value
/// makes the fit closer to a translation.
const RIDGE_PX: f64 = 2.0;

/// Four affine motions, from one image to each of the four frames around an instant (before, earlier, later, after).
/// The image is the one in which the fitted tracks have their positions: the interpolated image, or a frame of the
/// pair. Each motion is stored as the displacement of a centre point, and the derivative of the displacement by
/// position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AffineMotion {
    to: [Vector2<f64>; 4],
    per_px: [Matrix2<f64>; 4],
}

impl AffineMotion {
    /// Fits the four affine motions to tracks by least squares. Tracks nearer to `center` (pixels) have more weight.
    /// Returns `None` without tracks, or if a coordinate is not finite.
    pub fn fit(tracks: &[&TrackMotion], center: &Point2<f64>) -> Option<Self> {
        let mut normal = Matrix3::zeros();
        let mut right = [Matrix3x2::zeros(); 4];
        for motion in tracks {
            let from = motion.at - center;
            let weight = 1.0 / (1.0 + from.norm()).powi(DISTANCE_POWER);
            let row = Vector3::new(1.0, from.x, from.y);
            normal += weight * row * row.transpose();
            for (right, to) in right.iter_mut().zip(&motion.to) {
                *right += weight * row * to.transpose();
            }
        }
        // If there is a track, the diagonal is positive, and the system is well-conditioned.
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

    /// Returns the displacement to a frame (0 before, 1 earlier, 2 later, 3 after) of the point at the offset
    /// `from_center` from the centre. Displacement and offset are in pixels.
    pub fn at(&self, frame: usize, from_center: Vector2<f64>) -> Vector2<f64> {
        self.to[frame] + self.per_px[frame] * from_center
    }
}

/// Spatial index of tracks, which gives the candidate motions around any point by fits to the tracks nearby.
pub struct MotionHypotheses {
    pub motions: Vec<TrackMotion>,
    positions: Neighbors,
    search_radius_px: f64,
}

impl MotionHypotheses {
    /// Indexes tracks. Candidate motions around a point are fitted to the tracks within `search_radius_px` of the
    /// point.
    pub fn new(motions: Vec<TrackMotion>, search_radius_px: f64) -> Self {
        let positions = Neighbors::new(motions.iter().map(|m| m.at));
        Self { motions, positions, search_radius_px }
    }

    /// Returns the candidate motions around a point, ordered by the distance of their nearest tracks. Tracks are
    /// clustered greedily, nearest track first: each track that is in no cluster yet starts one, which also gets all
    /// unassigned tracks with a similar motion. A motion is fitted to every cluster of at least two tracks.
    pub fn around(&self, center: &Point2<f64>) -> Vec<AffineMotion> {
        let near = self.positions.nearest(center, usize::MAX, self.search_radius_px);
        let mut assigned = vec![false; near.len()];
        let mut hypotheses = Vec::new();
        for seed in 0..near.len() {
            if assigned[seed] || hypotheses.len() == MAX_MOTIONS {
                continue;
            }
            let own = &self.motions[near[seed]];
            let mut members = Vec::new();
            for k in seed..near.len() {
                let other = &self.motions[near[k]];
                if assigned[k] || own.difference_px(other) > SAME_MOTION_PX {
                    continue;
                }
                assigned[k] = true;
                members.push(other);
            }
            if members.len() >= MIN_TRACKS {
                hypotheses.extend(AffineMotion::fit(&members, center));
            }
        }
        hypotheses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(x: f64, y: f64, to: Vector2<f64>) -> TrackMotion {
        TrackMotion {
            at: Point2::new(x, y),
            to: [to * -1.5, to * -0.5, to * 0.5, to * 1.5],
            deformation: Matrix2::identity(),
        }
    }

    #[test]
    fn a_shift_is_found_exactly() {
        let shift = Vector2::new(3.0, -2.0);
        let tracks = [(4.0, 9.0), (12.0, 7.0), (8.0, 1.0)].map(|(x, y)| motion(x, y, shift));
        let fit = AffineMotion::fit(&tracks.each_ref(), &Point2::new(8.0, 8.0)).unwrap();
        for from in [Vector2::zeros(), Vector2::new(6.0, -3.0)] {
            assert!((fit.at(2, from) - 0.5 * shift).norm() < 1e-9);
            assert!((fit.at(0, from) + 1.5 * shift).norm() < 1e-9);
        }
    }

    #[test]
    fn a_turn_is_followed_better_than_by_a_shift() {
        let center = Point2::new(23.0, 23.0);
        let turn = |p: Point2<f64>| Vector2::new(-0.05 * (p.y - 23.0), 0.05 * (p.x - 23.0));
        let tracks: Vec<TrackMotion> = (0..49)
            .map(|k| Point2::new(2.0 + 6.0 * (k % 7) as f64, 2.0 + 6.0 * (k / 7) as f64))
            .map(|p| motion(p.x, p.y, turn(p)))
            .collect();
        let fit = AffineMotion::fit(&tracks.iter().collect::<Vec<_>>(), &center).unwrap();
        let from = Vector2::new(8.0, 8.0);
        let error = (fit.at(2, from) - 0.5 * turn(center + from)).norm();
        assert!(error < 0.6 * 0.5 * turn(center + from).norm(), "{error}");
    }

    #[test]
    fn no_tracks_no_motion() {
        assert_eq!(AffineMotion::fit(&[], &Point2::origin()), None);
    }

    #[test]
    fn a_single_track_is_a_shift() {
        let one = motion(3.0, 3.0, Vector2::new(1.0, 0.0));
        let fit = AffineMotion::fit(&[&one], &Point2::new(3.0, 3.0)).unwrap();
        assert!((fit.at(3, Vector2::new(5.0, 5.0)) - Vector2::new(1.5, 0.0)).norm() < 1e-9);
    }
}
