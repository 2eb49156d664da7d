//! The inputs of every stage. A stage's result depends only on its inputs and on the capture's frames and
//! clocks. The keys of the memo, the cache in memory, are the serialized inputs.

use super::graph::{LightField, Stage};
use super::slots::FrameId;
use crate::interpolation::{InterpolationOptions, SyncMethod, Synchronized};
use crate::lumigraph::{BlendMethod, BlendOptions};
use crate::options::{ProxyOptions, RenderOptions};
use crate::raster::Image;
use crate::registration::{Gains, RegistrationOptions};
use crate::scene_flow::MappedFrame;
use serde::{Serialize, Serializer};
use std::sync::{Arc, OnceLock};

/// The tracks between the frames `frame` and `frame + 1` of a camera, without those that fail the epipolar
/// test.
#[derive(Clone, Copy, Serialize)]
pub(super) struct PairTracks<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// The largest mean absolute difference of any 8×8 block between the two frames of a pair, for pixel values of 0 to
/// 1.
#[derive(Serialize)]
pub(super) struct FrameChange<'a>(pub PairTracks<'a>);

/// The triangulation of a pair's tracks.
#[derive(Serialize)]
pub(super) struct PairTriangles<'a>(pub PairTracks<'a>);

/// The costs of refinement that depend only on a frame pair, not on the instant.
#[derive(Serialize)]
pub(super) struct RefinementCosts<'a> {
    pub tracks: PairTracks<'a>,
    pub interpolation: &'a InterpolationOptions,
}

/// A camera's image at an instant.
#[derive(Clone, Copy, Serialize)]
pub(super) struct CameraImage<'a> {
    pub camera: usize,
    pub time_s: f64,
    pub method: &'a ImageMethod,
}

/// A camera's image at an instant, gain-corrected to the reference camera's exposure.
#[derive(Serialize)]
pub(super) struct CorrectedImage<'a> {
    pub image: CameraImage<'a>,
    pub registration: &'a RegistrationOptions,
}

/// The options that a camera's image at an instant depends on.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ImageMethod {
    pub sync: SyncMethod,
    pub registration: RegistrationOptions,
    /// `None` for the methods without motion.
    pub interpolation: Option<InterpolationOptions>,
    /// Whether the interpolation error is computed too.
    pub with_error: bool,
    /// Options of [`SyncMethod::AllCameras`]; `None` for other methods.
    pub all_cameras: Option<AllCamerasOptions>,
}

/// Options of the views that [`SyncMethod::AllCameras`] blends a camera's image with.
#[derive(Clone, Debug, Serialize)]
pub(super) struct AllCamerasOptions {
    pub proxy: ProxyOptions,
    pub blend: BlendOptions,
}

/// An instant, with the options by which the frames around it are registered or recognized as static.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Instant<'a> {
    pub time_s: f64,
    pub registration: &'a RegistrationOptions,
    pub still_change: f32,
}

impl<'a> Instant<'a> {
    pub fn new(time_s: f64, options: &'a RenderOptions) -> Self {
        let still_change = options.interpolation.still_change;
        Self { time_s, registration: &options.registration, still_change }
    }
}

impl ImageMethod {
    pub fn new(sync: SyncMethod, options: &RenderOptions) -> Self {
        let RenderOptions { registration, interpolation, proxy, blend, .. } = options.clone();
        let follows_motion = sync.needs_tracks();
        // Refinement computes the interpolation error in any case. With this flag always set, images are shared by
        // views whose weights depend on the error and views whose weights don't.
        let with_error =
            sync == SyncMethod::Refined || follows_motion && blend.method == BlendMethod::SpaceTime;
        let all_cameras =
            (sync == SyncMethod::AllCameras).then_some(AllCamerasOptions { proxy, blend });
        let interpolation = follows_motion.then_some(interpolation);
        Self { sync, registration, interpolation, with_error, all_cameras }
    }
}

