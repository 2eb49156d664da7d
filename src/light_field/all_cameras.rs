//! Beyond the paper: a camera's image at an instant is blended from the camera's own frames and from other cameras'
//! images. The other cameras' images are warped to the camera's viewpoint by depth per pixel.
//!
//! This recovers motion that a camera misses. For example, a ball bounces between two frames of a camera, and another
//! camera has a frame nearer to the instant of the bounce.

use super::camera_image::images_of;
use super::geometry::geometry;
use super::stages::{AllCamerasOptions, CameraImage, ImageMethod, ImageSource, Images, Instant};
use super::{Context, LightField, RenderError, Request, Viewpoint};
use crate::interpolation::{InterpolationOptions, SyncMethod, Synchronized};
use crate::lumigraph::BlendMethod;
use crate::options::{ProxyMethod, RenderOptions};

/// Factor by which [`crate::lumigraph::BlendOptions::error_angle_rad`], the penalty per pixel of interpolation error,
/// is multiplied when one camera's image is blended from all cameras' images. The blended images include the camera's
/// own interpolated image. The factor is below 1 because the camera's own image has no depth error. With a smaller
/// factor, the camera's own image dominates; with a larger factor, other cameras' images do.
const OWN_FRACTION: f64 = 0.25;

impl LightField {
    /// Computes a camera's image at an instant between two of its frames. It is blended from all cameras' images with
    /// the options `all`. Pixels that the blend doesn't cover are interpolated from the camera's own frames.
    pub(super) fn image_from_all_cameras(
        &self,
        image: &CameraImage,
        interpolation: &InterpolationOptions,
        all: &AllCamerasOptions,
        context: &Context,
    ) -> Result<Synchronized, RenderError> {
        let &CameraImage { camera, time_s, method } = image;
        let mut options = RenderOptions {
            sync: SyncMethod::AllCameras.of_one_camera(),
            registration: method.registration.clone(),
            interpolation: interpolation.clone(),
            proxy: all.proxy.clone(),
            blend: all.blend.clone(),
            ..RenderOptions::default()
        };
        options.proxy.method = ProxyMethod::Depth;
        options.blend.method = BlendMethod::SpaceTime;
        options.blend.error_angle_rad *= OWN_FRACTION;
        let own = ImageMethod::new(options.sync, &options);
        let own = CameraImage { camera, time_s, method: &own }.get(self, context)?;
        let filmed = &self.capture().cameras[camera].camera;
        let request = Request::new(Viewpoint::View(filmed), time_s, &options);
        let geometry = match geometry(self, filmed, &request, context) {
            // Without depth, other cameras' images can't be warped: the camera's own interpolated image is
            // the result.
            Err(RenderError::NoPoints | RenderError::NothingSeen) => return Ok((*own).clone()),
            geometry => geometry?,
        };
        let cameras: Vec<usize> =
            (0..geometry.sources.len()).filter(|&c| geometry.sources[c].is_some()).collect();
        if cameras.is_empty() {
            return Ok((*own).clone());
        }
        let source = ImageSource::new(Images::By(options.sync), &options);
        let instant = Instant::new(time_s, &options);
        let images = images_of(self, &source, &cameras, instant, context)?;
        let blended = self.blend(&images, &geometry, filmed, &options.blend);
        let gains = self.gains(&options.registration);
        let image = gains
            .as_filmed(camera, self.own_time_s(camera, time_s), &blended.image)
            .unwrap_or(blended.image);
        let mut result = (*own).clone();
        let channels = result.image.channels();
        let pixels = result.image.data_mut().chunks_exact_mut(channels);
        for ((out, color), covered) in
            pixels.zip(image.data().chunks_exact(channels)).zip(&blended.coverage)
        {
            if *covered {
                for (out, color) in out.iter_mut().zip(color) {
                    *out = color.clamp(0.0, 1.0);
                }
            }
        }
        Ok(result)
    }
}
