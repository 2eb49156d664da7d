//! The calibration check against pycolmap.

use super::script::{self, ScriptError};
use super::setup::Environment;
use crate::progress::Reporter;
use std::path::Path;

/// Checks a capture's calibration. The table goes to `on_text`, line by line; the measured values
/// into the file `json`, if one is named.
pub fn check(
    environment: &Environment,
    capture: &Path,
    json: Option<&Path>,
    reporter: &Reporter,
    on_text: impl FnMut(&str),
) -> Result<(), ScriptError> {
    let mut command = script::command(environment, "check.py");
    command.arg(capture);
    if let Some(json) = json {
        command.arg("--json").arg(json);
    }
    script::run(&mut command, "checking the calibration", reporter, on_text)
}
