//! Computes, for each feature, one candidate for the temporal offset between two cameras, from three frames (eq. (10)).
//!
//! A feature is tracked through two frames of camera i and has a correspondence in one frame of camera j. The
//! candidate is the time at which the feature's trajectory in camera i crosses the epipolar line of the
//! correspondence. The paper's trajectory is straight. Beyond the paper, trajectories may be quadratic or cubic
//! curves through the feature's positions in three or four frames of camera i.
//!
//! Known limit: a feature that moves along its epipolar line gives no offset candidate.

use crate::camera::{Camera, EpipolarGeometry, EpipolarLine};
use crate::capture::FrameTimes;
use crate::registration::{Track, Trajectory};
use nalgebra::Point2;

/// One feature's candidate for the temporal offset between cameras i and j.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// `t̃` of eq. (10), seconds: the time from camera i's earlier frame to the crossing of the feature's trajectory
    /// and the epipolar line. Camera j took its frame at this time.
    pub time_s: f64,
    /// The feature's signed speed perpendicular to the epipolar line, at the crossing of the trajectory and the line,
    /// pixels per second. It is negative if the feature moves towards the line's negative side. A perpendicular error
    /// of one pixel is an error of `1 / across_px_s` seconds in `time_s`.
    pub across_px_s: f64,
    /// The position at which the trajectory crosses the epipolar line, undistorted pixels of camera i.
    pub place: Point2<f64>,
    /// The expected deviation of the true motion from the fitted curve, perpendicular to the epipolar line, pixels; 0
    /// for straight trajectories, for which the deviation is not estimated.
    pub trajectory_error_px: f64,
}

impl Candidate {
    /// Returns the signed speed perpendicular to the epipolar line, pixels per second, reduced if the trajectory is
    /// uncertain. The square of this speed is proportional to the offset candidate's information.
    pub fn effective_speed_px_s(&self) -> f64 {
        self.across_px_s / 1.0_f64.hypot(self.trajectory_error_px / TRAJECTORY_SIGMA_PX)
    }
}

/// The trajectory error at which an offset candidate's information is halved, pixels. It equals the localization
/// error of good features.
const TRAJECTORY_SIGMA_PX: f64 = 0.03;
/// The ratio of a trajectory's expected error to the contribution of its highest-order polynomial term. At video rates,
/// each order of a motion contributes about this fraction of what the next lower order contributes.
const NEXT_ORDER_FRACTION: f64 = 0.2;
/// The constant part of the maximum prediction error of a trajectory, pixels. The prediction error is the distance of
/// the trajectory's last sample from the extrapolation of the other samples. Features with larger errors than the sum
/// of the constant part and the proportional part ([`MAX_PREDICTION_ERROR_FRACTION`]) are rejected.
const MAX_PREDICTION_ERROR_PX: f64 = 1.0;
/// The proportional part of the maximum prediction error ([`MAX_PREDICTION_ERROR_PX`]) of a trajectory, as a fraction
/// of the trajectory's largest step between two frames. Rejected features are mostly background features that a moving
/// body occludes; they would support a wrong offset.
const MAX_PREDICTION_ERROR_FRACTION: f64 = 0.3;
/// The maximum number of Newton steps to the crossing of a trajectory and an epipolar line.
const MAX_NEWTON_STEPS: usize = 4;
/// The size of a Newton step, as a fraction of the interval between the two frames, below which Newton's method has
/// converged.
const NEWTON_TOLERANCE: f64 = 1e-9;
/// The minimum speed perpendicular to the epipolar line during Newton's method, as a fraction of
/// [`ThreeFrames::min_across_px`] per frame interval. A slower feature has no offset candidate, since Newton's method
/// may diverge.
const MIN_SLOPE_FRACTION: f64 = 0.5;
/// The relative rounding error that is tolerated when the length of a motion is compared with
/// [`ThreeFrames::min_across_px`].
const ROUNDING: f64 = 1e-9;

/// Two successive frames of camera i and one frame of camera j, from which offset candidates are computed (eq. (10)).
pub struct ThreeFrames<'a> {
    /// Camera i, which has two frames.
    pub camera_i: &'a Camera,
    /// Camera j, which has one frame.
    pub camera_j: &'a Camera,
    /// The times of camera i's frames on its own clock. With a rolling shutter, each position has the time of its
    /// image row.
    pub times_i: FrameTimes<'a>,
    /// The index of the earlier one of camera i's two frames. It must not be the index of camera i's last frame.
    pub index_i: usize,
    /// Whether trajectories are curves instead of straight lines. A curve also passes through the feature's positions
    /// in the frames before and after camera i's two frames, if these exist.
    pub curved: bool,
    /// The minimum motion of a feature between camera i's two frames, perpendicular to its epipolar line, pixels.
    /// Features that move less have no offset candidate.
    pub min_across_px: f64,
}

