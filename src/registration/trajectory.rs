//! The trajectory of a feature in the image of one camera, through two to four frames: the straight line of eq.
//! (2), and curves beyond the paper.
//!
//! The trajectory is the polynomial through all samples. Two samples give the paper's straight line, three samples
//! a quadratic, and four samples a cubic. With straight lines, the curvature of the true trajectory would bias the
//! estimated temporal offsets between cameras.

use nalgebra::{Point2, Vector2};

/// Image position of a feature as a function of time: the interpolating polynomial of two to four samples.
/// Positions are in pixels, times in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trajectory {
    times_s: [f64; Trajectory::MAX],
    positions: [Point2<f64>; Trajectory::MAX],
    len: usize,
}

impl Trajectory {
    /// Maximum number of samples of a trajectory.
    pub const MAX: usize = 4;

    /// Creates the trajectory through samples `(time in seconds, position in pixels)`, in order of time.
    ///
    /// Returns `None` for fewer than two or more than four samples. Also returns `None` if the times do not
    /// strictly ascend, since [`Self::at`] divides by their differences.
    pub fn new(samples: impl IntoIterator<Item = (f64, Point2<f64>)>) -> Option<Self> {
        let mut trajectory =
            Self { times_s: [0.0; Self::MAX], positions: [Point2::origin(); Self::MAX], len: 0 };
        for (time_s, position) in samples {
            if trajectory.len == Self::MAX
                || (trajectory.len > 0 && time_s <= trajectory.times_s[trajectory.len - 1])
            {
                return None;
            }
            trajectory.times_s[trajectory.len] = time_s;
            trajectory.positions[trajectory.len] = position;
            trajectory.len += 1;
        }
        (trajectory.len >= 2).then_some(trajectory)
    }

    /// Returns the Lagrange basis polynomial of sample `i` at a time in seconds, without the factor that belongs to
    /// sample `skipped`. If `skipped` equals `i`, all factors are included.
    fn weight(&self, time_s: f64, i: usize, skipped: usize) -> f64 {
        (0..self.len)
            .filter(|&j| j != i && j != skipped)
            .map(|j| (time_s - self.times_s[j]) / (self.times_s[i] - self.times_s[j]))
            .product()
    }

    /// Returns the position, in pixels, at a time in seconds. For two samples, this is eq. (2). Outside the time
    /// range of the samples, the polynomial is extrapolated.
    pub fn at(&self, time_s: f64) -> Point2<f64> {
        let terms = (0..self.len).map(|i| self.positions[i].coords * self.weight(time_s, i, i));
        Point2::from(terms.fold(Vector2::zeros(), |sum, term| sum + term))
    }

    /// Returns the velocity, in pixels per second, at a time in seconds.
    pub fn velocity(&self, time_s: f64) -> Vector2<f64> {
        let mut sum = Vector2::zeros();
        for i in 0..self.len {
            let mut weight = 0.0;
            for skipped in (0..self.len).filter(|&k| k != i) {
                let interval_s = self.times_s[i] - self.times_s[skipped];
                weight += self.weight(time_s, i, skipped) / interval_s;
            }
            sum += self.positions[i].coords * weight;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_reproduced_at_uneven_times() {
        let curve = |t: f64| Point2::new(1.0 + t * (2.0 - t * (0.5 - 0.3 * t)), 4.0 - t * t * t);
        let slope = |t: f64| Vector2::new(2.0 - t + 0.9 * t * t, -3.0 * t * t);
        let trajectory = Trajectory::new([-1.1, 0.0, 0.9, 2.3].map(|t| (t, curve(t)))).unwrap();
        for t in [-1.1, -0.3, 0.0, 0.45, 2.0, 3.0] {
            assert!((trajectory.at(t) - curve(t)).norm() < 1e-12);
            assert!((trajectory.velocity(t) - slope(t)).norm() < 1e-12);
        }
    }

    #[test]
    fn two_samples_are_the_papers_line() {
        let trajectory =
            Trajectory::new([(1.0, Point2::new(0.0, 8.0)), (3.0, Point2::new(4.0, 0.0))]).unwrap();
        assert_eq!(trajectory.at(1.5), Point2::new(1.0, 6.0));
        assert_eq!(trajectory.velocity(9.0), Vector2::new(2.0, -4.0));
    }

    #[test]
    fn invalid_samples_give_no_trajectory() {
        let p = Point2::new(0.0, 0.0);
        assert!(Trajectory::new([]).is_none() && Trajectory::new([(0.0, p)]).is_none());
        assert!(Trajectory::new([(0.0, p), (0.0, p)]).is_none());
        assert!(Trajectory::new([(0.0, p), (f64::NAN, p), (1.0, p)]).is_none_or(|q| q.len == 3));
        assert!(Trajectory::new((0..5).map(|t| (f64::from(t), p))).is_none());
    }
}
