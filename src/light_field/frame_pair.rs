//! Computes how much two successive frames of a camera differ, and the feature tracks between them (§4 of the paper).

use super::RenderError;
use super::graph::{LightField, Stage, StoredStage};
use super::stages::{FrameChange, PairTracks, PairTriangles};
use crate::host::CacheKind;
use crate::interpolation::{Triangles, largest_change};
use crate::options::RenderOptions;
use crate::registration::{RegistrationOptions, Track, Verdict, epipolar_check, temporal_flow};
use rayon::prelude::*;
use std::sync::Arc;

impl Stage for FrameChange<'_> {
    type Output = f32;
    const NAME: &'static str = "change";

    fn bytes(_: &f32) -> usize {
        size_of::<f32>()
    }
}

impl FrameChange<'_> {
    fn get(&self, field: &LightField) -> Result<Arc<f32>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let PairTracks { camera, frame, registration } = self.0;
        let frames = field.frames(registration);
        let earlier_s = field.capture().cameras[camera].clock.times_s[frame];
        let earlier = frames.get(camera, frame)?;
        let later = frames.get_exposed_at(camera, frame + 1, earlier_s)?;
        Ok(field.insert(self, largest_change(&earlier.image, &later.image)))
    }
}

impl Stage for PairTracks<'_> {
    type Output = Vec<Track>;
    const NAME: &'static str = "tracks";

    fn bytes(tracks: &Vec<Track>) -> usize {
        size_of_val(tracks.as_slice())
    }
}

impl PairTracks<'_> {
    pub fn get(&self, field: &LightField) -> Result<Arc<Vec<Track>>, RenderError> {
        if let Some(found) = field.found(self) {
            return Ok(found);
        }
        let frames = field.frames(self.registration);
        let mut tracks = temporal_flow(&frames, self.camera, self.frame)?;
        if self.registration.epipolar_test {
            let times_s = &field.all_times_s;
            let verdicts = epipolar_check(&frames, times_s, self.camera, self.frame, &tracks)?;
            let mut verdicts = verdicts.into_iter();
            tracks.retain(|_| verdicts.next() != Some(Verdict::Rejected));
        }
        Ok(field.insert(self, tracks))
    }
}

impl StoredStage for PairTracks<'_> {
    const KIND: CacheKind = CacheKind { name: "tracks", version: 2 };
}

impl Stage for PairTriangles<'_> {
    type Output = Triangles;
    const NAME: &'static str = "triangles";

    fn bytes(triangles: &Triangles) -> usize {
        triangles.0.iter().map(|triangles| size_of_val(&triangles[..])).sum()
    }
}

impl PairTriangles<'_> {
    pub fn get(&self, field: &LightField) -> Result<Arc<Triangles>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let tracks = self.0.get(field)?;
        let camera = &field.capture().cameras[self.0.camera].camera;
        Ok(field.insert(self, Triangles::new(&tracks, camera.width, camera.height)))
    }
}

impl LightField {
    /// Returns the feature tracks between the frames `frame` and `frame + 1` of a camera. If the options ask for the
    /// epipolar test, tracks that contradict the epipolar geometry with other cameras are removed.
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read.
    pub fn tracks(
        &self,
        camera: usize,
        frame: usize,
        registration: &RegistrationOptions,
    ) -> Result<Arc<Vec<Track>>, RenderError> {
        PairTracks { camera, frame, registration }.get(self)
    }

    /// Tracks features between the two frames of each camera around `time_s`, seconds from the capture's start, and
    /// caches the tracks. Skipped are cameras without frames around this time, and frame pairs in which nothing moves.
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read.
    pub fn register(&self, time_s: f64, options: &RenderOptions) -> Result<(), RenderError> {
        self.usable(time_s).into_par_iter().try_for_each(|camera| {
            let (frame, later) = self.bracket(camera, time_s)?;
            let tracks = PairTracks { camera, frame, registration: &options.registration };
            if frame != later && !is_still(self, tracks, options.interpolation.still_change)? {
                tracks.get(self)?;
            }
            Ok(())
        })
    }
}

/// Returns whether a pair of successive frames is static and needs no registration. This is the case if the mean
/// absolute difference between the two frames is at most `still_change` in every 8×8 block of pixels (an option of
/// [`crate::interpolation::InterpolationOptions`]).
pub(super) fn is_still(
    field: &LightField,
    tracks: PairTracks,
    still_change: f32,
) -> Result<bool, RenderError> {
    Ok(*FrameChange(tracks).get(field)? <= still_change)
}
