//! §4.1: the bidirectional temporal flow of a camera. Each correspondence is labelled with the direction in which
//! it was found: forward, backward or both.

use super::consensus::{Moved, Support, consensus};
use super::guided_flow::{extensions, guided_flow};
use super::rotating_patches::match_rotating_patches;
use super::{
    AffineStart, Frame, FrameStore, Match, Neighbors, RegistrationOptions, Trajectory, flow,
};
use crate::capture::{CaptureError, FrameTimes};
use nalgebra::{Matrix2, Point2, Vector2};
use serde::{Deserialize, Serialize};

/// The direction of the bidirectional flow (§4.1) in which a correspondence was found. Eq. (9) warps the earlier
/// frame by the forward flow and the later frame by the backward flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FlowDirection {
    /// A corner of the earlier frame was tracked to the later frame.
    Forward,
    /// A corner of the later frame was tracked to the earlier frame.
    Backward,
    /// A forward and a backward correspondence were found that are close to each other in both frames. The forward
    /// correspondence is used.
    Both,
}

/// A temporal correspondence of one camera between its frames k and k + 1 (§4.1). Where the feature could be
/// tracked further, the track also has its positions in the frames k − 1 and k + 2. Positions are in pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Direction in which the correspondence between frames k and k + 1 was found.
    pub direction: FlowDirection,
    /// Position in frame k − 1; `None` if the feature was lost or there is no such frame.
    pub before: Option<Point2<f64>>,
    /// Position in frame k.
    pub earlier: Point2<f64>,
    /// Position in frame k + 1.
    pub later: Point2<f64>,
    /// Position in frame k + 2; `None` if the feature was lost or there is no such frame.
    pub after: Option<Point2<f64>>,
    /// Linear part (2×2 matrix) of the affine motion around the feature, from frame k to frame k + 1. It is the
    /// identity if the window was tracked by translation only.
    pub deformation: Matrix2<f64>,
    /// Mean absolute difference of the grey values (0 to 1) of the windows in frames k and k + 1.
    pub residual: f64,
    /// Forward–backward error between frames k and k + 1, pixels.
    pub forward_backward_error_px: f64,
}

impl Track {
    /// Returns whether the track was found in the forward direction; also true for [`FlowDirection::Both`]. Eq. (9) of
    /// the paper warps the earlier frame by these tracks.
    pub fn in_forward_set(&self) -> bool {
        self.direction != FlowDirection::Backward
    }

    /// Returns whether the track was found in the backward direction; also true for [`FlowDirection::Both`]. Eq. (9) of
    /// the paper warps the later frame by these tracks.
    pub fn in_backward_set(&self) -> bool {
        self.direction != FlowDirection::Forward
    }

    /// Returns the displacement from frame k to frame k + 1, in pixels.
    pub fn motion(&self) -> Vector2<f64> {
        self.later - self.earlier
    }

    /// Returns the start for tracking the feature from frame k to frame k − 1. The initial guess assumes constant
    /// affine motion.
    fn backward(&self) -> AffineStart {
        let inverse = self.deformation.try_inverse().unwrap_or_else(Matrix2::identity);
        let guess = self.earlier - inverse * self.motion();
        AffineStart { from: self.earlier, guess, deformation: inverse }
    }

    /// Returns the start for tracking the feature from frame k + 1 to frame k + 2. The initial guess assumes
    /// constant affine motion.
    fn forward(&self) -> AffineStart {
        let guess = self.later + self.deformation * self.motion();
        AffineStart { from: self.later, guess, deformation: self.deformation }
    }

    /// Removes the position in frame k − 1 if the trajectory has a kink in frame k, or the position in frame k + 2 if
    /// it has a kink in frame k + 1, for example because a body bounces. A polynomial through a kink would deviate from
    /// the trajectory between frames k and k + 1. Nothing is removed unless all four positions are known.
    ///
    /// A trajectory has a kink if its acceleration in frame k + 1 differs from that in frame k by more than
    /// [`MAX_JERK_PX`] allows. The kink is in the frame with the larger acceleration. `times_s` are the times of frames
    /// k − 1 to k + 2, in seconds.
    fn drop_kink(&mut self, times_s: &[f64]) {
        let (Some(before), Some(after)) = (self.before, self.after) else { return };
        let positions = [before, self.earlier, self.later, after];
        // Times ascend strictly, so that no interval is 0.
        let [first, middle, last] = [0, 1, 2].map(|n| {
            let scale = (times_s[2] - times_s[1]) / (times_s[n + 1] - times_s[n]);
            (positions[n + 1] - positions[n]) * scale
        });
        let [at_earlier, at_later] = [middle - first, last - middle];
        let limit = MAX_JERK_PX + JERK_FRACTION * at_earlier.norm().min(at_later.norm());
        if (at_later - at_earlier).norm() > limit {
            let is_earlier = at_earlier.norm() > at_later.norm();
            *(if is_earlier { &mut self.before } else { &mut self.after }) = None;
        }
    }

