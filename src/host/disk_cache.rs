//! A capture's cache on disk, in `CAPTURE/.stlfr/cache/`: results that take long to compute.
//!
//! An entry is a file `KIND/KEY`. KEY is a BLAKE3 hash of the program's version, the kind and its version, the
//! capture's content, and the serialized inputs of the computation. The file starts with a checksum, keyed with KEY;
//! the bytes of the result follow. It is written to a temporary file and renamed. A damaged file is noted, and treated
//! as absent.
//!
//! Files that belong to an entry, such as the frames of a decoded video, lie beside it in the folder `KIND/KEY.files`.
//!
//! All entries together take at most [`MAX_BYTES`]; the least recently used are removed first. The cache is never
//! accessed through a link inside of the capture. It may be deleted at any time.
//!
//! Known limits: the checksum detects damage, but no forgery. Entries that were used within [`RECENT`] are not
//! removed, so that the cache may temporarily exceed its bound.

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

/// The cache's folder inside a capture.
const FOLDER: &str = ".stlfr/cache";

/// Largest size of all entries of a capture, bytes, decoded videos included.
const MAX_BYTES: u64 = 32 << 30;

/// Size limit of an entry that is read, bytes.
const MAX_ENTRY_BYTES: u64 = 64 << 20;

/// Size of an entry's file minus the size of its content, bytes: the checksum.
pub(crate) const ENTRY_OVERHEAD_BYTES: u64 = blake3::OUT_LEN as u64;

/// An entry that was used within this time is not removed. The time of use is recorded with this precision.
const RECENT: Duration = Duration::from_secs(3600);

/// Number of hexadecimal digits of KEY in file names.
const KEY_DIGITS: usize = 32;

/// Extension of the folder with the files of an entry.
const FILES_EXTENSION: &str = "files";

/// A kind of cached results, listed and deleted together.
#[derive(Clone, Copy, Debug)]
pub struct CacheKind {
    /// Name of the kind's folder.
    pub name: &'static str,
    /// Version, a part of the key. It is incremented when equal inputs give other results, or when the results' format
    /// changes.
    pub version: u32,
}

/// Number of a kind's entries, and their size on disk.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheUse {
    pub kind: String,
    pub entries: usize,
    pub bytes: u64,
}

/// The disk cache of one capture. Clones share their state.
#[derive(Clone)]
pub struct DiskCache {
    capture: PathBuf,
    content: String,
    shared: Arc<Shared>,
}

/// State that all clones of a cache share.
struct Shared {
    max_bytes: u64,
    note: Box<dyn Fn(&str) + Send + Sync>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Kinds whose folders were cleared of the temporary files of killed processes.
    cleared: BTreeSet<&'static str>,
    /// Damaged entries that were noted already.
    noted: BTreeSet<PathBuf>,
    /// Entries whose files this process uses. They are not removed.
    pinned: BTreeSet<PathBuf>,
    /// Size of all entries, bytes; `None` before they are counted.
    bytes: Option<u64>,
    /// Size of all entries, bytes, above which entries are removed.
    limit: u64,
}

/// An entry on disk, with its files.
struct Found {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

impl DiskCache {
    /// Opens the disk cache of the capture in a folder. Keys don't depend on the capture's content; for this, see
    /// [`Self::for_content`]. `note` receives a sentence for each damaged entry.
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

    /// The same cache, with keys that depend on the capture's content. `content` is the content's hash.
    pub fn for_content(&self, content: &str) -> Self {
        Self { content: content.to_owned(), ..self.clone() }
    }

    /// The key of an entry, from its kind and inputs.
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

    /// The symbolic link on the way to a kind's entries, inside of the capture; `None` if there is none. The cache is
    /// not accessed through it.
    pub fn link(&self, kind: CacheKind) -> Option<PathBuf> {
        link_within(&self.capture, &self.folder().join(kind.name))
    }

    /// The path and the key of an entry.
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

