//! Lens models: maps from the normalized image plane z = 1 to pixels, and their inverses.

use super::distortion::Distortion;
use super::prism::PrismFisheye;
use super::radial_curve::RadialCurve;
use nalgebra::Point2;

/// COLMAP's camera models, with COLMAP's names and order of parameters. Focal lengths and principal points are in
/// pixels. Distortion coefficients are unitless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraModel {
    /// `SIMPLE_PINHOLE`: f, cx, cy.
    SimplePinhole { f: f64, cx: f64, cy: f64 },
    /// `PINHOLE`: fx, fy, cx, cy.
    Pinhole { fx: f64, fy: f64, cx: f64, cy: f64 },
    /// `SIMPLE_RADIAL`: f, cx, cy, k.
    SimpleRadial { f: f64, cx: f64, cy: f64, k: f64 },
    /// `RADIAL`: f, cx, cy, k1, k2.
    Radial { f: f64, cx: f64, cy: f64, k: [f64; 2] },
    /// `OPENCV`: fx, fy, cx, cy, k1, k2, p1, p2 (Brown's radial and tangential distortion).
    OpenCv { fx: f64, fy: f64, cx: f64, cy: f64, k1: f64, k2: f64, p1: f64, p2: f64 },
    /// `FULL_OPENCV`: fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 (rational radial distortion and tangential
    /// distortion).
    FullOpenCv { fx: f64, fy: f64, cx: f64, cy: f64, k: [f64; 6], p: [f64; 2] },
    /// `SIMPLE_RADIAL_FISHEYE`: f, cx, cy, k.
    SimpleRadialFisheye { f: f64, cx: f64, cy: f64, k: f64 },
    /// `RADIAL_FISHEYE`: f, cx, cy, k1, k2.
    RadialFisheye { f: f64, cx: f64, cy: f64, k: [f64; 2] },
    /// `OPENCV_FISHEYE`: fx, fy, cx, cy, k1, k2, k3, k4.
    OpenCvFisheye { fx: f64, fy: f64, cx: f64, cy: f64, k: [f64; 4] },
    /// `FOV`: fx, fy, cx, cy, omega.
    Fov { fx: f64, fy: f64, cx: f64, cy: f64, omega: f64 },
    /// `THIN_PRISM_FISHEYE`: fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1.
    ThinPrismFisheye { fx: f64, fy: f64, cx: f64, cy: f64, k: [f64; 4], p: [f64; 2], s: [f64; 2] },
    /// `RAD_TAN_THIN_PRISM_FISHEYE`: fx, fy, cx, cy, k0 to k5, p0, p1, s0 to s3.
    RadTanThinPrismFisheye {
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        k: [f64; 6],
        p: [f64; 2],
        s: [f64; 4],
    },
    /// `SIMPLE_DIVISION`: f, cx, cy, k.
    SimpleDivision { f: f64, cx: f64, cy: f64, k: f64 },
    /// `DIVISION`: fx, fy, cx, cy, k.
    Division { fx: f64, fy: f64, cx: f64, cy: f64, k: f64 },
    /// `SIMPLE_FISHEYE`: f, cx, cy.
    SimpleFisheye { f: f64, cx: f64, cy: f64 },
    /// `FISHEYE`: fx, fy, cx, cy.
    Fisheye { fx: f64, fy: f64, cx: f64, cy: f64 },
    /// `EUCM`: fx, fy, cx, cy, alpha, beta.
    Eucm { fx: f64, fy: f64, cx: f64, cy: f64, alpha: f64, beta: f64 },
}

impl CameraModel {
    /// All camera models. Each entry is COLMAP's name of the model, the model's number in COLMAP's binary files, and
    /// its number of parameters.
    pub const KNOWN: [(&str, i32, usize); 17] = [
        ("SIMPLE_PINHOLE", 0, 3),
        ("PINHOLE", 1, 4),
        ("SIMPLE_RADIAL", 2, 4),
        ("RADIAL", 3, 5),
        ("OPENCV", 4, 8),
        ("OPENCV_FISHEYE", 5, 8),
        ("FULL_OPENCV", 6, 12),
        ("SIMPLE_RADIAL_FISHEYE", 8, 4),
        ("RADIAL_FISHEYE", 9, 5),
        ("FOV", 7, 5),
        ("THIN_PRISM_FISHEYE", 10, 12),
        ("RAD_TAN_THIN_PRISM_FISHEYE", 11, 16),
        ("SIMPLE_DIVISION", 12, 4),
        ("DIVISION", 13, 5),
        ("SIMPLE_FISHEYE", 14, 3),
        ("FISHEYE", 15, 4),
        ("EUCM", 16, 6),
    ];

