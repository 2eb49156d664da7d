//! The pipeline (Fig. 2): registration, offsets, synchronized images, the view.

mod check;
pub(crate) mod left_out;
mod options;
mod points;
mod presets;
mod trail;
mod view;

pub use check::OptionError;
pub use options::{ProxyOptions, ProxyRung, RenderOptions};
pub use presets::Preset;
pub use trail::{TrailMode, TrailOptions, Viewpoint};

use crate::camera::Camera;
use crate::capture::{Capture, CaptureError};
use crate::interpolation::{FramePair, Sync, largest_change};
use crate::lumigraph::{Mesh, Plane, Proxy};
use crate::offset::{self, Offsets};
use crate::plan;
use crate::progress::Reporter;
use crate::raster::{Image, Tiles};
use crate::registration::{FrameStore, Gains, Track, Verdict, epipolar_test, temporal_flow};
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A capture's light field, continuous in space and time.
///
/// Times are seconds on the reference camera's clock, from the capture's start
/// ([`Capture::time_origin_s`]).
pub struct LightField {
    frames: FrameStore,
    offsets: Offsets,
    times_s: Vec<Option<Vec<f64>>>,
    options: RenderOptions,
    tracks: Mutex<KeptTracks>,
    /// The largest changes of frame pairs, by camera and earlier frame.
    changes: Mutex<HashMap<(usize, usize), f32>>,
    /// The points triangulated last, which every proxy of a view starts from.
    points: Mutex<Option<KeptPoints>>,
}

struct KeptPoints {
    target: Camera,
    time_s: f64,
    points: Arc<Vec<Point3<f64>>>,
}

type SharedTracks = Arc<Vec<Track>>;

/// Registered frame pairs that were used last.
#[derive(Default)]
struct KeptTracks {
    /// By camera and earlier frame, with when it was last used.
    pairs: HashMap<(usize, usize), (u64, SharedTracks)>,
    count: usize,
    clock: u64,
}

/// Tracks that are kept, of all frame pairs: 32 MB of them, several pairs of each camera of a rig.
const MAX_KEPT_TRACKS: usize = (32 << 20) / size_of::<Track>();

/// Why an image can't be rendered. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("{camera} has no frames around {time_s:?} s: it covers {first_s} to {last_s} s")]
    CameraTime { camera: String, time_s: f64, first_s: f64, last_s: f64 },
    #[error("{camera}'s clock is unknown: {reason}")]
    CameraClock { camera: String, reason: String },
    #[error("no camera has frames around {time_s:?} s: they cover {first_s} to {last_s} s")]
    Time { time_s: f64, first_s: f64, last_s: f64 },
    #[error("no camera of this capture has a known clock")]
    NoClock,
    #[error(
        "no point before this view could be triangulated; the plane proxy with proxy.plane_depth_m focuses by hand"
    )]
    NoPoints,
    #[error("no camera sees any pixel of this view")]
    NothingSeen,
    #[error("rendering was stopped")]
    Stopped,
}

impl LightField {
    pub fn new(capture: Arc<Capture>, offsets: Offsets, options: RenderOptions) -> Self {
        let frames = FrameStore::new(capture, &options.registration);
        Self::with_frames(frames, offsets, options)
    }

    /// With frames that are registered by the same options already.
    pub(crate) fn with_frames(
        frames: FrameStore,
        offsets: Offsets,
        options: RenderOptions,
    ) -> Self {
        let times_s = offsets.common_times_s(frames.capture());
        Self {
            frames,
            offsets,
            times_s,
            options,
            tracks: Mutex::default(),
            changes: Mutex::default(),
            points: Mutex::default(),
        }
    }

