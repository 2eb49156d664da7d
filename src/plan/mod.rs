//! What a scene requires: for every stage, the lowest rung that holds an error budget, with the
//! number that decided it.
//!
//! | question | measured | decided |
//! |---|---|---|
//! | whose clocks are known? | clocks in `capture.json` | whether offsets are estimated |
//! | does anything move? | features' motion, blocks that change ([`Motion`]) | the sync rung |
//! | can refinement pay? | views between cameras both ways, cameras' own frames from their neighbours ([`Probe`]) | the sync rung |
//! | does it move all the time, in all cameras? | frame pairs of which no block changes | still pairs dissolved |
//! | on straight lines? | bend of the paths through four frames | curved paths |
//! | is a plane enough? | points' parallax against it ([`Shape`]) | the proxy |
//! | do cameras record alike? | the light of features in neighbouring cameras ([`crate::registration::Gains`]) | correction |
//! | do lenses distort? | the largest shift of a pixel | resampling |
//! | does the rig spread in two directions? | the camera centres' extent | references |
//!
//! The budget is a position error in pixels that a simplification may make; where views by two rungs
//! can be compared, what they can gain in decibels. All that is measured is
//! in the capture; its truth is never read.
//!
//! Known limits: one rung holds for all that changes in a capture; frames at its start, middle and end stand for
//! all; a body that shows fewer than a handful of corners and no changing block is not seen to move.

mod decide;
mod motion;
mod probe;
mod rig;
mod shape;

pub use motion::Motion;
pub(crate) use motion::changed_pixels;
pub use probe::Probe;
pub use rig::{Clocks, extent_ratio, largest_distortion_px};
pub use shape::Shape;

use crate::capture::Capture;
use crate::interpolation::Sync;
use crate::offset::{self, Offsets};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use crate::render::{LightField, RenderError, RenderOptions};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Which rungs are left to the capture, and how far they may be off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutoOptions {
    /// The sync rung, whether paths are curved, and whether still frame pairs are registered.
    pub sync: bool,
    /// The proxy's rung.
    pub proxy: bool,
    /// How far a lower rung may move what is seen, pixels. Larger: cheaper rungs; at 0 none is
    /// simplified.
    pub budget_px: f64,
    /// How much better, decibels, views by the dearer sync rung can be for the cheaper one still to do
    /// ([`Probe::possible_gain_db`]). Larger is cheaper; at 0 refinement is done for a hundredth of
    /// a decibel. Left-out cameras stand twice as far from their neighbours as views do, so that
    /// views can gain more than that: on eleven films up to three times as much.
    pub budget_db: f64,
}

impl Default for AutoOptions {
    fn default() -> Self {
        Self { sync: false, proxy: false, budget_px: 0.25, budget_db: 0.07 }
    }
}

impl AutoOptions {
    /// Whether anything is left to the capture.
    pub fn any(&self) -> bool {
        self.sync || self.proxy
    }
}

/// One stage's rung, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    pub stage: &'static str,
    pub rung: String,
    /// What was measured, and the limit that it was held against; pixels unless `because` says
    /// otherwise. `None` where the capture's description decides.
    pub measured: Option<f64>,
    pub limit: Option<f64>,
    /// One sentence with the number.
    pub because: String,
}

/// What a capture requires.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    pub budget_px: f64,
    pub decisions: Vec<Decision>,
    /// The options that were given, with the rungs that were decided.
    pub options: RenderOptions,
}

impl Plan {
    /// What a stage was given; `None` if there is no such stage.
    pub fn decision(&self, stage: &str) -> Option<&Decision> {
        self.decisions.iter().find(|d| d.stage == stage)
    }
}

/// Plans a capture, and opens its light field by that plan. Only the stages that `options.auto`
/// names are changed in the options; all are decided.
pub fn plan(
    capture: &Arc<Capture>,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<(Plan, LightField), RenderError> {
    let offsets = offset::known_or_kept_or_estimated(
        capture,
        &options.offset,
        &options.registration,
        reporter,
    )?;
    plan_with(capture, offsets, options, reporter)
}

/// The same with offsets that are known already.
pub fn plan_with(
    capture: &Arc<Capture>,
    offsets: Offsets,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<(Plan, LightField), RenderError> {
    let budget_px = options.auto.budget_px;
    let frames = FrameStore::new(capture.clone(), &options.registration);
    let motion = Motion::survey(&frames, reporter)?;
    let mut decided = options.clone();
    let mut decisions = vec![decide::offsets(&Clocks::of(capture))];

    let (mut sync, mut of_sync) = decide::sync(&motion, budget_px);
    let (curved, of_path) = decide::path(&motion, budget_px);
    decided.interpolation.curved &= curved || !options.auto.sync;
    let (still_change, of_still) = decide::still_pairs(&motion, budget_px);
    if options.auto.sync {
        let given = decided.interpolation.still_change;
        decided.interpolation.still_change = given.max(still_change);
    }

    let mut field = LightField::with_frames(frames, offsets, decided.clone());
    let (proxy, of_proxy) = decide::proxy(Shape::survey(&field)?.as_ref(), budget_px);
    if options.auto.proxy {
        decided.proxy.rung = proxy.unwrap_or(decided.proxy.rung);
    }
    let trial = |sync| RenderOptions { sync, ..decided.clone() };
    if sync == Sync::Refined
        && let Some(probe) = Probe::open(&field, &trial(sync))?
    {
        let [cheaper, dearer] = [Sync::Triangulation, sync].map(trial);
        let gain_db = probe.possible_gain_db(&mut field, &cheaper, &dearer)?;
        if let Some(gain_db) = gain_db {
            (sync, of_sync) = decide::refinement(gain_db, &probe.names(), options.auto.budget_db);
        }
    }
    if options.auto.sync {
        decided.sync = sync;
    }
    decisions.extend([of_sync, of_still, of_path, of_proxy]);
    decisions.push(decide::gains(field.gains()));
    decisions.push(decide::lenses(largest_distortion_px(capture)));
    decisions.push(decide::references(extent_ratio(capture)));
    decided.auto = AutoOptions { sync: false, proxy: false, ..options.auto.clone() };
    field.set_options(decided.clone());
    Ok((Plan { budget_px, decisions, options: decided }, field))
}

/// The value that this share of them is not over; `None` of none.
fn percentile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((share * last as f64).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_few_and_of_none() {
        assert_eq!(percentile(vec![], 0.95), None);
        assert_eq!(percentile(vec![3.0], 0.95), Some(3.0));
        assert_eq!(percentile((0..=100).map(f64::from).collect(), 0.95), Some(95.0));
    }
}
