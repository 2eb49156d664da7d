//! Measurements in the capture's cache, one entry a combination, so that an interrupted run is resumed and a larger run
//! adds to a smaller one; and the folder of results.

use super::TradeoffError;
use crate::capture::{Capture, CaptureError, Truth};
use crate::host::temporary::{is_temporary, remove_abandoned};
use crate::host::{CacheKind, DiskCache, Elapsed, hash_file};
use crate::metrics::RegionScores;
use crate::offset::Offsets;
use crate::options::RenderOptions;
use crate::progress::Reporter;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// The files that a trade-off's folder holds.
pub const FILES: [&str; 3] = ["tradeoff.json", "tradeoff.svg", "recommended.json"];

pub(super) const PREPARATIONS: CacheKind = CacheKind { name: "tradeoff-preparations", version: 1 };
pub(super) const PLANS: CacheKind = CacheKind { name: "tradeoff-plans", version: 1 };
pub(super) const POINTS: CacheKind = CacheKind { name: "tradeoff-points", version: 1 };
pub(super) const TIMES: CacheKind = CacheKind { name: "tradeoff-times", version: 1 };

/// Stored measurements of one combination.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedPoint {
    pub options: RenderOptions,
    /// By the target's id.
    pub scores: BTreeMap<String, RegionScores>,
    /// Why a view can't be rendered; there are no scores then.
    pub reason: Option<String>,
}

/// A light field for one registration and offset method, with its preparation times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Prepared {
    pub offsets: Offsets,
    /// `None` where the clocks are known.
    pub offsets_took: Option<Elapsed>,
    pub registration_took: Elapsed,
}

/// The plan for `auto`, and its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Planned {
    pub options: RenderOptions,
    pub took: Elapsed,
}

/// The capture's cache, keyed with everything that measurements depend on besides their options.
pub(super) struct Store {
    cache: DiskCache,
    reporter: Reporter,
    /// Whether it was noted that nothing can be written.
    noted: AtomicBool,
}

impl Store {
    /// # Errors
    /// If a file of the capture or of the truth can't be read.
    pub fn open(
        capture: &Capture,
        truth: Option<&Truth>,
        reporter: &Reporter,
    ) -> Result<Self, TradeoffError> {
        let mut hashes = Vec::new();
        for file in truth.iter().flat_map(|t| t.views.iter().flat_map(|v| [&v.image, &v.motion])) {
            let path = truth.map(|t| t.file(file)).transpose()?.unwrap_or_default();
            let mut hasher = blake3::Hasher::new();
            hash_file(&mut hasher, &path).map_err(|source| CaptureError::Read { path, source })?;
            hashes.push(hasher.finalize().to_hex().to_string());
        }
        let views = truth.map(|truth| &truth.views);
        let cache = capture.cache()?;
        // Views can't fail to be serialized.
        let conditions = cache.key(POINTS, &(rayon::current_num_threads(), views, hashes));
        let cache = cache.for_content(&conditions.map(|key| key.to_string()).unwrap_or_default());
        Ok(Self { cache, reporter: *reporter, noted: AtomicBool::new(false) })
    }

    /// A measurement of this kind with these options, if it is cached.
    pub fn load<T: DeserializeOwned>(
        &self,
        kind: CacheKind,
        options: &impl Serialize,
    ) -> Option<T> {
        self.cache.load_json(kind, options)
    }

    /// Caches a measurement. Notes once if that can't be, as in a read-only capture.
    pub fn save(&self, kind: CacheKind, options: &impl Serialize, value: &impl Serialize) {
        let saved = self.cache.save_json(kind, options, value);
        if let Err(error) = saved
            && !self.noted.swap(true, Ordering::Relaxed)
        {
            let sentence = "Measurements can't be cached for the next command";
            self.reporter.note(&format!("{sentence}: {error}."));
        }
    }
}

/// Writes a value as a JSON file, whole or not at all.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), TradeoffError> {
    let failed = |source| TradeoffError::Write { path: path.to_owned(), source };
    crate::host::write_json(path, value).map_err(failed)
}

/// Only a folder that isn't there, that is empty, or that holds a trade-off is written to.
pub(super) fn refuse_foreign(folder: &Path) -> Result<(), TradeoffError> {
    remove_abandoned(folder);
    if folder.exists() && !folder.is_dir() {
        return Err(TradeoffError::NoFolder { folder: folder.to_owned() });
    }
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_of_a_run_at_work = is_temporary(&entry.file_name());
        if !FILES.contains(&name.as_str()) && !is_of_a_run_at_work {
            return Err(TradeoffError::Foreign { folder: folder.to_owned(), name });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("new");
        assert!(refuse_foreign(&missing).is_ok() && refuse_foreign(folder.path()).is_ok());
        std::fs::write(folder.path().join("tradeoff.json"), "{}").unwrap();
        assert!(refuse_foreign(folder.path()).is_ok());
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = refuse_foreign(folder.path()).unwrap_err().to_string();
        assert!(error.contains("thesis.tex"), "{error}");
        let error = refuse_foreign(&folder.path().join("thesis.tex")).unwrap_err().to_string();
        assert!(error.contains("is no folder"), "{error}");
    }
}
