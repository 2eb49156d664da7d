//! Beyond the paper: views from the depth and motion of frames, each at its own time.

use super::depth::{range, scene_points};
use super::graph::{LightField, Stage};
use super::points::nearest;
use super::stages::{Instant, SceneFlow, Undistorted};
use super::{Context, RenderError, Request};
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use crate::raster::Image;
use crate::scene_flow::{Estimation, FlowFrame, FlowMap, FlowView, Limits, MappedFrame, blend};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Maximum number of cameras from whose frames a view is blended.
const MAX_CAMERAS: usize = 8;
/// Maximum number of other cameras with whose frames a frame is matched.
const MAX_PARTNERS: usize = 7;
/// Maximum motion a frame of the search, as a fraction of the image's longer side.
const MAX_SPEED: f64 = 0.125;
/// Factor by which the search extends the range of the features' inverse depths, at both ends.
const DEPTH_MARGIN: f64 = 1.5;

/// A frame of the capture.
type FrameId = (usize, usize);

impl Stage for Undistorted<'_> {
    type Output = FlowFrame;
    const NAME: &'static str = "undistorted frame";

    fn bytes(frame: &FlowFrame) -> usize {
        frame.bytes()
    }

    fn compute(&self, field: &LightField, _: &Context) -> Result<FlowFrame, RenderError> {
        let &Self { camera, frame, registration } = self;
        let image = field.capture().read_frame(camera, frame)?;
        let gains = field.gains(registration);
        let image = gains.corrected(camera, &image).unwrap_or(image);
        let time = field.in_frames(field.times_s(camera)[frame]);
        Ok(FlowFrame::new(&field.capture().cameras[camera].camera, &image, time))
    }
}

impl Stage for SceneFlow<'_> {
    /// One map a frame; `None` if nothing is known of the scene's depths.
    type Output = Option<Vec<FlowMap>>;
    const NAME: &'static str = "scene flow";

    fn bytes(maps: &Self::Output) -> usize {
        maps.as_ref().map_or(1, |maps| maps.iter().map(FlowMap::bytes).sum())
    }

    fn compute(&self, field: &LightField, context: &Context) -> Result<Self::Output, RenderError> {
        let mapped = self.frames;
        let others: Vec<Vec<FrameId>> = mapped.iter().map(|&id| matched_with(field, id)).collect();
        let Some(limits) = self.limits(field)? else { return Ok(None) };
        let needed: BTreeSet<FrameId> =
            mapped.iter().chain(others.iter().flatten()).copied().collect();
        let load = |&(camera, frame): &FrameId| {
            context.check()?;
            let stage = Undistorted { camera, frame, registration: self.registration };
            Ok(((camera, frame), field.get(&stage, context)?))
        };
        let needed: Vec<FrameId> = needed.into_iter().collect();
        let frames: BTreeMap<FrameId, Arc<FlowFrame>> =
            needed.par_iter().map(load).collect::<Result<_, RenderError>>()?;
        let list: Vec<(&FlowFrame, Vec<&FlowFrame>)> = mapped
            .iter()
            .zip(&others)
            .map(|(id, others)| (&*frames[id], others.iter().map(|o| &*frames[o]).collect()))
            .collect();
        let baseline_m = 2.0 * field.spacing_m();
        let proceed = || context.check().is_ok();
        let maps = Estimation { frames: &list, limits, baseline_m }.run(&proceed);
        context.check()?;
        Ok(Some(maps))
    }
}

impl SceneFlow<'_> {
    /// The ranges of the search, from the features at the time of one of the frames. `None` if there are none, or if all
    /// cameras stand at one place.
    fn limits(&self, field: &LightField) -> Result<Option<Limits>, RenderError> {
        let Some(&(camera, frame)) = self.frames.get(self.frames.len() / 2) else {
            return Ok(None);
        };
        let time_s = field.times_s(camera)[frame];
        if field.spacing_m() == 0.0 {
            return Ok(None);
        }
        let Self { registration, still_change, .. } = *self;
        let instant = Instant { time_s, registration, still_change };
        let filmed = &field.capture().cameras;
        let points = scene_points(field, &filmed[camera].camera, instant, self.proxy)?;
        let Some(points) = points else { return Ok(None) };
        let cameras: BTreeSet<usize> = self.frames.iter().map(|id| id.0).collect();
        let ranges = cameras.iter().filter_map(|&c| range(&points, &filmed[c].camera));
        let both = ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let side = cameras.iter().map(|&c| filmed[c].camera.width.max(filmed[c].camera.height));
        let max_speed = (MAX_SPEED * side.max().unwrap_or(0) as f64) as f32;
        Ok(both.map(|[min, max]| Limits {
            inverse_depth: [(min / DEPTH_MARGIN) as f32, (max * DEPTH_MARGIN) as f32],
            max_speed,
        }))
    }
}

