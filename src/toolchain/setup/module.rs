//! Builds the wheel of the Python module `stlfr` from this tree.
//!
//! It has its own target folder. In the program's folder, builds with and without the Python feature
//! would replace each other.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The command that builds the wheel into the folder `wheels`.
pub(super) fn build_command(root: &Path, python: &Path, wheels: &Path) -> Command {
    let mut command = Command::new(root.join(".venv/bin/maturin"));
    command
        .args(["build", "--release", "--locked", "--quiet", "--interpreter"])
        .arg(python)
        .arg("--out")
        .arg(wheels)
        .arg("--target-dir")
        .arg(root.join("target/python"))
        .current_dir(root.join("blender"));
    command
}

/// The wheel in the folder.
pub(super) fn wheel_in(wheels: &Path) -> Option<PathBuf> {
    std::fs::read_dir(wheels)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|e| e == "whl"))
}
