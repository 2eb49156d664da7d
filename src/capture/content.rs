//! The identity of a capture's content: hashes of the bytes that were read.
//!
//! Everything cached on disk is keyed with it. A frame that is read later, with other bytes, is an error, so that what is
//! computed from it never gets the key of the earlier content.

use super::{Capture, CaptureError, FilmedCamera};
use crate::host::{DiskCache, file_hashes};
use std::path::Path;
use std::sync::OnceLock;

/// Hashes of the files of an opened capture. Those of images are set when they are first read.
#[derive(Debug)]
pub(super) struct ContentHashes {
    /// Of `capture.json`.
    description: blake3::Hash,
    /// By camera and frame.
    frames: Vec<Vec<OnceLock<blake3::Hash>>>,
    /// Of everything, in hexadecimal digits.
    content: OnceLock<String>,
}

impl ContentHashes {
    pub fn new(description: &str, cameras: &[FilmedCamera]) -> Self {
        let known = |camera: &FilmedCamera| match &camera.video {
            Some(video) => video.frames.iter().copied().map(OnceLock::from).collect(),
            None => vec![OnceLock::new(); camera.frames.len()],
        };
        Self {
            description: blake3::hash(description.as_bytes()),
            frames: cameras.iter().map(known).collect(),
            content: OnceLock::new(),
        }
    }
}

impl Capture {
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
        let is_image = |camera: &(usize, &FilmedCamera)| camera.1.video.is_none();
        let images: Vec<(usize, usize)> = (self.cameras.iter().enumerate().filter(is_image))
            .flat_map(|(c, camera)| (0..camera.frames.len()).map(move |k| (c, k)))
            .collect();
        let files: Vec<&Path> = images.iter().map(|&(c, k)| &*self.cameras[c].frames[k]).collect();
        let found = file_hashes(&self.cache, &files).map_err(|(file, source)| {
            CaptureError::Read { path: files[file].to_owned(), source }
        })?;
        for (&image, hash) in images.iter().zip(&found) {
            self.require_unchanged(image, *hash)?;
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.hashes.description.as_bytes());
        for video in self.cameras.iter().filter_map(|camera| camera.video.as_ref()) {
            hasher.update(video.hash.as_bytes());
        }
        for hash in &found {
            hasher.update(hash.as_bytes());
        }
        Ok(self.hashes.content.get_or_init(|| hasher.finalize().to_hex().to_string()))
    }

    /// The capture's cache on disk, keyed with its content.
    ///
    /// # Errors
    /// As [`Self::content_hash`].
    pub fn cache(&self) -> Result<DiskCache, CaptureError> {
        Ok(self.cache.for_content(self.content_hash()?))
    }
}
