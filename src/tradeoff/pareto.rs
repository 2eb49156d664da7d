//! The Pareto front of time and quality.

/// Time and quality of a measured combination of options: a point in the diagram of the trade-off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trade {
    pub seconds: f64,
    /// Quality, for example a PSNR. A larger value is better.
    pub quality: f64,
}

/// Returns the indices of the points that no other point dominates, fastest first. A point dominates another point
/// if it is faster and at least as good, or better and at least as fast. Of equal points, only the first is
/// returned. Points with a value that isn't finite are never returned.
pub fn pareto_front(points: &[Trade]) -> Vec<usize> {
    let finite = |k: &usize| points[*k].seconds.is_finite() && points[*k].quality.is_finite();
    let mut order: Vec<usize> = (0..points.len()).filter(finite).collect();
    order.sort_by(|&a, &b| {
        let (a_, b_) = (&points[a], &points[b]);
        a_.seconds.total_cmp(&b_.seconds).then(b_.quality.total_cmp(&a_.quality)).then(a.cmp(&b))
    });
    let mut best = f64::NEG_INFINITY;
    order.retain(|&k| {
        let better = points[k].quality > best;
        best = best.max(points[k].quality);
        better
    });
    order
}

/// Returns the index of the fastest point whose quality is at most `slack` below the best quality. Returns `None`
/// if no point is finite.
pub fn fastest_within(points: &[Trade], slack: f64) -> Option<usize> {
    let front = pareto_front(points);
    let best = points[*front.last()?].quality;
    front.into_iter().find(|&k| points[k].quality >= best - slack)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn dominates(a: &Trade, b: &Trade) -> bool {
        a.seconds <= b.seconds
            && a.quality >= b.quality
            && (a.seconds < b.seconds || a.quality > b.quality)
    }

    /// Compares the front with the definition of dominance, for points with many equal values.
    #[test]
    fn the_front_is_what_nothing_dominates() {
        let mut random = Random::new(11);
        for _ in 0..2000 {
            let count = (random.signed().abs() * 30.0) as usize;
            let mut coarse = || (random.signed() * 6.0).round() + 7.0;
            let points: Vec<Trade> =
                (0..count).map(|_| Trade { seconds: coarse(), quality: coarse() }).collect();
            let front = pareto_front(&points);
            for (k, point) in points.iter().enumerate() {
                let beaten = points.iter().any(|other| dominates(other, point));
                let twin = front.iter().any(|&f| points[f] == *point);
                assert_eq!(twin, !beaten, "{k} of {points:?}: {front:?}");
            }
            for pair in front.windows(2) {
                assert!(points[pair[0]].seconds < points[pair[1]].seconds);
                assert!(points[pair[0]].quality < points[pair[1]].quality);
            }
        }
    }

    #[test]
    fn what_is_not_finite_is_on_no_front() {
        let points = [(1.0, f64::NAN), (f64::INFINITY, 9.0), (2.0, 3.0)];
        let points = points.map(|(seconds, quality)| Trade { seconds, quality });
        assert_eq!(pareto_front(&points), [2]);
        assert_eq!(pareto_front(&[]), [0; 0]);
        assert_eq!(fastest_within(&[], 1.0), None);
    }

    #[test]
    fn almost_the_best_may_be_much_faster() {
        let points = [(0.1, 20.0), (0.5, 29.9), (4.0, 30.0), (5.0, 29.95)];
        let points = points.map(|(seconds, quality)| Trade { seconds, quality });
        assert_eq!(fastest_within(&points, 0.2), Some(1));
        assert_eq!(fastest_within(&points, 0.0), Some(2));
        assert_eq!(fastest_within(&points, 100.0), Some(0));
    }
}
