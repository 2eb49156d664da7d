//! §4.2: the epipolar test, which detects wrong temporal tracks by eqs. (1) to (3).
//!
//! A track of camera i is interpolated at the time of a frame of another camera j, the reference. The track's
//! feature is matched in this frame. If the match is off the epipolar line of the interpolated position, either the
//! track or the match is wrong.

use super::guided_flow::{MotionPrior, Retries};
use super::{
    FlowDirection, Frame, FrameStore, Match, Reference, ReferenceQuery, RegistrationOptions, Start,
    Track, Trajectory, flow, select_references,
};
use crate::camera::{Camera, EpipolarGeometry};
use crate::capture::{CaptureError, RowTimes};
use nalgebra::Point2;

/// The result of the epipolar test of a track. If several references test a track, the final result is the last of
/// their results in the order of this enum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No reference can test the track, because its feature has no match in a reference frame or moves along its
    /// epipolar line.
    Untestable,
    /// The feature's match in a reference frame (its spatial correspondence) is within the tolerance ε of its epipolar
    /// line, eq. (3).
    Passed,
    /// The feature's match in a reference frame is farther than the tolerance ε from its epipolar line. Either the
    /// track or the match is wrong, and neither is used.
    Rejected,
}

/// A feature's position in a frame of a reference camera, and the time of the position.
#[derive(Clone, Copy)]
struct InReference {
    /// Position in the image of the reference camera, pixels.
    position: Point2<f64>,
    /// Time at which the image row of the position was exposed, in seconds on the common clock.
    time_s: f64,
}

/// A track to be tested, with its trajectory.
struct TestedTrack<'a> {
    /// Index of the track in the list of all tracks of the camera.
    index: usize,
    track: &'a Track,
    trajectory: Trajectory,
    /// Position of the track in the frame from which its feature was tracked, in pixels.
    start: Point2<f64>,
}

/// Applies the epipolar test (§4.2) to the tracks of camera `i` between its frames `k` and `k + 1`. Returns one
/// verdict per track, in order.
///
/// References are frames of other cameras. [`select_references`] chooses them separately for the forward and the
/// backward flow. The first references ([`References::first`](super::References::first)) test all tracks. The
/// further references test the tracks that no first reference could test. A track is rejected if at least one
/// reference rejects it. It is passed if at least one reference passes it and none rejects it.
///
/// `times_s[j]` holds the frame times of camera j, in seconds on the common clock. It is `None` if the camera's
/// clock is unknown. If the clock of camera `i` is unknown, all tracks are untestable.
///
/// # Errors
/// If a frame of camera `i` or of a reference cannot be read.
///
/// # Panics
/// If camera `i` has no frame `k + 1`, or if `times_s` has no entry for camera `i`.
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
    // The error of a wrong track is largest at the end to which it was tracked: t + Δt in the forward flow, t in
    // the backward flow.
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

/// Motion of a feature between its track's two frames, in pixels, up to which the feature is always testable. If the
/// feature moves farther, it is testable only if its epipolar line shifts by at least [`MIN_ACROSS_FRACTION`] of its
/// motion.
const MIN_TEST_MOTION_PX: f64 = 1.0;
/// Minimum shift of a testable feature's epipolar line in the reference camera, as a fraction of the feature's motion.
/// Shift and motion are displacements, in pixels, between the track's two frames. If the shift is smaller, the feature
/// moves along its epipolar line, and the test can't detect an error of its motion.
const MIN_ACROSS_FRACTION: f64 = 0.1;
/// Number of pyramid levels in the second attempt to track a feature into the reference camera. The second attempt
/// starts from the displacement that the motion prior predicts.
const RETRY_LEVELS: usize = 1;

/// Camera i, whose tracks are tested, and camera j, the reference camera.
struct Pair<'a> {
    camera_i: &'a Camera,
    camera_j: &'a Camera,
    /// Times of camera j's image rows relative to the frame's time. A position in a frame of camera j is tested at
    /// the time of its own row.
    rows_j: RowTimes,
    /// Instant t' of eq. (2) at which the epipolar constraint is tested, in seconds on the common clock. It is the
    /// time of the middle image row.
    time_s: f64,
    options: &'a RegistrationOptions,
}

impl Pair<'_> {
    /// Tests features against one reference. The features are tracked from the frame `source` of camera i. Returns
    /// one verdict per feature, in order.
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
        // The position of a feature's trajectory at the time at which the row of its match was exposed.
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

    /// Tracks matched features from a frame of the reference camera to the camera's next frame. Replaces their
    /// positions in `matched` by positions that are linearly interpolated at `self.time_s`. Lost features become
    /// `None`. The times of the two frames are `first_s` and `next_s`, in seconds on the common clock.
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

    /// Tracks features again if they have no match, or if their match is off their epipolar line. Two initial
    /// guesses are tried. The first is the position predicted by the trajectory, plus the disparity of neighbouring
    /// features. The second is the position in the source frame, plus the displacement of neighbouring features.
    /// The match with the smallest residual is used. `at_match` returns a feature's position in camera i at the
    /// time of its match.
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

    /// Applies eq. (3) to a feature and its position in the reference camera. Returns `None` if the reference cannot
    /// test the feature: if there is no position or no epipolar line, or if the position is on the epipolar line and
    /// the feature moves along this line.
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
        // An error along the epipolar line can't be detected. A feature is therefore testable only if its motion
        // shifts its epipolar line by a minimum fraction of the motion.
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
