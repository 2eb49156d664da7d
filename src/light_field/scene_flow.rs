//! Beyond the paper: views by scene flow. They are rendered from the depth and motion of frames that were filmed at
//! different times.

use super::graph::{LightField, Stage, StoredStage};
use super::matched_frames::{limits, matched_with};
use super::slots::{FrameId, Slot, Slots};
use super::stages::{FlowAgreements, FlowConfidence, FlowOptions, FrameFlow, Undistorted};
use super::still_depth::{StillCameras, Stills};
use super::{Context, RenderError, Request};
use crate::camera::Camera;
use crate::host::CacheKind;
#[cfg(feature = "python")]
use crate::host::on_workers;
use crate::lumigraph::DepthMap;
use crate::options::RenderOptions;
use crate::raster::Image;
use crate::scene_flow::{
    Agreements, Background, Detail, EstimatedFrame, Estimation, FlowFrame, FlowMap, FlowView,
    MappedFrame, MatchingImage, PyramidFrame, agreements, blend, confidence, quick_maps,
    uncompared,
};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The frames of a [`Slot`], each with its map of depth and motion.
type SlotMaps = Vec<(FrameId, Arc<FlowMap>)>;

/// Estimates the maps of depth and motion of all frames of a [`Slot`] together. `stills` is the static background of its
/// cameras. `None` if the range of the scene's depths is unknown.
pub(super) fn slot_maps(
    slots: &Slots,
    slot: Slot,
    stills: &StillCameras,
    options: FlowOptions,
    context: &Context,
) -> Result<Option<SlotMaps>, RenderError> {
    let field = slots.field;
    // Gains are computed once here, before threads request them in parallel.
    field.gains(options.registration);
    let mapped = slots.frames(slot);
    let others: Vec<Vec<FrameId>> = mapped.iter().map(|&id| matched_with(field, id)).collect();
    let Some(limits) = limits(field, &mapped, options)? else { return Ok(None) };
    let needed: BTreeSet<FrameId> = mapped.iter().chain(others.iter().flatten()).copied().collect();
    let load = |&(camera, frame): &FrameId| {
        context.check()?;
        let undistorted = Undistorted { camera, frame, registration: options.registration };
        let flow_frame = undistorted.get(field)?;
        // Each pyramid is used in two or three slots. Caching it would evict results that take longer to
        // compute.
        let pyramid = match stills.get(&camera) {
            Some(of_camera) => flow_frame.pyramid_before(&of_camera.still),
            None => flow_frame.pyramid(),
        };
        Ok(((camera, frame), (flow_frame, pyramid)))
    };
    let needed: Vec<FrameId> = needed.into_iter().collect();
    let frames: BTreeMap<FrameId, (Arc<FlowFrame>, Vec<MatchingImage>)> =
        needed.par_iter().map(load).collect::<Result<_, RenderError>>()?;
    let with_pyramid = |id: &FrameId| {
        let (frame, levels) = &frames[id];
        PyramidFrame { frame, levels }
    };
    let estimated = |(id, others): (&FrameId, &Vec<FrameId>)| {
        let frame = with_pyramid(id);
        let of_camera = stills.get(&id.0);
        EstimatedFrame {
            frame,
            others: others.iter().map(with_pyramid).collect(),
            background: of_camera.map(|s| Background::new(frame, &s.map)),
        }
    };
    let list: Vec<EstimatedFrame> = mapped.par_iter().zip(&others).map(estimated).collect();
    let baseline_m = field.matching_baseline_m();
    let proceed = || context.check().is_ok();
    let maps = Estimation { frames: &list, limits, baseline_m }.run(&proceed);
    context.check()?;
    Ok(Some(mapped.into_iter().zip(maps.into_iter().map(Arc::new)).collect()))
}

impl Stage for FrameFlow<'_> {
    type Output = FlowMap;
    const NAME: &'static str = "scene flow of a frame";

    fn bytes(map: &FlowMap) -> usize {
        map.bytes()
    }
}

impl StoredStage for FrameFlow<'_> {
    const KIND: CacheKind = CacheKind { name: "scene-flow", version: 21 };
}

impl Stage for FlowConfidence<'_> {
    /// The confidences in the depth and motion of the frame's pixels, from 1 to 255, row by row.
    type Output = Vec<u8>;
    const NAME: &'static str = "confidences";

    fn bytes(confidences: &Self::Output) -> usize {
        confidences.len()
    }
}

