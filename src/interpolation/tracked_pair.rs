//! Tracks between two frames of a camera, as the methods of interpolation use them.

use super::edges::EdgeFeature;
use crate::registration::{Moved, Track, Trajectory};
use nalgebra::{Matrix2, Point2, Vector2};

/// The tracks between two consecutive frames of a camera.
#[derive(Clone, Copy)]
pub struct TrackedPair<'a> {
    /// The pair's tracks. If there are none, interpolation is a cross-fade.
    pub tracks: &'a [Track],
    /// The times of all frames of the camera, seconds, strictly ascending.
    pub times_s: &'a [f64],
    /// Index of the earlier frame; the later frame is the next.
    pub index: usize,
}

/// The tracks of the forward flow, or with `forward` false those of the backward flow.
pub(super) fn flow_tracks(tracks: &[Track], forward: bool) -> impl Iterator<Item = &Track> {
    tracks.iter().filter(move |t| if forward { t.in_forward_set() } else { t.in_backward_set() })
}

impl TrackedPair<'_> {
    /// (t' − t)/Δt of the instant t': 0 at the earlier frame and 1 at the later one, clamped to 0..=1.
    ///
    /// # Panics
    /// If `times_s` has no entry for the later frame.
    pub(super) fn fraction(&self, time_s: f64) -> f64 {
        let [start, end] = [self.times_s[self.index], self.times_s[self.index + 1]];
        ((time_s - start) / (end - start)).clamp(0.0, 1.0)
    }

    /// The track's trajectory: a curve if `curved`, else the straight line of eq. (2).
    fn trajectory(&self, track: &Track, curved: bool) -> Option<Trajectory> {
        if curved {
            track.trajectory(self.times_s, self.index)
        } else {
            let straight = Track { before: None, after: None, ..track.clone() };
            straight.trajectory(self.times_s, self.index)
        }
    }

    /// The features of the tracks of the forward or the backward flow, with their positions at an instant.
    pub(super) fn features(&self, time_s: f64, forward: bool, curved: bool) -> Vec<EdgeFeature> {
        let feature = |t: &Track| {
            let (source, other) = if forward { (t.earlier, t.later) } else { (t.later, t.earlier) };
            // Times ascend strictly, so that every track has a trajectory.
            let target = self.trajectory(t, curved).map_or(source, |t| t.at(time_s));
            EdgeFeature { source, other, target }
        };
        flow_tracks(self.tracks, forward).map(feature).collect()
    }

    /// The displacements of all tracks to the frames before, earlier, later and after, each from the track's
    /// position at some instant. `at` returns that position.
    pub(super) fn motions(
        &self,
        curved: bool,
        at: impl Fn(&Trajectory, &Track) -> Point2<f64>,
    ) -> Vec<TrackMotion> {
        let time = |frame: Option<usize>| frame.and_then(|k| self.times_s.get(k)).copied();
        let (before, after) = (time(self.index.checked_sub(1)), time(Some(self.index + 2)));
        let motion = |track: &Track| {
            let trajectory = self.trajectory(track, curved)?;
            let at = at(&trajectory, track);
            // The trajectory extrapolates a track that was not extended to a frame.
            let displacement = |tracked: Option<Point2<f64>>, time: Option<f64>| {
                let position = tracked.or_else(|| Some(trajectory.at(time?)));
                position.map_or(Vector2::zeros(), |p| p - at)
            };
            let to = [
                displacement(track.before, before),
                track.earlier - at,
                track.later - at,
                displacement(track.after, after),
            ];
            Some(TrackMotion { at, to, deformation: track.deformation })
        };
        self.tracks.iter().filter_map(motion).collect()
    }
}

/// A track's position at an instant, and its displacements from there to the four frames around the instant.
/// Pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrackMotion {
    /// Position at the instant.
    pub at: Point2<f64>,
    /// Displacements to the positions in the frames before, earlier, later and after; 0 to a frame that does
    /// not exist.
    pub to: [Vector2<f64>; 4],
    /// Linear part of the motion from the earlier to the later frame: the identity for a translation.
    pub deformation: Matrix2<f64>,
}

impl TrackMotion {
    /// Difference between two tracks' motions from the earlier to the later frame, pixels. One motion is
    /// extrapolated affinely to the other track's position; of the two ways to do this, the smaller
    /// difference is returned.
    pub fn difference_px(&self, other: &Self) -> f64 {
        let [own, other] = [self, other].map(|m| Moved {
            at: m.at + m.to[1],
            motion: m.to[2] - m.to[1],
            deformation: m.deformation,
        });
        own.distance(&other)
    }
}
