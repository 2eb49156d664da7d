//! Renders pictures of the ground truth: a ground-truth image is resampled for a rotated or zoomed view from the same
//! position.

use super::{LiveError, PictureRequest, Place};
use crate::camera::Camera;
use crate::capture::{Capture, CaptureError, Truth, require_size};
use crate::host::Memo;
use crate::lumigraph::{BlendOptions, DepthMap, Rendered, Source, blend};
use crate::raster::{Image, read_image};
use crate::text::distinct_s;
use nalgebra::{Isometry3, Translation3};
use std::path::PathBuf;
use std::sync::Arc;

/// Maximum size of all ground-truth images that are cached in memory, bytes.
const MAX_BYTES: usize = 64 << 20;
/// Maximum difference between a requested time and the time of a ground-truth image, seconds. It allows for the
/// rounding of times in addresses.
const SAME_INSTANT_S: f64 = 1e-6;

/// A ground-truth image of a simulated scene. Its file is read when the image is first needed.
#[derive(Clone, Debug)]
pub(super) struct LiveTruth {
    pub id: String,
    /// Time that the image shows: seconds on the reference camera's clock, as in the capture's file.
    pub time_s: f64,
    pub camera: Camera,
    file: PathBuf,
}

/// All ground-truth images of a capture. Empty for a capture without ground truth.
pub(super) struct TrueViews {
    pub views: Vec<LiveTruth>,
    images: Memo,
}

/// Returns a copy of the camera, moved to the world's origin with the same orientation.
fn at_origin(camera: &Camera) -> Camera {
    let cam_from_world =
        Isometry3::from_parts(Translation3::identity(), camera.cam_from_world.rotation);
    Camera { cam_from_world, ..camera.clone() }
}

impl Default for TrueViews {
    fn default() -> Self {
        Self { views: Vec::new(), images: Memo::new(MAX_BYTES) }
    }
}

impl TrueViews {
    pub fn open(capture: &Capture) -> Result<Self, CaptureError> {
        let Some(truth) = Truth::open(&capture.folder)? else { return Ok(Self::default()) };
        let view = |view: &crate::capture::TruthView| {
            let path = capture.folder.join("truth/truth.json");
            let camera = view.camera.camera();
            let camera = camera.map_err(|error| CaptureError::content(&path, error.to_string()))?;
            let file = truth.file(&view.image)?;
            Ok(LiveTruth { id: view.id.clone(), time_s: view.time_s, camera, file })
        };
        let views = truth.views.iter().map(view).collect::<Result<_, CaptureError>>()?;
        Ok(Self { views, ..Self::default() })
    }

    /// Returns the ground-truth image at the requested viewpoint and time, resampled for the requested rotation and
    /// zoom. `target` is the camera of the picture.
    ///
    /// # Errors
    /// If there is no ground-truth image with this viewpoint and time, or if its file can't be read.
    pub fn view(&self, request: &PictureRequest, target: &Camera) -> Result<Rendered, LiveError> {
        let Place::Truth(index) = request.place else {
            let there =
                if self.views.is_empty() { "none of this capture" } else { "at its places only" };
            return Err(LiveError::Request(format!("there is truth {there}")));
        };
        let view =
            self.views.get(index).ok_or_else(|| LiveError::Request("at: no such truth".into()))?;
        if !((view.time_s - request.time_s).abs() <= SAME_INSTANT_S) {
            let [own_s, wanted_s] = distinct_s([view.time_s, request.time_s]);
            return Err(LiveError::Request(format!(
                "the truth at this place is of {own_s} s, not of {wanted_s} s"
            )));
        }
        let image = self.image(index, view)?;
        // Views from the same position are related by a homography, which doesn't depend on depths.
        let [own, target] = [&view.camera, target].map(at_origin);
        let no_depth = DepthMap::empty(target.width, target.height);
        let options = BlendOptions { cameras: 1, ..BlendOptions::default() };
        Ok(blend(&[Source::new(&own, &image)], &no_depth, &target, &options))
    }

    fn image(&self, index: usize, view: &LiveTruth) -> Result<Arc<Image>, LiveError> {
        const STAGE: &str = "true image";
        if let Some(image) = self.images.get(STAGE, &index) {
            return Ok(image);
        }
        let (image, _) = read_image(&view.file)?;
        require_size(&view.file, [image.width(), image.height()], &view.camera)?;
        let bytes = size_of_val(image.data());
        Ok(self.images.insert(STAGE, &index, Arc::new(image), bytes))
    }
}