impl ThreeFrames<'_> {
    /// Returns the offset candidates of all features. A candidate is the crossing of a feature's trajectory in camera
    /// i with the epipolar line of its correspondence in camera j. `in_j` holds the correspondence of each of
    /// `tracks`, pixels.
    ///
    /// A feature gives no candidate if it has no correspondence, lies at the epipole, moves too little across its
    /// epipolar line, or crosses that line far from the track's two frames. Cameras with a common centre have no
    /// epipolar lines, and give no candidates.
    pub fn candidates(&self, tracks: &[&Track], in_j: &[Option<Point2<f64>>]) -> Vec<Candidate> {
        self.crossings(tracks, in_j).into_iter().filter_map(|(_, c)| c).collect()
    }

    /// Returns the features that move by at least `min_across_px` perpendicular to their epipolar lines, as (index
    /// into `tracks`, offset candidate).
    ///
    /// The candidate is `None` if the trajectory does not cross the epipolar line near the two frames, or if the
    /// feature has no correspondence in camera j. A feature without a correspondence is measured against the epipolar
    /// line through its own position.
    pub fn crossings(
        &self,
        tracks: &[&Track],
        in_j: &[Option<Point2<f64>>],
    ) -> Vec<(usize, Option<Candidate>)> {
        let i_from_j = EpipolarGeometry::new(self.camera_j, self.camera_i);
        let j_from_i = EpipolarGeometry::new(self.camera_i, self.camera_j);
        let Some((i_from_j, j_from_i)) = i_from_j.zip(j_from_i) else { return Vec::new() };
        let line = |track: &Track, p_j: Option<Point2<f64>>| match p_j {
            Some(p_j) => i_from_j.line_in_j(&self.camera_j.model.ideal_from_pixel(&p_j)?),
            // The correspondence lies on the epipolar line of p_i in camera j. All points of that line have the same
            // epipolar line in camera i, so any of them will do.
            None => {
                let p_i = self.camera_i.model.ideal_from_pixel(&track.earlier)?;
                i_from_j.line_in_j(&j_from_i.line_in_j(&p_i)?.nearest(&p_i))
            }
        };
        let crossing = |(k, (track, p_j)): (usize, (&&Track, &Option<Point2<f64>>))| {
            let candidate = self.crossing(&line(track, *p_j)?, track)?;
            Some((k, candidate.filter(|_| p_j.is_some())))
        };
        tracks.iter().zip(in_j).enumerate().filter_map(crossing).collect()
    }

    /// Returns whether a feature can have an offset candidate with some camera j: its trajectory is smooth, and its
    /// motion is at least `min_across_px` long. For such a motion, there are directions of epipolar lines that it
    /// crosses by at least `min_across_px`.
    pub fn can_cross(&self, track: &Track) -> bool {
        let ideal = |p| self.camera_i.model.ideal_from_pixel(p);
        let motion = ideal(&track.earlier).zip(ideal(&track.later)).map(|(from, to)| to - from);
        // The motion's length differs between distorted and undistorted pixels. The longer one is compared.
        let min_px = (1.0 - ROUNDING) * self.min_across_px;
        motion.is_some_and(|motion| motion.norm().max(track.motion().norm()) >= min_px)
            && self.samples(track).is_some()
    }

    /// Computes a feature's offset candidate for a given epipolar line: the crossing of trajectory and line, by
    /// Newton's method. The outer `None` means that the feature moves too little across the line, or has no valid
    /// trajectory. The inner `None` means that there is no crossing near the two frames.
    fn crossing(&self, line: &EpipolarLine, track: &Track) -> Option<Option<Candidate>> {
        let samples = self.samples(track)?;
        let trajectory = Trajectory::new(samples.iter().copied())?;
        let start = self.times_i.at(self.index_i, &track.earlier);
        let interval = self.times_i.at(self.index_i + 1, &track.later) - start;
        let [near, far] = [0.0, interval].map(|t| line.distance(&trajectory.at(start + t)));
        if (far - near).abs() < self.min_across_px {
            return None;
        }
        // The first estimate is the crossing of the chord. The check above bounds the chord's slope from below.
        let mut time_s = interval * near / (near - far);
        // The allowed times are those of the four frames. Outside, the trajectory is an extrapolation.
        let span = -interval..=2.0 * interval;
        if !span.contains(&time_s) {
            return Some(None);
        }
        for _ in 0..MAX_NEWTON_STEPS {
            let slope = line.normal.dot(&trajectory.velocity(start + time_s));
            // The trajectory reverses its direction near the line. Newton's method would diverge there.
            if slope.abs() * interval < MIN_SLOPE_FRACTION * self.min_across_px {
                return Some(None);
            }
            let step = line.distance(&trajectory.at(start + time_s)) / slope;
            time_s -= step;
            if step.abs() < NEWTON_TOLERANCE * interval {
                break;
            }
        }
        if !span.contains(&time_s) {
            return Some(None);
        }
        let place = trajectory.at(start + time_s);
        let across_px_s = line.normal.dot(&trajectory.velocity(start + time_s));
        let lower_order = without_farthest(&samples, start + time_s).filter(|_| self.curved);
        let trajectory_error_px = lower_order.map_or(0.0, |lower_order| {
            let change = place - lower_order.at(start + time_s);
            NEXT_ORDER_FRACTION * line.normal.dot(&change).abs()
        });
        // The result counts from the frame's time, not from the time of the feature's row.
        let time_s = time_s + (start - self.times_i.times_s[self.index_i]);
        Some(Some(Candidate { time_s, across_px_s, place, trajectory_error_px }))
    }

    /// Returns the trajectory's samples as (time, position): seconds on camera i's clock, and undistorted pixels.
    ///
    /// `None` if a position can't be undistorted. If trajectories are curved and camera i has more than two frames, the
    /// feature must also be tracked into the frame before or the frame after the two frames, and must not move abruptly
    /// there. Otherwise the result is `None` too.
    fn samples(&self, track: &Track) -> Option<Vec<(f64, Point2<f64>)>> {
        let k = self.index_i;
        let last = self.times_i.times_s.len() - 1;
        let mut at = vec![(k, track.earlier), (k + 1, track.later)];
        if self.curved {
            at.extend(track.before.filter(|_| k > 0).map(|p| (k.wrapping_sub(1), p)));
            at.extend(track.after.filter(|_| k + 1 < last).map(|p| (k + 2, p)));
            at.sort_by_key(|(k, _)| *k);
        }
        let samples = at
            .into_iter()
            .map(|(k, p)| Some((self.times_i.at(k, &p), self.camera_i.model.ideal_from_pixel(&p)?)))
            .collect::<Option<Vec<_>>>()?;
        let is_straight = last == 1 || !self.curved;
        (is_straight || (samples.len() > 2 && is_smooth(&samples))).then_some(samples)
    }
}

