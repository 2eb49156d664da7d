//! Numerical inversion of lens distortion: a test whether a polynomial is positive on an interval, and Newton's method
//! inside a domain.

use nalgebra::{Matrix2, Point2, Vector2};

/// Maximum relative length of the last step of Newton's iteration. The length is relative to 1 + |n| for a point n, and
/// to θ for an angle θ.
pub(super) const STEP: f64 = 1e-14;
/// Maximum number of Newton steps. Usually 3 to 6 steps suffice. At the border of the invertible domain, convergence is
/// linear and takes about 30 steps.
pub(super) const ITERATIONS: usize = 60;
/// Lower bound that defines the invertible domain. In this domain, the derivative of the distorted radius and the
/// determinant of the distortion's Jacobian are above this value.
pub(super) const MIN_SLOPE: f64 = 1e-9;
/// Maximum residual of the inversion: the distance, on the plane z = 1, between the distorted solution and the given
/// distorted point d. The limit is this value times 1 + |d|.
pub(super) const MAX_RESIDUAL: f64 = 1e-12;
/// Maximum angle of a ray from the optical axis, radians. A ray at 90° doesn't meet the plane z = 1.
pub(super) const MAX_ANGLE: f64 = std::f64::consts::FRAC_PI_2 - 1e-6;

/// Inverts a map of the plane by Newton's method: returns the point of the domain that `value` maps to `d`. `None` if
/// no such point is found. `derivative` is the map's Jacobian, and `is_inside` tells whether a point is in the domain.
/// A step that would leave the domain is halved until it stays inside. The domain must contain the origin, and the map
/// must be near to the identity there.
pub(super) fn newton(
    d: &Point2<f64>,
    value: impl Fn(&Point2<f64>) -> Point2<f64>,
    derivative: impl Fn(&Point2<f64>) -> Matrix2<f64>,
    is_inside: impl Fn(&Point2<f64>) -> bool,
) -> Option<Point2<f64>> {
    // The iteration starts at the distorted point, moved towards the origin until it is inside of the domain.
    let mut n = *d;
    for _ in 0..ITERATIONS {
        if is_inside(&n) {
            break;
        }
        n *= 0.5;
    }
    for _ in 0..ITERATIONS {
        let residual: Vector2<f64> = value(&n) - d;
        let mut step = derivative(&n).try_inverse()? * residual;
        let is_last = step.norm() < STEP * (1.0 + n.coords.norm());
        let mut halvings = 0;
        while !is_inside(&(n - step)) {
            step *= 0.5;
            halvings += 1;
            if halvings == ITERATIONS {
                return None;
            }
        }
        n -= step;
        if is_last {
            break;
        }
    }
    ((value(&n) - d).norm() < MAX_RESIDUAL * (1.0 + d.coords.norm())).then_some(n)
}

/// Returns the value of a polynomial at s. The coefficients are in ascending powers.
pub(super) fn polynomial<const N: usize>(coefficients: &[f64; N], s: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * s + c)
}

/// Maximum number of nested bisections of an interval. A polynomial whose positivity is undecided after these
/// bisections is close to 0, and counts as not positive.
const MAX_DEPTH: usize = 40;

/// Returns whether a polynomial is above [`MIN_SLOPE`] on the whole interval [0, end]. The coefficients are in
/// ascending powers. The first coefficient must be 1.
///
/// The smallest Bernstein coefficient is a lower bound of the polynomial on an interval (Farouki 2012, §3). Where the
/// bound doesn't decide, the interval is bisected. False if a coefficient or `end` is not finite.
pub(super) fn is_positive_up_to<const N: usize>(coefficients: &[f64; N], end: f64) -> bool {
    let mut scaled = *coefficients;
    let mut power = 1.0;
    for c in &mut scaled {
        *c *= power;
        power *= end;
    }
    // b_i = Σ_j≤i C(i, j) / C(n, j) c_j.
    let degree = N - 1;
    let mut bernstein = [0.0; N];
    for (i, b) in bernstein.iter_mut().enumerate() {
        let mut ratio = 1.0;
        for (j, c) in scaled.iter().enumerate().take(i + 1) {
            *b += ratio * c;
            if j < degree {
                ratio *= (i - j) as f64 / (degree - j) as f64;
            }
        }
    }
    bernstein.iter().all(|b| b.is_finite()) && is_bernstein_positive(bernstein, MAX_DEPTH)
}

fn is_bernstein_positive<const N: usize>(b: [f64; N], depth: usize) -> bool {
    if b.iter().all(|&v| v > MIN_SLOPE) {
        return true;
    }
    if depth == 0 || !(b[0] > MIN_SLOPE && b[N - 1] > MIN_SLOPE) {
        return false;
    }
    // De Casteljau's subdivision at the middle. The first entry of each row is a coefficient of the left half, the last
    // entry one of the right half.
    let (mut left, mut right, mut row) = ([0.0; N], b, b);
    for i in 0..N {
        left[i] = row[0];
        right[N - 1 - i] = row[N - 1 - i];
        for j in 0..N - 1 - i {
            row[j] = 0.5 * (row[j] + row[j + 1]);
        }
    }
    is_bernstein_positive(left, depth - 1) && is_bernstein_positive(right, depth - 1)
}
