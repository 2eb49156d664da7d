//! A capture's cache on disk, in `CAPTURE/.stlfr/cache/`, for results that take long to compute.
//!
//! A cached result, called *entry*, is a file `KIND/KEY`. KEY is a BLAKE3 hash of the program's version, the kind's
//! name and version, the capture's content, and the serialized inputs of the computation. The file starts with a
//! checksum of the result, which also depends on KEY. The bytes of the result follow. The file is written under a
//! temporary name and then renamed. A damaged file is reported in a note, and treated as absent.
//!
//! Additional files of an entry, such as the frames of a decoded video, are in the folder `KIND/KEY.files`.
//!
//! All entries together take at most [`MAX_BYTES`]; the least recently used entries are removed first. If a folder on
//! the path from the capture to the entries is a symbolic link, the cache is not used. The cache may be deleted at any
//! time.
//!
//! Known limits: the checksum detects damage, but no forgery. Entries that were used within the last [`RECENT`] are not
//! removed, so that the cache may temporarily exceed its maximum size.

use super::files::{ignore_absent, link_within, read_bytes, remove_special};
use super::machine::lock;
use super::temporary::{remove_abandoned, write_atomically};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Result};
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

/// Path of the cache's folder, relative to the capture's folder.
const FOLDER: &str = ".stlfr/cache";

/// Maximum size of all entries of a capture's cache together, bytes. Decoded videos are included.
const MAX_BYTES: u64 = 32 << 30;

/// Maximum size of a cache entry's file, bytes. A larger file is treated as damaged.
const MAX_ENTRY_BYTES: u64 = 64 << 20;

/// Size of the checksum at the start of a cache entry's file, bytes.
pub(crate) const ENTRY_OVERHEAD_BYTES: u64 = blake3::OUT_LEN as u64;

/// Time for which a cache entry is not removed after its last use. Times of use are recorded with this precision.
const RECENT: Duration = Duration::from_secs(3600);

/// Number of hexadecimal digits of a cache entry's key that its file name contains.
const KEY_DIGITS: usize = 32;

/// Extension of the folder for the additional files of a cache entry, such as the frames of a decoded video.
const FILES_EXTENSION: &str = "files";

/// A kind of cached results, such as plans. The entries of one kind are listed and deleted together.
#[derive(Clone, Copy, Debug)]
pub struct CacheKind {
    /// Name of the kind, and of the folder with its entries.
    pub name: &'static str,
    /// Version of this kind of results. It is part of every entry's key. It must be incremented when equal inputs give
    /// other results, or when the format of the results changes.
    pub version: u32,
}

/// Number of cached entries of one kind, and their size on disk.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheUse {
    /// Name of the kind of results, such as `plans`.
    pub kind: String,
    /// Number of entries.
    pub entries: usize,
    /// Size of all entries with their additional files, bytes.
    pub bytes: u64,
}

/// The disk cache of one capture. Clones of this value share the cache's state.
#[derive(Clone)]
pub struct DiskCache {
    capture: PathBuf,
    content: String,
    shared: Arc<Shared>,
}

/// State that all clones of a [`DiskCache`] share.
struct Shared {
    max_bytes: u64,
    note: Box<dyn Fn(&str) + Send + Sync>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Names of the kinds of results for which this process has removed the temporary files that killed processes left.
    cleared: BTreeSet<&'static str>,
    /// Paths of damaged cache entries that have already been reported in a note.
    noted: BTreeSet<PathBuf>,
    /// Paths of cache entries that this process uses, and therefore does not remove.
    pinned: BTreeSet<PathBuf>,
    /// Size of all cache entries together, bytes. `None` if they have not been counted yet.
    bytes: Option<u64>,
    /// Limit of the size of all cache entries together, bytes. If it is exceeded, entries are removed.
    limit: u64,
}

/// A cache entry found on disk. Its size includes its additional files.
struct Found {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl DiskCache {
    /// Opens the disk cache of the capture in the folder `capture`. Keys of entries don't depend on the capture's
    /// content, unless [`Self::for_content`] is called. `note` receives a sentence for each damaged entry.
    pub fn new(capture: &Path, note: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self::bounded(capture, MAX_BYTES, note)
    }

