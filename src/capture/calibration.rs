//! Errors of a capture's calibration: their covariance, and the fields of `capture.json` that state them.
//!
//! A calibration error of a camera has the same effect on all features in all of its frames. Therefore it doesn't
//! average out over the features.

use super::CaptureError;
use crate::camera::{Camera, CameraParameter};
use nalgebra::{Cholesky, DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Covariance of the calibration parameters of all cameras, as `stlfr refine` and `stlfr calibrate` estimate it.
///
/// The parameters are ordered by camera. Each camera has a rotation about each of the world's three axes (radians),
/// then a translation of its centre along each axis (metres), then the parameters of `lens`. The images don't determine
/// the world's position, orientation and scale. These directions of the parameter space have variance 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationCovarianceFormat {
    /// The lens parameters that were estimated. `focal` is one parameter, the logarithm of the focal lengths.
    /// `principal_point` is two parameters, in pixels. `distortion` is the camera model's further parameters.
    pub lens: Vec<LensGroup>,
    /// Lower triangle of the symmetric covariance matrix, row by row. Row k, counted from 0, has k + 1 numbers.
    pub rows: Vec<Vec<f64>>,
}

/// A group of lens parameters that are estimated together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LensGroup {
    Focal,
    PrincipalPoint,
    Distortion,
}

/// Standard deviations of the errors of one camera's calibration, stated by hand. A missing field is 0. Errors of
/// different cameras are independent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationStdFormat {
    /// Standard deviation of the error of the camera's rotation about each of the world's axes, degrees, at most 45.
    pub rotation_deg: f64,
    /// Standard deviation of the error of the camera's centre along each of the world's axes, metres, at most 1000.
    pub centre_m: f64,
    /// Standard deviation of the relative error of the focal lengths, at most 0.5.
    pub focal_relative: f64,
    /// Standard deviation of the error of each coordinate of the principal point, pixels, at most 1000.
    pub principal_point_px: f64,
}

/// Covariance of the errors of a capture's calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationErrors {
    /// Calibration parameters that may have errors, each with the index of its camera, in the order of the covariance's
    /// rows.
    pub parameters: Vec<(usize, CameraParameter)>,
    /// Covariance matrix of the parameters' errors. Symmetric, and positive semidefinite up to rounding.
    pub covariance: DMatrix<f64>,
}

/// Tolerance for negative eigenvalues due to rounding, in a covariance matrix scaled to unit variances. Numbers in
/// files are rounded to six digits or more.
const ROUNDING: f64 = 1e-5;

impl CalibrationStdFormat {
    /// Returns the fields, each with its name, its value and its largest allowed value.
    fn fields(&self) -> [(&'static str, f64, f64); 4] {
        [
            ("rotation_deg", self.rotation_deg, 45.0),
            ("centre_m", self.centre_m, 1000.0),
            ("focal_relative", self.focal_relative, 0.5),
            ("principal_point_px", self.principal_point_px, 1000.0),
        ]
    }

    /// Checks that every standard deviation is in its allowed range. The error message starts with the field's name.
    pub(super) fn check(&self) -> Result<(), String> {
        let wrong = self.fields().into_iter().find(|(_, value, max)| !(0.0..=*max).contains(value));
        wrong.map_or(Ok(()), |(field, _, max)| Err(format!("{field} must be from 0 to {max}")))
    }

    /// Returns the standard deviation of a calibration parameter's error. The unit is radians for rotations, metres for
    /// translations, and pixels for the principal point. The focal length's error is a fraction of the focal length.
    /// Distortion is assumed to be without error.
    fn of(&self, parameter: CameraParameter) -> f64 {
        match parameter {
            CameraParameter::Rotation(_) => self.rotation_deg.to_radians(),
            CameraParameter::Center(_) => self.centre_m,
            CameraParameter::Focal => self.focal_relative,
            CameraParameter::PrincipalPoint(_) => self.principal_point_px,
            CameraParameter::Distortion(_) => 0.0,
        }
    }
}

impl CalibrationErrors {
    /// Returns the covariance of the calibration errors that `capture.json` states. `None` if it states no errors.
    /// `format` is the capture's field `calibration_covariance`. `stated` holds the field `calibration_std` of each
    /// camera.
    ///
    /// Errors: both fields are given, the matrix has a wrong size, a number is not finite, or the matrix is not
    /// positive semidefinite.
    pub(super) fn open(
        format: Option<&CalibrationCovarianceFormat>,
        stated: &[Option<CalibrationStdFormat>],
        cameras: &[&Camera],
        file: &Path,
    ) -> Result<Option<Self>, CaptureError> {
        let any_stated = stated.iter().any(Option::is_some);
        match format {
            None => Ok(Some(Self::independent(stated)).filter(|e| !e.parameters.is_empty())),
            Some(_) if any_stated => {
                let reason = "calibration_covariance: the cameras have a calibration_std too";
                Err(CaptureError::content(file, reason))
            }
            Some(format) => {
                let wrong =
                    |r: String| CaptureError::content(file, format!("calibration_covariance: {r}"));
                Self::estimated(format, cameras).map(Some).map_err(wrong)
            }
        }
    }

