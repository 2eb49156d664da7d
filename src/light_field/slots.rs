//! Frames whose depth and motion are found together.

use super::LightField;
use serde::Serialize;

/// A frame of the capture: camera and index.
pub(super) type FrameId = (usize, usize);

/// Largest number of cameras of a slot.
const MAX_CAMERAS: usize = 12;

/// The frames of neighbouring cameras within an interval of time. Every frame is in one slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(super) struct Slot {
    /// Intervals since the capture's start.
    interval: i64,
    /// Which of the groups of cameras.
    group: usize,
}

impl LightField {
    /// The slot of a frame. Its camera's times are known.
    pub(super) fn slot_of(&self, (camera, frame): FrameId) -> Slot {
        let interval = self.interval_of(self.times_s(camera)[frame], self.interval_s());
        let groups = self.camera_groups();
        // Every camera is in a group.
        let group = groups.iter().position(|g| g.contains(&camera)).unwrap_or(0);
        Slot { interval, group }
    }

    /// A slot's frames, ascending.
    pub(super) fn frames_of(&self, slot: Slot) -> Vec<FrameId> {
        let interval_s = self.interval_s();
        let cameras = self.camera_groups().swap_remove(slot.group);
        let frames = |c: usize| {
            let times_s = self.times_s(c);
            let is_in = move |k: &usize| self.interval_of(times_s[*k], interval_s) == slot.interval;
            (0..times_s.len()).filter(is_in).map(move |k| (c, k))
        };
        cameras.into_iter().flat_map(frames).collect()
    }

    /// All slots, in order of time.
    pub(super) fn slots(&self) -> Vec<Slot> {
        let frames = |c: usize| (0..self.times_s(c).len()).map(move |k| (c, k));
        let all = (0..self.capture().cameras.len()).flat_map(frames);
        let mut slots: Vec<Slot> = all.map(|id| self.slot_of(id)).collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    }

    /// The length of a slot, seconds: the median of the cameras' frame intervals.
    fn interval_s(&self) -> f64 {
        let intervals = self.capture().cameras.iter().map(|c| c.clock.frame_s());
        let mut intervals: Vec<f64> = intervals.filter(|s| *s > 0.0).collect();
        intervals.sort_by(f64::total_cmp);
        // All frames of a static light field are in one slot.
        let median = intervals.get(intervals.len() / 2).copied();
        median.filter(|_| !self.capture().is_static()).unwrap_or(f64::INFINITY)
    }

    fn interval_of(&self, time_s: f64, interval_s: f64) -> i64 {
        (time_s / interval_s).floor() as i64 // saturates
    }

    /// Groups of neighbouring cameras, each ascending; as few as [`MAX_CAMERAS`] allows, of equal size. A camera is beside
    /// the nearest ones that have no group yet.
    fn camera_groups(&self) -> Vec<Vec<usize>> {
        let cameras = &self.capture().cameras;
        let size = cameras.len().div_ceil(cameras.len().div_ceil(MAX_CAMERAS).max(1)).max(1);
        let mut left: Vec<usize> = (0..cameras.len()).collect();
        let mut groups = Vec::new();
        while let Some(&first) = left.first() {
            let center = cameras[first].camera.center();
            let distance = |c: &usize| (cameras[*c].camera.center() - center).norm();
            left.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            let mut group: Vec<usize> = left.drain(..size.min(left.len())).collect();
            group.sort_unstable();
            left.sort_unstable();
            groups.push(group);
        }
        groups
    }
}
