//! A camera's own clock, the times of an image's rows, and bounds on the times of frames while the offset is unknown.

use super::{Capture, FilmedCamera};
use nalgebra::Point2;

/// Shortest time between two frames, seconds. Estimates of offsets and trajectories divide by it.
const MIN_FRAME_S: f64 = 1e-9;
/// Largest absolute time, seconds (3000 years). Unix times are accepted in seconds and refused in milliseconds.
pub(super) const MAX_TIME_S: f64 = 1e11;

/// Longest readout of a rolling shutter, seconds. Real ones take at most the tenth part.
const MAX_READOUT_S: f64 = 1.0;
/// Relative error of a frame interval due to rounded times. Times are files' decimal numbers.
const READOUT_ROUNDING: f64 = 1e-6;

/// Largest drift of a clock relative to the reference's clock, parts per million. Drifts of quartz clocks are at most
/// 100.
pub const MAX_DRIFT_PPM: f64 = 1000.0;

/// The times of a camera's frames on its own clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    /// The middle of the exposure of each frame's middle row: seconds from the capture's start, strictly ascending.
    pub times_s: Vec<f64>,
    /// Whether the camera has the common clock. All cameras with this flag share one clock.
    pub shared: bool,
    /// Whether the clock's rate may differ from that of the reference's clock.
    pub drift: bool,
    /// Whether frames may be missing although the times show no gap.
    pub lost: bool,
    /// The time from the first row's exposure to the last row's, seconds; 0 for a global shutter. Every row of a frame
    /// is exposed at a time of its own ([`RowTimes`]).
    pub readout_s: f64,
}

/// The times of an image's rows relative to its frame's time: a rolling shutter exposes one row after the other,
/// from the first to the last, at a constant rate. A frame's time is that of its middle.
///
/// Rows are those of the camera's own image, lens distortion included. On another clock whose rate differs by
/// [`MAX_DRIFT_PPM`], they are off by a thousandth of the readout, which is neglected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowTimes {
    s_per_px: f64,
    middle_px: f64,
}

impl RowTimes {
    /// A camera's rows: `height` pixels, and the time from the first row's to the last row's. One row has the
    /// frame's time.
    pub fn new(readout_s: f64, height: usize) -> Self {
        let s_per_px = if height > 1 { readout_s / (height - 1) as f64 } else { 0.0 };
        Self { s_per_px, middle_px: 0.5 * height as f64 }
    }

    /// The time of a position in the image relative to its frame's time, seconds. `y_px` is its vertical coordinate,
    /// pixels; the first row's centre is at 0.5. Exactly 0 for a global shutter.
    pub fn offset_s(&self, y_px: f64) -> f64 {
        if self.s_per_px == 0.0 { 0.0 } else { self.s_per_px * (y_px - self.middle_px) }
    }

    /// The time from one row to the next, seconds; 0 for a global shutter.
    pub fn s_per_px(&self) -> f64 {
        self.s_per_px
    }

    /// Whether all rows have the frame's time.
    pub fn are_global(&self) -> bool {
        self.s_per_px == 0.0
    }
}

impl Clock {
    /// An error unless the times are strictly ascending and at least [`MIN_FRAME_S`] apart. The error is a reason,
    /// without the file's name.
    pub(super) fn ascends(&self) -> Result<(), String> {
        match self.times_s.windows(2).position(|w| !(w[1] - w[0] >= MIN_FRAME_S)) {
            None => Ok(()),
            Some(k) => Err(format!(
                "the times of frames {k} and {} do not ascend by at least {MIN_FRAME_S:?} s",
                k + 1
            )),
        }
    }

