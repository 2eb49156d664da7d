//! How long the stages of a comparison took.

use super::results::StageTime;
use std::time::Instant;

/// Times of the stages, each the sum of its parts.
pub(super) struct StageTimes(pub Vec<StageTime>);

impl StageTimes {
    /// Runs one part of a stage.
    pub fn time<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.add(stage, start);
        result
    }

    /// Adds the time since `start` to a stage's.
    pub fn add(&mut self, stage: &str, start: Instant) {
        let seconds = start.elapsed().as_secs_f64();
        match self.0.iter_mut().find(|s| s.stage == stage) {
            Some(known) => known.seconds += seconds,
            None => self.0.push(StageTime { stage: stage.to_owned(), seconds }),
        }
    }
}
