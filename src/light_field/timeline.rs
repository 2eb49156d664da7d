//! Frame times of the cameras on one clock, the frames around an instant, and the instants at which cameras have
//! images.

use super::{LightField, RenderError};
use crate::capture::{Capture, FrameTimes};
use crate::offset::clocks;

/// Checks that the times `times_s`, seconds from the capture's start, can lie within the recordings. The check needs no
/// temporal offsets of the cameras, so that it can precede their estimation, which may take long.
///
/// # Errors
/// If any of the times is outside the recording of `camera`, whatever the camera's offset is. If `camera` is `None`: if
/// any of the times is outside the recordings of all cameras. The error states the first such time in the list.
pub fn check_times_before_offsets(
    capture: &Capture,
    camera: Option<usize>,
    times_s: &[f64],
) -> Result<(), RenderError> {
    let (first_s, last_s) = capture.widest_span_s(camera);
    let outside = times_s.iter().find(|t| !(first_s..=last_s).contains(*t));
    let Some(time_s) = outside.filter(|_| !capture.is_static()) else { return Ok(()) };
    let origin_s = capture.time_origin_s;
    let [time_s, first_s, last_s] = [*time_s, first_s, last_s].map(|t| t + origin_s);
    let id = |camera: usize| capture.cameras[camera].id.clone();
    let is_known = |c: usize| c == capture.reference || clocks(capture).1 == 1;
    Err(match camera {
        Some(c) if is_known(c) => {
            RenderError::CameraTime { camera: id(c), time_s, first_s, last_s }
        }
        Some(c) => RenderError::Beyond { time_s, of: id(c), first_s, last_s },
        None if clocks(capture).1 == 1 => RenderError::Time { time_s, first_s, last_s },
        None => RenderError::Beyond { time_s, of: "the cameras".into(), first_s, last_s },
    })
}

impl LightField {
    /// Returns the camera's frame times, seconds from the capture's start. They are empty if the camera's clock is
    /// unknown.
    pub(super) fn times_s(&self, camera: usize) -> &[f64] {
        self.all_times_s[camera].as_deref().unwrap_or_default()
    }

