//! Timing the stages of combinations, each stage once for all combinations that share it.

use super::TradeoffError;
use super::bench::Bench;
use super::stages::{Stage, Views};
use super::store::CachedPoint;
use crate::host::Elapsed;
use crate::light_field::LightField;
use crate::progress::Task;
use serde::{Deserialize, Serialize};

/// The times of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedStage {
    pub runs: Vec<Elapsed>,
}

/// A stage of one combination, shared by others, and the name that its times are cached by.
pub(super) struct UntimedStage {
    stage: Stage,
    key: String,
    point: CachedPoint,
}

impl Bench<'_> {
    fn stage_key(&self, stage: Stage, point: &CachedPoint) -> String {
        self.store.key("time", &stage.part(point))
    }

    /// The times of a stage so far.
    fn stage(&self, stage: Stage, point: &CachedPoint) -> CachedStage {
        self.store.load(&self.stage_key(stage, point)).unwrap_or_default()
    }

    /// The distinct stages, of combinations that can be rendered, that lack runs.
    pub fn untimed<'p>(&self, points: impl Iterator<Item = &'p CachedPoint>) -> Vec<UntimedStage> {
        let mut found: Vec<UntimedStage> = Vec::new();
        for point in points.filter(|p| p.reason.is_none()) {
            for stage in Stage::ALL {
                let key = self.stage_key(stage, point);
                let is_known = found.iter().any(|other| other.key == key);
                if !is_known && self.stage(stage, point).runs.len() < self.runs {
                    found.push(UntimedStage { stage, key, point: point.clone() });
                }
            }
        }
        found
    }

    /// Times stages in turns, so that what else the machine does affects all alike.
    pub fn time(
        &self,
        field: &LightField,
        untimed: &[UntimedStage],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let (camera, time_s) = (&self.timed.camera, self.timed.time_s);
        let mut views = Views::new(field, camera, time_s);
        // What is prepared once for all views between two frames isn't timed: everything once
        // before.
        for UntimedStage { point, .. } in untimed {
            field.register(time_s, point.options.interpolation.still_change)?;
            views.view(&point.options)?;
        }
        for run in 0..self.runs {
            for UntimedStage { stage, key, point } in untimed {
                let mut cached: CachedStage = self.store.load(key).unwrap_or_default();
                if cached.runs.len() > run {
                    continue;
                }
                cached.runs.push(views.timed(*stage, &point.options)?);
                self.store.save(key, &cached)?;
                task.advance(1);
            }
        }
        Ok(())
    }

    /// What whole views of a combination took, run by run: its three stages.
    pub fn runs(&self, point: &CachedPoint) -> Vec<[Elapsed; 3]> {
        let stages = Stage::ALL.map(|stage| self.stage(stage, point).runs);
        let runs = stages.iter().map(Vec::len).min().unwrap_or(0);
        (0..runs).map(|run| [0, 1, 2].map(|stage| stages[stage][run])).collect()
    }
}
