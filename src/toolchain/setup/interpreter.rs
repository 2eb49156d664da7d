//! Finds a Python 3.11 that can create environments.

use super::{SetupError, system};
use std::process::{Command, Stdio};

/// The version that `bpy` is built for.
const VERSION: &str = "3.11";

/// Prints the version, and whether `venv` is there: Debian packages it separately.
const PROBE: &str = "import sys
try:
    import ensurepip, venv
    able = 'able'
except ImportError:
    able = 'unable'
print('%d.%d' % sys.version_info[:2], able)";

/// The command that starts such a Python.
pub(super) fn find() -> Result<&'static str, SetupError> {
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
    Err(match unable {
        Some(python) => SetupError::NoVenv {
            python: python.to_owned(),
            line: system::install_line(&["python3.11-venv"]),
        },
        None => SetupError::NoPython(system::install_line(&["python3.11", "python3.11-venv"])),
    })
}
