//! Estimation of the cameras' depth per pixel at an instant, by stereo matching of their images.

use super::camera_image::images_of;
use super::graph::{LightField, Stage};
use super::points::nearest;
use super::stages::{CameraDepth, Instant, OcclusionDepths, Stereo};
use super::{Context, RenderError};
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use crate::options::{ProxyMethod, ProxyOptions, RenderOptions};
use crate::stereo::{InverseDepths, Matcher, StereoImage, Surface, fuse};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use std::sync::Arc;

/// Margin by which the range of the triangulated points' inverse depths is widened at both ends for stereo matching, as
/// a fraction of the range. Surfaces may be nearer or farther than all triangulated points.
const RANGE_MARGIN: f64 = 0.1;
/// Spacing of the pixels at which the depth map of the scene's mesh proxy is sampled, pixels. The samples give the
/// scene's range of depths.
const RANGE_STEP_PX: usize = 8;
/// Smallest inverse depth that stereo matching searches, 1/m.
const MIN_INVERSE_DEPTH: f64 = 1e-5;
/// Memory that a stereo matcher needs, bytes per pixel of its cameras' images.
const MATCHER_BYTES: usize = 16;

/// A stereo matcher with its prepared images, and each camera's search range of inverse depths.
pub(super) struct PreparedStereo {
    matcher: Matcher,
    /// For each camera whose image is matched, the minimum and maximum inverse depth to be searched, 1/m. `None` if no
    /// scene point is in front of the camera.
    ranges: Vec<Option<[f64; 2]>>,
    bytes: usize,
}

impl Stage for Stereo<'_> {
    /// The prepared stereo matcher. `None` if the range of the scene's depths is unknown.
    type Output = Option<PreparedStereo>;
    const NAME: &'static str = "stereo";

    fn bytes(prepared: &Option<PreparedStereo>) -> usize {
        prepared.as_ref().map_or(1, |p| p.bytes)
    }
}

impl Stereo<'_> {
    fn get(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Arc<Option<PreparedStereo>>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        Ok(field.insert(self, self.prepared(field, context)?))
    }

    fn prepared(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Option<PreparedStereo>, RenderError> {
        let filmed = &field.capture().cameras;
        let reference = &filmed[field.capture().reference].camera;
        let middle = nearest(field.capture(), self.cameras, reference.center())[0];
        let middle = &filmed[middle].camera;
        let Some(points) = scene_points(field, middle, self.instant, self.proxy)? else {
            return Ok(None);
        };
        let cameras = || self.cameras.iter().map(|&c| &filmed[c].camera);
        let ranges: Vec<_> = cameras().map(|camera| range(&points, camera)).collect();
        let of_all = ranges.iter().flatten().fold([f64::INFINITY, 0.0], |[low, high], r| {
            [f64::min(low, r[0]), f64::max(high, r[1])]
        });
        if of_all[1] <= 0.0 {
            return Ok(None);
        }
        let images = images_of(field, self.images, self.cameras, self.instant, context)?;
        let view = |&c: &usize| {
            let image = &images[c].as_deref()?.image;
            Some(StereoImage { camera: &filmed[c].camera, image })
        };
        let views: Vec<StereoImage> = self.cameras.iter().filter_map(view).collect();
        let matcher = Matcher::new(&views, of_all, &self.proxy.depth);
        let pixels: usize = cameras().map(|c| c.width * c.height).sum();
        Ok(Some(PreparedStereo { matcher, ranges, bytes: MATCHER_BYTES * pixels }))
    }

    /// Estimates the depths of all pixels of `cameras`, which must be among the cameras whose images are matched
    /// ([`Self::cameras`]). Cameras whose depths can't be estimated are omitted from the result.
    pub fn surfaces(
        &self,
        field: &LightField,
        cameras: &[usize],
        context: &Context,
    ) -> Result<Vec<EstimatedDepth>, RenderError> {
        // The matcher is computed once here, before threads request it in parallel.
        self.get(field, context)?;
        let depth = |&camera: &usize| {
            Ok((camera, CameraDepth { stereo: *self, camera }.get(field, context)?))
        };
        let mut depths: Vec<EstimatedDepth> =
            cameras.par_iter().map(depth).collect::<Result<_, RenderError>>()?;
        depths.retain(|(_, depths)| depths.is_some());
        Ok(depths)
    }
}

/// Index of a camera, and the inverse depths of its pixels. The inverse depths are `None` if they can't be estimated.
pub(super) type EstimatedDepth = (usize, Arc<Option<InverseDepths>>);

impl Stage for CameraDepth<'_> {
    /// Inverse depths of the camera's pixels. `None` if all cameras stand at one place, or if the range of the scene's
    /// depths is unknown.
    type Output = Option<InverseDepths>;
    const NAME: &'static str = "depth";

    fn bytes(depths: &Option<InverseDepths>) -> usize {
        1 + depths.as_ref().map_or(0, |d| size_of_val(d.values.as_slice()))
    }
}

