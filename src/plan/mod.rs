//! Automatic choice of methods. For every stage of the pipeline, the plan chooses the cheapest method whose error on
//! this capture is within a budget. Each decision records the measured number on which it is based.
//!
//! | question | measured | decided |
//! |---|---|---|
//! | which cameras have known clocks? | clocks in `capture.json` | whether offsets are estimated |
//! | does anything move? | motion of features, image blocks that change ([`Motion`]) | the sync method |
//! | can refinement gain enough? | views with and without refinement, errors on held-out frames ([`Probe`]) | the sync method |
//! | do images from all cameras gain enough? | errors on held-out frames with and without them ([`Probe`]) | the sync method |
//! | do the cameras stand around the scene? | angle between neighbouring cameras | the proxy method |
//! | does scene flow gain over depth per pixel? | errors on held-out frames with both ([`Probe`]) | the proxy method |
//! | do blending weights in time gain? | errors on held-out frames with and without them ([`Probe`]) | the blending method |
//! | does something move in every frame pair? | frame pairs in which no image block changes | whether frame pairs without motion are registered |
//! | are trajectories straight? | curvature of trajectories through four frames | whether trajectories are curved |
//! | is a plane sufficient? | parallax of points relative to a plane ([`Shape`]) | the proxy method |
//! | do cameras have equal gains? | linear light of the same features in several cameras ([`crate::registration::Gains`]) | whether gains are corrected |
//! | do lenses distort? | the largest displacement of a pixel by distortion | whether images are resampled |
//! | does the rig spread in two directions? | extent of the camera centres | against which cameras tracks are tested by epipolar geometry |
//!
//! There are two error budgets. `budget_px` is the position error, in pixels, that a cheaper method may cause.
//! `budget_db` applies where rendered views are compared: a slower method is chosen only if its PSNR gain, in decibels,
//! exceeds this budget. The ground truth of a simulated capture is not used. Planning changes neither the capture nor
//! the light field.
//!
//! Known limits: all moving objects of a capture get the same method. Motion is measured only in frames at the start,
//! the middle and the end of the recording. An object with fewer than five corner features and no changing image block
//! is not detected as moving.

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

/// The methods of all stages that were chosen automatically for a capture, with the reasons.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// Maximum position error in the image that a cheaper method may cause, in pixels.
    pub budget_px: f64,
    /// One decision per stage of the pipeline.
    pub decisions: Vec<Decision>,
    /// The options of all stages with the chosen methods. No method in them is left to be chosen automatically.
    pub options: RenderOptions,
}

/// Returns whether an automatic choice of methods can change rendered views. `options.auto` has the stages whose
/// methods are chosen automatically. The choice of a proxy method always has an effect. With scene flow as the proxy,
/// the sync method and the blending method have no effect. The choice of the blending method has an effect only with
/// depth per pixel and with the sync methods `Refined` and `AllCameras`.
pub fn is_undecided(options: &RenderOptions) -> bool {
    let AutoOptions { sync, proxy, blend, .. } = options.auto;
    let is_refined = options.sync.of_one_camera() == SyncMethod::Refined;
    match options.proxy.method {
        _ if proxy => true,
        ProxyMethod::SceneFlow => false,
        ProxyMethod::Depth => sync || (blend && is_refined),
        ProxyMethod::Plane | ProxyMethod::Mesh => sync,
    }
}

/// Chooses the methods of all stages by measurements of a light field's capture. In the returned options, the stages
/// that `options.auto` names have the chosen methods, and other stages have the methods of `options`.
///
/// Views are rendered for comparison only if the motion in the images requires [`SyncMethod::Refined`],
/// [`is_undecided`] is true, and scene flow isn't the proxy already. Otherwise, the motion alone decides the sync method, and
/// the blending method is unchanged. Without a comparison, scene flow is chosen only in a wide array
/// ([`LightField::wide_angle_rad`]): if no point could be triangulated, or if a plane doesn't suffice and the motion requires
/// refinement. If neighbouring cameras are more than [`MAX_MATCHED_ANGLE_RAD`](crate::light_field::MAX_MATCHED_ANGLE_RAD)
/// apart, a plane is chosen in its place.
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
    let (proxy, mut of_proxy) = decide::proxy(shape.as_ref(), budget_px);
    let of_motion = if options.auto.sync { sync } else { options.sync.of_one_camera() };
    let mut is_compared = true;
    if options.auto.proxy {
        decided.proxy.method = proxy.unwrap_or(decided.proxy.method);
        // In a wide array, a mesh can't stand for bodies, so that views over it say nothing about refinement.
        let is_needed = match proxy {
            Some(ProxyMethod::Plane) => false,
            Some(_) => of_motion == SyncMethod::Refined,
            None => true,
        };
        if let Some(wide) = decide::wide(field.wide_angle_rad()).filter(|_| is_needed) {
            (decided.proxy.method, of_proxy) = wide;
            is_compared = false;
        }
    }
    let comparison = reporter.phase("comparing methods on held-out frames");
    let ByViews { sync: (sync, of_sync), blend: (blend, of_blend), proxy } =
        by_views(field, &decided, (sync, of_sync), is_compared)?;
    drop(comparison);
    if let Some((proxy, decision)) = proxy {
        decided.proxy.method = proxy;
        of_proxy = decision;
    }
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

