//! Measuring combinations: quality once, time several times, in turns.

use super::stages::{Views, sync_part};
use super::store::{KeptPoint, Planned, Prepared, Store};
use super::targets::{Against, Scene, Target, Timed};
use super::{Clock, Elapsed, Stopwatch, TradeoffError};
use crate::capture::Capture;
use crate::offset::{self, Offsets};
use crate::plan;
use crate::progress::{Reporter, Task};
use crate::render::{LightField, RenderError, RenderOptions};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The bench that combinations are measured on.
pub(super) struct Bench<'a> {
    pub capture: &'a Arc<Capture>,
    pub store: Store,
    pub targets: Vec<Target>,
    pub timed: Timed,
    pub runs: usize,
    pub clock: Clock,
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
    let still_change = options.interpolation.still_change;
    let key = store.key("prepared", &(&options.registration, &options.offset, still_change));
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
    /// What the capture makes of options, where they leave rungs to it, and what planning takes.
    pub fn planned(&self, asked: &RenderOptions) -> Result<Planned, TradeoffError> {
        if !asked.auto.any() {
            let took = Elapsed { wall_s: 0.0, cpu_s: 0.0 };
            return Ok(Planned { options: asked.clone(), took });
        }
        let key = self.store.key("auto", &asked);
        if let Some(kept) = self.store.load(&key) {
            return Ok(kept);
        }
        let prepared = self.prepared(asked)?;
        let watch = Stopwatch::start();
        let (plan, _) = plan::plan_with(self.capture, prepared.offsets, asked, self.reporter)?;
        // What was left to the capture is decided.
        let options = RenderOptions { auto: plan::AutoOptions::default(), ..plan.options };
        let planned = Planned { options, took: watch.elapsed() };
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
            scores: BTreeMap::new(),
            cameras: Vec::new(),
            reason: None,
        })
    }

    /// Measures what isn't known yet of these combinations; all that is known of them.
    pub fn measure(
        &self,
        label: &str,
        combinations: &[RenderOptions],
    ) -> Result<Vec<KeptPoint>, TradeoffError> {
        let mut points: Vec<KeptPoint> = combinations.iter().map(|o| self.kept(o)).collect();
        let unscored: usize = points.iter().map(|p| self.unscored(p).count()).sum();
        let untimed = self.untimed(points.iter()).len() * self.runs;
        let task = self.reporter.task(label, unscored + untimed);
        for group in groups(&points) {
            self.measure_group(&group, &mut points, &task)?;
        }
        Ok(points)
    }

    /// The targets that a point lacks.
    fn unscored<'p>(&'p self, point: &'p KeptPoint) -> impl Iterator<Item = &'p Target> {
        let lacks = |t: &&Target| point.reason.is_none() && !point.scores.contains_key(&t.id);
        self.targets.iter().filter(lacks)
    }

    fn measure_group(
        &self,
        group: &Group,
        points: &mut [KeptPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let members = |points: &[KeptPoint], target: &Target| -> Vec<usize> {
            let lacks = |k: &usize| self.unscored(&points[*k]).any(|t| t.id == target.id);
            let mut found: Vec<usize> = group.members.iter().copied().filter(lacks).collect();
            // Those that share synchronized images one after the other.
            found.sort_by_cached_key(|&k| sync_part(&points[k].options).to_string());
            found
        };
        let untimed = self.untimed(group.members.iter().map(|&k| &points[k]));
        if untimed.is_empty() && self.targets.iter().all(|t| members(points, t).is_empty()) {
            return Ok(());
        }
        let prepared = self.prepared(&group.options)?;
        let scene =
            Scene { capture: self.capture, offsets: &prepared.offsets, base: &group.options };
        let mut open: Option<(Option<usize>, LightField)> = None;
        for target in &self.targets {
            let lacking = members(points, target);
            if lacking.is_empty() {
                continue;
            }
            if open.as_ref().is_none_or(|(left_out, _)| *left_out != target.left_out) {
                open = Some((target.left_out, scene.field(&group.options, target.left_out)));
            }
            let Some((_, field)) = &mut open else { continue };
            let mut views = Views::new(field);
            for k in lacking {
                self.score(&mut views, target, &mut points[k])?;
                task.advance(1);
            }
        }
        let untimed = self.untimed(group.members.iter().map(|&k| &points[k]));
        if untimed.is_empty() {
            return Ok(());
        }
        let whole = open.filter(|(left_out, _)| left_out.is_none()).map(|(_, field)| field);
        let mut field = whole.unwrap_or_else(|| scene.field(&group.options, None));
        self.time(&mut field, &untimed, task)
    }

    fn score(
        &self,
        views: &mut Views,
        target: &Target,
        point: &mut KeptPoint,
    ) -> Result<(), TradeoffError> {
        match views.view(&point.options, &target.camera, target.time_s) {
            Ok((rendered, cameras)) => {
                if self.timed.target == target.id {
                    point.cameras = cameras;
                }
                point.scores.insert(target.id.clone(), target.score(&rendered));
            }
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(error) => point.reason = Some(error.to_string()),
        }
        self.store.save(&self.key(&point.options), point)
    }

    /// The kinds of targets that there are, the one that counts first.
    pub fn against(&self) -> Against {
        let order = [Against::Truth, Against::LeftOut, Against::MostAccurate];
        let there = |a: &Against| self.targets.iter().any(|t| t.against == *a);
        order.into_iter().find(there).unwrap_or(Against::MostAccurate)
    }
}

fn groups(points: &[KeptPoint]) -> Vec<Group> {
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
