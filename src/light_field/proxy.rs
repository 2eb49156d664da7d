//! §6: the geometry proxy at an instant, for one view.

use super::{LightField, RenderError};
use crate::camera::Camera;
use crate::lumigraph::{Mesh, Plane, Proxy};
use crate::options::{ProxyMethod, ProxyOptions, ViewOptions};
use nalgebra::Point3;

impl LightField {
    /// The scene's shape at a time, for one view.
    ///
    /// # Errors
    /// [`RenderError::NoPoints`] if the view's surroundings have no points to tell it from,
    /// [`RenderError::NothingSeen`] if points lie elsewhere only.
    pub fn proxy(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Proxy, RenderError> {
        proxy_of(|| self.points(target, time_s, options), target, &options.proxy)
    }

    /// [`Self::proxy`] without cached points: but for correspondences that are known, it takes as long as for the
    /// first view of an instant.
    pub(crate) fn uncached_proxy(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Proxy, RenderError> {
        let points = || self.uncached_points(target, time_s, options);
        proxy_of(points, target, &options.proxy)
    }
}

/// A plane whose depth the user set needs no points.
fn proxy_of(
    points: impl FnOnce() -> Result<Vec<Point3<f64>>, RenderError>,
    target: &Camera,
    options: &ProxyOptions,
) -> Result<Proxy, RenderError> {
    if let (ProxyMethod::Plane, Some(depth_m)) = (options.method, options.plane_depth_m) {
        return Ok(Proxy::Plane(Plane::fronto_parallel(target, depth_m)));
    }
    let points = &points()?;
    let proxy = match options.method {
        ProxyMethod::Plane => {
            let weighted: Vec<_> = points.iter().map(|p| (*p, 1.0)).collect();
            Plane::fit(&weighted, target).map(Proxy::Plane)
        }
        ProxyMethod::Mesh | ProxyMethod::Depth => {
            Mesh::build(points, target, options.depth_edges).map(Proxy::Mesh)
        }
    };
    // A view of a bare spot, or of a single pixel, has no feature in it, but a depth.
    let around = || Plane::amid(points, target).map(Proxy::Plane);
    let is_seen = |p| target.project(p).is_some_and(|pixel| target.contains(&pixel));
    proxy.or_else(around).ok_or_else(|| {
        if points.is_empty() || points.iter().any(is_seen) {
            RenderError::NoPoints
        } else {
            RenderError::NothingSeen
        }
    })
}
