//! A camera's image at an instant at which it took none (§5).

use super::{LightField, RenderError};
use crate::host::on_workers;
use crate::interpolation::{FramePair, SyncMethod, Synchronized};
use crate::lumigraph::BlendMethod;
use crate::options::ViewOptions;
use crate::raster::Tiles;
use rayon::prelude::*;
use std::sync::Arc;

impl LightField {
    /// A camera's image at a time: its own frame where it has one at that very time.
    ///
    /// # Errors
    /// [`RenderError::CameraTime`] outside the camera's frames, [`RenderError::CameraClock`] if its
    /// clock is unknown, [`RenderError::Capture`] if a frame can't be read.
    pub fn synchronized(
        &self,
        camera: usize,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Synchronized, RenderError> {
        on_workers(|| self.synchronized_in(camera, time_s, options, None))
    }

    /// The same for some parts of the image, if not all; the rest is less accurate.
    pub(super) fn synchronized_in(
        &self,
        camera: usize,
        time_s: f64,
        options: &ViewOptions,
        parts: Option<&Tiles>,
    ) -> Result<Synchronized, RenderError> {
        let (k, later) = self.bracket(camera, time_s)?;
        let earlier_frame = self.frames().get(camera, k)?;
        if k == later {
            return Ok(Synchronized::filmed(earlier_frame.image.clone()));
        }
        if options.sync == SyncMethod::AllCameras {
            return self.joint(camera, time_s, options);
        }
        let later_frame = self.frames().get(camera, later)?;
        let still_change = options.interpolation.still_change;
        let sync = if options.sync.needs_tracks() && self.is_still(camera, k, still_change)? {
            SyncMethod::Crossfade
        } else {
            options.sync
        };
        let tracks = if sync.needs_tracks() { self.tracks(camera, k)? } else { Arc::default() };
        let around = match sync {
            SyncMethod::Refined => [k.checked_sub(1), Some(later + 1)]
                .map(|n| n.filter(|&n| n < self.times(camera).len())),
            _ => [None, None],
        };
        let [before, after] = around.map(|n| n.map(|n| self.frames().get(camera, n)).transpose());
        let (before, after) = (before?, after?);
        let size = [earlier_frame.image.width(), earlier_frame.image.height()];
        let triangles = matches!(sync, SyncMethod::Triangulation | SyncMethod::Refined)
            .then(|| self.triangles((camera, k), &tracks, size));
        let mut pair = FramePair {
            around: [before.as_deref(), after.as_deref()],
            earlier: &earlier_frame,
            later: &later_frame,
            tracks: &tracks,
            triangles: triangles.as_deref(),
            pair_costs: None,
            times_s: self.times(camera),
            index: k,
            parts,
            with_interpolation_error: options.blend.method == BlendMethod::SpaceTime,
        };
        let costs = (sync == SyncMethod::Refined)
            .then(|| self.pair_costs((camera, k), &pair, &options.interpolation));
        pair.pair_costs = costs.as_deref();
        Ok(pair.interpolate(time_s, sync, &options.interpolation))
    }

    /// The images of all cameras at a time, in the capture's order; `None` for cameras that can't
    /// give one.
    pub fn synchronized_all(
        &self,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Vec<Option<Synchronized>>, RenderError> {
        on_workers(|| self.synchronized_all_while(time_s, options, &|| true))
    }

    /// The same, as long as `proceed` says so, which is asked before every image; else
    /// [`RenderError::Stopped`].
    pub(super) fn synchronized_all_while(
        &self,
        time_s: f64,
        options: &ViewOptions,
        proceed: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<Option<Synchronized>>, RenderError> {
        self.share_joint(&self.usable(time_s), time_s, options)?;
        (0..self.times_s.len())
            .into_par_iter()
            .map(|c| {
                if !proceed() {
                    return Err(RenderError::Stopped);
                }
                match self.synchronized(c, time_s, options) {
                    Ok(image) => Ok(Some(image)),
                    Err(RenderError::CameraTime { .. } | RenderError::CameraClock { .. }) => {
                        Ok(None)
                    }
                    Err(error) => Err(error),
                }
            })
            .collect()
    }
}
