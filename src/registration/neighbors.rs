//! Radius queries among 2D points, by a k-d tree.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point2;

/// Fraction of the radius within which [`Neighbors::nearest`] searches first. If it finds a sufficient number of
/// points, it does not search the whole radius.
const CLOSE_FRACTION: f64 = 1.0 / 3.0;

/// A set of 2D points for radius queries.
pub struct Neighbors {
    tree: Option<ImmutableKdTree<f64, 2>>,
}

impl Neighbors {
    /// Creates a set of points, which are numbered in their order. All coordinates must be finite. An empty set is
    /// valid; its queries return nothing.
    pub fn new(points: impl IntoIterator<Item = Point2<f64>>) -> Self {
        let points: Vec<[f64; 2]> = points.into_iter().map(|p| [p.x, p.y]).collect();
        let tree = (!points.is_empty()).then(|| {
            ImmutableKdTree::new_from_slice(&points).expect("fewer points than a u32 counts")
        });
        Self { tree }
    }

    /// Calls `act` with the index of each point at a distance of at most `radius` from `p`, in no particular
    /// order.
    pub fn each_within(&self, p: &Point2<f64>, radius: f64, mut act: impl FnMut(usize)) {
        self.with_distances(p, radius).into_iter().for_each(|(_, k)| act(k));
    }

    /// Returns whether any point is at a distance of at most `radius` from `p`.
    pub fn any_within(&self, p: &Point2<f64>, radius: f64) -> bool {
        self.at_least_within(p, radius, 1, |_| true)
    }

    /// Returns the indices of at most `count` points within `radius` of `p`, nearest first. Of equally near points,
    /// the one of lower index is first. Returns fewer indices if fewer points are within the radius.
    pub fn nearest(&self, p: &Point2<f64>, count: usize, radius: f64) -> Vec<usize> {
        let mut near = self.with_distances(p, CLOSE_FRACTION * radius);
        if near.len() < count {
            near = self.with_distances(p, radius);
        }
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.into_iter().take(count).map(|(_, k)| k).collect()
    }

    /// Returns whether at least `wanted` of the points within `radius` of `p` pass `test`. Testing stops after
    /// `wanted` points have passed.
    pub fn at_least_within(
        &self,
        p: &Point2<f64>,
        radius: f64,
        wanted: usize,
        test: impl Fn(usize) -> bool,
    ) -> bool {
        let Some(tree) = &self.tree else { return wanted == 0 };
        let at = [p.x, p.y];
        let within = tree.query(&at).within::<SquaredEuclidean<f64>>(radius * radius).unsorted();
        let passing = within.iter().filter(|near| test(near.item as usize));
        passing.take(wanted).count() == wanted
    }

    /// Returns the squared distances and indices of the points within `radius` of `p`, in no particular order.
    fn with_distances(&self, p: &Point2<f64>, radius: f64) -> Vec<(f64, usize)> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let items = tree
            .query(&[p.x, p.y])
            .within::<SquaredEuclidean<f64>>(radius * radius)
            .unsorted()
            .execute();
        items.into_iter().map(|item| (item.distance, item.item as usize)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_equal_brute_force() {
        let points: Vec<Point2<f64>> = (0..300)
            .map(|k| {
                let k = f64::from(k);
                Point2::new((k * 12.9898).sin() * 50.0, (k * 78.233).sin() * 50.0)
            })
            .collect();
        let neighbors = Neighbors::new(points.iter().copied());
        let within = |p: &Point2<f64>, radius: f64| {
            let mut found = Vec::new();
            neighbors.each_within(p, radius, |k| found.push(k));
            found.sort_unstable();
            found
        };
        for p in &points[..40] {
            let all: Vec<usize> =
                (0..points.len()).filter(|&k| (points[k] - p).norm() <= 9.0).collect();
            assert_eq!(within(p, 9.0), all);
            let mut nearest = all.clone();
            nearest.sort_by(|&a, &b| (points[a] - p).norm().total_cmp(&(points[b] - p).norm()));
            for count in [0, 1, 5, 300] {
                let expected = &nearest[..count.min(nearest.len())];
                assert_eq!(neighbors.nearest(p, count, 9.0), expected);
            }
            let odd = all.iter().filter(|k| **k % 2 == 1).count();
            for wanted in 0..8 {
                let found = neighbors.at_least_within(p, 9.0, wanted, |k| k % 2 == 1);
                assert_eq!(found, wanted <= odd);
            }
            for radius in [0.0, 0.5, 3.0] {
                let aside = p + nalgebra::Vector2::new(0.7, -0.3);
                let any = points.iter().any(|q| (q - aside).norm() <= radius);
                assert_eq!(neighbors.any_within(&aside, radius), any);
            }
        }
    }

    #[test]
    fn none_and_many_duplicates() {
        let none = Neighbors::new([]);
        none.each_within(&Point2::origin(), 1.0, |_| panic!("there are none"));
        assert!(none.nearest(&Point2::origin(), 3, 1.0).is_empty());
        assert!(!none.any_within(&Point2::origin(), 1e9));
        let same = Neighbors::new((0..1000).map(|_| Point2::new(1.0, 2.0)));
        let mut count = 0;
        same.each_within(&Point2::new(1.0, 2.5), 1.0, |_| count += 1);
        assert_eq!(count, 1000);
    }
}
