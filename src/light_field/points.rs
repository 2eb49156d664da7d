//! Points of the scene at one instant (§6), and the geometry proxy through them. The points are triangulated from
//! spatial correspondences, whose positions in each camera are first interpolated to the instant.

use super::RenderError;
use super::correspondences::{frames_around, observations};
use super::graph::{LightField, Stage};
use super::stages::{CameraPoints, Correspondences, Instant};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::lumigraph::{Mesh, Plane, Proxy, triangulate};
use crate::options::{ProxyMethod, ProxyOptions, RenderOptions};
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Maximum root mean square reprojection error of a triangulated point, pixels. Points with larger errors are dropped.
const MAX_ERROR_PX: f64 = 0.7;

impl Stage for CameraPoints<'_> {
    type Output = Vec<Point3<f64>>;
    const NAME: &'static str = "points";

    fn bytes(points: &Vec<Point3<f64>>) -> usize {
        size_of_val(points.as_slice())
    }
}

impl CameraPoints<'_> {
    fn get(&self, field: &LightField) -> Result<Arc<Vec<Point3<f64>>>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let cameras = std::iter::once(self.camera).chain(self.partners.iter().copied());
        let Instant { time_s, registration, .. } = self.instant;
        let around =
            cameras.map(|c| frames_around(field, c, self.instant)).collect::<Result<_, _>>()?;
        let matched = Correspondences { around, registration }.get(field)?;
        let points: Vec<_> = observations(field, &matched, time_s)
            .iter()
            .filter(|observations| observations.len() > 1)
            .filter_map(|observations| triangulate(observations))
            .filter(|t| t.rms_px <= MAX_ERROR_PX)
            .map(|t| t.point)
            .collect();
        Ok(field.insert(self, points))
    }
}

impl LightField {
    /// Returns points of the scene at `time_s`, seconds from the capture's start, in world coordinates, metres. They
    /// are triangulated from features of the cameras nearest to the view `target`.
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read.
    pub fn points(
        &self,
        target: &Camera,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let cameras = with_partners(self, target, time_s, &options.proxy);
        let instant = Instant::new(time_s, options);
        let stages: Vec<CameraPoints> = cameras
            .iter()
            .map(|(camera, partners)| CameraPoints { camera: *camera, partners, instant })
            .collect();
        let unknown = stages.iter().filter(|stage| self.cached(*stage).is_none());
        load_frames(self, unknown)?;
        let all: Vec<_> =
            stages.par_iter().map(|stage| stage.get(self)).collect::<Result<_, _>>()?;
        Ok(all.iter().flat_map(|points| points.iter().copied()).collect())
    }

    /// Returns the geometry proxy of a view at `time_s`, seconds from the capture's start. For the methods with depth
    /// per pixel, the proxy is the mesh through the scene's points. In a wide array without points, plane and mesh are
    /// the plane through the place that all cameras look at.
    ///
    /// # Errors
    /// [`RenderError::NoPoints`] if no points can otherwise be triangulated, [`RenderError::NothingSeen`] if all points are
    /// behind the view's camera, and [`RenderError::Capture`] if a frame can't be read.
    pub fn proxy(
        &self,
        target: &Camera,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<Proxy, RenderError> {
        // A plane whose depth the user sets needs no points.
        if let (ProxyMethod::Plane, Some(depth_m)) =
            (options.proxy.method, options.proxy.plane_depth_m)
        {
            return Ok(Proxy::Plane(Plane::fronto_parallel(target, depth_m)));
        }
        let points = &self.points(target, time_s, options)?;
        let proxy = match options.proxy.method {
            ProxyMethod::Plane => Plane::fit(points, target).map(Proxy::Plane),
            ProxyMethod::Mesh | ProxyMethod::Depth | ProxyMethod::SceneFlow => {
                Mesh::build(points, target, options.proxy.depth_edges).map(Proxy::Mesh)
            }
        };
        // If the view shows no features, as for a textureless wall, its proxy is a plane at the median depth of all
        // points in front of the camera.
        let around = || Plane::amid(points, target).map(Proxy::Plane);
        let looked_at = || self.plane_looked_at(target, options.proxy.method).map(Proxy::Plane);
        let is_seen = |p| target.project(p).is_some_and(|pixel| target.contains(&pixel));
        proxy.or_else(around).or_else(looked_at).ok_or_else(|| {
            if points.is_empty() || points.iter().any(is_seen) {
                RenderError::NoPoints
            } else {
                RenderError::NothingSeen
            }
        })
    }

    /// Returns the plane through the place that all cameras of a wide array look at, parallel to the view's image. `None` if
    /// the array isn't wide, if the place is behind the view's camera, or if the method needs the scene's depths.
    fn plane_looked_at(&self, target: &Camera, method: ProxyMethod) -> Option<Plane> {
        let is_flat = matches!(method, ProxyMethod::Plane | ProxyMethod::Mesh);
        let place = self.common_place().filter(|_| is_flat)?;
        let depth_m = (target.cam_from_world * place.at).z;
        (depth_m > 0.0).then(|| Plane::fronto_parallel(target, depth_m))
    }
}

/// Decodes the frames that the given stages need, in parallel and each frame once. Does nothing if the cache can't hold
/// all of these frames together.
fn load_frames<'a>(
    field: &LightField,
    stages: impl Iterator<Item = &'a CameraPoints<'a>>,
) -> Result<(), RenderError> {
    let stages: Vec<&CameraPoints> = stages.collect();
    let Some(first) = stages.first() else { return Ok(()) };
    let frames = field.frames(first.instant.registration);
    // Gains are computed once here, before threads request them in parallel.
    frames.gains();
    let cameras: BTreeSet<usize> =
        stages.iter().flat_map(|s| s.partners.iter().chain([&s.camera])).copied().collect();
    if !frames.fits(cameras.iter().copied(), 2) {
        return Ok(());
    }
    let mut indices = Vec::new();
    for camera in cameras {
        let (k, later) = field.bracket(camera, first.instant.time_s)?;
        indices.push((camera, k));
        indices.extend((later != k).then_some((camera, later)));
    }
    indices.into_par_iter().try_for_each(|(camera, index)| {
        frames.get(camera, index)?;
        Ok(())
    })
}

/// Returns the indices of the cameras nearest to a view, each with the indices of its partners. The partners are the
/// cameras in which the camera's features are searched.
fn with_partners(
    field: &LightField,
    target: &Camera,
    time_s: f64,
    options: &ProxyOptions,
) -> Vec<(usize, Vec<usize>)> {
    let usable = field.usable(time_s);
    let capture = field.capture();
    let with = |camera: usize| {
        let mut partners = nearest(capture, &usable, capture.cameras[camera].camera.center());
        partners.retain(|&j| j != camera);
        partners.truncate(options.partners);
        (camera, partners)
    };
    nearest(capture, &usable, target.center()).into_iter().take(options.cameras).map(with).collect()
}

/// Returns the indices of the cameras `among`, ordered by the distance of their centres from the point `from` of the
/// world. Equal distances are ordered by index.
pub(super) fn nearest(capture: &Capture, among: &[usize], from: Point3<f64>) -> Vec<usize> {
    let mut order = among.to_vec();
    let distance = |c: usize| (capture.cameras[c].camera.center() - from).norm();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    order
}
