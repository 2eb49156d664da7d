//! Results in a capture's cache on disk, in postcard's binary form.

use super::{Capture, CaptureError};
use crate::host::{CacheKind, DiskCache};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// A result on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stored {
    /// Size of its file, bytes.
    pub bytes: u64,
    /// Whether it was stored before.
    pub was_there: bool,
}

impl Capture {
    /// The cache, if it may have entries of a kind. Otherwise the capture's content isn't hashed.
    fn cache_with(&self, kind: CacheKind) -> Option<DiskCache> {
        self.cache.has(kind).then(|| self.cache().ok()).flatten()
    }

    /// Loads the result for these inputs, if it is stored.
    pub(crate) fn load_stored<T: DeserializeOwned>(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
    ) -> Option<T> {
        postcard::from_bytes(&self.cache_with(kind)?.load(kind, inputs)?).ok()
    }

    /// Computes and stores the result for these inputs, unless it is stored already.
    ///
    /// # Errors
    /// Those of [`Self::cache`] and of `compute`, and [`CaptureError::Write`] if it can't be written.
    pub(crate) fn store<T: Serialize, E: From<CaptureError>>(
        &self,
        kind: CacheKind,
        inputs: &impl Serialize,
        compute: impl FnOnce() -> Result<Arc<T>, E>,
    ) -> Result<Stored, E> {
        let cache = self.cache()?;
        if cache.load(kind, inputs).is_some()
            && let Some(bytes) = cache.size(kind, inputs)
        {
            return Ok(Stored { bytes, was_there: true });
        }
        let content = compute()?;
        let failed = |source| {
            let path = cache.path(kind, inputs).unwrap_or_else(|_| self.folder.clone());
            E::from(CaptureError::Write { path, source })
        };
        let content =
            postcard::to_allocvec(&*content).map_err(std::io::Error::other).map_err(failed)?;
        let bytes = cache.save(kind, inputs, &content).map_err(failed)?;
        Ok(Stored { bytes, was_there: false })
    }
}
