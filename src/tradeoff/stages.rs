//! The three stages of a view, one after the other. Combinations share them.

use super::store::CachedPoint;
use crate::camera::Camera;
use crate::host::{BoundedCache, Elapsed, Stopwatch};
use crate::interpolation::{InterpolationOptions, SyncMethod, Synchronized};
use crate::light_field::{Geometry, LightField, RenderError};
use crate::lumigraph::{BlendMethod, Rendered};
use crate::offset::OffsetOptions;
use crate::options::{ProxyMethod, RenderOptions};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::sync::Arc;

/// The stages of a view, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// The images at the instant of the cameras that the view is blended from.
    Sync,
    /// The scene's shape.
    Proxy,
    /// From the shape to depths, the cameras that contribute, and the view.
    Blend,
}

impl Stage {
    pub const ALL: [Self; 3] = [Self::Sync, Self::Proxy, Self::Blend];

    /// What the stage's time depends on: not on how offsets were estimated, once they are.
    pub fn part(self, point: &CachedPoint) -> Value {
        let options = RenderOptions { offset: OffsetOptions::default(), ..point.options.clone() };
        match self {
            Self::Sync => {
                // Which parts of the images are needed depends on the shape and the blend.
                let parts = (options.sync == SyncMethod::Refined)
                    .then(|| json!([shape_part(&options), options.blend]));
                json!(["sync", sync_part(&options), point.cameras, parts])
            }
            Self::Proxy => json!(["proxy", shape_part(&options)]),
            Self::Blend => json!(["blend", shape_part(&options), options.blend]),
        }
    }
}

/// The options that synchronized images depend on.
pub(super) fn sync_part(o: &RenderOptions) -> Value {
    // Interpolation errors are computed where they have weight.
    let with_interpolation_error = o.blend.method == BlendMethod::SpaceTime;
    json!([with_interpolation_error, image_part(o)])
}

/// The same of the images alone.
fn image_part(o: &RenderOptions) -> Value {
    match o.sync {
        SyncMethod::Nearest | SyncMethod::Crossfade => json!([o.offset, o.sync]),
        SyncMethod::Triangulation => {
            let InterpolationOptions { curved, still_change, .. } = o.interpolation;
            json!([o.offset, o.sync, o.registration, curved, still_change])
        }
        SyncMethod::Refined => {
            let InterpolationOptions { curved, still_change, ref refine, .. } = o.interpolation;
            json!([o.offset, o.sync, o.registration, curved, still_change, refine])
        }
        SyncMethod::Morph | SyncMethod::EdgeMorph => {
            json!([o.offset, o.sync, o.registration, o.interpolation])
        }
        SyncMethod::AllCameras => {
            let error_angle_rad = o.blend.error_angle_rad;
            json!([o.offset, o.sync, o.registration, o.interpolation, o.proxy, error_angle_rad])
        }
    }
}

/// The options that the scene's shape depends on.
fn proxy_part(o: &RenderOptions) -> Value {
    json!([o.offset, o.registration, o.interpolation.still_change, o.proxy])
}

/// The options that the scene's shape depends on, whatever it is estimated from.
fn shape_part(o: &RenderOptions) -> Value {
    let images = (o.proxy.method == ProxyMethod::Depth).then(|| sync_part(o));
    json!([proxy_part(o), images])
}

/// How many geometries of one view are cached. More only saves building them again.
const MAX_CACHED_GEOMETRIES: usize = 64;

/// Renders views from one place at one instant, and caches what combinations share.
pub(super) struct Views<'a> {
    field: &'a LightField,
    camera: &'a Camera,
    time_s: f64,
    images: Option<SharedImages>,
    /// The last combinations' geometries, by the options that they depend on.
    geometries: BoundedCache<String, Arc<Geometry>>,
}

/// Synchronized images of some cameras, black ones of the others.
struct SharedImages {
    /// The options that they depend on.
    part: String,
    images: Vec<Option<Synchronized>>,
    done: Vec<usize>,
}

impl<'a> Views<'a> {
    pub fn new(field: &'a LightField, camera: &'a Camera, time_s: f64) -> Self {
        let geometries = BoundedCache::new(MAX_CACHED_GEOMETRIES);
        Self { field, camera, time_s, images: None, geometries }
    }

