//! What a file's name may already stand for.

use std::fs::FileType;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Why a file can't have this name: something that is no regular file has it.
pub fn obstacle(path: &Path) -> Option<&'static str> {
    let found = std::fs::symlink_metadata(path).ok()?.file_type();
    (!found.is_file()).then(|| match kind(found) {
        "a folder" => "is a folder",
        "a link" => "is a link, which is not written over",
        "a pipe" => "is a pipe, which is not written over",
        "a socket" => "is a socket, which is not written over",
        _ => "is a device, which is not written over",
    })
}

/// What something that is no regular file is.
pub(super) fn kind(found: FileType) -> &'static str {
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
