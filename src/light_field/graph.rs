//! Graph of the stages that render views: a capture with its clocks, and the cached results of stages.

use super::error::RenderError;
use crate::capture::{Capture, Stored};
use crate::host::{CacheKind, Memo, memory_bytes};
use crate::offset::Offsets;
use crate::registration::{FrameStore, RegistrationOptions};
use nalgebra::Point3;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::any::Any;
use std::sync::Arc;

/// Part of the machine's memory that the in-memory cache takes while a capture is viewed: one in this many.
const MEMORY_PARTS: usize = 8;
/// Maximum size of the in-memory cache while a capture is viewed, bytes.
const MAX_VIEWING_BYTES: usize = 4 << 30;

/// Inputs of a stage of rendering, which computes one kind of result. The serialized inputs are the key of the stage's
/// result in the memory cache. Each stage has a function `get`, in the file of its algorithm. It returns the result
/// from the cache, or computes and caches it.
pub(super) trait Stage: Serialize {
    type Output: Any + Send + Sync;
    /// Name of the stage, by which the cache separates its results from the results of other stages.
    const NAME: &'static str;

    /// Returns the size of a result in memory, bytes.
    fn bytes(output: &Self::Output) -> usize;
}

/// A stage whose results [`LightField::prepare`] stores on disk.
pub(super) trait StoredStage: Stage<Output: Serialize + DeserializeOwned> {
    const KIND: CacheKind;
}

/// A capture with known clocks, from which views are rendered.
///
/// A light field is immutable, and may be used by several threads. Results of stages are cached in memory of bounded
/// size. No result depends on the views rendered before.
///
/// Times are seconds on the reference camera's clock, counted from the capture's start ([`Capture::time_origin_s`]).
pub struct LightField {
    capture: Arc<Capture>,
    offsets: Offsets,
    /// Frame times of every camera, seconds on the reference camera's clock from the capture's start. `None` if the
    /// camera's clock is unknown.
    pub(super) all_times_s: Vec<Option<Vec<f64>>>,
    times_hash: String,
    pub(super) memo: Arc<Memo>,
}

impl LightField {
    /// Creates the light field of a capture. `offsets` are the temporal offsets of its cameras.
    pub fn new(capture: Arc<Capture>, offsets: Offsets) -> Self {
        Self::with_frames(&FrameStore::new(capture, &RegistrationOptions::default()), offsets)
    }

    /// Creates the light field of a frame store's capture. The light field shares the store's cached frames.
    pub fn with_frames(frames: &FrameStore, offsets: Offsets) -> Self {
        let capture = offsets.with_readouts(frames.capture());
        let all_times_s = offsets.common_times_s(&capture);
        let readouts_s: Vec<Option<f64>> = offsets.cameras.iter().map(|c| c.readout_s).collect();
        let mut hasher = blake3::Hasher::new();
        // This can't fail: a hasher accepts all bytes, and lists of numbers can be serialized.
        let mut written = serde_json::to_writer(&mut hasher, &all_times_s);
        if readouts_s.iter().any(Option::is_some) {
            written = written.and_then(|()| serde_json::to_writer(&mut hasher, &readouts_s));
        }
        debug_assert!(written.is_ok());
        let times_hash = hasher.finalize().to_hex().to_string();
        Self { capture, offsets, all_times_s, times_hash, memo: frames.memo.clone() }
    }

    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    pub fn offsets(&self) -> &Offsets {
        &self.offsets
    }

    /// Enlarges the in-memory cache for viewing, so that the frames of successive instants stay in it with their depth
    /// and motion. It then takes up to an eighth of the machine's memory, but at most 4 GiB.
    pub fn enlarge_cache(&self) {
        let part = memory_bytes().map_or(0, |bytes| bytes / MEMORY_PARTS);
        self.memo.raise_max_bytes(part.min(MAX_VIEWING_BYTES));
    }

    /// Returns the store of decoded frames, which are prepared for registration with the given options.
    pub fn frames(&self, registration: &RegistrationOptions) -> FrameStore {
        FrameStore::with_memo(self.capture.clone(), registration, self.memo.clone())
    }

    /// Returns the result of a stage if it is in memory, else `None`.
    pub(super) fn cached<S: Stage>(&self, stage: &S) -> Option<Arc<S::Output>> {
        self.memo.get(S::NAME, stage)
    }

    /// Returns the result of a stage from memory or else from disk. `None` if the result is in neither.
    pub(super) fn found<S: StoredStage>(&self, stage: &S) -> Option<Arc<S::Output>> {
        self.cached(stage).or_else(|| {
            let stored: S::Output =
                self.capture.load_stored(S::KIND, &self.stored_inputs(stage))?;
            Some(self.insert(stage, stored))
        })
    }

    /// Caches the result of a stage in memory, and returns it.
    pub(super) fn insert<S: Stage>(
        &self,
        stage: &S,
        result: impl Into<Arc<S::Output>>,
    ) -> Arc<S::Output> {
        let result = result.into();
        let bytes = S::bytes(&result);
        self.memo.insert(S::NAME, stage, result, bytes)
    }

    /// Returns the size of a stage's result on disk, without reading the result. `None` if the result isn't on disk.
    pub(super) fn stored<S: StoredStage>(&self, stage: &S) -> Option<Stored> {
        self.capture.stored(S::KIND, &self.stored_inputs(stage))
    }

    /// Stores the result of a stage on disk, and returns its size on disk. A result with the same inputs is
    /// overwritten.
    pub(super) fn store<S: StoredStage>(
        &self,
        stage: &S,
        result: &S::Output,
    ) -> Result<Stored, RenderError> {
        Ok(self.capture.store(S::KIND, &self.stored_inputs(stage), result)?)
    }

    /// Returns the key of a stage's result on disk: the stage's inputs, and a hash of the frame times. A capture's
    /// cache may hold results for several estimates of the temporal offsets, which the hash distinguishes.
    fn stored_inputs<'a, S: StoredStage>(&'a self, stage: &'a S) -> (&'a S, &'a str) {
        (stage, &self.times_hash)
    }

    /// Returns the median distance between a camera and its nearest neighbour, metres. Cameras at the same place don't
    /// count as neighbours. Returns 0 if no camera has a neighbour.
    pub(crate) fn spacing_m(&self) -> f64 {
        let centers: Vec<_> = self.capture.cameras.iter().map(|c| c.camera.center()).collect();
        let nearest = |a: &Point3<f64>| {
            let distances = centers.iter().map(|b| (a - b).norm()).filter(|d| *d > 0.0);
            distances.min_by(f64::total_cmp)
        };
        let mut distances: Vec<f64> = centers.iter().filter_map(nearest).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().unwrap_or(0.0)
    }
}
