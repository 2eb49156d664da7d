//! What a path may already stand for.

use std::fs::FileType;
use std::io::{ErrorKind, Result};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// The reason why a file can't be written here: the path exists and is no regular file.
pub fn obstacle(path: &Path) -> Option<String> {
    let found = std::fs::symlink_metadata(path).ok()?.file_type();
    let reason = if found.is_dir() { "" } else { ", which is not written over" };
    (!found.is_file()).then(|| format!("is {}{reason}", file_kind(found)))
}

/// The kind of a file that is not regular, with its article.
pub(super) fn file_kind(found: FileType) -> &'static str {
    if found.is_symlink() {
        "a link"
    } else if found.is_dir() {
        "a folder"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

/// Removes a link, a pipe, a socket or a device, without following the link. A regular file and a folder stay.
pub(crate) fn remove_special(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(found) if !found.is_file() && !found.is_dir() => std::fs::remove_file(path),
        _ => Ok(()),
    }
}

/// The result of a removal, with nothing to remove as success.
pub(crate) fn ignore_absent(removal: Result<()>) -> Result<()> {
    match removal {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// The innermost link among `path` and its folders inside `root`. Writing and deleting through it would reach files
/// elsewhere.
pub(crate) fn link_within(root: &Path, path: &Path) -> Option<PathBuf> {
    let is_link = |path: &&Path| path.symlink_metadata().is_ok_and(|m| m.is_symlink());
    path.ancestors().take_while(|p| *p != root).find(is_link).map(Path::to_owned)
}
