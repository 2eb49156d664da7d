//! Registered frame pairs (§4), each registered when it is first asked for.

use super::{LightField, RenderError};
use crate::capture::CaptureError;
use crate::interpolation::{FramePair, InterpolationOptions, PairCosts, Triangles, largest_change};
use crate::registration::{Track, Verdict, epipolar_test, temporal_flow};
use rayon::prelude::*;
use std::sync::Arc;

/// How many tracks are cached, those of all frame pairs together: 32 MB of them, several pairs of
/// each camera of a rig. More only saves registering again.
pub(super) const MAX_CACHED_TRACKS: usize = (32 << 20) / size_of::<Track>();

/// How many triangles are cached: those of as many tracks, about four each in the two frames together. More only saves
/// triangulating again; fewer: pairs whose tracks are cached are triangulated for every view.
pub(super) const MAX_CACHED_TRIANGLES: usize = 4 * MAX_CACHED_TRACKS;

/// Of how many frame pairs the change is cached. More only saves comparing two frames again.
pub(super) const MAX_CACHED_CHANGES: usize = 1 << 16;

/// How much memory the costs take that refinement has of frame pairs, bytes: about 30 pairs of 1500 tracks. More only
/// saves computing them again; fewer: several cameras' pairs take turns.
pub(super) const MAX_CACHED_COST_BYTES: usize = 32 << 20;

/// All that [`LightField::pair_costs`] depends on, besides what the light field was opened with.
#[derive(Clone, PartialEq, Eq, Hash)]
pub(super) struct PairCostsKey {
    pair: (usize, usize),
    /// The options, bit by bit.
    options: [u64; 6],
}

impl PairCostsKey {
    fn new(
        pair: (usize, usize),
        InterpolationOptions { curved, refine, .. }: &InterpolationOptions,
    ) -> Self {
        let options = [
            u64::from(*curved),
            refine.window_radius_px as u64,
            refine.search_radius_px.to_bits(),
            refine.same_motion_px.to_bits(),
            refine.min_tracks as u64,
            refine.max_motions as u64,
        ];
        Self { pair, options }
    }
}

impl LightField {
    /// The tracks between frames `k` and `k + 1` of a camera that the epipolar test leaves.
    pub fn tracks(&self, camera: usize, k: usize) -> Result<Arc<Vec<Track>>, CaptureError> {
        if let Some(tracks) = self.tracks.get(&(camera, k)) {
            return Ok(tracks);
        }
        if let Some(tracks) = self.store().and_then(|store| store.load((camera, k))) {
            let tracks = Arc::new(tracks);
            self.tracks.insert((camera, k), tracks.clone(), tracks.len());
            return Ok(tracks);
        }
        let mut tracks = temporal_flow(self.frames(), camera, k)?;
        if self.frames.options().epipolar_test {
            let verdicts = epipolar_test(self.frames(), &self.times_s, camera, k, &tracks)?;
            let mut verdicts = verdicts.into_iter();
            tracks.retain(|_| verdicts.next() != Some(Verdict::Rejected));
        }
        let tracks = Arc::new(tracks);
        self.tracks.insert((camera, k), tracks.clone(), tracks.len());
        Ok(tracks)
    }

    /// The triangles of [`Self::tracks`], for frames of this size in pixels.
    pub(super) fn triangles(
        &self,
        (camera, k): (usize, usize),
        tracks: &[Track],
        [width, height]: [usize; 2],
    ) -> Arc<Triangles> {
        if let Some(triangles) = self.triangles.get(&(camera, k)) {
            return triangles;
        }
        let triangles = Arc::new(Triangles::new(tracks, width, height));
        self.triangles.insert((camera, k), triangles.clone(), triangles.count());
        triangles
    }

    /// The costs of [`FramePair::pair_costs`], of the frames `k` and `k + 1` of a camera.
    pub(super) fn pair_costs(
        &self,
        (camera, k): (usize, usize),
        pair: &FramePair,
        options: &InterpolationOptions,
    ) -> Arc<PairCosts> {
        let key = PairCostsKey::new((camera, k), options);
        if let Some(costs) = self.pair_costs.get(&key) {
            return costs;
        }
        let costs = Arc::new(pair.pair_costs(options));
        self.pair_costs.insert(key, costs.clone(), costs.bytes());
        costs
    }

    /// Whether the frame pair of `k` and `k + 1` goes without registration, because none of its
    /// blocks changes by more than `still_change` ([`crate::interpolation::InterpolationOptions`]).
    pub(crate) fn is_still(
        &self,
        camera: usize,
        k: usize,
        still_change: f32,
    ) -> Result<bool, CaptureError> {
        if let Some(change) = self.changes.get(&(camera, k)) {
            return Ok(change <= still_change);
        }
        let [earlier, later] = [self.frames().get(camera, k)?, self.frames().get(camera, k + 1)?];
        let change = largest_change(&earlier.image, &later.image);
        self.changes.insert((camera, k), change, 1);
        Ok(change <= still_change)
    }

    /// Registers the frames around a time, of all cameras that have some: views at all instants between
    /// them use the same tracks.
    pub(crate) fn register(&self, time_s: f64, still_change: f32) -> Result<(), RenderError> {
        self.usable(time_s).into_par_iter().try_for_each(|camera| {
            let (k, later) = self.bracket(camera, time_s)?;
            if k != later && !self.is_still(camera, k, still_change)? {
                self.tracks(camera, k)?;
            }
            Ok(())
        })
    }
}