impl FlowConfidence<'_> {
    fn get(&self, field: &LightField) -> Arc<Vec<u8>> {
        if let Some(cached) = field.cached(self) {
            return cached;
        }
        let &Self { of, frames, options, mapped } = self;
        let others = (0..frames.len()).into_par_iter().filter(|&other| other != of);
        let agreements = others.map(|other| {
            let mapped = [&mapped[of], &mapped[other]];
            FlowAgreements { of: frames[of], by: frames[other], options, mapped }.get(field)
        });
        let agreements: Vec<Arc<Option<Agreements>>> = agreements.collect();
        let comparable: Vec<&Agreements> =
            agreements.iter().filter_map(|a| a.as_ref().as_ref()).collect();
        let map = mapped[of].map;
        field.insert(self, confidence([map.width, map.height], &comparable))
    }
}

impl Stage for FlowAgreements<'_> {
    /// How the second frame's map agrees with that of the first. `None` if the frames aren't compared.
    type Output = Option<Agreements>;
    const NAME: &'static str = "agreements";

    fn bytes(agreements: &Self::Output) -> usize {
        agreements.as_ref().map_or(0, Agreements::bytes)
    }
}

impl FlowAgreements<'_> {
    fn get(&self, field: &LightField) -> Arc<Option<Agreements>> {
        let [of, by] = self.mapped;
        field.cached(self).unwrap_or_else(|| field.insert(self, agreements(of, by)))
    }
}

/// A frame of the capture, with its map of depth and motion.
pub struct LoadedFrame {
    pub frame: Arc<FlowFrame>,
    pub map: Arc<FlowMap>,
}

impl LoadedFrame {
    pub fn mapped(&self) -> MappedFrame<'_> {
        MappedFrame { frame: &self.frame, map: &self.map }
    }
}

/// Returns the frames `frames` with their maps of depth and motion. Cached maps are read from memory or disk, and
/// missing maps are computed. `None` if the range of the scene's depths is unknown.
pub(super) fn load(
    field: &LightField,
    frames: &[FrameId],
    options: FlowOptions,
    context: &Context,
) -> Result<Option<Vec<LoadedFrame>>, RenderError> {
    let stored = |&frame: &FrameId| field.found(&FrameFlow { frame, options });
    let stored: Vec<Option<Arc<FlowMap>>> = frames.par_iter().map(stored).collect();
    let slots = stored.contains(&None).then(|| Slots::new(field));
    let mut computed: BTreeMap<FrameId, Arc<FlowMap>> = BTreeMap::new();
    let mut stills = Stills::default();
    let mut all = Vec::with_capacity(frames.len());
    for (&id, stored) in frames.iter().zip(stored) {
        if let Some(slots) = &slots
            && stored.is_none()
            && !computed.contains_key(&id)
        {
            let slot = slots.of(id);
            let of_group = stills.of(slots, slot, options, context)?;
            let maps = slot_maps(slots, slot, of_group, options, context)?;
            let Some(maps) = maps else { return Ok(None) };
            computed.extend(maps);
        }
        all.extend(stored.or_else(|| computed.get(&id).cloned()).map(|map| (id, map)));
    }
    // Backgrounds and maps are inserted after all slots are computed, since computing a slot evicts much of the cache.
    stills.keep(field, options);
    for (frame, map) in computed {
        field.insert(&FrameFlow { frame, options }, map);
    }
    let load = |((camera, frame), map): (FrameId, Arc<FlowMap>)| {
        let undistorted = Undistorted { camera, frame, registration: options.registration };
        Ok(LoadedFrame { frame: undistorted.get(field)?, map })
    };
    Ok(Some(all.into_par_iter().map(load).collect::<Result<_, RenderError>>()?))
}

/// The frames from which a view by scene flow is blended, with the confidences of their maps' pixels.
struct Blended {
    frames: Vec<LoadedFrame>,
    confidences: Vec<Arc<Vec<u8>>>,
}

