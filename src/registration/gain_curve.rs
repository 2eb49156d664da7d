//! A camera's gains as a function of time. Automatic exposure and white balance change them.

use serde::{Deserialize, Serialize};

/// The change of a camera's gains over its recording, relative to its gains at the middle frame. The logarithms of the
/// gains are piecewise linear in time. Without knots, the gains are constant.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GainCurve {
    /// The knots, ascending in time.
    knots: Vec<GainKnot>,
}

/// A knot of a [`GainCurve`]: the camera's measured gains at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GainKnot {
    /// Time of the knot, in seconds on the camera's own clock.
    pub time_s: f64,
    /// Natural logarithms of the gains of red, green and blue, relative to the gains at the middle frame.
    pub log: [f64; 3],
}

/// Maximum absolute value of [`GainKnot::log`] that is accepted when a curve is read from disk.
const MAX_LOG: f64 = 14.0;

impl GainCurve {
    /// Creates the curve through these knots, whose times must ascend.
    pub fn new(knots: Vec<GainKnot>) -> Self {
        debug_assert!(knots.windows(2).all(|w| w[0].time_s < w[1].time_s));
        Self { knots }
    }

    /// Returns whether the camera's gains don't change.
    pub fn is_constant(&self) -> bool {
        self.knots.is_empty()
    }

    /// Returns the size of the knots in memory, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.knots[..])
    }

    /// Returns whether a curve that was read from a file is valid.
    pub(super) fn is_plausible(&self) -> bool {
        let is_log = |knot: &GainKnot| knot.log.iter().all(|l| l.abs() <= MAX_LOG);
        let ascend = self.knots.windows(2).all(|w| w[0].time_s < w[1].time_s);
        ascend && self.knots.iter().all(|k| k.time_s.is_finite() && is_log(k))
    }

    /// Returns the natural logarithms of the gains of red, green and blue at `time_s`, relative to the gains at the
    /// middle frame. `time_s` is in seconds on the camera's own clock. Before the first knot and after the last knot,
    /// the gains are constant. Without knots, all logarithms are 0.
    pub fn log_at(&self, time_s: f64) -> [f64; 3] {
        let after = self.knots.partition_point(|k| k.time_s <= time_s);
        let (before, after) = (after.checked_sub(1), self.knots.get(after));
        match (before.map(|k| &self.knots[k]), after) {
            (None, None) => [0.0; 3],
            (Some(knot), None) | (None, Some(knot)) => knot.log,
            (Some(a), Some(b)) => {
                let fraction = (time_s - a.time_s) / (b.time_s - a.time_s);
                [0, 1, 2].map(|c| a.log[c] + fraction * (b.log[c] - a.log[c]))
            }
        }
    }

    /// Returns the largest change of a channel's gain over the recording: the ratio of the largest to the smallest
    /// gain, minus 1. It is 0 without knots.
    pub fn largest_change(&self) -> f64 {
        let range = |c: usize| {
            let logs = || self.knots.iter().map(|k| k.log[c]);
            (logs().fold(0.0, f64::max) - logs().fold(0.0, f64::min)).exp_m1()
        };
        (0..3).map(range).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> GainCurve {
        let knot = |time_s: f64, log: f64| GainKnot { time_s, log: [log, 0.0, -log] };
        GainCurve::new(vec![knot(1.0, -0.2), knot(2.0, 0.0), knot(4.0, 0.6)])
    }

    #[test]
    fn logs_are_interpolated_and_clamped() {
        let at = |time_s: f64| curve().log_at(time_s)[0];
        for (time_s, log) in
            [(0.0, -0.2), (1.0, -0.2), (1.5, -0.1), (3.0, 0.3), (4.0, 0.6), (9.0, 0.6)]
        {
            assert!((at(time_s) - log).abs() < 1e-12, "{time_s}: {}", at(time_s));
        }
        assert_eq!(GainCurve::default().log_at(3.0), [0.0; 3]);
        assert!((curve().largest_change() - 0.8_f64.exp_m1()).abs() < 1e-12);
        assert_eq!(GainCurve::default().largest_change(), 0.0);
    }

    #[test]
    fn implausible_curves_are_refused() {
        assert!(curve().is_plausible() && GainCurve::default().is_plausible());
        for (k, wrong) in [(0, f64::NAN), (1, 0.5), (2, f64::INFINITY)] {
            let mut curve = curve();
            curve.knots[k].time_s = wrong;
            assert!(!curve.is_plausible(), "{wrong}");
        }
        for wrong in [f64::NAN, -15.0, f64::INFINITY] {
            let mut curve = curve();
            curve.knots[1].log[2] = wrong;
            assert!(!curve.is_plausible(), "{wrong}");
        }
    }
}
