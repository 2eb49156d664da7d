//! Preparation of a light field: results that depend only on frames are computed beforehand, and stored on disk for
//! later views. These results are the feature tracks of all pairs of successive frames, and the cameras' exposure
//! gains. For views by scene flow, they include depth and motion of all frames, and the depth of the static background.

use super::RenderError;
use super::frame_pair::is_still;
use super::graph::{LightField, StoredStage};
use super::slots::Slots;
use super::stages::{FlowOptions, FrameFlow, PairTracks, StillDepth};
use super::still_depth::stored_bytes;
use super::stored_slots::store_slots;
use crate::options::{ProxyMethod, RenderOptions};
use crate::registration::{Gains, Track};
use crate::scene_flow::FlowMap;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// Upper bound on the overhead of a stored result on disk, bytes.
const ENTRY_BYTES: usize = 64;

/// Names of the kinds of results that [`LightField::prepare`] stores in a capture's cache on disk.
pub const PREPARED: [&str; 4] =
    [PairTracks::KIND.name, Gains::KIND.name, FrameFlow::KIND.name, StillDepth::KIND.name];

/// Counts and total size of the results that [`LightField::prepare`] has stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Preparation {
    /// Number of pairs of successive frames with motion. The feature tracks of all these pairs are stored.
    pub pairs: usize,
    /// Number of the frame pairs in `pairs` whose tracks were on disk before the preparation.
    pub found: usize,
    /// Number of frames whose depth and motion are stored; 0 unless the options choose scene flow.
    pub maps: usize,
    /// Number of the frames in `maps` whose depth and motion were on disk before the preparation.
    pub maps_found: usize,
    /// Total size of all stored results on disk, bytes.
    pub bytes: u64,
}

impl LightField {
    /// Returns the number of steps of [`Self::prepare`], and an upper bound on the size of its results on disk, bytes.
    /// Each pair of successive frames is a step. If the options choose scene flow, each frame is a further step.
    pub fn preparation_size(&self, options: &RenderOptions) -> (usize, u64) {
        let cameras = self.capture().cameras.len();
        let pairs: usize = (0..cameras).map(|c| self.times_s(c).len().saturating_sub(1)).sum();
        let tracks = 2 * options.registration.max_corners;
        // In a wide array, gains are stored twice: by features, and by scene flow.
        let gains = 2 * (Gains::max_stored_bytes(cameras) + ENTRY_BYTES);
        let mut bytes = pairs * (tracks * size_of::<Track>() + ENTRY_BYTES) + gains;
        let mut steps = pairs;
        if options.proxy.method == ProxyMethod::SceneFlow {
            for (c, filmed) in self.capture().cameras.iter().enumerate() {
                let frames = self.times_s(c).len();
                steps += frames;
                // The static background has a map too.
                bytes += (frames + 1) * FlowMap::max_stored_bytes(&filmed.camera);
            }
        }
        (steps, bytes as u64)
    }

    /// Tracks features in all pairs of successive frames with motion, and stores the tracks on disk. If the options
    /// choose scene flow, depth and motion of all frames are stored too. Results that are on disk already are not
    /// computed again. `progress` is called with the number of finished steps: frame pairs, and then also frames.
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read or a result can't be written.
    pub fn prepare(
        &self,
        options: &RenderOptions,
        progress: impl Fn(usize) + Sync,
    ) -> Result<Preparation, RenderError> {
        let registration = &options.registration;
        let cameras = self.capture().cameras.len();
        let gains_bytes = self.store_gains(registration)?;
        let times = |camera: usize| self.times_s(camera);
        let frames = (0..cameras).map(|c| times(c).len()).max().unwrap_or(0);
        let (done, found) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let (pairs, bytes) = (AtomicUsize::new(0), AtomicU64::new(gains_bytes));
        // Pairs are processed in order of time, so that successive pairs share a decoded frame.
        for frame in 0..frames.saturating_sub(1) {
            (0..cameras).into_par_iter().try_for_each(|camera| {
                if frame + 1 >= times(camera).len() {
                    return Ok(());
                }
                let pair = PairTracks { camera, frame, registration };
                if !is_still(self, pair, options.interpolation.still_change)? {
                    let stored = match self.stored(&pair) {
                        Some(stored) => stored,
                        None => self.store(&pair, &*pair.get(self)?)?,
                    };
                    pairs.fetch_add(1, Ordering::Relaxed);
                    found.fetch_add(usize::from(stored.was_there), Ordering::Relaxed);
                    bytes.fetch_add(stored.bytes, Ordering::Relaxed);
                }
                progress(done.fetch_add(1, Ordering::Relaxed) + 1);
                Ok::<(), RenderError>(())
            })?;
        }
        let [pairs, found, done] = [pairs, found, done].map(AtomicUsize::into_inner);
        let mut prepared =
            Preparation { pairs, found, bytes: bytes.into_inner(), ..Preparation::default() };
        if options.proxy.method == ProxyMethod::SceneFlow {
            self.prepare_maps(options, &mut prepared, |maps| progress(done + maps))?;
        }
        Ok(prepared)
    }

    /// Returns whether [`Self::prepare`] has probably stored depth and motion of all frames. Only frames from the
    /// middle of the recording are looked up on disk. Returns false if there are no frames.
    pub fn has_prepared_maps(&self, options: &RenderOptions) -> bool {
        let (slots, options) = (Slots::new(self), FlowOptions::new(options));
        let all = slots.all();
        let Some(&middle) = all.get(all.len() / 2) else { return false };
        slots
            .frames(middle)
            .iter()
            .all(|&frame| self.stored(&FrameFlow { frame, options }).is_some())
    }

    /// Stores depth and motion of all frames on disk, and counts them in `prepared`. `progress` is called with the
    /// number of finished frames.
    fn prepare_maps(
        &self,
        options: &RenderOptions,
        prepared: &mut Preparation,
        progress: impl Fn(usize) + Sync,
    ) -> Result<(), RenderError> {
        let (slots, options) = (Slots::new(self), FlowOptions::new(options));
        store_slots(&slots, &slots.all(), options, |stored| {
            prepared.maps += stored.len();
            prepared.maps_found += stored.iter().filter(|stored| stored.was_there).count();
            prepared.bytes += stored.iter().map(|stored| stored.bytes).sum::<u64>();
            progress(prepared.maps);
            Ok(())
        })?;
        prepared.bytes += stored_bytes(self, options);
        Ok(())
    }
}
