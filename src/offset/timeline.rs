//! The cameras' clocks as an estimate goes on: lost frames accounted for.

use super::store::with_lost_frames;
use crate::capture::Capture;

/// Frame times of every camera on its own clock, seconds, a frame added for each lost one.
#[derive(Clone, Debug, PartialEq)]
pub struct Timelines {
    pub times_s: Vec<Vec<f64>>,
    /// The images before which a frame is missing, by camera.
    pub lost_before: Vec<Vec<usize>>,
}

impl Timelines {
    /// Without lost frames.
    pub fn nominal(capture: &Capture) -> Self {
        Self::with_lost(capture, vec![Vec::new(); capture.cameras.len()])
    }

    pub fn with_lost(capture: &Capture, lost_before: Vec<Vec<usize>>) -> Self {
        let times_s = capture
            .cameras
            .iter()
            .zip(&lost_before)
            .map(|(c, lost)| with_lost_frames(&c.clock.times_s, lost))
            .collect();
        Self { times_s, lost_before }
    }

    /// The image of a camera nearest to a time on its clock.
    pub fn nearest(&self, camera: usize, time_s: f64) -> usize {
        let times = &self.times_s[camera];
        let after = times.partition_point(|&t| t < time_s).min(times.len() - 1);
        match after.checked_sub(1) {
            Some(before) if time_s - times[before] <= times[after] - time_s => before,
            _ => after,
        }
    }

    /// Median time between a camera's frames; 0 for a single one.
    pub fn frame_s(&self, camera: usize) -> f64 {
        let mut gaps: Vec<f64> = self.times_s[camera].windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
    }

    /// First and last time of a camera.
    pub fn span_s(&self, camera: usize) -> (f64, f64) {
        let times = &self.times_s[camera];
        (times[0], times[times.len() - 1])
    }
}
