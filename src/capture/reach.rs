//! What is known of when cameras filmed before their offsets are: bounds from the recordings' lengths.

use super::{Capture, FilmedCamera, MAX_DRIFT_PPM};

impl FilmedCamera {
    /// How long the recording can have been on any clock, seconds, its last frame included. Frames that
    /// it may have lost lengthen it; more than it has are not believed.
    fn max_duration_s(&self) -> f64 {
        let times = &self.clock.times_s;
        let duration_s = times[times.len() - 1] - times[0] + self.clock.frame_s();
        let lost = if self.clock.lost { 2.0 } else { 1.0 };
        duration_s * lost * (1.0 + 1e-6 * MAX_DRIFT_PPM)
    }
}

impl Capture {
    /// How far a camera's recording can be from the reference's, seconds: images tell an offset only
    /// where recordings overlap, in a chain that leads to the reference, and no chain is longer than all
    /// recordings one after the other.
    pub fn reach_s(&self) -> f64 {
        self.cameras.iter().map(FilmedCamera::max_duration_s).sum()
    }

    /// Whether a camera has the reference's clock: its own, or one that both share.
    pub fn has_reference_clock(&self, camera: usize) -> bool {
        let shares = |c: usize| self.cameras[c].clock.shared;
        camera == self.reference || (shares(camera) && shares(self.reference))
    }

    /// The first and the last time that a camera's frames can have on the reference's clock, whatever
    /// its offset, seconds; those of all cameras for `None`. They are exact for a camera with the
    /// reference's own clock that loses no frames.
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