    /// With the offsets that the capture needs (known clocks, else those kept in its folder, else
    /// estimated now and kept), and the rungs that it requires, where `options.auto` leaves them to
    /// it. Says which on the reporter.
    pub fn open(
        capture: Arc<Capture>,
        options: RenderOptions,
        reporter: &Reporter,
    ) -> Result<Self, RenderError> {
        if options.auto.any() {
            let (plan, field) = plan::plan(&capture, &options, reporter)?;
            for decision in plan.decisions.iter().filter(|d| ["sync", "proxy"].contains(&d.stage)) {
                let plan::Decision { stage, rung, because, .. } = decision;
                reporter.note(&format!("Auto: {stage} {rung}. {because}"));
            }
            return Ok(field);
        }
        let offsets = offset::known_or_kept_or_estimated(
            &capture,
            &options.offset,
            &options.registration,
            reporter,
        )?;
        Ok(Self::new(capture, offsets, options))
    }

    pub fn capture(&self) -> &Capture {
        self.frames.capture()
    }

    pub fn offsets(&self) -> &Offsets {
        &self.offsets
    }

    pub fn options(&self) -> &RenderOptions {
        &self.options
    }

    /// Other rungs over the same registered frames and offsets.
    pub(crate) fn set_options(&mut self, options: RenderOptions) {
        self.options = options;
    }

    /// The median distance of a camera from its nearest neighbour elsewhere, metres; 0 without one.
    pub(crate) fn spacing_m(&self) -> f64 {
        let centers: Vec<_> = self.capture().cameras.iter().map(|c| c.camera.center()).collect();
        let nearest = |a: &Point3<f64>| {
            let distances = centers.iter().map(|b| (a - b).norm()).filter(|d| *d > 0.0);
            distances.min_by(f64::total_cmp)
        };
        let mut distances: Vec<f64> = centers.iter().filter_map(nearest).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().unwrap_or(0.0)
    }

    /// How much more light each camera records than the reference.
    pub fn gains(&self) -> &Gains {
        self.frames.gains()
    }

    fn frames(&self) -> &FrameStore {
        &self.frames
    }

    /// The cameras that can give an image at a time.
    pub fn usable(&self, time_s: f64) -> Vec<usize> {
        (0..self.times_s.len()).filter(|&c| self.bracket(c, time_s).is_ok()).collect()
    }

    /// The first and the last time at which a camera can give an image.
    pub fn span_s(&self, camera: usize) -> Option<(f64, f64)> {
        let times = self.times_s[camera].as_ref()?;
        Some((*times.first()?, *times.last()?))
    }

    /// The first and the last time at which every camera with a known clock can give an image;
    /// `None` if there is none.
    pub fn common_span_s(&self) -> Option<(f64, f64)> {
        let spans = || (0..self.times_s.len()).filter_map(|c| self.span_s(c));
        let first = spans().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
        let last = spans().map(|s| s.1).fold(f64::INFINITY, f64::min);
        (first.is_finite() && first <= last).then_some((first, last))
    }

    /// A camera's image at a time, by the rung of the options.
    pub fn synchronized(&self, camera: usize, time_s: f64) -> Result<Image, RenderError> {
        self.synchronized_by(self.options.sync, camera, time_s)
    }

    /// A camera's image at a time, by any rung.
    pub fn synchronized_by(
        &self,
        sync: Sync,
        camera: usize,
        time_s: f64,
    ) -> Result<Image, RenderError> {
        self.synchronized_in(sync, camera, time_s, None)
    }

    /// Parts of a camera's image, if not all; the rest is not as good.
    fn synchronized_in(
        &self,
        sync: Sync,
        camera: usize,
        time_s: f64,
        parts: Option<&Tiles>,
    ) -> Result<Image, RenderError> {
        let (k, later) = self.bracket(camera, time_s)?;
        let earlier_frame = self.frames.get(camera, k)?;
        if k == later {
            return Ok(earlier_frame.image.clone());
        }
        let later_frame = self.frames.get(camera, later)?;
        let sync =
            if sync.needs_tracks() && self.skips(camera, k)? { Sync::Crossfade } else { sync };
        let tracks = if sync.needs_tracks() { self.tracks(camera, k)? } else { Arc::default() };
        let around = match sync {
            Sync::Refined => [k.checked_sub(1), Some(later + 1)]
                .map(|n| n.filter(|&n| n < self.times(camera).len())),
            _ => [None, None],
        };
        let [before, after] = around.map(|n| n.map(|n| self.frames.get(camera, n)).transpose());
        let (before, after) = (before?, after?);
        let pair = FramePair {
            around: [before.as_deref(), after.as_deref()],
            earlier: &earlier_frame,
            later: &later_frame,
            tracks: &tracks,
            times_s: self.times(camera),
            index: k,
            parts,
        };
        Ok(pair.interpolate(time_s, sync, &self.options.interpolation))
    }

