//! Hashes of files' content, read again only after a file has changed.

use super::disk_cache::{CacheKind, DiskCache};
use super::files::open_file;
use rayon::prelude::*;
use std::io::Result;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const HASHES: CacheKind = CacheKind { name: "hashes", version: 1 };

/// Age from which a file's times are relied on. A younger file may change again without a change of its times, whose
/// resolution is 2 s on FAT.
const SETTLED: Duration = Duration::from_millis(if cfg!(test) { 200 } else { 3000 });

/// Metadata that changes with a file's content, as in Git's index: device, inode, size, and the times of the last change
/// of content and of metadata.
type Trace = ([u64; 3], [i64; 4]);

fn trace(file: &Path) -> Result<Trace> {
    let found = std::fs::metadata(file)?;
    let times = [found.mtime(), found.mtime_nsec(), found.ctime(), found.ctime_nsec()];
    Ok(([found.dev(), found.ino(), found.size()], times))
}

/// Whether every later change of the file will change its trace.
fn is_settled((_, times): &Trace) -> bool {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let latest = now.as_nanos() as i128 - SETTLED.as_nanos() as i128;
    let (times, _) = times.as_chunks::<2>();
    times.iter().all(|[s, ns]| 1_000_000_000 * i128::from(*s) + i128::from(*ns) < latest)
}

/// The hash of every file's bytes: from the cache if no file has changed since it was read.
///
/// # Errors
/// The first file that can't be read, by its index.
pub(crate) fn file_hashes(
    cache: &DiskCache,
    files: &[&Path],
) -> std::result::Result<Vec<blake3::Hash>, (usize, std::io::Error)> {
    let traces = || files.iter().map(|file| trace(file)).collect::<Result<Vec<Trace>>>().ok();
    let before = traces().filter(|t| !t.is_empty() && t.iter().all(is_settled));
    if let Some(known) = before.as_ref().and_then(|traces| cache.load(HASHES, traces)) {
        let (hashes, _) = known.as_chunks();
        if hashes.len() == files.len() {
            return Ok(hashes.iter().copied().map(blake3::Hash::from_bytes).collect());
        }
    }
    let hash = |(k, file): (usize, &&Path)| {
        let mut hasher = blake3::Hasher::new();
        let read = open_file(file).and_then(|file| hasher.update_reader(file).map(drop));
        read.map(|()| hasher.finalize()).map_err(|error| (k, error))
    };
    // In order, so that the error is the first file's.
    let found: Vec<_> = files.par_iter().enumerate().map(hash).collect();
    let found: Vec<blake3::Hash> = found.into_iter().collect::<std::result::Result<_, _>>()?;
    // A file that changed meanwhile may have been read before the change.
    if let Some(before) = before.filter(|before| traces().as_ref() == Some(before)) {
        let bytes: Vec<u8> = found.iter().flat_map(|hash| *hash.as_bytes()).collect();
        // A read-only capture is read again next time.
        let _ = cache.save(HASHES, &before, &bytes);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, FileTimes};
    use std::path::PathBuf;

    #[test]
    fn files_are_read_again_when_any_changed() {
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = ["a", "b"].map(|name| folder.path().join(name)).into();
        let cache = DiskCache::new(folder.path(), |_| ());
        let paths: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
        let found = || file_hashes(&cache, &paths);
        let hashes = |texts: [&str; 2]| texts.map(|text| blake3::hash(text.as_bytes())).to_vec();
        let cached = || cache.listing().iter().map(|of| of.entries).sum::<usize>();
        let write = |file: &Path, text: &str| std::fs::write(file, text).unwrap();
        let wait = || std::thread::sleep(2 * SETTLED);
        assert_eq!(found().unwrap_err().0, 0);
        files.iter().for_each(|file| write(file, "1"));
        // What was just written may be written again at the same time.
        assert!(found().unwrap() == hashes(["1", "1"]) && cached() == 0);
        wait();
        for _ in 0..2 {
            assert!(found().unwrap() == hashes(["1", "1"]) && cached() == 1);
        }
        // What the cache says is believed.
        let traces: Vec<Trace> = files.iter().map(|file| trace(file).unwrap()).collect();
        let said = hashes(["x", "y"]);
        let bytes: Vec<u8> = said.iter().flat_map(|hash| *hash.as_bytes()).collect();
        cache.save(HASHES, &traces, &bytes).unwrap();
        assert_eq!(found().unwrap(), said);
        cache.save(HASHES, &traces, &bytes[1..]).unwrap();
        assert_eq!(found().unwrap(), hashes(["1", "1"]), "too few");
        // As many bytes, and the old time put back.
        let before = files[1].metadata().unwrap().modified().unwrap();
        write(&files[1], "2");
        let file = File::options().write(true).open(&files[1]).unwrap();
        file.set_times(FileTimes::new().set_modified(before)).unwrap();
        wait();
        assert_eq!(found().unwrap(), hashes(["1", "2"]));
        assert_eq!(cached(), 2);
    }
}
