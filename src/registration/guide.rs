//! Where to look for a feature, from where its neighbours were found.

use super::Neighbors;
use nalgebra::{Point2, Vector2};

/// Displacements (motion or disparity, pixels) of features that were found, to be asked near
/// others.
pub struct Guide {
    neighbors: Neighbors,
    found: Vec<(Point2<f64>, Vector2<f64>)>,
}

/// So many of the nearest are asked: a median of these is right where two are wrong.
const ASKED: usize = 5;

impl Guide {
    /// Features this near have much the same displacement, where they are on one surface.
    pub const RADIUS_PX: f64 = 40.0;

    /// From places and the displacements found there.
    pub fn new(found: &[(Point2<f64>, Vector2<f64>)]) -> Self {
        Self { neighbors: Neighbors::new(found.iter().map(|(p, _)| *p)), found: found.to_vec() }
    }

    /// The median displacement, by component, of the nearest few within a radius, pixels; `None`
    /// where there are none.
    pub fn near(&self, p: &Point2<f64>, radius_px: f64) -> Option<Vector2<f64>> {
        let mut near: Vec<(f64, usize)> = self
            .neighbors
            .within(p, radius_px)
            .into_iter()
            .map(|k| ((self.found[k].0 - p).norm(), k))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(ASKED);
        let median = |axis: usize| {
            let mut values: Vec<f64> = near.iter().map(|&(_, k)| self.found[k].1[axis]).collect();
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
        let mut found: Vec<_> = (0..6)
            .map(|k| (Point2::new(f64::from(k), 0.0), Vector2::new(7.0, f64::from(k))))
            .collect();
        found[1].1 = Vector2::new(-90.0, 400.0);
        let guide = Guide::new(&found);
        assert_eq!(guide.near(&Point2::new(0.4, 0.0), 20.0), Some(Vector2::new(7.0, 3.0)));
        assert_eq!(guide.near(&Point2::new(0.0, 30.0), 20.0), None);
        assert_eq!(Guide::new(&[]).near(&Point2::origin(), 1e9), None);
    }
}
