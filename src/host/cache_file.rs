//! Cache files: what one run computes and a later one reads back. A file is believed only if it is, to
//! the byte, what was written for the same key.
//!
//! A file is JSON: `{"checksum": "…", "content": …}`. The checksum is a BLAKE3 hash of the key and of the
//! content's bytes. The key identifies all that the content was computed from, so that a file that was
//! moved to another's place doesn't hold either. What doesn't hold is made anew, with a note, and ends no
//! command.
//!
//! Known limit: a checksum tells damage and edits, not a forger, who can compute it too.

use super::obstacle::remove_special;
use super::read::read_bytes;
use super::write::write_atomically;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{ErrorKind, Result};
use std::path::Path;

/// Largest file, bytes. Larger: what stands in a cache's place fills the memory. Smaller: the list of a
/// video of a hundred thousand frames is never read back.
const MAX_BYTES: u64 = 64 << 20;

const BEFORE_CHECKSUM: &str = "{\"checksum\": \"";
const BEFORE_CONTENT: &str = "\", \"content\":\n";
const AFTER_CONTENT: &str = "}\n";

fn checksum(key: &str, content: &[u8]) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(key.len() as u64).to_le_bytes());
    hasher.update(key.as_bytes());
    hasher.update(content);
    hasher.finalize().to_hex().to_string()
}

/// What a cache file holds for a key; `None` if there is no file, or if it doesn't hold, which `note`
/// is told in one sentence.
pub(crate) fn load<T: DeserializeOwned>(
    path: &Path,
    key: &str,
    note: impl FnOnce(&str),
) -> Option<T> {
    let value = match read_bytes(path, MAX_BYTES) {
        Err(error) if error.kind() == ErrorKind::NotFound => return None,
        Err(_) => None,
        Ok(bytes) => content(&bytes, key).and_then(|text| serde_json::from_slice(text).ok()),
    };
    if value.is_none() {
        note(&damaged(path));
    }
    value
}

/// The sentence of a cache that doesn't hold.
pub(crate) fn damaged(path: &Path) -> String {
    format!("{}: is damaged or of another version, and is made anew.", path.display())
}

/// The content's bytes, if they are those that were written for this key.
fn content<'a>(bytes: &'a [u8], key: &str) -> Option<&'a [u8]> {
    let rest = bytes.strip_prefix(BEFORE_CHECKSUM.as_bytes())?;
    let (said, rest) = rest.split_at_checked(2 * blake3::OUT_LEN)?;
    let content = rest.strip_prefix(BEFORE_CONTENT.as_bytes())?;
    let content = content.strip_suffix(AFTER_CONTENT.as_bytes())?;
    (said == checksum(key, content).as_bytes()).then_some(content)
}

/// Writes a value for a key, whole or not at all. A link, a pipe or a device in its place is replaced:
/// a cache's names are the program's own.
pub(crate) fn save(path: &Path, key: &str, value: &impl Serialize) -> Result<()> {
    let mut content = serde_json::to_string_pretty(value)?;
    content.push('\n');
    let checksum = checksum(key, content.as_bytes());
    let text =
        [BEFORE_CHECKSUM, &checksum, BEFORE_CONTENT, content.as_str(), AFTER_CONTENT].concat();
    remove_special(path)?;
    write_atomically(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    type Value = BTreeMap<String, f64>;

    fn loaded(path: &Path, key: &str) -> (Option<Value>, bool) {
        let mut noted = false;
        let value = load(path, key, |_| noted = true);
        (value, noted)
    }

    #[test]
    fn what_was_written_is_read_for_its_own_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        let value: Value = [("x".into(), 0.1), ("y".into(), 1e-300)].into();
        assert_eq!(loaded(&path, "k"), (None, false));
        save(&path, "k", &value).unwrap();
        assert_eq!(loaded(&path, "k"), (Some(value.clone()), false));
        assert_eq!(loaded(&path, "other"), (None, true));
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(json["content"]["x"], 0.1);
        std::fs::write(&path, serde_json::to_string(&value).unwrap()).unwrap();
        assert_eq!(loaded(&path, "k"), (None, true), "without a checksum");
    }

    #[test]
    fn every_changed_bit_and_every_length_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        save(&path, "k", &Value::from([("x".into(), 0.5)])).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << bit;
                assert!(content(&flipped, "k").is_none(), "byte {at}, bit {bit}");
            }
            assert!(content(&bytes[..at], "k").is_none(), "{at} bytes");
        }
        assert!(content(&bytes, "k").is_some());
    }

    #[test]
    fn what_is_no_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        for target in [Path::new("/dev/zero"), folder.path()] {
            std::os::unix::fs::symlink(target, &path).unwrap();
            assert_eq!(loaded(&path, "k"), (None, true));
            save(&path, "k", &Value::new()).unwrap();
            assert_eq!(loaded(&path, "k"), (Some(Value::new()), false));
            std::fs::remove_file(&path).unwrap();
        }
    }
}
