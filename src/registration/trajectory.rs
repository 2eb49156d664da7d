//! A feature's path in one camera through a few frames: eq. (2), and beyond straight lines.
//!
//! The polynomial through all samples: two give the paper's straight line, three and four a
//! quadratic and a cubic (method.md part 2: straight lines bias offsets by the path's curvature).

use nalgebra::{Point2, Vector2};

/// Positions at two to four ascending times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trajectory {
    times_s: [f64; Trajectory::MAX],
    positions: [Point2<f64>; Trajectory::MAX],
    len: usize,
}

impl Trajectory {
    /// Samples at most.
    pub const MAX: usize = 4;

    /// From samples in order of time.
    ///
    /// `None` for fewer than two or more than four samples, or times that don't ascend: the
    /// differences that [`Self::at`] divides by are then positive.
    pub fn new(samples: impl IntoIterator<Item = (f64, Point2<f64>)>) -> Option<Self> {
        let mut path =
            Self { times_s: [0.0; Self::MAX], positions: [Point2::origin(); Self::MAX], len: 0 };
        for (time_s, position) in samples {
            if path.len == Self::MAX || (path.len > 0 && time_s <= path.times_s[path.len - 1]) {
                return None;
            }
            path.times_s[path.len] = time_s;
            path.positions[path.len] = position;
            path.len += 1;
        }
        (path.len >= 2).then_some(path)
    }

    /// The position at a time, seconds; outside the samples an extrapolation.
    pub fn at(&self, time_s: f64) -> Point2<f64> {
        let mut sum = Vector2::zeros();
        for i in 0..self.len {
            let weight: f64 = (0..self.len)
                .filter(|&j| j != i)
                .map(|j| (time_s - self.times_s[j]) / (self.times_s[i] - self.times_s[j]))
                .product();
            sum += self.positions[i].coords * weight;
        }
        Point2::from(sum)
    }

    /// The velocity at a time, pixels a second.
    pub fn velocity(&self, time_s: f64) -> Vector2<f64> {
        let mut sum = Vector2::zeros();
        for i in 0..self.len {
            let mut weight = 0.0;
            for skipped in (0..self.len).filter(|&k| k != i) {
                let product: f64 = (0..self.len)
                    .filter(|&j| j != i && j != skipped)
                    .map(|j| (time_s - self.times_s[j]) / (self.times_s[i] - self.times_s[j]))
                    .product();
                weight += product / (self.times_s[i] - self.times_s[skipped]);
            }
            sum += self.positions[i].coords * weight;
        }
        sum
    }

    /// The sum of the squared weights of the samples at a time: how much the noise of single
    /// positions (variance) reaches the result. 0.5 to 1 between the samples of a line.
    pub fn noise_gain(&self, time_s: f64) -> f64 {
        (0..self.len)
            .map(|i| {
                (0..self.len)
                    .filter(|&j| j != i)
                    .map(|j| (time_s - self.times_s[j]) / (self.times_s[i] - self.times_s[j]))
                    .product::<f64>()
                    .powi(2)
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_reproduced_at_uneven_times() {
        let curve = |t: f64| Point2::new(1.0 + t * (2.0 - t * (0.5 - 0.3 * t)), 4.0 - t * t * t);
        let slope = |t: f64| Vector2::new(2.0 - t + 0.9 * t * t, -3.0 * t * t);
        let path = Trajectory::new([-1.1, 0.0, 0.9, 2.3].map(|t| (t, curve(t)))).unwrap();
        for t in [-1.1, -0.3, 0.0, 0.45, 2.0, 3.0] {
            assert!((path.at(t) - curve(t)).norm() < 1e-12);
            assert!((path.velocity(t) - slope(t)).norm() < 1e-12);
        }
    }

    #[test]
    fn two_samples_are_the_papers_line() {
        let path =
            Trajectory::new([(1.0, Point2::new(0.0, 8.0)), (3.0, Point2::new(4.0, 0.0))]).unwrap();
        assert_eq!(path.at(1.5), Point2::new(1.0, 6.0));
        assert_eq!(path.velocity(9.0), Vector2::new(2.0, -4.0));
        assert_eq!(path.noise_gain(2.0), 0.5);
    }

    #[test]
    fn what_is_no_path() {
        let p = Point2::new(0.0, 0.0);
        assert!(Trajectory::new([]).is_none() && Trajectory::new([(0.0, p)]).is_none());
        assert!(Trajectory::new([(0.0, p), (0.0, p)]).is_none());
        assert!(Trajectory::new([(0.0, p), (f64::NAN, p), (1.0, p)]).is_none_or(|q| q.len == 3));
        assert!(Trajectory::new((0..5).map(|t| (f64::from(t), p))).is_none());
    }
}
