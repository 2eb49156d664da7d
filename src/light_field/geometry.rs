//! The scene's shape at an instant as a view needs it: its own depths, and what is occluded in the cameras that it is
//! blended from.

use super::depth::surfaces;
use super::graph::LightField;
use super::points::nearest;
use super::scene_flow::flow_depths;
use super::stages::{ImageSource, Images, Instant, OcclusionDepths, Stereo};
use super::{Context, RenderError, Request};
use crate::camera::Camera;
use crate::lumigraph::{BlendMethod, DepthMap};
use crate::options::{ProxyMethod, RenderOptions};
use crate::stereo::{FURTHER_CAMERAS, fuse};
use std::sync::Arc;

/// The depths of a view, and of the cameras that it is blended from.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Of the view.
    pub view: DepthMap,
    /// Of every camera, in the capture's order. `None`: nothing is occluded in it.
    pub sources: Vec<Option<Arc<DepthMap>>>,
}

/// The cameras whose images decide a view's depths or the weights of time, nearest first. None, if the proxy is built
/// from features and time has no weight.
pub(super) fn nearest_cameras(
    field: &LightField,
    target: &Camera,
    time_s: f64,
    options: &RenderOptions,
) -> Vec<usize> {
    if !has_pixel_depths(options) && options.blend.method != BlendMethod::SpaceTime {
        return Vec::new();
    }
    let mut cameras = nearest(field.capture(), &field.usable(time_s), target.center());
    cameras.truncate(options.proxy.depth.cameras + FURTHER_CAMERAS);
    cameras
}

/// Whether depths are estimated per pixel, and not taken from features.
fn has_pixel_depths(options: &RenderOptions) -> bool {
    matches!(options.proxy.method, ProxyMethod::Depth | ProxyMethod::SceneFlow)
}

/// The geometry of a view from `target`.
pub(super) fn geometry(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Geometry, RenderError> {
    let &Request { time_s, options, .. } = request;
    let cameras = field.capture().cameras.len();
    if request.uses_scene_flow()
        && let Some(view) = flow_depths(field, target, request, context)?
    {
        return Ok(Geometry { view, sources: vec![None; cameras] });
    }
    if has_pixel_depths(options)
        && let Some(geometry) = by_stereo(field, target, request, context)?
    {
        return Ok(geometry);
    }
    let proxy = field.proxy(target, time_s, options)?;
    Ok(Geometry { view: proxy.depth_map(target), sources: vec![None; cameras] })
}

/// The depths that the cameras nearest to the view agree on. `None` with fewer than two cameras, or if nothing is
/// known of the scene's depths.
fn by_stereo(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<Geometry>, RenderError> {
    let &Request { time_s, options, shape, .. } = request;
    let mut cameras = nearest_cameras(field, target, time_s, options);
    if let Images::Given(given) = shape {
        cameras.retain(|&c| given.all().get(c).is_some_and(Option::is_some));
    }
    if cameras.len() < 2 {
        return Ok(None);
    }
    let mut estimated = cameras.clone();
    estimated.truncate(options.proxy.depth.cameras.max(1));
    // Sorted, so that views from other places share them.
    cameras.sort_unstable();
    estimated.sort_unstable();
    let images = ImageSource::new(shape, options);
    let stereo = Stereo {
        cameras: &cameras,
        instant: Instant::new(time_s, options),
        images: &images,
        proxy: &options.proxy,
    };
    let depths = stereo.surfaces(field, &estimated, context)?;
    if depths.is_empty() {
        return Ok(None);
    }
    let sources = field.get(&OcclusionDepths { stereo, estimated: &estimated }, context)?;
    let view = fuse(target, &surfaces(field, &depths));
    Ok(Some(Geometry { view, sources: sources.to_vec() }))
}
