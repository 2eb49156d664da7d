//! What depths are estimated from.

use crate::camera::Camera;
use crate::raster::Image;

/// A camera and its image at the instant.
#[derive(Clone, Copy, Debug)]
pub struct CameraImage<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// Of the camera's size.
    pub image: &'a Image,
}
