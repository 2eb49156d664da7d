//! What a file's name may already stand for.

use std::fs::FileType;
use std::io::Result;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Why a file can't have this name: something that is no regular file has it.
pub fn obstacle(path: &Path) -> Option<&'static str> {
    let found = std::fs::symlink_metadata(path).ok()?.file_type();
    (!found.is_file()).then(|| match Kind::of(found) {
        Kind::Folder => "is a folder",
        Kind::Link => "is a link, which is not written over",
        Kind::Pipe => "is a pipe, which is not written over",
        Kind::Socket => "is a socket, which is not written over",
        Kind::Device => "is a device, which is not written over",
    })
}

/// Removes a link, a pipe, a socket or a device of this name. A link is not followed, wherever it leads;
/// a file and a folder stay.
pub(crate) fn remove_special(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(found) if !found.is_file() && !found.is_dir() => std::fs::remove_file(path),
        _ => Ok(()),
    }
}

/// What something that is no regular file is.
pub(super) enum Kind {
    Link,
    Folder,
    Pipe,
    Socket,
    Device,
}

impl Kind {
    pub(super) fn of(found: FileType) -> Self {
        if found.is_symlink() {
            Self::Link
        } else if found.is_dir() {
            Self::Folder
        } else if found.is_fifo() {
            Self::Pipe
        } else if found.is_socket() {
            Self::Socket
        } else {
            Self::Device
        }
    }

    /// With its article.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Link => "a link",
            Self::Folder => "a folder",
            Self::Pipe => "a pipe",
            Self::Socket => "a socket",
            Self::Device => "a device",
        }
    }
}

/// The first link among a path's folders and itself, inside `root`: through it, what is written and deleted there
/// would be elsewhere.
pub(crate) fn link_within(root: &Path, path: &Path) -> Option<PathBuf> {
    let is_link = |path: &&Path| path.symlink_metadata().is_ok_and(|m| m.is_symlink());
    path.ancestors().take_while(|p| *p != root).find(is_link).map(Path::to_owned)
}
