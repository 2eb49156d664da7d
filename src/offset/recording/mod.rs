//! Recordings of all cameras, with assumed frame times: their frames, the tracks of features, and the features'
//! candidates for the temporal offsets.

mod candidates;
mod features;

pub use candidates::{Candidate, ThreeFrames};

use super::{OffsetMethod, OffsetOptions};
use crate::capture::{CaptureError, Clock};
use crate::host::BoundedCache;
use crate::registration::{FrameStore, Track, flow, temporal_flow_of};
use nalgebra::Point2;
use std::sync::Arc;

/// One feature's candidate for the temporal offset between two cameras, a and b (eq. (10)).
///
/// At `time_a_s` on a's clock, the feature's trajectory in camera a crosses the epipolar line of the feature's position
/// in a frame of camera b. At `time_b_s` on b's clock, camera b exposed the image row of this position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The indices of the two cameras, a and b.
    pub cameras: [usize; 2],
    pub time_a_s: f64,
    pub time_b_s: f64,
    /// The feature's signed speed perpendicular to the epipolar line, pixels per second, reduced if its trajectory is
    /// uncertain ([`Candidate::effective_speed_px_s`]). The square of this speed, divided by the variance of the
    /// residuals in pixels, is the offset candidate's information.
    pub across_px_s: f64,
    /// The index of the cell that contains the feature in a coarse grid over camera a's image. Errors of features in
    /// the same cell are correlated.
    pub cell: usize,
    /// The index of the tile that contains the feature in a fine grid over camera a's image. A tile is about twice as
    /// wide as the tracker's window. Features in the same tile are tracked by nearly the same pixels.
    pub window: usize,
    /// The positions of the feature in the two cameras' images, and its speed.
    pub sight: Sight,
}

/// Positions and speed of a [`Sample`]'s feature in the images of cameras a and b, at the time of b's image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// The feature's position on its trajectory in camera a, undistorted pixels.
    pub ideal_a: Point2<f64>,
    /// The feature's position in camera b's image, pixels.
    pub in_b: Point2<f64>,
    /// The feature's signed speed in camera a, perpendicular to the epipolar line, pixels per second. Unlike
    /// [`Sample::across_px_s`], it is not reduced if the trajectory is uncertain.
    pub across_px_s: f64,
}

impl Sample {
    /// Returns `offset_b − offset_a` according to this feature alone, seconds.
    pub fn offset_s(&self) -> f64 {
        self.time_a_s - self.time_b_s
    }
}

/// Offset candidates of a frame triple (two frames of camera a, one frame of camera b), and the numbers of features at
/// each stage of their selection.
#[derive(Clone, Debug, Default)]
pub struct FrameTriple {
    pub samples: Vec<Sample>,
    /// The number of features tracked between the two frames of the triple's camera a.
    pub tracks: usize,
    /// The number of tracked features that move on a smooth trajectory in camera a and have a correspondence in
    /// camera b.
    pub moving: usize,
    /// The number of features that move across their epipolar lines by at least [`MIN_ACROSS_PX`], with or without an
    /// offset candidate.
    pub across: usize,
}

/// Frame triple as ([a, b], [k, m]): frames k and k + 1 of camera a, and frame m of camera b.
pub type TripleFrames = ([usize; 2], [usize; 2]);

/// The minimum motion of a feature between two successive frames, perpendicular to its epipolar line, that gives an
/// offset candidate, pixels.
const MIN_ACROSS_PX: f64 = 1.0;
/// The numbers of columns and rows of the coarse grid over an image ([`Sample::cell`]).
const CELLS: [f64; 2] = [8.0, 6.0];
/// The side of a tile of the fine grid over an image ([`Sample::window`]), pixels: about twice the width of the
/// tracker's window.
const WINDOW_PX: f64 = 24.0;
/// In a frame triple, the maximum time by which the frame of camera b may lie outside the interval between the two
/// frames of camera a, as a fraction of this interval. Outside the interval, trajectories are extrapolated.
const MAX_OUTSIDE: f64 = 0.5;
/// The maximum number of feature tracks in the cache. They take 256 MB, enough for 30 frames of each of 100 cameras,
/// with 600 features a frame.
const MAX_CACHED_TRACKS: usize = (256 << 20) / size_of::<Track>();
/// The maximum number of offset candidates in the cache. They take 128 MB.
pub const MAX_CACHED_SAMPLES: usize = (128 << 20) / size_of::<Sample>();

