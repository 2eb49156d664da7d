//! Stores measurements in the capture's disk cache, with one entry per combination of options. An interrupted run can
//! therefore be resumed, and a run with more combinations reuses the measurements of an earlier run.

use super::TradeoffError;
use crate::capture::{Capture, Truth};
use crate::host::{CacheKind, DiskCache, Elapsed, Stopwatch};
use crate::light_field::LightField;
use crate::metrics::RegionScores;
use crate::offset::{self, Offsets};
use crate::options::{AutoOptions, RenderOptions};
use crate::plan::plan;
use crate::progress::Reporter;
use crate::registration::FrameStore;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const PREPARATIONS: CacheKind = CacheKind { name: "tradeoff-preparations", version: 2 };
const PLANS: CacheKind = CacheKind { name: "tradeoff-plans", version: 3 };
const POINTS: CacheKind = CacheKind { name: "tradeoff-points", version: 3 };

/// Stored measurements of one combination of options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedPoint {
    pub options: RenderOptions,
    /// Scores of the rendered views against their reference images. The key is the id of the target, which is a view
    /// with a reference image.
    pub scores: BTreeMap<String, RegionScores>,
    /// Reason why no view can be rendered with these options; `None` if views can be rendered. If there is a reason,
    /// `scores` and `runs` are not used.
    pub reason: Option<String>,
    /// Rendering times of the view that is timed, one for each run.
    pub runs: Vec<Elapsed>,
}

/// Temporal offsets of the cameras for one choice of registration options and offset method, with the times that the
/// estimation of offsets and the registration of frames took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Prepared {
    pub offsets: Offsets,
    /// Time to estimate the offsets; `None` if the cameras' clocks are known, so that nothing is estimated.
    pub offsets_took: Option<Elapsed>,
    pub registration_took: Elapsed,
}

/// Options in which every automatic choice is replaced by the chosen method, and the time to choose the methods.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Planned {
    pub options: RenderOptions,
    pub took: Elapsed,
}

/// A capture and its cache of measurements. The cache keys contain the options and everything else on which the
/// measurements depend.
pub(super) struct Store {
    pub capture: Arc<Capture>,
    cache: DiskCache,
    reporter: Reporter,
    /// Whether the user has been notified that the cache can't be written.
    noted: AtomicBool,
}

impl Store {
    /// Opens the store of a capture's measurements.
    ///
    /// # Errors
    /// If a file of the capture or of its ground truth can't be read.
    pub fn open(
        capture: &Arc<Capture>,
        truth: Option<&Truth>,
        reporter: &Reporter,
    ) -> Result<Self, TradeoffError> {
        let mut hashes = Vec::new();
        for (truth, view) in truth.iter().flat_map(|t| t.views.iter().map(move |v| (t, v))) {
            for file in [&view.image, &view.motion] {
                hashes.push(truth.hash(file)?.to_hex().to_string());
            }
        }
        let views = truth.map(|truth| &truth.views);
        let cache = capture.cache()?;
        // The serialization of views can't fail.
        let conditions = cache.key(POINTS, &(rayon::current_num_threads(), views, hashes));
        let cache = cache.for_content(&conditions.map(|key| key.to_string()).unwrap_or_default());
        let noted = AtomicBool::new(false);
        Ok(Self { capture: capture.clone(), cache, reporter: *reporter, noted })
    }

    /// Returns the temporal offsets for these options, and the times that the estimation of offsets and the
    /// registration of frames took. They are loaded from the cache or, if they are not cached, computed and timed.
    pub fn prepared(&self, options: &RenderOptions) -> Result<Prepared, TradeoffError> {
        let capture = &self.capture;
        let still_change = options.interpolation.still_change;
        let inputs = (&options.registration, &options.offset, still_change);
        if let Some(cached) = self.load::<Prepared>(PREPARATIONS, &inputs)
            && cached.offsets.fits(capture)
        {
            return Ok(cached);
        }
        let estimates = offset::clocks(capture).1 > 1 && !capture.is_static();
        let watch = Stopwatch::start();
        let offsets = if estimates {
            let frames = FrameStore::new(capture.clone(), &options.registration);
            offset::estimate(&frames, &options.offset, &self.reporter)?.offsets
        } else {
            Offsets::known(capture)
        };
        let offsets_took = estimates.then(|| watch.elapsed());
        // This light field has no decoded frames yet, so that the time of registration includes decoding.
        let field = LightField::new(capture.clone(), offsets.clone());
        let middle_s = middle_s(&field);
        let watch = Stopwatch::start();
        field.register(middle_s, options)?;
        let registration_took = watch.elapsed();
        let prepared = Prepared { offsets, offsets_took, registration_took };
        self.save(PREPARATIONS, &inputs, &prepared);
        Ok(prepared)
    }

    /// Returns the options `asked` with every automatic choice replaced by the chosen method, and the time that the
    /// choice took.
    pub fn planned(&self, asked: &RenderOptions) -> Result<Planned, TradeoffError> {
        if asked.auto.stages().is_empty() {
            let took = Elapsed { wall_s: 0.0, cpu_s: 0.0 };
            return Ok(Planned { options: asked.clone(), took });
        }
        if let Some(cached) = self.load(PLANS, asked) {
            return Ok(cached);
        }
        let prepared = self.prepared(asked)?;
        let watch = Stopwatch::start();
        let field = LightField::new(self.capture.clone(), prepared.offsets);
        let plan = plan(&field, asked, &self.reporter)?;
        // The plan has replaced every `auto` by a method.
        let options = RenderOptions { auto: AutoOptions::default(), ..plan.options };
        let planned = Planned { options, took: watch.elapsed() };
        self.save(PLANS, asked, &planned);
        Ok(planned)
    }

    /// Returns the cached measurements of a combination of options. If there are none, returns a [`CachedPoint`]
    /// without measurements.
    pub fn point(&self, options: &RenderOptions) -> CachedPoint {
        let cached = self.load::<CachedPoint>(POINTS, options);
        cached.filter(|cached| cached.options == *options).unwrap_or_else(|| CachedPoint {
            options: options.clone(),
            scores: BTreeMap::new(),
            reason: None,
            runs: Vec::new(),
        })
    }

    pub fn save_point(&self, point: &CachedPoint) {
        self.save(POINTS, &point.options, point);
    }

    /// Returns the cached measurement of this kind for these options. Returns `None` if no such measurement is cached.
    fn load<T: DeserializeOwned>(&self, kind: CacheKind, options: &impl Serialize) -> Option<T> {
        self.cache.load_json(kind, options)
    }

    /// Caches a measurement. If caching fails, for example because the capture is read-only, a note is shown once.
    fn save(&self, kind: CacheKind, options: &impl Serialize, value: &impl Serialize) {
        let saved = self.cache.save_json(kind, options, value);
        if let Err(error) = saved
            && !self.noted.swap(true, Ordering::Relaxed)
        {
            let sentence = "Measurements can't be cached for the next command";
            self.reporter.note(&format!("{sentence}: {error}."));
        }
    }
}

/// Returns the middle of the time span that all cameras with known clocks cover, in seconds from the capture's start.
/// If there is no such span, returns the middle of the reference camera's time span.
pub(super) fn middle_s(field: &LightField) -> f64 {
    let own_span = || field.span_s(field.capture().reference);
    let (first, last) = field.common_span_s().or_else(own_span).unwrap_or_default();
    0.5 * (first + last)
}
