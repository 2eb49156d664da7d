//! Inputs of every stage of the graph that renders views. A stage computes one kind of result, which depends only on
//! the stage's inputs and on the capture's frames and clocks. The serialized inputs are the keys of the memo, the cache
//! of results in memory.

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

/// Inputs of the stage that tracks features between the frames `frame` and `frame + 1` of a camera. If the options ask
/// for the epipolar test, tracks that contradict the epipolar geometry with other cameras are removed.
#[derive(Clone, Copy, Serialize)]
pub(super) struct PairTracks<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// Inputs of the stage that measures the change between two successive frames of a camera. The change is the maximum,
/// over all 8×8 blocks of pixels, of the block's mean absolute difference. Pixel values are 0 to 1.
#[derive(Serialize)]
pub(super) struct FrameChange<'a>(pub PairTracks<'a>);

/// Inputs of the stage that computes the Delaunay triangulation of a frame pair's tracked features.
#[derive(Serialize)]
pub(super) struct PairTriangles<'a>(pub PairTracks<'a>);

/// Inputs of the stage that computes the photometric costs by which tracked motion is refined. The costs depend only on
/// a frame pair, not on the instant.
#[derive(Serialize)]
pub(super) struct RefinementCosts<'a> {
    pub tracks: PairTracks<'a>,
    pub interpolation: &'a InterpolationOptions,
}

/// Inputs of the stage that computes a camera's image at an instant.
#[derive(Clone, Copy, Serialize)]
pub(super) struct CameraImage<'a> {
    pub camera: usize,
    pub time_s: f64,
    pub method: &'a ImageMethod,
}

/// Inputs of the stage that computes a camera's image at an instant, gain-corrected to the reference camera's exposure.
#[derive(Serialize)]
pub(super) struct CorrectedImage<'a> {
    pub image: CameraImage<'a>,
    pub registration: &'a RegistrationOptions,
}

/// The options that determine a camera's image at an instant.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ImageMethod {
    pub sync: SyncMethod,
    pub registration: RegistrationOptions,
    /// Options of temporal interpolation. `None` for methods that don't use motion.
    pub interpolation: Option<InterpolationOptions>,
    /// Whether the expected interpolation error of each pixel is computed too.
    pub with_error: bool,
    /// Options of the method [`SyncMethod::AllCameras`]; `None` for other methods.
    pub all_cameras: Option<AllCamerasOptions>,
}

/// Options with which [`SyncMethod::AllCameras`] blends one camera's image from all cameras' images.
#[derive(Clone, Debug, Serialize)]
pub(super) struct AllCamerasOptions {
    pub proxy: ProxyOptions,
    pub blend: BlendOptions,
}

/// An instant, with the options that decide how the frames around it are registered and when a frame pair counts as
/// static.
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

/// How the cameras' images at an instant are obtained.
#[derive(Clone, Copy, Debug)]
pub enum Images<'a> {
    /// The cameras' images are synchronized from the capture's frames by this method.
    By(SyncMethod),
    /// The cameras' images are given by the caller, such as ground-truth images.
    Given(&'a GivenImages),
}

/// One image per camera, in the capture's order; `None` if the camera has no image.
pub(super) type CameraImages = Vec<Option<Arc<Synchronized>>>;

/// Images of the cameras at an instant that are given by the caller, such as ground-truth images. They are not
/// synchronized from the capture's frames.
#[derive(Debug)]
pub struct GivenImages {
    images: CameraImages,
    /// Whether the images are gain-corrected to the reference camera's exposure.
    are_corrected: bool,
    hash: OnceLock<String>,
}

impl GivenImages {
    /// Wraps images that are not gain-corrected: each has the exposure of its camera's first frame. `images` has one
    /// element per camera, in the capture's order; `None` if the camera has no image.
    pub fn filmed(images: Vec<Option<Arc<Synchronized>>>) -> Self {
        Self { images, are_corrected: false, hash: OnceLock::new() }
    }

    /// Wraps images that are gain-corrected to the reference camera's exposure. `images` has one element per camera, in
    /// the capture's order; `None` if the camera has no image.
    pub fn corrected(images: Vec<Option<Arc<Synchronized>>>) -> Self {
        Self { images, are_corrected: true, hash: OnceLock::new() }
    }

    /// Replaces each camera's image by a uniform colour. `colors` has one RGB colour per camera, from 0 to 1, in the
    /// capture's order. The interpolation errors are unchanged. A view of the result shows the blending weights: each
    /// pixel is the weighted mean of the cameras' colours.
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

    /// Returns one image per camera, in the capture's order; `None` if the camera has no image.
    pub fn all(&self) -> &[Option<Arc<Synchronized>>] {
        &self.images
    }

