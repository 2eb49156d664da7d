//! Sources of a view, the options of blending, and the rendered view.

use super::depth_map::DepthMap;
use super::weights::BlendMethod;
use crate::camera::Camera;
use crate::option::options;
use crate::raster::Image;

/// A camera and its image at the instant that is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// Image of the camera's size, with 1 or 3 channels.
    pub image: &'a Image,
    /// Depths of the camera's pixels; points behind them are occluded. `None`: no point counts as occluded.
    pub depth: Option<&'a DepthMap>,
    /// Expected error of temporal interpolation at each pixel, pixels of motion. `None`: 0 everywhere.
    pub interpolation_error_px: Option<&'a [f32]>,
}

impl<'a> Source<'a> {
    /// A source in which no point is occluded.
    pub fn new(camera: &'a Camera, image: &'a Image) -> Self {
        Self { camera, image, depth: None, interpolation_error_px: None }
    }
}

options! {
    /// Options of blending.
    pub struct BlendOptions {
        /// The cameras' weights, if auto.blend is false.
        method: BlendMethod = BlendMethod::Lumigraph,
        /// Cameras from which a pixel is blended.
        cameras: usize [1..=1000, "cameras"] = 3,
        /// Distance of the pixels whose weights are computed; between them, weights are interpolated.
        weight_step_px: usize [1..=64, "px"] = 4,
        /// Angle that one pixel of interpolation error counts as, for the method space-time.
        error_angle_rad: f64 [0.0..=1000.0, "rad"] = 0.004,
    }
}

/// A rendered view.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The view; pixels without coverage are 0.
    pub image: Image,
    /// For each pixel, row by row, whether any camera sees its point.
    pub coverage: Vec<bool>,
}