/// Fits a trajectory through all samples, as (time, position), except the first or the last one, whichever is farther
/// in time from `time_s`. Its polynomial order is lower by one than that of the trajectory through all samples. `None`
/// if there are only two samples.
fn without_farthest(samples: &[(f64, Point2<f64>)], time_s: f64) -> Option<Trajectory> {
    let distance = |s: &(f64, Point2<f64>)| (s.0 - time_s).abs();
    let (first, last) = (samples.first()?, samples.last()?);
    Trajectory::new(if distance(first) > distance(last) {
        samples[1..].iter().copied()
    } else {
        samples[..samples.len() - 1].iter().copied()
    })
}

/// Returns whether the last of three or four samples, as (time, position), is close to the extrapolation of the other
/// samples ([`MAX_PREDICTION_ERROR_PX`]).
fn is_smooth(samples: &[(f64, Point2<f64>)]) -> bool {
    let Some(((time_s, position), others)) = samples.split_last() else { return false };
    let Some(trajectory) = Trajectory::new(others.iter().copied()) else { return false };
    let step = samples.windows(2).map(|w| (w[1].1 - w[0].1).norm()).fold(0.0, f64::max);
    (position - trajectory.at(*time_s)).norm()
        <= MAX_PREDICTION_ERROR_PX + MAX_PREDICTION_ERROR_FRACTION * step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::capture::RowTimes;
    use crate::registration::FlowDirection;
    use nalgebra::{Isometry3, Matrix2, Point3};

    /// Returns a camera on the x axis, at `x` metres.
    fn camera(x: f64) -> Camera {
        Camera {
            width: 640,
            height: 480,
            model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        }
    }

    fn track(at: impl Fn(f64) -> Point2<f64>) -> Track {
        Track {
            direction: FlowDirection::Forward,
            before: Some(at(-1.0)),
            earlier: at(0.0),
            later: at(1.0),
            after: Some(at(2.0)),
            deformation: Matrix2::identity(),
            residual: 0.0,
            forward_backward_error_px: 0.0,
        }
    }

    #[test]
    fn candidates_are_exact_for_straight_and_curved_motion() {
        let (i, j) = (camera(0.0), camera(0.06));
        for (curve, curved, tolerance) in [(0.0, false, 1e-12), (0.02, true, 1e-9)] {
            for k in 0..20 {
                let k = f64::from(k);
                let at = move |t: f64| {
                    Point3::new(0.1 * (k * 0.7).sin() + 0.01 * t, 0.03 * t + curve * t * t, 1.8)
                };
                let t = 0.05 * k;
                let frames = ThreeFrames {
                    camera_i: &i,
                    camera_j: &j,
                    times_i: FrameTimes::global(&[-1.0, 0.0, 1.0, 2.0]),
                    index_i: 1,
                    curved,
                    min_across_px: 1.0,
                };
                let track = track(|t| i.project(&at(t)).unwrap());
                let candidate = frames.candidates(&[&track], &[j.project(&at(t))])[0];
                assert!((candidate.time_s - t).abs() < tolerance, "{} {t}", candidate.time_s);
            }
        }
    }

    /// Checks that the offset candidate of a camera with a rolling shutter equals the true time, if each position has
    /// the time of its image row.
    #[test]
    fn candidates_of_rolling_shutters_are_exact() {
        let (i, j) = (camera(0.0), camera(0.06));
        let rows = RowTimes::new(0.7, i.height);
        for k in 0..20 {
            let k = f64::from(k);
            let at = move |t: f64| {
                Point3::new(0.1 * (k * 0.7).sin() + 0.01 * t, 0.2 * (k * 0.9).cos() + 0.05 * t, 1.8)
            };
            // The row depends on the time, and the time on the row. The time is found by fixed-point iteration.
            let seen = |frame: f64| {
                let pixel = |t: f64| i.project(&at(t)).unwrap();
                pixel((0..40).fold(frame, |t, _| frame + rows.offset_s(pixel(t).y)))
            };
            let frames = |rows: RowTimes| ThreeFrames {
                camera_i: &i,
                camera_j: &j,
                times_i: FrameTimes { times_s: &[-1.0, 0.0, 1.0, 2.0], rows },
                index_i: 1,
                curved: false,
                min_across_px: 1.0,
            };
            let t = 0.05 * k;
            let (track, in_j) = (track(seen), j.project(&at(t)));
            let found = |rows| frames(rows).candidates(&[&track], &[in_j])[0].time_s;
            let offset_s = rows.offset_s(i.project(&at(t)).unwrap().y);
            assert!((found(rows) - t).abs() < 1e-9, "{} {t}", found(rows));
            assert!((found(RowTimes::default()) - t).abs() > 0.5 * offset_s.abs());
        }
    }

    #[test]
    fn what_cannot_cross_has_no_candidate_from_any_side() {
        for k in [0.0, -0.2, 0.2] {
            let counts =
                crossing_counts(CameraModel::SimpleRadial { f: 686.0, cx: 320.0, cy: 240.0, k });
            assert!(counts[0] > 150 && counts[1] > 100, "{k}: {counts:?}");
        }
    }

    /// Returns the numbers of simulated features that do not cross and that do cross their epipolar lines, in this
    /// order. The features have several speeds, and are far from the image's centre.
    fn crossing_counts(model: CameraModel) -> [usize; 2] {
        let middle = Camera { model, ..camera(0.0) };
        let turned = |angle: f64| Camera {
            cam_from_world: Isometry3::translation(-0.06 * angle.cos(), -0.06 * angle.sin(), 0.0),
            ..middle.clone()
        };
        let mut counts = [0; 2];
        for n in 0..400 {
            let n = f64::from(n);
            let (speed, angle) = (0.005 * n, 0.37 * n);
            let (sin, cos) = angle.sin_cos();
            // Every seventh trajectory is not smooth.
            let jump = if n % 7.0 == 0.0 { 9.0 } else { 0.0 };
            let at = |t: f64| {
                let away = speed * t + if t > 1.5 { jump } else { 0.0 };
                Point2::new(60.0 + away * cos, 420.0 + away * sin)
            };
            let track = track(at);
            let other = turned(angle + std::f64::consts::FRAC_PI_2);
            let frames = ThreeFrames {
                camera_i: &middle,
                camera_j: &other,
                times_i: FrameTimes::global(&[-1.0, 0.0, 1.0, 2.0]),
                index_i: 1,
                curved: true,
                min_across_px: 1.0,
            };
            let crosses = !frames.crossings(&[&track], &[None]).is_empty();
            assert!(frames.can_cross(&track) || !crosses, "{n}");
            counts[usize::from(crosses)] += 1;
        }
        counts
    }

    #[test]
    fn motion_along_the_epipolar_line_has_no_candidate() {
        let (i, j) = (camera(0.0), camera(0.06));
        let frames = ThreeFrames {
            camera_i: &i,
            camera_j: &j,
            times_i: FrameTimes::global(&[-1.0, 0.0, 1.0, 2.0]),
            index_i: 1,
            curved: true,
            min_across_px: 1.0,
        };
        let along = track(|t| Point2::new(100.0 + 20.0 * t, 100.0));
        assert!(frames.candidates(&[&along], &[Some(Point2::new(90.0, 100.0))]).is_empty());
        assert!(frames.candidates(&[&along], &[None]).is_empty());
    }
}
