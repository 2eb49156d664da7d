//! What was read from files, without reading them again while none has changed.

use super::cache_file;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::Result;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A file that changed less than this before it is read may change again and have the same times: those of
/// FAT are even seconds. Larger: what was just filmed is read more often. Smaller: a change may go unseen.
const SETTLED: Duration = Duration::from_secs(3);

/// What tells that a file has changed, as Git's index has it: its file system and number, its size, and the times of
/// the last change of its content and of its entry. Where the file system keeps the latter, nobody sets it at will.
struct Traces {
    key: String,
    /// The latest of all times, nanoseconds since 1970.
    latest_ns: i128,
}

impl Traces {
    fn of<'a>(files: impl Iterator<Item = &'a Path>) -> Result<Self> {
        let mut hasher = blake3::Hasher::new();
        let mut latest_ns = i128::MIN;
        for file in files {
            let found = std::fs::metadata(file)?;
            for number in [found.dev(), found.ino(), found.size()] {
                hasher.update(&number.to_le_bytes());
            }
            let times = [found.mtime(), found.mtime_nsec(), found.ctime(), found.ctime_nsec()];
            for time in times.chunks_exact(2) {
                for number in time {
                    hasher.update(&number.to_le_bytes());
                }
                latest_ns =
                    latest_ns.max(1_000_000_000 * i128::from(time[0]) + i128::from(time[1]));
            }
        }
        Ok(Self { key: hasher.finalize().to_hex().to_string(), latest_ns })
    }

    /// Whether any later change will show.
    fn are_settled(&self, settled: Duration) -> bool {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.latest_ns < now.as_nanos() as i128 - settled.as_nanos() as i128
    }
}

/// What `read` finds in files: from the file `memory` if nothing has changed since it was written there, and written
/// there otherwise, where its folder exists. `made_for` says what is read, and by which version.
///
/// # Errors
/// Those of `read`. A memory that can't be read or written is no error.
pub(crate) fn remembered<'a, T: Serialize + DeserializeOwned, E>(
    memory: &Path,
    made_for: &str,
    files: impl Iterator<Item = &'a Path> + Clone,
    read: impl FnOnce() -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    remembered_after(SETTLED, memory, made_for, files, read)
}

fn remembered_after<'a, T: Serialize + DeserializeOwned, E>(
    settled: Duration,
    memory: &Path,
    made_for: &str,
    files: impl Iterator<Item = &'a Path> + Clone,
    read: impl FnOnce() -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    let traces = || Traces::of(files.clone()).ok();
    let key = |traces: &Traces| format!("{made_for} {}", traces.key);
    let Some(before) = traces().filter(|traces| traces.are_settled(settled)) else { return read() };
    if let Some(known) = cache_file::load(memory, &key(&before), |_| ()) {
        return Ok(known);
    }
    let found = read()?;
    // A file that changed meanwhile was perhaps read before.
    let is_unchanged = traces().is_some_and(|after| after.key == before.key);
    if is_unchanged && memory.parent().is_some_and(Path::is_dir) {
        let _ = cache_file::save(memory, &key(&before), &found);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::fs::{File, FileTimes};
    use std::path::PathBuf;

    /// Longer than a clock's tick.
    const SETTLED: Duration = Duration::from_millis(200);

    #[test]
    fn files_are_read_again_when_any_changed() {
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = ["a", "b"].map(|name| folder.path().join(name)).into();
        let memory = folder.path().join("memory.json");
        let reads = Cell::new(0);
        let found = |made_for: &str| {
            let read = || {
                reads.set(reads.get() + 1);
                files.iter().map(std::fs::read_to_string).collect::<Result<Vec<_>>>()
            };
            remembered_after(SETTLED, &memory, made_for, files.iter().map(PathBuf::as_path), read)
        };
        let write = |file: &Path, text: &str| std::fs::write(file, text).unwrap();
        let wait = || std::thread::sleep(2 * SETTLED);
        assert!(found("x").is_err());
        files.iter().for_each(|file| write(file, "1"));
        reads.set(0);
        // What was just written may be written again at the same time.
        for _ in 0..2 {
            found("x").unwrap();
        }
        assert!(reads.get() == 2 && !memory.exists());
        wait();
        for _ in 0..3 {
            assert_eq!(found("x").unwrap(), ["1", "1"]);
        }
        assert_eq!(reads.get(), 3);
        found("y").unwrap();
        assert_eq!(reads.get(), 4, "another version");
        // As many bytes, and the old time put back.
        let before = files[1].metadata().unwrap().modified().unwrap();
        write(&files[1], "2");
        let file = File::options().write(true).open(&files[1]).unwrap();
        file.set_times(FileTimes::new().set_modified(before)).unwrap();
        wait();
        assert_eq!(found("y").unwrap(), ["1", "2"]);
        assert_eq!(reads.get(), 5);
        found("y").unwrap();
        assert_eq!(reads.get(), 5);
        std::fs::write(&memory, "{}").unwrap();
        assert_eq!(found("y").unwrap(), ["1", "2"]);
        assert_eq!(reads.get(), 6, "damaged");
    }

    #[test]
    fn without_a_folder_nothing_is_remembered() {
        let folder = tempfile::tempdir().unwrap();
        let memory = folder.path().join("none/memory.json");
        let found: Result<u8> = remembered(&memory, "x", std::iter::empty(), || Ok(3));
        assert!(found.unwrap() == 3 && !folder.path().join("none").exists());
    }
}