    /// Returns the trajectory through the two to four known positions: the straight line of eq. (2), or a curve
    /// beyond the paper.
    ///
    /// `times` are the times of the camera's frames, and `k` is the index of the earlier frame. Every position has
    /// the time at which its image row was exposed. Returns `None` if the times do not strictly ascend.
    ///
    /// # Panics
    /// If `times` has no entry for frame k + 1.
    pub fn trajectory(&self, times: FrameTimes, k: usize) -> Option<Trajectory> {
        let sample = |k: usize, p: Point2<f64>| (times.at(k, &p), p);
        let before = self.before.zip(k.checked_sub(1)).map(|(p, k)| sample(k, p));
        let after = self.after.filter(|_| k + 2 < times.times_s.len()).map(|p| sample(k + 2, p));
        Trajectory::new(
            before
                .into_iter()
                .chain([sample(k, self.earlier), sample(k + 1, self.later)])
                .chain(after),
        )
    }
}

/// Constant term, in pixels per squared frame interval, of the maximum change of a smooth motion's acceleration from
/// one frame to the next. The maximum is this value plus [`JERK_FRACTION`] times the smaller of the two accelerations.
/// A larger change is a kink ([`Track::drop_kink`]).
const MAX_JERK_PX: f64 = 12.0;
const JERK_FRACTION: f64 = 0.5;
/// Maximum distance, in both frames, between a forward and a backward correspondence that are merged, in pixels.
const MERGE_DISTANCE_PX: f64 = 1.0;

/// Computes the bidirectional temporal flow (§4.1) between frames `k` and `k + 1` of a camera, from the corners of
/// both frames.
///
/// Correspondences that are found in both directions are merged. A correspondence whose motion differs from the
/// motion of its neighbours is removed ([`neighbor_consensus`]). The remaining correspondences are extended to the
/// frames `k − 1` and `k + 2`, if these exist. The order of the result does not depend on the number of threads.
///
/// # Errors
/// If one of the frames cannot be read.
///
/// # Panics
/// If the camera has no frame `k + 1`.
pub fn temporal_flow(
    frames: &FrameStore,
    camera: usize,
    k: usize,
) -> Result<Vec<Track>, CaptureError> {
    let options = frames.options();
    let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
    let (of_earlier, of_later) =
        rayon::join(|| earlier.corners(options), || later.corners(options));
    temporal_flow_of(frames, camera, k, [of_earlier, of_later])
}

/// Computes [`temporal_flow`] from given points of frame `k` and of frame `k + 1`, in pixels, instead of the
/// frames' corners.
///
/// # Errors
/// If one of the frames cannot be read.
///
/// # Panics
/// If the camera has no frame `k + 1`.
pub fn temporal_flow_of(
    frames: &FrameStore,
    camera: usize,
    k: usize,
    [of_earlier, of_later]: [&[Point2<f64>]; 2],
) -> Result<Vec<Track>, CaptureError> {
    let options = frames.options();
    let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
    let (forward, backward) = rayon::join(
        || directed_flow(&earlier, &later, of_earlier, options),
        || directed_flow(&later, &earlier, of_later, options),
    );
    let mut tracks = merged(&forward, &backward);
    let mut consensus = neighbor_consensus(&tracks, options).into_iter();
    tracks.retain(|_| consensus.next().unwrap_or(true));

    let count = frames.capture().cameras[camera].frames.len();
    let extended = |from: &Frame, frame: Option<usize>, onward: fn(&Track) -> AffineStart| {
        let Some(frame) = frame else { return Ok::<_, CaptureError>(vec![None; tracks.len()]) };
        let starts: Vec<_> = tracks.iter().map(onward).collect();
        Ok(extensions([from, &*frames.get(camera, frame)?], &starts, options))
    };
    let (before, after) = rayon::join(
        || extended(&earlier, k.checked_sub(1), Track::backward),
        || extended(&later, Some(k + 2).filter(|k| *k < count), Track::forward),
    );
    for ((track, before), after) in tracks.iter_mut().zip(before?).zip(after?) {
        (track.before, track.after) = (before, after);
    }
    if k > 0 && k + 2 < count {
        let times_s = &frames.capture().cameras[camera].clock.times_s[k - 1..k + 3];
        tracks.iter_mut().for_each(|track| track.drop_kink(times_s));
    }
    Ok(tracks)
}

