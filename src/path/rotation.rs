//! Splines of rotations, by unit quaternions (Kim, Kim and Shin, SIGGRAPH 1995).

use super::curve::parabolic;
use nalgebra::{UnitQuaternion, Vector3};

/// Maximum angle between the rotations of two keys of a spline that count as equal, radians. It covers the rounding
/// errors of quaternions.
const SAME_DIRECTION_RAD: f64 = 1e-9;

/// Returns the rotation vector (axis times angle, radians) from one rotation to another along the shorter arc, in the
/// frame of `from`. If the two rotations differ by half a turn, either arc may be returned.
fn step(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>) -> Vector3<f64> {
    (from.inverse() * to).scaled_axis()
}

/// Returns the angular velocity of a spline of rotations at each key, radians per unit of the parameter. The vector is
/// in the local (rotated) frame of the key. `at` has the parameters of the keys, ascending.
pub(super) fn rotation_tangents(
    at: &[f64],
    rotations: &[UnitQuaternion<f64>],
) -> Vec<Vector3<f64>> {
    // The rotation vector of a step has the same coordinates in the frames of both keys.
    let steps: Vec<Vector3<f64>> =
        (1..at.len()).map(|k| step(&rotations[k - 1], &rotations[k])).collect();
    let stands: Vec<bool> = steps.iter().map(|s| s.norm() <= SAME_DIRECTION_RAD).collect();
    let slopes: Vec<Vector3<f64>> =
        steps.iter().enumerate().map(|(k, step)| step / (at[k + 1] - at[k])).collect();
    parabolic(at, &slopes, &stands)
}

/// Interpolates between the rotations `a` and `b`, which are `length` seconds apart, by a cumulative cubic Bézier
/// curve. Each rotation comes with its angular velocity, radians per second, in its local (rotated) frame. `passed` is
/// the fraction of the interval, from 0 to 1.
pub(super) fn cumulative(
    passed: f64,
    length: f64,
    (a, a_velocity): (UnitQuaternion<f64>, Vector3<f64>),
    (b, b_velocity): (UnitQuaternion<f64>, Vector3<f64>),
) -> UnitQuaternion<f64> {
    let [first, last] =
        [a_velocity, b_velocity].map(|velocity| UnitQuaternion::new(velocity * (length / 3.0)));
    let middle = step(&(a * first), &(b * last.inverse()));
    let (t, u) = (passed, 1.0 - passed);
    let turned = a
        * UnitQuaternion::new(a_velocity * (length / 3.0 * (1.0 - u * u * u)))
        * UnitQuaternion::new(middle * (t * t * (1.0 + 2.0 * u)))
        * UnitQuaternion::new(b_velocity * (length / 3.0 * t * t * t));
    UnitQuaternion::new_normalize(turned.into_inner())
}