/// Recordings of all cameras, with assumed frame times ([`Recording::clocks`]). Feature tracks and offset candidates
/// are computed on demand and cached.
pub struct Recording<'a> {
    pub frames: &'a FrameStore,
    /// The clock of each camera, by camera. Its frame times are the capture's, or are corrected for lost frames.
    pub clocks: Vec<Clock>,
    pub options: &'a OffsetOptions,
    track_cache: &'a TrackCache,
    triples: BoundedCache<TripleFrames, Arc<FrameTriple>>,
}

/// Cache of feature tracks, by (index of the camera, index of the earlier frame). Tracks do not depend on frame times.
/// All camera pairs therefore share the cache, as do [`Recording`]s with other frame times.
pub struct TrackCache(BoundedCache<(usize, usize), Arc<Vec<Track>>>);

impl Default for TrackCache {
    fn default() -> Self {
        Self(BoundedCache::new(MAX_CACHED_TRACKS))
    }
}

impl<'a> Recording<'a> {
    pub fn new(
        frames: &'a FrameStore,
        clocks: Vec<Clock>,
        track_cache: &'a TrackCache,
        options: &'a OffsetOptions,
    ) -> Self {
        let triples = BoundedCache::new(MAX_CACHED_SAMPLES);
        Self { frames, clocks, options, track_cache, triples }
    }

    /// Returns the feature tracks of a camera between frames k and k + 1. Returns an error if a frame cannot be read.
    ///
    /// If two threads request the same tracks at the same time, both may compute them, with equal results. If one
    /// thread waited for the other, the thread pool could deadlock.
    pub fn tracks(&self, camera: usize, k: usize) -> Result<Arc<Vec<Track>>, CaptureError> {
        let TrackCache(cache) = self.track_cache;
        if let Some(tracks) = cache.get(&(camera, k)) {
            return Ok(tracks);
        }
        let (earlier, later) = (self.frames.get(camera, k)?, self.frames.get(camera, k + 1)?);
        let corners = earlier.corners(self.frames.options());
        let selected = features::changing(&earlier, &later, corners, self.options.max_features);
        // As in §7, only features selected in the earlier frame are tracked. There is no backward flow.
        let tracks = Arc::new(temporal_flow_of(self.frames, camera, k, [&selected, &[]])?);
        cache.insert((camera, k), tracks.clone(), tracks.len());
        Ok(tracks)
    }

    /// Returns the index of camera b's image nearest in time to the middle between frames k and k + 1 of camera a,
    /// given `offset_s = offset_b − offset_a`. `None` if this image is outside the interval between the two frames by
    /// more than [`MAX_OUTSIDE`].
    pub fn image_between(&self, [a, b]: [usize; 2], k: usize, offset_s: f64) -> Option<usize> {
        let [times, times_b] = [a, b].map(|c| &self.clocks[c].times_s);
        let (start, end) = (times[k], times[k + 1]);
        let m = self.clocks[b].nearest(0.5 * (start + end) - offset_s);
        let time_s = times_b[m] + offset_s;
        let slack = MAX_OUTSIDE * (end - start);
        (time_s >= start - slack && time_s <= end + slack).then_some(m)
    }

    /// Returns the offset candidates of a frame triple: frames k and k + 1 of camera a and frame m of camera b.
    /// Returns an error if a frame cannot be read.
    pub fn triple(&self, triple: TripleFrames) -> Result<Arc<FrameTriple>, CaptureError> {
        if let Some(cached) = self.triples.get(&triple) {
            return Ok(cached);
        }
        let computed = Arc::new(self.compute_triple(triple)?);
        self.triples.insert(triple, computed.clone(), computed.samples.len());
        Ok(computed)
    }

    /// Returns whether the offset candidates of a frame triple (two frames of one camera, one frame of another) are
    /// cached, and marks them as recently used.
    pub fn has_triple(&self, triple: TripleFrames) -> bool {
        self.triples.get(&triple).is_some()
    }