    /// The images of all cameras at a time, by any rung; `None` for cameras that can't give one.
    pub fn synchronized_all(
        &self,
        sync: Sync,
        time_s: f64,
    ) -> Result<Vec<Option<Image>>, RenderError> {
        (0..self.times_s.len())
            .into_par_iter()
            .map(|c| match self.synchronized_by(sync, c, time_s) {
                Ok(image) => Ok(Some(image)),
                Err(RenderError::CameraTime { .. } | RenderError::CameraClock { .. }) => Ok(None),
                Err(error) => Err(error),
            })
            .collect()
    }

    /// The scene's shape at a time, for one view.
    pub fn proxy(
        &self,
        rung: ProxyRung,
        target: &Camera,
        time_s: f64,
    ) -> Result<Proxy, RenderError> {
        let options = &self.options.proxy;
        if let (ProxyRung::Plane, Some(depth_m)) = (rung, options.plane_depth_m) {
            return Ok(Proxy::Plane(Plane::fronto_parallel(target, depth_m)));
        }
        let points = self.points(target, time_s)?;
        let proxy = match rung {
            ProxyRung::Plane => {
                let weighted: Vec<_> = points.iter().map(|p| (*p, 1.0)).collect();
                Plane::fit(&weighted, target).map(Proxy::Plane)
            }
            ProxyRung::Mesh => Mesh::build(&points, target, &options.mesh).map(Proxy::Mesh),
        };
        // A view of a bare spot, or of a single pixel, has no feature in it, but a depth.
        let around = || Plane::amid(&points, target).map(Proxy::Plane);
        let is_seen = |p| target.project(p).is_some_and(|pixel| target.contains(&pixel));
        proxy.or_else(around).ok_or_else(|| {
            if points.is_empty() || points.iter().any(is_seen) {
                RenderError::NoPoints
            } else {
                RenderError::NothingSeen
            }
        })
    }

    /// [`Self::triangulated`], kept for the next proxy of the same view.
    pub(crate) fn points(
        &self,
        target: &Camera,
        time_s: f64,
    ) -> Result<Arc<Vec<Point3<f64>>>, RenderError> {
        let mut kept = self.points.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = &*kept
            && kept.time_s == time_s
            && kept.target == *target
        {
            return Ok(kept.points.clone());
        }
        let points = Arc::new(self.triangulated(target, time_s)?);
        *kept = Some(KeptPoints { target: target.clone(), time_s, points: points.clone() });
        Ok(points)
    }

    /// How many cameras have a time between two frames, this share of the interval or more from both.
    pub(crate) fn between_frames(&self, time_s: f64, share: f64) -> usize {
        let is_between = |&camera: &usize| {
            let times = self.times(camera);
            self.bracket(camera, time_s).is_ok_and(|(k, later)| {
                let passed = (time_s - times[k]) / (times[later] - times[k]);
                k != later && (share..=1.0 - share).contains(&passed)
            })
        };
        (0..self.times_s.len()).filter(is_between).count()
    }

