//! What is not finished yet: it lies in a temporary folder beside its place, and gets its name when it
//! is whole.
//!
//! A temporary folder is locked for as long as the process that made it lives, so that any later
//! process knows the ones that a killed process left, in whatever container or on whatever machine
//! it ran. They are removed by the next process that writes into the folder they lie in.
//!
//! Known limit: where the file system has no locks, folders of killed processes stay.

use super::obstacle::obstacle;
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{File, TryLockError};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

const PREFIX: &str = ".stlfr-";
const SUFFIX: &str = ".tmp";

/// How often a folder is emptied that a child process still writes into. Larger: an interrupted program
/// ends later. Smaller: the folder may stay.
const REMOVALS: usize = 100;

/// What this process has begun, and the folders that it has cleared of what others left.
struct Begun {
    folders: BTreeSet<PathBuf>,
    cleared: BTreeSet<PathBuf>,
}

static BEGUN: Mutex<Begun> =
    Mutex::new(Begun { folders: BTreeSet::new(), cleared: BTreeSet::new() });

/// Distinguishes the folders of one process.
static COUNT: AtomicU64 = AtomicU64::new(0);

fn begun() -> MutexGuard<'static, Begun> {
    // Sets of paths are whole at any time.
    BEGUN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary folder. Dropped, or when a signal ends the program, it is removed with all that is in it.
pub(crate) struct Temporary {
    path: PathBuf,
    /// Holds the lock.
    _lock: File,
}

impl Temporary {
    /// A temporary folder beside `target`, on the same disk; missing folders on the way are created. An
    /// error if something that is no regular file has the target's name.
    pub fn for_file(target: &Path) -> Result<Self> {
        if let Some(obstacle) = obstacle(target) {
            return Err(Error::new(ErrorKind::InvalidInput, obstacle));
        }
        if target.file_name().is_none() {
            return Err(Error::new(ErrorKind::InvalidInput, "names no file"));
        }
        Self::inside(parent(target))
    }

    /// A temporary folder inside `folder`, which is created if it is missing.
    pub fn inside(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        // The current folder may change; the folder's own path is what a signal removes.
        let folder = folder.canonicalize()?;
        if begun().cleared.insert(folder.clone()) {
            remove_abandoned(&folder);
        }
        loop {
            let number = COUNT.fetch_add(1, Ordering::Relaxed);
            let name = format!("{PREFIX}{}-{number}{SUFFIX}", std::process::id());
            let path = folder.join(name);
            // Under the mutex, so that a signal finds either no folder or one that is listed.
            let mut begun = begun();
            match std::fs::create_dir(&path) {
                Ok(()) => begun.folders.insert(path.clone()),
                // A process of that number in another container, or one that was killed.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(error),
            };
            match locked(&path) {
                Ok(Some(lock)) => return Ok(Self { path, _lock: lock }),
                // Another process has taken it for abandoned before it was locked.
                Ok(None) => begun.folders.remove(&path),
                Err(error) => {
                    remove(&path);
                    begun.folders.remove(&path);
                    return Err(error);
                }
            };
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves one of its files or folders to its place, once the disk has it. A file replaces a file, a
    /// folder an empty folder.
    pub fn place(&self, name: &str, target: &Path) -> Result<()> {
        let whole = self.path.join(name);
        File::open(&whole)?.sync_all()?;
        std::fs::rename(whole, target)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut begun = begun();
        remove(&self.path);
        begun.folders.remove(&self.path);
    }
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The lock of a folder that was just made; `None` if another process has it, or has removed the folder.
fn locked(path: &Path) -> Result<Option<File>> {
    let found = |error: Error| match error.kind() {
        ErrorKind::NotFound => Ok(None),
        _ => Err(error),
    };
    let folder = match File::open(path) {
        Ok(folder) => folder,
        Err(error) => return found(error),
    };
    if matches!(folder.try_lock(), Err(TryLockError::WouldBlock)) {
        return Ok(None);
    }
    match std::fs::metadata(path) {
        Ok(there) => Ok((there.ino() == folder.metadata()?.ino()).then_some(folder)),
        Err(error) => found(error),
    }
}

/// Removes a folder with all that is in it, also while a child process writes into it.
fn remove(path: &Path) {
    for _ in 0..REMOVALS {
        match std::fs::remove_dir_all(path) {
            Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => {}
            // Gone, or out of reach: then the next process that writes here removes it.
            _ => return,
        }
    }
}

/// Whether a file's name is that of a temporary folder.
pub(crate) fn is_temporary(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name.starts_with(PREFIX.as_bytes()) && name.ends_with(SUFFIX.as_bytes())
}

/// Removes the temporary folders in a folder whose processes live no more.
pub(crate) fn remove_abandoned(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|e| is_temporary(&e.file_name())) {
        let is_folder = entry.file_type().is_ok_and(|t| t.is_dir());
        let Some(folder) = is_folder.then(|| File::open(entry.path()).ok()).flatten() else {
            continue;
        };
        if folder.try_lock().is_ok() {
            remove(&entry.path());
        }
    }
}

/// Removes what this process has begun. Nothing can be begun or finished after it: the caller ends the
/// process.
pub(super) fn abandon() -> impl Sized {
    let begun = begun();
    begun.folders.iter().for_each(|path| remove(path));
    begun
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_dead_process_left_is_removed_and_what_a_living_one_has_stays() {
        let folder = tempfile::tempdir().unwrap();
        let left = folder.path().join(".stlfr-1-0.tmp");
        std::fs::create_dir(&left).unwrap();
        std::fs::write(left.join("half"), "").unwrap();
        let of_another = folder.path().join(".stlfr.tmp");
        std::fs::write(&of_another, "").unwrap();
        let mine = Temporary::inside(folder.path()).unwrap();
        assert!(!left.exists() && of_another.exists() && mine.path().is_dir());
        remove_abandoned(folder.path());
        assert!(mine.path().is_dir(), "it is locked");
        let path = mine.path().to_owned();
        drop(mine);
        assert!(!path.exists());
    }
}
