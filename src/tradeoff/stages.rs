//! The three stages of a view, one after the other. Combinations share them.

use super::store::CachedPoint;
use crate::camera::Camera;
use crate::host::{BoundedCache, Elapsed, Stopwatch};
use crate::interpolation::{InterpolationOptions, SyncMethod};
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::{Proxy, Rendered};
use crate::offset::OffsetOptions;
use crate::options::{RenderOptions, ViewOptions};
use crate::raster::Image;
use rayon::prelude::*;
use serde_json::{Value, json};

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
                    .then(|| json!([proxy_part(&options), options.blend]));
                json!(["sync", sync_part(&options), point.cameras, parts])
            }
            Self::Proxy => json!(["proxy", proxy_part(&options)]),
            Self::Blend => json!(["blend", proxy_part(&options), options.blend]),
        }
    }
}

/// The options that synchronized images depend on.
pub(super) fn sync_part(o: &RenderOptions) -> Value {
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
    }
}

/// The options that the scene's shape depends on.
fn proxy_part(o: &RenderOptions) -> Value {
    json!([o.offset, o.registration, o.interpolation.still_change, o.proxy])
}

/// How many proxies of one view are cached. More only saves building them again.
const MAX_CACHED_PROXIES: usize = 64;

/// Renders views from one place at one instant, and caches what combinations share.
pub(super) struct Views<'a> {
    field: &'a LightField,
    camera: &'a Camera,
    time_s: f64,
    images: Option<SharedImages>,
    /// The last combinations' proxies, by the options that they depend on.
    proxies: BoundedCache<String, Proxy>,
}

/// Synchronized images of some cameras, black ones of the others.
struct SharedImages {
    /// The options that they depend on.
    part: String,
    images: Vec<Option<Image>>,
    done: Vec<usize>,
}

impl<'a> Views<'a> {
    pub fn new(field: &'a LightField, camera: &'a Camera, time_s: f64) -> Self {
        Self { field, camera, time_s, images: None, proxies: BoundedCache::new(MAX_CACHED_PROXIES) }
    }

    /// As [`LightField::view`], and the cameras that the view is blended from.
    pub fn view(&mut self, options: &RenderOptions) -> Result<(Rendered, Vec<usize>), RenderError> {
        let view = options.view();
        let depth = self.proxy(options, &view)?.depth_map(self.camera);
        let part = sync_part(options).to_string();
        let blanks = || self.field.blanks(self.time_s);
        let mut shared = self
            .images
            .take()
            .filter(|shared| shared.part == part)
            .unwrap_or_else(|| SharedImages { part, images: blanks(), done: Vec::new() });
        let needed = self.field.needed(&shared.images, &depth, self.camera, &view.blend);
        let needed: Vec<usize> = needed.into_iter().map(|(c, _)| c).collect();
        let missing: Vec<usize> =
            needed.iter().copied().filter(|c| !shared.done.contains(c)).collect();
        // Whole images, so that other combinations can share them.
        let whole = |c: &usize| Ok((*c, self.field.synchronized(*c, self.time_s, &view)?));
        let images: Vec<(usize, Image)> =
            missing.par_iter().map(whole).collect::<Result<_, RenderError>>()?;
        for (c, image) in images {
            shared.images[c] = Some(image);
        }
        shared.done.extend(missing);
        let rendered = self.field.blend_by_depth(&shared.images, &depth, self.camera, &view.blend);
        self.images = Some(shared);
        let is_seen = rendered.coverage.contains(&true);
        if is_seen { Ok((rendered, needed)) } else { Err(RenderError::NothingSeen) }
    }

    fn proxy(&mut self, options: &RenderOptions, view: &ViewOptions) -> Result<Proxy, RenderError> {
        let part = proxy_part(options).to_string();
        if let Some(proxy) = self.proxies.get(&part) {
            return Ok(proxy);
        }
        let proxy = self.field.proxy(self.camera, self.time_s, view)?;
        self.proxies.insert(part, proxy.clone(), 1);
        Ok(proxy)
    }

    /// What one stage takes, with nothing cached of this view's.
    pub fn timed(&mut self, stage: Stage, options: &RenderOptions) -> Result<Elapsed, RenderError> {
        let (view, camera, time_s) = (options.view(), self.camera, self.time_s);
        let proxy = self.proxy(options, &view)?;
        let mut images = self.field.blanks(time_s);
        let needed = match stage {
            Stage::Sync => {
                self.field.needed(&images, &proxy.depth_map(camera), camera, &view.blend)
            }
            Stage::Proxy | Stage::Blend => Vec::new(),
        };
        let watch = Stopwatch::start();
        match stage {
            Stage::Sync => self.field.synchronize(&mut images, &needed, time_s, &view)?,
            Stage::Proxy => drop(self.field.uncached_proxy(camera, time_s, &view)?),
            Stage::Blend => {
                let depth = proxy.depth_map(camera);
                self.field.needed(&images, &depth, camera, &view.blend);
                self.field.blend_by_depth(&images, &depth, camera, &view.blend);
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
