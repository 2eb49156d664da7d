//! Deviation of the scene from a plane, measured as parallax in views between cameras.

use super::percentile;
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::{Plane, Proxy};
use crate::options::RenderOptions;

/// Number of evenly spaced instants at which the scene's deviation from a plane is measured.
const INSTANTS: usize = 3;

/// The deviation of the scene's points from a plane, in the reference camera's view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Displacement of points, in pixels, in a view halfway between two neighbouring cameras, if the best-fitting plane
    /// is the proxy. It is the 95th percentile over the points, at the instant with the largest displacement.
    pub off_plane_px: f64,
    /// Number of triangulated points in the reference camera's view, at the instant with the fewest points.
    pub points: usize,
}

impl Shape {
    /// Measures the deviation of the scene from a plane at a few instants. Returns `None` if no point can be
    /// triangulated, or if the recordings of the cameras with known clocks don't overlap in time.
    pub fn survey(
        field: &LightField,
        options: &RenderOptions,
    ) -> Result<Option<Self>, RenderError> {
        let capture = field.capture();
        let reference = capture.reference;
        let target = &capture.cameras[reference].camera;
        let half_baseline_m = 0.5 * field.spacing_m();
        let mut found = Vec::new();
        for time_s in instants_s(field) {
            let points = field.points(target, time_s, options)?;
            let Some(plane) = Plane::fit(&points, target) else { continue };
            let depths = Proxy::Plane(plane).depth_map(target);
            let errors_px: Vec<f64> = points
                .iter()
                .filter_map(|point| {
                    let pixel = target.project(point).filter(|p| target.contains(p))?;
                    let plane_m = f64::from(depths.row(pixel.y as usize)[pixel.x as usize]);
                    let depth_m = (target.cam_from_world * point).z;
                    // Where the ray misses the plane, the depth is NaN or infinite, and the inverse depth is set to 0.
                    let inverse = if plane_m > 0.0 { 1.0 / plane_m } else { 0.0 };
                    // The point is in the view, so its depth is positive.
                    let apart = (1.0 / depth_m - inverse).abs();
                    Some(apart * target.focal_px() * half_baseline_m)
                })
                .collect();
            let points = errors_px.len();
            let off_plane_px = percentile(errors_px, 0.95);
            found.extend(off_plane_px.map(|off_plane_px| Self { off_plane_px, points }));
        }
        Ok(found.into_iter().reduce(|a, b| Self {
            off_plane_px: a.off_plane_px.max(b.off_plane_px),
            points: a.points.min(b.points),
        }))
    }
}

/// Returns evenly spaced instants, in seconds, in the time span that all cameras with known clocks have in common.
fn instants_s(field: &LightField) -> Vec<f64> {
    if field.capture().is_static() {
        return vec![0.0];
    }
    let Some((first, last)) = field.common_span_s() else { return Vec::new() };
    (0..INSTANTS).map(|n| first + (last - first) * (n as f64 + 0.5) / INSTANTS as f64).collect()
}
