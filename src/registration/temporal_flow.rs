//! §4.1: the bidirectional temporal flow of a camera, with its two labelled sets of correspondences.

use super::flow::{Start, flow_over, is_new};
use super::{
    Frame, FrameStore, Match, MotionPrior, Neighbors, RegistrationOptions, Trajectory, flow,
};
use crate::capture::CaptureError;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// The direction of the bidirectional flow (§4.1) that a correspondence is of. Eq. (9) warps the earlier
/// frame with the forward flow, and the later frame with the backward flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowDirection {
    /// A corner of the earlier frame, tracked to the later one.
    Forward,
    /// A corner of the later frame, tracked to the earlier one.
    Backward,
    /// Both: two correspondences within [`RegistrationOptions::merge_distance_px`] of each other at
    /// both ends, of which the forward one is used.
    Both,
}

/// A temporal correspondence of one camera between its frames k and k + 1 (§4.1), extended by a frame
/// at both ends where the feature could be tracked. Positions in pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The flow that it is of.
    pub direction: FlowDirection,
    /// Position in frame k − 1; `None` if the feature was lost or there is no such frame.
    pub before: Option<Point2<f64>>,
    /// Position in frame k.
    pub earlier: Point2<f64>,
    /// Position in frame k + 1.
    pub later: Point2<f64>,
    /// Position in frame k + 2; `None` if the feature was lost or there is no such frame.
    pub after: Option<Point2<f64>>,
    /// Mean absolute difference of the windows in frames k and k + 1, values 0..=1.
    pub residual: f64,
    /// Forward-backward error between frames k and k + 1, pixels.
    pub forward_backward_error_px: f64,
}

impl Track {
    /// Whether it is of the forward flow, which warps the earlier frame in eq. (9).
    pub fn in_forward_set(&self) -> bool {
        self.direction != FlowDirection::Backward
    }

    /// Whether it is of the backward flow, which warps the later frame in eq. (9).
    pub fn in_backward_set(&self) -> bool {
        self.direction != FlowDirection::Forward
    }

    /// The displacement from frame k to frame k + 1, pixels.
    pub fn motion(&self) -> Vector2<f64> {
        self.later - self.earlier
    }

    /// The trajectory through the two to four known positions: eq. (2), and curves beyond the paper.
    ///
    /// `times_s` are the camera's frame times in seconds and `k` is the index of the earlier frame.
    /// `None` if the times do not strictly ascend.
    ///
    /// # Panics
    /// If `times_s` has no entry for frame k + 1.
    pub fn trajectory(&self, times_s: &[f64], k: usize) -> Option<Trajectory> {
        let before = self.before.zip(k.checked_sub(1)).map(|(p, k)| (times_s[k], p));
        let after = self.after.filter(|_| k + 2 < times_s.len()).map(|p| (times_s[k + 2], p));
        Trajectory::new(
            before
                .into_iter()
                .chain([(times_s[k], self.earlier), (times_s[k + 1], self.later)])
                .chain(after),
        )
    }
}

/// Pyramid levels, forward and backward, where the motion prior gives the guess. Larger: small objects in
/// fast motion are pulled away by their background; smaller: the prior must be more accurate.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Maximum number of times that lost features are sought again with the motion prior, which gains
/// features each time. Larger: time for few more; smaller: large motion is followed near slow motion
/// only.
const PRIOR_ROUNDS: usize = 2;
/// Pyramid levels, forward and backward, of extending a track by a frame, where its motion gives the
/// guess. Larger: as of [`PRIOR_LEVELS`]; smaller: changes of motion are lost.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];

/// The bidirectional temporal flow (§4.1) between frames `k` and `k + 1` of a camera, from the corners of
/// both.
///
/// Correspondences of both directions are merged, those unlike their neighbours are removed
/// ([`neighbor_consensus`]), and the others are extended by a frame at both ends where there is one.
/// The order does not depend on the number of threads.
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

