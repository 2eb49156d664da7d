//! §4.2: the epipolar test, which finds wrong temporal tracks by eqs. (1) to (3).
//!
//! A track of camera i is interpolated at the time of a frame of another camera j, the reference. Its feature
//! is matched in that frame. If the match is off the epipolar line of the interpolated position, the track or
//! the match is wrong.

use super::guided_flow::{MotionPrior, Retries};
use super::{
    FlowDirection, Frame, FrameStore, Match, Reference, ReferenceQuery, RegistrationOptions, Start,
    Track, Trajectory, flow, select_references,
};
use crate::camera::{Camera, EpipolarGeometry};
use crate::capture::{CaptureError, RowTimes};
use nalgebra::Point2;

/// The result of the epipolar test of a track. If several references test it, the last of their results in
/// this order counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No reference can test the track: its feature has no match there, or moves along the epipolar line.
    Untestable,
    /// The feature's match in the reference (spatial correspondence) is on the epipolar line, eq. (3).
    Passed,
    /// The feature's match in the reference is off the epipolar line: the track or the match is wrong, and
    /// neither is used.
    Rejected,
}

/// A feature's position in a reference camera.
#[derive(Clone, Copy)]
struct InReference {
    /// Pixels.
    position: Point2<f64>,
    /// The time of the position, seconds on the common clock.
    time_s: f64,
}

/// A track to be tested.
struct TestedTrack<'a> {
    /// Index of the track.
    index: usize,
    track: &'a Track,
    trajectory: Trajectory,
    /// The track's position in the frame from which it was tracked, pixels.
    start: Point2<f64>,
}

/// The epipolar test (§4.2) of the tracks of camera `i` between its frames `k` and `k + 1`. Returns a verdict
/// for each track, in order.
///
/// References are frames of other cameras, which [`select_references`] chooses for each direction of the
/// flow. The first references ([`References::first`](super::References::first)) test all tracks. The further
/// references test the tracks that no first reference could test. A track is rejected if one reference
/// rejects it, and passed if one passes it and none rejects it.
///
/// `times_s[j]` are camera j's frame times in seconds on the common clock, `None` if its clock is unknown. If
/// camera `i`'s clock is unknown, all tracks are untestable.
///
/// # Errors
/// If a frame of the camera or of a reference cannot be read.
///
/// # Panics
/// If the camera has no frame `k + 1`, or no entry for it in `times_s`.
pub fn epipolar_check(
    frames: &FrameStore,
    times_s: &[Option<Vec<f64>>],
    i: usize,
    k: usize,
    tracks: &[Track],
) -> Result<Vec<Verdict>, CaptureError> {
    let mut verdicts = vec![Verdict::Untestable; tracks.len()];
    let Some(own_times) = &times_s[i] else { return Ok(verdicts) };
    let interval_s = [own_times[k], own_times[k + 1]];
    let filmed = &frames.capture().cameras[i];
    // Errors of the forward flow show at its end, t + Δt; those of the backward flow at its end, t.
    let directed = |is_backward: bool| {
        let (frame, time_s) = if is_backward { (k + 1, interval_s[0]) } else { (k, interval_s[1]) };
        let is_own = |track: &Track| is_backward == (track.direction == FlowDirection::Backward);
        let own = tracks.iter().enumerate().filter(|(_, track)| is_own(track));
        let tested = own.filter_map(|(index, track)| {
            let start = if is_backward { track.later } else { track.earlier };
            let trajectory = track.trajectory(filmed.frame_times(own_times), k)?;
            Some((TestedTrack { index, track, trajectory, start }, Verdict::Untestable))
        });
        let mut features: Vec<_> = tested.collect();
        let query = ReferenceQuery { camera: i, interval_s, time_s };
        let references = select_references(frames.capture(), times_s, &query);
        let source = frames.get(i, frame)?;
        let cameras = &frames.capture().cameras;
        let first = references.first.iter().map(|reference| (reference, true));
        let further = references.further.iter().map(|reference| (reference, false));
        for (reference, is_first) in first.chain(further) {
            let pair = Pair {
                camera_i: &cameras[i].camera,
                camera_j: &cameras[reference.camera].camera,
                rows_j: cameras[reference.camera].row_times(),
                time_s: reference.time_s,
                options: frames.options(),
            };
            let is_tested = |(_, verdict): &&mut _| is_first || *verdict == Verdict::Untestable;
            let (tested, verdicts): (Vec<_>, Vec<_>) = features
                .iter_mut()
                .filter(is_tested)
                .map(|(feature, verdict)| (&*feature, verdict))
                .unzip();
            let found = pair.verdicts(frames, &source, reference, &tested)?;
            for (verdict, found) in verdicts.into_iter().zip(found) {
                *verdict = found.max(*verdict);
            }
        }
        Ok::<_, CaptureError>(features)
    };
    let (forward, backward) = rayon::join(|| directed(false), || directed(true));
    for (feature, verdict) in forward?.into_iter().chain(backward?) {
        verdicts[feature.index] = verdict;
    }
    Ok(verdicts)
}

