//! Measurements on disk, one small file a combination, so that an interrupted run is resumed and a
//! larger run adds to a smaller one.

use super::TradeoffError;
use crate::capture::{Capture, CaptureError, Truth};
use crate::host::temporary::{is_temporary, remove_abandoned};
use crate::host::{Elapsed, cache_file, hash_file};
use crate::metrics::RegionScores;
use crate::offset::Offsets;
use crate::options::RenderOptions;
use crate::progress::Reporter;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The files that a trade-off's folder holds.
pub const FILES: [&str; 3] = ["tradeoff.json", "tradeoff.svg", "recommended.json"];
/// The folder of measurements in it.
pub(super) const POINTS: &str = "points";

/// What is known of one combination.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedPoint {
    pub options: RenderOptions,
    /// By the target's id.
    pub scores: BTreeMap<String, RegionScores>,
    /// The cameras that the timed view is blended from.
    pub cameras: Vec<usize>,
    /// Why a view can't be rendered, instead of all else.
    pub reason: Option<String>,
}

/// What views with one registration and one offset method start from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Prepared {
    pub offsets: Offsets,
    /// `None` where the clocks are known.
    pub offsets_took: Option<Elapsed>,
    pub registration_took: Elapsed,
}

/// What `auto` makes of the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Planned {
    pub options: RenderOptions,
    pub took: Elapsed,
}

/// The folder, and the hash of all that measurements in it rest on besides their options.
pub(super) struct Store {
    folder: PathBuf,
    base: String,
    reporter: Reporter,
    /// The files that a note was about.
    noted: Mutex<BTreeSet<PathBuf>>,
}

impl Store {
    /// Refuses a folder that holds anything else.
    pub fn open(
        folder: &Path,
        capture: &Capture,
        truth: Option<&Truth>,
        reporter: &Reporter,
    ) -> Result<Self, TradeoffError> {
        remove_abandoned(folder);
        remove_abandoned(&folder.join(POINTS));
        refuse_foreign(folder)?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        hasher.update(capture.content_hash()?.as_bytes());
        hasher.update(&rayon::current_num_threads().to_le_bytes());
        for view in truth.iter().flat_map(|t| &t.views) {
            hasher.update(serde_json::to_string(view).unwrap_or_default().as_bytes());
        }
        for file in truth.iter().flat_map(|t| t.views.iter().flat_map(|v| [&v.image, &v.motion])) {
            let path = truth.map(|t| t.file(file)).transpose()?.unwrap_or_default();
            hash_file(&mut hasher, &path).map_err(|source| CaptureError::Read { path, source })?;
        }
        let base = hasher.finalize().to_hex().to_string();
        let noted = Mutex::default();
        Ok(Self { folder: folder.to_owned(), base, reporter: *reporter, noted })
    }

    /// The name that a measurement with these options is cached by.
    pub fn key(&self, what: &str, options: &impl Serialize) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.base.as_bytes());
        hasher.update(serde_json::to_string(options).unwrap_or_default().as_bytes());
        format!("{what}-{}", &hasher.finalize().to_hex()[..24])
    }

    fn path(&self, key: &str) -> PathBuf {
        self.folder.join(POINTS).join(format!("{key}.json"))
    }

    /// What was cached by this name; `None` if nothing was, or if the file is not what was written,
    /// which is noted.
    pub fn load<T: DeserializeOwned>(&self, key: &str) -> Option<T> {
        let path = self.path(key);
        cache_file::load(&path, key, |sentence| {
            // Every measurement is asked for again until it is made anew.
            if self.noted.lock().unwrap_or_else(PoisonError::into_inner).insert(path.clone()) {
                self.reporter.note(sentence);
            }
        })
    }

    pub fn save(&self, key: &str, value: &impl Serialize) -> Result<(), TradeoffError> {
        let path = self.path(key);
        cache_file::save(&path, key, value).map_err(|source| TradeoffError::Write { path, source })
    }
}

/// Writes a value as a JSON file, whole or not at all.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), TradeoffError> {
    let failed = |source| TradeoffError::Write { path: path.to_owned(), source };
    crate::host::write_json(path, value).map_err(failed)
}

/// Only a folder that isn't there, that is empty, or that holds a trade-off is written to.
fn refuse_foreign(folder: &Path) -> Result<(), TradeoffError> {
    if folder.exists() && !folder.is_dir() {
        return Err(TradeoffError::NoFolder { folder: folder.to_owned() });
    }
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_of_a_run_at_work = is_temporary(&entry.file_name());
        let own = FILES.contains(&name.as_str()) || name == POINTS || is_of_a_run_at_work;
        if !own {
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
        std::fs::create_dir(folder.path().join(POINTS)).unwrap();
        std::fs::write(folder.path().join("tradeoff.json"), "{}").unwrap();
        assert!(refuse_foreign(folder.path()).is_ok());
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = refuse_foreign(folder.path()).unwrap_err().to_string();
        assert!(error.contains("thesis.tex"), "{error}");
        let error = refuse_foreign(&folder.path().join("thesis.tex")).unwrap_err().to_string();
        assert!(error.contains("is no folder"), "{error}");
    }
}
