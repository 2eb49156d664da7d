//! Beyond the paper: a camera's image at an instant from all cameras: its own frames, and what other cameras filmed
//! nearer to the instant, seen from its place.
//!
//! A body that bounces between two frames leaves no trace of it in them. Another camera has a frame just then.

use super::geometry::geometry;
use super::graph::{LightField, Stage};
use super::stages::{AllCamerasImage, CameraImage, ImageMethod, ImageSource, Images};
use super::view::blend_images;
use super::{Context, RenderError, Request, Viewpoint, depth};
use crate::interpolation::{SyncMethod, Synchronized};
use crate::lumigraph::BlendMethod;
use crate::options::{ProxyMethod, RenderOptions};

/// Fraction of [`crate::lumigraph::BlendOptions::error_angle_rad`] that counts where a camera's own image is one of
/// those blended, since that one has no error of depth.
const OWN_FRACTION: f64 = 0.25;

impl Stage for AllCamerasImage<'_> {
    type Output = Synchronized;
    const NAME: &'static str = "image from all cameras";

    fn bytes(image: &Synchronized) -> usize {
        CameraImage::bytes(image)
    }

    fn compute(&self, field: &LightField, context: &Context) -> Result<Synchronized, RenderError> {
        let CameraImage { camera, time_s, method } = self.image;
        let mut options = RenderOptions {
            sync: SyncMethod::AllCameras.of_one_camera(),
            registration: method.registration.clone(),
            interpolation: self.interpolation.clone(),
            proxy: self.options.proxy.clone(),
            blend: self.options.blend.clone(),
            ..RenderOptions::default()
        };
        options.proxy.method = ProxyMethod::Depth;
        options.blend.method = BlendMethod::SpaceTime;
        options.blend.error_angle_rad *= OWN_FRACTION;
        let own = ImageMethod::new(options.sync, &options);
        let own = field.get(&CameraImage { camera, time_s, method: &own }, context)?;
        let filmed = &field.capture().cameras[camera].camera;
        let request = Request::new(Viewpoint::View(filmed), time_s, &options);
        let geometry = match geometry(field, filmed, &request, context) {
            // Without a shape, other cameras can't help.
            Err(RenderError::NoPoints | RenderError::NothingSeen) => return Ok((*own).clone()),
            geometry => geometry?,
        };
        if geometry.sources.iter().all(Option::is_none) {
            return Ok((*own).clone());
        }
        let cameras: Vec<usize> =
            (0..geometry.sources.len()).filter(|&c| geometry.sources[c].is_some()).collect();
        let source = ImageSource::new(Images::By(options.sync), &options);
        let at = (time_s, &options.registration);
        let found = depth::images_of(field, &source, &cameras, at, context)?;
        let mut images = vec![None; geometry.sources.len()];
        for (&c, image) in cameras.iter().zip(found) {
            images[c] = Some(image);
        }
        let blended = blend_images(field, &images, &geometry, filmed, &options.blend);
        let gains = field.gains(&options.registration);
        let image = gains.as_filmed(camera, &blended.image).unwrap_or(blended.image);
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
