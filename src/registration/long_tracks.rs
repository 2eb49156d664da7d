//! Features followed from frame to frame, each under a number that stays its own.

use super::{FrameStore, RegistrationOptions, Spaced, Trajectory, flow};
use crate::capture::CaptureError;
use nalgebra::{Point2, Vector2};
use std::collections::VecDeque;

/// A feature that is being followed: alive in the frame that was visited last.
#[derive(Clone, Debug, PartialEq)]
pub struct LongTrack {
    /// Given once, in the order of first sight, and never again.
    pub id: u64,
    /// The frame in which it was first seen.
    pub first_frame: usize,
    /// Where it was in the frames visited last, oldest first, pixels: as many as a [`Trajectory`] takes.
    recent: VecDeque<Point2<f64>>,
}

impl LongTrack {
    /// Where it is in the frame visited last.
    pub fn position(&self) -> Point2<f64> {
        self.recent[self.recent.len() - 1]
    }

    /// Its path through the frames visited last; `frame` is the last of them, `times_s` are the
    /// camera's. `None` in the first frame that has it.
    pub fn path(&self, times_s: &[f64], frame: usize) -> Option<Trajectory> {
        let first = (frame + 1).checked_sub(self.recent.len())?;
        Trajectory::new(self.recent.iter().enumerate().map(|(k, p)| (times_s[first + k], *p)))
    }

    /// Where it would be in the next frame if it went on as it did: what a body in smooth motion
    /// does, by as many frames as are known (at most three).
    fn guess(&self) -> Point2<f64> {
        let known = &self.recent;
        let motion = |back: usize| known[known.len() - back] - known[known.len() - back - 1];
        match known.len() {
            1 => known[0],
            2 => known[1] + motion(1),
            n => known[n - 1] + (motion(1) + (motion(1) - motion(2))),
        }
    }
}

/// The features of one camera, over any number of frames; what it holds does not grow with them.
///
/// Known limit: each step's error adds to the ones before, so that a feature drifts by the root of
/// the number of frames.
#[derive(Clone, Debug)]
pub struct LongTracks {
    camera: usize,
    frame: usize,
    next_id: u64,
    tracks: Vec<LongTrack>,
}

impl LongTracks {
    /// Starts at a frame, with its corners.
    pub fn start(frames: &FrameStore, camera: usize, frame: usize) -> Result<Self, CaptureError> {
        let mut all = Self { camera, frame, next_id: 0, tracks: Vec::new() };
        all.replenish(frames)?;
        Ok(all)
    }

    /// The frame visited last.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// The features alive in it, by ascending number.
    pub fn tracks(&self) -> &[LongTrack] {
        &self.tracks
    }

    /// Follows every feature to the next frame; those that are lost end, and corners where there
    /// is no feature begin.
    ///
    /// # Panics
    /// If there is no next frame.
    pub fn advance(&mut self, frames: &FrameStore) -> Result<(), CaptureError> {
        let options = frames.options();
        let source = frames.get(self.camera, self.frame)?;
        let target = frames.get(self.camera, self.frame + 1)?;
        let starts: Vec<_> = self.tracks.iter().map(|t| (t.position(), t.guess())).collect();
        let found = flow(&source, &target, &starts, options);
        let mut spaced = self.spaced(options, target.pyramid.width(), target.pyramid.height());
        let mut found = found.into_iter();
        self.tracks.retain_mut(|track| {
            let Some(Some(found)) = found.next() else { return false };
            let change = found.target - track.guess();
            let limit = options.max_motion_change_px
                + options.max_motion_change_share * track.last_motion().norm();
            // Where the motion is known, it changes as a body's does. Two that run into each
            // other: the older goes on.
            let credible = track.recent.len() == 1 || change.norm() <= limit;
            if !credible || !spaced.insert(found.target) {
                return false;
            }
            if track.recent.len() == Trajectory::MAX {
                track.recent.pop_front();
            }
            track.recent.push_back(found.target);
            true
        });
        self.frame += 1;
        self.replenish(frames)
    }

    /// New features at corners that are nobody's.
    fn replenish(&mut self, frames: &FrameStore) -> Result<(), CaptureError> {
        let options = frames.options();
        let frame = frames.get(self.camera, self.frame)?;
        let mut spaced = self.spaced(options, frame.pyramid.width(), frame.pyramid.height());
        for track in &self.tracks {
            spaced.insert(track.position());
        }
        for &corner in frame.corners(options) {
            if self.tracks.len() >= options.corners.max_corners {
                break;
            }
            if spaced.insert(corner) {
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

    /// A grid to keep features apart: by half of what corners keep, so that neither noise nor a
    /// surface that shrinks a little ends them.
    fn spaced(&self, options: &RegistrationOptions, width: usize, height: usize) -> Spaced {
        Spaced::new(width, height, 0.5 * options.corners.min_distance_px)
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
