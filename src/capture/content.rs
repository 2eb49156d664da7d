//! The identity of a capture's content: hashes of the bytes that were read.
//!
//! Everything cached on disk is keyed with it. A frame that is read later, with other bytes, is an error, so that what is
//! computed from it never gets the key of the earlier content.

use super::{Capture, CaptureError, FilmedCamera};
use crate::host::{CacheKind, DiskCache, file_hashes};
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Hashes of the files of an opened capture. Those of images are set when they are first read.
#[derive(Clone, Debug)]
pub(super) struct ContentHashes {
    /// Of `capture.json`.
    description: blake3::Hash,
    /// By camera and frame.
    frames: Vec<Arc<Vec<OnceLock<blake3::Hash>>>>,
    /// Of everything, in hexadecimal digits.
    content: Arc<OnceLock<String>>,
}

impl ContentHashes {
    pub fn new(description: &str, cameras: &[FilmedCamera]) -> Self {
        let known = |camera: &FilmedCamera| match &camera.video {
            Some(video) => video.frames.iter().copied().map(OnceLock::from).collect(),
            None => vec![OnceLock::new(); camera.frames.len()],
        };
        Self {
            description: blake3::hash(description.as_bytes()),
            frames: cameras.iter().map(known).map(Arc::new).collect(),
            content: Arc::default(),
        }
    }
}

impl Capture {
    /// The capture with some of its cameras only, in this order. The first is the reference if the reference isn't among
    /// them.
    pub(crate) fn with_cameras(&self, cameras: &[usize]) -> Self {
        Self {
            reference: cameras.iter().position(|&c| c == self.reference).unwrap_or(0),
            cameras: cameras.iter().map(|&c| self.cameras[c].clone()).collect(),
            hashes: ContentHashes {
                frames: cameras.iter().map(|&c| self.hashes.frames[c].clone()).collect(),
                content: Arc::default(),
                ..self.hashes
            },
            ..self.clone()
        }
    }

    /// Refuses a frame whose bytes aren't those that were read before.
    pub(super) fn require_unchanged(
        &self,
        (camera, frame): (usize, usize),
        found: blake3::Hash,
    ) -> Result<(), CaptureError> {
        let known = self.hashes.frames[camera][frame].get_or_init(|| found);
        if *known == found {
            return Ok(());
        }
        Err(CaptureError::Changed { path: self.cameras[camera].frames[frame].clone() })
    }

    /// A hash of everything that results from this capture depend on: `capture.json` and the bytes of the frames or videos.
    /// 64 hexadecimal digits.
    ///
    /// Computed once. Hashes of files that haven't changed since an earlier command come from the cache.
    ///
    /// # Errors
    /// [`CaptureError::Read`], or [`CaptureError::Changed`] for a frame that was read before, with other bytes.
    pub fn content_hash(&self) -> Result<&str, CaptureError> {
        if let Some(content) = self.hashes.content.get() {
            return Ok(content);
        }
        self.hash_frames()?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.hashes.description.as_bytes());
        hasher.update(&self.reference.to_le_bytes());
        for (camera, frames) in self.cameras.iter().zip(&self.hashes.frames) {
            hasher.update(camera.id.as_bytes());
            hasher.update(&frames.len().to_le_bytes());
            if let Some(video) = &camera.video {
                hasher.update(video.hash.as_bytes());
            }
            for frame in frames.iter().filter_map(OnceLock::get) {
                hasher.update(frame.as_bytes());
            }
        }
        Ok(self.hashes.content.get_or_init(|| hasher.finalize().to_hex().to_string()))
    }

    /// Hashes all images, unless each was read before.
    fn hash_frames(&self) -> Result<(), CaptureError> {
        let is_known = |frames: &Arc<Vec<OnceLock<_>>>| frames.iter().all(|f| f.get().is_some());
        if self.hashes.frames.iter().all(is_known) {
            return Ok(());
        }
        let is_image = |camera: &(usize, &FilmedCamera)| camera.1.video.is_none();
        let images: Vec<(usize, usize)> = (self.cameras.iter().enumerate().filter(is_image))
            .flat_map(|(c, camera)| (0..camera.frames.len()).map(move |k| (c, k)))
            .collect();
        let files: Vec<&Path> = images.iter().map(|&(c, k)| &*self.cameras[c].frames[k]).collect();
        let found = file_hashes(&self.cache, &files).map_err(|(file, source)| {
            CaptureError::Read { path: files[file].to_owned(), source }
        })?;
        let mut images = images.iter().zip(found);
        images.try_for_each(|(&image, hash)| self.require_unchanged(image, hash))
    }

    /// Whether there may be cached results of a kind; nothing is hashed.
    pub fn has_cached(&self, kind: CacheKind) -> bool {
        self.cache.has(kind)
    }

    /// The capture's cache on disk, keyed with its content.
    ///
    /// # Errors
    /// As [`Self::content_hash`].
    pub fn cache(&self) -> Result<DiskCache, CaptureError> {
        Ok(self.cache.for_content(self.content_hash()?))
    }
}