/// The decisions that are made by comparing rendered views with each other and with held-out frames.
struct ByViews {
    sync: (SyncMethod, Decision),
    /// The chosen blending method, with the reason. If the method is `None`, the blending method stays unchanged.
    blend: (Option<BlendMethod>, Decision),
    /// The chosen proxy method, with the reason. If `None`, the proxy method stays unchanged.
    proxy: Option<(ProxyMethod, Decision)>,
}

/// Chooses the sync method, the blending method and the proxy (depth per pixel or scene flow) by comparing rendered
/// views. The sync method and the proxy are chosen only if `options.auto` names these stages. `sync` is the sync method
/// that the motion in the images requires, with its decision. If this method isn't [`SyncMethod::Refined`], if scene flow is
/// the proxy already, or if `is_compared` is false, nothing is rendered, and `sync` is returned unchanged.
fn by_views(
    field: &LightField,
    options: &RenderOptions,
    mut sync: (SyncMethod, Decision),
    is_compared: bool,
) -> Result<ByViews, RenderError> {
    let AutoOptions { budget_db, .. } = options.auto;
    let has_effect = options.proxy.method != ProxyMethod::SceneFlow && is_undecided(options);
    let is_probed = is_compared && sync.0 == SyncMethod::Refined && has_effect;
    let probe = if is_probed { Probe::open(field, &options.registration)? } else { None };
    let Some(probe) = probe else {
        return Ok(ByViews { sync, blend: decide::blend(None, ""), proxy: None });
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
        // The sync method `AllCameras` needs depth per pixel.
        _ if options.proxy.method != ProxyMethod::Depth => &[],
        true if sync.0 == SyncMethod::Refined => {
            [SyncMethod::Refined, SyncMethod::AllCameras].as_slice()
        }
        false if options.sync.of_one_camera() == SyncMethod::Refined => {
            slice::from_ref(&options.sync)
        }
        _ => &[],
    };
    let mut options_of: Vec<RenderOptions> = candidates.iter().map(by).collect();
    if options.auto.proxy && !candidates.is_empty() {
        options_of.push(by_scene_flow(options));
    }
    let mut errors = probe.errors(&options_of)?.unwrap_or_default();
    let of_scene_flow = if errors.len() > candidates.len() { errors.pop() } else { None };
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
    let errors = of_chosen.map(|(_, e)| e.by(options.blend.method, options.auto.blend));
    let flow_gain_db = errors.zip(of_scene_flow).and_then(|(e, flow)| gain_db([e, flow.in_space]));
    let proxy = flow_gain_db.map(|gain_db| decide::scene_flow(gain_db, &frames, budget_db));
    Ok(ByViews { sync, blend: decide::blend(space_time_gain_db, &frames), proxy })
}

/// Returns the options with scene flow as the proxy.
fn by_scene_flow(options: &RenderOptions) -> RenderOptions {
    let mut options = options.clone();
    options.proxy.method = ProxyMethod::SceneFlow;
    options
}

/// Returns the PSNR gain, in decibels, of a view with the second squared error over a view with the first squared
/// error. The gain is positive if the second error is smaller. Returns `None` if one of the errors is 0.
fn gain_db([error, other]: [f64; 2]) -> Option<f64> {
    (error > 0.0 && other > 0.0).then(|| 10.0 * (error / other).log10())
}

/// Returns a percentile of the values by the nearest rank. `fraction` is from 0 to 1. Returns `None` without values.
fn percentile(mut values: Vec<f64>, fraction: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((fraction * last as f64).round() as usize).copied()
}

/// Returns the options with which views are rendered to compare sync methods. They equal the given options, except that
/// a mesh replaces depth per pixel as the proxy. Depth per pixel takes several times as long.
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
    fn methods_without_an_effect_are_not_chosen() {
        let undecided = |proxy: ProxyMethod, sync: SyncMethod, auto: AutoOptions| {
            let mut options = RenderOptions { sync, auto, ..RenderOptions::default() };
            options.proxy.method = proxy;
            is_undecided(&options)
        };
        let all = AutoOptions::all();
        let of_views = AutoOptions { proxy: false, ..all.clone() };
        let of_blend = AutoOptions { sync: false, ..of_views.clone() };
        for proxy in [ProxyMethod::Plane, ProxyMethod::Mesh, ProxyMethod::Depth] {
            assert!(undecided(proxy, SyncMethod::Nearest, all.clone()));
            assert!(undecided(proxy, SyncMethod::Nearest, of_views.clone()));
            assert!(!undecided(proxy, SyncMethod::Nearest, of_blend.clone()));
            let is_depth = proxy == ProxyMethod::Depth;
            assert_eq!(undecided(proxy, SyncMethod::AllCameras, of_blend.clone()), is_depth);
            assert!(!undecided(proxy, SyncMethod::Refined, AutoOptions::default()));
        }
        assert!(undecided(ProxyMethod::SceneFlow, SyncMethod::Refined, all));
        assert!(!undecided(ProxyMethod::SceneFlow, SyncMethod::Refined, of_views));
    }

    #[test]
    fn percentiles_of_few_and_of_none() {
        assert_eq!(percentile(vec![], 0.95), None);
        assert_eq!(percentile(vec![3.0], 0.95), Some(3.0));
        assert_eq!(percentile((0..=100).map(f64::from).collect(), 0.95), Some(95.0));
    }
}