/// The source of the cameras' images at an instant.
#[derive(Clone, Copy, Debug)]
pub enum Images<'a> {
    /// Synchronized by this method from the capture's frames.
    By(SyncMethod),
    /// Given images, such as true ones.
    Given(&'a GivenImages),
}

/// One image for each camera, in the capture's order; `None` if the camera has none.
pub(super) type CameraImages = Vec<Option<Arc<Synchronized>>>;

/// Images of the cameras that are given by the caller and not synchronized from the capture, such as true
/// images.
#[derive(Debug)]
pub struct GivenImages {
    images: CameraImages,
    /// Whether the images are gain-corrected to the reference camera's exposure.
    are_corrected: bool,
    hash: OnceLock<String>,
}

impl GivenImages {
    /// Images with each camera's own exposure, that of its first frame: one for each camera, in the capture's order;
    /// `None` if the camera has none.
    pub fn filmed(images: Vec<Option<Arc<Synchronized>>>) -> Self {
        Self { images, are_corrected: false, hash: OnceLock::new() }
    }

    /// Images that are gain-corrected to the reference camera's exposure: one for each camera, in the
    /// capture's order.
    pub fn corrected(images: Vec<Option<Arc<Synchronized>>>) -> Self {
        Self { images, are_corrected: true, hash: OnceLock::new() }
    }

    /// Replaces each camera's image by a uniform colour: RGB of 0 to 1, in the capture's order. Interpolation errors
    /// stay. A view of the result shows the blending weights: a pixel is the weighted mean of the cameras' colours.
    ///
    /// # Panics
    /// If there are fewer colours than cameras.
    pub fn with_colors(&self, colors: &[[f32; 3]]) -> Self {
        assert!(colors.len() >= self.images.len(), "a colour for each camera");
        let tinted = |(image, color): (&Option<Arc<Synchronized>>, &[f32; 3])| {
            let given = image.as_deref()?;
            let (width, height) = (given.image.width(), given.image.height());
            let image = Image::from_data(width, height, 3, color.repeat(width * height));
            Some(Arc::new(with_image(given, image)))
        };
        Self::corrected(self.images.iter().zip(colors).map(tinted).collect())
    }

    /// One image for each camera, in the capture's order.
    pub fn all(&self) -> &[Option<Arc<Synchronized>>] {
        &self.images
    }

    /// A camera's image, gain-corrected to the reference camera's exposure. `first_s` is the time of the camera's first
    /// frame on its own clock, seconds.
    pub(super) fn corrected_of(
        &self,
        camera: usize,
        first_s: f64,
        gains: &Gains,
    ) -> Option<Arc<Synchronized>> {
        let given = self.images.get(camera)?.as_ref()?;
        let image = gains.corrected(camera, first_s, &given.image).filter(|_| !self.are_corrected);
        Some(image.map_or_else(|| given.clone(), |image| Arc::new(with_image(given, image))))
    }

    fn hash(&self) -> &str {
        self.hash.get_or_init(|| {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&[u8::from(self.are_corrected)]);
            for image in &self.images {
                hasher.update(&[u8::from(image.is_some())]);
                let data = image.iter().flat_map(|s| s.image.data());
                hasher.update(&data.flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
            }
            hasher.finalize().to_hex().to_string()
        })
    }
}

impl Serialize for GivenImages {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.hash())
    }
}

/// `image` with the interpolation errors of `of`.
pub(super) fn with_image(of: &Synchronized, image: Image) -> Synchronized {
    Synchronized { image, interpolation_error_px: of.interpolation_error_px.clone() }
}

/// The source of the cameras' images, with the options that the images depend on.
#[derive(Clone, Debug, Serialize)]
pub(super) enum ImageSource<'a> {
    Synchronized(Box<ImageMethod>),
    Given(&'a GivenImages),
}

