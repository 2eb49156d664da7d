//! Temporal interpolation (§5): a camera's image at an instant between its frames.

use super::frame_pair::is_still;
use super::graph::{LightField, Stage};
use super::stages::{
    CameraImage, CameraImages, CorrectedImage, GivenImages, ImageMethod, ImageSource, Images,
    Instant, PairTracks, PairTriangles, RefinementCosts, with_image,
};
use super::{Context, RenderError};
use crate::host::on_workers;
use crate::interpolation::{
    FramePair, PairCosts, PairMethod, SyncMethod, Synchronized, TrackedPair,
};
use crate::options::RenderOptions;
use crate::raster::Tiles;
use rayon::prelude::*;
use std::sync::Arc;

impl Stage for CameraImage<'_> {
    type Output = Synchronized;
    const NAME: &'static str = "camera image";

    fn bytes(image: &Synchronized) -> usize {
        size_of_val(image.image.data())
            + image.interpolation_error_px.as_deref().map_or(0, size_of_val)
    }
}

impl CameraImage<'_> {
    pub fn get(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Arc<Synchronized>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        Ok(field.insert(self, image_in(field, self, None, context)?))
    }
}

impl Stage for CorrectedImage<'_> {
    type Output = Synchronized;
    const NAME: &'static str = "corrected image";

    fn bytes(image: &Synchronized) -> usize {
        CameraImage::bytes(image)
    }
}

impl CorrectedImage<'_> {
    pub fn get(
        &self,
        field: &LightField,
        context: &Context,
    ) -> Result<Arc<Synchronized>, RenderError> {
        let gains = field.gains(self.registration);
        if gains.are_equal() {
            return self.image.get(field, context);
        }
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let filmed = self.image.get(field, context)?;
        let CameraImage { camera, time_s, .. } = self.image;
        let own_s = field.own_time_s(camera, time_s);
        let image = gains.corrected(camera, own_s, &filmed.image);
        let image = image.map(|image| Arc::new(with_image(&filmed, image)));
        Ok(field.insert(self, image.unwrap_or(filmed)))
    }
}

impl Stage for RefinementCosts<'_> {
    type Output = PairCosts;
    const NAME: &'static str = "refinement costs";

    fn bytes(costs: &PairCosts) -> usize {
        costs.bytes()
    }
}

impl RefinementCosts<'_> {
    fn get(&self, field: &LightField) -> Result<Arc<PairCosts>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let PairTracks { camera, frame: index, .. } = self.tracks;
        let tracks = self.tracks.get(field)?;
        let times = field.frame_times(camera);
        let tracked = TrackedPair { tracks: &tracks, times, index };
        let camera = &field.capture().cameras[camera].camera;
        let size = [camera.width, camera.height];
        Ok(field.insert(self, PairCosts::new(&tracked, size, self.interpolation)))
    }
}

