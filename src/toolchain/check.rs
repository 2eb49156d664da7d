//! Checks a calibration against pycolmap and Blender.

use super::script::{self, ScriptError};
use super::setup::Environment;
use crate::host::process;
use crate::progress::Reporter;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The result of a check.
#[derive(Clone, Debug)]
pub struct Check {
    pub values: CheckValues,
    /// A table of the values, line by line.
    pub table: Vec<String>,
}

/// Measured values, as the script prints them.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckValues {
    pub model: CheckedModel,
    /// Which images pycolmap reconstructed from; `None` for a single camera.
    pub image_source: Option<String>,
    pub rotation_tolerance_deg: f64,
    pub position_tolerance_mm: f64,
    /// A camera passes if it is off by at most this number of its standard errors.
    pub tolerance_std_errs: f64,
    pub cameras: Vec<CheckedCamera>,
    pub ok: bool,
    /// Why the check failed.
    pub reason: Option<String>,
}

/// Largest distances, in pixels, between this library's projection of a point and another program's.
/// `None` if only one of the two sees some points.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedModel {
    /// To pycolmap, for this capture's cameras.
    pub capture_px: Option<f64>,
    /// Whether pycolmap read the cameras from the capture's COLMAP model.
    pub colmap_folder: bool,
    /// To pycolmap, for every lens model.
    pub lenses: Vec<CheckedLens>,
    /// To Blender, for every image format and sensor fit.
    pub blender: Vec<CheckedFormat>,
    /// To pycolmap, for those Blender cameras.
    pub blender_pycolmap_px: Option<f64>,
    /// Tolerance to pycolmap.
    pub tolerance_px: f64,
    /// Tolerance to Blender.
    pub blender_tolerance_px: f64,
}

/// Result for one of COLMAP's lens models.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedLens {
    pub model: String,
    pub pycolmap_px: Option<f64>,
}

/// Result for an image format (`landscape`, `portrait`, `square`) and a sensor fit of Blender, over all
/// shifts, pixel aspects and resolution percentages.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedFormat {
    pub format: String,
    pub fit: String,
    pub blender_px: Option<f64>,
}

/// Difference between a camera's pose and pycolmap's reconstruction, with the reconstruction's standard
/// error along its worst axis. `None` if the camera was not reconstructed.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedCamera {
    pub id: String,
    pub rotation_deg: Option<f64>,
    pub rotation_std_err_deg: Option<f64>,
    pub position_mm: Option<f64>,
    pub position_std_err_mm: Option<f64>,
}

/// Checks a capture's calibration. A wrong calibration is a result, not an error.
pub fn check(
    environment: &Environment,
    capture: &Path,
    reporter: &Reporter,
) -> Result<Check, ScriptError> {
    let mut command = script::command(environment, "check.py");
    command.arg(capture);
    let phase = reporter.phase("checking the calibration");
    let mut stdout = String::new();
    let ended = process::run(&mut command, |line| {
        stdout.push_str(line);
        stdout.push('\n');
    });
    drop(phase);
    let ended = ended.map_err(|e| ScriptError::Failure(format!("check.py: {e}")))?;
    let Ok(values) = serde_json::from_str::<CheckValues>(&stdout) else {
        script::verdict("check.py", &ended)?;
        return Err(ScriptError::Failure("check.py: printed no result".into()));
    };
    let table: Vec<String> = ended
        .stderr
        .lines()
        .filter(|line| !line.starts_with("calibration check failed"))
        .map(str::to_owned)
        .collect();
    Ok(Check { values, table })
}
