//! Building the wheel of the Python module `stlfr` from this tree.
//!
//! It compiles in the project's own target folder, so that the crates already compiled there for
//! the program serve again. Cargo holds no lock on it while a test or `cargo run` is running.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The command that builds it, into the folder `wheels`.
pub(super) fn build_command(root: &Path, python: &Path, wheels: &Path) -> Command {
    let mut command = Command::new(root.join(".venv/bin/maturin"));
    command
        .args(["build", "--release", "--locked", "--quiet", "--interpreter"])
        .arg(python)
        .arg("--out")
        .arg(wheels)
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
