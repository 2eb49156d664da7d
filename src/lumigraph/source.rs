//! Input images of a rendered view, the options of blending them, and the rendered view.

use super::depth_map::DepthMap;
use super::weights::BlendMethod;
use crate::camera::Camera;
use crate::option::options;
use crate::raster::Image;

/// One input of a view: a camera, and its image at the rendered instant.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Lens and pose of the camera.
    pub camera: &'a Camera,
    /// The camera's image, with 1 or 3 channels. Its size must be the camera's.
    pub image: &'a Image,
    /// Depth map of the camera. Points behind these depths are occluded in the camera. `None`: no point counts as
    /// occluded.
    pub depth: Option<&'a DepthMap>,
    /// Expected error of each pixel's position due to temporal interpolation, pixels, row by row. `None`: 0 everywhere.
    pub interpolation_error_px: Option<&'a [f32]>,
}

impl<'a> Source<'a> {
    /// Returns a source without a depth map and without interpolation errors. No point counts as occluded in such a
    /// source.
    pub fn new(camera: &'a Camera, image: &'a Image) -> Self {
        Self { camera, image, depth: None, interpolation_error_px: None }
    }
}

options! {
    /// Options for blending a view from the cameras' images.
    pub struct BlendOptions {
        /// How the cameras that see a pixel's point are weighted, if auto.blend is false.
        method: BlendMethod = BlendMethod::Lumigraph,
        /// Number of cameras from which each pixel is blended.
        cameras: usize [1..=1000, "cameras"] = 3,
        /// Spacing of the pixels at which weights are computed; between these pixels, weights are interpolated.
        weight_step_px: usize [1..=64, "px"] = 4,
        /// Angle between rays that counts as much as one pixel of interpolation error, for the method space-time.
        error_angle_rad: f64 [0.0..=1000.0, "rad"] = 0.004,
    }
}

/// A rendered view, with its coverage mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Image of the view. Pixels that are not covered are 0.
    pub image: Image,
    /// Coverage mask, row by row: true for pixels whose colour comes from at least one camera's image.
    pub coverage: Vec<bool>,
}
