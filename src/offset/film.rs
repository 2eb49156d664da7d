//! What pairs are estimated from: frames, tracks and times, and the samples of three frames.

use super::candidates::ThreeFrames;
use super::features;
use super::timeline::Timelines;
use super::{OffsetMethod, OffsetOptions};
use crate::capture::CaptureError;
use crate::registration::{FrameStore, Track, flow, temporal_flow_of};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// One feature's candidate: at `time_a_s` on camera a's clock it was where camera b's image has
/// it, which was taken at `time_b_s` on b's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    pub cameras: [usize; 2],
    pub time_a_s: f64,
    pub time_b_s: f64,
    /// How fast the feature crosses the epipolar line, pixels a second, less where its path is
    /// uncertain.
    pub across_px_s: f64,
    /// Where in camera a's image it is, on a coarse grid: features that lie together err together.
    pub cell: usize,
    /// The same, as fine as the windows that features are followed by: those in one share pixels.
    pub window: usize,
}

impl Sample {
    /// `offset_b − offset_a` as this feature has it, seconds.
    pub fn offset_s(&self) -> f64 {
        self.time_a_s - self.time_b_s
    }
}

/// The samples of three frames, and why there are no more of them.
#[derive(Clone, Debug, Default)]
pub struct Triple {
    pub samples: Vec<Sample>,
    /// Features followed from frame to frame in camera a,
    pub tracks: usize,
    /// and those of them that move, as bodies do, and are seen by camera b.
    pub moving: usize,
    /// Those of them that move across their epipolar lines, whether they cross them or not.
    pub across: usize,
}

/// Cells of an image's grid, across and down.
const CELLS: [f64; 2] = [8.0, 6.0];
/// Features this near to each other are followed by the same pixels: two of the tracker's windows.
/// Larger calls what a small body shows well less certain; smaller believes a corner of one.
const WINDOW_PX: f64 = 24.0;

/// The film as one attempt sees it: the times may hold lost frames that the next one accounts for.
pub struct Film<'a> {
    pub frames: &'a FrameStore,
    pub timelines: Timelines,
    pub options: &'a OffsetOptions,
    tracks: &'a TrackCache,
    triples: Mutex<HashMap<[usize; 2], TriplesByFrames>>,
}

type TriplesByFrames = HashMap<[usize; 2], Arc<Triple>>;

/// Tracks by camera and frame: two pairs of a camera, and two attempts, share them.
#[derive(Default)]
pub struct TrackCache(Mutex<TracksByFrame>);

type TracksByFrame = HashMap<(usize, usize), Arc<Vec<Track>>>;

impl TrackCache {
    /// Found now if they have not been. Two threads may both find them, to the same bits: waiting
    /// for each other they might wait for ever, each inside the other's work.
    pub fn get(
        &self,
        frames: &FrameStore,
        camera: usize,
        k: usize,
        max_features: usize,
    ) -> Result<Arc<Vec<Track>>, CaptureError> {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tracks) = kept().get(&(camera, k)) {
            return Ok(tracks.clone());
        }
        let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
        let corners = earlier.corners(frames.options());
        let chosen = features::changing(&earlier, &later, corners, max_features);
        // §7 starts from the features selected on I_i(t) itself.
        let tracks = Arc::new(temporal_flow_of(frames, camera, k, [&chosen, &[]])?);
        kept().insert((camera, k), tracks.clone());
        Ok(tracks)
    }
}

impl<'a> Film<'a> {
    pub fn new(
        frames: &'a FrameStore,
        timelines: Timelines,
        tracks: &'a TrackCache,
        options: &'a OffsetOptions,
    ) -> Self {
        Self { frames, timelines, options, tracks, triples: Mutex::default() }
    }

    /// The tracks of a camera between frames k and k + 1.
    pub fn track(&self, camera: usize, k: usize) -> Result<Arc<Vec<Track>>, CaptureError> {
        self.tracks.get(self.frames, camera, k, self.options.max_features)
    }