    /// An error unless the readout time is finite, not negative, and at most the median time between frames. The error
    /// is a reason, without the file's name.
    pub(super) fn readout_fits(&self) -> Result<(), String> {
        let readout_s = self.readout_s;
        if !(0.0..=MAX_READOUT_S).contains(&readout_s) {
            return Err(format!(
                "readout_s is {readout_s:?}, must be from 0 to {MAX_READOUT_S:?} s"
            ));
        }
        let frame_s = self.frame_s();
        // A frame interval that is a rounded fraction, as 1 / 30 s, may be its readout.
        if self.times_s.len() > 1 && readout_s > frame_s * (1.0 + READOUT_ROUNDING) {
            return Err(format!(
                "readout_s is {readout_s:?}, longer than the {frame_s:?} s from frame to frame"
            ));
        }
        Ok(())
    }

    /// The median time between frames, seconds; 0 for a single frame.
    pub fn frame_s(&self) -> f64 {
        let mut gaps: Vec<f64> = self.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
    }

    /// The index of the frame nearest to a time, the earlier one of two equally near.
    pub fn nearest(&self, time_s: f64) -> usize {
        let times = &self.times_s;
        let after = times.partition_point(|&t| t < time_s).min(times.len().saturating_sub(1));
        match after.checked_sub(1) {
            Some(before) if time_s - times[before] <= times[after] - time_s => before,
            _ => after,
        }
    }
}

/// Indices of the last frame at or before a time, and of the first frame at or after it. They are equal if a frame has
/// exactly this time.
///
/// `None` before the first time, after the last, and for NaN. `times_s` must ascend; of equal times, the first counts.
pub fn bracket(times_s: &[f64], time_s: f64) -> Option<(usize, usize)> {
    let after = times_s.partition_point(|&t| t < time_s);
    let found = *times_s.get(after)?;
    if found == time_s { Some((after, after)) } else { Some((after.checked_sub(1)?, after)) }
}

/// Whether times are finite and strictly ascending. Adding a very large offset rounds neighbouring times to equal
/// values.
pub fn are_frame_times(times_s: &[f64]) -> bool {
    times_s.iter().all(|t| t.is_finite()) && times_s.windows(2).all(|w| w[0] < w[1])
}

/// The times of a camera's frames and of the positions in them.
#[derive(Clone, Copy, Debug)]
pub struct FrameTimes<'a> {
    /// The time of each frame's middle row, seconds on any clock, strictly ascending.
    pub times_s: &'a [f64],
    pub rows: RowTimes,
}

impl<'a> FrameTimes<'a> {
    /// The times of a global shutter's frames.
    pub fn global(times_s: &'a [f64]) -> Self {
        Self { times_s, rows: RowTimes::default() }
    }

    /// The time at which a position of a frame was exposed, seconds. The position is in the camera's own image,
    /// pixels.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn at(&self, frame: usize, position: &Point2<f64>) -> f64 {
        self.times_s[frame] + self.rows.offset_s(position.y)
    }
}

impl FilmedCamera {
    /// The times of its images' rows.
    pub fn row_times(&self) -> RowTimes {
        RowTimes::new(self.clock.readout_s, self.camera.height)
    }

    /// The times of positions in its frames, of the frames' times on any clock.
    pub fn frame_times<'a>(&self, times_s: &'a [f64]) -> FrameTimes<'a> {
        FrameTimes { times_s, rows: self.row_times() }
    }

    /// Upper bound on the recording's duration, from the first frame's start to the last frame's end, seconds on any
    /// clock. A camera that may lose frames (`lost`) is assumed to have lost at most half of them.
    fn max_duration_s(&self) -> f64 {
        let times = &self.clock.times_s;
        let duration_s = times[times.len() - 1] - times[0] + self.clock.frame_s();
        let lost = if self.clock.lost { 2.0 } else { 1.0 };
        duration_s * lost * (1.0 + 1e-6 * MAX_DRIFT_PPM)
    }
}

impl Capture {
    /// Upper bound on the time between a camera's recording and the reference's, seconds. Offsets are estimated along
    /// chains of overlapping recordings; the longest chain has all recordings one after the other.
    pub fn reach_s(&self) -> f64 {
        self.cameras.iter().map(FilmedCamera::max_duration_s).sum()
    }