/// The frames that a frame is matched with: its own camera's before and after, and of the nearest other cameras the one
/// nearest in time.
fn matched_with(field: &LightField, (camera, frame): FrameId) -> Vec<FrameId> {
    let count = field.times_s(camera).len();
    let own = [frame.checked_sub(1), Some(frame + 1).filter(|&k| k < count)];
    let mut matched: Vec<FrameId> = own.into_iter().flatten().map(|k| (camera, k)).collect();
    let filmed = &field.capture().cameras;
    let others: Vec<usize> =
        (0..filmed.len()).filter(|&c| c != camera && !field.times_s(c).is_empty()).collect();
    let time_s = field.times_s(camera)[frame];
    for other in nearest(field.capture(), &others, filmed[camera].camera.center())
        .into_iter()
        .take(MAX_PARTNERS)
    {
        matched.extend(field.nearest_frame(other, time_s).map(|k| (other, k)));
    }
    matched
}

/// The view from `target` by the maps of the frames nearest in time, one of each of the nearest cameras. `None` if nothing
/// is known of the scene's depths.
pub(super) fn flow_view(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<FlowView>, RenderError> {
    let &Request { time_s, options, .. } = request;
    let registration = &options.registration;
    let mut cameras = nearest(field.capture(), &field.usable(time_s), target.center());
    cameras.truncate(MAX_CAMERAS);
    let frame = |c: usize| field.nearest_frame(c, time_s).map(|k| (c, k));
    let mut frames: Vec<FrameId> = cameras.into_iter().filter_map(frame).collect();
    // Sorted, so that views from other places share them.
    frames.sort_unstable();
    let stage = SceneFlow {
        frames: &frames,
        registration,
        still_change: options.interpolation.still_change,
        proxy: &options.proxy,
    };
    let maps = field.get(&stage, context)?;
    let Some(maps) = maps.as_ref() else { return Ok(None) };
    let undistorted = |&(camera, frame): &FrameId| {
        field.get(&Undistorted { camera, frame, registration }, context)
    };
    let frames: Vec<Arc<FlowFrame>> =
        frames.iter().map(undistorted).collect::<Result<_, RenderError>>()?;
    context.check()?;
    let mapped: Vec<MappedFrame> =
        frames.iter().zip(maps).map(|(frame, map)| MappedFrame { frame, map }).collect();
    Ok(Some(blend(&mapped, target, field.in_frames(time_s))))
}

/// A filming camera's image: its own frame where it has one at that very time, else the view from its place. Pixels that no
/// camera sees are those of its nearest frame. `None` if nothing is known of the scene's depths.
pub(super) fn flow_image(
    field: &LightField,
    camera: usize,
    request: &Request,
    context: &Context,
) -> Result<Option<Image>, RenderError> {
    let (frame, later) = field.bracket(camera, request.time_s)?;
    let nearest = field.nearest_frame(camera, request.time_s).unwrap_or(frame);
    let mut image = field.capture().read_frame(camera, nearest)?;
    if frame == later {
        return Ok(Some(image));
    }
    let target = &field.capture().cameras[camera].camera;
    let Some(FlowView { rendered, .. }) = flow_view(field, target, request, context)? else {
        return Ok(None);
    };
    let gains = field.gains(&request.options.registration);
    let is_gray = image.channels() == 1;
    let view = if is_gray { rendered.image.to_gray() } else { rendered.image.to_rgb() };
    let view = gains.as_filmed(camera, &view).unwrap_or(view);
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

/// The depths of [`flow_view`].
pub(super) fn flow_depths(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<DepthMap>, RenderError> {
    Ok(flow_view(field, target, request, context)?.map(|view| view.depths))
}
