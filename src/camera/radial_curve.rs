//! Radial distortions whose inverses have closed forms: COLMAP's FOV, division and EUCM models.

use super::solve::MIN_SLOPE;
use nalgebra::Point2;

/// A radial distortion of the plane z = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RadialCurve {
    /// FOV model of Devernay and Faugeras, with field of view ω: the radius r is mapped to atan(2 r tan(ω/2)) / ω.
    Fov { omega: f64 },
    /// Division model of Fitzgibbon: the inverse maps a distorted radius d to r = d / (1 + k d²).
    Division { k: f64 },
    /// EUCM model of Khomutenko, Garcia and Martinet: the radius r is mapped to r / (α √(β r² + 1) + 1 − α).
    Eucm { alpha: f64, beta: f64 },
}

impl RadialCurve {
    /// Returns the distorted radius divided by the radius r. Multiplying a point by this factor gives the distorted
    /// point. The factor is meaningful only where [`Self::is_short_of_fold`] is true.
    pub fn scale(&self, r: f64) -> f64 {
        match *self {
            Self::Fov { omega } => {
                let t = 2.0 * (0.5 * omega).tan();
                if r == 0.0 { t / omega } else { (r * t).atan() / (r * omega) }
            }
            Self::Division { k } => 2.0 / (1.0 + (1.0 - 4.0 * k * r * r).sqrt()),
            Self::Eucm { alpha, beta } => 1.0 / (alpha * (beta * r * r + 1.0).sqrt() + 1.0 - alpha),
        }
    }

    /// Returns whether the distorted radius grows with the undistorted radius at `r`, a radius on the plane z = 1.
    /// False if the model's parameters are outside of their valid range.
    pub fn is_short_of_fold(&self, r: f64) -> bool {
        match *self {
            Self::Fov { omega } => omega.abs() < std::f64::consts::PI && r.is_finite(),
            Self::Division { k } => 1.0 - 4.0 * k * r * r > MIN_SLOPE,
            Self::Eucm { alpha, beta } => {
                let root = (beta * r * r + 1.0).sqrt();
                alpha / root + 1.0 - alpha > MIN_SLOPE && beta > 0.0 && alpha >= 0.0
            }
        }
    }

    /// Returns the point of the plane z = 1 that the distortion maps to `d`. `None` if no such point exists.
    pub fn undistorted(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        let rd = d.coords.norm();
        let factor = match *self {
            Self::Fov { omega } => {
                let t = 2.0 * (0.5 * omega).tan();
                let angle = rd * omega;
                if rd == 0.0 {
                    omega / t
                } else if angle.abs() < std::f64::consts::FRAC_PI_2 {
                    angle.tan() / (rd * t)
                } else {
                    f64::NAN
                }
            }
            Self::Division { k } => {
                let s = k * rd * rd;
                if s < 1.0 && s > -1.0 { 1.0 / (1.0 + s) } else { f64::NAN }
            }
            Self::Eucm { alpha, beta } => {
                let s = beta * rd * rd;
                let root = (1.0 - (2.0 * alpha - 1.0) * s).sqrt();
                let depth = (1.0 - alpha * alpha * s) / (alpha * root + 1.0 - alpha);
                if depth > 0.0 { 1.0 / depth } else { f64::NAN }
            }
        };
        let n = d * factor;
        (n.x.is_finite() && n.y.is_finite() && self.is_short_of_fold(n.coords.norm())).then_some(n)
    }
}
