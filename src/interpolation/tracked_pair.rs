//! The tracks between two frames of a camera, in the forms that the interpolation methods need.

use super::edges::EdgeFeature;
use crate::capture::{FrameTimes, RowTimes};
use crate::registration::{Moved, Track, Trajectory};
use nalgebra::{Matrix2, Point2, Vector2};

/// The tracks between two consecutive frames of a camera.
#[derive(Clone, Copy)]
pub struct TrackedPair<'a> {
    /// Tracks between the two frames. If there are none, interpolation is a cross-fade.
    pub tracks: &'a [Track],
    /// Times of all frames of the camera.
    pub times: FrameTimes<'a>,
    /// Index of the earlier frame. The later frame has the next index.
    pub index: usize,
}

/// Returns the tracks of the forward flow (from the earlier to the later frame) if `forward` is true, else the tracks
/// of the backward flow. A track may be in both flows.
pub(super) fn flow_tracks(tracks: &[Track], forward: bool) -> impl Iterator<Item = &Track> {
    tracks.iter().filter(move |t| if forward { t.in_forward_set() } else { t.in_backward_set() })
}

impl TrackedPair<'_> {
    /// Returns the position (t' − t)/Δt of the instant t' in the interval between the two frames: 0 at the earlier and
    /// 1 at the later frame, clamped to 0..=1. With a rolling shutter, the time of a frame is the time of its middle
    /// row.
    ///
    /// # Panics
    /// If `times` has no entry for the later frame.
    pub(super) fn fraction(&self, time_s: f64) -> f64 {
        let [start, end] = self.interval_s();
        ((time_s - start) / (end - start)).clamp(0.0, 1.0)
    }

    /// Returns the position of the instant in the frame interval ([`Self::fraction`]) for every image row.
    pub(super) fn row_fractions(&self, time_s: f64) -> RowFractions {
        let [start, end] = self.interval_s();
        RowFractions {
            middle: self.fraction(time_s),
            rows: self.times.rows,
            interval_s: end - start,
        }
    }

    fn interval_s(&self) -> [f64; 2] {
        [self.times.times_s[self.index], self.times.times_s[self.index + 1]]
    }

    /// Returns the trajectory of a track: a curve if `curved`, else the straight line of eq. (2). Returns `None` if the
    /// frames' times do not strictly ascend.
    fn trajectory(&self, track: &Track, curved: bool) -> Option<Trajectory> {
        if curved {
            track.trajectory(self.times, self.index)
        } else {
            let straight = Track { before: None, after: None, ..track.clone() };
            straight.trajectory(self.times, self.index)
        }
    }

    /// Returns the tracks of the forward or of the backward flow as features, with their positions in the two frames
    /// and at `time_s` (seconds). The features' source frame is the earlier frame for the forward flow, and the later
    /// frame for the backward flow.
    pub(super) fn features(&self, time_s: f64, forward: bool, curved: bool) -> Vec<EdgeFeature> {
        let feature = |t: &Track| {
            let (source, other) = if forward { (t.earlier, t.later) } else { (t.later, t.earlier) };
            // Times ascend strictly, so that every track has a trajectory.
            let target = self.trajectory(t, curved).map_or(source, |t| t.at(time_s));
            EdgeFeature { source, other, target }
        };
        flow_tracks(self.tracks, forward).map(feature).collect()
    }

    /// Returns the displacements, in pixels, of all tracks to four frames: the frame before the pair, the earlier and
    /// the later frame of the pair, and the frame after the pair. The displacements of a track are measured from the
    /// position that `at` returns for it.
    pub(super) fn motions(
        &self,
        curved: bool,
        at: impl Fn(&Trajectory, &Track) -> Point2<f64>,
    ) -> Vec<TrackMotion> {
        let exists = |k: &usize| *k < self.times.times_s.len();
        let before = self.index.checked_sub(1);
        let after = Some(self.index + 2).filter(exists);
        let motion = |track: &Track| {
            let trajectory = self.trajectory(track, curved)?;
            let at = at(&trajectory, track);
            // If a track was not extended to a frame, its trajectory is extrapolated.
            let displacement = |tracked: Option<Point2<f64>>, frame: Option<usize>| {
                let position = tracked.or_else(|| Some(self.in_frame(&trajectory, frame?)));
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

    /// Returns the position, in pixels, at which a frame shows a point that moves on this trajectory.
    fn in_frame(&self, trajectory: &Trajectory, frame: usize) -> Point2<f64> {
        let at_middle = trajectory.at(self.times.times_s[frame]);
        if self.times.rows.are_global() {
            return at_middle;
        }
        // The time depends on the row of the position, and the position depends on the time. Two fixed-point
        // iterations solve this. If the point moves by a tenth of the image's height during a readout, each
        // iteration reduces the error to a tenth.
        let corrected = trajectory.at(self.times.at(frame, &at_middle));
        trajectory.at(self.times.at(frame, &corrected))
    }
}

/// The position of an instant between two frames, as a fraction of the frame interval for each image row. With a
/// rolling shutter, each row has its own times.
#[derive(Clone, Copy, Debug)]
pub struct RowFractions {
    /// Fraction at the middle row, 0 to 1.
    middle: f64,
    rows: RowTimes,
    interval_s: f64,
}

impl RowFractions {
    /// Creates fractions that are equal in all rows.
    pub fn constant(fraction: f64) -> Self {
        Self { middle: fraction, rows: RowTimes::default(), interval_s: 1.0 }
    }

    /// Returns whether all rows have the same fraction.
    pub fn are_constant(&self) -> bool {
        self.rows.are_global()
    }

    /// Returns the fraction at a vertical position in pixels. It is 0 if the earlier frame exposes this row at the
    /// instant or later, and 1 if the later frame exposes this row at the instant or earlier.
    pub fn at(&self, y_px: f64) -> f64 {
        if self.are_constant() {
            return self.middle;
        }
        (self.middle - self.rows.offset_s(y_px) / self.interval_s).clamp(0.0, 1.0)
    }
}

/// A track's position, and its displacements from this position to the four frames around an instant. All are in
/// pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrackMotion {
    /// Position from which the displacements are measured, in pixels: the track's position at the instant, or in one of
    /// the pair's frames.
    pub at: Point2<f64>,
    /// Displacements to the frame before the pair, the earlier and the later frame of the pair, and the frame after
    /// the pair, in pixels. The displacement to a frame that does not exist is 0.
    pub to: [Vector2<f64>; 4],
    /// Linear part (2×2 matrix) of the affine motion from the earlier to the later frame. It is the identity for a
    /// translation.
    pub deformation: Matrix2<f64>,
}

impl TrackMotion {
    /// Returns the difference between two tracks' motions from the earlier to the later frame, in pixels. To compare
    /// them at one position, one of the motions is extrapolated affinely to the other track's position. Of the two
    /// differences that this gives, the smaller is returned.
    pub fn difference_px(&self, other: &Self) -> f64 {
        let [own, other] = [self, other].map(|m| Moved {
            at: m.at + m.to[1],
            motion: m.to[2] - m.to[1],
            deformation: m.deformation,
        });
        own.distance(&other)
    }
}
