//! A camera's own clock, the times of an image's rows, and bounds on the times of frames while temporal offsets are
//! unknown.

use super::{Capture, FilmedCamera};
use nalgebra::Point2;

/// Shortest allowed time between two frames of a camera, seconds. The estimation of offsets and trajectories divides by
/// the time between frames.
const MIN_FRAME_S: f64 = 1e-9;
/// Largest allowed absolute time, seconds (3000 years). Unix times are accepted in seconds and refused in milliseconds.
pub(super) const MAX_TIME_S: f64 = 1e11;

/// Longest allowed readout time of a rolling shutter, seconds. Real cameras need at most 0.1 s.
const MAX_READOUT_S: f64 = 1.0;
/// Relative tolerance when the readout time is compared with the frame interval. Times in files are rounded decimals.
const READOUT_ROUNDING: f64 = 1e-6;

/// Largest assumed drift of a clock relative to the reference camera's clock, parts per million. Quartz clocks drift by
/// at most 100.
pub const MAX_DRIFT_PPM: f64 = 1000.0;

/// Times of a camera's frames on its own clock, and how this clock may differ from the reference camera's clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clock {
    /// Time of each frame, seconds on the camera's own clock, strictly ascending. It is the middle of the exposure of
    /// the frame's middle row. [`Capture::time_origin_s`] is subtracted.
    pub times_s: Vec<f64>,
    /// Whether the camera runs on the common clock. All cameras with this flag share one clock.
    pub shared: bool,
    /// Whether the clock's rate may differ from the rate of the reference camera's clock.
    pub drift: bool,
    /// Whether the camera may have lost frames although its times show no gap.
    pub lost: bool,
    /// Time from the exposure of a frame's first row to the exposure of its last row, seconds. 0 for a global shutter.
    /// [`RowTimes`] gives the time of each row.
    pub readout_s: f64,
    /// Standard error of `readout_s`, seconds; 0 if the readout time is exact. If it isn't, the readout time is
    /// estimated together with the temporal offsets. Where no offsets are estimated, as between cameras that share one
    /// clock, `readout_s` is used as given.
    pub readout_std_s: f64,
}

/// Exposure times of an image's rows, relative to the frame's time. A rolling shutter exposes the rows one after
/// another, from the first to the last, at a constant rate. The frame's time is the time of the middle of the image.
///
/// Rows are counted in the camera's own image, with lens distortion. If the rate of the camera's clock differs by
/// [`MAX_DRIFT_PPM`] from the reference's, row times are wrong by a thousandth of the readout time. This error is
/// neglected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowTimes {
    s_per_px: f64,
    middle_px: f64,
}

impl RowTimes {
    /// Makes the row times of an image of `height` pixels. `readout_s` is the time from the first row to the last row,
    /// seconds. The single row of an image of height 1 is exposed at the frame's time.
    pub fn new(readout_s: f64, height: usize) -> Self {
        let s_per_px = if height > 1 { readout_s / (height - 1) as f64 } else { 0.0 };
        Self { s_per_px, middle_px: 0.5 * height as f64 }
    }

    /// Returns the exposure time of a position in the image, relative to the frame's time, seconds. `y_px` is the
    /// vertical coordinate in pixels. The first row's centre is at 0.5. Exactly 0 for a global shutter.
    pub fn offset_s(&self, y_px: f64) -> f64 {
        if self.s_per_px == 0.0 { 0.0 } else { self.s_per_px * (y_px - self.middle_px) }
    }

    /// Returns the time from one row to the next, seconds. 0 for a global shutter.
    pub fn s_per_px(&self) -> f64 {
        self.s_per_px
    }

    /// Returns whether all rows are exposed at the frame's time, as with a global shutter.
    pub fn are_global(&self) -> bool {
        self.s_per_px == 0.0
    }
}

impl Clock {
    /// Returns an error unless the times are strictly ascending and at least [`MIN_FRAME_S`] apart. The caller adds the
    /// file's name to the error message.
    pub(super) fn ascends(&self) -> Result<(), String> {
        match self.times_s.windows(2).position(|w| !(w[1] - w[0] >= MIN_FRAME_S)) {
            None => Ok(()),
            Some(k) => Err(format!(
                "the times of frames {k} and {} do not ascend by at least {MIN_FRAME_S:?} s",
                k + 1
            )),
        }
    }

    /// Returns an error unless the readout time and its standard error are from 0 to [`MAX_READOUT_S`], and the readout
    /// time is at most the median time between frames. The caller adds the file's name to the error message.
    pub(super) fn readout_fits(&self) -> Result<(), String> {
        let readout_s = self.readout_s;
        for (field, value_s) in [("readout_s", readout_s), ("readout_std_s", self.readout_std_s)] {
            if !(0.0..=MAX_READOUT_S).contains(&value_s) {
                return Err(format!(
                    "{field} is {value_s:?}, must be from 0 to {MAX_READOUT_S:?} s"
                ));
            }
        }
        let frame_s = self.frame_s();
        // The readout time may equal a frame interval that is a rounded fraction such as 1 / 30 s.
        if self.times_s.len() > 1 && readout_s > frame_s * (1.0 + READOUT_ROUNDING) {
            return Err(format!(
                "readout_s is {readout_s:?}, longer than the {frame_s:?} s from frame to frame"
            ));
        }
        Ok(())
    }

