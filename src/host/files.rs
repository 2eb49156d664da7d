//! Access to files at untrusted paths. Only regular files up to a size limit are read, because a device or a pipe could
//! block, and a huge file could exhaust the memory. Output files replace only regular files.

use serde::Serialize;
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Opens a regular file for reading. Symbolic links are followed. Opening never blocks.
///
/// # Errors
/// If the file can't be opened, or if it is not a regular file. In the latter case, the error names the kind of file,
/// such as a folder or a pipe.
pub fn open_file(path: &Path) -> Result<File> {
    must_be_regular(&std::fs::metadata(path)?)?;
    // After this check, the file may be replaced by a pipe. Opening a pipe without `O_NONBLOCK` waits for a writer.
    let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    must_be_regular(&file.metadata()?)?;
    Ok(file)
}

/// Opens a regular file of at most `max_bytes`. Returns the open file and its length in bytes.
pub fn open_bounded(path: &Path, max_bytes: u64) -> Result<(File, u64)> {
    let file = open_file(path)?;
    let bytes = file.metadata()?.len();
    if bytes > max_bytes { Err(too_large(max_bytes)) } else { Ok((file, bytes)) }
}

/// Reads the bytes of a regular file. A file of more than `max_bytes` is an error, and is not read.
pub fn read_bytes(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let (mut file, length) = open_bounded(path, max_bytes)?;
    read_open(&mut file, length, max_bytes)
}

fn read_open(file: &mut File, length: u64, max_bytes: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(length as usize);
    // The length is checked again, because a file may grow, and files in /proc state a length of 0.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large(max_bytes)) } else { Ok(bytes) }
}

/// State of a file, by which a change of its content is detected. As in Git's index, the state consists of device,
/// inode and size, the time of the last change of content (mtime), and the time of the last change of metadata (ctime).
/// Times are seconds and nanoseconds. Two changes of content within the resolution of these times may give equal
/// states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct FileState([u64; 3], [i64; 2], [i64; 2]);

impl FileState {
    pub fn of(found: &Metadata) -> Self {
        let identity = [found.dev(), found.ino(), found.size()];
        Self(identity, [found.mtime(), found.mtime_nsec()], [found.ctime(), found.ctime_nsec()])
    }

    /// Returns whether two states of a file have the same size and modification time, so that its content has probably
    /// not changed. The inode is not compared, because some network file systems change inode numbers. The permissions
    /// are not compared either.
    pub fn has_content_of(&self, other: &Self) -> bool {
        (self.0[2], self.1) == (other.0[2], other.1)
    }

    /// Returns the later of two times, as seconds and nanoseconds: the last change of content (mtime), and the last
    /// change of metadata (ctime).
    pub fn changed(&self) -> [i64; 2] {
        self.1.max(self.2)
    }
}

/// Hash of a file's bytes, and the file's state after they were read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FileRead {
    pub hash: blake3::Hash,
    pub state: FileState,
}

/// Reads a regular file of at most `max_bytes`. Returns its bytes, with their hash and the file's state.
pub(crate) fn read_hashed(path: &Path, max_bytes: u64) -> Result<(Vec<u8>, FileRead)> {
    let (mut file, length) = open_bounded(path, max_bytes)?;
    let bytes = read_open(&mut file, length, max_bytes)?;
    let read = FileRead { hash: blake3::hash(&bytes), state: FileState::of(&file.metadata()?) };
    Ok((bytes, read))
}

/// Reads a regular file of at most `max_bytes` as UTF-8 text.
pub fn read_text(path: &Path, max_bytes: u64) -> Result<String> {
    String::from_utf8(read_bytes(path, max_bytes)?)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "is no text in UTF-8"))
}

/// Adds the length and the bytes of a regular file to a hash. The file is read in chunks.
pub(crate) fn hash_file(hasher: &mut blake3::Hasher, path: &Path) -> Result<()> {
    let file = open_file(path)?;
    hasher.update(&file.metadata()?.len().to_le_bytes());
    hasher.update_reader(file)?;
    Ok(())
}

fn must_be_regular(found: &Metadata) -> Result<()> {
    if found.is_file() {
        return Ok(());
    }
    let sentence = format!("is {}, not a regular file", file_kind(found.file_type()));
    Err(Error::new(ErrorKind::InvalidInput, sentence))
}

