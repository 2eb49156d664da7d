//! Tracks between two frames of a camera, as the methods of interpolation use them.

use super::edges::EdgeFeature;
use crate::capture::{FrameTimes, RowTimes};
use crate::registration::{Moved, Track, Trajectory};
use nalgebra::{Matrix2, Point2, Vector2};

/// The tracks between two consecutive frames of a camera.
#[derive(Clone, Copy)]
pub struct TrackedPair<'a> {
    /// The pair's tracks. If there are none, interpolation is a cross-fade.
    pub tracks: &'a [Track],
    /// The times of all frames of the camera.
    pub times: FrameTimes<'a>,
    /// Index of the earlier frame; the later frame is the next.
    pub index: usize,
}

/// The tracks of the forward flow, or with `forward` false those of the backward flow.
pub(super) fn flow_tracks(tracks: &[Track], forward: bool) -> impl Iterator<Item = &Track> {
    tracks.iter().filter(move |t| if forward { t.in_forward_set() } else { t.in_backward_set() })
}

impl TrackedPair<'_> {
    /// (t' − t)/Δt of the instant t': 0 at the earlier frame and 1 at the later one, clamped to 0..=1. With a rolling
    /// shutter, it is that of the frames' middle rows.
    ///
    /// # Panics
    /// If `times` has no entry for the later frame.
    pub(super) fn fraction(&self, time_s: f64) -> f64 {
        let [start, end] = self.interval_s();
        ((time_s - start) / (end - start)).clamp(0.0, 1.0)
    }

    /// [`Self::fraction`] of every row.
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

    /// The track's trajectory: a curve if `curved`, else the straight line of eq. (2).
    fn trajectory(&self, track: &Track, curved: bool) -> Option<Trajectory> {
        if curved {
            track.trajectory(self.times, self.index)
        } else {
            let straight = Track { before: None, after: None, ..track.clone() };
            straight.trajectory(self.times, self.index)
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

    /// The displacements of all tracks to four frames: the one before the pair, the pair's earlier and later
    /// frame, and the one after the pair. `at` gives the position from which a track's displacements are
    /// measured.
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
            // The trajectory extrapolates a track that was not extended to a frame.
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

    /// Where a frame shows a point of this trajectory, pixels.
    fn in_frame(&self, trajectory: &Trajectory, frame: usize) -> Point2<f64> {
        let at_middle = trajectory.at(self.times.times_s[frame]);
        if self.times.rows.are_global() {
            return at_middle;
        }
        // The row depends on the time, and the time on the row. A point that moves by a tenth of the image's height
        // during a readout is a tenth of its error nearer after each correction.
        let corrected = trajectory.at(self.times.at(frame, &at_middle));
        trajectory.at(self.times.at(frame, &corrected))
    }
}

/// The instant's place between two frames, by row: rows of a rolling shutter have times of their own.
#[derive(Clone, Copy, Debug)]
pub struct RowFractions {
    /// Of the middle row, 0 to 1.
    middle: f64,
    rows: RowTimes,
    interval_s: f64,
}

impl RowFractions {
    /// The same fraction in all rows.
    pub fn constant(fraction: f64) -> Self {
        Self { middle: fraction, rows: RowTimes::default(), interval_s: 1.0 }
    }

    /// Whether all rows have the same fraction.
    pub fn are_constant(&self) -> bool {
        self.rows.are_global()
    }

    /// The fraction at a vertical position, pixels: 0 where the earlier frame has the instant or a later time, 1 where
    /// the later frame has the instant or an earlier time.
    pub fn at(&self, y_px: f64) -> f64 {
        if self.are_constant() {
            return self.middle;
        }
        (self.middle - self.rows.offset_s(y_px) / self.interval_s).clamp(0.0, 1.0)
    }
}

/// A track's position at an instant, pixels, and its displacements from there to the two frames before and
/// the two frames after the instant, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrackMotion {
    /// Position at the instant.
    pub at: Point2<f64>,
    /// Displacements to the frame before the pair, the pair's earlier and later frame, and the frame after
    /// the pair; 0 to a frame that does not exist.
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
