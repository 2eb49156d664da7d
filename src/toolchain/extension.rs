//! The Blender extension as one file to install.

use super::script::{self, ScriptError};
use super::setup::{Environment, SetupError, Wheel};
use crate::host::process;
use crate::host::temporary::Temporary;
use crate::progress::Reporter;
use std::path::Path;

/// Why the extension can't be built.
#[derive(Debug, thiserror::Error)]
pub enum ExtensionError {
    #[error(transparent)]
    Wheel(#[from] SetupError),
    #[error(transparent)]
    Package(#[from] ScriptError),
}

/// Name of the zip inside its temporary folder.
const FILE: &str = "extension.zip";

/// Writes the extension's zip for this platform, with the wheel of the Python module inside, validated
/// by Blender's own tool.
pub fn build_extension(
    environment: &Environment,
    zip: &Path,
    reporter: &Reporter,
) -> Result<(), ExtensionError> {
    let wheel = Wheel::build(environment, reporter)?;
    let failed = |e| ScriptError::Failure(format!("{}: can't be written ({e})", zip.display()));
    let temporary = Temporary::for_file(zip).map_err(failed)?;
    let whole = temporary.path().join(FILE);
    let mut command = script::command(environment, "package.py");
    command.arg(&wheel.path).arg("-o").arg(&whole);
    let _phase = reporter.phase("packing the extension");
    let ended = process::run(&mut command, |_| {});
    let ended = ended.map_err(|e| ScriptError::Failure(format!("package.py: {e}")))?;
    script::verdict("package.py", &ended).map_err(|error| match error {
        // It knows the extension by its temporary name.
        ScriptError::Failure(sentence) => ScriptError::Failure(
            sentence.replace(&*whole.to_string_lossy(), &zip.to_string_lossy()),
        ),
        error => error,
    })?;
    Ok(temporary.place(FILE, zip).map_err(failed)?)
}
