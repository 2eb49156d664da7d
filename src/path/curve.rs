//! Tangents at the keys (interpolated points) of a spline, and cubic Hermite interpolation between two keys.

use nalgebra::Vector3;
use std::ops::{Add, Mul, Sub};

/// Maximum distance between two keys of a spline that count as the same position, metres.
const SAME_PLACE_M: f64 = 1e-9;

/// Returns the tangent of a spline at each key (interpolated point). A tangent is the derivative of the parabola
/// through the key and its two neighbours; at the first and the last key, of the parabola through the three nearest
/// keys. A tangent is 0 if a neighbour is at the same position. `at` has the parameters of the keys, ascending, and
/// `values` their positions, metres.
pub(super) fn tangents(at: &[f64], values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let steps: Vec<Vector3<f64>> =
        (1..at.len()).map(|k| (values[k] - values[k - 1]) / (at[k] - at[k - 1])).collect();
    let stands: Vec<bool> =
        (1..at.len()).map(|k| (values[k] - values[k - 1]).norm() <= SAME_PLACE_M).collect();
    parabolic(at, &steps, &stands)
}

/// Returns the tangent of a spline at each key (interpolated point), by parabolas through three keys. `at` has the
/// parameters of the keys, ascending. `slopes` has the mean slope in each interval between keys. `stands` is true for
/// each interval in which nothing moves. The tangents at both ends of such an interval are 0.
pub(super) fn parabolic(at: &[f64], slopes: &[Vector3<f64>], stands: &[bool]) -> Vec<Vector3<f64>> {
    let length = |k: usize| at[k + 1] - at[k];
    let end = |near: usize, far: usize| {
        let (h, g) = (length(near), length(far));
        slopes[near] + (slopes[near] - slopes[far]) * (h / (h + g))
    };
    let last = slopes.len();
    let tangent = |k: usize| match (k, last) {
        (_, 0) => Vector3::zeros(),
        (_, 1) => slopes[0],
        (0, _) => end(0, 1),
        (k, _) if k == last => end(last - 1, last - 2),
        (k, _) => {
            let (h, g) = (length(k - 1), length(k));
            (slopes[k - 1] * g + slopes[k] * h) / (h + g)
        }
    };
    let is_still = |k: usize| k > 0 && stands[k - 1] || k < last && stands[k];
    (0..at.len()).map(|k| if is_still(k) { Vector3::zeros() } else { tangent(k) }).collect()
}

/// Returns the slope of a monotone cubic spline at each key (Fritsch and Butland 1984). Between two keys, the spline
/// stays within the range of their values. If the values are a linear function of the parameter, so is the spline. `at`
/// has the parameters of the keys, ascending, and `values` their values.
pub(super) fn monotone_tangents(at: &[f64], values: &[f64]) -> Vec<f64> {
    let last = at.len() - 1;
    let length = |k: usize| at[k + 1] - at[k];
    let slope = |k: usize| (values[k + 1] - values[k]) / length(k);
    let end = |near: usize, far: usize| {
        let (h, g, near, far) = (length(near), length(far), slope(near), slope(far));
        let parabola = near + (near - far) * (h / (h + g));
        let limit = 3.0 * near.abs();
        if parabola * near <= 0.0 { 0.0 } else { parabola.clamp(-limit, limit) }
    };
    let tangent = |k: usize| match (k, last) {
        (_, 0) => 0.0,
        (_, 1) => slope(0),
        (0, _) => end(0, 1),
        (k, _) if k == last => end(last - 1, last - 2),
        (k, _) => {
            let (before, after) = (slope(k - 1), slope(k));
            // The signs are compared, because a product could underflow.
            if before == 0.0 || after == 0.0 || (before > 0.0) != (after > 0.0) {
                return 0.0;
            }
            let (h, g) = (length(k - 1), length(k));
            let (w, v) = (2.0 * g + h, g + 2.0 * h);
            (w + v) / (w / before + v / after)
        }
    };
    (0..=last).map(tangent).collect()
}

/// Sets the tangents of a spline to 0 at all keys where `rests` is true.
pub(super) fn resting<T: Default>(rests: &[bool], tangents: Vec<T>) -> Vec<T> {
    let pairs = tangents.into_iter().zip(rests);
    pairs.map(|(tangent, rests)| if *rests { T::default() } else { tangent }).collect()
}

/// The interval between two keys of a spline that contains a given parameter, and the parameter's position in this
/// interval. It evaluates cubic Hermite polynomials there.
pub(super) struct Hermite {
    /// Index of the key at the start of the interval.
    pub key: usize,
    /// Index of the key at the end of the interval. Equal to `key` if there is only one key.
    pub next: usize,
    /// Fraction of the interval that the parameter has passed, from 0 to 1.
    pub passed: f64,
    /// Length of the interval in units of the parameter, seconds.
    pub length: f64,
}

impl Hermite {
    /// Finds the interval of `keys` that contains the parameter `at`, and the position in it. Parameters outside of all
    /// keys are clamped to the first or the last key. The function `parameter` returns the parameter of a key. `keys`
    /// must not be empty.
    pub fn at<K>(at: f64, keys: &[K], parameter: impl Fn(&K) -> f64) -> Self {
        let after = keys.partition_point(|key| parameter(key) <= at).min(keys.len() - 1);
        let key = after.saturating_sub(1);
        let (start, length) =
            (parameter(&keys[key]), parameter(&keys[after]) - parameter(&keys[key]));
        let passed = if length > 0.0 { ((at - start) / length).clamp(0.0, 1.0) } else { 0.0 };
        Self { key, next: after, passed, length }
    }

    /// Interpolates between two values with given slopes, by a cubic Hermite polynomial. Each argument is a pair of
    /// value and slope: first at the start of the interval, then at its end.
    pub fn value<T>(&self, (a, a_slope): (T, T), (b, b_slope): (T, T)) -> T
    where
        T: Copy + Mul<f64, Output = T> + Add<Output = T> + Sub<Output = T>,
    {
        let t = self.passed;
        let (u, h) = (1.0 - t, self.length);
        // If `a` and `b` are equal and the slopes are 0, this form gives exactly `a`. Equal views are then found in
        // caches.
        a + ((b - a) * (t * t * (1.0 + 2.0 * u))
            + a_slope * (h * t * u * u)
            + b_slope * (-h * t * t * u))
    }

    /// Interpolates like [`Self::value`] between two pairs of value and slope. The slopes are those of
    /// [`monotone_tangents`]. The result is clamped to the range of the two values, against rounding errors.
    pub fn monotone(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        self.value(a, b).clamp(a.0.min(b.0), a.0.max(b.0))
    }

    /// Returns the derivative of [`Self::value`] with respect to the parameter. 0 if the interval has no length.
    pub fn slope(
        &self,
        (a, a_slope): (Vector3<f64>, Vector3<f64>),
        (b, b_slope): (Vector3<f64>, Vector3<f64>),
    ) -> Vector3<f64> {
        let t = self.passed;
        if self.length == 0.0 {
            return Vector3::zeros();
        }
        (b - a) * (6.0 * t * (1.0 - t) / self.length)
            + a_slope * ((1.0 - t) * (1.0 - 3.0 * t))
            + b_slope * (t * (3.0 * t - 2.0))
    }
}
