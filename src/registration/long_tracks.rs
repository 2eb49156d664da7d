//! Features tracked over many frames, each under an identifier of its own.

use super::corners::MinDistanceSet;
use super::{FrameStore, RegistrationOptions, Trajectory, flow};
use crate::capture::CaptureError;
use nalgebra::{Point2, Vector2};
use std::collections::VecDeque;

/// A feature of [`LongTracks`] that is alive in the current frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LongTrack {
    /// The identifier: ascending in the order of detection, and never reused.
    pub id: u64,
    /// Index of the frame in which it was detected.
    pub first_frame: usize,
    /// Its positions in the last frames up to the current one, oldest first, pixels; at most
    /// [`Trajectory::MAX`].
    recent: VecDeque<Point2<f64>>,
}

impl LongTrack {
    /// Its position in the current frame, pixels.
    pub fn position(&self) -> Point2<f64> {
        self.recent[self.recent.len() - 1]
    }

    /// Its trajectory through the last two to four frames; `times_s` are the camera's frame times in
    /// seconds and `frame` is the current frame ([`LongTracks::frame`]). `None` in the first frame
    /// that has it.
    ///
    /// # Panics
    /// If `times_s` has no entry for `frame`.
    pub fn trajectory(&self, times_s: &[f64], frame: usize) -> Option<Trajectory> {
        let first = (frame + 1).checked_sub(self.recent.len())?;
        Trajectory::new(self.recent.iter().enumerate().map(|(k, p)| (times_s[first + k], *p)))
    }

    /// Its predicted position in the next frame, pixels: of constant position, velocity or
    /// acceleration, by as many frames as are known (at most three).
    fn predicted_position(&self) -> Point2<f64> {
        let known = &self.recent;
        let motion = |back: usize| known[known.len() - back] - known[known.len() - back - 1];
        match known.len() {
            1 => known[0],
            2 => known[1] + motion(1),
            n => known[n - 1] + (motion(1) + (motion(1) - motion(2))),
        }
    }
}

/// Minimum distance between two features over that between corners. Larger: noise and surfaces that
/// shrink a little end features; smaller: features that fell together are all tracked.
const TRACK_DISTANCE: f64 = 0.5;

/// The features of one camera, tracked over any number of frames in constant memory.
///
/// Known limit: each step's error adds to the ones before, so that a feature drifts in proportion to
/// the square root of the number of frames.
#[derive(Clone, Debug)]
pub struct LongTracks {
    camera: usize,
    frame: usize,
    next_id: u64,
    tracks: Vec<LongTrack>,
}

impl LongTracks {
    /// Starts at frame `frame` of camera `camera` (indices into the capture), with its corners.
    ///
    /// # Errors
    /// If the frame cannot be read.
    pub fn start(frames: &FrameStore, camera: usize, frame: usize) -> Result<Self, CaptureError> {
        let mut all = Self { camera, frame, next_id: 0, tracks: Vec::new() };
        all.replenish(frames)?;
        Ok(all)
    }

    /// Index of the current frame.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// The features alive in the current frame, by ascending identifier.
    pub fn tracks(&self) -> &[LongTrack] {
        &self.tracks
    }

    /// Tracks every feature to the next frame. Lost features end, and corners that are not near a
    /// feature begin.
    ///
    /// # Errors
    /// If the next frame cannot be read.
    ///
    /// # Panics
    /// If there is no next frame.
    pub fn advance(&mut self, frames: &FrameStore) -> Result<(), CaptureError> {
        let options = frames.options();
        let source = frames.get(self.camera, self.frame)?;
        let target = frames.get(self.camera, self.frame + 1)?;
        let starts: Vec<_> =
            self.tracks.iter().map(|t| (t.position(), t.predicted_position())).collect();
        let matches = flow(&source, &target, &starts, options);
        let mut occupied = Self::occupied(options, target.pyramid.width(), target.pyramid.height());
        let mut matches = matches.into_iter();
        self.tracks.retain_mut(|track| {
            let Some(Some(matched)) = matches.next() else { return false };
            let change = matched.target - track.predicted_position();
            let limit = options.max_motion_change_px
                + options.max_motion_change_share * track.last_motion().norm();
            // Where the motion is known, its change is bounded. Of two features that meet, the
            // older goes on.
            let plausible = track.recent.len() == 1 || change.norm() <= limit;
            if !plausible || !occupied.insert(matched.target) {
                return false;
            }
            if track.recent.len() == Trajectory::MAX {
                track.recent.pop_front();
            }
            track.recent.push_back(matched.target);
            true
        });
        self.frame += 1;
        self.replenish(frames)
    }

    /// Adds features at corners that are not near one.
    fn replenish(&mut self, frames: &FrameStore) -> Result<(), CaptureError> {
        let options = frames.options();
        let frame = frames.get(self.camera, self.frame)?;
        let mut occupied = Self::occupied(options, frame.pyramid.width(), frame.pyramid.height());
        for track in &self.tracks {
            occupied.insert(track.position());
        }
        for &corner in frame.corners(options) {
            if self.tracks.len() >= options.corners.max_corners {
                break;
            }
            if occupied.insert(corner) {
                self.tracks.push(LongTrack {
                    id: self.next_id,
                    first_frame: self.frame,
                    recent: VecDeque::from([corner]),
                });
                self.next_id += 1;
            }
        }
        Ok(())
    }

    /// An empty set of occupied positions in an image of this size.
    fn occupied(options: &RegistrationOptions, width: usize, height: usize) -> MinDistanceSet {
        MinDistanceSet::new(width, height, TRACK_DISTANCE * options.corners.min_distance_px)
    }
}

impl LongTrack {
    fn last_motion(&self) -> Vector2<f64> {
        match self.recent.len() {
            1 => Vector2::zeros(),
            n => self.recent[n - 1] - self.recent[n - 2],
        }
    }
}
