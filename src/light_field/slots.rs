//! Slots: groups of frames whose depth and motion are estimated together.

use super::LightField;

/// Identifies a frame of the capture by two indices: of the camera, and of the frame in the camera's recording.
pub(super) type FrameId = (usize, usize);

/// Maximum number of cameras in a group. Depth and motion of the group's frames in one interval of time are estimated
/// together.
const MAX_GROUP: usize = 12;

/// A slot: the frames of a group of neighbouring cameras within one interval of time. Depth and motion of all frames of
/// a slot are estimated together. Every frame is in exactly one slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Slot {
    /// Index of the time interval. Interval 0 begins at the capture's start.
    interval: i64,
    pub group: usize,
}

/// Division of a light field's frames into slots ([`Slot`]).
pub(super) struct Slots<'a> {
    pub field: &'a LightField,
    /// Length of a slot's time interval, seconds: the median of the cameras' frame intervals. Infinite for a static
    /// light field, so that all frames of a group are in one slot.
    interval_s: f64,
    /// For each camera, the index of the group that it belongs to.
    groups: Vec<usize>,
}

impl<'a> Slots<'a> {
    pub fn new(field: &'a LightField) -> Self {
        let intervals = field.capture().cameras.iter().map(|c| c.clock.frame_s());
        let mut intervals: Vec<f64> = intervals.filter(|s| *s > 0.0).collect();
        intervals.sort_by(f64::total_cmp);
        let median = intervals.get(intervals.len() / 2).copied();
        let interval_s = median.filter(|_| !field.capture().is_static()).unwrap_or(f64::INFINITY);
        Self { field, interval_s, groups: groups(field) }
    }

    /// Returns the slot of a frame. The clock of the frame's camera must be known.
    pub fn of(&self, (camera, frame): FrameId) -> Slot {
        let interval = self.interval(self.field.times_s(camera)[frame]);
        Slot { interval, group: self.groups[camera] }
    }

    /// Returns the frames of a slot, in ascending order of camera and frame index.
    pub fn frames(&self, slot: Slot) -> Vec<FrameId> {
        let mut frames = self.all_frames();
        frames.retain(|id| self.of(*id) == slot);
        frames
    }

    /// Returns the cameras of a slot's group whose clocks are known, in ascending order.
    pub fn cameras(&self, slot: Slot) -> Vec<usize> {
        let is_of = |&c: &usize| self.groups[c] == slot.group && !self.field.times_s(c).is_empty();
        (0..self.groups.len()).filter(is_of).collect()
    }

    /// Returns all slots, in order of time.
    pub fn all(&self) -> Vec<Slot> {
        let mut slots: Vec<Slot> = self.all_frames().into_iter().map(|id| self.of(id)).collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    }

    fn all_frames(&self) -> Vec<FrameId> {
        let frames = |c: usize| (0..self.field.times_s(c).len()).map(move |k| (c, k));
        (0..self.groups.len()).flat_map(frames).collect()
    }

    fn interval(&self, time_s: f64) -> i64 {
        (time_s / self.interval_s).floor() as i64 // saturates
    }
}

/// Divides the cameras into groups, and returns the index of each camera's group. There are as few groups as
/// [`MAX_GROUP`] allows, of about equal size. The groups are formed greedily: the first camera without a group is
/// joined by the nearest cameras without a group.
fn groups(field: &LightField) -> Vec<usize> {
    let cameras = &field.capture().cameras;
    let size = cameras.len().div_ceil(cameras.len().div_ceil(MAX_GROUP).max(1)).max(1);
    let mut groups = vec![0; cameras.len()];
    let mut left: Vec<usize> = (0..cameras.len()).collect();
    let mut group = 0;
    while let Some(&first) = left.first() {
        let center = cameras[first].camera.center();
        let distance = |c: &usize| (cameras[*c].camera.center() - center).norm();
        left.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        left.drain(..size.min(left.len())).for_each(|c| groups[c] = group);
        left.sort_unstable();
        group += 1;
    }
    groups
}
