//! Checks a calibration against pycolmap and Blender.

use super::script::{self, ScriptError};
use super::setup::Environment;
use crate::host::process;
use crate::progress::Reporter;
use serde::Deserialize;
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

/// The decision, among the measured values.
#[derive(Deserialize)]
struct CheckDecision {
    ok: bool,
    reason: Option<String>,
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
    let values = serde_json::from_str::<Value>(&stdout);
    let decided = values.and_then(|v| Ok((CheckDecision::deserialize(&v)?, v)));
    let Ok((decision, values)) = decided else {
        script::verdict("check.py", &ended)?;
        return Err(ScriptError::Failure("check.py: printed no result".into()));
    };
    let failure = (!decision.ok).then(|| decision.reason.unwrap_or_default());
    let table: Vec<String> = ended
        .stderr
        .lines()
        .filter(|line| !line.starts_with("calibration check failed"))
        .map(str::to_owned)
        .collect();
    Ok(Check { values, failure, table })
}
