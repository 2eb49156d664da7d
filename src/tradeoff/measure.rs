//! Measuring combinations: quality once, time several times, in turns.

use super::TradeoffError;
use super::combination::most_accurate;
use super::stopwatch::Stopwatch;
use super::store::{KeptPoint, Planned, Prepared, Store};
use super::targets::{Against, Scene, Target, Timed};
use crate::capture::Capture;
use crate::offset::{self, Offsets};
use crate::plan;
use crate::progress::{Reporter, Task};
use crate::render::{LightField, RenderError, RenderOptions};
use std::sync::Arc;

/// The bench that combinations are measured on.
pub(super) struct Bench<'a> {
    pub capture: &'a Arc<Capture>,
    pub base: &'a RenderOptions,
    pub store: Store,
    pub targets: Vec<Target>,
    pub timed: Timed,
    pub runs: usize,
    pub reporter: &'a Reporter,
}

/// Combinations that share registered frames and offsets.
struct Group {
    options: RenderOptions,
    /// Indices of the combinations.
    members: Vec<usize>,
}

/// Offsets and registered frames for these options: kept from before, or made now.
pub(super) fn prepared(
    capture: &Arc<Capture>,
    store: &Store,
    options: &RenderOptions,
    reporter: &Reporter,
) -> Result<Prepared, TradeoffError> {
    let key = store.key("prepared", &(&options.registration, &options.offset));
    if let Some(kept) = store.load::<Prepared>(&key)
        && kept.offsets.cameras.len() == capture.cameras.len()
    {
        return Ok(kept);
    }
    let clocks = plan::Clocks::of(capture);
    let estimated = clocks.unknown > 0 && !clocks.one_frame;
    let watch = Stopwatch::start();
    let offsets = if estimated {
        let (offset, registration) = (&options.offset, &options.registration);
        offset::estimate(capture, offset, registration, reporter)?.offsets
    } else {
        Offsets::known(capture)
    };
    let offsets_took = estimated.then(|| watch.elapsed());
    let field = LightField::new(capture.clone(), offsets.clone(), options.clone());
    let own_span = || field.span_s(capture.reference);
    let (first, last) = field.common_span_s().or_else(own_span).unwrap_or_default();
    let watch = Stopwatch::start();
    field.register(0.5 * (first + last))?;
    let registration_took = watch.elapsed();
    let made = Prepared { offsets, offsets_took, registration_took };
    store.save(&key, &made)?;
    Ok(made)
}

