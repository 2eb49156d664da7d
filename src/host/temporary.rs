//! Atomic writing of files and folders: they are written into a temporary folder beside their target, and then renamed.
//!
//! A process holds a lock on each of its temporary folders. If the process is killed, its locks end, even if it ran in
//! another container or on another machine. The next process that writes into the same parent folder removes the
//! temporary folders without a lock. If a signal ends the program, the program first removes its own temporary folders
//! ([`remove_unfinished_on_signals`]).
//!
//! Known limit: on file systems without locks, the temporary folders of killed processes remain.

use super::files::obstacle;
use super::machine::lock;
use super::process;
use serde::Serialize;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::{File, TryLockError};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

const PREFIX: &str = ".stlfr-";
const SUFFIX: &str = ".tmp";

/// Maximum number of attempts to remove a folder while a child process still writes into it.
const REMOVALS: usize = 100;

/// Temporary folders that this process has created.
struct Begun {
    folders: BTreeSet<PathBuf>,
    /// Number of temporary folders created so far. It makes their names unique.
    count: u64,
    /// Parent folders from which this process has already removed the temporary folders that killed processes left.
    cleared: BTreeSet<PathBuf>,
}

static BEGUN: Mutex<Begun> =
    Mutex::new(Begun { folders: BTreeSet::new(), count: 0, cleared: BTreeSet::new() });

/// A temporary folder. It is removed with its contents when this value is dropped, or when a signal ends the program.
pub(crate) struct Temporary {
    path: PathBuf,
    /// Open handle of the folder, which holds the lock on it.
    _lock: File,
}

impl Temporary {
    /// Creates a temporary folder beside `target`, on the same disk. Missing parent folders are created.
    ///
    /// # Errors
    /// If `target` exists and isn't a regular file, or if the folder can't be created.
    pub fn for_file(target: &Path) -> Result<Self> {
        if let Some(obstacle) = obstacle(target) {
            return Err(Error::new(ErrorKind::InvalidInput, obstacle));
        }
        if target.file_name().is_none() {
            return Err(Error::new(ErrorKind::InvalidInput, "names no file"));
        }
        let parent = target.parent().filter(|parent| !parent.as_os_str().is_empty());
        Self::inside(parent.unwrap_or(Path::new(".")))
    }

    /// Creates a temporary folder inside `folder`. Creates `folder` too if it is missing.
    pub fn inside(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        // The path is absolute, so that the removal after a signal doesn't depend on the working directory.
        let folder = folder.canonicalize()?;
        if lock(&BEGUN).cleared.insert(folder.clone()) {
            remove_abandoned(&folder);
        }
        // The mutex is locked until the folder is in the list, so that a signal handler knows every temporary folder.
        let mut begun = lock(&BEGUN);
        loop {
            let name = format!("{PREFIX}{}-{}{SUFFIX}", std::process::id(), begun.count);
            begun.count += 1;
            let path = folder.join(name);
            match std::fs::create_dir(&path) {
                // A folder with this name exists. Its process has the same id in another container, or was killed.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                created => created?,
            }
            match locked(&path) {
                Ok(Some(lock)) => {
                    begun.folders.insert(path.clone());
                    return Ok(Self { path, _lock: lock });
                }
                // Another process took the new folder for abandoned before this process had locked it.
                Ok(None) => {}
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => {
                    remove(&path);
                    return Err(error);
                }
            }
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Flushes the file or folder `name` of this temporary folder to the disk, and renames it to `target`. A file may
    /// replace a file, and a folder may replace an empty folder.
    pub fn place(&self, name: &str, target: &Path) -> Result<()> {
        let whole = self.path.join(name);
        File::open(&whole)?.sync_all()?;
        std::fs::rename(whole, target)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut begun = lock(&BEGUN);
        remove(&self.path);
        begun.folders.remove(&self.path);
    }
}

/// Locks a temporary folder that was just created. Returns the folder's open handle, which holds the lock. `None` if
/// another process has already locked, or removed and created again, this folder.
fn locked(path: &Path) -> Result<Option<File>> {
    let folder = File::open(path)?;
    if matches!(folder.try_lock(), Err(TryLockError::WouldBlock)) {
        return Ok(None);
    }
    let is_own = std::fs::metadata(path)?.ino() == folder.metadata()?.ino();
    Ok(is_own.then_some(folder))
}

/// Removes a folder with its contents. Tries again, up to [`REMOVALS`] times, if a child process writes into the folder
/// meanwhile.
fn remove(path: &Path) {
    for _ in 0..REMOVALS {
        match std::fs::remove_dir_all(path) {
            Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => {}
            // The folder is removed, or can't be accessed. In the latter case, a later process removes it.
            _ => return,
        }
    }
}

/// Returns whether a file name has the form of a temporary folder's name.
pub(crate) fn is_temporary(name: &OsStr) -> bool {
    let name = name.as_encoded_bytes();
    name.starts_with(PREFIX.as_bytes()) && name.ends_with(SUFFIX.as_bytes())
}

/// Removes the temporary folders in `folder` on which no process holds a lock. Killed processes have left them.
pub(crate) fn remove_abandoned(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|e| is_temporary(&e.file_name())) {
        // Only folders are opened. Opening a pipe would wait for a writer.
        if entry.file_type().is_ok_and(|found| found.is_dir())
            && let Ok(folder) = File::open(entry.path())
            && folder.try_lock().is_ok()
        {
            remove(&entry.path());
        }
    }
}

/// Installs a handler for Ctrl-C, SIGTERM and SIGHUP. The handler ends child processes and removes unfinished files
/// before the signal ends the program. Signals that were ignored at the start of the process remain ignored.
///
/// For the main function of programs, not for libraries.
pub fn remove_unfinished_on_signals() -> Result<()> {
    let handled = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|&signal| !is_ignored(signal));
    let mut signals = Signals::new(handled)?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        if let Some(signal) = signals.forever().next() {
            // Child processes are ended first, because they write into the temporary folders.
            process::end_all();
            // While the mutex is locked, no temporary folder is created or removed.
            let begun = lock(&BEGUN);
            begun.folders.iter().for_each(|path| remove(path));
            // The signal's default action ends the process, so that the shell reports the signal.
            let _ = emulate_default_handler(signal);
        }
    })?;
    Ok(())
}

/// Returns whether a signal was ignored at the start of the process, as SIGHUP is under `nohup`.
fn is_ignored(signal: i32) -> bool {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::uninit();
    // SAFETY: without a new action, the call only writes the current action. If the call returns 0, the structure is
    // complete.
    unsafe {
        libc::sigaction(signal, std::ptr::null(), action.as_mut_ptr()) == 0
            && action.assume_init().sa_sigaction == libc::SIG_IGN
    }
}

const FILE: &str = "file";

/// Writes a file atomically, and creates missing parent folders. An existing regular file is replaced.
///
/// # Errors
/// If the file can't be written, or if a link, a folder or a device exists at `path`.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let temporary = Temporary::for_file(path)?;
    std::fs::write(temporary.path().join(FILE), bytes)?;
    temporary.place(FILE, path)
}

/// Writes a value atomically as indented JSON with a final line break.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    write_atomically(path, text.as_bytes())
}

/// Creates a folder if it is missing, and tests whether files can be created in it.
pub fn try_folder(folder: &Path) -> Result<()> {
    Temporary::inside(folder).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

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