impl CameraDepth<'_> {
    fn get(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Arc<Option<InverseDepths>>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        context.check()?;
        let stereo = self.stereo.get(field, context)?;
        let index = self.stereo.cameras.iter().position(|&c| c == self.camera);
        let depths = (*stereo)
            .as_ref()
            .zip(index)
            .and_then(|(stereo, index)| stereo.matcher.depths(index, stereo.ranges[index]?));
        Ok(field.insert(self, depths))
    }
}

impl Stage for OcclusionDepths<'_> {
    /// One depth map per camera, in the capture's order. `None` for cameras whose images aren't matched by stereo.
    type Output = Vec<Option<Arc<DepthMap>>>;
    const NAME: &'static str = "occlusion depths";

    fn bytes(maps: &Self::Output) -> usize {
        let bytes = |map: &Arc<DepthMap>| size_of_val(map.data());
        maps.iter().flatten().map(bytes).sum()
    }
}

impl OcclusionDepths<'_> {
    pub fn get(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Arc<Vec<Option<Arc<DepthMap>>>>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let depths = self.stereo.surfaces(field, self.estimated, context)?;
        let surfaces = surfaces(field, &depths);
        let filmed = &field.capture().cameras;
        let mut maps = vec![None; filmed.len()];
        for &c in self.stereo.cameras {
            let camera = &filmed[c].camera;
            let own = depths.iter().find(|(own, _)| *own == c);
            let map = own.and_then(|(_, depths)| Some(Option::as_ref(depths)?.depth_map(camera)));
            maps[c] = Some(Arc::new(map.unwrap_or_else(|| fuse(camera, &surfaces))));
        }
        Ok(field.insert(self, maps))
    }
}

/// Converts the estimated depths of several cameras to surfaces for [`fuse`]. Cameras without depths are omitted.
pub(super) fn surfaces<'a>(
    field: &'a LightField,
    depths: &'a [EstimatedDepth],
) -> Vec<Surface<'a>> {
    let filmed = &field.capture().cameras;
    let surface = |(camera, depths): &'a EstimatedDepth| {
        Some(Surface { camera: &filmed[*camera].camera, depths: Option::as_ref(depths)? })
    };
    depths.iter().filter_map(surface).collect()
}

/// Returns points of the scene at an instant, in world coordinates, metres. They are samples of the mesh proxy in the
/// view of the camera `middle`. `None` if no feature points are in front of this camera.
pub(super) fn scene_points(
    field: &LightField,
    middle: &Camera,
    instant: Instant,
    proxy: &ProxyOptions,
) -> Result<Option<Vec<Point3<f64>>>, RenderError> {
    let mut options = RenderOptions {
        registration: instant.registration.clone(),
        proxy: ProxyOptions { method: ProxyMethod::Mesh, ..proxy.clone() },
        ..RenderOptions::default()
    };
    options.interpolation.still_change = instant.still_change;
    match field.proxy(middle, instant.time_s, &options) {
        Ok(proxy) => Ok(Some(sampled(&proxy.depth_map(middle), middle))),
        Err(RenderError::NoPoints | RenderError::NothingSeen) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Returns the points that a depth map shows at every [`RANGE_STEP_PX`]-th pixel of every [`RANGE_STEP_PX`]-th row, in
/// world coordinates, metres.
fn sampled(depths: &DepthMap, camera: &Camera) -> Vec<Point3<f64>> {
    let mut points = Vec::new();
    for y in (0..camera.height).step_by(RANGE_STEP_PX) {
        for x in (0..camera.width).step_by(RANGE_STEP_PX) {
            let depth = f64::from(depths.row(y)[x]);
            let ray = camera.ray_world(&Point2::new(x as f64 + 0.5, y as f64 + 0.5));
            if let Some(ray) = ray.filter(|_| depth.is_finite()) {
                points.push(camera.center() + ray * depth);
            }
        }
    }
    points
}

/// Returns the minimum and the maximum inverse depth, 1/m, of `points` as seen from a camera. The range is widened by
/// [`RANGE_MARGIN`]. `None` if no point is in front of the camera.
pub(super) fn range(points: &[Point3<f64>], camera: &Camera) -> Option<[f64; 2]> {
    let depths = points.iter().map(|p| (camera.cam_from_world * p).z).filter(|z| *z > 0.0);
    let [low, high] = depths
        .fold([f64::INFINITY, 0.0_f64], |[low, high], z| [low.min(1.0 / z), high.max(1.0 / z)]);
    let margin = RANGE_MARGIN * (high - low);
    (low < f64::INFINITY).then(|| [(low - margin).max(MIN_INVERSE_DEPTH), high + margin])
}