    /// Whether a camera is the reference, or shares its clock.
    pub fn has_reference_clock(&self, camera: usize) -> bool {
        let shares = |c: usize| self.cameras[c].clock.shared;
        camera == self.reference || (shares(camera) && shares(self.reference))
    }

    /// Bounds on the times of a camera's frames for every possible offset, seconds on the reference's clock. `None`
    /// stands for all cameras together. The bounds are exact for a camera with the reference's clock that loses no
    /// frames.
    pub fn widest_span_s(&self, camera: Option<usize>) -> (f64, f64) {
        let reference = &self.cameras[self.reference];
        let span = |c: usize| {
            let clock = &self.cameras[c].clock;
            let (first, last) = (clock.times_s[0], clock.times_s[clock.times_s.len() - 1]);
            if !self.has_reference_clock(c) {
                let (reach, reference) = (self.reach_s(), &reference.clock.times_s);
                (reference[0] - reach, reference[reference.len() - 1] + reach)
            } else if clock.lost {
                (first, first + self.cameras[c].max_duration_s())
            } else {
                (first, last)
            }
        };
        match camera {
            Some(camera) => span(camera),
            None => (0..self.cameras.len())
                .map(span)
                .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
                .unwrap_or_default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock() -> Clock {
        let times_s = vec![0.0, 1.0, 2.5, 3.5];
        Clock { times_s, shared: false, drift: false, lost: false, readout_s: 0.0 }
    }

    #[test]
    fn rows_are_read_from_the_first_to_the_last_around_the_frame_s_time() {
        let rows = RowTimes::new(0.03, 4);
        let offsets = [0.5, 1.5, 2.5, 3.5, 2.0].map(|y| rows.offset_s(y));
        for (offset, expected) in offsets.iter().zip([-0.015, -0.005, 0.005, 0.015, 0.0]) {
            assert!((offset - expected).abs() < 1e-15, "{offset}");
        }
        assert!(!rows.are_global());
        for global in [RowTimes::new(0.0, 4), RowTimes::new(0.03, 1), RowTimes::default()] {
            assert!(global.are_global());
            assert_eq!(global.offset_s(123.0).to_bits(), 0.0f64.to_bits());
        }
    }

    #[test]
    fn bracketing_frames() {
        let c = clock().times_s;
        assert_eq!(bracket(&c, 0.25), Some((0, 1)));
        assert_eq!(bracket(&c, 1.0), Some((1, 1)));
        assert_eq!(bracket(&c, 3.5), Some((3, 3)));
        assert_eq!(bracket(&c, -0.1), None);
        assert_eq!(bracket(&c, 3.6), None);
        assert_eq!(bracket(&c, f64::NAN), None);
        assert_eq!(bracket(&c, 1e300), None);
        assert_eq!(bracket(&[], 0.0), None);
    }

    #[test]
    fn equal_times_bracket_within_the_frames() {
        let equal = [1e16 + 0.1, 1e16 + 0.2, 1e16 + 0.3];
        assert_eq!(bracket(&equal, 1e16), Some((0, 0)));
        assert!(!are_frame_times(&equal) && !are_frame_times(&[f64::INFINITY]));
        assert!(are_frame_times(&clock().times_s) && are_frame_times(&[]));
    }

    #[test]
    fn nearest_frame() {
        let c = clock();
        let at: Vec<usize> = [-9.0, 0.4, 0.6, 1.75, 1.76, 99.0].map(|t| c.nearest(t)).into();
        assert_eq!(at, [0, 0, 1, 1, 2, 3]);
    }

    #[test]
    fn frame_duration_is_the_median() {
        assert_eq!(clock().frame_s(), 1.0);
        assert_eq!(Clock { times_s: vec![3.0], ..clock() }.frame_s(), 0.0);
    }
}