    /// Returns the longest readout time that an estimate may have, seconds: the median time between frames. `None` for a
    /// single frame.
    pub fn longest_readout_s(&self) -> Option<f64> {
        Some(self.frame_s()).filter(|frame_s| *frame_s > 0.0)
    }

    /// Returns the median time between frames, seconds. 0 for a single frame.
    pub fn frame_s(&self) -> f64 {
        let mut gaps: Vec<f64> = self.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Returns the index of the frame nearest to a time. Of two equally near frames, the earlier one.
    pub fn nearest(&self, time_s: f64) -> usize {
        let times = &self.times_s;
        let after = times.partition_point(|&t| t < time_s).min(times.len().saturating_sub(1));
        match after.checked_sub(1) {
            Some(before) if time_s - times[before] <= times[after] - time_s => before,
            _ => after,
        }
    }
}

/// Returns the indices of the last frame at or before a time, and of the first frame at or after the time. The two are
/// equal if a frame has exactly this time.
///
/// `None` for a time before the first frame or after the last frame, and for NaN. `times_s` must ascend. Among equal
/// times, the first frame is returned.
pub fn bracket(times_s: &[f64], time_s: f64) -> Option<(usize, usize)> {
    let after = times_s.partition_point(|&t| t < time_s);
    let found = *times_s.get(after)?;
    if found == time_s { Some((after, after)) } else { Some((after.checked_sub(1)?, after)) }
}

/// Returns whether times are finite and strictly ascending. Adding a very large offset to times can round neighbouring
/// times to equal values.
pub fn are_frame_times(times_s: &[f64]) -> bool {
    times_s.iter().all(|t| t.is_finite()) && times_s.windows(2).all(|w| w[0] < w[1])
}

/// Times of a camera's frames, and of the rows in the frames.
#[derive(Clone, Copy, Debug)]
pub struct FrameTimes<'a> {
    /// Time of each frame's middle row, seconds, strictly ascending. The clock is the camera's own or the reference's.
    pub times_s: &'a [f64],
    pub rows: RowTimes,
}

impl<'a> FrameTimes<'a> {
    /// Makes the times of frames from a camera with a global shutter, whose rows are all exposed at the frame's time.
    pub fn global(times_s: &'a [f64]) -> Self {
        Self { times_s, rows: RowTimes::default() }
    }

    /// Returns the time at which a position of a frame was exposed, seconds on the clock of `times_s`. The position is
    /// in the camera's own image with lens distortion, pixels.
    ///
    /// # Panics
    /// If the camera has no frame with this index.
    pub fn at(&self, frame: usize, position: &Point2<f64>) -> f64 {
        self.times_s[frame] + self.rows.offset_s(position.y)
    }
}

impl FilmedCamera {
    /// Returns the exposure times of this camera's image rows, relative to a frame's time.
    pub fn row_times(&self) -> RowTimes {
        RowTimes::new(self.clock.readout_s, self.camera.height)
    }

    /// Combines the given times of this camera's frames with the times of its image rows. The given times may be on any
    /// clock.
    pub fn frame_times<'a>(&self, times_s: &'a [f64]) -> FrameTimes<'a> {
        FrameTimes { times_s, rows: self.row_times() }
    }

    /// Returns an upper bound on the duration of the recording, from the start of the first frame to the end of the
    /// last frame, seconds on any camera's clock. A camera that may lose frames (`lost`) is assumed to have lost at
    /// most half of its frames.
    fn max_duration_s(&self) -> f64 {
        let times = &self.clock.times_s;
        let duration_s = times[times.len() - 1] - times[0] + self.clock.frame_s();
        let lost = if self.clock.lost { 2.0 } else { 1.0 };
        duration_s * lost * (1.0 + 1e-6 * MAX_DRIFT_PPM)
    }
}

impl Capture {
    /// Returns an upper bound on the time between any camera's recording and the reference's recording, seconds. The
    /// bound is the sum of the durations of all recordings: offsets are only estimated between recordings that overlap,
    /// directly or through the recordings of other cameras.
    pub fn reach_s(&self) -> f64 {
        self.cameras.iter().map(FilmedCamera::max_duration_s).sum()
    }

    /// Returns whether a camera is the reference, or shares the reference's clock.
    pub fn has_reference_clock(&self, camera: usize) -> bool {
        let shares = |c: usize| self.cameras[c].clock.shared;
        camera == self.reference || (shares(camera) && shares(self.reference))
    }

    /// Returns the lower and the upper bound on the times of a camera's frames, seconds on the reference's clock. The
    /// bounds hold for every possible offset of the camera. If `camera` is `None`, the bounds are for all cameras
    /// together. The bounds are exact for a camera that has the reference's clock and loses no frames.
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
        Clock { times_s, ..Clock::default() }
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
