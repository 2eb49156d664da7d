//! Lens distortion on the normalized image plane z = 1, the inverse of the distortion, and the domain on which the
//! inverse exists.

use super::prism::PrismFisheye;
use super::radial_curve::RadialCurve;
use super::solve::{
    ITERATIONS, MAX_ANGLE, MAX_RESIDUAL, MIN_SLOPE, STEP, is_positive_up_to, newton, polynomial,
};
use nalgebra::{Matrix2, Point2};

/// Lens distortion: maps an ideal point of the normalized plane z = 1 to a distorted point of the same plane.
/// Coefficients are unitless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Distortion {
    /// The identity map.
    None,
    /// Brown's model. With s = x² + y², the radial factor is (1 + k₁s + k₂s² + k₃s³) / (1 + k₄s + k₅s² + k₆s³). `p`
    /// holds the tangential coefficients p₁ and p₂.
    Brown { k: [f64; 6], p: [f64; 2] },
    /// Kannala and Brandt's fisheye model. The distorted radius is θ (1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸), where θ is the
    /// angle from the axis.
    Fisheye { k: [f64; 4] },
    /// FOV, division or EUCM model: a radial map whose inverse has a closed form.
    Curve(RadialCurve),
    /// A fisheye with tangential and thin-prism distortion.
    Prism(PrismFisheye),
}

