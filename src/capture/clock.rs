//! A camera's own clock.

/// Shortest time between two frames, seconds. Larger: fast cameras are refused. Smaller: offsets
/// and trajectories, which divide by it, overflow, and times of a wrong unit pass.
const MIN_FRAME_S: f64 = 1e-9;
/// Largest absolute time, seconds (3000 years). Larger: microseconds since 1970 pass for seconds.
/// Smaller: seconds since 1970 are refused.
pub(super) const MAX_TIME_S: f64 = 1e11;

/// Largest drift of a clock against the reference's, millionths: of a simulated rig, and of the
/// clocks that are estimated.
///
/// Quartz is off by 100 at most. Larger: the estimate of a drift has more rates to try, and a
/// rate that few features show is less certain. Smaller: cheap oscillators are outside of it.
pub const MAX_DRIFT_PPM: f64 = 1000.0;

/// The times of a camera's frames on its own clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    /// The middle of every frame's exposure: seconds from the capture's start, strictly ascending.
    pub times_s: Vec<f64>,
    /// Whether the reference has the same clock, so that there is no offset to estimate.
    pub shared: bool,
    /// Whether its rate may differ from the reference's.
    pub drift: bool,
    /// Whether frames may be missing without a trace.
    pub lost: bool,
}

impl Clock {
    /// Subtracts the capture's start. Done once, where times are read: 1.8e9 s (Unix time) leaves
    /// an f64 2.4e-7 s, a capture's own seconds leave it 1e-16 s.
    pub(super) fn rebase(&mut self, origin_s: f64) {
        for t in &mut self.times_s {
            *t -= origin_s;
        }
    }

    /// Refuses times that do not ascend; the error is a reason.
    pub(super) fn ascends(&self) -> Result<(), String> {
        match self.times_s.windows(2).position(|w| !(w[1] - w[0] >= MIN_FRAME_S)) {
            None => Ok(()),
            Some(k) => Err(format!(
                "the times of frames {k} and {} do not ascend by at least {MIN_FRAME_S:?} s",
                k + 1
            )),
        }
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

/// Indices of the frames on both sides of a time: the last one at or before it, and the first one
/// at or after it. They are equal for a frame at that very time.
///
/// `None` before the first time, after the last one, and for NaN. `times_s` must ascend; of equal
/// times, the first counts.
pub fn bracket(times_s: &[f64], time_s: f64) -> Option<(usize, usize)> {
    let after = times_s.partition_point(|&t| t < time_s);
    let found = *times_s.get(after)?;
    if found == time_s { Some((after, after)) } else { Some((after.checked_sub(1)?, after)) }
}

/// Whether times can be those of a camera's frames on another clock: finite and ascending. An offset so
/// large that the time between frames is lost in rounding gives no such times.
pub fn are_frame_times(times_s: &[f64]) -> bool {
    times_s.iter().all(|t| t.is_finite()) && times_s.windows(2).all(|w| w[0] < w[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock() -> Clock {
        Clock { times_s: vec![0.0, 1.0, 2.5, 3.5], shared: false, drift: false, lost: false }
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