/// As [`temporal_flow`], of given points instead of corners: those of frame `k`, and those of frame
/// `k + 1`, pixels.
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
    let forward = directed_flow(&earlier, &later, of_earlier, options);
    let backward = directed_flow(&later, &earlier, of_later, options);
    let mut tracks = merged(&forward, &backward, options.merge_distance_px);
    let mut consensus = neighbor_consensus(&tracks, options).into_iter();
    tracks.retain(|_| consensus.next().unwrap_or(true));

    let count = frames.capture().cameras[camera].frames.len();
    if let Some(before) = k.checked_sub(1) {
        let frame = frames.get(camera, before)?;
        let start = |t: &Track| (t.earlier, t.earlier - t.motion());
        for (track, p) in extensions(&tracks, [&earlier, &frame], start, options) {
            tracks[track].before = Some(p);
        }
    }
    if k + 2 < count {
        let frame = frames.get(camera, k + 2)?;
        let start = |t: &Track| (t.later, t.later + t.motion());
        for (track, p) in extensions(&tracks, [&later, &frame], start, options) {
            tracks[track].after = Some(p);
        }
    }
    Ok(tracks)
}

/// One direction of the bidirectional flow. Points are sought from where they are; then those that were
/// lost, or that move unlike their neighbours, from where the motion prior predicts them.
fn directed_flow(
    source: &Frame,
    target: &Frame,
    corners: &[Point2<f64>],
    options: &RegistrationOptions,
) -> Vec<Match> {
    let starts: Vec<_> = corners.iter().map(|&p| (p, p)).collect();
    let mut matches = flow(source, target, &starts, options);
    let mut tried = vec![None; corners.len()];
    for _ in 0..PRIOR_ROUNDS {
        let mut again = predicted_by_neighbors(corners, &matches, options);
        again.retain(|(k, start)| is_new(&mut tried[*k], start.1));
        if again.is_empty() {
            break;
        }
        let starts: Vec<_> = again.iter().map(|(_, start)| *start).collect();
        let retried = flow_over(source, target, &starts, PRIOR_LEVELS, options);
        for ((k, _), retried) in again.iter().zip(retried) {
            let Some(retried) = retried else { continue };
            if matches[*k].is_none_or(|first| retried.residual < first.residual) {
                matches[*k] = Some(retried);
            }
        }
    }
    matches.into_iter().flatten().collect()
}

/// Initial guesses, by index, of the points that were lost or that move unlike their neighbours. Points
/// without neighbours have none.
fn predicted_by_neighbors(
    corners: &[Point2<f64>],
    matches: &[Option<Match>],
    options: &RegistrationOptions,
) -> Vec<(usize, Start)> {
    let motions: Vec<_> =
        matches.iter().flatten().map(|m| (m.source, m.target - m.source)).collect();
    let agrees = consensus(&motions, options);
    let trusted: Vec<_> = motions
        .iter()
        .zip(&agrees)
        .filter_map(|(motion, agrees)| agrees.then_some(*motion))
        .collect();
    let prior = MotionPrior::new(&trusted);
    let mut agrees = agrees.into_iter();
    (0..corners.len())
        .filter(|&k| matches[k].is_none() || !agrees.next().unwrap_or(true))
        .filter_map(|k| {
            let motion = prior.predict(&corners[k], MotionPrior::RADIUS_PX)?;
            Some((k, (corners[k], corners[k] + motion)))
        })
        .collect()
}

/// Extends tracks by a frame: `(index of the track, position)` of those that were found and whose motion
/// changes by no more than the options allow. `start` gives a track's position in the source and its
/// guess in the target.
fn extensions(
    tracks: &[Track],
    [source, target]: [&Frame; 2],
    start: impl Fn(&Track) -> Start,
    options: &RegistrationOptions,
) -> Vec<(usize, Point2<f64>)> {
    let starts: Vec<_> = tracks.iter().map(start).collect();
    flow_over(source, target, &starts, EXTENSION_LEVELS, options)
        .into_iter()
        .enumerate()
        .filter_map(|(k, matched)| {
            let position = matched?.target;
            let change = (position - starts[k].1).norm();
            let limit = options.max_motion_change_px
                + options.max_motion_change_share * tracks[k].motion().norm();
            (change <= limit).then_some((k, position))
        })
        .collect()
}