/// Computes a camera's image at an instant, with the exposure that the camera has at this instant. If tiles are given
/// as `parts`, only the pixels in these tiles are valid; other pixels may be wrong or black.
pub(super) fn image_in(
    field: &LightField,
    image: &CameraImage,
    parts: Option<&Tiles>,
    context: &Context,
) -> Result<Synchronized, RenderError> {
    let &CameraImage { camera, time_s, method } = image;
    let (frame, later) = field.bracket(camera, time_s)?;
    let registration = &method.registration;
    let frames = field.frames(registration);
    if frame == later {
        return Ok(Synchronized::filmed(frames.get(camera, frame)?.image.clone()));
    }
    let own_s = field.own_time_s(camera, time_s);
    let exposed_now = |index: usize| frames.get_exposed_at(camera, index, own_s);
    let interpolation = method.interpolation.clone().unwrap_or_default();
    if let Some(options) = &method.all_cameras {
        return field.image_from_all_cameras(image, &interpolation, options, context);
    }
    let (earlier_frame, later_frame) = (exposed_now(frame)?, exposed_now(later)?);
    let pair_tracks = PairTracks { camera, frame, registration };
    let follows_motion = method.interpolation.is_some()
        && !is_still(field, pair_tracks, interpolation.still_change)?;
    let sync = match method.sync {
        sync if follows_motion || !sync.needs_tracks() => sync,
        _ => SyncMethod::Crossfade,
    };
    let tracks = if follows_motion { pair_tracks.get(field)? } else { Arc::default() };
    let times = field.frame_times(camera);
    let pair = FramePair {
        earlier: &earlier_frame,
        later: &later_frame,
        tracked: TrackedPair { tracks: &tracks, times, index: frame },
        parts,
        with_interpolation_error: method.with_error,
    };
    let interpolate = |method: PairMethod| pair.interpolate(time_s, method, &interpolation);
    Ok(match sync {
        SyncMethod::Nearest => interpolate(PairMethod::Nearest),
        SyncMethod::Crossfade => interpolate(PairMethod::Crossfade),
        SyncMethod::Triangulation => {
            let triangles = PairTriangles(pair_tracks).get(field)?;
            interpolate(PairMethod::Triangulation(&triangles))
        }
        SyncMethod::Morph => interpolate(PairMethod::Morph { boosted: false }),
        SyncMethod::EdgeMorph => interpolate(PairMethod::Morph { boosted: true }),
        SyncMethod::Refined | SyncMethod::AllCameras => {
            let triangles = PairTriangles(pair_tracks).get(field)?;
            let costs = RefinementCosts { tracks: pair_tracks, interpolation: &interpolation };
            let costs = costs.get(field)?;
            let outer = |index: Option<usize>| {
                let index = index.filter(|&k| k < times.times_s.len());
                index.map(exposed_now).transpose()
            };
            let (before, after) = (outer(frame.checked_sub(1))?, outer(Some(later + 1))?);
            let around = [before.as_deref(), after.as_deref()];
            interpolate(PairMethod::Refined { triangles: &triangles, costs: &costs, around })
        }
    })
}

