//! Shows a comparison in Blender.

use super::script::{self, ScriptError};
use super::setup::Environment;
use crate::progress::Reporter;
use std::path::{Path, PathBuf};

/// Writes `review.blend` beside the `review.json` of a comparison.
pub fn review(
    environment: &Environment,
    layout: &Path,
    reporter: &Reporter,
) -> Result<PathBuf, ScriptError> {
    let mut command = script::command(environment, "review.py");
    command.arg(layout);
    script::run(&mut command, "review.blend", reporter, |_| ())?;
    Ok(layout.with_file_name("review.blend"))
}
