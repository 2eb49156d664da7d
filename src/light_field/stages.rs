//! The inputs of every stage. A stage's result depends on its inputs, the capture's frames and clocks, and nothing
//! else. The memo's keys are these inputs, serialized.

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

/// The tracks between the frames `frame` and `frame + 1` of a camera that pass the epipolar test.
#[derive(Clone, Copy, Serialize)]
pub(super) struct PairTracks<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// The largest change of a block between the frames of a pair.
#[derive(Serialize)]
pub(super) struct FrameChange<'a>(pub PairTracks<'a>);

/// The triangulation of a pair's tracks.
#[derive(Serialize)]
pub(super) struct PairTriangles<'a>(pub PairTracks<'a>);

/// The refinement's costs that depend on a frame pair alone, not on the instant.
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

/// A camera's image at an instant, as bright as the reference camera records it.
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
    /// `None` for methods that follow no motion.
    pub interpolation: Option<InterpolationOptions>,
    /// Whether the error of interpolation is wanted beside the image.
    pub with_error: bool,
    /// Options of [`SyncMethod::AllCameras`]; `None` for other methods.
    pub all_cameras: Option<AllCamerasOptions>,
}

/// Options of views from which [`SyncMethod::AllCameras`] takes a camera's image.
#[derive(Clone, Debug, Serialize)]
pub(super) struct AllCamerasOptions {
    pub proxy: ProxyOptions,
    pub blend: BlendOptions,
}

/// An instant, and the options by which the frames around it are registered or recognized as still.
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
        // Refinement computes the error in any case. So views with and without weights of time share images.
        let with_error =
            sync == SyncMethod::Refined || follows_motion && blend.method == BlendMethod::SpaceTime;
        let all_cameras =
            (sync == SyncMethod::AllCameras).then_some(AllCamerasOptions { proxy, blend });
        let interpolation = follows_motion.then_some(interpolation);
        Self { sync, registration, interpolation, with_error, all_cameras }
    }
}

/// Where the cameras' images at an instant come from.
#[derive(Clone, Copy, Debug)]
pub enum Images<'a> {
    /// Synchronized from the capture's frames, by this method.
    By(SyncMethod),
    /// The images themselves, such as the truth's.
    Given(&'a GivenImages),
}

/// One image a camera, in the capture's order. `None`: the camera has none.
pub(super) type CameraImages = Vec<Option<Arc<Synchronized>>>;

/// Images of the cameras that are not synchronized from the capture, such as the truth's.
#[derive(Debug)]
pub struct GivenImages {
    images: CameraImages,
    /// Whether the images are as bright as the reference camera records them; else as their own camera does.
    are_corrected: bool,
    hash: OnceLock<String>,
}

impl GivenImages {
    /// One image a camera, in the capture's order, as bright as the camera records it. `None`: the camera has none.
    pub fn filmed(images: Vec<Option<Arc<Synchronized>>>) -> Self {
        Self { images, are_corrected: false, hash: OnceLock::new() }
    }

    /// One image a camera, in the capture's order, as bright as the reference camera records it.
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

    /// One image a camera, in the capture's order.
    pub fn all(&self) -> &[Option<Arc<Synchronized>>] {
        &self.images
    }

    /// A camera's image, as bright as the reference records it.
    pub(super) fn corrected_of(&self, camera: usize, gains: &Gains) -> Option<Arc<Synchronized>> {
        let given = self.images.get(camera)?.as_ref()?;
        let image = gains.corrected(camera, &given.image).filter(|_| !self.are_corrected);
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

/// `image` with the interpolation error of `of`.
pub(super) fn with_image(of: &Synchronized, image: Image) -> Synchronized {
    Synchronized { image, interpolation_error_px: of.interpolation_error_px.clone() }
}

/// Where the cameras' images come from, with the options that they depend on.
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
    /// The frame that is nearer in time.
    pub near: usize,
    /// The frame on the instant's other side; `near` where nothing moves between them.
    pub far: usize,
}

/// Features of the first camera, matched in the others, for all instants between the same frames.
#[derive(Serialize)]
pub(super) struct Correspondences<'a> {
    pub around: Vec<FramesAround>,
    pub registration: &'a RegistrationOptions,
}

/// Points of the scene at an instant that a camera and its partners see.
#[derive(Serialize)]
pub(super) struct CameraPoints<'a> {
    pub camera: usize,
    pub partners: &'a [usize],
    pub instant: Instant<'a>,
}

/// The images of cameras at an instant, prepared for stereo, and the ranges of their depths.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Stereo<'a> {
    /// Camera indices, ascending.
    pub cameras: &'a [usize],
    pub instant: Instant<'a>,
    pub images: &'a ImageSource<'a>,
    pub proxy: &'a ProxyOptions,
}

/// A camera's depths at an instant.
#[derive(Serialize)]
pub(super) struct CameraDepth<'a> {
    pub stereo: Stereo<'a>,
    pub camera: usize,
}

/// Depth maps of all cameras of a stereo, for occlusion. Those of `estimated` are estimated by matching; the others are
/// fused from these.
#[derive(Serialize)]
pub(super) struct OcclusionDepths<'a> {
    pub stereo: Stereo<'a>,
    /// The cameras whose depths are estimated, ascending.
    pub estimated: &'a [usize],
}

/// A frame without lens distortion, as bright as the reference camera records it.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Undistorted<'a> {
    pub camera: usize,
    pub frame: usize,
    pub registration: &'a RegistrationOptions,
}

/// Depth and motion of one frame, which are found together with those of the other frames of its slot.
#[derive(Serialize)]
pub(super) struct FrameFlow<'a> {
    pub frame: FrameId,
    pub options: FlowOptions<'a>,
}

/// How far the maps of a view's frames agree.
#[derive(Serialize)]
pub(super) struct FlowConfidences<'a> {
    /// Cameras and frames, ascending.
    pub frames: &'a [FrameId],
    pub options: FlowOptions<'a>,
    /// These frames, with their maps.
    #[serde(skip)]
    pub mapped: &'a [MappedFrame<'a>],
}

/// The options that depth and motion of frames depend on.
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

/// Stages whose results belong to an instant.
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
    /// Drops the cached results of all instants. The next view then takes as long as the first view of a new instant
    /// between registered frames.
    pub(crate) fn forget_instants(&self) {
        self.memo.forget(|stage| OF_INSTANTS.contains(&stage));
    }
}
