//! The three stages of a view, each timed apart: a view is one after the other, and combinations
//! share them.

use super::measure::Bench;
use super::store::KeptPoint;
use super::{Elapsed, Stopwatch, TradeoffError};
use crate::camera::Camera;
use crate::interpolation::{InterpolationOptions, Sync};
use crate::lumigraph::{Proxy, Rendered};
use crate::offset::OffsetOptions;
use crate::progress::Task;
use crate::raster::Image;
use crate::render::{LightField, RenderError, RenderOptions};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::HashMap;

/// What a view is made by, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// The images at the instant of the cameras that the view is blended from.
    Sync,
    /// The scene's shape.
    Proxy,
    /// From the shape to depths, the cameras that answer, and the view.
    Blend,
}

impl Stage {
    pub const ALL: [Self; 3] = [Self::Sync, Self::Proxy, Self::Blend];

    /// What the stage's time depends on: not on how offsets were estimated, once they are.
    fn part(self, point: &KeptPoint) -> Value {
        let options = RenderOptions { offset: OffsetOptions::default(), ..point.options.clone() };
        match self {
            Self::Sync => {
                // What of the images is asked for depends on the shape and the blend.
                let parts = (options.sync == Sync::Refined)
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
        Sync::Nearest | Sync::Crossfade => json!([o.offset, o.sync]),
        Sync::Triangulation => {
            let InterpolationOptions { curved, still_change, .. } = o.interpolation;
            json!([o.offset, o.sync, o.registration, curved, still_change])
        }
        Sync::Refined => {
            let InterpolationOptions { curved, still_change, ref refine, .. } = o.interpolation;
            json!([o.offset, o.sync, o.registration, curved, still_change, refine])
        }
        Sync::Morph | Sync::EdgeMorph => {
            json!([o.offset, o.sync, o.registration, o.interpolation])
        }
    }
}

/// The options that the scene's shape depends on.
fn proxy_part(o: &RenderOptions) -> Value {
    json!([o.offset, o.registration, o.interpolation.still_change, o.proxy])
}

/// The times of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct KeptStage {
    pub runs: Vec<Elapsed>,
}

/// A stage of one combination, shared by others, and the name that its times are kept by.
pub(super) struct Work {
    stage: Stage,
    key: String,
    point: KeptPoint,
}

impl Bench<'_> {
    fn stage_key(&self, stage: Stage, point: &KeptPoint) -> String {
        self.store.key("time", &stage.part(point))
    }

    /// The times of a stage so far.
    fn stage(&self, stage: Stage, point: &KeptPoint) -> KeptStage {
        self.store.load(&self.stage_key(stage, point)).unwrap_or_default()
    }

    /// The different stages of combinations that can be rendered, and are timed too seldom.
    pub fn untimed<'p>(&self, points: impl Iterator<Item = &'p KeptPoint>) -> Vec<Work> {
        let mut found: Vec<Work> = Vec::new();
        for point in points.filter(|p| p.reason.is_none()) {
            for stage in Stage::ALL {
                let key = self.stage_key(stage, point);
                let known = found.iter().any(|other| other.key == key);
                if !known && self.stage(stage, point).runs.len() < self.runs {
                    found.push(Work { stage, key, point: point.clone() });
                }
            }
        }
        found
    }

    /// Times stages in turns, so that what else the machine does meets all alike.
    pub fn time(
        &self,
        field: &mut LightField,
        work: &[Work],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let (camera, time_s) = (&self.timed.camera, self.timed.time_s);
        // What is prepared once for all views between two frames isn't timed: everything once
        // before.
        field.register(time_s)?;
        let mut views = Views::new(field);
        for Work { point, .. } in work {
            views.view(&point.options, camera, time_s)?;
        }
        for run in 0..self.runs {
            for Work { stage, key, point } in work {
                let mut kept: KeptStage = self.store.load(key).unwrap_or_default();
                if kept.runs.len() > run {
                    continue;
                }
                kept.runs.push(views.timed(*stage, point, camera, time_s)?);
                self.store.save(key, &kept)?;
                task.advance(1);
            }
        }
        Ok(())
    }

    /// What whole views of a combination took, run by run: the sums of its stages.
    pub fn runs(&self, point: &KeptPoint) -> Vec<[Elapsed; 3]> {
        let stages = Stage::ALL.map(|stage| self.stage(stage, point).runs);
        let runs = stages.iter().map(Vec::len).min().unwrap_or(0);
        (0..runs).map(|run| [0, 1, 2].map(|stage| stages[stage][run])).collect()
    }
}

