//! Arc-length parametrization of a spline, for motion at constant speed.

use super::curve::Hermite;
use nalgebra::Vector3;

/// Number of parts into which the interval between two keys is divided. The table [`ArcLength`] has the arc length at
/// the end of each part. With fewer parts, the quadrature of the arc length is inaccurate at cusps of the curve.
const PARTS: usize = 32;

/// Number of bisections by which a parameter is found inside of one part of an interval ([`PARTS`]). They determine the
/// parameter to 1e-12 of the part's length.
const HALVINGS: usize = 40;

/// Position of a key, metres, and tangent of the curve at the key, metres per unit of the parameter.
type PlaceAndTangent = (Vector3<f64>, Vector3<f64>);

/// Table of a curve's arc length as a function of its parameter.
#[derive(Clone, Debug)]
pub(super) struct ArcLength {
    keys: Vec<(f64, PlaceAndTangent)>,
    /// Pairs of a parameter and the curve's arc length from its start to this parameter, metres. Both ascend.
    lengths: Vec<(f64, f64)>,
}

impl ArcLength {
    /// Computes the table of arc lengths for the curve through keys. `at` has the parameters of the keys, ascending,
    /// and `places` their positions and tangents. `None` if the curve's length is 0 or not finite.
    pub fn new(at: &[f64], places: &[PlaceAndTangent]) -> Option<Self> {
        let keys: Vec<_> = at.iter().copied().zip(places.iter().copied()).collect();
        let mut curve = Self { keys, lengths: vec![(at[0], 0.0)] };
        for pair in at.windows(2) {
            for part in 1..=PARTS {
                let end = pair[0] + (pair[1] - pair[0]) * part as f64 / PARTS as f64;
                let (start, before) = curve.lengths[curve.lengths.len() - 1];
                curve.lengths.push((end, before + curve.length(start, end)));
            }
        }
        let whole = curve.whole();
        (whole > 0.0 && whole.is_finite()).then_some(curve)
    }

    fn whole(&self) -> f64 {
        self.lengths[self.lengths.len() - 1].1
    }

    fn speed(&self, at: f64) -> f64 {
        let place = Hermite::at(at, &self.keys, |key| key.0);
        place.slope(self.keys[place.key].1, self.keys[place.next].1).norm()
    }

    /// Returns the arc length between two parameters, metres, by Gauss–Legendre quadrature with five points. There must
    /// be no key between the two parameters.
    fn length(&self, start: f64, end: f64) -> f64 {
        const POINTS: [(f64, f64); 3] = [
            (0.0, 0.568_888_888_888_888_9),
            (0.538_469_310_105_683, 0.478_628_670_499_366_5),
            (0.906_179_845_938_664, 0.236_926_885_056_189_1),
        ];
        let (middle, half) = (0.5 * (start + end), 0.5 * (end - start));
        let pairs = POINTS.iter().map(|&(x, weight)| match x {
            0.0 => weight * self.speed(middle),
            _ => weight * (self.speed(middle - half * x) + self.speed(middle + half * x)),
        });
        half * pairs.sum::<f64>()
    }

    /// Returns the curve's parameter at the time `at`, for a point that moves along the whole curve at constant speed.
    /// The point starts at the time that equals the first key's parameter. It arrives at the time that equals the last
    /// key's parameter.
    pub fn parameter(&self, at: f64) -> f64 {
        let (first, last) = (self.lengths[0].0, self.lengths[self.lengths.len() - 1].0);
        let wanted = self.whole() * (at - first) / (last - first);
        let after = self.lengths.partition_point(|entry| entry.1 <= wanted);
        if after == 0 || after == self.lengths.len() {
            return if after == 0 { first } else { last };
        }
        let (start, before) = self.lengths[after - 1];
        let (mut low, mut high) = (start, self.lengths[after].0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if before + self.length(start, middle) < wanted { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}