    /// Builds the diagonal covariance of independent calibration errors. `stated` has the standard deviations of each
    /// camera's errors; `None` for a camera without errors.
    fn independent(stated: &[Option<CalibrationStdFormat>]) -> Self {
        let of_lens = [
            CameraParameter::Focal,
            CameraParameter::PrincipalPoint(0),
            CameraParameter::PrincipalPoint(1),
        ];
        let mut parameters = Vec::new();
        let mut variances = Vec::new();
        for (camera, stated) in stated.iter().enumerate() {
            let Some(stated) = stated else { continue };
            for parameter in CameraParameter::POSE.into_iter().chain(of_lens) {
                let std = stated.of(parameter);
                if std > 0.0 {
                    parameters.push((camera, parameter));
                    variances.push(std * std);
                }
            }
        }
        let covariance = DMatrix::from_diagonal(&DVector::from_vec(variances));
        Self { parameters, covariance }
    }

    /// Builds the covariance of the calibration errors from its lower triangle in `format`. The caller adds the field's
    /// name to the error message.
    fn estimated(
        format: &CalibrationCovarianceFormat,
        cameras: &[&Camera],
    ) -> Result<Self, String> {
        let mut parameters = Vec::new();
        for (index, camera) in cameras.iter().enumerate() {
            parameters.extend(CameraParameter::POSE.map(|p| (index, p)));
            for (k, group) in format.lens.iter().enumerate() {
                if format.lens[..k].contains(group) {
                    return Err("lens: has a group twice".into());
                }
                let of_group: Vec<CameraParameter> = match group {
                    LensGroup::Focal => vec![CameraParameter::Focal],
                    LensGroup::PrincipalPoint => {
                        (0..2).map(CameraParameter::PrincipalPoint).collect()
                    }
                    LensGroup::Distortion => (0..camera.model.distortion_count())
                        .map(CameraParameter::Distortion)
                        .collect(),
                };
                parameters.extend(of_group.into_iter().map(|p| (index, p)));
            }
        }
        let (rows, count) = (&format.rows, parameters.len());
        if rows.len() != count {
            return Err(format!(
                "rows: there are {}, the cameras have {count} numbers",
                rows.len()
            ));
        }
        if let Some(k) = (0..count).find(|&k| rows[k].len() != k + 1) {
            return Err(format!("rows[{k}]: has {} numbers, must have {}", rows[k].len(), k + 1));
        }
        if let Some(k) = (0..count).find(|&k| !rows[k].iter().all(|v| v.is_finite())) {
            return Err(format!("rows[{k}]: must be finite"));
        }
        let covariance = DMatrix::from_fn(count, count, |r, c| rows[r.max(c)][r.min(c)]);
        if !is_semidefinite(&covariance) {
            return Err("rows: are no covariance, some variance is negative".into());
        }
        Ok(Self { parameters, covariance })
    }

    /// Returns the covariance of the calibration errors of the given cameras only. The cameras are renumbered in the
    /// given order.
    pub(super) fn of_cameras(&self, cameras: &[usize]) -> Self {
        let mut parameters = Vec::new();
        let mut rows = Vec::new();
        for (new, old) in cameras.iter().enumerate() {
            let own = self.parameters.iter().enumerate().filter(|(_, (c, _))| c == old);
            for (row, (_, parameter)) in own {
                parameters.push((new, *parameter));
                rows.push(row);
            }
        }
        let covariance = self.covariance.select_rows(&rows).select_columns(&rows);
        Self { parameters, covariance }
    }
}

/// Returns whether a covariance matrix is positive semidefinite up to rounding.
fn is_semidefinite(covariance: &DMatrix<f64>) -> bool {
    // A parameter with variance 0 must have covariance 0 with all other parameters.
    let is_fixed = |r: usize| covariance[(r, r)] == 0.0;
    if (0..covariance.nrows()).any(|r| is_fixed(r) && covariance.row(r).iter().any(|v| *v != 0.0)) {
        return false;
    }
    let scale = covariance.diagonal().map(|v| if v > 0.0 { v.sqrt().recip() } else { 1.0 });
    let scaled = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |r, c| {
        let rounding = if r == c { ROUNDING } else { 0.0 };
        covariance[(r, c)] * scale[r] * scale[c] + rounding
    });
    Cholesky::new(scaled).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn semidefinite_within_rounding() {
        let singular = DMatrix::from_row_slice(2, 2, &[4.0, 6.0, 6.0, 9.0]);
        assert!(is_semidefinite(&singular) && is_semidefinite(&DMatrix::zeros(3, 3)));
        assert!(!is_semidefinite(&DMatrix::from_row_slice(2, 2, &[4.0, 6.1, 6.1, 9.0])));
        assert!(!is_semidefinite(&DMatrix::from_row_slice(2, 2, &[0.0, 1e-3, 1e-3, 9.0])));
        assert!(!is_semidefinite(&DMatrix::from_row_slice(1, 1, &[-1e-3])));
    }

    #[test]
    fn a_part_of_the_cameras_keeps_its_numbers() {
        let std = |rotation_deg, centre_m| {
            Some(CalibrationStdFormat { rotation_deg, centre_m, ..Default::default() })
        };
        let all = CalibrationErrors::independent(&[std(1.0, 0.0), None, std(0.0, 0.5)]);
        assert_eq!(all.parameters.len(), 6);
        let part = all.of_cameras(&[2, 1]);
        assert_eq!(part.parameters, [0, 1, 2].map(|k| (0, CameraParameter::Center(k))));
        assert_eq!(part.covariance, DMatrix::identity(3, 3) * 0.25);
    }
}
