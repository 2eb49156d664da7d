//! Tangents at keys, and cubic Hermite interpolation between two keys.

use nalgebra::Vector3;
use std::ops::{Add, Mul, Sub};

/// Largest distance of two keys that count as one place, metres.
const SAME_PLACE_M: f64 = 1e-9;

/// Tangents at keys: the derivative at each value of the parabola through this value and its neighbours, at an end of
/// the parabola through the three values there. `at` has the parameters, ascending. 0 where a neighbour is at the same
/// place.
pub(super) fn tangents(at: &[f64], values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let steps: Vec<Vector3<f64>> =
        (1..at.len()).map(|k| (values[k] - values[k - 1]) / (at[k] - at[k - 1])).collect();
    let stands: Vec<bool> =
        (1..at.len()).map(|k| (values[k] - values[k - 1]).norm() <= SAME_PLACE_M).collect();
    parabolic(at, &steps, &stands)
}

/// Tangents at keys from the mean slopes of the intervals. `stands` says for each interval whether nothing moves in
/// it; tangents at its ends are 0.
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

/// Slopes at keys for a monotone cubic (Fritsch and Butland 1984). Between two values the curve stays between them;
/// values on a line give the line. `at` has the parameters, ascending.
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

/// The tangents, with 0 at the keys that rest.
pub(super) fn resting<T: Default>(rests: &[bool], tangents: Vec<T>) -> Vec<T> {
    let pairs = tangents.into_iter().zip(rests);
    pairs.map(|(tangent, rests)| if *rests { T::default() } else { tangent }).collect()
}

/// A position between two keys.
pub(super) struct Hermite {
    /// Index of the key before.
    pub key: usize,
    /// Index of the key after; equal to `key` if there is only one key.
    pub next: usize,
    /// Fraction of the interval between the keys, from 0 to 1.
    pub passed: f64,
    /// Length of the interval, seconds.
    pub length: f64,
}

impl Hermite {
    /// The position of a parameter among the keys; it is clamped to the first and the last one. `keys` must not be
    /// empty.
    pub fn at<K>(at: f64, keys: &[K], parameter: impl Fn(&K) -> f64) -> Self {
        let after = keys.partition_point(|key| parameter(key) <= at).min(keys.len() - 1);
        let key = after.saturating_sub(1);
        let (start, length) =
            (parameter(&keys[key]), parameter(&keys[after]) - parameter(&keys[key]));
        let passed = if length > 0.0 { ((at - start) / length).clamp(0.0, 1.0) } else { 0.0 };
        Self { key, next: after, passed, length }
    }

    /// The cubic Hermite interpolation of two values with their tangents.
    pub fn value<T>(&self, (a, a_slope): (T, T), (b, b_slope): (T, T)) -> T
    where
        T: Copy + Mul<f64, Output = T> + Add<Output = T> + Sub<Output = T>,
    {
        let t = self.passed;
        let (u, h) = (1.0 - t, self.length);
        // This form gives exactly `a` where nothing moves, so that results for equal views are found in caches.
        a + ((b - a) * (t * t * (1.0 + 2.0 * u))
            + a_slope * (h * t * u * u)
            + b_slope * (-h * t * t * u))
    }

    /// The cubic Hermite interpolation of two values with monotone tangents. It is clamped to the values' range,
    /// against rounding.
    pub fn monotone(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        self.value(a, b).clamp(a.0.min(b.0), a.0.max(b.0))
    }

    /// The derivative of [`Self::value`] with respect to the parameter.
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
