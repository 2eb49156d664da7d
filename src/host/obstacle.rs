//! What a file's name may already stand for.

use std::fs::FileType;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Why a file can't have this name: something that is no regular file has it.
pub fn obstacle(path: &Path) -> Option<&'static str> {
    let found = std::fs::symlink_metadata(path).ok()?.file_type();
    (!found.is_file()).then(|| kind(found))
}

fn kind(found: FileType) -> &'static str {
    if found.is_symlink() {
        "is a link, which is not written over"
    } else if found.is_dir() {
        "is a folder"
    } else if found.is_fifo() {
        "is a pipe, which is not written over"
    } else if found.is_socket() {
        "is a socket, which is not written over"
    } else {
        "is a device, which is not written over"
    }
}