    /// Forgets the points that the last view left, so that the next one takes as long as a first.
    pub(crate) fn forget_points(&self) {
        *self.points.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Registers the frames around a time, of all cameras that have some: what views between them
    /// share.
    pub(crate) fn register(&self, time_s: f64) -> Result<(), RenderError> {
        self.usable(time_s).into_par_iter().try_for_each(|camera| {
            let (k, later) = self.bracket(camera, time_s)?;
            if k != later && !self.skips(camera, k)? {
                self.tracks(camera, k)?;
            }
            Ok(())
        })
    }

    /// The tracks between frames `k` and `k + 1` of a camera that the epipolar test leaves.
    pub fn tracks(&self, camera: usize, k: usize) -> Result<Arc<Vec<Track>>, CaptureError> {
        if let Some(found) = self.kept().find((camera, k)) {
            return Ok(found);
        }
        let mut tracks = temporal_flow(&self.frames, camera, k)?;
        if self.options.registration.epipolar_test {
            let verdicts = epipolar_test(&self.frames, &self.times_s, camera, k, &tracks)?;
            let mut verdicts = verdicts.into_iter();
            tracks.retain(|_| verdicts.next() != Some(Verdict::Rejected));
        }
        let tracks = Arc::new(tracks);
        self.kept().insert((camera, k), &tracks);
        Ok(tracks)
    }

    /// Whether a frame pair goes without registration, as nothing changes in it.
    pub(crate) fn skips(&self, camera: usize, k: usize) -> Result<bool, CaptureError> {
        let limit = self.options.interpolation.still_change;
        let kept = || self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(change) = kept().get(&(camera, k)) {
            return Ok(*change <= limit);
        }
        let [earlier, later] = [self.frames.get(camera, k)?, self.frames.get(camera, k + 1)?];
        let change = largest_change(&earlier.image, &later.image);
        kept().insert((camera, k), change);
        Ok(change <= limit)
    }

    fn kept(&self) -> MutexGuard<'_, KeptTracks> {
        // Nothing in there panics half-way.
        self.tracks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The camera's frame times on the reference's clock; empty if they are unknown.
    fn times(&self, camera: usize) -> &[f64] {
        self.times_s[camera].as_deref().unwrap_or_default()
    }

    /// The frames on both sides of a time (the same one twice if it is at that very time). A
    /// static light field has its frames at any time, whatever its clocks.
    fn bracket(&self, camera: usize, time_s: f64) -> Result<(usize, usize), RenderError> {
        if self.capture().is_static() {
            return Ok((0, 0));
        }
        let id = || self.capture().cameras[camera].id.clone();
        let Some(times) = &self.times_s[camera] else {
            let reason = self.offsets.cameras[camera].reason.clone().unwrap_or_default();
            return Err(RenderError::CameraClock { camera: id(), reason });
        };
        crate::capture::bracket(times, time_s).ok_or_else(|| {
            let origin_s = self.capture().time_origin_s;
            RenderError::CameraTime {
                camera: id(),
                time_s: time_s + origin_s,
                first_s: times[0] + origin_s,
                last_s: times[times.len() - 1] + origin_s,
            }
        })
    }

    fn no_camera_at(&self, time_s: f64) -> RenderError {
        let origin_s = self.capture().time_origin_s;
        let spans = || (0..self.times_s.len()).filter_map(|c| self.span_s(c));
        let first_s = spans().map(|s| s.0).fold(f64::INFINITY, f64::min);
        let last_s = spans().map(|s| s.1).fold(f64::NEG_INFINITY, f64::max);
        if first_s > last_s {
            return RenderError::NoClock;
        }
        RenderError::Time {
            time_s: time_s + origin_s,
            first_s: first_s + origin_s,
            last_s: last_s + origin_s,
        }
    }
}

impl KeptTracks {
    fn find(&mut self, key: (usize, usize)) -> Option<Arc<Vec<Track>>> {
        self.clock += 1;
        let (used, tracks) = self.pairs.get_mut(&key)?;
        *used = self.clock;
        Some(tracks.clone())
    }

    fn insert(&mut self, key: (usize, usize), tracks: &Arc<Vec<Track>>) {
        self.clock += 1;
        self.count += tracks.len();
        if let Some((_, same)) = self.pairs.insert(key, (self.clock, tracks.clone())) {
            self.count -= same.len();
        }
        while self.count > MAX_KEPT_TRACKS && self.pairs.len() > 1 {
            let oldest = self.pairs.iter().min_by_key(|(_, (used, _))| *used).map(|(k, _)| *k);
            if let Some((_, tracks)) = oldest.and_then(|key| self.pairs.remove(&key)) {
                self.count -= tracks.len();
            }
        }
    }
}
