//! Clock models: the offset, rate and lost frames of one camera's clock relative to another clock.

use crate::capture::{Capture, Clock};

/// Relation of a camera's own clock to a target clock: an offset that changes linearly with time, and the camera's
/// lost frames.
///
/// `target time = own time + offset_s + rate · (own time − reference_s)`. The own time of an image is the image's
/// nominal time plus one frame period for each frame that is missing before the image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// Target time minus own time, seconds, at the own time `reference_s`.
    pub offset_s: f64,
    /// The rate of change of the offset with time on the own clock, seconds per second.
    pub rate: f64,
    /// The own time at which the offset equals `offset_s`, seconds.
    pub reference_s: f64,
    /// The indices of the images directly before which a frame is missing, ascending. An index occurs once for each
    /// missing frame.
    pub lost_before: Vec<usize>,
}

/// An estimated clock model with its standard errors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockEstimate {
    pub clock: ClockModel,
    /// The standard error of the clock's offset, seconds.
    pub std_err_s: f64,
    /// The standard error of the clock's rate, seconds per second; 0 for a clock that does not drift.
    pub rate_std_err: f64,
}

/// A camera's clock as the capture states it, before any estimation.
#[derive(Clone, Copy, Debug)]
pub struct NominalClock<'a> {
    /// The time of every image on the camera's own clock, ascending, seconds.
    pub times_s: &'a [f64],
    /// The median time between successive images, seconds.
    pub frame_s: f64,
    /// Whether frames may be missing although `times_s` shows no gap.
    pub may_lose_frames: bool,
    /// Whether the rate of this clock may differ from the rate of the reference camera's clock.
    pub drifts: bool,
}

impl<'a> NominalClock<'a> {
    /// Returns the nominal clock of the camera with the index `camera`.
    pub fn of_camera(capture: &'a Capture, camera: usize) -> Self {
        let clock = &capture.cameras[camera].clock;
        Self {
            times_s: &clock.times_s,
            frame_s: clock.frame_s(),
            may_lose_frames: clock.lost,
            drifts: clock.drift && camera != capture.reference,
        }
    }
}

impl ClockModel {
    /// Returns a model with the given offset, seconds, and without drift or lost frames.
    pub fn constant(offset_s: f64) -> Self {
        Self { offset_s, ..Self::default() }
    }

    /// Returns the offset (target time minus own time) at a time on the own clock, both in seconds.
    pub fn offset_at(&self, time_s: f64) -> f64 {
        self.offset_s + self.rate * (time_s - self.reference_s)
    }

    /// Converts a time on the own clock to the target clock; both in seconds.
    pub fn apply(&self, time_s: f64) -> f64 {
        time_s + (time_s - self.reference_s) * self.rate + self.offset_s
    }

    /// Returns this clock's offset relative to another clock, as a function of the time on that other clock. Both
    /// models must have the same target clock. The result is exact to first order in the rates, and has no lost
    /// frames.
    pub fn relative_to(&self, other: &Self) -> Self {
        Self {
            offset_s: self.offset_at(other.reference_s) - other.offset_s,
            rate: self.rate - other.rate,
            reference_s: other.reference_s,
            lost_before: Vec::new(),
        }
    }

    /// Returns the time of an image on the camera's own clock, seconds, including one frame period for each frame
    /// missing before the image. `None` if no image has this index.
    pub fn own_time_s(&self, nominal: &NominalClock, image: usize) -> Option<f64> {
        let missing = self.lost_before.partition_point(|&n| n <= image) as f64;
        Some(nominal.times_s.get(image)? + nominal.frame_s * missing)
    }

    /// Returns the times of all images on the camera's own clock, seconds. Each includes one frame period for each
    /// frame missing before the image.
    pub fn own_times_s(&self, nominal: &NominalClock) -> Vec<f64> {
        (0..nominal.times_s.len()).map_while(|image| self.own_time_s(nominal, image)).collect()
    }

    /// Returns the time of an image on the target clock, seconds. `None` if no image has this index.
    pub fn image_time_s(&self, nominal: &NominalClock, image: usize) -> Option<f64> {
        let own_s = self.own_time_s(nominal, image)?;
        // The terms are summed in another order than in `apply`. The last bit of fitted values depends on this order.
        Some(own_s + self.offset_s + self.rate * (own_s - self.reference_s))
    }

    /// Returns the times of all images on the target clock, seconds.
    pub fn image_times_s(&self, nominal: &NominalClock) -> Vec<f64> {
        (0..nominal.times_s.len()).map_while(|image| self.image_time_s(nominal, image)).collect()
    }
}

/// Returns a camera's clock with frame times that are corrected for lost frames. `lost_before` holds the indices of
/// the images directly before which a frame is missing.
pub fn with_lost_frames(capture: &Capture, camera: usize, lost_before: &[usize]) -> Clock {
    let model = ClockModel { lost_before: lost_before.into(), ..ClockModel::default() };
    let times_s = model.own_times_s(&NominalClock::of_camera(capture, camera));
    Clock { times_s, ..capture.cameras[camera].clock.clone() }
}

/// Returns the index of each camera's clock, by camera, and the number of clocks.
///
/// The reference camera has clock 0. All cameras whose clock is marked as shared have one common clock. This is clock
/// 0 if the reference camera's clock is shared too. Every other camera has a clock of its own.
pub fn clocks(capture: &Capture) -> (Vec<usize>, usize) {
    let reference_shares = capture.cameras[capture.reference].clock.shared;
    let mut next = 1;
    let mut shared = reference_shares.then_some(0);
    let mut clock = Vec::with_capacity(capture.cameras.len());
    for (c, camera) in capture.cameras.iter().enumerate() {
        let mut new_clock = || {
            next += 1;
            next - 1
        };
        clock.push(if c == capture.reference {
            0
        } else if camera.clock.shared {
            *shared.get_or_insert_with(new_clock)
        } else {
            new_clock()
        });
    }
    (clock, next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_frames_delay_all_later_images() {
        let own_times_s = |times_s: &[f64], lost_before: &[usize]| {
            let clock = Clock { times_s: times_s.into(), lost: true, ..Clock::default() };
            let frame_s = clock.frame_s();
            let nominal = NominalClock { times_s, frame_s, may_lose_frames: true, drifts: false };
            let lost_before = lost_before.into();
            ClockModel { lost_before, ..ClockModel::default() }.own_times_s(&nominal)
        };
        let times = [0.0, 1.0, 2.0, 3.0];
        assert_eq!(own_times_s(&times, &[]), times);
        assert_eq!(own_times_s(&times, &[2]), [0.0, 1.0, 3.0, 4.0]);
        assert_eq!(own_times_s(&times, &[1, 3, 3]), [0.0, 2.0, 3.0, 6.0]);
        assert_eq!(own_times_s(&[5.0], &[0]), [5.0]);
    }

    #[test]
    fn offsets_are_linear_in_time() {
        let clock =
            ClockModel { offset_s: 0.01, rate: 1e-4, reference_s: 5.0, ..ClockModel::default() };
        assert!((clock.offset_at(15.0) - 0.011).abs() < 1e-15);
        assert!((clock.apply(15.0) - 15.011).abs() < 1e-12);
        assert_eq!(ClockModel::constant(0.2).offset_at(99.0), 0.2);
        let other =
            ClockModel { offset_s: 3.0, rate: 2e-4, reference_s: 25.0, ..ClockModel::default() };
        let relative = clock.relative_to(&other);
        assert!((relative.offset_at(35.0) - (0.013 - 3.002)).abs() < 1e-12);
    }
}
