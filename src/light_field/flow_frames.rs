//! Frames with their depth and motion as estimated by scene flow, for callers that render views by themselves.

use super::graph::LightField;
use super::points::nearest;
use super::scene_flow::{LoadedFrame, load};
use super::slots::{FrameId, Slot, Slots};
use super::stages::{FlowOptions, FrameFlow};
use super::stored_slots::store_slots;
use super::{Context, RenderError};
use crate::camera::Camera;
use crate::options::RenderOptions;
use crate::scene_flow::fading;
use std::collections::BTreeSet;

/// Maximum number of cameras from whose frames a view by scene flow is blended.
const MAX_CAMERAS: usize = 8;

impl LightField {
    /// Returns the frames nearest to a view, as (camera index, frame index), sorted. For each of the cameras nearest to
    /// `target`, the list contains the frame nearest in time to `time_s`, seconds from the capture's start.
    pub fn frames_of_view(&self, target: &Camera, time_s: f64) -> Vec<(usize, usize)> {
        let mut cameras = nearest(self.capture(), &self.usable(time_s), target.center());
        cameras.truncate(MAX_CAMERAS);
        let frame = |c: usize| self.nearest_frame(c, time_s).map(|k| (c, k));
        let mut frames: Vec<FrameId> = cameras.into_iter().filter_map(frame).collect();
        // The frames are sorted, so that views from other places with the same frames share cached results.
        frames.sort_unstable();
        frames
    }

    /// Returns the frames from which a view by scene flow is blended, sorted: those of [`Self::frames_of_view`], and the frames
    /// into which some of them fade. Frames of a wide array don't fade.
    pub(super) fn blended_frames(&self, target: &Camera, time_s: f64) -> Vec<FrameId> {
        let mut frames = self.frames_of_view(target, time_s);
        if self.common_place().is_none() {
            let next = |&(camera, frame): &FrameId| {
                Some((camera, fades_into(self.times_s(camera), frame, time_s)?))
            };
            let next: Vec<FrameId> = frames.iter().filter_map(next).collect();
            frames.extend(next);
            frames.sort_unstable();
        }
        frames
    }

    /// Returns whether a view by scene flow can be rendered without estimating depth and motion: whether those of all
    /// frames from which it is blended are in memory or on disk.
    pub(crate) fn has_flow(&self, target: &Camera, time_s: f64, options: &RenderOptions) -> bool {
        let options = FlowOptions::new(options);
        let frames = self.blended_frames(target, time_s);
        let flow = |&frame: &FrameId| FrameFlow { frame, options };
        let is_there =
            |frame| self.cached(&flow(frame)).is_some() || self.stored(&flow(frame)).is_some();
        !frames.is_empty() && frames.iter().all(is_there)
    }

    /// Returns the frames, as (camera index, frame index), that views by scene flow use within a span of time. The span
    /// is the first and the last instant, seconds from the capture's start. For every camera, the result contains each
    /// frame that is the camera's nearest frame at some instant of the span. The frames are ordered by time.
    pub fn frames_within(&self, (first_s, last_s): (f64, f64)) -> Vec<(usize, usize)> {
        let of = |camera: usize| {
            let ends = [first_s, last_s].map(|t| self.nearest_frame(camera, t));
            let range = ends[0].zip(ends[1]).map(|(first, last)| first..last + 1);
            range.into_iter().flatten().map(move |frame| (camera, frame))
        };
        let mut frames: Vec<FrameId> = (0..self.capture().cameras.len()).flat_map(of).collect();
        let time_s = |&(camera, frame): &FrameId| self.times_s(camera)[frame];
        frames.sort_by(|a, b| time_s(a).total_cmp(&time_s(b)).then(a.cmp(b)));
        frames
    }

    /// Stores depth and motion of the given frames on disk, as [`Self::prepare`] does for all frames. A frame is
    /// (camera index, frame index). Depth and motion are estimated for groups of frames, so that results for further
    /// frames may be stored too. `progress` is called with the number of stored frames, which may exceed the length of
    /// the list.
    ///
    /// # Errors
    /// [`RenderError::NoPoints`] if the range of the scene's depths is unknown, and the errors of [`Self::prepare`].
    pub fn prepare_frames(
        &self,
        frames: &[(usize, usize)],
        options: &RenderOptions,
        progress: impl Fn(usize) + Sync,
    ) -> Result<(), RenderError> {
        let (slots, options) = (Slots::new(self), FlowOptions::new(options));
        let needed: BTreeSet<Slot> = frames.iter().map(|&frame| slots.of(frame)).collect();
        let needed: Vec<Slot> = needed.into_iter().collect();
        let mut done = 0;
        store_slots(&slots, &needed, options, |stored| {
            if stored.is_empty() {
                return Err(RenderError::NoPoints);
            }
            done += stored.len();
            progress(done);
            Ok(())
        })
    }

    /// Returns the given frames with their depth and motion. Cached results are read from memory or disk, and missing
    /// results are computed. A frame is (camera index, frame index).
    ///
    /// # Errors
    /// [`RenderError::NoPoints`] if the range of the scene's depths is unknown, and [`RenderError::Capture`]
    /// if a frame can't be read.
    pub fn frames_with_flow(
        &self,
        frames: &[(usize, usize)],
        options: &RenderOptions,
    ) -> Result<Vec<LoadedFrame>, RenderError> {
        let options = FlowOptions::new(options);
        load(self, frames, options, &Context::unattended())?.ok_or(RenderError::NoPoints)
    }
}

/// Returns the index of the frame into which frame `nearest` of a camera fades at `time_s`, if it does. `times_s` are the times
/// of the camera's frames, ascending; `nearest` is the nearest to `time_s`.
fn fades_into(times_s: &[f64], nearest: usize, time_s: f64) -> Option<usize> {
    let own_s = times_s[nearest];
    let other = if time_s >= own_s { nearest + 1 } else { nearest.checked_sub(1)? };
    (fading(time_s - own_s, times_s.get(other)? - own_s) < 1.0).then_some(other)
}

#[cfg(test)]
mod tests {
    use super::fades_into;

    #[test]
    fn a_frame_fades_into_the_one_on_the_other_side_of_the_instant_around_their_middle() {
        let times_s = [1.0, 2.0, 4.0];
        for (nearest, time_s, expected) in [
            (1, 2.0, None),
            (1, 1.61, None),
            (1, 1.59, Some(0)),
            (0, 1.41, Some(1)),
            (0, 1.39, None),
            (1, 2.79, None),
            (1, 2.81, Some(2)),
            (2, 3.19, Some(1)),
            (0, 0.1, None),
            (2, 9.0, None),
        ] {
            assert_eq!(fades_into(&times_s, nearest, time_s), expected, "{time_s}");
        }
        assert_eq!(fades_into(&[3.0, 3.0], 0, 3.0), None, "frames of one time");
    }
}
