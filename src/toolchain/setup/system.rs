//! Requirements on the system: a Python 3.11 that can create virtual environments, and the system libraries that
//! Blender needs. If something is missing, the error names the command that installs it.

use crate::toolchain::ToolchainError;
use std::path::Path;
use std::process::{Command, Stdio};

/// Python version for which Blender's module `bpy` is built.
const VERSION: &str = "3.11";

/// Python program that prints Python's version, and whether the module `venv` is complete. Debian has a separate
/// package for this module.
const PROBE: &str = "import sys
try:
    import ensurepip, venv
    able = 'able'
except ImportError:
    able = 'unable'
print('%d.%d' % sys.version_info[:2], able)";

/// Returns the command that starts a Python 3.11 that can create virtual environments.
pub(super) fn find_python() -> Result<&'static str, ToolchainError> {
    let mut unable = None;
    for python in ["python3.11", "python3", "python"] {
        let output = Command::new(python).args(["-I", "-c", PROBE]).stdin(Stdio::null()).output();
        let answer = output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
        match answer.as_deref().ok().and_then(|a| a.split_once(' ')) {
            Some((VERSION, "able")) => return Ok(python),
            Some((VERSION, _)) => unable = unable.or(Some(python)),
            _ => {}
        }
    }
    Err(ToolchainError::Failure(match unable {
        Some(python) => {
            let line = install_line(&["python3.11-venv"]);
            format!("{python} can't make environments; on Debian: {line}")
        }
        None => {
            let line = install_line(&["python3.11", "python3.11-venv"]);
            format!("Python 3.11 is not installed; on Debian: {line}")
        }
    }))
}

/// Returns the command line with which the user installs these Debian packages, with `sudo` unless the user is root.
fn install_line(packages: &[&str]) -> String {
    // SAFETY: geteuid has no preconditions and can't fail.
    let sudo = if unsafe { libc::geteuid() } == 0 { "" } else { "sudo " };
    format!("{sudo}apt-get install -y {}", packages.join(" "))
}

/// Returns the error for a shared library that the system lacks. `stderr` is the output of a failed import in Python.
/// `None` if it names no such library.
pub(super) fn missing_library(root: &Path, stderr: &str) -> Option<ToolchainError> {
    // The line has the form "ImportError: libX.so.1: cannot open shared object file: …".
    let line = stderr.lines().find(|l| l.contains("cannot open shared object file"))?;
    let library = line.split(": ").find(|part| part.contains(".so") && !part.contains(' '))?;
    // The list has one package per line; `#` starts a comment.
    let list = std::fs::read_to_string(root.join("blender/system-packages.txt")).ok()?;
    let packages = list.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
    let packages: Vec<&str> = packages.filter(|name| !name.is_empty()).collect();
    let line = install_line(&packages);
    Some(ToolchainError::Failure(format!(
        "Blender needs {library}, which this system lacks; on Debian: {line}"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_missing_library_and_its_line_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("blender/system-packages.txt");
        crate::host::write_atomically(&list, b"# bpy needs:\nlibegl1\nlibsm6 # X\n").unwrap();
        let stderr = "Traceback (most recent call last):\nImportError: libEGL.so.1: cannot open \
                      shared object file: No such file or directory\n";
        let message = missing_library(folder.path(), stderr).unwrap().to_string();
        assert!(message.contains("libEGL.so.1"), "{message}");
        assert!(message.ends_with("apt-get install -y libegl1 libsm6"), "{message}");
        assert!(missing_library(folder.path(), "ImportError: no numpy").is_none());
    }
}