/// Computes one direction of the bidirectional flow: tracks `corners`, in pixels of `source`, to `target`. Returns
/// the matches of the corners that are not lost.
fn directed_flow(
    source: &Frame,
    target: &Frame,
    corners: &[Point2<f64>],
    options: &RegistrationOptions,
) -> Vec<Match> {
    let starts: Vec<_> = corners.iter().map(|&p| (p, p)).collect();
    let mut matches = flow(source, target, &starts, options);
    guided_flow([source, target], &starts, &mut matches, options);
    match_rotating_patches([source, target], corners, &mut matches, options);
    matches.into_iter().flatten().collect()
}

/// Merges the correspondences of both directions into tracks. A forward and a backward correspondence become one
/// track if they are within [`MERGE_DISTANCE_PX`] of each other in both frames.
fn merged(forward: &[Match], backward: &[Match]) -> Vec<Track> {
    let track = |direction, m: &Match| {
        let (earlier, later, deformation) = if direction == FlowDirection::Backward {
            // The change of area of a match is bounded, so that the inverse exists.
            let inverse = m.deformation.try_inverse().unwrap_or_else(Matrix2::identity);
            (m.target, m.source, inverse)
        } else {
            (m.source, m.target, m.deformation)
        };
        Track {
            direction,
            before: None,
            earlier,
            later,
            after: None,
            deformation,
            residual: m.residual,
            forward_backward_error_px: m.forward_backward_error_px,
        }
    };
    let mut tracks: Vec<Track> = forward.iter().map(|m| track(FlowDirection::Forward, m)).collect();
    let at_earlier = Neighbors::new(forward.iter().map(|m| m.source));
    for m in backward {
        // Sorted by distance; equally near correspondences are sorted by index.
        let near = at_earlier.nearest(&m.target, usize::MAX, MERGE_DISTANCE_PX);
        let is_twin = |k: &usize| (forward[*k].target - m.source).norm() <= MERGE_DISTANCE_PX;
        match near.into_iter().find(is_twin) {
            Some(k) => tracks[k].direction = FlowDirection::Both,
            None => tracks.push(track(FlowDirection::Backward, m)),
        }
    }
    tracks
}

