//! How far a capture's calibration may be off: the fields of `capture.json` that say so, and the covariance that follows.
//!
//! A calibration's errors are common to all that a camera sees, so that they do not average out over features or frames.

use super::CaptureError;
use crate::camera::{Camera, CameraParameter};
use nalgebra::{Cholesky, DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The covariance of all cameras' calibration, as `stlfr refine` and `stlfr calibrate` estimate it.
///
/// Every camera has the same numbers, camera after camera: a turn about the world's three axes (radians), a move of its
/// centre along them (metres), then those of `lens` in its order. Directions that no image shows (where the world is, how
/// it is turned, how large its unit is) have no variance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationCovarianceFormat {
    /// The lens parameters that were estimated: `focal` is one number, the logarithm of the focal lengths;
    /// `principal_point` two, pixels; `distortion` the model's further parameters.
    pub lens: Vec<LensGroup>,
    /// The lower triangle of the symmetric matrix by rows: one number in the first row, one more in each row after it.
    pub rows: Vec<Vec<f64>>,
}

/// Parameters of a lens that are estimated together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LensGroup {
    Focal,
    PrincipalPoint,
    Distortion,
}

/// How far a camera's calibration may be off, stated by hand: standard deviations, 0 where a field is left out. Errors of
/// different cameras are independent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrationStdFormat {
    /// Of the turn about each axis, degrees, at most 45.
    pub rotation_deg: f64,
    /// Of the centre along each axis, metres, at most 1000.
    pub centre_m: f64,
    /// Of the focal lengths, as a fraction of them, at most 0.5.
    pub focal_relative: f64,
    /// Of each coordinate of the principal point, pixels, at most 1000.
    pub principal_point_px: f64,
}

/// The covariance of the errors of a capture's calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationErrors {
    /// The numbers that may be off, with the index of their camera, in the order of the covariance's rows.
    pub parameters: Vec<(usize, CameraParameter)>,
    /// Symmetric and positive semidefinite within rounding.
    pub covariance: DMatrix<f64>,
}

/// The most negative eigenvalue that is rounding, as a fraction of the variances: numbers in files have six digits or more.
const ROUNDING: f64 = 1e-5;

impl CalibrationStdFormat {
    /// The fields, each with its name and its largest value.
    fn fields(&self) -> [(&'static str, f64, f64); 4] {
        [
            ("rotation_deg", self.rotation_deg, 45.0),
            ("centre_m", self.centre_m, 1000.0),
            ("focal_relative", self.focal_relative, 0.5),
            ("principal_point_px", self.principal_point_px, 1000.0),
        ]
    }

    /// The error is a reason that starts with the field.
    pub(super) fn check(&self) -> Result<(), String> {
        let wrong = self.fields().into_iter().find(|(_, value, max)| !(0.0..=*max).contains(value));
        wrong.map_or(Ok(()), |(field, _, max)| Err(format!("{field} must be from 0 to {max}")))
    }

    /// The standard deviation of a parameter.
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
    /// The errors that the fields of a capture state; `None` if they state none. `stated` are the cameras' own fields.
    ///
    /// Errors: both kinds of fields, a matrix of another size, a number that is not finite, a matrix that is no
    /// covariance.
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

    /// Independent errors with these standard deviations.
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

    /// The error is a reason without the field's name.
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

    /// Those of some of the cameras, in this order.
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

/// Whether no variance in any direction is negative, within rounding.
fn is_semidefinite(covariance: &DMatrix<f64>) -> bool {
    // What has no variance varies with nothing else.
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
