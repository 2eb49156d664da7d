//! Timing views of combinations, in turns.

use super::TradeoffError;
use super::bench::Bench;
use super::store::{CachedPoint, TIMES};
use crate::host::{Elapsed, Stopwatch};
use crate::light_field::LightField;
use crate::progress::Task;
use serde::{Deserialize, Serialize};

/// Timed views of one combination.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CachedTimes {
    pub runs: Vec<Elapsed>,
}

impl Bench<'_> {
    /// The times of a combination's views, one for each run.
    pub fn runs(&self, point: &CachedPoint) -> Vec<Elapsed> {
        self.store.load::<CachedTimes>(TIMES, &point.options).unwrap_or_default().runs
    }

    /// The combinations that can be rendered and lack runs.
    pub fn untimed<'p>(
        &self,
        points: impl Iterator<Item = &'p CachedPoint>,
    ) -> Vec<&'p CachedPoint> {
        points.filter(|p| p.reason.is_none() && self.runs(p).len() < self.runs).collect()
    }

    /// Times a view of each combination in turns, so that what else the machine does affects all alike. Frames are
    /// registered before, nothing of the instant is cached.
    pub fn time(
        &self,
        field: &LightField,
        untimed: &[&CachedPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let (camera, time_s) = (&self.timed.camera, self.timed.time_s);
        // What views between two frames share isn't timed: everything once before.
        for point in untimed {
            field.register(time_s, &point.options)?;
            field.view(camera, time_s, &point.options)?;
        }
        for run in 0..self.runs {
            for point in untimed {
                let mut runs = self.runs(point);
                if runs.len() > run {
                    continue;
                }
                field.forget_instants();
                let watch = Stopwatch::start();
                field.view(camera, time_s, &point.options)?;
                runs.push(watch.elapsed());
                self.store.save(TIMES, &point.options, &CachedTimes { runs });
                task.advance(1);
            }
        }
        Ok(())
    }
}
