//! The calibration check against pycolmap.

use super::process;
use super::script::{self, ScriptError};
use super::setup::Environment;
use crate::progress::Reporter;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the check found.
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
    /// The largest distance between pycolmap's and our projection of a point; `None` where only one
    /// of them sees some points.
    pub model_max_px: Option<f64>,
    pub model_tolerance_px: f64,
    pub rotation_tolerance_deg: f64,
    pub position_tolerance_mm: f64,
    /// Which images pycolmap worked from; `None` for a single camera.
    pub image_source: Option<String>,
    pub cameras: Vec<CheckedCamera>,
    pub ok: bool,
    /// What is not as it should be.
    pub reason: Option<String>,
}

/// How far a camera's pose is from where the pixels put it; `None` where they put it nowhere.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CheckedCamera {
    pub id: String,
    pub rotation_deg: Option<f64>,
    pub position_mm: Option<f64>,
}

/// Checks a capture's calibration. A calibration that is found wrong is a result, not an error; the
/// values also go into the file `json`, if one is named.
pub fn check(
    environment: &Environment,
    capture: &Path,
    json: Option<&Path>,
    reporter: &Reporter,
) -> Result<Check, ScriptError> {
    let mut command = script::command(environment, "check.py");
    command.arg(capture);
    if let Some(json) = json {
        command.arg("--json").arg(json);
    }
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
