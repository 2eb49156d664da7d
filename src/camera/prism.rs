//! Fisheyes with tangential and thin-prism distortion: COLMAP's `THIN_PRISM_FISHEYE` and `RAD_TAN_THIN_PRISM_FISHEYE`.

use super::solve::{MAX_ANGLE, MIN_SLOPE, is_positive_up_to, newton, polynomial};
use nalgebra::{Matrix2, Point2, Vector2};

/// Radial, tangential and thin-prism distortion of a fisheye.
///
/// A point n of the plane z = 1 has the angle θ from the axis. The vector w = (n / |n|) θ has the direction of n and
/// the length θ. With s = |w|², the radially distorted point is q = w (1 + k₁s + … + k₆s⁶). The distorted point is q +
/// 2 (p·b) b + |b|² p + (s₁|b|² + s₂|b|⁴, s₃|b|² + s₄|b|⁴). Here b is q if [`Self::is_nested`], otherwise w.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PrismFisheye {
    /// Radial coefficients k₁ to k₆.
    pub k: [f64; 6],
    /// Tangential coefficients: the components x and y of the vector p.
    pub p: [f64; 2],
    /// Thin-prism coefficients s₁ to s₄.
    pub s: [f64; 4],
    /// Whether the tangential and thin-prism terms are computed from the radially distorted point, as in
    /// `RAD_TAN_THIN_PRISM_FISHEYE`. If false, they are computed from the undistorted point, as in
    /// `THIN_PRISM_FISHEYE`.
    pub is_nested: bool,
}

impl PrismFisheye {
    pub fn distorted(&self, n: &Point2<f64>) -> Point2<f64> {
        self.project_angles(&angles(n))
    }

    /// Returns whether the model is invertible at the point `n` of the plane z = 1. The radius after radial distortion
    /// must grow all the way from the axis to `n`, and the Jacobian's determinant must be positive at `n`.
    pub fn is_short_of_fold(&self, n: &Point2<f64>) -> bool {
        self.is_inside(&angles(n))
    }

    pub fn undistorted(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        let w = newton(
            d,
            |w| self.project_angles(w),
            |w| self.derivative(w),
            |w| w.coords.norm() < MAX_ANGLE && self.is_inside(w),
        )?;
        let theta = w.coords.norm();
        Some(if theta == 0.0 { w } else { w * (theta.tan() / theta) })
    }

    fn is_inside(&self, w: &Point2<f64>) -> bool {
        let [k1, k2, k3, k4, k5, k6] = self.k;
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4, 11.0 * k5, 13.0 * k6];
        is_positive_up_to(&slope, w.coords.norm_squared())
            && self.derivative(w).determinant() > MIN_SLOPE
    }

    /// Returns the radial factor 1 + k₁s + … + k₆s⁶, and its derivative with respect to s. s is the squared angle from
    /// the axis.
    fn radial(&self, s: f64) -> (f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.k;
        let value = polynomial(&[1.0, k1, k2, k3, k4, k5, k6], s);
        (value, polynomial(&[k1, 2.0 * k2, 3.0 * k3, 4.0 * k4, 5.0 * k5, 6.0 * k6], s))
    }

    fn project_angles(&self, w: &Point2<f64>) -> Point2<f64> {
        let q = w.coords * self.radial(w.coords.norm_squared()).0;
        let b = if self.is_nested { q } else { w.coords };
        let (p, [s1, s2, s3, s4], b2) = (Vector2::from(self.p), self.s, b.norm_squared());
        let prism = Vector2::new(s1 * b2 + s2 * b2 * b2, s3 * b2 + s4 * b2 * b2);
        Point2::from(q + b * (2.0 * p.dot(&b)) + p * b2 + prism)
    }

    /// Returns the Jacobian of the distorted point with respect to `w`. `w` is an undistorted point, converted by
    /// [`angles`].
    fn derivative(&self, w: &Point2<f64>) -> Matrix2<f64> {
        let (value, slope) = self.radial(w.coords.norm_squared());
        let by_radius = w.coords * w.coords.transpose() * (2.0 * slope);
        let radial = Matrix2::identity() * value + by_radius;
        let b = if self.is_nested { w.coords * value } else { w.coords };
        let (p, [s1, s2, s3, s4], b2) = (Vector2::from(self.p), self.s, b.norm_squared());
        let tangential = b * p.transpose() * 2.0
            + Matrix2::identity() * (2.0 * p.dot(&b))
            + p * b.transpose() * 2.0;
        let prism = Vector2::new(s1 + 2.0 * s2 * b2, s3 + 2.0 * s4 * b2) * b.transpose() * 2.0;
        let added = tangential + prism;
        if self.is_nested { (Matrix2::identity() + added) * radial } else { radial + added }
    }
}

/// Converts a point of the plane z = 1 to angles. The result has the point's direction, and its length is the point's
/// angle from the axis, in radians.
fn angles(n: &Point2<f64>) -> Point2<f64> {
    let r = n.coords.norm();
    if r == 0.0 { *n } else { n * (r.atan() / r) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_is_the_differences() {
        for is_nested in [false, true] {
            let lens = PrismFisheye {
                k: [0.1, -0.05, 0.02, -0.01, 0.003, -0.001],
                p: [0.01, -0.02],
                s: [0.01, -0.003, 0.02, 0.004],
                is_nested,
            };
            let w = Point2::new(0.4, -0.7);
            let steps = [Vector2::new(1e-6, 0.0), Vector2::new(0.0, 1e-6)];
            for (column, d) in steps.iter().enumerate() {
                let by_difference =
                    (lens.project_angles(&(w + d)) - lens.project_angles(&(w - d))) / 2e-6;
                assert!((lens.derivative(&w).column(column) - by_difference).norm() < 1e-8);
            }
        }
    }
}