/// Loads the frames of [`LightField::blended_frames`], and compares their maps as far as the view needs it. `None` if the range of
/// the scene's depths is unknown.
fn blended(
    field: &LightField,
    target: &Camera,
    (time_s, detail): (f64, Detail),
    options: &RenderOptions,
    context: &Context,
) -> Result<Option<Blended>, RenderError> {
    let ids = field.blended_frames(target, time_s);
    let options = FlowOptions::new(options);
    let Some(frames) = load(field, &ids, options, context)? else { return Ok(None) };
    context.check()?;
    let mapped: Vec<MappedFrame> = frames.iter().map(LoadedFrame::mapped).collect();
    let compared: Vec<usize> = match detail {
        Detail::Quick => quick_maps(&mapped, target, field.in_frames(time_s)),
        Detail::Full | Detail::WithMotion => (0..ids.len()).collect(),
    };
    let confidence = |of: usize| match compared.contains(&of) {
        true => FlowConfidence { of, frames: &ids, options, mapped: &mapped }.get(field),
        false => Arc::new(uncompared(mapped[of].map)),
    };
    let confidences = (0..ids.len()).into_par_iter().map(confidence).collect();
    Ok(Some(Blended { frames, confidences }))
}

#[cfg(feature = "python")]
impl LightField {
    /// Loads into memory what a quick view by scene flow is rendered from. Returns false if depth and motion of a frame would
    /// have to be estimated.
    pub(crate) fn load_flow(
        &self,
        target: &Camera,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<bool, RenderError> {
        let flow = FlowOptions::new(options);
        let frames = self.blended_frames(target, time_s);
        let is_there = |&frame: &FrameId| self.found(&FrameFlow { frame, options: flow }).is_some();
        on_workers(|| {
            if frames.is_empty() || !frames.par_iter().all(is_there) {
                return Ok(false);
            }
            let quick = (time_s, Detail::Quick);
            Ok(blended(self, target, quick, options, &Context::unattended())?.is_some())
        })
    }
}

/// Renders the view of the camera `target` by scene flow. `None` if the range of the scene's depths is unknown.
pub(super) fn flow_view(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<FlowView>, RenderError> {
    let &Request { time_s, options, detail, .. } = request;
    let blended = blended(field, target, (time_s, detail), options, context)?;
    let Some(Blended { frames, confidences }) = blended else { return Ok(None) };
    context.check()?;
    let mapped: Vec<MappedFrame> = frames.iter().map(LoadedFrame::mapped).collect();
    let confidences: Vec<&[u8]> = confidences.iter().map(|of| of.as_slice()).collect();
    let time = field.in_frames(time_s);
    Ok(Some(blend(&mapped, &confidences, target, time, detail)))
}

/// Computes the image of a recording camera at the request's time. If the camera has a frame at exactly this time, the
/// result is this frame. Otherwise, the result is the view that scene flow renders from the camera's place. Pixels that
/// this view doesn't cover are taken from the camera's frame nearest in time. `None` if the range of the scene's depths
/// is unknown.
pub(super) fn flow_image(
    field: &LightField,
    camera: usize,
    request: &Request,
    context: &Context,
) -> Result<Option<Image>, RenderError> {
    let (frame, later) = field.bracket(camera, request.time_s)?;
    let nearest = field.nearest_frame(camera, request.time_s).unwrap_or(frame);
    let image = field.capture().read_frame(camera, nearest)?;
    if frame == later {
        return Ok(Some(image));
    }
    let gains = field.gains(&request.options.registration);
    let nearest_s = field.capture().cameras[camera].clock.times_s[nearest];
    let own_s = field.own_time_s(camera, request.time_s);
    let mut image = gains.exposed_at(camera, [nearest_s, own_s], &image).unwrap_or(image);
    let target = &field.capture().cameras[camera].camera;
    let view = flow_view(field, target, request, context)?;
    let Some(FlowView { rendered, .. }) = view else {
        return Ok(None);
    };
    let is_gray = image.channels() == 1;
    let view = if is_gray { rendered.image.to_gray() } else { rendered.image.to_rgb() };
    let view = gains.as_filmed(camera, own_s, &view).unwrap_or(view);
    let channels = image.channels();
    let pixels = image.data_mut().chunks_exact_mut(channels);
    let views = view.data().chunks_exact(channels).zip(&rendered.coverage);
    for (pixel, (color, _)) in pixels.zip(views).filter(|(_, (_, is_covered))| **is_covered) {
        for (value, color) in pixel.iter_mut().zip(color) {
            *value = color.clamp(0.0, 1.0);
        }
    }
    Ok(Some(image))
}

/// Computes the depth map of the view that [`flow_view`] renders. `None` if the range of the scene's depths is unknown.
pub(super) fn flow_depths(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<DepthMap>, RenderError> {
    Ok(flow_view(field, target, request, context)?.map(|view| view.depths))
}