/// The correspondences of both directions, with those within `distance_px` at both ends merged.
fn merged(forward: &[Match], backward: &[Match], distance_px: f64) -> Vec<Track> {
    let track = |direction, m: &Match| {
        let (earlier, later) = if direction == FlowDirection::Backward {
            (m.target, m.source)
        } else {
            (m.source, m.target)
        };
        Track {
            direction,
            before: None,
            earlier,
            later,
            after: None,
            residual: m.residual,
            forward_backward_error_px: m.forward_backward_error_px,
        }
    };
    let mut tracks: Vec<Track> = forward.iter().map(|m| track(FlowDirection::Forward, m)).collect();
    let at_earlier = Neighbors::new(forward.iter().map(|m| m.source));
    for m in backward {
        let twin = at_earlier
            .within(&m.target, distance_px)
            .into_iter()
            .filter(|&k| (forward[k].target - m.source).norm() <= distance_px)
            .min_by(|&a, &b| {
                let gap = |k: usize| (forward[k].source - m.target).norm();
                gap(a).total_cmp(&gap(b))
            });
        match twin {
            Some(k) => tracks[k].direction = FlowDirection::Both,
            None => tracks.push(track(FlowDirection::Backward, m)),
        }
    }
    tracks
}

/// For each track, whether it moves like [`RegistrationOptions::min_support`] of its neighbours. A
/// surface has more than one feature, so that a track unlike its neighbours is a mismatch.
///
/// Also true where a track has fewer neighbours than that.
pub fn neighbor_consensus(tracks: &[Track], options: &RegistrationOptions) -> Vec<bool> {
    consensus(&tracks.iter().map(|t| (t.earlier, t.motion())).collect::<Vec<_>>(), options)
}

/// As [`neighbor_consensus`], of positions and their motions.
fn consensus(motions: &[(Point2<f64>, Vector2<f64>)], options: &RegistrationOptions) -> Vec<bool> {
    let neighbors = Neighbors::new(motions.iter().map(|(p, _)| *p));
    motions
        .par_iter()
        .enumerate()
        .map(|(k, (p, motion))| {
            let limit = options.support_px + options.support_share * motion.norm();
            let near = neighbors.unsorted_within(p, options.support_radius_px);
            let support = near
                .iter()
                .filter(|&&n| n != k && (motions[n].1 - motion).norm() <= limit)
                .take(options.min_support)
                .count();
            near.len().saturating_sub(1) < options.min_support || support >= options.min_support
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a_match(x: f64, dx: f64) -> Match {
        Match {
            source: Point2::new(x, 10.0),
            target: Point2::new(x + dx, 10.0),
            residual: 0.01,
            forward_backward_error_px: 0.1,
        }
    }

    #[test]
    fn a_correspondence_of_both_directions_is_merged_and_labelled() {
        let forward = [a_match(10.0, 3.0), a_match(20.0, 3.0)];
        // The first is the forward one reversed; the second starts there but goes elsewhere.
        let backward = [a_match(13.2, -3.1), a_match(23.1, -9.0)];
        let tracks = merged(&forward, &backward, 1.0);
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
        let mut tracks = merged(&matches, &[], 1.0);
        let mut consensus =
            neighbor_consensus(&tracks, &RegistrationOptions::default()).into_iter();
        tracks.retain(|_| consensus.next().unwrap());
        assert_eq!(tracks.len(), 8);
        assert!(tracks.iter().all(|t| (t.motion().x - 5.0).abs() < 1e-9));
    }

    #[test]
    fn trajectories_use_the_positions_that_exist() {
        let mut track = merged(&[a_match(10.0, 3.0)], &[], 1.0).remove(0);
        track.before = Some(Point2::new(8.0, 10.0));
        let times = [0.0, 1.0, 2.0];
        let curved = track.trajectory(&times, 1).unwrap();
        assert!((curved.at(1.5).x - 11.375).abs() < 1e-12);
        // Frame 0 has no frame before it, whatever the track says.
        assert!((track.trajectory(&times, 0).unwrap().at(0.5).x - 11.5).abs() < 1e-12);
    }
}
