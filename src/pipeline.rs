//! The whole pipeline (Fig. 2 of the paper). It opens a capture as a light field, from which views are rendered, and
//! chooses methods automatically.

use crate::camera::Camera;
use crate::capture::Capture;
use crate::host::CacheKind;
use crate::light_field::{LightField, RenderError, Request, Viewpoint};
use crate::method::Method;
use crate::offset::resolve_offsets;
use crate::options::{AutoOptions, RenderOptions};
use crate::path::{CameraPath, PathError, PathScene, ReadyMadePath};
use crate::plan::{Decision, Plan, is_undecided, plan};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use std::sync::Arc;

/// Disk cache of plans. A plan is an automatic choice of methods. It is made by comparing dozens of rendered views;
/// with a cached plan, later commands need not render them again. If a change of the renderer changes views, the
/// version must be incremented.
const PLANS: CacheKind = CacheKind { name: "plans", version: 18 };

/// Opens a capture's light field. The offsets of the cameras' clocks are known from the capture, or are read from its
/// folder, or else are estimated and stored there ([`resolve_offsets`]). Notes on the reporter state which of these
/// applies. Cameras with unknown offsets are excluded from views, and a note names them.
///
/// The estimation and the views share the decoded frames and the estimated gains.
pub fn open_field(
    capture: Arc<Capture>,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<LightField, RenderError> {
    let frames = FrameStore::new(capture, &options.registration);
    let offsets = resolve_offsets(&frames, &options.offset, reporter)?;
    let field = LightField::with_frames(&frames, offsets);
    let cameras = field.offsets().cameras.iter().enumerate();
    let unknown = cameras.filter(|(index, _)| field.span_s(*index).is_none());
    let unknown: Vec<&str> = unknown.map(|(_, camera)| camera.id.as_str()).collect();
    if !unknown.is_empty() && !field.capture().is_static() {
        reporter.note(&format!("Left out, their clocks being unknown: {}.", unknown.join(", ")));
    }
    Ok(field)
}

/// Returns the options after the automatic choice of methods. [`plan`] chooses the methods and parameters of the stages
/// that `options.auto` names. The options of other stages are unchanged. If the choice can't affect views with these
/// options, no views are compared.
///
/// The choice is cached for the same offsets and options. Notes on the reporter state the chosen methods. For a choice
/// that wasn't cached, they also state the reasons.
pub fn resolved(
    field: &LightField,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<RenderOptions, RenderError> {
    if !is_undecided(options) {
        let AutoOptions { budget_px, budget_db, .. } = options.auto;
        let auto = AutoOptions { budget_px, budget_db, ..AutoOptions::default() };
        return Ok(RenderOptions { auto, ..options.clone() });
    }
    let stages = options.auto.stages();
    if let Some(planned) = planned_before(field, options) {
        let methods = [
            ("sync", planned.sync.name()),
            ("proxy", planned.proxy.method.name()),
            ("blend", planned.blend.method.name()),
        ];
        let decided = methods.iter().filter(|(stage, _)| stages.contains(stage));
        let decided: Vec<String> = decided.map(|(stage, name)| format!("{stage} {name}")).collect();
        reporter.note(&format!("Auto: {}, as planned before.", decided.join(", ")));
        return Ok(planned);
    }
    let plan = plan_again(field, options, reporter)?;
    for Decision { stage, method, because, .. } in &plan.decisions {
        if stages.contains(stage) {
            reporter.note(&format!("Auto: {stage} {method}. {because}"));
        }
    }
    Ok(plan.options)
}

/// Returns the result of an earlier automatic choice of methods from the cache: the options with the chosen methods.
/// `None` if no choice is cached for these options and for the light field's clock offsets.
pub fn planned_before(field: &LightField, options: &RenderOptions) -> Option<RenderOptions> {
    let cache = field.capture().cache().ok()?;
    let planned: Option<RenderOptions> = cache.load_json(PLANS, &(field.offsets(), options));
    planned.filter(|planned| planned.check().is_ok())
}

/// Chooses methods by [`plan`], even if an earlier choice is cached. The new choice is cached for later commands with
/// the same offsets and options.
pub fn plan_again(
    field: &LightField,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<Plan, RenderError> {
    let plan = plan(field, options, reporter)?;
    let cache = field.capture().cache().map_err(|error| error.to_string());
    let saved = cache.and_then(|cache| {
        let inputs = (field.offsets(), options);
        cache.save_json(PLANS, &inputs, &plan.options).map_err(|error| error.to_string())
    });
    // A plan that can't be stored, as in a read-only capture, is still used.
    if let Err(error) = saved {
        reporter.note(&format!("The plan can't be cached for the next command: {error}."));
    }
    Ok(plan)
}

/// Why a ready-made path can't be fitted to a capture.
#[derive(Debug, thiserror::Error)]
pub enum PathFitError {
    /// The depths of the scene can't be estimated.
    #[error(transparent)]
    Depths(#[from] RenderError),
    /// A time or the duration is out of range.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Returns a ready-made path of `duration_s` seconds, fitted to the rig, to the scene's depths and to the recording's
/// times.
///
/// `frozen_s` is the instant at which time is frozen, as in [`PathScene::frozen_s`]. This instant and the path's
/// instants are seconds from the capture's start. The views have the image size of the reference camera, and 0.55 to
/// 0.95 times the width of its field of view.
pub fn ready_made_path(
    field: &LightField,
    options: &RenderOptions,
    kind: ReadyMadePath,
    duration_s: f64,
    frozen_s: Option<f64>,
) -> Result<CameraPath, PathFitError> {
    let capture = field.capture();
    let lens = &capture.cameras[capture.reference].camera;
    let own_span = || field.span_s(capture.reference);
    let span_s = field.common_span_s().or_else(own_span).unwrap_or_default();
    let middle_s = frozen_s.unwrap_or(0.5 * (span_s.0 + span_s.1));
    let request = Request::new(Viewpoint::View(lens), middle_s, options);
    let depths_m = field.depth_range_m(lens, &request)?;
    let cameras: Vec<Camera> = capture.cameras.iter().map(|c| c.camera.clone()).collect();
    let scene = PathScene { cameras: &cameras, lens, depths_m, span_s, frozen_s, duration_s };
    Ok(kind.path(&scene)?)
}