fn too_large(max_bytes: u64) -> Error {
    let limit = match (max_bytes >> 20, max_bytes >> 10) {
        (0, 0) => format!("{max_bytes} bytes"),
        (0, kib) => format!("{kib} KiB"),
        (mib, _) => format!("{mib} MiB"),
    };
    Error::new(ErrorKind::InvalidData, format!("is larger than {limit}, the maximum"))
}

/// Returns the reason why no file may be written at a path, such as `is a pipe`. The reason is that something other
/// than a regular file exists there. `None` if nothing or a regular file exists there.
pub fn obstacle(path: &Path) -> Option<String> {
    let found = path.symlink_metadata().ok()?.file_type();
    let reason = if found.is_dir() { "" } else { ", which is not written over" };
    (!found.is_file()).then(|| format!("is {}{reason}", file_kind(found)))
}

/// Returns the kind of a file that isn't regular, with an article, such as `a pipe`.
fn file_kind(found: FileType) -> &'static str {
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

/// Removes the file at a path if it is a symbolic link, a pipe, a socket or a device. The target of a link is not
/// removed. Regular files and folders are not removed.
pub(crate) fn remove_special(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(found) if !found.is_file() && !found.is_dir() => std::fs::remove_file(path),
        _ => Ok(()),
    }
}

/// Converts the result of removing or renaming a file: the error that the file doesn't exist becomes success.
pub(crate) fn ignore_absent(removal: Result<()>) -> Result<()> {
    match removal {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Returns the innermost symbolic link among `path` and its parent folders below `root`. `None` if there is no link.
/// Callers refuse links, because a link may lead to files outside of `root`.
pub(crate) fn link_within(root: &Path, path: &Path) -> Option<PathBuf> {
    let is_link = |path: &&Path| path.symlink_metadata().is_ok_and(|m| m.is_symlink());
    path.ancestors().take_while(|p| *p != root).find(is_link).map(Path::to_owned)
}

/// Returns the path of the file `name` in the output folder `root`.
///
/// # Errors
/// If the file, or a folder between the file and `root`, is a symbolic link. Links may lead to files elsewhere. `root`
/// itself may be a link.
pub(crate) fn beneath(root: &Path, name: &str) -> Result<PathBuf> {
    let path = root.join(name);
    match link_within(root, &path) {
        None => Ok(path),
        Some(link) => {
            let link = link.strip_prefix(root).unwrap_or(&link).display().to_string();
            let sentence = format!("{link} is a link, which is not written through");
            Err(Error::new(ErrorKind::InvalidInput, sentence))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn only_regular_files_up_to_the_limit_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let [pipe, link, file] = ["pipe", "link", "file"].map(|name| folder.path().join(name));
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for (path, words) in [
            (pipe.as_path(), "is a pipe, not a regular file"),
            (&link, "is a device, not a regular file"),
            (Path::new("/dev/zero"), "is a device, not a regular file"),
            (folder.path(), "is a folder, not a regular file"),
        ] {
            let error = read_bytes(path, 1 << 30).unwrap_err();
            assert_eq!(
                (error.kind(), error.to_string().as_str()),
                (ErrorKind::InvalidInput, words)
            );
        }
        std::fs::write(&file, "x".repeat(1024)).unwrap();
        assert_eq!(read_text(&file, 1024).unwrap().len(), 1024);
        assert_eq!(read_bytes(&file, u64::MAX).unwrap().len(), 1024);
        let error = read_bytes(&file, 1023).unwrap_err().to_string();
        assert_eq!(error, "is larger than 1023 bytes, the maximum");
        for (limit, words) in [(1 << 10, "1 KiB"), (1 << 20, "1 MiB")] {
            assert_eq!(
                too_large(limit).to_string(),
                format!("is larger than {words}, the maximum")
            );
        }
        // A file whose stated length is 0.
        assert!(read_bytes(Path::new("/proc/self/status"), 16).is_err());
        assert!(!read_bytes(Path::new("/proc/self/status"), 1 << 20).unwrap().is_empty());
        std::fs::write(&file, [0xff]).unwrap();
        assert!(read_text(&file, 9).unwrap_err().to_string().contains("UTF-8"));
    }
}
