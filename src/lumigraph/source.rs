//! What a view is blended from, how, and what comes out of it.

use super::DepthMap;
use super::weights::BlendMethod;
use crate::camera::Camera;
use crate::raster::{Image, Sampling};
use serde::{Deserialize, Serialize};

/// A camera with its image at the instant that is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// The image, of the camera's size, with 1 or 3 channels.
    pub image: &'a Image,
    /// The proxy's depths in this camera; points behind them are occluded. `None`: no point is.
    pub depth: Option<&'a DepthMap>,
    /// Expected error of each pixel's temporal interpolation, pixels
    /// ([`Synchronized::interpolation_error_px`](crate::interpolation::Synchronized)). `None`: 0 everywhere.
    pub interpolation_error_px: Option<&'a [f32]>,
}

impl<'a> Source<'a> {
    /// A source in which no point is occluded.
    pub fn new(camera: &'a Camera, image: &'a Image) -> Self {
        Self { camera, image, depth: None, interpolation_error_px: None }
    }
}

/// Options of [`blend`](super::blend).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlendOptions {
    /// The cameras' weights. Files of earlier versions call the field `rung`.
    #[serde(alias = "rung")]
    pub method: BlendMethod,
    /// Number of cameras that a pixel is blended from; 0 counts as 1. Larger: the noise of more images
    /// is averaged, and the proxy's error blurs. Smaller: every camera's own errors show. (Magazine
    /// scene: over true depth 2, 3, 4, 8 give 33.7, 33.8, 34.0, 34.2 dB, over a plane 25.9, 25.9,
    /// 25.7, 24.4.)
    pub cameras: usize,
    /// Width over which a camera fades out towards its image's border, pixels. Larger: the image's
    /// outer part is wasted. Smaller: the border of an image is visible.
    pub feather_px: f64,
    /// β, the weight of coarser resolution. Larger: cameras that are farther away or have a shorter
    /// lens than the view are avoided even at the right angle. Smaller: their blur shows.
    pub resolution: f64,
    /// Distance of the pixels whose weights are computed, along rows and columns; between them weights are
    /// interpolated, as Buehler et al. do. At least 1, where all are computed, and at most 64. Larger: cameras mix where
    /// surfaces end. Smaller: slower. It has no effect where depths of a camera, its interpolation errors or grey cameras
    /// among coloured ones change weights from pixel to pixel.
    pub weight_step_px: usize,
    /// Interpolation of the images between pixels.
    pub sampling: Sampling,
    /// Smallest depth of an occluded point beyond [`Source::depth`], as a fraction of it. Larger: the
    /// foreground's edge shows twice. Smaller: slanted surfaces occlude themselves.
    pub hidden_share: f64,
    /// The angle, radians, that one pixel of interpolation error counts as
    /// ([`BlendMethod::SpaceTime`]). Larger: cameras that stand farther away replace those that filmed
    /// longer before or after. Smaller: the errors of interpolation show.
    pub interpolation_error_rad: f64,
}

impl Default for BlendOptions {
    fn default() -> Self {
        Self {
            method: BlendMethod::default(),
            cameras: 3,
            feather_px: 4.0,
            resolution: 1.0,
            weight_step_px: 4,
            sampling: Sampling::Cubic,
            hidden_share: 0.03,
            interpolation_error_rad: 0.004,
        }
    }
}

/// A rendered view.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The view; pixels without coverage are 0.
    pub image: Image,
    /// Whether any camera sees the pixel's point, row by row.
    pub coverage: Vec<bool>,
}
