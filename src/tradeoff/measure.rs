//! Measures combinations of options. Quality is measured once. Time is measured in several runs that alternate
//! between the combinations.

use super::store::{CachedPoint, Store};
use super::targets::{Against, Target, TargetScene, View};
use super::{TimingClock, TradeoffError};
use crate::host::Stopwatch;
use crate::light_field::{LightField, RenderError};
use crate::method::Method;
use crate::options::RenderOptions;
use crate::progress::{Reporter, Task, in_words};

/// The inputs with which combinations of options are measured: the reference images, the view whose rendering time
/// is measured, and the cache of measurements.
pub(super) struct Bench<'a> {
    pub store: Store,
    pub targets: Vec<Target>,
    /// The view whose rendering time is measured.
    pub timed: View,
    pub runs: usize,
    pub clock: TimingClock,
    pub reporter: &'a Reporter,
}

/// Time, in seconds, that one thread takes to render a view, per pixel and per camera of the capture. It is the
/// mean over all methods on the test scene `magazine`. The expected duration of the measurements is computed from
/// it.
const SAMPLE_S: f64 = 4e-7;

impl Bench<'_> {
    /// Returns the kind of reference images against which the quality of views is measured.
    pub fn against(&self) -> Against {
        let order = [Against::Truth, Against::HeldOut, Against::MostAccurate];
        let there = |a: &Against| self.targets.iter().any(|t| t.against == *a);
        order.into_iter().find(there).unwrap_or(Against::MostAccurate)
    }

    /// Measures the time and the quality of the given combinations of options. Measurements that are in the cache
    /// are not repeated. `label` describes the combinations in the progress display.
    pub fn measure(
        &self,
        label: &str,
        combinations: &[RenderOptions],
    ) -> Result<Vec<CachedPoint>, TradeoffError> {
        let mut points: Vec<CachedPoint> =
            combinations.iter().map(|o| self.store.point(o)).collect();
        let unscored = |p: &CachedPoint| self.targets.iter().filter(|t| p.lacks(t)).count();
        let untimed = points.iter().filter(|p| self.is_untimed(p)).count() * self.runs;
        let steps = points.iter().map(unscored).sum::<usize>() + untimed;
        if steps > 0 {
            let (size, cameras) = (&self.timed.camera, self.store.capture.cameras.len());
            let samples = steps * cameras * size.width * size.height;
            let seconds = SAMPLE_S * samples as f64 / rayon::current_num_threads() as f64;
            let time = in_words(seconds);
            self.reporter.note(&format!("{steps} views, {label}, may take {time}."));
        }
        let task = self.reporter.task(label, steps);
        for group in groups(&points) {
            self.measure_group(&group, &mut points, &task)?;
        }
        Ok(points)
    }

    /// Returns whether a combination of options can be rendered and has fewer timed runs than required.
    fn is_untimed(&self, point: &CachedPoint) -> bool {
        point.reason.is_none() && point.runs.len() < self.runs
    }

    fn measure_group(
        &self,
        group: &[usize],
        points: &mut [CachedPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let is_measured =
            |p: &CachedPoint| !self.is_untimed(p) && !self.targets.iter().any(|t| p.lacks(t));
        if group.iter().all(|&k| is_measured(&points[k])) {
            return Ok(());
        }
        let base = &points[group[0]].options.clone();
        let prepared = self.store.prepared(base)?;
        let scene = TargetScene { capture: &self.store.capture, offsets: &prepared.offsets, base };
        let mut open: Option<(Option<usize>, LightField)> = None;
        for target in &self.targets {
            let lacks = |k: &usize| points[*k].lacks(target);
            let mut lacking: Vec<usize> = group.iter().copied().filter(lacks).collect();
            if lacking.is_empty() {
                continue;
            }
            // Sorted, so that successive combinations with the same synchronization method share cached
            // synchronized images.
            lacking.sort_by_key(|&k| points[k].options.sync.name());
            if open.as_ref().is_none_or(|(held_out, _)| *held_out != target.held_out) {
                open = Some((target.held_out, scene.field(target.held_out)));
            }
            let Some((_, field)) = &open else { continue };
            for k in lacking {
                self.score(field, target, &mut points[k])?;
                task.advance(1);
            }
        }
        let untimed: Vec<usize> =
            group.iter().copied().filter(|&k| self.is_untimed(&points[k])).collect();
        if untimed.is_empty() {
            return Ok(());
        }
        let whole = open.filter(|(held_out, _)| held_out.is_none()).map(|(_, field)| field);
        self.time(&whole.unwrap_or_else(|| scene.field(None)), &untimed, points, task)
    }

    fn score(
        &self,
        field: &LightField,
        target: &Target,
        point: &mut CachedPoint,
    ) -> Result<(), TradeoffError> {
        match field.view(&target.view.camera, target.view.time_s, &point.options) {
            Ok(rendered) => {
                point.scores.insert(target.id.clone(), target.score(&rendered));
            }
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(error) => point.reason = Some(error.to_string()),
        }
        self.store.save_point(point);
        Ok(())
    }

    /// Measures the time that each combination of options takes to render the view [`Self::timed`]. The
    /// combinations are rendered in turns, so that other load on the machine affects all of them alike. Frames are
    /// registered before the timed runs. Before each run, cached results for the view's instant are discarded.
    fn time(
        &self,
        field: &LightField,
        untimed: &[usize],
        points: &mut [CachedPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let View { camera, time_s } = &self.timed;
        // Results that all views between two frames share are computed here, outside the timed runs.
        for &k in untimed {
            field.register(*time_s, &points[k].options)?;
            field.view(camera, *time_s, &points[k].options)?;
        }
        for run in 0..self.runs {
            for &k in untimed {
                let point = &mut points[k];
                if point.runs.len() > run {
                    continue;
                }
                field.forget_instants();
                let watch = Stopwatch::start();
                field.view(camera, *time_s, &point.options)?;
                point.runs.push(watch.elapsed());
                self.store.save_point(point);
                task.advance(1);
            }
        }
        Ok(())
    }
}

impl CachedPoint {
    /// Returns whether this combination of options can be rendered, but has not been compared with the target's
    /// reference image yet.
    fn lacks(&self, target: &Target) -> bool {
        self.reason.is_none() && !self.scores.contains_key(&target.id)
    }
}

/// Groups the combinations of options that can share registered frames and temporal offsets, because their
/// registration options and offset methods are equal. Each group has the indices of its combinations in `points`.
fn groups(points: &[CachedPoint]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (k, CachedPoint { options, .. }) in points.iter().enumerate() {
        let of = groups.iter_mut().find(|group| {
            let other = &points[group[0]].options;
            other.registration == options.registration && other.offset == options.offset
        });
        match of {
            Some(group) => group.push(k),
            None => groups.push(vec![k]),
        }
    }
    groups
}
