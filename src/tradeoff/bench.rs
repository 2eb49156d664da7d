//! The bench: the capture, the reference images, and prepared light fields.

use super::store::{CachedPoint, PLANS, POINTS, PREPARATIONS, Planned, Prepared, Store};
use super::targets::{Against, Target, TargetView};
use super::{TimingClock, TradeoffError};
use crate::capture::Capture;
use crate::host::{Elapsed, Stopwatch};
use crate::light_field::LightField;
use crate::offset::{self, Offsets};
use crate::options::{AutoOptions, RenderOptions};
use crate::plan::plan;
use crate::progress::Reporter;
use crate::registration::FrameStore;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The bench that combinations are measured on.
pub(super) struct Bench<'a> {
    pub capture: &'a Arc<Capture>,
    pub store: Store,
    pub targets: Vec<Target>,
    /// The view that is timed.
    pub timed: TargetView,
    pub runs: usize,
    pub clock: TimingClock,
    pub reporter: &'a Reporter,
}

/// Offsets and registered frames for these options: cached from before, or computed now.
pub(super) fn prepared(
    capture: &Arc<Capture>,
    store: &Store,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<Prepared, TradeoffError> {
    let still_change = options.interpolation.still_change;
    let inputs = (&options.registration, &options.offset, still_change);
    if let Some(cached) = store.load::<Prepared>(PREPARATIONS, &inputs)
        && cached.offsets.fits(capture)
    {
        return Ok(cached);
    }
    let estimates = offset::clocks(capture).1 > 1 && !capture.is_static();
    let watch = Stopwatch::start();
    let offsets = if estimates {
        let frames = FrameStore::new(capture.clone(), &options.registration);
        offset::estimate(&frames, &options.offset, reporter)?.offsets
    } else {
        Offsets::known(capture)
    };
    let offsets_took = estimates.then(|| watch.elapsed());
    // Its frames are its own, so that decoding is in the time of registration.
    let field = LightField::new(capture.clone(), offsets.clone());
    let own_span = || field.span_s(capture.reference);
    let (first, last) = field.common_span_s().or_else(own_span).unwrap_or_default();
    let watch = Stopwatch::start();
    field.register(0.5 * (first + last), options)?;
    let registration_took = watch.elapsed();
    let prepared = Prepared { offsets, offsets_took, registration_took };
    store.save(PREPARATIONS, &inputs, &prepared);
    Ok(prepared)
}

impl Bench<'_> {
    /// The planned methods for options with `auto`, and the planning time.
    pub fn planned(&self, asked: &RenderOptions) -> Result<Planned, TradeoffError> {
        if asked.auto.stages().is_empty() {
            let took = Elapsed { wall_s: 0.0, cpu_s: 0.0 };
            return Ok(Planned { options: asked.clone(), took });
        }
        if let Some(cached) = self.store.load(PLANS, asked) {
            return Ok(cached);
        }
        let prepared = self.prepared(asked)?;
        let watch = Stopwatch::start();
        let field = LightField::new(self.capture.clone(), prepared.offsets);
        let plan = plan(&field, asked, self.reporter)?;
        // What was left to the capture is decided.
        let options = RenderOptions { auto: AutoOptions::default(), ..plan.options };
        let planned = Planned { options, took: watch.elapsed() };
        self.store.save(PLANS, asked, &planned);
        Ok(planned)
    }

    pub fn prepared(&self, options: &RenderOptions) -> Result<Prepared, TradeoffError> {
        prepared(self.capture, &self.store, options, self.reporter)
    }

    /// Stored measurements of a combination.
    pub fn cached(&self, options: &RenderOptions) -> CachedPoint {
        let cached = self.store.load::<CachedPoint>(POINTS, options);
        cached.filter(|cached| cached.options == *options).unwrap_or_else(|| CachedPoint {
            options: options.clone(),
            scores: BTreeMap::new(),
            reason: None,
        })
    }

    /// The kind of reference images that quality is measured against.
    pub fn against(&self) -> Against {
        let order = [Against::Truth, Against::HeldOut, Against::MostAccurate];
        let there = |a: &Against| self.targets.iter().any(|t| t.against == *a);
        order.into_iter().find(there).unwrap_or(Against::MostAccurate)
    }
}