impl LightField {
    /// Returns a camera's synchronized image: its image at `time_s`, seconds from the capture's start. If a frame of
    /// the camera has exactly this time, the image is this frame. Otherwise, the image is interpolated.
    ///
    /// # Errors
    /// [`RenderError::CameraTime`] if the time is outside the camera's frames, [`RenderError::CameraClock`] if the
    /// camera's clock is unknown, and [`RenderError::Capture`] if a frame can't be read.
    pub fn synchronized(
        &self,
        camera: usize,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<Arc<Synchronized>, RenderError> {
        let method = ImageMethod::new(options.sync, options);
        let image = CameraImage { camera, time_s, method: &method };
        on_workers(|| image.get(self, &Context::unattended()))
    }

    /// Converts a camera's synchronized image at `time_s`, seconds from the capture's start, to the exposure of the
    /// camera's first frame. Ground-truth images have this exposure, too. Returns `None` if the image already has this
    /// exposure.
    pub(crate) fn exposed_first(
        &self,
        camera: usize,
        time_s: f64,
        image: &Synchronized,
        options: &RenderOptions,
    ) -> Option<Synchronized> {
        let gains = self.gains(&options.registration);
        let first_s = self.capture().cameras[camera].clock.times_s[0];
        let own_s = self.own_time_s(camera, time_s);
        Some(with_image(image, gains.exposed_at(camera, [own_s, first_s], &image.image)?))
    }

    /// Returns the synchronized images of all cameras at `time_s`, seconds from the capture's start. The result has one
    /// element per camera, in the capture's order: `None` if the camera has no image at this time.
    ///
    /// # Errors
    /// [`RenderError::Capture`] if a frame can't be read, and [`RenderError::Stopped`] if `context` stops the
    /// computation.
    pub fn synchronized_all(
        &self,
        time_s: f64,
        options: &RenderOptions,
        context: &Context,
    ) -> Result<Vec<Option<Arc<Synchronized>>>, RenderError> {
        let method = ImageMethod::new(options.sync, options);
        let get =
            |camera: usize| CameraImage { camera, time_s, method: &method }.get(self, context);
        let usable = self.usable(time_s);
        on_workers(|| side_by_side(self, &usable, method.all_cameras.is_some(), context, get))
    }

    /// Returns the synchronized images of all cameras at `time_s` ([`Self::synchronized_all`]), gain-corrected to the
    /// reference camera's exposure.
    ///
    /// # Errors
    /// The errors of [`Self::synchronized_all`]. If no camera has an image at `time_s`: [`RenderError::Time`], or
    /// [`RenderError::NoClock`] if no camera's clock is known.
    pub fn corrected_all(
        &self,
        time_s: f64,
        options: &RenderOptions,
        context: &Context,
    ) -> Result<GivenImages, RenderError> {
        if self.usable(time_s).is_empty() {
            return Err(self.no_camera_at(time_s));
        }
        let source = ImageSource::new(Images::By(options.sync), options);
        let (usable, instant) = (self.usable(time_s), Instant::new(time_s, options));
        // The images are requested twice, so that the memo holds all of them at the end. During the first request,
        // frames of the last cameras may evict images of the first cameras.
        on_workers(|| images_of(self, &source, &usable, instant, context))?;
        let images = on_workers(|| images_of(self, &source, &usable, instant, context))?;
        Ok(GivenImages::corrected(images))
    }

    /// Returns the result of [`Self::corrected_all`] if the synchronized images of all usable cameras are cached. A
    /// camera is usable if it can give an image at `time_s`, seconds from the capture's start. `None` if an image isn't
    /// cached, or if no camera is usable.
    pub(crate) fn cached_instant(
        &self,
        time_s: f64,
        options: &RenderOptions,
    ) -> Option<GivenImages> {
        let method = ImageMethod::new(options.sync, options);
        let image = |camera: usize| CameraImage { camera, time_s, method: &method };
        let usable = self.usable(time_s);
        let are_cached = usable.iter().all(|&c| self.cached(&image(c)).is_some());
        if !are_cached || usable.is_empty() {
            return None;
        }
        self.corrected_all(time_s, options, &Context::unattended()).ok()
    }
}

/// Returns the images of `cameras`, given by index, at an instant. They are gain-corrected to the reference camera's
/// exposure. The result has one element per camera of the capture: `None` for cameras that weren't requested.
pub(super) fn images_of(
    field: &LightField,
    source: &ImageSource,
    cameras: &[usize],
    Instant { time_s, registration, .. }: Instant,
    context: &Context,
) -> Result<CameraImages, RenderError> {
    match source {
        ImageSource::Synchronized(method) => {
            // Gains are computed once here, before threads request them in parallel.
            field.gains(registration);
            let get = |camera: usize| {
                let image = CameraImage { camera, time_s, method };
                CorrectedImage { image, registration }.get(field, context)
            };
            side_by_side(field, cameras, method.all_cameras.is_some(), context, get)
        }
        ImageSource::Given(given) => {
            let gains = field.gains(registration);
            let mut all = vec![None; field.capture().cameras.len()];
            let first_s = |c: usize| field.capture().cameras[c].clock.times_s[0];
            cameras.iter().for_each(|&c| all[c] = given.corrected_of(c, first_s(c), &gains));
            Ok(all)
        }
    }
}

/// Computes the images of the given cameras in parallel, by `get`. If `share_inputs` is true, the first image is
/// computed alone, so that inputs that all images share are computed only once. The result has one element per camera
/// of the capture: `None` for cameras that aren't given.
fn side_by_side(
    field: &LightField,
    cameras: &[usize],
    share_inputs: bool,
    context: &Context,
    get: impl Fn(usize) -> Result<Arc<Synchronized>, RenderError> + Sync,
) -> Result<CameraImages, RenderError> {
    if let Some(&first) = cameras.first().filter(|_| share_inputs) {
        get(first)?;
    }
    let images = cameras.par_iter().map(|&camera| {
        context.check()?;
        Ok((camera, get(camera)?))
    });
    let mut all = vec![None; field.capture().cameras.len()];
    for (camera, image) in images.collect::<Result<Vec<_>, RenderError>>()? {
        all[camera] = Some(image);
    }
    Ok(all)
}
