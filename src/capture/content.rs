//! Hash of a capture's content, and results cached on disk under keys that include this hash.
//!
//! Results are stored in postcard's binary form. A frame that changes after the capture was opened is an error.
//! Therefore no result is computed from a mixture of old and new content, or stored under the key of another content.

use super::{Capture, CaptureError, FilmedCamera};
use crate::host::{CacheKind, DiskCache, ENTRY_OVERHEAD_BYTES};
use crate::host::{FileRead, FileState, file_hashes};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Hashes of the files of an opened capture. The hash of an image is computed when the image is first read.
#[derive(Debug)]
pub(super) struct ContentHashes {
    /// Hash of `capture.json`.
    description: blake3::Hash,
    frames: HashMap<PathBuf, FrameContent>,
}

#[derive(Debug)]
struct FrameContent {
    /// State of the file (size and times) when the capture was opened. `None` if the file's metadata couldn't be read.
    state: Option<FileState>,
    hash: OnceLock<blake3::Hash>,
}

impl ContentHashes {
    pub fn new(description: &str, cameras: &[FilmedCamera]) -> Self {
        let mut frames = HashMap::new();
        for camera in cameras {
            let mut known = camera.video.iter().flat_map(|video| video.frames.iter().copied());
            for frame in &camera.frames {
                let state = std::fs::metadata(frame).ok().map(|found| FileState::of(&found));
                let hash = known.next().map_or_else(OnceLock::new, OnceLock::from);
                frames.insert(frame.clone(), FrameContent { state, hash });
            }
        }
        Self { description: blake3::hash(description.as_bytes()), frames }
    }

    /// Returns the hash of a frame's file. `None` if the hash isn't known yet, because the file hasn't been read.
    fn get(&self, frame: &Path) -> Option<blake3::Hash> {
        self.frames.get(frame).and_then(|known| known.hash.get()).copied()
    }

    /// Returns an error if a frame's file, whose state and hash are `read`, has other bytes than when it was read
    /// earlier. At the first reading, returns an error if the file was replaced or modified since the capture was
    /// opened.
    pub fn require_unchanged(&self, frame: &Path, read: &FileRead) -> Result<(), CaptureError> {
        let Some(known) = self.frames.get(frame) else { return Ok(()) };
        let is_opened = known.state.is_none_or(|state| read.state.has_content_of(&state));
        let hash = match known.hash.get() {
            None if is_opened => *known.hash.get_or_init(|| read.hash),
            Some(hash) => *hash,
            None => return Err(CaptureError::Changed { path: frame.to_owned() }),
        };
        if hash == read.hash {
            Ok(())
        } else {
            Err(CaptureError::Changed { path: frame.to_owned() })
        }
    }
}

/// Hash of a capture's content, computed once. A clone starts without the hash, because the cameras of a cloned capture
/// may be replaced.
#[derive(Debug, Default)]
pub(super) struct ContentHash(OnceLock<String>);

impl Clone for ContentHash {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Capture {
    /// Returns the capture with only the given cameras, in this order. If the reference isn't among them, the first of
    /// them becomes the reference.
    pub(crate) fn with_cameras(&self, cameras: &[usize]) -> Self {
        let errors = self.calibration_errors.as_ref();
        Self {
            reference: cameras.iter().position(|&c| c == self.reference).unwrap_or(0),
            calibration_errors: errors.map(|errors| Arc::new(errors.of_cameras(cameras))),
            cameras: cameras.iter().map(|&c| self.cameras[c].clone()).collect(),
            ..self.clone()
        }
    }

    /// Returns the hash of the capture's content (`capture.json` and the bytes of all frames or videos), 64 hexadecimal
    /// digits.
    ///
    /// The hash is computed once. Hashes of files that haven't changed since an earlier command come from the cache.
    ///
    /// # Errors
    /// [`CaptureError::Read`] for a file that can't be read, [`CaptureError::Changed`] for a frame that changed since
    /// the capture was opened.
    pub fn content_hash(&self) -> Result<&str, CaptureError> {
        if let Some(content) = self.content.0.get() {
            return Ok(content);
        }
        let frames = || self.cameras.iter().flat_map(|camera| &camera.frames);
        if frames().any(|frame| self.hashes.get(frame).is_none()) {
            let images = self.cameras.iter().filter(|camera| camera.video.is_none());
            let files: Vec<&Path> = images.flat_map(|c| &c.frames).map(PathBuf::as_path).collect();
            let found = file_hashes(&self.cache, &files).map_err(|(file, source)| {
                CaptureError::Read { path: files[file].to_owned(), source }
            })?;
            let mut found = files.iter().zip(found);
            found.try_for_each(|(file, read)| self.hashes.require_unchanged(file, &read))?;
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.hashes.description.as_bytes());
        hasher.update(&self.reference.to_le_bytes());
        for camera in &self.cameras {
            hasher.update(camera.id.as_bytes());
            hasher.update(&camera.frames.len().to_le_bytes());
            if let Some(video) = &camera.video {
                hasher.update(video.hash.as_bytes());
            }
            for hash in camera.frames.iter().filter_map(|frame| self.hashes.get(frame)) {
                hasher.update(hash.as_bytes());
            }
        }
        Ok(self.content.0.get_or_init(|| hasher.finalize().to_hex().to_string()))
    }

    /// Returns the capture's cache on disk. Its keys include the hash of the capture's content.
    ///
    /// # Errors
    /// The errors of [`Self::content_hash`].
    pub fn cache(&self) -> Result<DiskCache, CaptureError> {
        Ok(self.cache.for_content(self.content_hash()?))
    }

    /// Loads the result of this kind that was computed from `inputs` and stored in the cache on disk. `None` if there
    /// is no such result, or if it can't be decoded. The capture's content is hashed only if the cache has results of
    /// this kind.
    pub(crate) fn load_stored<T: DeserializeOwned>(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
    ) -> Option<T> {
        postcard::from_bytes(&self.stored_bytes(kind, inputs)?).ok()
    }

    /// Looks up the stored result of this kind for `inputs` in the cache on disk, without decoding it. `None` if the
    /// cache has no such result.
    pub(crate) fn stored(&self, kind: CacheKind, inputs: &impl Serialize) -> Option<Stored> {
        let bytes = self.stored_bytes(kind, inputs)?.len() as u64 + ENTRY_OVERHEAD_BYTES;
        Some(Stored { bytes, was_there: true })
    }

    fn stored_bytes(&self, kind: CacheKind, inputs: &impl Serialize) -> Option<Vec<u8>> {
        let cache = self.cache.has(kind).then(|| self.cache().ok()).flatten()?;
        cache.load(kind, inputs)
    }

    /// Stores `result`, which was computed from `inputs`, in the cache on disk.
    ///
    /// # Errors
    /// The errors of [`Self::cache`], and [`CaptureError::Write`] if the result can't be written.
    pub(crate) fn store(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
        result: &impl Serialize,
    ) -> Result<Stored, CaptureError> {
        let cache = self.cache()?;
        let content = postcard::to_allocvec(result).map_err(std::io::Error::other);
        let saved = content.and_then(|content| cache.save(kind, inputs, &content));
        let bytes = saved.map_err(|source| {
            let path = cache.path(kind, inputs).unwrap_or_else(|_| self.folder.clone());
            CaptureError::Write { path, source }
        })?;
        Ok(Stored { bytes, was_there: false })
    }
}

/// Facts about a result that is stored in the cache on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    /// Size of the cache entry's file, bytes.
    pub bytes: u64,
    /// True if the result was already in the cache, false if it was stored just now.
    pub was_there: bool,
}