    /// Returns the capture times of the camera's frames, seconds from the capture's start. With a rolling shutter, the
    /// result includes the capture time of each row of a frame.
    pub(super) fn frame_times(&self, camera: usize) -> FrameTimes<'_> {
        self.capture().cameras[camera].frame_times(self.times_s(camera))
    }

    /// Converts an instant, seconds from the capture's start, to a time on a camera's own clock. The result is clamped
    /// to the times of the camera's frames. If the clock is unknown, its offset is taken as 0.
    pub(crate) fn own_time_s(&self, camera: usize, time_s: f64) -> f64 {
        let own_s = &self.capture().cameras[camera].clock.times_s;
        let Some(times_s) = self.all_times_s[camera].as_deref() else { return time_s };
        let after = times_s.partition_point(|t| *t <= time_s);
        match after {
            0 => own_s[0],
            _ if after == times_s.len() => own_s[after - 1],
            _ => {
                let [from_s, to_s] = [times_s[after - 1], times_s[after]];
                let fraction = (time_s - from_s) / (to_s - from_s);
                own_s[after - 1] + fraction * (own_s[after] - own_s[after - 1])
            }
        }
    }

    /// Converts a time in seconds to frame intervals of the reference camera. All times of a static light field become
    /// 0.
    pub(crate) fn in_frames(&self, time_s: f64) -> f64 {
        let frame_s = self.capture().frame_s();
        // A reference camera with one frame has no frame interval. 1 s is used instead.
        let frame_s = if frame_s > 0.0 { frame_s } else { 1.0 };
        if self.capture().is_static() { 0.0 } else { time_s / frame_s }
    }

    /// Returns the time nearest to `time_s` at which all cameras with a known clock have images, seconds from the
    /// capture's start. Returns `time_s` itself if there is no such time.
    pub(super) fn while_all_film(&self, time_s: f64) -> f64 {
        let spans = || self.all_times_s.iter().flatten().filter_map(|t| t.first().zip(t.last()));
        let first_s = spans().map(|span| *span.0).fold(f64::NEG_INFINITY, f64::max);
        let last_s = spans().map(|span| *span.1).fold(f64::INFINITY, f64::min);
        if first_s <= last_s { time_s.clamp(first_s, last_s) } else { time_s }
    }

    /// Returns the index of the camera's frame nearest to `time_s`, seconds from the capture's start. Of two equally
    /// near frames, the earlier is returned. `None` if the camera's clock is unknown.
    pub(super) fn nearest_frame(&self, camera: usize, time_s: f64) -> Option<usize> {
        let times_s = self.times_s(camera);
        let distance = |k: &usize| (times_s[*k] - time_s).abs();
        (0..times_s.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Returns the indices of the cameras that can give an image at `time_s`, seconds from the capture's start, in
    /// ascending order.
    pub fn usable(&self, time_s: f64) -> Vec<usize> {
        let is_usable = |&c: &usize| self.bracket(c, time_s).is_ok();
        (0..self.capture().cameras.len()).filter(is_usable).collect()
    }

    /// Returns the first and the last time at which a camera can give an image, seconds from the capture's start.
    /// `None` if the camera's clock is unknown.
    pub fn span_s(&self, camera: usize) -> Option<(f64, f64)> {
        let times_s = self.times_s(camera);
        Some((*times_s.first()?, *times_s.last()?))
    }

    /// Returns the first and the last time at which all cameras with a known clock can give an image, seconds from the
    /// capture's start. `None` if there is no such time.
    pub fn common_span_s(&self) -> Option<(f64, f64)> {
        let first = self.spans_s().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
        let last = self.spans_s().map(|s| s.1).fold(f64::INFINITY, f64::min);
        (first.is_finite() && first <= last).then_some((first, last))
    }

    fn spans_s(&self) -> impl Iterator<Item = (f64, f64)> {
        (0..self.capture().cameras.len()).filter_map(|c| self.span_s(c))
    }

    /// Returns the number of cameras for which `time_s`, seconds from the capture's start, is well between two frames:
    /// its distance from each frame is at least `fraction` of the time between the two frames.
    pub(crate) fn between_frames(&self, time_s: f64, fraction: f64) -> usize {
        let is_between = |&camera: &usize| {
            let times = self.times_s(camera);
            self.bracket(camera, time_s).is_ok_and(|(k, later)| {
                let passed = (time_s - times[k]) / (times[later] - times[k]);
                k != later && (fraction..=1.0 - fraction).contains(&passed)
            })
        };
        (0..self.capture().cameras.len()).filter(is_between).count()
    }

    /// Returns the indices of a camera's frames before and after `time_s`, seconds from the capture's start. The two
    /// indices are equal if a frame has exactly this time. With a rolling shutter, they are always two successive
    /// frames, since the rows of a frame have different times. In a static light field, both indices are 0 at any time,
    /// even if the camera's clock is unknown. Otherwise, an unknown clock is an error, and so is a time outside the
    /// camera's frames.
    pub(super) fn bracket(
        &self,
        camera: usize,
        time_s: f64,
    ) -> Result<(usize, usize), RenderError> {
        let capture = self.capture();
        if capture.is_static() {
            return Ok((0, 0));
        }
        let id = || capture.cameras[camera].id.clone();
        let Some(times_s) = &self.all_times_s[camera] else {
            let reason = self.offsets().cameras[camera].reason.clone().unwrap_or_default();
            return Err(RenderError::CameraClock { camera: id(), reason });
        };
        let is_rolling = !capture.cameras[camera].row_times().are_global();
        let apart = |(frame, later): (usize, usize)| match frame {
            _ if frame != later || !is_rolling || times_s.len() < 2 => (frame, later),
            0 => (0, 1),
            _ => (frame - 1, frame),
        };
        crate::capture::bracket(times_s, time_s).map(apart).ok_or_else(|| {
            let times_s = [time_s, times_s[0], times_s[times_s.len() - 1]];
            let [time_s, first_s, last_s] = times_s.map(|t| t + capture.time_origin_s);
            RenderError::CameraTime { camera: id(), time_s, first_s, last_s }
        })
    }

    /// Returns the error for a time at which no camera has an image.
    pub(super) fn no_camera_at(&self, time_s: f64) -> RenderError {
        let first_s = self.spans_s().map(|s| s.0).fold(f64::INFINITY, f64::min);
        let last_s = self.spans_s().map(|s| s.1).fold(f64::NEG_INFINITY, f64::max);
        if first_s > last_s {
            return RenderError::NoClock;
        }
        let [time_s, first_s, last_s] =
            [time_s, first_s, last_s].map(|t| t + self.capture().time_origin_s);
        RenderError::Time { time_s, first_s, last_s }
    }
}