    /// Returns a camera's image, gain-corrected to the reference camera's exposure. `None` if the camera has no image.
    /// `first_s` is the time of the camera's first frame, seconds on its own clock.
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

/// Returns `image` with the interpolation errors of `of`.
pub(super) fn with_image(of: &Synchronized, image: Image) -> Synchronized {
    Synchronized { image, interpolation_error_px: of.interpolation_error_px.clone() }
}

/// Origin of the cameras' images, with the options that determine the images.
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

/// A camera and its two frames around an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct FramesAround {
    pub camera: usize,
    /// Index of the frame that is nearer in time to the instant.
    pub near: usize,
    /// Index of the frame that is farther in time from the instant. It is equal to `near` if nothing moves between the
    /// two frames.
    pub far: usize,
}

/// Inputs of the stage that matches the features of one camera, the first in `around`, in the other cameras of
/// `around`. The matches are valid at all instants at which each camera has the same frames `near` and `far`.
#[derive(Serialize)]
pub(super) struct Correspondences<'a> {
    pub around: Vec<FramesAround>,
    pub registration: &'a RegistrationOptions,
}

/// Inputs of the stage that triangulates points of the scene at an instant, from a camera and its partners. The
/// partners are the cameras in which the camera's features are searched.
#[derive(Serialize)]
pub(super) struct CameraPoints<'a> {
    pub camera: usize,
    pub partners: &'a [usize],
    pub instant: Instant<'a>,
}

/// Inputs of the stage that prepares a stereo matcher for the images of several cameras at an instant.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Stereo<'a> {
    /// Indices of the cameras whose images are matched, ascending.
    pub cameras: &'a [usize],
    pub instant: Instant<'a>,
    pub images: &'a ImageSource<'a>,
    pub proxy: &'a ProxyOptions,
}

/// Inputs of the stage that estimates a camera's depth per pixel at an instant.
#[derive(Serialize)]
pub(super) struct CameraDepth<'a> {
    pub stereo: Stereo<'a>,
    pub camera: usize,
}

/// Inputs of the stage that computes a depth map of each camera in `stereo`, to find which points are occluded in the
/// camera. The depths of the cameras `estimated` come from stereo matching. The depths of the other cameras are fused
/// from these estimated depths.
#[derive(Serialize)]
pub(super) struct OcclusionDepths<'a> {
    pub stereo: Stereo<'a>,
    /// Indices of the cameras whose depths are estimated by stereo matching, ascending.
    pub estimated: &'a [usize],
}

/// Inputs of the stage that resamples a frame without lens distortion, gain-corrected to the reference camera's
/// exposure.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Undistorted<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// Inputs of the stage that estimates the gains of cameras that stand around the scene.
#[derive(Clone, Copy, Serialize)]
pub(super) struct WideGains<'a> {
    pub registration: &'a RegistrationOptions,
}

/// Inputs of the stage that finds the static background of a camera over the whole recording.
#[derive(Clone, Copy, Serialize)]
pub(super) struct StillContent<'a> {
    pub camera: usize,
    pub registration: &'a RegistrationOptions,
}

/// Inputs of the stage that estimates the depth of a camera's static background. The cameras of a group are estimated
/// together.
#[derive(Clone, Copy, Serialize)]
pub(super) struct StillDepth<'a> {
    pub camera: usize,
    pub options: FlowOptions<'a>,
}

/// Inputs of the stage that estimates the depth and motion of one frame. All frames of a slot ([`super::slots::Slot`])
/// are estimated together.
#[derive(Serialize)]
pub(super) struct FrameFlow<'a> {
    pub frame: FrameId,
    pub options: FlowOptions<'a>,
}

/// Inputs of the stage that computes the confidences of one of the depth and motion maps from which a view is blended.
#[derive(Serialize)]
pub(super) struct FlowConfidence<'a> {
    /// Index of the map's frame in `frames`.
    pub of: usize,
    /// The frames from which the view is blended, as (camera index, frame index), ascending.
    pub frames: &'a [FrameId],
    pub options: FlowOptions<'a>,
    /// The frames of `frames`, each with its map of depth and motion. They follow from the other inputs, and are
    /// therefore not a part of the cache key.
    #[serde(skip)]
    pub mapped: &'a [MappedFrame<'a>],
}

/// Inputs of the stage that compares the depth and motion map of one frame with that of another frame.
#[derive(Serialize)]
pub(super) struct FlowAgreements<'a> {
    pub of: FrameId,
    pub by: FrameId,
    pub options: FlowOptions<'a>,
    /// The frames `of` and `by` with their maps, which are not a part of the cache key.
    #[serde(skip)]
    pub mapped: [&'a MappedFrame<'a>; 2],
}

/// The options that determine the depth and motion of frames.
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

/// Names of the stages whose results are valid only near or at one instant.
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
    /// Evicts the results of all instants from memory. The next view then takes as long as the first view at a new
    /// instant, except that the feature tracks between frames are still cached.
    pub(crate) fn forget_instants(&self) {
        self.memo.forget(|stage| OF_INSTANTS.contains(&stage));
    }
}
