//! The calibration check against pycolmap and Blender.

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
    /// The same for people, line by line.
    pub table: Vec<String>,
}

/// The measured values, as the script prints them.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckValues {
    pub model: CheckedModel,
    /// Which images pycolmap worked from; `None` for a single camera.
    pub image_source: Option<String>,
    pub rotation_tolerance_deg: f64,
    pub position_tolerance_mm: f64,
    /// A camera may be off by so many of its standard errors, if that is more.
    pub tolerance_std_errs: f64,
    pub cameras: Vec<CheckedCamera>,
    pub ok: bool,
    /// What is not as it should be.
    pub reason: Option<String>,
}

/// The largest distances, in pixels, between our projection of a point and another's; `None` where
/// only one of the two sees some points.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedModel {
    /// pycolmap's, of this capture's cameras.
    pub capture_px: Option<f64>,
    /// Whether pycolmap read them from the capture's COLMAP model.
    pub colmap_folder: bool,
    /// pycolmap's, of every lens model.
    pub lenses: Vec<CheckedLens>,
    /// Blender's, of every image format and sensor fit.
    pub blender: Vec<CheckedFormat>,
    /// pycolmap's, of those Blender cameras.
    pub blender_pycolmap_px: Option<f64>,
    /// The largest distance from pycolmap's that passes.
    pub tolerance_px: f64,
    /// The largest distance from Blender's that passes.
    pub blender_tolerance_px: f64,
}

/// A lens model of COLMAP's.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedLens {
    pub model: String,
    pub pycolmap_px: Option<f64>,
}

/// An image format (`landscape`, `portrait`, `square`) with a sensor fit of Blender's, over shifts,
/// pixel aspects and resolution percentages.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedFormat {
    pub format: String,
    pub fit: String,
    pub blender_px: Option<f64>,
}

/// How far a camera's pose is from where the pixels put it, and the standard error of where that
/// is along its worst axis; `None` where they put it nowhere.
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
