//! Files that are written whole or not at all.

use super::temporary::Temporary;
use serde::Serialize;
use std::io::Result;
use std::path::Path;

const FILE: &str = "file";

/// Writes a whole file or none: in a temporary folder beside it, then renamed. Missing folders on the
/// way are created. Only a regular file is replaced; a link, a folder or a device of that name is an
/// error.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let temporary = Temporary::for_file(path)?;
    std::fs::write(temporary.path().join(FILE), bytes)?;
    temporary.place(FILE, path)
}

/// Writes a value as an indented JSON file that ends with a line break, whole or not at all.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    write_atomically(path, text.as_bytes())
}

/// An error if nothing can be written into a folder, which must exist.
pub fn try_folder(folder: &Path) -> Result<()> {
    Temporary::inside(folder).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn only_a_regular_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, dangling, socket] =
            ["file", "link", "dangling", "socket"].map(|name| folder.path().join(name));
        write_atomically(&file, b"first").unwrap();
        write_atomically(&file, b"second").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"second");
        symlink(&file, &link).unwrap();
        symlink("nowhere", &dangling).unwrap();
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for (path, words) in [
            (link.as_path(), "a link"),
            (&dangling, "a link"),
            (&socket, "a socket"),
            (folder.path(), "a folder"),
            (Path::new("/dev/null"), "a device"),
        ] {
            let message = write_atomically(path, b"third").unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
        assert_eq!(std::fs::read(&file).unwrap(), b"second");
        assert!(!Path::new("/dev/null").symlink_metadata().unwrap().is_file());
    }

    #[test]
    fn the_longest_name_is_no_longer_while_it_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n".repeat(255));
        write_atomically(&path, b"whole").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