impl<'a> ImageSource<'a> {
    pub fn new(images: Images<'a>, options: &RenderOptions) -> Self {
        match images {
            Images::By(sync) => Self::Synchronized(Box::new(ImageMethod::new(sync, options))),
            Images::Given(given) => Self::Given(given),
        }
    }
}

/// A camera's frames around an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct FramesAround {
    pub camera: usize,
    /// The frame nearer to the instant.
    pub near: usize,
    /// The frame at the other end of the interval between frames that contains the instant; equal to `near` if
    /// nothing moves between the two.
    pub far: usize,
}

/// Features of the first camera, matched in the others. They hold for all instants between the same frames.
#[derive(Serialize)]
pub(super) struct Correspondences<'a> {
    pub around: Vec<FramesAround>,
    pub registration: &'a RegistrationOptions,
}

/// Points of the scene at an instant, seen by a camera and its partners.
#[derive(Serialize)]
pub(super) struct CameraPoints<'a> {
    pub camera: usize,
    pub partners: &'a [usize],
    pub instant: Instant<'a>,
}

/// A stereo matcher for the images of some cameras at an instant, with their search ranges.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Stereo<'a> {
    /// Camera indices, ascending.
    pub cameras: &'a [usize],
    pub instant: Instant<'a>,
    pub images: &'a ImageSource<'a>,
    pub proxy: &'a ProxyOptions,
}

/// A camera's depth per pixel at an instant.
#[derive(Serialize)]
pub(super) struct CameraDepth<'a> {
    pub stereo: Stereo<'a>,
    pub camera: usize,
}

/// Depth maps of all cameras of a stereo, for occlusion. The depths of the cameras `estimated` come from matching;
/// those of the other cameras are fused from the estimated depths.
#[derive(Serialize)]
pub(super) struct OcclusionDepths<'a> {
    pub stereo: Stereo<'a>,
    /// The cameras whose depths are estimated, ascending.
    pub estimated: &'a [usize],
}

/// A frame resampled without lens distortion, and gain-corrected to the reference camera's exposure.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Undistorted<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// What stands still before a camera over the whole recording.
#[derive(Clone, Copy, Serialize)]
pub(super) struct StillContent<'a> {
    pub camera: usize,
    pub registration: &'a RegistrationOptions,
}

/// Depth and motion of one frame. It is estimated together with the other frames of its slot.
#[derive(Serialize)]
pub(super) struct FrameFlow<'a> {
    pub frame: FrameId,
    pub options: FlowOptions<'a>,
}

/// The confidences of the maps from which a view is blended.
#[derive(Serialize)]
pub(super) struct FlowConfidences<'a> {
    /// The frames as (camera, index), ascending.
    pub frames: &'a [FrameId],
    pub options: FlowOptions<'a>,
    /// `frames`, each with its map of depth and motion.
    #[serde(skip)]
    pub mapped: &'a [MappedFrame<'a>],
}

/// The options that the depth and motion of frames depend on.
#[derive(Clone, Copy, Serialize)]
pub(super) struct FlowOptions<'a> {
    pub registration: &'a RegistrationOptions,
    pub still_change: f32,
    pub proxy: &'a ProxyOptions,
}

impl<'a> FlowOptions<'a> {
    pub fn new(options: &'a RenderOptions) -> Self {
        let still_change = options.interpolation.still_change;
        Self { registration: &options.registration, still_change, proxy: &options.proxy }
    }
}

/// The names of stages whose results belong to an instant.
const OF_INSTANTS: [&str; 7] = [
    Correspondences::NAME,
    CameraPoints::NAME,
    CameraImage::NAME,
    CorrectedImage::NAME,
    Stereo::NAME,
    CameraDepth::NAME,
    OcclusionDepths::NAME,
];

impl LightField {
    /// Evicts the results of all instants from memory. The next view then takes as long as the first view at
    /// a new instant between registered frames.
    pub(crate) fn forget_instants(&self) {
        self.memo.forget(|stage| OF_INSTANTS.contains(&stage));
    }
}