    /// Returns COLMAP's name of the model.
    pub fn name(&self) -> &'static str {
        match self {
            Self::SimplePinhole { .. } => "SIMPLE_PINHOLE",
            Self::Pinhole { .. } => "PINHOLE",
            Self::SimpleRadial { .. } => "SIMPLE_RADIAL",
            Self::Radial { .. } => "RADIAL",
            Self::OpenCv { .. } => "OPENCV",
            Self::FullOpenCv { .. } => "FULL_OPENCV",
            Self::SimpleRadialFisheye { .. } => "SIMPLE_RADIAL_FISHEYE",
            Self::RadialFisheye { .. } => "RADIAL_FISHEYE",
            Self::OpenCvFisheye { .. } => "OPENCV_FISHEYE",
            Self::Fov { .. } => "FOV",
            Self::ThinPrismFisheye { .. } => "THIN_PRISM_FISHEYE",
            Self::RadTanThinPrismFisheye { .. } => "RAD_TAN_THIN_PRISM_FISHEYE",
            Self::SimpleDivision { .. } => "SIMPLE_DIVISION",
            Self::Division { .. } => "DIVISION",
            Self::SimpleFisheye { .. } => "SIMPLE_FISHEYE",
            Self::Fisheye { .. } => "FISHEYE",
            Self::Eucm { .. } => "EUCM",
        }
    }

    /// Returns the parameters in COLMAP's order.
    pub fn params(&self) -> Vec<f64> {
        match *self {
            Self::SimplePinhole { f, cx, cy } | Self::SimpleFisheye { f, cx, cy } => {
                vec![f, cx, cy]
            }
            Self::Pinhole { fx, fy, cx, cy } | Self::Fisheye { fx, fy, cx, cy } => {
                vec![fx, fy, cx, cy]
            }
            Self::SimpleRadial { f, cx, cy, k }
            | Self::SimpleRadialFisheye { f, cx, cy, k }
            | Self::SimpleDivision { f, cx, cy, k } => vec![f, cx, cy, k],
            Self::Radial { f, cx, cy, k } | Self::RadialFisheye { f, cx, cy, k } => {
                vec![f, cx, cy, k[0], k[1]]
            }
            Self::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 } => {
                vec![fx, fy, cx, cy, k1, k2, p1, p2]
            }
            Self::FullOpenCv { fx, fy, cx, cy, k, p } => {
                vec![fx, fy, cx, cy, k[0], k[1], p[0], p[1], k[2], k[3], k[4], k[5]]
            }
            Self::OpenCvFisheye { fx, fy, cx, cy, k } => {
                vec![fx, fy, cx, cy, k[0], k[1], k[2], k[3]]
            }
            Self::Fov { fx, fy, cx, cy, omega: k } | Self::Division { fx, fy, cx, cy, k } => {
                vec![fx, fy, cx, cy, k]
            }
            Self::ThinPrismFisheye { fx, fy, cx, cy, k, p, s } => {
                vec![fx, fy, cx, cy, k[0], k[1], p[0], p[1], k[2], k[3], s[0], s[1]]
            }
            Self::RadTanThinPrismFisheye { fx, fy, cx, cy, k, p, s } => {
                [&[fx, fy, cx, cy][..], &k, &p, &s].concat()
            }
            Self::Eucm { fx, fy, cx, cy, alpha, beta } => vec![fx, fy, cx, cy, alpha, beta],
        }
    }

    /// Returns the model with this COLMAP name and these parameters. `None` if the name is unknown or the number of
    /// parameters is wrong.
    pub fn from_params(name: &str, params: &[f64]) -> Option<Self> {
        Some(match (name, params) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => Self::SimplePinhole { f, cx, cy },
            ("PINHOLE", &[fx, fy, cx, cy]) => Self::Pinhole { fx, fy, cx, cy },
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => Self::SimpleRadial { f, cx, cy, k },
            ("RADIAL", &[f, cx, cy, k1, k2]) => Self::Radial { f, cx, cy, k: [k1, k2] },
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                Self::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 }
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                Self::FullOpenCv { fx, fy, cx, cy, k: [k1, k2, k3, k4, k5, k6], p: [p1, p2] }
            }
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
                Self::SimpleRadialFisheye { f, cx, cy, k }
            }
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => {
                Self::RadialFisheye { f, cx, cy, k: [k1, k2] }
            }
            ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
                Self::OpenCvFisheye { fx, fy, cx, cy, k: [k1, k2, k3, k4] }
            }
            ("FOV", &[fx, fy, cx, cy, omega]) => Self::Fov { fx, fy, cx, cy, omega },
            ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1]) => {
                let k = [k1, k2, k3, k4];
                Self::ThinPrismFisheye { fx, fy, cx, cy, k, p: [p1, p2], s: [sx1, sy1] }
            }
            (
                "RAD_TAN_THIN_PRISM_FISHEYE",
                &[fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3],
            ) => Self::RadTanThinPrismFisheye {
                fx,
                fy,
                cx,
                cy,
                k: [k0, k1, k2, k3, k4, k5],
                p: [p0, p1],
                s: [s0, s1, s2, s3],
            },
            ("SIMPLE_DIVISION", &[f, cx, cy, k]) => Self::SimpleDivision { f, cx, cy, k },
            ("DIVISION", &[fx, fy, cx, cy, k]) => Self::Division { fx, fy, cx, cy, k },
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => Self::SimpleFisheye { f, cx, cy },
            ("FISHEYE", &[fx, fy, cx, cy]) => Self::Fisheye { fx, fy, cx, cy },
            ("EUCM", &[fx, fy, cx, cy, alpha, beta]) => Self::Eucm { fx, fy, cx, cy, alpha, beta },
            _ => return None,
        })
    }

    /// Returns the focal lengths and the principal point as (fx, fy, cx, cy), pixels.
    pub fn intrinsics(&self) -> (f64, f64, f64, f64) {
        match *self {
            Self::SimplePinhole { f, cx, cy }
            | Self::SimpleRadial { f, cx, cy, .. }
            | Self::Radial { f, cx, cy, .. }
            | Self::SimpleRadialFisheye { f, cx, cy, .. }
            | Self::RadialFisheye { f, cx, cy, .. }
            | Self::SimpleDivision { f, cx, cy, .. }
            | Self::SimpleFisheye { f, cx, cy } => (f, f, cx, cy),
            Self::Pinhole { fx, fy, cx, cy }
            | Self::OpenCv { fx, fy, cx, cy, .. }
            | Self::FullOpenCv { fx, fy, cx, cy, .. }
            | Self::OpenCvFisheye { fx, fy, cx, cy, .. }
            | Self::Fov { fx, fy, cx, cy, .. }
            | Self::ThinPrismFisheye { fx, fy, cx, cy, .. }
            | Self::RadTanThinPrismFisheye { fx, fy, cx, cy, .. }
            | Self::Division { fx, fy, cx, cy, .. }
            | Self::Fisheye { fx, fy, cx, cy }
            | Self::Eucm { fx, fy, cx, cy, .. } => (fx, fy, cx, cy),
        }
    }

    /// Returns the model for the same image at half the resolution.
    pub fn halved(&self) -> Self {
        self.scaled(0.5)
    }

    /// Returns the model for the same image at `factor` times the resolution in both directions.
    pub fn scaled(&self, factor: f64) -> Self {
        let intrinsics = self.focal_count() + 2;
        let mut params = self.params();
        params[..intrinsics].iter_mut().for_each(|v| *v *= factor);
        // Name and number of parameters come from the model itself, so the conversion can't fail.
        Self::from_params(self.name(), &params).unwrap_or(*self)
    }

    /// Returns whether the model has no distortion.
    pub fn is_pinhole(&self) -> bool {
        self.distortion() == Distortion::None
    }

    /// Projects the point `n` of the plane z = 1 to a pixel. The result is meaningful only where
    /// [`Self::is_short_of_fold`] is true.
    pub fn pixel_from_normalized(&self, n: &Point2<f64>) -> Point2<f64> {
        let (fx, fy, cx, cy) = self.intrinsics();
        let d = self.distortion().distorted(n);
        Point2::new(fx * d.x + cx, fy * d.y + cy)
    }

    /// Returns whether the point `n` of the plane z = 1 lies inside of the fold. The fold is the radius at which the
    /// distorted radius stops growing. Beyond the fold, the model isn't invertible.
    pub fn is_short_of_fold(&self, n: &Point2<f64>) -> bool {
        self.distortion().is_short_of_fold(n)
    }

    /// Returns the point of the plane z = 1 that projects to `pixel`. `None` if no point inside of the fold
    /// ([`Self::is_short_of_fold`]) projects there.
    pub fn normalized_from_pixel(&self, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        let (fx, fy, cx, cy) = self.intrinsics();
        self.distortion().undistorted(&Point2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy))
    }

    /// Removes the distortion from a pixel position: returns the position at which a pinhole camera with the same focal
    /// lengths and principal point would see the same point. Epipolar lines are straight in undistorted pixels. `None`
    /// where [`Self::normalized_from_pixel`] is `None`.
    pub fn ideal_from_pixel(&self, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        if self.is_pinhole() {
            return Some(*pixel);
        }
        let (fx, fy, cx, cy) = self.intrinsics();
        let n = self.normalized_from_pixel(pixel)?;
        Some(Point2::new(fx * n.x + cx, fy * n.y + cy))
    }

    /// Returns the model's distortion on the plane z = 1.
    fn distortion(&self) -> Distortion {
        let (k, p) = match *self {
            Self::SimplePinhole { .. } | Self::Pinhole { .. } => return Distortion::None,
            Self::SimpleRadialFisheye { k, .. } => {
                return Distortion::Fisheye { k: [k, 0.0, 0.0, 0.0] };
            }
            Self::RadialFisheye { k: [k1, k2], .. } => {
                return Distortion::Fisheye { k: [k1, k2, 0.0, 0.0] };
            }
            Self::OpenCvFisheye { k, .. } => return Distortion::Fisheye { k },
            Self::SimpleFisheye { .. } | Self::Fisheye { .. } => {
                return Distortion::Fisheye { k: [0.0; 4] };
            }
            Self::Fov { omega: 0.0, .. }
            | Self::SimpleDivision { k: 0.0, .. }
            | Self::Division { k: 0.0, .. }
            | Self::Eucm { alpha: 0.0, .. } => return Distortion::None,
            Self::Fov { omega, .. } => return Distortion::Curve(RadialCurve::Fov { omega }),
            Self::SimpleDivision { k, .. } | Self::Division { k, .. } => {
                return Distortion::Curve(RadialCurve::Division { k });
            }
            Self::Eucm { alpha, beta, .. } => {
                return Distortion::Curve(RadialCurve::Eucm { alpha, beta });
            }
            Self::ThinPrismFisheye { k: [k1, k2, k3, k4], p: [p1, p2], s: [sx1, sy1], .. } => {
                return Distortion::Prism(PrismFisheye {
                    k: [k1, k2, k3, k4, 0.0, 0.0],
                    // In Brown's model p2 is the coefficient of x.
                    p: [p2, p1],
                    s: [sx1, 0.0, sy1, 0.0],
                    is_nested: false,
                });
            }
            Self::RadTanThinPrismFisheye { k, p, s, .. } => {
                return Distortion::Prism(PrismFisheye { k, p, s, is_nested: true });
            }
            Self::SimpleRadial { k, .. } => ([k, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            Self::Radial { k: [k1, k2], .. } => ([k1, k2, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            Self::OpenCv { k1, k2, p1, p2, .. } => ([k1, k2, 0.0, 0.0, 0.0, 0.0], [p1, p2]),
            Self::FullOpenCv { k, p, .. } => (k, p),
        };
        if k == [0.0; 6] && p == [0.0; 2] { Distortion::None } else { Distortion::Brown { k, p } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns one model of each kind, with a realistic distortion, for a 640×480 image.
    fn one_of_each() -> Vec<CameraModel> {
        let (f, fx, fy, cx, cy) = (400.0, 686.0, 680.0, 321.0, 239.0);
        let params: [&[f64]; 17] = [
            &[f, cx, cy],
            &[fx, fy, cx, cy],
            &[fx, cx, cy, -0.15],
            &[fx, cx, cy, -0.21, 0.07],
            &[fx, fy, cx, cy, -0.21, 0.07, 1e-3, -2e-3],
            &[f, f, cx, cy, 0.02, -0.01, 0.004, -0.001],
            &[fx, fy, cx, cy, 0.3, -0.1, 1e-3, -2e-3, 0.02, 0.5, 0.1, -0.01],
            &[f, cx, cy, -0.03],
            &[f, cx, cy, 0.05, -0.02],
            &[f, f, cx, cy, 0.9],
            &[f, f, cx, cy, 0.02, -0.01, 1e-3, -2e-3, 0.004, -0.001, 2e-3, -1e-3],
            &[
                f, f, cx, cy, 0.02, -0.01, 0.004, -0.001, 2e-4, -1e-4, 1e-3, -2e-3, 2e-3, -1e-3,
                1e-3, 5e-4,
            ],
            &[fx, cx, cy, -0.2],
            &[fx, fy, cx, cy, 0.1],
            &[f, cx, cy],
            &[f, f, cx, cy],
            &[fx, fy, cx, cy, 0.6, 1.1],
        ];
        CameraModel::KNOWN
            .iter()
            .zip(params)
            .map(|((name, _, count), params)| {
                assert_eq!(params.len(), *count, "{name}");
                CameraModel::from_params(name, params).unwrap()
            })
            .collect()
    }

    #[test]
    fn names_and_parameters_round_trip() {
        for (model, (name, _, count)) in one_of_each().into_iter().zip(CameraModel::KNOWN) {
            assert_eq!(model.name(), name);
            let params: Vec<f64> = (1..=count).map(|k| k as f64).collect();
            let back = CameraModel::from_params(name, &params).unwrap();
            assert_eq!((back.name(), back.params()), (name, params.clone()));
            assert_eq!(CameraModel::from_params(name, &params[1..]), None);
        }
        assert_eq!(CameraModel::from_params("FISH", &[1.0; 4]), None);
    }

    #[test]
    fn distortion_is_inverted_to_the_last_digits() {
        for model in one_of_each() {
            for y in (0..=480).step_by(40) {
                for x in (0..=640).step_by(40) {
                    let pixel = Point2::new(f64::from(x), f64::from(y));
                    let n = model.normalized_from_pixel(&pixel).unwrap();
                    assert!(model.is_short_of_fold(&n), "{} {pixel}", model.name());
                    let off = (model.pixel_from_normalized(&n) - pixel).norm();
                    assert!(off < 1e-9, "{} {pixel}: {off}", model.name());
                }
            }
        }
    }

    /// A fisheye with zero coefficients is equidistant: the radius in pixels is f θ.
    #[test]
    fn a_fisheye_measures_angles() {
        let model = CameraModel::SimpleRadialFisheye { f: 300.0, cx: 0.0, cy: 0.0, k: 0.0 };
        assert!(!model.is_pinhole());
        let n = Point2::new(0.0, std::f64::consts::FRAC_PI_3.tan());
        let pixel = model.pixel_from_normalized(&n);
        assert!((pixel - Point2::new(0.0, 100.0 * std::f64::consts::PI)).norm() < 1e-12);
        let beyond = Point2::new(0.0, 300.0 * std::f64::consts::FRAC_PI_2);
        assert_eq!(model.normalized_from_pixel(&beyond), None);
        assert_eq!(model.normalized_from_pixel(&Point2::origin()), Some(Point2::origin()));
    }

    #[test]
    fn past_the_fold_there_is_no_inverse_and_no_image() {
        let folding = CameraModel::OpenCv {
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
        assert!(folding.normalized_from_pixel(&Point2::new(50.0, 0.0)).is_some());
        assert!(folding.normalized_from_pixel(&Point2::new(54.4, 0.0)).is_some());
        assert_eq!(folding.normalized_from_pixel(&Point2::new(54.5, 0.0)), None);
        assert_eq!(folding.normalized_from_pixel(&Point2::new(60.0, 0.0)), None);
        assert!(folding.is_short_of_fold(&Point2::new(0.816, 0.0)));
        assert!(!folding.is_short_of_fold(&Point2::new(0.817, 0.0)));
        assert!(!folding.is_short_of_fold(&Point2::new(3.0, 4.0)));
        assert!(!folding.is_short_of_fold(&Point2::new(f64::NAN, 0.0)));
    }

    /// Beyond the second fold, the distorted radius grows again. The model is still not invertible there, because
    /// points nearer to the axis project to the same pixels.
    #[test]
    fn a_lens_that_folds_twice_ends_at_the_first() {
        let model = CameraModel::Radial { f: 1.0, cx: 0.0, cy: 0.0, k: [-1.0, 0.3] };
        // 1 − 3 s + 1.5 s² is negative from s = 0.42 to 1.58.
        for (r, expected) in [(0.6, true), (0.7, false), (1.2, false), (1.4, false)] {
            assert_eq!(model.is_short_of_fold(&Point2::new(r, 0.0)), expected, "{r}");
        }
        let pixel = model.pixel_from_normalized(&Point2::new(1.4, 0.0));
        let inverse = model.normalized_from_pixel(&pixel);
        assert!(inverse.is_none_or(|n| n.coords.norm() < 0.65), "{inverse:?}");
    }

    /// Tests the inverse up to the fold. The pincushion distortion maps some points inside of the fold to distorted
    /// radii larger than the fold's radius. Newton's method then starts beyond the fold.
    #[test]
    fn strong_distortion_is_inverted_up_to_its_fold() {
        let barrel = CameraModel::SimpleRadial { f: 1.0, cx: 0.0, cy: 0.0, k: -0.5 };
        let pincushion = CameraModel::Radial { f: 1.0, cx: 0.0, cy: 0.0, k: [0.9, -0.6] };
        let fisheye = CameraModel::OpenCvFisheye {
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            k: [-0.3, 0.0, 0.0, 0.0],
        };
        for (model, fold) in
            [(barrel, (2.0_f64 / 3.0).sqrt()), (pincushion, 1.048), (fisheye, 1.054_f64.tan())]
        {
            for k in 1..1000 {
                let r = fold * f64::from(k) / 1000.0;
                let n = Point2::new(0.6 * r, -0.8 * r);
                let back = model.normalized_from_pixel(&model.pixel_from_normalized(&n)).unwrap();
                assert!((back - n).norm() < 1e-8, "{model:?} at {r}: {back}");
            }
        }
    }

    /// The reference pixels were computed by pycolmap, in `tests/golden/make_lens_reference.py`.
    #[test]
    fn points_are_projected_as_pycolmap_does() {
        let text = include_str!("../../tests/golden/lenses.json");
        let lenses: Vec<serde_json::Value> = serde_json::from_str(text).unwrap();
        assert_eq!(lenses.len(), CameraModel::KNOWN.len());
        let numbers = |value: &serde_json::Value| -> Vec<f64> {
            value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
        };
        for lens in &lenses {
            let name = lens["model"].as_str().unwrap();
            let model = CameraModel::from_params(name, &numbers(&lens["params"])).unwrap();
            let points = lens["points"].as_array().unwrap().iter().map(numbers);
            for (point, pixel) in points.zip(lens["pixels"].as_array().unwrap()) {
                let (n, pixel) = (Point2::new(point[0], point[1]), numbers(pixel));
                let off = model.pixel_from_normalized(&n) - Point2::new(pixel[0], pixel[1]);
                assert!(off.norm() < 1e-9, "{name} at {n}: {off}");
                assert!(model.is_short_of_fold(&n), "{name} at {n}");
            }
        }
    }
}
