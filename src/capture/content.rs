//! Hashes of a capture's content, and cached results on disk that are keyed with this content.
//!
//! Results are stored in postcard's binary form. A frame that changes after the capture was opened is an error. A
//! result is therefore never computed from two contents, or stored with the key of another content.

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
    /// State of the file (size and times) when the capture was opened.
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

    /// The hash of a frame's file; `None` if the file hasn't been read yet.
    fn get(&self, frame: &Path) -> Option<blake3::Hash> {
        self.frames.get(frame).and_then(|known| known.hash.get()).copied()
    }

    /// An error if a frame was read with other bytes than before. At the first reading, an error if the file was
    /// replaced or modified since the capture was opened.
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

/// The hash of a capture's content, computed once. A clone starts without the hash, because its cameras may be
/// replaced.
#[derive(Debug, Default)]
pub(super) struct ContentHash(OnceLock<String>);

impl Clone for ContentHash {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Capture {
    /// The capture reduced to these cameras, in this order. If they don't include the reference, the first one becomes
    /// the reference.
    pub(crate) fn with_cameras(&self, cameras: &[usize]) -> Self {
        let errors = self.calibration_errors.as_ref();
        Self {
            reference: cameras.iter().position(|&c| c == self.reference).unwrap_or(0),
            calibration_errors: errors.map(|errors| Arc::new(errors.of_cameras(cameras))),
            cameras: cameras.iter().map(|&c| self.cameras[c].clone()).collect(),
            ..self.clone()
        }
    }

    /// Hash of the capture's content (`capture.json`, and the bytes of all frames or videos), 64 hexadecimal digits.
    ///
    /// Computed once. Hashes of files that haven't changed since an earlier command come from the cache.
    ///
    /// # Errors
    /// [`CaptureError::Read`], or [`CaptureError::Changed`] for a frame that changed since the capture was opened.
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

    /// The capture's cache on disk, keyed with its content.
    ///
    /// # Errors
    /// As [`Self::content_hash`].
    pub fn cache(&self) -> Result<DiskCache, CaptureError> {
        Ok(self.cache.for_content(self.content_hash()?))
    }

    /// Loads the cached result of these inputs; `None` if it isn't stored. The capture's content is hashed only if the
    /// cache has results of this kind.
    pub(crate) fn load_stored<T: DeserializeOwned>(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
    ) -> Option<T> {
        postcard::from_bytes(&self.stored_bytes(kind, inputs)?).ok()
    }

    /// The entry of these inputs in the cache on disk; `None` if there is none.
    pub(crate) fn stored(&self, kind: CacheKind, inputs: &impl Serialize) -> Option<Stored> {
        let bytes = self.stored_bytes(kind, inputs)?.len() as u64 + ENTRY_OVERHEAD_BYTES;
        Some(Stored { bytes, was_there: true })
    }

    fn stored_bytes(&self, kind: CacheKind, inputs: &impl Serialize) -> Option<Vec<u8>> {
        let cache = self.cache.has(kind).then(|| self.cache().ok()).flatten()?;
        cache.load(kind, inputs)
    }

    /// Stores the result of these inputs in the cache on disk.
    ///
    /// # Errors
    /// Those of [`Self::cache`], and [`CaptureError::Write`] if it can't be written.
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

/// A result that is stored in the cache on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    /// Size of the result's file, bytes.
    pub bytes: u64,
    /// Whether the result had been stored before.
    pub was_there: bool,
}
