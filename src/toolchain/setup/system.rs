//! Required system packages, and the command that installs them.

use super::SetupError;
use std::path::Path;

/// The command that installs Debian packages.
pub(super) fn install_line(packages: &[impl AsRef<str>]) -> String {
    // SAFETY: geteuid has no preconditions and can't fail.
    let sudo = if unsafe { libc::geteuid() } == 0 { "" } else { "sudo " };
    let packages: Vec<&str> = packages.iter().map(AsRef::as_ref).collect();
    format!("{sudo}apt-get install -y {}", packages.join(" "))
}

/// The error for a missing shared library, if an import's output names one.
pub(super) fn missing_library(root: &Path, stderr: &str) -> Option<SetupError> {
    let library = library_in(stderr)?.to_owned();
    let list = std::fs::read_to_string(root.join("blender/system-packages.txt")).ok()?;
    Some(SetupError::NoLibrary { library, line: install_line(&packages(&list)) })
}

/// Finds `libX.so.1` in "ImportError: libX.so.1: cannot open shared object file: …".
fn library_in(stderr: &str) -> Option<&str> {
    let line = stderr.lines().find(|l| l.contains("cannot open shared object file"))?;
    line.split(": ").find(|part| part.contains(".so") && !part.contains(' '))
}

/// Parses a list with one package a line; `#` starts a comment.
fn packages(list: &str) -> Vec<&str> {
    list.lines()
        .map(|line| line.split('#').next().unwrap_or_default().trim())
        .filter(|name| !name.is_empty())
        .collect()
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