impl Bench<'_> {
    /// What `auto` chooses, and what planning takes.
    pub fn planned(&self) -> Result<Planned, TradeoffError> {
        let mut asked = self.base.clone();
        (asked.auto.sync, asked.auto.proxy) = (true, true);
        let key = self.store.key("auto", &asked);
        if let Some(kept) = self.store.load(&key) {
            return Ok(kept);
        }
        let prepared = self.prepared(self.base)?;
        let watch = Stopwatch::start();
        let (plan, _) = plan::plan_with(self.capture, prepared.offsets, &asked, self.reporter)?;
        let planned = Planned { options: plan.options, took: watch.elapsed() };
        self.store.save(&key, &planned)?;
        Ok(planned)
    }

    pub fn prepared(&self, options: &RenderOptions) -> Result<Prepared, TradeoffError> {
        prepared(self.capture, &self.store, options, self.reporter)
    }

    fn key(&self, options: &RenderOptions) -> String {
        self.store.key("point", options)
    }

    /// What is known of a combination so far.
    pub fn kept(&self, options: &RenderOptions) -> KeptPoint {
        let kept = self.store.load::<KeptPoint>(&self.key(options));
        kept.filter(|kept| kept.options == *options).unwrap_or_else(|| KeptPoint {
            options: options.clone(),
            scores: Default::default(),
            reason: None,
            runs: Vec::new(),
        })
    }

    /// Measures what isn't known yet of these combinations; all that is known of them.
    pub fn measure(
        &self,
        label: &str,
        combinations: &[RenderOptions],
    ) -> Result<Vec<KeptPoint>, TradeoffError> {
        let mut points: Vec<KeptPoint> = combinations.iter().map(|o| self.kept(o)).collect();
        let steps = self.targets.len() + self.runs;
        let task = self.reporter.task(label, steps * points.len());
        task.resume_at(points.iter().map(|p| steps - self.missing(p)).sum());
        for group in self.groups(&points) {
            if group.members.iter().any(|&k| self.missing(&points[k]) > 0) {
                self.measure_group(&group, &mut points, &task)?;
            }
        }
        Ok(points)
    }

    /// How many measurements a point lacks.
    fn missing(&self, point: &KeptPoint) -> usize {
        if point.reason.is_some() {
            return 0;
        }
        let scored = self.targets.iter().filter(|t| point.scores.contains_key(&t.id)).count();
        self.targets.len() - scored + self.runs.saturating_sub(point.runs.len())
    }

    fn groups(&self, points: &[KeptPoint]) -> Vec<Group> {
        let mut groups: Vec<Group> = Vec::new();
        for (k, KeptPoint { options, .. }) in points.iter().enumerate() {
            let of = groups.iter_mut().find(|g| {
                let other = &g.options;
                other.registration == options.registration && other.offset == options.offset
            });
            match of {
                Some(group) => group.members.push(k),
                None => groups.push(Group { options: options.clone(), members: vec![k] }),
            }
        }
        groups
    }

    fn measure_group(
        &self,
        group: &Group,
        points: &mut [KeptPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let prepared = self.prepared(&group.options)?;
        let scene =
            Scene { capture: self.capture, offsets: &prepared.offsets, base: &group.options };
        let mut field: Option<(Option<usize>, LightField)> = None;
        for target in &self.targets {
            let lacking: Vec<usize> = group
                .members
                .iter()
                .copied()
                .filter(|&k| points[k].reason.is_none())
                .filter(|&k| !points[k].scores.contains_key(&target.id))
                .collect();
            if lacking.is_empty() {
                continue;
            }
            let (_, field) = match &mut field {
                Some(open) if open.0 == target.left_out => open,
                other => {
                    let opened = scene.field(&group.options, target.left_out);
                    other.insert((target.left_out, opened))
                }
            };
            for k in lacking {
                self.score(field, target, &mut points[k])?;
                task.advance(1);
            }
        }
        let whole = field.filter(|(left_out, _)| left_out.is_none()).map(|(_, field)| field);
        self.time(whole.unwrap_or_else(|| scene.field(&group.options, None)), group, points, task)
    }

    fn score(
        &self,
        field: &mut LightField,
        target: &Target,
        point: &mut KeptPoint,
    ) -> Result<(), TradeoffError> {
        field.set_options(point.options.clone());
        match field.view(&target.camera, target.time_s) {
            Ok(rendered) => {
                point.scores.insert(target.id.clone(), target.score(&rendered));
            }
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(error) => point.reason = Some(error.to_string()),
        }
        self.store.save(&self.key(&point.options), point)
    }

    /// Times all members in turns, so that what else the machine does meets all alike.
    fn time(
        &self,
        mut field: LightField,
        group: &Group,
        points: &mut [KeptPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let Timed { camera, time_s } = &self.timed;
        let lacks = |p: &KeptPoint, run: usize| p.reason.is_none() && p.runs.len() <= run;
        if !group.members.iter().any(|&k| lacks(&points[k], self.runs.saturating_sub(1))) {
            return Ok(());
        }
        // What is prepared once for all views between two frames isn't timed.
        field.set_options(most_accurate(&group.options));
        if let Err(RenderError::Capture(error)) = field.view(camera, *time_s) {
            return Err(error.into());
        }
        for run in 0..self.runs {
            for &k in group.members.iter().filter(|&&k| lacks(&points[k], run)).collect::<Vec<_>>()
            {
                let point = &mut points[k];
                field.set_options(point.options.clone());
                field.forget_points();
                let watch = Stopwatch::start();
                let rendered = field.view(camera, *time_s);
                let took = watch.elapsed();
                match rendered {
                    Ok(_) => point.runs.push(took),
                    Err(RenderError::Capture(error)) => return Err(error.into()),
                    Err(error) => point.reason = Some(error.to_string()),
                }
                self.store.save(&self.key(&point.options), point)?;
                task.advance(1);
            }
        }
        Ok(())
    }

    /// The kinds of targets that there are, the one that counts first.
    pub fn against(&self) -> Against {
        let order = [Against::Truth, Against::LeftOut, Against::MostAccurate];
        let there = |a: &Against| self.targets.iter().any(|t| t.against == *a);
        order.into_iter().find(there).unwrap_or(Against::MostAccurate)
    }
}
