//! Timing the stages of combinations, each stage once for all combinations that share it.

use super::TradeoffError;
use super::bench::Bench;
use super::stages::{Stage, Views};
use super::store::{CachedPoint, TIMES};
use crate::host::Elapsed;
use crate::light_field::LightField;
use crate::progress::Task;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The times of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedStage {
    pub runs: Vec<Elapsed>,
}

/// A stage of one combination, shared by others, and the options that its times depend on.
pub(super) struct UntimedStage {
    stage: Stage,
    options: Value,
    point: CachedPoint,
}

impl Bench<'_> {
    /// The times so far of a stage with these options.
    fn stage(&self, options: &Value) -> CachedStage {
        self.store.load(TIMES, options).unwrap_or_default()
    }

    /// The distinct stages, of combinations that can be rendered, that lack runs.
    pub fn untimed<'p>(&self, points: impl Iterator<Item = &'p CachedPoint>) -> Vec<UntimedStage> {
        let mut found: Vec<UntimedStage> = Vec::new();
        for point in points.filter(|p| p.reason.is_none()) {
            for stage in Stage::ALL {
                let options = stage.part(point);
                let is_known = found.iter().any(|other| other.options == options);
                if !is_known && self.stage(&options).runs.len() < self.runs {
                    found.push(UntimedStage { stage, options, point: point.clone() });
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
            for UntimedStage { stage, options, point } in untimed {
                let mut cached = self.stage(options);
                if cached.runs.len() > run {
                    continue;
                }
                cached.runs.push(views.timed(*stage, &point.options)?);
                self.store.save(TIMES, options, &cached);
                task.advance(1);
            }
        }
        Ok(())
    }

    /// What whole views of a combination took, run by run: its three stages.
    pub fn runs(&self, point: &CachedPoint) -> Vec<[Elapsed; 3]> {
        let stages = Stage::ALL.map(|stage| self.stage(&stage.part(point)).runs);
        let runs = stages.iter().map(Vec::len).min().unwrap_or(0);
        (0..runs).map(|run| [0, 1, 2].map(|stage| stages[stage][run])).collect()
    }
}