    /// The image of camera b between frames k and k + 1 of camera a, or that near to them that the
    /// path can still be followed, if b's clock is `offset_s` behind a's.
    pub fn between(&self, [a, b]: [usize; 2], k: usize, offset_s: f64) -> Option<usize> {
        let times = &self.timelines.times_s[a];
        let (start, end) = (times[k], times[k + 1]);
        let m = self.timelines.nearest(b, 0.5 * (start + end) - offset_s);
        let time_s = self.timelines.times_s[b][m] + offset_s;
        // Beyond by less than the path can be followed, for a guess that is still rough.
        let slack = 0.5 * (end - start);
        (time_s >= start - slack && time_s <= end + slack).then_some(m)
    }

    /// The samples of frames k and k + 1 of camera a and frame m of camera b.
    pub fn triple(
        &self,
        [a, b]: [usize; 2],
        [k, m]: [usize; 2],
    ) -> Result<Arc<Triple>, CaptureError> {
        let kept = || self.triples.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(triple) = kept().get(&[a, b]).and_then(|of_pair| of_pair.get(&[k, m])) {
            return Ok(triple.clone());
        }
        let triple = Arc::new(self.three_frames([a, b], [k, m])?);
        kept().entry([a, b]).or_default().insert([k, m], triple.clone());
        Ok(triple)
    }

    /// Gives a pair's samples up, those of both directions: a large array's are hundreds of megabytes.
    /// Asked for again they are found again.
    pub fn forget(&self, [a, b]: [usize; 2]) {
        let mut kept = self.triples.lock().unwrap_or_else(PoisonError::into_inner);
        kept.remove(&[a, b]);
        kept.remove(&[b, a]);
    }

    fn three_frames(&self, [a, b]: [usize; 2], [k, m]: [usize; 2]) -> Result<Triple, CaptureError> {
        let cameras = &self.frames.capture().cameras;
        let (source, target) = (self.frames.get(a, k)?, self.frames.get(b, m)?);
        let tracks = self.track(a, k)?;
        let chosen: Vec<&Track> = tracks.iter().collect();
        let times_i = &self.timelines.times_s[a];
        let time_b_s = self.timelines.times_s[b][m];
        // Half-way is nowhere far off while the offset is a guess.
        let starts: Vec<_> =
            chosen.iter().map(|t| (t.earlier, t.earlier + 0.5 * t.motion())).collect();
        let in_b: Vec<_> = flow(&source, &target, &starts, self.frames.options())
            .into_iter()
            .map(|found| found.map(|f| f.target))
            .collect();
        let three = ThreeFrames {
            camera_i: &cameras[a].camera,
            camera_j: &cameras[b].camera,
            times_i,
            index_i: k,
            curved: self.options.method == OffsetMethod::JointCurved,
            min_across_px: self.options.min_across_px,
        };
        let crossings = three.crossings(&chosen, &in_b);
        let samples = crossings
            .iter()
            .filter_map(|(track, candidate)| Some((*track, (*candidate)?)))
            .map(|(track, candidate)| Sample {
                cameras: [a, b],
                time_a_s: times_i[k] + candidate.time_s,
                time_b_s,
                across_px_s: candidate.certain_px_s(),
                cell: self.cell(a, chosen[track]),
                window: self.window(a, chosen[track]),
            })
            .collect();
        let moves = |track: &&Track, seen: &Option<_>| {
            seen.is_some()
                && track.motion().norm() >= self.options.min_across_px
                && three.follows(track)
        };
        let moving = chosen.iter().zip(&in_b).filter(|(track, seen)| moves(track, seen)).count();
        Ok(Triple { samples, tracks: chosen.len(), moving, across: crossings.len() })
    }

    fn cell(&self, camera: usize, track: &Track) -> usize {
        let camera = &self.frames.capture().cameras[camera].camera;
        let share =
            |v: f64, size: usize, cells: f64| (v / size as f64 * cells).clamp(0.0, cells - 1.0);
        let x = share(track.earlier.x, camera.width, CELLS[0]) as usize;
        let y = share(track.earlier.y, camera.height, CELLS[1]) as usize;
        y * CELLS[0] as usize + x
    }

    fn window(&self, camera: usize, track: &Track) -> usize {
        let columns = self.frames.capture().cameras[camera].camera.width as f64 / WINDOW_PX;
        // A feature is inside its image.
        let [x, y] = [track.earlier.x, track.earlier.y].map(|v| (v / WINDOW_PX).max(0.0) as usize);
        y * columns.ceil() as usize + x
    }
}
