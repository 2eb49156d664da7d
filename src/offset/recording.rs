//! What pairs are estimated from: the cameras' frames, tracks and times, and the candidates of
//! frame triples.

use super::candidates::ThreeFrames;
use super::features;
use super::timeline::Timelines;
use super::{OffsetMethod, OffsetOptions};
use crate::capture::CaptureError;
use crate::host::BoundedCache;
use crate::registration::{FrameStore, Track, flow, temporal_flow_of};
use std::sync::Arc;

/// One feature's candidate for the offset of two cameras, a and b (eq. (10)).
///
/// The feature's trajectory in camera a crosses the epipolar line of its image in camera b at
/// `time_a_s` on a's clock; that image was taken at `time_b_s` on b's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The indices of cameras a and b.
    pub cameras: [usize; 2],
    pub time_a_s: f64,
    pub time_b_s: f64,
    /// The feature's signed speed across the epipolar line, pixels a second, reduced where its
    /// trajectory is uncertain. Its square over the residual variance is the candidate's information.
    pub across_px_s: f64,
    /// The cell of a coarse grid over camera a's image: the errors of features in one cell are
    /// correlated.
    pub cell: usize,
    /// The tile of a fine grid over camera a's image, as large as the tracker's windows: features in
    /// one tile are tracked by the same pixels.
    pub window: usize,
}

impl Sample {
    /// `offset_b − offset_a` by this feature alone, seconds.
    pub fn offset_s(&self) -> f64 {
        self.time_a_s - self.time_b_s
    }
}

/// The candidates of a frame triple: two successive frames of camera a, one frame of camera b. The
/// counts tell why there are no more candidates.
#[derive(Clone, Debug, Default)]
pub struct Triple {
    pub samples: Vec<Sample>,
    /// The number of features tracked between the two frames of camera a.
    pub tracks: usize,
    /// The number of tracked features that move, on a smooth trajectory, and have a correspondence
    /// in camera b.
    pub moving: usize,
    /// The number of features that move across their epipolar lines, with a candidate or without.
    pub across: usize,
}

/// The coarse grid's cells across and down. More cells treat correlated errors as independent, so
/// that error bars are too short; fewer leave too few clusters to estimate a variance from.
const CELLS: [f64; 2] = [8.0, 6.0];
/// The fine grid's tiles, pixels: two of the tracker's windows. Larger inflates the error bars of
/// small, well-textured bodies; smaller trusts features that share their pixels.
const WINDOW_PX: f64 = 24.0;
/// How far outside camera a's interval camera b's frame may be while the offset is still rough, as a
/// fraction of the interval. Larger extrapolates trajectories too far; smaller leaves triples out
/// whose frame turns out to be inside.
const MAX_OUTSIDE: f64 = 0.5;

/// The recordings of all cameras under one hypothesis of their clocks. Tracks and candidates are
/// computed on demand and cached.
pub struct Recording<'a> {
    pub frames: &'a FrameStore,
    /// The cameras' times; a later hypothesis accounts for lost frames.
    pub timelines: Timelines,
    pub options: &'a OffsetOptions,
    track_cache: &'a TrackCache,
    triples: BoundedCache<TripleKey, Arc<Triple>>,
}

/// How many tracks are cached, 256 MB of them: those of 100 cameras with 600 features each. Fewer cost
/// time, where tracks are computed again.
const MAX_CACHED_TRACKS: usize = (256 << 20) / size_of::<Track>();
/// How many candidates are cached, 128 MB of them. Fewer cost time, where candidates are computed
/// again.
pub const MAX_CACHED_SAMPLES: usize = (128 << 20) / size_of::<Sample>();

/// The two cameras of a pair, and the frames of a triple.
type TripleKey = ([usize; 2], [usize; 2]);

/// Tracks by camera and earlier frame. All pairs of a camera share them, and all hypotheses of the
/// clocks: tracks do not depend on times. One estimate has one cache, with one number of features.
pub struct TrackCache(BoundedCache<(usize, usize), Arc<Vec<Track>>>);

impl Default for TrackCache {
    fn default() -> Self {
        Self(BoundedCache::new(MAX_CACHED_TRACKS))
    }
}

impl TrackCache {
    /// The tracks of a camera between frames k and k + 1, at most `max_features` of them.
    ///
    /// Two threads that ask at once may both compute them, with equal results: waiting for each
    /// other could deadlock inside the thread pool.
    pub fn get(
        &self,
        frames: &FrameStore,
        camera: usize,
        k: usize,
        max_features: usize,
    ) -> Result<Arc<Vec<Track>>, CaptureError> {
        if let Some(tracks) = self.0.get(&(camera, k)) {
            return Ok(tracks);
        }
        let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
        let corners = earlier.corners(frames.options());
        let selected = features::changing(&earlier, &later, corners, max_features);
        // §7 tracks the features selected on I_i(t) itself, without those of the backward flow.
        let tracks = Arc::new(temporal_flow_of(frames, camera, k, [&selected, &[]])?);
        self.0.insert((camera, k), tracks.clone(), tracks.len());
        Ok(tracks)
    }
}