impl Distortion {
    /// Returns the distorted image of the point `n` of the plane z = 1. The result is meaningful only where
    /// [`Self::is_short_of_fold`] is true.
    pub fn distorted(&self, n: &Point2<f64>) -> Point2<f64> {
        match self {
            Self::None => *n,
            Self::Brown { k, p: [p1, p2] } => {
                let (x, y) = (n.x, n.y);
                let r2 = x * x + y * y;
                let [above, below] = radial_quotient(k).map(|part| polynomial(&part, r2));
                let radial = above / below;
                Point2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
            Self::Fisheye { k } => {
                let r = n.coords.norm();
                if r == 0.0 {
                    return *n;
                }
                let theta = r.atan();
                n * (theta * polynomial(&angular(k), theta * theta) / r)
            }
            Self::Curve(curve) => n * curve.scale(n.coords.norm()),
            Self::Prism(prism) => prism.distorted(n),
        }
    }

    /// Returns whether the point `n` lies inside of the fold. The fold is the radius at which the distorted radius
    /// stops growing. Beyond the fold, the formula maps several points to one pixel, which no lens does.
    pub fn is_short_of_fold(&self, n: &Point2<f64>) -> bool {
        match self {
            Self::None => true,
            Self::Brown { k, .. } => {
                let r2 = n.coords.norm_squared();
                is_positive_up_to(&radial_quotient(k)[1], r2)
                    && is_positive_up_to(&radial_slope(k), r2)
                    && self.derivative(n).determinant() > MIN_SLOPE
            }
            Self::Fisheye { k } => {
                let theta = n.coords.norm().atan();
                is_positive_up_to(&angular_slope(k), theta * theta)
            }
            Self::Curve(curve) => curve.is_short_of_fold(n.coords.norm()),
            Self::Prism(prism) => prism.is_short_of_fold(n),
        }
    }

    /// Inverts [`Self::distorted`]: returns the point inside of the fold whose distorted image is `d`. `None` if no
    /// such point exists, or if a coordinate of `d` isn't finite.
    pub fn undistorted(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        if !(d.x.is_finite() && d.y.is_finite()) {
            return None;
        }
        match self {
            Self::None => Some(*d),
            Self::Brown { .. } => newton(
                d,
                |n| self.distorted(n),
                |n| self.derivative(n),
                |n| self.is_short_of_fold(n),
            ),
            Self::Fisheye { k } => undistorted_fisheye(k, d),
            Self::Curve(curve) => curve.undistorted(d),
            Self::Prism(prism) => prism.undistorted(d),
        }
    }

    /// Returns the Jacobian of [`Self::distorted`] at the point `n`, for Brown's model. The other models are inverted
    /// without this function; for them, it returns the identity matrix.
    fn derivative(&self, n: &Point2<f64>) -> Matrix2<f64> {
        let Self::Brown { k, p: [p1, p2] } = self else { return Matrix2::identity() };
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let [above, below] = radial_quotient(k).map(|part| polynomial(&part, r2));
        let above_r2 = k[0] + r2 * (2.0 * k[1] + 3.0 * k[2] * r2);
        let below_r2 = k[3] + r2 * (2.0 * k[4] + 3.0 * k[5] * r2);
        let radial = above / below;
        let radial_r2 = (above_r2 - radial * below_r2) / below;
        let mixed = 2.0 * (x * y * radial_r2 + p1 * x + p2 * y);
        Matrix2::new(
            radial + 2.0 * x * x * radial_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * radial_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }
}

/// Inverts the fisheye model by Newton's method with a bracket on the angle from the axis. `d` is the distorted point.
/// `None` if no angle in the invertible range, below [`MAX_ANGLE`], is mapped to the distorted radius |d|.
fn undistorted_fisheye(k: &[f64; 4], d: &Point2<f64>) -> Option<Point2<f64>> {
    let target = d.coords.norm();
    if target == 0.0 {
        return Some(*d);
    }
    let (value, slope) = (angular(k), angular_slope(k));
    // The bracket [low, high] of the angle. Where the slope isn't positive, θ lies beyond the fold and becomes `high`.
    let (mut low, mut high) = (0.0, MAX_ANGLE);
    let mut theta = target.min(0.99 * high);
    for _ in 0..2 * ITERATIONS {
        let t2 = theta * theta;
        let residual = theta * polynomial(&value, t2) - target;
        let is_rising = is_positive_up_to(&slope, t2);
        if !is_rising || residual > 0.0 {
            high = theta;
        } else {
            low = theta;
        }
        let newton = theta - residual / polynomial(&slope, t2);
        let next = if is_rising && newton > low && newton < high {
            newton
        } else if is_rising && residual.abs() < MAX_RESIDUAL {
            theta
        } else {
            0.5 * (low + high)
        };
        let step = (next - theta).abs();
        theta = next;
        if step < STEP * theta {
            break;
        }
    }
    let t2 = theta * theta;
    let fits = (theta * polynomial(&value, t2) - target).abs() < MAX_RESIDUAL * (1.0 + target);
    (fits && theta < MAX_ANGLE && is_positive_up_to(&slope, t2)).then(|| d * (theta.tan() / target))
}

/// Returns the coefficients of the numerator and of the denominator of Brown's radial factor, in ascending powers of s
/// = r².
fn radial_quotient(k: &[f64; 6]) -> [[f64; 4]; 2] {
    [[1.0, k[0], k[1], k[2]], [1.0, k[3], k[4], k[5]]]
}

/// Returns the coefficients, in ascending powers of s = r², of N D + 2 s (N′ D − N D′), where N/D is Brown's radial
/// factor. This is the numerator of the derivative of the distorted radius r N/D with respect to r.
fn radial_slope(k: &[f64; 6]) -> [f64; 7] {
    let [above, below] = radial_quotient(k);
    let mut slope = [0.0; 7];
    for (i, a) in above.iter().enumerate() {
        for (j, b) in below.iter().enumerate() {
            slope[i + j] += a * b * (1.0 + 2.0 * (i as f64 - j as f64));
        }
    }
    slope
}

/// Returns the coefficients of the fisheye model's distorted radius divided by the angle θ: 1 + k₁θ² + …, in ascending
/// powers of θ².
fn angular(k: &[f64; 4]) -> [f64; 5] {
    [1.0, k[0], k[1], k[2], k[3]]
}

/// Returns the coefficients of the derivative of the fisheye model's distorted radius with respect to the angle θ: 1 +
/// 3 k₁θ² + 5 k₂θ⁴ + …, in ascending powers of θ².
fn angular_slope(k: &[f64; 4]) -> [f64; 5] {
    [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use nalgebra::Vector2;

    #[test]
    fn positivity_is_that_of_the_densely_sampled_polynomial() {
        let mut numbers = Random::new(7);
        let mut random = || numbers.unit();
        let (mut positive, mut negative) = (0, 0);
        for _ in 0..2000 {
            let k: [f64; 6] = std::array::from_fn(|_| 3.0 * (random() - 0.5));
            let slope = radial_slope(&k);
            let end = 1.5 * random();
            let min = (0..=4000)
                .map(|i| polynomial(&slope, end * f64::from(i) / 4000.0))
                .fold(f64::INFINITY, f64::min);
            if min.abs() < 1e-3 {
                continue; // the polynomial may change its sign between two samples
            }
            assert_eq!(is_positive_up_to(&slope, end), min > 0.0, "{k:?} to {end}");
            *if min > 0.0 { &mut positive } else { &mut negative } += 1;
        }
        assert!(positive > 200 && negative > 200, "{positive} {negative}");
    }

    #[test]
    fn the_radial_slope_is_the_derivative() {
        let k = [-0.3, 0.1, 0.02, 0.2, -0.05, 0.01];
        let [above, below] = radial_quotient(&k);
        let radial = |r: f64| r * polynomial(&above, r * r) / polynomial(&below, r * r);
        for r in [0.1, 0.5, 1.1] {
            let by_difference = (radial(r + 1e-5) - radial(r - 1e-5)) / 2e-5;
            let d = polynomial(&below, r * r);
            assert!((polynomial(&radial_slope(&k), r * r) / (d * d) - by_difference).abs() < 1e-9);
        }
    }

    #[test]
    fn the_derivative_is_the_differences() {
        let lens = Distortion::Brown { k: [-0.3, 0.1, 0.02, 0.2, -0.05, 0.01], p: [0.003, -0.002] };
        let n = Point2::new(0.4, -0.7);
        for (column, d) in [Vector2::new(1e-6, 0.0), Vector2::new(0.0, 1e-6)].iter().enumerate() {
            let by_difference = (lens.distorted(&(n + d)) - lens.distorted(&(n - d))) / 2e-6;
            assert!((lens.derivative(&n).column(column) - by_difference).norm() < 1e-9);
        }
    }
}