    /// As [`LightField::view`], and the cameras that the view is blended from.
    pub fn view(&mut self, options: &RenderOptions) -> Result<(Rendered, Vec<usize>), RenderError> {
        let view = options.view();
        let (field, camera) = (self.field, self.camera);
        let geometry = self.geometry(options)?;
        let candidates = self.candidates(options);
        let needed = field.needed(&candidates, &geometry, camera, &view.blend);
        let needed: Vec<usize> = needed.into_iter().map(|(c, _)| c).collect();
        self.share(options, &needed)?;
        let candidates = self.candidates(options);
        let rendered = field.blend(&candidates, &geometry, camera, &view.blend);
        let is_seen = rendered.coverage.contains(&true);
        if is_seen { Ok((rendered, needed)) } else { Err(RenderError::NothingSeen) }
    }

    /// The images that a view is blended from.
    fn candidates(&self, options: &RenderOptions) -> Vec<Option<Synchronized>> {
        let mut images = self.images.as_ref().map_or_else(Vec::new, |s| s.images.clone());
        self.field.keep_candidates(&mut images, self.camera, self.time_s, &options.view());
        images
    }

    /// Makes these cameras' images, whole, so that other combinations can share them.
    fn share(&mut self, options: &RenderOptions, cameras: &[usize]) -> Result<(), RenderError> {
        let view = options.view();
        let part = sync_part(options).to_string();
        let (field, time_s) = (self.field, self.time_s);
        let blanks = || field.blanks(time_s);
        let mut shared = self
            .images
            .take()
            .filter(|shared| shared.part == part)
            .unwrap_or_else(|| SharedImages { part, images: blanks(), done: Vec::new() });
        let missing: Vec<usize> =
            cameras.iter().copied().filter(|c| !shared.done.contains(c)).collect();
        let whole = |c: &usize| Ok((*c, field.synchronized(*c, time_s, &view)?));
        let images: Vec<(usize, Synchronized)> =
            missing.par_iter().map(whole).collect::<Result<_, RenderError>>()?;
        for (c, image) in images {
            shared.images[c] = Some(image);
        }
        shared.done.extend(missing);
        self.images = Some(shared);
        Ok(())
    }

    fn geometry(&mut self, options: &RenderOptions) -> Result<Arc<Geometry>, RenderError> {
        let view = options.view();
        self.share(options, &self.field.geometry_cameras(self.camera, self.time_s, &view))?;
        let part = shape_part(options).to_string();
        if let Some(geometry) = self.geometries.get(&part) {
            return Ok(geometry);
        }
        let images = self.images.as_ref().map_or(&[][..], |s| &s.images);
        let geometry = Arc::new(self.field.geometry(images, self.camera, self.time_s, &view)?);
        self.geometries.insert(part, geometry.clone(), 1);
        Ok(geometry)
    }

    /// What one stage takes, with nothing cached of this view's.
    pub fn timed(&mut self, stage: Stage, options: &RenderOptions) -> Result<Elapsed, RenderError> {
        let (view, camera, time_s) = (options.view(), self.camera, self.time_s);
        let geometry = self.geometry(options)?;
        let shared = self.images.as_ref().map_or(&[][..], |s| &s.images);
        let mut images = self.field.blanks(time_s);
        let whole = self.field.geometry_cameras(camera, time_s, &view);
        let mut candidates = images.clone();
        self.field.keep_candidates(&mut candidates, camera, time_s, &view);
        let mut needed = self.field.needed(&candidates, &geometry, camera, &view.blend);
        needed.retain(|(c, _)| !whole.contains(c));
        self.field.forget_shared();
        let watch = Stopwatch::start();
        match stage {
            Stage::Sync => {
                self.field.synchronize_geometry(&mut images, camera, time_s, &view)?;
                self.field.synchronize(&mut images, &needed, time_s, &view)?;
            }
            Stage::Proxy => {
                let proxy = self.field.uncached_proxy(camera, time_s, &view)?;
                self.field.geometry_over(&proxy, shared, camera, time_s, &view);
            }
            Stage::Blend => {
                self.field.needed(&images, &geometry, camera, &view.blend);
                self.field.blend(&images, &geometry, camera, &view.blend);
            }
        }
        Ok(watch.elapsed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::Method;

    /// Where still pairs go unregistered, images and points are others.
    #[test]
    fn what_stands_still_tells_stages_apart() {
        let mut other = RenderOptions::default();
        other.interpolation.still_change = 0.01;
        assert_ne!(proxy_part(&RenderOptions::default()), proxy_part(&other));
        for &sync in SyncMethod::ALL {
            let [a, b] = [RenderOptions::default(), other.clone()]
                .map(|options| sync_part(&RenderOptions { sync, ..options }));
            assert_eq!(a != b, sync.needs_tracks(), "{sync:?}");
        }
    }
}