    fn bounded(
        capture: &Path,
        max_bytes: u64,
        note: impl Fn(&str) + Send + Sync + 'static,
    ) -> Self {
        let state = Mutex::new(State { limit: max_bytes, ..State::default() });
        let shared = Arc::new(Shared { max_bytes, note: Box::new(note), state });
        Self { capture: capture.to_owned(), content: String::new(), shared }
    }

    /// Returns the same cache with keys that depend on the capture's content. `content` is a hash of this content.
    pub fn for_content(&self, content: &str) -> Self {
        Self { content: content.to_owned(), ..self.clone() }
    }

    /// Returns the key of a cache entry, from the kind of the result and the inputs of its computation.
    ///
    /// # Errors
    /// If the inputs can't be serialized as JSON.
    pub(crate) fn key(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<blake3::Hash> {
        let mut hasher = blake3::Hasher::new();
        let all = (env!("CARGO_PKG_VERSION"), kind.name, kind.version, &self.content, inputs);
        serde_json::to_writer(&mut hasher, &all)?;
        Ok(hasher.finalize())
    }

    fn folder(&self) -> PathBuf {
        self.capture.join(FOLDER)
    }

    /// Returns the innermost symbolic link on the path from the capture's folder to the folder of this kind of results.
    /// `None` if there is no link. If there is a link, results of this kind are not cached.
    pub fn link(&self, kind: CacheKind) -> Option<PathBuf> {
        link_within(&self.capture, &self.folder().join(kind.name))
    }

    /// Returns the path and the key of a cache entry. The first call for a kind of results also removes the temporary
    /// files that killed processes left in its folder.
    fn entry(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<(PathBuf, blake3::Hash)> {
        if let Some(link) = self.link(kind) {
            return Err(Error::other(format!("{} is a link", link.display())));
        }
        let folder = self.folder().join(kind.name);
        if lock(&self.shared.state).cleared.insert(kind.name) {
            remove_abandoned(&folder);
        }
        let key = self.key(kind, inputs)?;
        Ok((folder.join(&key.to_hex()[..KEY_DIGITS]), key))
    }

    /// Returns the path of a cache entry's file.
    ///
    /// # Errors
    /// If a folder on the path from the capture to the entry is a symbolic link.
    pub fn path(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<PathBuf> {
        Ok(self.entry(kind, inputs)?.0)
    }

    /// Returns the path of the folder for the additional files of a cache entry. The caller must create this folder
    /// before it saves the entry. The caller must also check these files, because the cache doesn't.
    ///
    /// # Errors
    /// The errors of [`Self::path`].
    pub fn files(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<PathBuf> {
        Ok(self.path(kind, inputs)?.with_extension(FILES_EXTENSION))
    }

    /// Removes a cache entry and its additional files, if they exist.
    ///
    /// # Errors
    /// If they can't be removed, or if a folder on the path from the capture to the entry is a symbolic link.
    pub fn remove(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<()> {
        remove(&self.path(kind, inputs)?)
    }

    /// Returns the bytes of a cache entry. `None` if the entry is absent or damaged.
    pub fn load(&self, kind: CacheKind, inputs: &impl Serialize) -> Option<Vec<u8>> {
        let (path, key) = self.entry(kind, inputs).ok()?;
        let found = path.symlink_metadata().ok()?;
        let content = found.is_file().then(|| unsealed(&path, &key)).flatten();
        match content {
            Some(_) => self.mark_used(&path, &found),
            None => self.note_damage(&path),
        }
        content
    }

    /// Writes the bytes of a cache entry. Returns the size of the entry's file in bytes.
    ///
    /// # Errors
    /// If the entry can't be written. Callers continue without the cache, because a capture may be read-only.
    pub fn save(&self, kind: CacheKind, inputs: &impl Serialize, content: &[u8]) -> Result<u64> {
        let (path, key) = self.entry(kind, inputs)?;
        let bytes = [checksum(&key, content).as_bytes(), content].concat();
        remove_special(&path)?;
        write_atomically(&path, &bytes)?;
        let size = bytes.len() as u64;
        self.add(size + folder_bytes(&path.with_extension(FILES_EXTENSION)));
        Ok(size)
    }

    /// Returns the value of a cache entry that was saved as JSON. `None` if the entry is absent or damaged.
    pub fn load_json<T: DeserializeOwned>(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
    ) -> Option<T> {
        let value = serde_json::from_slice(&self.load(kind, inputs)?).ok();
        if value.is_none() {
            self.note_damage(&self.path(kind, inputs).ok()?);
        }
        value
    }

    /// Writes a value as indented JSON into a cache entry. Returns the size of the entry's file in bytes.
    ///
    /// # Errors
    /// The errors of [`Self::save`].
    pub fn save_json(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
        value: &impl Serialize,
    ) -> Result<u64> {
        let mut content = serde_json::to_vec_pretty(value)?;
        content.push(b'\n');
        self.save(kind, inputs, &content)
    }

    /// Reports in a note that a cache entry is damaged, once for each path.
    pub fn note_damage(&self, path: &Path) {
        if lock(&self.shared.state).noted.insert(path.to_owned()) {
            let path = path.display();
            (self.shared.note)(&format!(
                "{path}: is damaged or of another version, and is made anew."
            ));
        }
    }

    /// Marks a cache entry as used by this process, so that this process doesn't remove the entry. `path` is the path
    /// of the entry's file.
    pub fn pin(&self, path: &Path) {
        lock(&self.shared.state).pinned.insert(path.to_owned());
    }

    /// Records the current time as the time of a cache entry's last use, which is the modification time of the entry's
    /// file. `found` is the metadata of this file. A recorded time within the last [`RECENT`] is left unchanged.
    fn mark_used(&self, path: &Path, found: &Metadata) {
        let now = SystemTime::now();
        let is_recent = |t| now.duration_since(t).is_ok_and(|age| age < RECENT);
        if !found.modified().is_ok_and(is_recent) {
            // In a read-only capture, the time can't be changed.
            let _ = File::open(path).and_then(|file| file.set_modified(now));
        }
    }

    /// Adds the size of a new cache entry to the total size. If the total exceeds the limit, removes entries.
    fn add(&self, bytes: u64) {
        let mut state = lock(&self.shared.state);
        let all = || self.found().values().flatten().map(|entry| entry.bytes).sum();
        let mut total = state.bytes.map_or_else(all, |total| total + bytes);
        if total > state.limit {
            total = self.shrink(&state.pinned);
            // Entries in use are not removed, so that the total may still be too large. The limit is then raised,
            // because another search is worthwhile only after the total has grown.
            let max_bytes = self.shared.max_bytes;
            state.limit = max_bytes.max(total + max_bytes / 16);
        }
        state.bytes = Some(total);
    }

    /// Removes the least recently used cache entries until the remaining ones fit into the maximum size. Entries that
    /// were used within the last [`RECENT`], and entries with paths in `pinned`, are not removed. Returns the size of
    /// the remaining entries, bytes.
    fn shrink(&self, pinned: &BTreeSet<PathBuf>) -> u64 {
        let mut entries: Vec<Found> = self.found().into_values().flatten().collect();
        entries.sort_by_key(|entry| entry.used);
        let now = SystemTime::now();
        let mut left: u64 = entries.iter().map(|entry| entry.bytes).sum();
        for entry in entries {
            let age = now.duration_since(entry.used).unwrap_or_default();
            if left <= self.shared.max_bytes || age < RECENT {
                break;
            }
            if !pinned.contains(&entry.path) && remove(&entry.path).is_ok() {
                left -= entry.bytes;
            }
        }
        left
    }

    /// Returns whether the cache may have entries of this kind. It has none if the folder of the kind is missing, or is
    /// reached through a symbolic link.
    pub fn has(&self, kind: CacheKind) -> bool {
        self.link(kind).is_none() && self.folder().join(kind.name).is_dir()
    }

    /// Returns all cache entries on disk, grouped by the names of their kinds.
    fn found(&self) -> BTreeMap<String, Vec<Found>> {
        let folder = self.folder();
        if link_within(&self.capture, &folder).is_some() {
            return BTreeMap::new();
        }
        let is_folder = |entry: &std::fs::DirEntry| entry.file_type().is_ok_and(|t| t.is_dir());
        let kinds = std::fs::read_dir(folder).into_iter().flatten().flatten().filter(is_folder);
        let of_kind = |kind: std::fs::DirEntry| {
            let name = kind.file_name().into_string().ok()?;
            let entries = entries(&kind.path());
            (!name.starts_with('.') && !entries.is_empty()).then_some((name, entries))
        };
        kinds.filter_map(of_kind).collect()
    }

    /// Returns the number and the size of the cache entries of each kind.
    pub fn listing(&self) -> Vec<CacheUse> {
        let of_kind = |(kind, found): (String, Vec<Found>)| CacheUse {
            kind,
            entries: found.len(),
            bytes: found.iter().map(|entry| entry.bytes).sum(),
        };
        self.found().into_iter().map(of_kind).collect()
    }

    /// Deletes the cache entries of one kind; of all kinds if `kind` is `None`. Returns the number and the size of the
    /// deleted entries.
    ///
    /// # Errors
    /// If the entries can't be deleted, if `kind` is no folder name, or if a folder on the path from the capture to the
    /// entries is a symbolic link.
    pub fn delete(&self, kind: Option<&str>) -> Result<CacheUse> {
        let folder = kind.map_or(self.folder(), |kind| self.folder().join(kind));
        if kind.is_some_and(|kind| !is_name(kind)) {
            return Err(Error::new(ErrorKind::InvalidInput, "is no kind of entries"));
        }
        if let Some(link) = link_within(&self.capture, &folder) {
            return Err(Error::other(format!("{} is a link", link.display())));
        }
        let mut deleted = CacheUse { kind: kind.unwrap_or_default().into(), ..CacheUse::default() };
        for found in self.listing().iter().filter(|found| kind.is_none_or(|k| k == found.kind)) {
            deleted.entries += found.entries;
            deleted.bytes += found.bytes;
        }
        lock(&self.shared.state).bytes = None;
        ignore_absent(std::fs::remove_dir_all(&folder))?;
        Ok(deleted)
    }
}

impl std::fmt::Debug for DiskCache {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "DiskCache({:?}, {:?})", self.capture, self.content)
    }
}

fn checksum(key: &blake3::Hash, content: &[u8]) -> blake3::Hash {
    blake3::keyed_hash(key.as_bytes(), content)
}

/// Reads a cache entry's file, and returns the bytes after the checksum. `None` if the file can't be read, or if its
/// checksum is wrong for the key and these bytes.
fn unsealed(path: &Path, key: &blake3::Hash) -> Option<Vec<u8>> {
    let mut bytes = read_bytes(path, MAX_ENTRY_BYTES).ok()?;
    let (found, content) = bytes.split_first_chunk::<{ blake3::OUT_LEN }>()?;
    (*found == *checksum(key, content).as_bytes()).then(|| bytes.split_off(blake3::OUT_LEN))
}

/// Returns whether a text is a file name without a path.
fn is_name(text: &str) -> bool {
    matches!(Path::new(text).components().collect::<Vec<_>>()[..], [Component::Normal(name)] if name == text)
}

fn folder_bytes(folder: &Path) -> u64 {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    files.filter_map(|file| file.metadata().ok()).map(|found| found.len()).sum()
}

/// Returns the cache entries in `folder`, which holds one kind of results. A folder of additional files without an
/// entry's file counts as an entry.
fn entries(folder: &Path) -> Vec<Found> {
    let mut found: BTreeMap<PathBuf, Found> = BTreeMap::new();
    for item in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, Ok(metadata)) = (item.path(), item.metadata()) else { continue };
        let stem = path.file_stem().unwrap_or_default().as_encoded_bytes();
        if stem.len() != KEY_DIGITS || !stem.iter().all(u8::is_ascii_hexdigit) {
            continue;
        }
        let bytes = match path.extension().map(|e| e == FILES_EXTENSION) {
            None if metadata.is_file() => metadata.len(),
            Some(true) if metadata.is_dir() => folder_bytes(&path),
            _ => continue,
        };
        let path = path.with_extension("");
        let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        let entry = found.entry(path.clone()).or_insert(Found { path, bytes: 0, used });
        entry.bytes += bytes;
        entry.used = entry.used.max(used);
    }
    found.into_values().collect()
}

/// Removes a cache entry: its file, and then the folder of its additional files. `path` is the path of the entry's
/// file. Files that don't exist are no error.
fn remove(path: &Path) -> Result<()> {
    ignore_absent(std::fs::remove_file(path))?;
    let files = path.with_extension(FILES_EXTENSION);
    ignore_absent(match files.symlink_metadata() {
        Ok(found) if !found.is_dir() => std::fs::remove_file(files),
        _ => std::fs::remove_dir_all(files),
    })
}

#[cfg(test)]
mod tests;