impl<'a> Recording<'a> {
    pub fn new(
        frames: &'a FrameStore,
        timelines: Timelines,
        track_cache: &'a TrackCache,
        options: &'a OffsetOptions,
    ) -> Self {
        let triples = BoundedCache::new(MAX_CACHED_SAMPLES);
        Self { frames, timelines, options, track_cache, triples }
    }

    /// The tracks of a camera between frames k and k + 1.
    pub fn tracks(&self, camera: usize, k: usize) -> Result<Arc<Vec<Track>>, CaptureError> {
        self.track_cache.get(self.frames, camera, k, self.options.max_features)
    }

    /// The image of camera b nearest to the middle of frames k and k + 1 of camera a, given
    /// `offset_s = offset_b − offset_a`. `None` if it lies outside the interval by more than
    /// trajectories can be extrapolated.
    pub fn image_between(&self, [a, b]: [usize; 2], k: usize, offset_s: f64) -> Option<usize> {
        let times = &self.timelines.times_s[a];
        let (start, end) = (times[k], times[k + 1]);
        let m = self.timelines.nearest(b, 0.5 * (start + end) - offset_s);
        let time_s = self.timelines.times_s[b][m] + offset_s;
        let slack = MAX_OUTSIDE * (end - start);
        (time_s >= start - slack && time_s <= end + slack).then_some(m)
    }

    /// The candidates of frames k and k + 1 of camera a and frame m of camera b.
    pub fn triple(
        &self,
        [a, b]: [usize; 2],
        [k, m]: [usize; 2],
    ) -> Result<Arc<Triple>, CaptureError> {
        if let Some(triple) = self.triples.get(&([a, b], [k, m])) {
            return Ok(triple);
        }
        let triple = Arc::new(self.compute_triple([a, b], [k, m])?);
        self.triples.insert(([a, b], [k, m]), triple.clone(), triple.samples.len());
        Ok(triple)
    }

    /// Whether the candidates of these frames are cached. They count as used.
    pub fn has_triple(&self, cameras: [usize; 2], frames: [usize; 2]) -> bool {
        self.triples.get(&(cameras, frames)).is_some()
    }

    /// Drops the cached candidates of a pair, in both directions: those of a large array take
    /// hundreds of megabytes.
    pub fn release_pair(&self, [a, b]: [usize; 2]) {
        self.triples.retain(|(pair, _)| *pair != [a, b] && *pair != [b, a]);
    }

    fn compute_triple(
        &self,
        [a, b]: [usize; 2],
        [k, m]: [usize; 2],
    ) -> Result<Triple, CaptureError> {
        let cameras = &self.frames.capture().cameras;
        let (source, target) = (self.frames.get(a, k)?, self.frames.get(b, m)?);
        let all_tracks = self.tracks(a, k)?;
        let times_i = &self.timelines.times_s[a];
        let time_b_s = self.timelines.times_s[b][m];
        let three_frames = ThreeFrames {
            camera_i: &cameras[a].camera,
            camera_j: &cameras[b].camera,
            times_i,
            index_i: k,
            curved: self.options.method == OffsetMethod::JointCurved,
            min_across_px: self.options.min_across_px,
        };
        // The others have no candidate and don't count as moving, whatever camera b shows.
        let tracks: Vec<&Track> =
            all_tracks.iter().filter(|track| three_frames.can_cross(track)).collect();
        // The middle of the motion is a good start for any frame of b inside the interval.
        let starts: Vec<_> =
            tracks.iter().map(|t| (t.earlier, t.earlier + 0.5 * t.motion())).collect();
        let in_b: Vec<_> = flow(&source, &target, &starts, self.frames.options())
            .into_iter()
            .map(|correspondence| correspondence.map(|f| f.target))
            .collect();
        let crossings = three_frames.crossings(&tracks, &in_b);
        let samples = crossings
            .iter()
            .filter_map(|(track, candidate)| Some((*track, (*candidate)?)))
            .map(|(track, candidate)| Sample {
                cameras: [a, b],
                time_a_s: times_i[k] + candidate.time_s,
                time_b_s,
                across_px_s: candidate.effective_speed_px_s(),
                cell: self.cell(a, tracks[track]),
                window: self.window(a, tracks[track]),
            })
            .collect();
        let moves = |track: &&Track, in_b: &Option<_>| {
            in_b.is_some() && track.motion().norm() >= self.options.min_across_px
        };
        let moving = tracks.iter().zip(&in_b).filter(|(track, in_b)| moves(track, in_b)).count();
        Ok(Triple { samples, tracks: all_tracks.len(), moving, across: crossings.len() })
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
