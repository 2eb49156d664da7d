//! The times of all images on their cameras' own clocks, under one hypothesis of the lost frames.

use super::store::with_lost_frames;
use crate::capture::Capture;

/// The frame times of every camera, with a frame period added for each lost frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Timelines {
    /// By camera and image: the time on the camera's own clock, ascending, seconds.
    pub times_s: Vec<Vec<f64>>,
    /// By camera: the images before which a frame is missing, ascending, one entry for each frame.
    pub lost_before: Vec<Vec<usize>>,
}

impl Timelines {
    /// The nominal times: no frame is lost.
    pub fn nominal(capture: &Capture) -> Self {
        Self::with_lost_frames(capture, vec![Vec::new(); capture.cameras.len()])
    }

    /// The times with the given frames lost; `lost_before` has one entry for each camera.
    pub fn with_lost_frames(capture: &Capture, lost_before: Vec<Vec<usize>>) -> Self {
        let times_s = capture
            .cameras
            .iter()
            .zip(&lost_before)
            .map(|(c, lost)| with_lost_frames(&c.clock.times_s, lost))
            .collect();
        Self { times_s, lost_before }
    }

    /// The image of a camera nearest to a time on its own clock; the earlier one of two as near.
    pub fn nearest(&self, camera: usize, time_s: f64) -> usize {
        let times = &self.times_s[camera];
        let after = times.partition_point(|&t| t < time_s).min(times.len() - 1);
        match after.checked_sub(1) {
            Some(before) if time_s - times[before] <= times[after] - time_s => before,
            _ => after,
        }
    }

    /// The median time between a camera's successive images, seconds; 0 for a single image.
    pub fn frame_s(&self, camera: usize) -> f64 {
        let mut gaps: Vec<f64> = self.times_s[camera].windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
    }

    /// The times of a camera's first and last image, seconds.
    pub fn span_s(&self, camera: usize) -> (f64, f64) {
        let times = &self.times_s[camera];
        (times[0], times[times.len() - 1])
    }
}
