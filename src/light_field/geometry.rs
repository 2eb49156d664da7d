//! Geometry of the scene at an instant for one view: the depth map of the view, and the depth maps of the cameras from
//! which the view is blended. The cameras' depth maps show which points are occluded in each camera.

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

/// Depth maps of a view, and of the cameras from which the view is blended.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Depth map of the view.
    pub view: DepthMap,
    /// Depth map of each camera, in the capture's order. `None`: no point counts as occluded in that camera.
    pub sources: Vec<Option<Arc<DepthMap>>>,
}

/// Returns the indices of the cameras nearest to a view, ordered by distance. The view's depth per pixel is estimated
/// from their images. With [`BlendMethod::SpaceTime`], the view is also blended from these cameras alone. The result is
/// empty if neither applies: the geometry proxy is built from features, and the view is blended by another method.
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

/// Returns whether the options choose depth per pixel, and not a proxy that is built from triangulated features.
fn has_pixel_depths(options: &RenderOptions) -> bool {
    matches!(options.proxy.method, ProxyMethod::Depth | ProxyMethod::SceneFlow)
}

/// Computes the geometry of the view of the camera `target` at the request's time.
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

/// Computes a view's geometry by stereo matching: the depths per pixel of the cameras nearest to the view, fused into
/// the view. `None` with fewer than two cameras, or if no camera's depths can be estimated.
fn by_stereo(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Option<Geometry>, RenderError> {
    let &Request { time_s, options, shape, .. } = request;
    let Some([cameras, estimated]) = stereo_cameras(field, target, request) else {
        return Ok(None);
    };
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
    let sources = OcclusionDepths { stereo, estimated: &estimated }.get(field, context)?;
    let view = fuse(target, &surfaces(field, &depths));
    Ok(Some(Geometry { view, sources: sources.to_vec() }))
}

/// Returns two ascending lists of camera indices: the cameras whose images are matched by stereo for a view, and the
/// subset of these cameras whose own depth maps are estimated. `None` with fewer than two cameras.
fn stereo_cameras(
    field: &LightField,
    target: &Camera,
    &Request { time_s, options, shape, .. }: &Request,
) -> Option<[Vec<usize>; 2]> {
    let mut cameras = nearest_cameras(field, target, time_s, options);
    if let Images::Given(given) = shape {
        cameras.retain(|&c| given.all().get(c).is_some_and(Option::is_some));
    }
    if cameras.len() < 2 {
        return None;
    }
    let mut estimated = cameras.clone();
    estimated.truncate(options.proxy.depth.cameras.max(1));
    // The indices are sorted, so that all views with the same nearest cameras share the cached depths.
    cameras.sort_unstable();
    estimated.sort_unstable();
    Some([cameras, estimated])
}

impl LightField {
    /// Returns whether a view's geometry can be computed without stereo matching: its proxy is built from features, its
    /// depths are cached, or there are too few cameras to match. Returns false for scene flow.
    pub(crate) fn has_cached_geometry(&self, target: &Camera, request: &Request) -> bool {
        let &Request { time_s, options, shape, .. } = request;
        match options.proxy.method {
            ProxyMethod::Plane | ProxyMethod::Mesh => true,
            ProxyMethod::SceneFlow => false,
            ProxyMethod::Depth => {
                let Some([cameras, estimated]) = stereo_cameras(self, target, request) else {
                    return true;
                };
                let stereo = Stereo {
                    cameras: &cameras,
                    instant: Instant::new(time_s, options),
                    images: &ImageSource::new(shape, options),
                    proxy: &options.proxy,
                };
                self.cached(&OcclusionDepths { stereo, estimated: &estimated }).is_some()
            }
        }
    }
}
