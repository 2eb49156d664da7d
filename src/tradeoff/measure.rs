//! Measuring combinations: quality once, time several times, in turns.

use super::TradeoffError;
use super::bench::Bench;
use super::store::{CachedPoint, POINTS};
use super::targets::{Target, TargetScene};
use crate::light_field::{LightField, RenderError};
use crate::method::Method;
use crate::options::RenderOptions;
use crate::progress::Task;

/// Combinations that share registered frames and offsets.
struct Group {
    options: RenderOptions,
    /// Indices of the combinations.
    members: Vec<usize>,
}

impl Bench<'_> {
    /// Measures combinations as far as they aren't stored, and returns all measurements.
    pub fn measure(
        &self,
        label: &str,
        combinations: &[RenderOptions],
    ) -> Result<Vec<CachedPoint>, TradeoffError> {
        let mut points: Vec<CachedPoint> = combinations.iter().map(|o| self.cached(o)).collect();
        let unscored: usize = points.iter().map(|p| self.unscored(p).count()).sum();
        let untimed = self.untimed(points.iter()).len() * self.runs;
        let task = self.reporter.task(label, unscored + untimed);
        for group in groups(&points) {
            self.measure_group(&group, &mut points, &task)?;
        }
        Ok(points)
    }

    /// Targets without a score of this point.
    fn unscored<'p>(&'p self, point: &'p CachedPoint) -> impl Iterator<Item = &'p Target> {
        let lacks = |t: &&Target| point.reason.is_none() && !point.scores.contains_key(&t.id);
        self.targets.iter().filter(lacks)
    }

    /// The members of a group that lack a target, those that may share synchronized images one after the other.
    fn lacking(&self, group: &Group, points: &[CachedPoint], target: &Target) -> Vec<usize> {
        let lacks = |k: &usize| self.unscored(&points[*k]).any(|t| t.id == target.id);
        let mut found: Vec<usize> = group.members.iter().copied().filter(lacks).collect();
        found.sort_by_key(|&k| points[k].options.sync.name());
        found
    }

    fn measure_group(
        &self,
        group: &Group,
        points: &mut [CachedPoint],
        task: &Task,
    ) -> Result<(), TradeoffError> {
        let untimed = self.untimed(group.members.iter().map(|&k| &points[k]));
        let is_scored = |t: &Target| self.lacking(group, points, t).is_empty();
        if untimed.is_empty() && self.targets.iter().all(is_scored) {
            return Ok(());
        }
        let prepared = self.prepared(&group.options)?;
        let scene =
            TargetScene { capture: self.capture, offsets: &prepared.offsets, base: &group.options };
        let mut open: Option<(Option<usize>, LightField)> = None;
        for target in &self.targets {
            let lacking = self.lacking(group, points, target);
            if lacking.is_empty() {
                continue;
            }
            if open.as_ref().is_none_or(|(held_out, _)| *held_out != target.held_out) {
                open = Some((target.held_out, scene.field(target.held_out)));
            }
            let Some((_, field)) = &open else { continue };
            for k in lacking {
                self.score(field, target, &mut points[k])?;
                task.advance(1);
            }
        }
        let untimed = self.untimed(group.members.iter().map(|&k| &points[k]));
        if untimed.is_empty() {
            return Ok(());
        }
        let whole = open.filter(|(held_out, _)| held_out.is_none()).map(|(_, field)| field);
        self.time(&whole.unwrap_or_else(|| scene.field(None)), &untimed, task)
    }

    fn score(
        &self,
        field: &LightField,
        target: &Target,
        point: &mut CachedPoint,
    ) -> Result<(), TradeoffError> {
        match field.view(&target.camera, target.time_s, &point.options) {
            Ok(rendered) => {
                point.scores.insert(target.id.clone(), target.score(&rendered));
            }
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(error) => point.reason = Some(error.to_string()),
        }
        self.store.save(POINTS, &point.options, point);
        Ok(())
    }
}

fn groups(points: &[CachedPoint]) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for (k, CachedPoint { options, .. }) in points.iter().enumerate() {
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
