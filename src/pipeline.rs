//! From a capture to a light field that views are taken from (Fig. 2): frames, offsets, and the
//! methods that the capture requires.

use crate::capture::Capture;
use crate::light_field::{LightField, RenderError};
use crate::offset::resolve_offsets;
use crate::options::RenderOptions;
use crate::plan::{Choice, Methods, PlanStage, load_plan, plan, save_plan};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use std::sync::Arc;

/// Opens a capture's light field, with the offsets that it needs: known clocks, else those cached in
/// its folder, else estimated now and cached. Says which on the reporter.
///
/// Frames are decoded, and gains estimated, once for offsets and views together.
pub fn open_field(
    capture: Arc<Capture>,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<LightField, RenderError> {
    let frames = FrameStore::new(capture, &options.registration);
    let offsets = resolve_offsets(&frames, &options.offset, reporter)?;
    Ok(LightField::with_frames(&frames, offsets))
}

/// The options with nothing left to the capture: where `options.auto` leaves methods to it, those
/// that it requires ([`plan`]), or those that an earlier plan decided for the same capture and options. Says
/// which on the reporter, and why if it plans.
pub fn resolved(
    field: &LightField,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<RenderOptions, RenderError> {
    if !options.auto.any() {
        return Ok(options.clone());
    }
    let auto = &options.auto;
    type OfMethods = fn(&Methods) -> Choice;
    let stages: [(bool, PlanStage, OfMethods); 3] = [
        (auto.sync, PlanStage::Sync, |methods| Choice::Sync(methods.sync)),
        (auto.proxy, PlanStage::Proxy, |methods| Choice::Proxy(methods.proxy)),
        (auto.blend, PlanStage::Blend, |methods| Choice::Blend(methods.blend)),
    ];
    let left = stages.into_iter().filter(|(is_auto, ..)| *is_auto);
    if let Some(methods) = load_plan(field, options) {
        let choices =
            left.map(|(_, stage, of)| format!("{} {}", stage.name(), of(&methods).name()));
        let choices: Vec<String> = choices.collect();
        reporter.note(&format!("Auto: {}, as planned before.", choices.join(", ")));
        return Ok(methods.put_into(options.clone()));
    }
    let plan = plan(field, options, reporter)?;
    // A read-only capture can be used all the same.
    if let Err(error) = save_plan(field, options, &Methods::of(&plan.options)) {
        reporter.note(&format!("The plan can't be cached for the next command: {error}."));
    }
    for (_, stage, _) in left {
        let Some(decision) = plan.decision(stage) else { continue };
        let (method, because) = (decision.choice.name(), &decision.because);
        reporter.note(&format!("Auto: {} {method}. {because}", stage.name()));
    }
    Ok(plan.options)
}