/// Returns, for each track, whether its motion agrees with the motion of its neighbours. Also `true` if the track
/// has too few neighbours for a comparison. A track that disagrees is a mismatch, assuming that every surface has
/// several features.
pub fn neighbor_consensus(tracks: &[Track], options: &RegistrationOptions) -> Vec<bool> {
    let moved =
        |t: &Track| Some(Moved { at: t.earlier, motion: t.motion(), deformation: t.deformation });
    let support = consensus(&tracks.iter().map(moved).collect::<Vec<_>>(), options);
    support.into_iter().map(|support| support != Some(Support::Differs)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::RowTimes;

    fn a_match(x: f64, dx: f64) -> Match {
        Match {
            source: Point2::new(x, 10.0),
            target: Point2::new(x + dx, 10.0),
            deformation: Matrix2::identity(),
            residual: 0.01,
            forward_backward_error_px: 0.1,
        }
    }

    #[test]
    fn a_correspondence_of_both_directions_is_merged_and_labelled() {
        let forward = [a_match(10.0, 3.0), a_match(20.0, 3.0)];
        // The first backward match is the reverse of a forward match. The second starts at the end of a forward
        // match, but ends elsewhere.
        let backward = [a_match(13.2, -3.1), a_match(23.1, -9.0)];
        let tracks = merged(&forward, &backward);
        let directions: Vec<_> = tracks.iter().map(|t| t.direction).collect();
        let expected = [FlowDirection::Both, FlowDirection::Forward, FlowDirection::Backward];
        assert_eq!(directions, expected);
        assert!((tracks[2].earlier - Point2::new(14.1, 10.0)).norm() < 1e-9);
        assert!(tracks[0].in_backward_set() && !tracks[1].in_backward_set());
    }

    #[test]
    fn a_track_unlike_its_neighbours_is_dropped() {
        let matches: Vec<Match> =
            (0..9).map(|k| a_match(f64::from(k) * 4.0, if k == 4 { 30.0 } else { 5.0 })).collect();
        let mut tracks = merged(&matches, &[]);
        let mut consensus =
            neighbor_consensus(&tracks, &RegistrationOptions::default()).into_iter();
        tracks.retain(|_| consensus.next().unwrap());
        assert_eq!(tracks.len(), 8);
        assert!(tracks.iter().all(|t| (t.motion().x - 5.0).abs() < 1e-9));
    }

    /// At the turning point of a swing, all four positions remain. At a bounce, the position beyond the kink is
    /// removed.
    #[test]
    fn a_kink_drops_the_position_beyond_it() {
        let track = |xs: [f64; 4]| {
            let [before, earlier, later, after] = xs.map(|x| Point2::new(x, 10.0));
            let mut track = merged(&[a_match(earlier.x, later.x - earlier.x)], &[]).remove(0);
            (track.before, track.after) = (Some(before), Some(after));
            track
        };
        let kept = |xs: [f64; 4], times_s: [f64; 4]| {
            let mut track = track(xs);
            track.drop_kink(&times_s);
            (track.before.is_some(), track.after.is_some())
        };
        let even = [0.0, 1.0, 2.0, 3.0];
        // The motion decreases by 20 px with every frame.
        assert_eq!(kept([0.0, 30.0, 40.0, 30.0], even), (true, true));
        // A bounce in frame k, and one in frame k + 1.
        assert_eq!(kept([0.0, 10.0, -20.0, -50.0], even), (false, true));
        assert_eq!(kept([-50.0, -20.0, 10.0, 0.0], even), (true, false));
        // A frame is missing, and the velocity is constant.
        assert_eq!(kept([0.0, 30.0, 60.0, 120.0], [0.0, 1.0, 2.0, 4.0]), (true, true));
    }

    #[test]
    fn trajectories_use_the_positions_that_exist() {
        let mut track = merged(&[a_match(10.0, 3.0)], &[]).remove(0);
        track.before = Some(Point2::new(8.0, 10.0));
        let times = FrameTimes::global(&[0.0, 1.0, 2.0]);
        let curved = track.trajectory(times, 1).unwrap();
        assert!((curved.at(1.5).x - 11.375).abs() < 1e-12);
        // No frame precedes frame 0, so that the track's position `before` is ignored.
        assert!((track.trajectory(times, 0).unwrap().at(0.5).x - 11.5).abs() < 1e-12);
    }

    /// A point moves at constant velocity in the image of a camera with a rolling shutter.
    #[test]
    fn positions_have_the_times_of_their_rows() {
        let rows = RowTimes::new(0.8, 101);
        let at = |t: f64| Point2::new(20.0 + 7.0 * t, 30.0 + 20.0 * t);
        // The time at which the point's row is exposed in frame k: t = k + offset(y(t)), which is linear in t.
        let seen = |k: f64| {
            let t = (k + rows.offset_s(30.0)) / (1.0 - 20.0 * rows.s_per_px());
            assert!((t - k - rows.offset_s(at(t).y)).abs() < 1e-12);
            at(t)
        };
        let mut track = merged(&[a_match(10.0, 3.0)], &[]).remove(0);
        (track.earlier, track.later) = (seen(1.0), seen(2.0));
        (track.before, track.after) = (Some(seen(0.0)), Some(seen(3.0)));
        let times = FrameTimes { times_s: &[0.0, 1.0, 2.0, 3.0], rows };
        let trajectory = track.trajectory(times, 1).unwrap();
        let global = track.trajectory(FrameTimes::global(times.times_s), 1).unwrap();
        for t in [0.9, 1.0, 1.5, 2.0] {
            assert!((trajectory.at(t) - at(t)).norm() < 1e-9);
        }
        // Around frame 1 the point is in the middle row.
        assert!((global.at(2.0) - at(2.0)).norm() > 1.0);
    }
}