/// Motion between the two frames, pixels, up to which a feature is always testable. A feature that moves more is
/// testable only if [`MIN_ACROSS_FRACTION`] of its motion is perpendicular to its epipolar line.
const MIN_TEST_MOTION_PX: f64 = 1.0;
/// Minimum component of a testable feature's motion that is perpendicular to its epipolar line, as a fraction
/// of the motion.
const MIN_ACROSS_FRACTION: f64 = 0.1;
/// Number of pyramid levels in the second attempt to track a feature into the reference camera. It starts
/// from the displacement that the motion prior predicts.
const RETRY_LEVELS: usize = 1;

/// Camera i, whose tracks are tested, and camera j, a reference camera against which they are tested.
struct Pair<'a> {
    camera_i: &'a Camera,
    camera_j: &'a Camera,
    /// The times of camera j's rows: a position in its frame is tested at the time of its own row.
    rows_j: RowTimes,
    /// Instant at which the epipolar constraint is tested: t' of eq. (2), seconds on the common clock. It is the time
    /// of the middle row.
    time_s: f64,
    options: &'a RegistrationOptions,
}

impl Pair<'_> {
    /// Tests features, tracked from frame `source`, with one reference. Returns their verdicts in order.
    fn verdicts(
        &self,
        frames: &FrameStore,
        source: &Frame,
        reference: &Reference,
        features: &[&TestedTrack],
    ) -> Result<Vec<Verdict>, CaptureError> {
        if features.is_empty() {
            return Ok(Vec::new());
        }
        let target = frames.get(reference.camera, reference.frame)?;
        let target_s = reference.between.map_or(reference.time_s, |[first, _]| first);
        let starts: Vec<Start> =
            features.iter().map(|f| (f.start, f.trajectory.at(target_s))).collect();
        let mut matches = flow(source, &target, &starts, self.options);
        // The position at which a feature's trajectory is when the match was exposed.
        let at_match = |k: usize, m: &Match| {
            features[k].trajectory.at(target_s + self.rows_j.offset_s(m.target.y))
        };
        self.retry([source, &target], &starts, at_match, &mut matches);
        let in_reference = |position: Point2<f64>| InReference {
            position,
            time_s: target_s + self.rows_j.offset_s(position.y),
        };
        let mut matched: Vec<_> =
            matches.into_iter().map(|m| m.map(|m| in_reference(m.target))).collect();
        if let Some(between) = reference.between {
            let next = frames.get(reference.camera, reference.frame + 1)?;
            self.interpolate([&target, &next], between, features, &mut matched);
        }
        let verdict = |(feature, p_j): (&&TestedTrack, Option<InReference>)| {
            self.verdict(feature, p_j.as_ref()).unwrap_or(Verdict::Untestable)
        };
        Ok(features.iter().zip(matched).map(verdict).collect())
    }

    /// Tracks matched features from a frame of the reference camera to its next frame, and replaces their
    /// positions in `matched` by those at `self.time_s`, linearly interpolated; `None` if lost. The two
    /// frames are at `first_s` and `next_s`, seconds on the common clock.
    fn interpolate(
        &self,
        [frame, next]: [&Frame; 2],
        [first_s, next_s]: [f64; 2],
        features: &[&TestedTrack],
        matched: &mut [Option<InReference>],
    ) {
        let (indices, starts): (Vec<usize>, Vec<Start>) = matched
            .iter()
            .zip(features)
            .enumerate()
            .filter_map(|(k, (p, feature))| {
                let (p, own) = (p.as_ref()?.position, &feature.trajectory);
                Some((k, (p, p + (own.at(next_s) - own.at(first_s)))))
            })
            .unzip();
        let at_instant = |m: Match| {
            let first_s = first_s + self.rows_j.offset_s(m.source.y);
            let next_s = next_s + self.rows_j.offset_s(m.target.y);
            let fraction = (self.time_s - first_s) / (next_s - first_s);
            let position = m.source + (m.target - m.source) * fraction;
            InReference { position, time_s: self.time_s }
        };
        for (k, tracked) in indices.into_iter().zip(flow(frame, next, &starts, self.options)) {
            matched[k] = tracked.map(at_instant);
        }
    }

    /// Tracks features again that have no match, or whose match is off their epipolar line. There are two
    /// initial guesses: the position predicted by the trajectory plus the neighbours' disparity, and the
    /// position in the source frame plus the neighbours' displacement. The match with the smallest residual
    /// is used. `at_match` gives a feature's position in camera i at the time of its match.
    fn retry(
        &self,
        frames: [&Frame; 2],
        starts: &[Start],
        at_match: impl Fn(usize, &Match) -> Point2<f64>,
        matches: &mut [Option<Match>],
    ) {
        let Some(geometry) = EpipolarGeometry::new(self.camera_i, self.camera_j) else { return };
        let is_on_line = |p_i: &Point2<f64>, p_j: &Point2<f64>| {
            let line = geometry.line_in_j(&self.camera_i.model.ideal_from_pixel(p_i)?)?;
            let distance_px = line.distance(&self.camera_j.model.ideal_from_pixel(p_j)?).abs();
            Some(!(distance_px > self.options.epipolar_tolerance_px))
        };
        let mut retries = Retries::new(frames, starts, [RETRY_LEVELS, 1], self.options);
        for from_prediction in [true, false] {
            let base = |k: usize| if from_prediction { starts[k].1 } else { starts[k].0 };
            let is_trusted = |k: &usize| {
                matches[*k].is_some_and(|m| is_on_line(&at_match(*k, &m), &m.target) == Some(true))
            };
            let (trusted, others): (Vec<_>, Vec<_>) = (0..starts.len()).partition(is_trusted);
            let displacement = |k: usize| Some((base(k), matches[k]?.target - base(k)));
            let prior = MotionPrior::new(trusted.into_iter().filter_map(displacement));
            let guess = |k: usize| Some((k, base(k) + prior.predict(&base(k))?));
            retries.track(others.into_iter().filter_map(guess), matches);
        }
    }

    /// Applies eq. (3) to a feature and its position in the reference, pixels. `None` if the reference cannot
    /// test it.
    fn verdict(
        &self,
        feature: &TestedTrack,
        in_reference: Option<&InReference>,
    ) -> Option<Verdict> {
        let in_reference = in_reference?;
        let geometry = EpipolarGeometry::new(self.camera_i, self.camera_j)?;
        let ideal_i = |p: &Point2<f64>| self.camera_i.model.ideal_from_pixel(p);
        let p_j = self.camera_j.model.ideal_from_pixel(&in_reference.position)?;
        let at = feature.trajectory.at(in_reference.time_s);
        let line = geometry.line_in_j(&ideal_i(&at)?)?;
        if line.distance(&p_j).abs() > self.options.epipolar_tolerance_px {
            return Some(Verdict::Rejected);
        }
        // An error along the epipolar line can't be detected. A motion can be tested only if it moves the
        // feature's epipolar line enough.
        let motion = feature.track.motion();
        let start = geometry.line_in_j(&ideal_i(&feature.track.earlier)?)?;
        let end = geometry.line_in_j(&ideal_i(&feature.track.later)?)?;
        let foot = line.nearest(&p_j);
        let across = (start.distance(&foot) - end.distance(&foot)).abs();
        let is_testable =
            motion.norm() <= MIN_TEST_MOTION_PX || across >= MIN_ACROSS_FRACTION * motion.norm();
        is_testable.then_some(Verdict::Passed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::capture::FrameTimes;
    use nalgebra::{Isometry3, Matrix2};

    fn camera(x: f64) -> Camera {
        Camera {
            width: 320,
            height: 240,
            model: CameraModel::Pinhole { fx: 343.0, fy: 343.0, cx: 160.0, cy: 120.0 },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        }
    }

    fn track(earlier: [f64; 2], later: [f64; 2]) -> Track {
        Track {
            direction: FlowDirection::Forward,
            before: None,
            earlier: earlier.into(),
            later: later.into(),
            after: None,
            deformation: Matrix2::identity(),
            residual: 0.0,
            forward_backward_error_px: 0.0,
        }
    }

    fn verdict(t: &Track, in_reference: Option<[f64; 2]>) -> Verdict {
        let options = RegistrationOptions::default();
        let (a, b) = (camera(0.0), camera(0.06));
        let rows_j = RowTimes::default();
        let pair = Pair { camera_i: &a, camera_j: &b, rows_j, time_s: 0.5, options: &options };
        let trajectory = t.trajectory(FrameTimes::global(&[0.0, 1.0]), 0).unwrap();
        let feature = TestedTrack { index: 0, track: t, trajectory, start: t.earlier };
        let in_reference =
            in_reference.map(|p| InReference { position: p.into(), time_s: pair.time_s });
        let verdict = pair.verdict(&feature, in_reference.as_ref());
        verdict.unwrap_or(Verdict::Untestable)
    }

    #[test]
    fn on_the_line_passes_and_off_it_is_rejected() {
        let t = track([100.0, 100.0], [104.0, 110.0]);
        assert_eq!(verdict(&t, Some([70.0, 105.2])), Verdict::Passed);
        assert_eq!(verdict(&t, Some([70.0, 111.0])), Verdict::Rejected);
        assert_eq!(verdict(&t, None), Verdict::Untestable);
    }

    #[test]
    fn motion_along_the_line_is_untestable_and_rest_is_not() {
        let along = track([100.0, 100.0], [120.0, 100.2]);
        assert_eq!(verdict(&along, Some([70.0, 100.0])), Verdict::Untestable);
        // A match off the line is rejected, whatever the motion.
        assert_eq!(verdict(&along, Some([70.0, 107.0])), Verdict::Rejected);
        let at_rest = track([100.0, 100.0], [100.0, 100.0]);
        assert_eq!(verdict(&at_rest, Some([70.0, 100.0])), Verdict::Passed);
        assert_eq!(verdict(&at_rest, Some([70.0, 107.0])), Verdict::Rejected);
    }
}