/// Renders views of one instant, and keeps what the next combination shares.
pub(super) struct Views<'a> {
    field: &'a mut LightField,
    images: Option<SharedImages>,
    proxies: HashMap<String, Proxy>,
}

/// Synchronized images of some cameras, black ones of the others.
struct SharedImages {
    of: String,
    images: Vec<Option<Image>>,
    done: Vec<usize>,
}

impl<'a> Views<'a> {
    pub fn new(field: &'a mut LightField) -> Self {
        Self { field, images: None, proxies: HashMap::new() }
    }

    /// As [`LightField::view`], and the cameras that the view is blended from.
    pub fn view(
        &mut self,
        options: &RenderOptions,
        camera: &Camera,
        time_s: f64,
    ) -> Result<(Rendered, Vec<usize>), RenderError> {
        self.field.set_options(options.clone());
        let depth = self.proxy(options, camera, time_s)?.depth_map(camera);
        let of = sync_part(options).to_string();
        let mut shared = self.images.take().filter(|shared| shared.of == of).unwrap_or_else(|| {
            SharedImages { of, images: self.field.blanks(time_s), done: Vec::new() }
        });
        let needed = self.field.needed(&shared.images, &depth, camera);
        let needed: Vec<usize> = needed.into_iter().map(|(c, _)| c).collect();
        let missing: Vec<usize> =
            needed.iter().copied().filter(|c| !shared.done.contains(c)).collect();
        // Whole, for other combinations to share.
        let whole = |c: &usize| Ok((*c, self.field.synchronized(*c, time_s)?));
        let images: Vec<(usize, Image)> =
            missing.par_iter().map(whole).collect::<Result<_, RenderError>>()?;
        for (c, image) in images {
            shared.images[c] = Some(image);
        }
        shared.done.extend(missing);
        let rendered = self.field.blend_by_depth(&shared.images, &depth, camera);
        self.images = Some(shared);
        let seen = rendered.coverage.contains(&true);
        if seen { Ok((rendered, needed)) } else { Err(RenderError::NothingSeen) }
    }

    fn proxy(
        &mut self,
        options: &RenderOptions,
        camera: &Camera,
        time_s: f64,
    ) -> Result<Proxy, RenderError> {
        let part = proxy_part(options).to_string();
        if let Some(proxy) = self.proxies.get(&part) {
            return Ok(proxy.clone());
        }
        self.field.forget_points();
        let proxy = self.field.proxy(options.proxy.rung, camera, time_s)?;
        self.proxies.insert(part, proxy.clone());
        Ok(proxy)
    }

    /// What one stage takes.
    fn timed(
        &mut self,
        stage: Stage,
        point: &KeptPoint,
        camera: &Camera,
        time_s: f64,
    ) -> Result<Elapsed, RenderError> {
        let options = &point.options;
        self.field.set_options(options.clone());
        let proxy = self.proxy(options, camera, time_s)?;
        let mut images = self.field.blanks(time_s);
        let needed = match stage {
            Stage::Sync => self.field.needed(&images, &proxy.depth_map(camera), camera),
            Stage::Proxy | Stage::Blend => Vec::new(),
        };
        self.field.forget_points();
        let watch = Stopwatch::start();
        match stage {
            Stage::Sync => self.field.synchronize(&mut images, &needed, time_s)?,
            Stage::Proxy => drop(self.field.proxy(options.proxy.rung, camera, time_s)?),
            Stage::Blend => {
                let depth = proxy.depth_map(camera);
                self.field.needed(&images, &depth, camera);
                self.field.blend_by_depth(&images, &depth, camera);
            }
        }
        Ok(watch.elapsed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

    /// Where still pairs go unregistered, images and points are others.
    #[test]
    fn what_stands_still_tells_stages_apart() {
        let mut other = RenderOptions::default();
        other.interpolation.still_change = 0.01;
        assert_ne!(proxy_part(&RenderOptions::default()), proxy_part(&other));
        for &sync in Sync::value_variants() {
            let [a, b] = [RenderOptions::default(), other.clone()]
                .map(|options| sync_part(&RenderOptions { sync, ..options }));
            assert_eq!(a != b, sync.needs_tracks(), "{sync:?}");
        }
    }
}
