//! The three stages of a view, each timed apart: a view is one after the other, and combinations
//! share them.

use super::measure::Bench;
use super::store::KeptPoint;
use super::{Elapsed, Stopwatch, TradeoffError};
use crate::interpolation::Sync;
use crate::lumigraph::Proxy;
use crate::progress::Task;
use crate::raster::Image;
use crate::render::{LightField, RenderError, RenderOptions};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::HashMap;

/// What a view is made by, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// All cameras' images at the instant.
    Sync,
    /// The scene's shape.
    Proxy,
    Blend,
}

impl Stage {
    pub const ALL: [Self; 3] = [Self::Sync, Self::Proxy, Self::Blend];

    /// The options that the stage's time and result depend on.
    pub fn part(self, o: &RenderOptions) -> Value {
        let sync = match o.sync {
            Sync::Nearest | Sync::Crossfade => json!(null),
            Sync::Triangulation => json!([o.registration, o.interpolation.curved]),
            Sync::Morph | Sync::EdgeMorph | Sync::Refined => {
                json!([o.registration, o.interpolation])
            }
        };
        match self {
            Self::Sync => json!(["sync", o.offset, o.sync, sync]),
            Self::Proxy => json!(["proxy", o.offset, o.registration, o.proxy]),
            Self::Blend => json!(["blend", o.offset, o.registration, o.proxy, o.blend]),
        }
    }
}

/// The times of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct KeptStage {
    pub runs: Vec<Elapsed>,
}

/// Stages of one combination, shared by others.
type Work = (Stage, String, RenderOptions);

impl Bench<'_> {
    fn stage_key(&self, stage: Stage, options: &RenderOptions) -> String {
        self.store.key("time", &stage.part(options))
    }

    /// The times of a stage so far.
    pub fn stage(&self, stage: Stage, options: &RenderOptions) -> KeptStage {
        self.store.load(&self.stage_key(stage, options)).unwrap_or_default()
    }

    /// The different stages of combinations that can be rendered, and are timed too seldom.
    pub fn untimed<'p>(&self, points: impl Iterator<Item = &'p KeptPoint>) -> Vec<Work> {
        let mut found: Vec<Work> = Vec::new();
        for point in points.filter(|p| p.reason.is_none()) {
            for stage in Stage::ALL {
                let key = self.stage_key(stage, &point.options);
                let known = found.iter().any(|(_, other, _)| *other == key);
                if !known && self.stage(stage, &point.options).runs.len() < self.runs {
                    found.push((stage, key, point.options.clone()));
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
        let images = field.synchronized_all(Sync::Refined, time_s)?;
        let mut proxies: HashMap<String, Proxy> = HashMap::new();
        for run in 0..self.runs {
            for (stage, key, options) in work {
                let mut kept: KeptStage = self.store.load(key).unwrap_or_default();
                if kept.runs.len() > run {
                    continue;
                }
                field.set_options(options.clone());
                let proxy = match proxies.get(&Stage::Proxy.part(options).to_string()) {
                    Some(proxy) => proxy.clone(),
                    None => {
                        field.forget_points();
                        let proxy = field.proxy(options.proxy.rung, camera, time_s)?;
                        proxies.insert(Stage::Proxy.part(options).to_string(), proxy.clone());
                        proxy
                    }
                };
                field.forget_points();
                let watch = Stopwatch::start();
                match stage {
                    Stage::Sync => drop(field.synchronized_all(options.sync, time_s)?),
                    Stage::Proxy => drop(field.proxy(options.proxy.rung, camera, time_s)?),
                    Stage::Blend => drop(field.blend(&images, &proxy, camera)),
                }
                kept.runs.push(watch.elapsed());
                self.store.save(key, &kept)?;
                task.advance(1);
            }
        }
        Ok(())
    }

    /// What whole views of a combination took, run by run: the sums of its stages.
    pub fn runs(&self, options: &RenderOptions) -> Vec<[Elapsed; 3]> {
        let stages = Stage::ALL.map(|stage| self.stage(stage, options).runs);
        let runs = stages.iter().map(Vec::len).min().unwrap_or(0);
        (0..runs).map(|run| [0, 1, 2].map(|stage| stages[stage][run])).collect()
    }
}

/// Renders views of one instant, and keeps what the next combination shares.
pub(super) struct Views<'a> {
    field: &'a mut LightField,
    images: Option<(String, Vec<Option<Image>>)>,
    proxies: HashMap<String, Proxy>,
}

impl<'a> Views<'a> {
    pub fn new(field: &'a mut LightField) -> Self {
        Self { field, images: None, proxies: HashMap::new() }
    }

    /// As [`LightField::view`].
    pub fn view(
        &mut self,
        options: &RenderOptions,
        camera: &crate::camera::Camera,
        time_s: f64,
    ) -> Result<crate::lumigraph::Rendered, RenderError> {
        self.field.set_options(options.clone());
        let part = Stage::Sync.part(options).to_string();
        if self.images.as_ref().is_none_or(|(of, _)| *of != part) {
            self.images = Some((part, self.field.synchronized_all(options.sync, time_s)?));
        }
        let part = Stage::Proxy.part(options).to_string();
        if !self.proxies.contains_key(&part) {
            self.field.forget_points();
            let proxy = self.field.proxy(options.proxy.rung, camera, time_s)?;
            self.proxies.insert(part.clone(), proxy);
        }
        let images = self.images.as_ref().map(|(_, images)| images.as_slice());
        let rendered = self.field.blend(images.unwrap_or_default(), &self.proxies[&part], camera);
        if rendered.coverage.contains(&true) { Ok(rendered) } else { Err(RenderError::NothingSeen) }
    }
}
