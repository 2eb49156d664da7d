//! Checks a calibration against pycolmap and Blender.

use super::script::{self, ToolchainError};
use super::setup::Environment;
use crate::host::process;
use crate::progress::Reporter;
use serde_json::Value;
use std::path::Path;

/// The result of a check.
#[derive(Clone, Debug)]
pub struct Check {
    /// Measured values: the JSON object that `blender/check.py` prints.
    pub values: Value,
    /// Why the calibration is off; `None` if it is right.
    pub failure: Option<String>,
    /// A table of the values, line by line.
    pub table: Vec<String>,
}

/// Checks a capture's calibration. A wrong calibration is a result, not an error.
pub fn check(
    environment: &Environment,
    capture: &Path,
    reporter: &Reporter,
) -> Result<Check, ToolchainError> {
    let mut command = script::command(environment, "check.py");
    command.arg(capture);
    let phase = reporter.phase("checking the calibration");
    let mut stdout = String::new();
    let ended = process::run(&mut command, |line| {
        stdout.push_str(line);
        stdout.push('\n');
    });
    drop(phase);
    let ended = ended.map_err(|e| ToolchainError::Failure(format!("check.py: {e}")))?;
    let values = serde_json::from_str::<Value>(&stdout);
    let decided = values.ok().and_then(|values| Some((values["ok"].as_bool()?, values)));
    let Some((is_right, values)) = decided else {
        script::verdict("check.py", &ended)?;
        return Err(ToolchainError::Failure("check.py: printed no result".into()));
    };
    let failure = (!is_right).then(|| values["reason"].as_str().unwrap_or_default().to_owned());
    let table: Vec<String> = ended
        .stderr
        .lines()
        .filter(|line| !line.starts_with("calibration check failed"))
        .map(str::to_owned)
        .collect();
    Ok(Check { values, failure, table })
}
