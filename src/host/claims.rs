//! Work items that several processes divide among themselves, so that each item is done once. The processes may run on
//! several machines, if they share a folder on a file system with file locks.
//!
//! Every item has a file in this folder. A process locks the file while it works on the item, and writes a mark into
//! the file when the item is finished. If the process ends before that, its lock ends too, and another process can take
//! the item.
//!
//! Known limit: on file systems whose locks have no effect on other machines, several machines may do the same item.

use super::files::{ignore_absent, read_text};
use super::temporary::{is_temporary, remove_abandoned};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Result, Write};
use std::path::{Path, PathBuf};

/// Content of the file of a finished work item. The file of an unfinished work item is empty.
const DONE: &str = "done\n";

/// A folder through which several processes divide work items among themselves. It has one file for each work item.
#[derive(Clone, Debug)]
pub struct Claims {
    folder: PathBuf,
}

/// A work item that this process has taken. If the claim is dropped without [`Self::finish`], other processes can take
/// the item.
#[derive(Debug)]
pub struct Claim {
    file: File,
}

/// Result of an attempt to take a work item.
#[derive(Debug)]
pub enum Taken {
    /// The item was free, and this process has taken it.
    Mine(Claim),
    /// Another process works on the item.
    Elsewhere,
    /// The item is finished, or the folder of work items has been removed.
    Done,
}

impl Claims {
    /// Opens the shared folder of work items, and creates it if it is missing.
    pub fn join(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Takes a work item, given by its index, if it is free. Otherwise, returns whether the item is finished or another
    /// process works on it.
    pub fn take(&self, item: usize) -> Result<Taken> {
        let path = self.folder.join(item.to_string());
        let opened =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let file = match opened {
            // The folder is missing if another process has found that all items are done, and has removed the folder.
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Taken::Done),
            opened => opened?,
        };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Ok(Taken::Elsewhere),
            Err(TryLockError::Error(error)) => return Err(error),
            Ok(()) => {}
        }
        let is_done = read_text(&path, DONE.len() as u64).is_ok_and(|text| text == DONE);
        Ok(if is_done { Taken::Done } else { Taken::Mine(Claim { file }) })
    }

    /// Removes the folder of work items, unless an item is finished or a process works on an item. To be called after
    /// the work has failed.
    pub fn end_unused(&self) -> Result<()> {
        for entry in std::fs::read_dir(&self.folder)? {
            let file = File::open(entry?.path())?;
            // After the removal, other processes get [`Taken::Done`] for every item. They do the items whose results
            // are missing without sharing them.
            if file.metadata()?.len() > 0 || file.try_lock().is_err() {
                return Ok(());
            }
        }
        self.end()
    }

    /// Removes the folder of work items, and the temporary files that killed processes left beside this folder. To be
    /// called after all items are finished.
    pub fn end(&self) -> Result<()> {
        let gone = self.folder.with_extension(format!("{}.tmp", std::process::id()));
        debug_assert!(gone.file_name().is_some_and(is_temporary));
        // The folder is renamed before it is removed. Other processes then see either all items done, or no folder.
        ignore_absent(std::fs::rename(&self.folder, &gone))?;
        ignore_absent(std::fs::remove_dir_all(&gone))?;
        // A process that was killed may have left temporary files beside the folder.
        let beside = self.folder.parent().filter(|parent| !parent.as_os_str().is_empty());
        remove_abandoned(beside.unwrap_or(Path::new(".")));
        Ok(())
    }
}

impl Claim {
    /// Marks the work item as finished, so that no process takes it again.
    pub fn finish(mut self) -> Result<()> {
        self.file.write_all(DONE.as_bytes())?;
        self.file.sync_all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mine(taken: Taken) -> Claim {
        match taken {
            Taken::Mine(claim) => claim,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_item_is_taken_once_and_free_after_a_failure() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join(".stlfr-render-1");
        let [a, b] = [0, 1].map(|_| Claims::join(&name).unwrap());
        let first = mine(a.take(0).unwrap());
        assert!(matches!(b.take(0).unwrap(), Taken::Elsewhere));
        drop(first);
        mine(b.take(0).unwrap()).finish().unwrap();
        assert!(matches!(a.take(0).unwrap(), Taken::Done));
        let second = mine(a.take(1).unwrap());
        second.finish().unwrap();
        b.end().unwrap();
        assert!(matches!(a.take(5).unwrap(), Taken::Done), "the folder is gone");
        a.end().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_is_removed_after_a_failure_only_if_nothing_in_it_counts() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join(".stlfr-render-1");
        let claims = Claims::join(&name).unwrap();
        let working = mine(claims.take(0).unwrap());
        claims.end_unused().unwrap();
        assert!(name.exists(), "a process works on an item");
        drop(working);
        claims.end_unused().unwrap();
        assert!(!name.exists());
        let claims = Claims::join(&name).unwrap();
        mine(claims.take(0).unwrap()).finish().unwrap();
        drop(mine(claims.take(1).unwrap()));
        claims.end_unused().unwrap();
        assert!(matches!(claims.take(0).unwrap(), Taken::Done));
    }

    #[test]
    fn threads_do_each_item_once() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join(".stlfr-render-1");
        let counts: Vec<usize> = std::thread::scope(|scope| {
            let work = || {
                let claims = Claims::join(&name).unwrap();
                let done = (0..200).filter(|item| match claims.take(*item).unwrap() {
                    Taken::Mine(claim) => claim.finish().is_ok(),
                    Taken::Elsewhere | Taken::Done => false,
                });
                done.count()
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(work)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert_eq!(counts.iter().sum::<usize>(), 200, "{counts:?}");
    }
}