    /// The path of an entry's file.
    ///
    /// # Errors
    /// If a link is on the path to the cache.
    pub fn path(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<PathBuf> {
        Ok(self.entry(kind, inputs)?.0)
    }

    /// The folder for the files of an entry. The caller creates it before it saves the entry, and checks the files in
    /// it.
    ///
    /// # Errors
    /// As [`Self::path`].
    pub fn files(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<PathBuf> {
        Ok(self.path(kind, inputs)?.with_extension(FILES_EXTENSION))
    }

    /// Removes an entry and its files, if they exist.
    ///
    /// # Errors
    /// If they can't be removed, or a link is on the path to the cache.
    pub fn remove(&self, kind: CacheKind, inputs: &impl Serialize) -> Result<()> {
        remove(&self.path(kind, inputs)?)
    }

    /// The bytes of an entry; `None` if it is absent or damaged.
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

    /// Writes the bytes of an entry; returns the file's size.
    ///
    /// # Errors
    /// If the entry can't be written. Callers continue without it, because a capture may be read-only.
    pub fn save(&self, kind: CacheKind, inputs: &impl Serialize, content: &[u8]) -> Result<u64> {
        let (path, key) = self.entry(kind, inputs)?;
        let bytes = [checksum(&key, content).as_bytes(), content].concat();
        remove_special(&path)?;
        write_atomically(&path, &bytes)?;
        let size = bytes.len() as u64;
        self.add(size + folder_bytes(&path.with_extension(FILES_EXTENSION)));
        Ok(size)
    }

    /// The value of an entry that was saved as JSON; `None` if it is absent or damaged.
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

    /// Writes a value as indented JSON; returns the file's size.
    ///
    /// # Errors
    /// As [`Self::save`].
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

    /// Notes once that an entry is damaged.
    pub fn note_damage(&self, path: &Path) {
        if lock(&self.shared.state).noted.insert(path.to_owned()) {
            let path = path.display();
            (self.shared.note)(&format!(
                "{path}: is damaged or of another version, and is made anew."
            ));
        }
    }

    /// Marks an entry as in use, so that this process doesn't remove it.
    pub fn pin(&self, path: &Path) {
        lock(&self.shared.state).pinned.insert(path.to_owned());
    }

    /// Records the time of use, as modification time of the entry's file.
    fn mark_used(&self, path: &Path, found: &Metadata) {
        let now = SystemTime::now();
        let is_recent = |t| now.duration_since(t).is_ok_and(|age| age < RECENT);
        if !found.modified().is_ok_and(is_recent) {
            // In a read-only capture, the time can't be changed.
            let _ = File::open(path).and_then(|file| file.set_modified(now));
        }
    }

    /// Adds to the total size. If the total exceeds the limit, removes entries.
    fn add(&self, bytes: u64) {
        let mut state = lock(&self.shared.state);
        let all = || self.found().values().flatten().map(|entry| entry.bytes).sum();
        let mut total = state.bytes.map_or_else(all, |total| total + bytes);
        if total > state.limit {
            total = self.shrink(&state.pinned);
            // Entries in use can't be removed. The next removal waits until the total has grown enough to make another
            // search worthwhile.
            let max_bytes = self.shared.max_bytes;
            state.limit = max_bytes.max(total + max_bytes / 16);
        }
        state.bytes = Some(total);
    }

    /// Removes the least recently used entries until the bound holds; returns the size of the remaining ones, bytes.
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

    /// Whether the folder of a kind exists, so that there may be entries.
    pub fn has(&self, kind: CacheKind) -> bool {
        self.link(kind).is_none() && self.folder().join(kind.name).is_dir()
    }

    /// All entries by kind.
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

    /// Number and size of the entries, by kind.
    pub fn listing(&self) -> Vec<CacheUse> {
        let of_kind = |(kind, found): (String, Vec<Found>)| CacheUse {
            kind,
            entries: found.len(),
            bytes: found.iter().map(|entry| entry.bytes).sum(),
        };
        self.found().into_iter().map(of_kind).collect()
    }

    /// Deletes the entries of one kind, or of all kinds; returns their number and size.
    ///
    /// # Errors
    /// If they can't be deleted, or a link is on the path to them.
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

/// Reads an entry's file, and returns the content; `None` if its checksum doesn't match the key.
fn unsealed(path: &Path, key: &blake3::Hash) -> Option<Vec<u8>> {
    let mut bytes = read_bytes(path, MAX_ENTRY_BYTES).ok()?;
    let (found, content) = bytes.split_first_chunk::<{ blake3::OUT_LEN }>()?;
    (*found == *checksum(key, content).as_bytes()).then(|| bytes.split_off(blake3::OUT_LEN))
}

/// Whether a text is a file name without a path.
fn is_name(text: &str) -> bool {
    matches!(Path::new(text).components().collect::<Vec<_>>()[..], [Component::Normal(name)] if name == text)
}

fn folder_bytes(folder: &Path) -> u64 {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    files.filter_map(|file| file.metadata().ok()).map(|found| found.len()).sum()
}

/// The entries in a kind's folder, each with its files. Files without an entry are listed too.
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

/// Removes an entry's file, and then the folder of its files.
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
