//! A motion prior: predicts a feature's displacement from its neighbours'.

use super::Neighbors;
use nalgebra::{Point2, Vector2};

/// Displacements (motion or disparity, pixels) of tracked features, which predict those of features nearby.
pub struct MotionPrior {
    neighbors: Neighbors,
    displacements: Vec<(Point2<f64>, Vector2<f64>)>,
}

/// Number of nearest neighbours whose median is the prediction. Up to two of five may be wrong.
const MEDIAN_OF: usize = 5;

impl MotionPrior {
    /// Usual radius of [`Self::predict`], pixels.
    pub const RADIUS_PX: f64 = 40.0;

    /// The prior of `(position, displacement)` pairs, pixels; of none, it predicts nothing.
    pub fn new(displacements: &[(Point2<f64>, Vector2<f64>)]) -> Self {
        let neighbors = Neighbors::new(displacements.iter().map(|(p, _)| *p));
        Self { neighbors, displacements: displacements.to_vec() }
    }

    /// The component-wise median displacement, pixels, of the five nearest positions within
    /// `radius_px` of `p`, fewer where there are fewer. `None` if there is none.
    pub fn predict(&self, p: &Point2<f64>, radius_px: f64) -> Option<Vector2<f64>> {
        let near = self.neighbors.nearest(p, MEDIAN_OF, radius_px);
        let median = |axis: usize| {
            let mut values: Vec<f64> =
                near.iter().map(|&k| self.displacements[k].1[axis]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Some(Vector2::new(median(0)?, median(1)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_the_nearest_is_not_moved_by_a_wrong_one() {
        let mut displacements: Vec<_> = (0..6)
            .map(|k| (Point2::new(f64::from(k), 0.0), Vector2::new(7.0, f64::from(k))))
            .collect();
        displacements[1].1 = Vector2::new(-90.0, 400.0);
        let prior = MotionPrior::new(&displacements);
        assert_eq!(prior.predict(&Point2::new(0.4, 0.0), 20.0), Some(Vector2::new(7.0, 3.0)));
        assert_eq!(prior.predict(&Point2::new(0.0, 30.0), 20.0), None);
        assert_eq!(MotionPrior::new(&[]).predict(&Point2::origin(), 1e9), None);
    }
}
