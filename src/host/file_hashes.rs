//! Content hashes of sets of files. The hashes are cached on disk, and are computed again only after a file of the set
//! has changed.

use super::disk_cache::{CacheKind, DiskCache};
use super::files::{FileRead, FileState, open_file};
use rayon::prelude::*;
use std::fs::File;
use std::io::{Error, Result, Seek};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const HASHES: CacheKind = CacheKind { name: "hashes", version: 2 };

/// Time after a file's last change from which every further change also changes the file's recorded times. Earlier, a
/// further change may leave the times equal, because their resolution is up to 2 s (on the file system FAT).
const SETTLED: Duration = Duration::from_millis(if cfg!(test) { 200 } else { 3000 });

/// Returns whether a file has been unchanged for longer than [`SETTLED`]. If so, every later change of the file also
/// changes its [`FileState`].
fn is_settled(state: &FileState) -> bool {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let latest = now.as_nanos() as i128 - SETTLED.as_nanos() as i128;
    let [s, ns] = state.changed();
    1_000_000_000 * i128::from(s) + i128::from(ns) < latest
}

/// Returns the hash of all bytes of an open file, and the file's state. The state is `None` if the file changed while
/// it was read.
fn hash_open(mut file: &File) -> Result<(blake3::Hash, Option<FileState>)> {
    file.rewind()?;
    let before = FileState::of(&file.metadata()?);
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file)?;
    let after = FileState::of(&file.metadata()?);
    Ok((hasher.finalize(), Some(after).filter(|after| *after == before)))
}

/// Returns the hash of a file's bytes.
pub(crate) fn file_hash(path: &Path) -> Result<blake3::Hash> {
    Ok(hash_open(&open_file(path)?)?.0)
}

/// A file that this process holds open while another program reads it. The file must not change until the other program
/// has read it, which [`Self::is_unchanged`] checks.
pub(crate) struct HeldFile {
    pub file: File,
    read: FileRead,
}

impl HeldFile {
    /// Opens a file, and compares the hash of its bytes with `hash`. `None` if the hashes differ, or if the file
    /// changed while it was read.
    pub fn open(path: &Path, hash: blake3::Hash) -> Result<Option<Self>> {
        let file = open_file(path)?;
        let (found, state) = hash_open(&file)?;
        let is_same = |state: FileState| (found == hash).then_some(FileRead { hash, state });
        Ok(state.and_then(is_same).map(|read| Self { file, read }))
    }

    /// Hashes the file again, and returns whether the file has not changed since it was opened.
    pub fn is_unchanged(&self) -> Result<bool> {
        let (hash, state) = hash_open(&self.file)?;
        Ok(hash == self.read.hash && state == Some(self.read.state))
    }
}

/// Returns the hash and the state of every file. The hashes come from the cache if no file has changed since they were
/// cached.
///
/// # Errors
/// The error of the first file that can't be read, in the order of `files`, with the file's index.
pub(crate) fn file_hashes(
    cache: &DiskCache,
    files: &[&Path],
) -> std::result::Result<Vec<FileRead>, (usize, std::io::Error)> {
    let state = |file: &&Path| Ok(FileState::of(&std::fs::metadata(file)?));
    let before = files.iter().map(state).collect::<Result<Vec<FileState>>>().ok();
    let before = before.filter(|states| !states.is_empty() && states.iter().all(is_settled));
    if let Some((states, known)) =
        before.as_ref().and_then(|states| Some((states, cache.load(HASHES, states)?)))
    {
        let (hashes, _) = known.as_chunks();
        if hashes.len() == files.len() {
            let hashes = hashes.iter().copied().map(blake3::Hash::from_bytes);
            return Ok(hashes.zip(states).map(|(hash, &state)| FileRead { hash, state }).collect());
        }
    }
    let hash = |(k, file): (usize, &&Path)| {
        let read = open_file(file).and_then(|file| {
            let (hash, unchanged) = hash_open(&file)?;
            let state =
                unchanged.map_or_else(|| Ok(FileState::of(&file.metadata()?)), Ok::<_, Error>)?;
            Ok((FileRead { hash, state }, unchanged))
        });
        read.map_err(|error| (k, error))
    };
    // The results are in the order of the files, so that the returned error is that of the first file that failed.
    let found: Vec<_> = files.par_iter().enumerate().map(hash).collect();
    let found = found.into_iter().collect::<std::result::Result<Vec<_>, _>>()?;
    let (found, unchanged): (Vec<FileRead>, Vec<Option<FileState>>) = found.into_iter().unzip();
    // Hashes are stored only if every file had the same state before, while and after it was read.
    if let Some(before) = before.filter(|before| before.iter().copied().map(Some).eq(unchanged)) {
        let bytes: Vec<u8> = found.iter().flat_map(|read| *read.hash.as_bytes()).collect();
        // If the capture is read-only, the files are hashed again next time.
        let _ = cache.save(HASHES, &before, &bytes);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::FileTimes;
    use std::path::PathBuf;

    #[test]
    fn files_are_read_again_when_any_changed() {
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = ["a", "b"].map(|name| folder.path().join(name)).into();
        let cache = DiskCache::new(folder.path(), |_| ());
        let paths: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
        let found = || {
            let found = file_hashes(&cache, &paths);
            found.map(|read| read.iter().map(|read| read.hash).collect::<Vec<_>>())
        };
        let hashes = |texts: [&str; 2]| texts.map(|text| blake3::hash(text.as_bytes())).to_vec();
        let cached = || cache.listing().iter().map(|of| of.entries).sum::<usize>();
        let write = |file: &Path, text: &str| std::fs::write(file, text).unwrap();
        let wait = || std::thread::sleep(2 * SETTLED);
        assert_eq!(found().unwrap_err().0, 0);
        files.iter().for_each(|file| write(file, "1"));
        // The files were just written. They may change again within the resolution of their times, and are therefore
        // not cached.
        assert!(found().unwrap() == hashes(["1", "1"]) && cached() == 0);
        wait();
        for _ in 0..2 {
            assert!(found().unwrap() == hashes(["1", "1"]) && cached() == 1);
        }
        // A cached hash is returned without reading the file.
        let state = |file: &PathBuf| FileState::of(&file.metadata().unwrap());
        let states: Vec<FileState> = files.iter().map(state).collect();
        let said = hashes(["x", "y"]);
        let bytes: Vec<u8> = said.iter().flat_map(|hash| *hash.as_bytes()).collect();
        cache.save(HASHES, &states, &bytes).unwrap();
        assert_eq!(found().unwrap(), said);
        cache.save(HASHES, &states, &bytes[1..]).unwrap();
        assert_eq!(found().unwrap(), hashes(["1", "1"]), "too few");
        // The file gets new bytes of the same size, and its old modification time.
        let before = files[1].metadata().unwrap().modified().unwrap();
        write(&files[1], "2");
        let file = File::options().write(true).open(&files[1]).unwrap();
        file.set_times(FileTimes::new().set_modified(before)).unwrap();
        wait();
        assert_eq!(found().unwrap(), hashes(["1", "2"]));
        assert_eq!(cached(), 2);
    }
}