    /// Removes all offset candidates of a pair of cameras from the cache: those of triples with two frames of a, and
    /// those of triples with two frames of b.
    pub fn release_pair(&self, [a, b]: [usize; 2]) {
        self.triples.retain(|(pair, _)| *pair != [a, b] && *pair != [b, a]);
    }

    fn compute_triple(&self, ([a, b], [k, m]): TripleFrames) -> Result<FrameTriple, CaptureError> {
        let cameras = &self.frames.capture().cameras;
        let (source, target) = (self.frames.get(a, k)?, self.frames.get(b, m)?);
        let all_tracks = self.tracks(a, k)?;
        let [times_i, times_j] = [a, b].map(|c| cameras[c].frame_times(&self.clocks[c].times_s));
        let three_frames = ThreeFrames {
            camera_i: &cameras[a].camera,
            camera_j: &cameras[b].camera,
            times_i,
            index_i: k,
            curved: self.options.method == OffsetMethod::JointCurved,
            min_across_px: MIN_ACROSS_PX,
        };
        // Only these tracks can have a candidate or count as moving.
        let tracks: Vec<&Track> =
            all_tracks.iter().filter(|track| three_frames.can_cross(track)).collect();
        // The middle of the motion in camera a is a good start for the search in any frame of camera b inside the
        // interval.
        let starts: Vec<_> =
            tracks.iter().map(|t| (t.earlier, t.earlier + 0.5 * t.motion())).collect();
        let in_b: Vec<_> = flow(&source, &target, &starts, self.frames.options())
            .into_iter()
            .map(|correspondence| correspondence.map(|f| f.target))
            .collect();
        let crossings = three_frames.crossings(&tracks, &in_b);
        let samples = crossings
            .iter()
            .filter_map(|(track, candidate)| Some((*track, (*candidate)?, in_b[*track]?)))
            .map(|(track, candidate, p_b)| Sample {
                cameras: [a, b],
                time_a_s: times_i.times_s[k] + candidate.time_s,
                time_b_s: times_j.at(m, &p_b),
                across_px_s: candidate.effective_speed_px_s(),
                cell: self.cell(a, tracks[track]),
                window: self.window(a, tracks[track]),
                sight: Sight {
                    ideal_a: candidate.place,
                    // Every candidate has a correspondence, so the default is never used.
                    in_b: in_b[track].unwrap_or_default(),
                    across_px_s: candidate.across_px_s,
                },
            })
            .collect();
        let moves = |track: &&Track, in_b: &Option<_>| {
            in_b.is_some() && track.motion().norm() >= MIN_ACROSS_PX
        };
        let moving = tracks.iter().zip(&in_b).filter(|(track, in_b)| moves(track, in_b)).count();
        Ok(FrameTriple { samples, tracks: all_tracks.len(), moving, across: crossings.len() })
    }

    fn cell(&self, camera: usize, track: &Track) -> usize {
        let camera = &self.frames.capture().cameras[camera].camera;
        let index =
            |v: f64, size: usize, cells: f64| (v / size as f64 * cells).clamp(0.0, cells - 1.0);
        let x = index(track.earlier.x, camera.width, CELLS[0]) as usize;
        let y = index(track.earlier.y, camera.height, CELLS[1]) as usize;
        y * CELLS[0] as usize + x
    }

    fn window(&self, camera: usize, track: &Track) -> usize {
        let columns = self.frames.capture().cameras[camera].camera.width as f64 / WINDOW_PX;
        // Features lie inside the image, so the indices are not negative.
        let [x, y] = [track.earlier.x, track.earlier.y].map(|v| (v / WINDOW_PX).max(0.0) as usize);
        y * columns.ceil() as usize + x
    }
}

/// Returns at most `count` of the integers from 0 to `n` − 1, ascending and evenly spread; all of them if `n` is at
/// most `count`.
pub fn spread(n: usize, count: usize) -> Vec<usize> {
    if n <= count {
        return (0..n).collect();
    }
    (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_evenly() {
        assert_eq!(spread(3, 5), [0, 1, 2]);
        assert_eq!(spread(10, 5), [1, 3, 5, 7, 9]);
        assert!(spread(0, 5).is_empty() && spread(5, 0).is_empty());
    }
}
