//! Lens models: normalized image plane (z = 1) to pixels and back.

use nalgebra::{Matrix2, Point2, Vector2};

/// COLMAP's camera models, in its names and parameter order. Focal lengths and principal point
/// are in pixels, distortion coefficients are unitless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraModel {
    /// `PINHOLE`: fx, fy, cx, cy.
    Pinhole { fx: f64, fy: f64, cx: f64, cy: f64 },
    /// `OPENCV`: fx, fy, cx, cy, k1, k2, p1, p2 (Brown's radial and tangential distortion).
    OpenCv { fx: f64, fy: f64, cx: f64, cy: f64, k1: f64, k2: f64, p1: f64, p2: f64 },
}

/// Newton stops when a step is below this; a normalized unit is some hundreds of pixels, so this
/// is far below what an f64 pixel coordinate resolves.
const UNDISTORT_STEP: f64 = 1e-14;
/// Newton converges in 3 to 6 steps where the distortion can be inverted at all.
const UNDISTORT_ITERATIONS: usize = 25;

impl CameraModel {
    /// COLMAP's name of the model.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pinhole { .. } => "PINHOLE",
            Self::OpenCv { .. } => "OPENCV",
        }
    }

    /// The parameters in COLMAP's order.
    pub fn params(&self) -> Vec<f64> {
        match *self {
            Self::Pinhole { fx, fy, cx, cy } => vec![fx, fy, cx, cy],
            Self::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 } => {
                vec![fx, fy, cx, cy, k1, k2, p1, p2]
            }
        }
    }

    /// From COLMAP's name and parameters; `None` if the name is unknown or the count is wrong.
    pub fn from_params(name: &str, params: &[f64]) -> Option<Self> {
        match (name, params) {
            ("PINHOLE", &[fx, fy, cx, cy]) => Some(Self::Pinhole { fx, fy, cx, cy }),
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                Some(Self::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 })
            }
            _ => None,
        }
    }

    /// fx, fy, cx, cy in pixels.
    pub fn intrinsics(&self) -> (f64, f64, f64, f64) {
        match *self {
            Self::Pinhole { fx, fy, cx, cy } | Self::OpenCv { fx, fy, cx, cy, .. } => {
                (fx, fy, cx, cy)
            }
        }
    }

    /// Mean of fx and fy.
    pub fn focal_px(&self) -> f64 {
        let (fx, fy, ..) = self.intrinsics();
        0.5 * (fx + fy)
    }

    /// Whether straight lines of the scene are straight in the image.
    pub fn is_pinhole(&self) -> bool {
        match *self {
            Self::Pinhole { .. } => true,
            Self::OpenCv { k1, k2, p1, p2, .. } => [k1, k2, p1, p2] == [0.0; 4],
        }
    }

    /// Pixel of a point of the plane z = 1.
    pub fn pixel_from_normalized(&self, n: &Point2<f64>) -> Point2<f64> {
        let (fx, fy, cx, cy) = self.intrinsics();
        let d = self.distorted(n);
        Point2::new(fx * d.x + cx, fy * d.y + cy)
    }

    /// Point of the plane z = 1 that a pixel sees; `None` where Newton finds no inverse of the
    /// distortion.
    pub fn normalized_from_pixel(&self, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        let (fx, fy, cx, cy) = self.intrinsics();
        self.undistorted(&Point2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy))
    }

    /// Where the pixel would be if the lens had no distortion (same focal lengths): there,
    /// epipolar curves are lines. The same pixel for `PINHOLE`.
    pub fn ideal_from_pixel(&self, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        if self.is_pinhole() {
            return Some(*pixel);
        }
        let (fx, fy, cx, cy) = self.intrinsics();
        let n = self.normalized_from_pixel(pixel)?;
        Some(Point2::new(fx * n.x + cx, fy * n.y + cy))
    }

    fn distorted(&self, n: &Point2<f64>) -> Point2<f64> {
        match *self {
            Self::Pinhole { .. } => *n,
            Self::OpenCv { k1, k2, p1, p2, .. } => {
                let (x, y) = (n.x, n.y);
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * k2);
                Point2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
        }
    }

    /// Newton on the distortion, from the distorted point itself.
    fn undistorted(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        let Self::OpenCv { k1, k2, p1, p2, .. } = *self else {
            return (d.x.is_finite() && d.y.is_finite()).then_some(*d);
        };
        let mut n = *d;
        for _ in 0..UNDISTORT_ITERATIONS {
            let residual: Vector2<f64> = self.distorted(&n) - d;
            let (x, y) = (n.x, n.y);
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (k1 + r2 * k2);
            let radial_r2 = k1 + 2.0 * k2 * r2;
            let jacobian = Matrix2::new(
                radial + 2.0 * x * x * radial_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
                2.0 * x * y * radial_r2 + 2.0 * p1 * x + 2.0 * p2 * y,
                2.0 * x * y * radial_r2 + 2.0 * p1 * x + 2.0 * p2 * y,
                radial + 2.0 * y * y * radial_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
            );
            // A determinant that is not positive is past the lens's fold: there the model shows
            // the same pixel twice and has no inverse.
            if !(jacobian.determinant() > 1e-9) {
                return None;
            }
            let step = jacobian.try_inverse()? * residual;
            n -= step;
            if step.norm() < UNDISTORT_STEP * (1.0 + n.coords.norm()) {
                return Some(n);
            }
        }
        let residual = (self.distorted(&n) - d).norm();
        (residual < 1e-12).then_some(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distortion_is_inverted_to_the_last_digits() {
        let model = CameraModel::OpenCv {
            fx: 686.0,
            fy: 680.0,
            cx: 321.0,
            cy: 239.0,
            k1: -0.21,
            k2: 0.07,
            p1: 1e-3,
            p2: -2e-3,
        };
        for y in (0..=480).step_by(40) {
            for x in (0..=640).step_by(40) {
                let pixel = Point2::new(f64::from(x), f64::from(y));
                let n = model.normalized_from_pixel(&pixel).unwrap();
                assert!((model.pixel_from_normalized(&n) - pixel).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn past_the_fold_there_is_no_inverse() {
        let model = CameraModel::OpenCv {
            fx: 100.0,
            fy: 100.0,
            cx: 0.0,
            cy: 0.0,
            k1: -0.5,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        };
        // r(1 − r²/2) has its maximum 0.544 at r = 0.816.
        assert!(model.normalized_from_pixel(&Point2::new(50.0, 0.0)).is_some());
        assert_eq!(model.normalized_from_pixel(&Point2::new(60.0, 0.0)), None);
    }

    #[test]
    fn names_and_parameters_round_trip() {
        for (name, params) in [
            ("PINHOLE", vec![1.0, 2.0, 3.0, 4.0]),
            ("OPENCV", vec![1.0, 2.0, 3.0, 4.0, 0.1, 0.2, 0.3, 0.4]),
        ] {
            let model = CameraModel::from_params(name, &params).unwrap();
            assert_eq!((model.name(), model.params()), (name, params));
        }
        assert_eq!(CameraModel::from_params("PINHOLE", &[1.0]), None);
        assert_eq!(CameraModel::from_params("FISHEYE", &[1.0; 4]), None);
    }
}
