//! What a scene requires: for every stage, the cheapest method that holds an error budget, with the
//! number that decided it.
//!
//! | question | measured | decided |
//! |---|---|---|
//! | whose clocks are known? | clocks in `capture.json` | whether offsets are estimated |
//! | does anything move? | features' motion, blocks that change ([`Motion`]) | the sync method |
//! | can refinement pay? | views between cameras by both methods, held-out frames ([`Probe`]) | the sync method |
//! | do other cameras' images pay? | held-out frames by both methods ([`Probe`]) | the sync method |
//! | do weights in time pay? | the same | the blend's method |
//! | does it move all the time, in all cameras? | frame pairs of which no block changes | whether still pairs are registered |
//! | on straight lines? | curvature of trajectories through four frames | curved trajectories |
//! | is a plane enough? | points' parallax against it ([`Shape`]) | the proxy method |
//! | do cameras record alike? | the light of features in neighbouring cameras ([`crate::registration::Gains`]) | correction |
//! | do lenses distort? | the largest shift of a pixel | resampling |
//! | does the rig spread in two directions? | the camera centres' extent | references |
//!
//! The budget is a position error in pixels that a simplification may make; where views by two
//! methods can be compared, it is what the dearer one can gain in decibels. All that is measured is
//! in the capture; its truth is never read. A plan reads a light field and changes nothing.
//!
//! Known limits: one method holds for all that changes in a capture; frames at its start, middle and
//! end stand for all; a body that shows fewer than a handful of corners and no changing block is not
//! seen to move.

mod decide;
pub(crate) mod held_out;
mod motion;
mod rig;
mod shape;

pub use decide::Decision;
pub use held_out::Probe;
pub use motion::Motion;
pub use shape::Shape;

use crate::interpolation::SyncMethod;
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::BlendMethod;
use crate::offset::clocks;
use crate::options::{AutoOptions, ProxyMethod, RenderOptions};
use crate::progress::Reporter;
use rig::{extent_ratio, largest_distortion_px};
use serde::Serialize;
use std::slice;

/// The methods that a capture requires.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// The error that a simplification may make, pixels.
    pub budget_px: f64,
    /// One decision a stage, in the stages' order.
    pub decisions: Vec<Decision>,
    /// The options that were given, with the methods that were decided; nothing is left to the
    /// capture in them.
    pub options: RenderOptions,
}

/// Plans the views of a light field. Only the stages that `options.auto` names are changed in the
/// options. All are decided, as far as they can be without views; views are rendered to decide the sync method and
/// the blend if those are left to the capture.
pub fn plan(
    field: &LightField,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<Plan, RenderError> {
    let capture = field.capture();
    let AutoOptions { budget_px, budget_db, .. } = options.auto;
    let motion = Motion::survey(&field.frames(&options.registration), reporter)?;
    let (sync, of_sync) = decide::sync(&motion, budget_px);
    let (curved, of_trajectory) = decide::trajectory(&motion, budget_px);
    let (still_change, of_still) = decide::still_pairs(&motion, budget_px);
    let mut decided = options.clone();
    if options.auto.sync {
        let interpolation = &mut decided.interpolation;
        interpolation.curved &= curved;
        interpolation.still_change = interpolation.still_change.max(still_change);
    }
    let shape = Shape::survey(field, &decided)?;
    let (proxy, of_proxy) = decide::proxy(shape.as_ref(), budget_px);
    if options.auto.proxy {
        decided.proxy.method = proxy.unwrap_or(decided.proxy.method);
    }
    let ByViews { sync: (sync, of_sync), blend: (blend, of_blend) } =
        by_views(field, &decided, (sync, of_sync))?;
    if options.auto.sync {
        decided.sync = sync;
    }
    if options.auto.blend {
        decided.blend.method = blend.unwrap_or(decided.blend.method);
    }
    decided.auto = AutoOptions { budget_px, budget_db, ..AutoOptions::default() };
    let decisions = vec![
        decide::offsets(&clocks(capture).0, capture.is_static()),
        of_sync,
        of_still,
        of_trajectory,
        of_proxy,
        of_blend,
        decide::gains(&field.gains(&options.registration)),
        decide::lenses(largest_distortion_px(capture)),
        decide::references(extent_ratio(capture)),
    ];
    Ok(Plan { budget_px, decisions, options: decided })
}

/// Decisions that need rendered views.
struct ByViews {
    sync: (SyncMethod, Decision),
    /// Without a method, the blend stays as it is.
    blend: (Option<BlendMethod>, Decision),
}

/// The sync method and the blend, where something moves and they are left to the capture; else the sync method stays as
/// motion decided it.
fn by_views(
    field: &LightField,
    options: &RenderOptions,
    mut sync: (SyncMethod, Decision),
) -> Result<ByViews, RenderError> {
    let AutoOptions { budget_db, .. } = options.auto;
    let is_probed = sync.0 == SyncMethod::Refined && (options.auto.sync || options.auto.blend);
    let probe = if is_probed { Probe::open(field, &options.registration)? } else { None };
    let Some(probe) = probe else {
        return Ok(ByViews { sync, blend: decide::blend(None, "") });
    };
    let frames = probe.names();
    let by = |sync: &SyncMethod| RenderOptions { sync: *sync, ..options.clone() };
    if options.auto.sync {
        let [cheaper, dearer] =
            [SyncMethod::Triangulation, SyncMethod::Refined].map(|sync| probing(by(&sync)));
        if let Some(gain_db) = probe.possible_gain_db(field, &cheaper, &dearer)? {
            sync = decide::refinement(gain_db, &frames, budget_db);
        }
    }
    let candidates = match options.auto.sync {
        // All cameras' images come from their depths.
        _ if options.proxy.method != ProxyMethod::Depth => &[],
        true if sync.0 == SyncMethod::Refined => {
            [SyncMethod::Refined, SyncMethod::AllCameras].as_slice()
        }
        false if options.sync.of_one_camera() == SyncMethod::Refined => {
            slice::from_ref(&options.sync)
        }
        _ => &[],
    };
    let options_of: Vec<RenderOptions> = candidates.iter().map(by).collect();
    let errors = probe.errors(&options_of)?.unwrap_or_default();
    if let [refined, all] = errors.as_slice() {
        let compared = [refined, all].map(|e| e.by(options.blend.method, options.auto.blend));
        if let Some(gain_db) = gain_db(compared) {
            sync = decide::all_cameras(gain_db, &frames, budget_db);
        }
    }
    let chosen = if options.auto.sync { sync.0 } else { options.sync };
    let of_chosen = candidates.iter().zip(&errors).find(|(method, _)| **method == chosen);
    let space_time_gain_db =
        of_chosen.and_then(|(_, e)| gain_db([e.in_space, e.in_space_and_time]));
    Ok(ByViews { sync, blend: decide::blend(space_time_gain_db, &frames) })
}

/// Gain of the second squared error over the first, decibels; `None` if an error is 0.
fn gain_db([error, other]: [f64; 2]) -> Option<f64> {
    (error > 0.0 && other > 0.0).then(|| 10.0 * (error / other).log10())
}

/// The value that this fraction of them does not exceed; `None` of none.
fn percentile(mut values: Vec<f64>, fraction: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((fraction * last as f64).round() as usize).copied()
}

/// A view's options as a probe takes them: many views are rendered to see what synchronization changes, and depth
/// per pixel takes several times as long as the mesh.
fn probing(mut options: RenderOptions) -> RenderOptions {
    if options.proxy.method == ProxyMethod::Depth {
        options.proxy.method = ProxyMethod::Mesh;
    }
    options
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
