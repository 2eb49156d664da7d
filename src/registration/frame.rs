//! Video frames, prepared for registration.

use super::polar_gradients::{PolarGradients, polar_gradients};
use super::pyramid::PyramidLevel;
use super::{Pyramid, RegistrationOptions, corners};
use crate::raster::Image;
use nalgebra::Point2;
use std::sync::{Arc, OnceLock};

/// A video frame with its pyramid, corners and gradients.
#[derive(Debug)]
pub struct Frame {
    /// Image as filmed, without gain correction.
    pub image: Image,
    /// Pyramid for tracking. It is built from the image after gain correction to the reference camera's exposure.
    pub pyramid: Arc<Pyramid>,
    corners: OnceLock<Vec<Point2<f64>>>,
    gradients: OnceLock<PolarGradients>,
}

impl Frame {
    /// Creates a frame whose pyramid is built from `image` without gain correction.
    pub fn new(image: Image, options: &RegistrationOptions) -> Self {
        let pyramid = Arc::new(Pyramid::new(&image, options.levels, options.pad_px()));
        let (corners, gradients) = (OnceLock::new(), OnceLock::new());
        Self { image, pyramid, corners, gradients }
    }

    /// Returns a copy of the frame with another image, which shows the same scene at another exposure. The copy shares
    /// the pyramid.
    pub(super) fn with_image(&self, image: Image) -> Self {
        let (corners, gradients) = (OnceLock::new(), OnceLock::new());
        Self { image, pyramid: self.pyramid.clone(), corners, gradients }
    }

    /// Returns the frame's corners (§4.1), in pixels. The first call computes the corners with its `options`. Later
    /// calls return the same corners and ignore their `options`.
    pub fn corners(&self, options: &RegistrationOptions) -> &[Point2<f64>] {
        self.corners.get_or_init(|| corners(&self.pyramid.levels[0], options.max_corners))
    }

    /// Returns the gradients for the SIFT descriptors of rotating patches. They are computed on the first call.
    pub(super) fn gradients(&self) -> &PolarGradients {
        self.gradients.get_or_init(|| polar_gradients(&self.pyramid))
    }

    /// Returns the size in memory, in bytes, of a frame. `size` is its width and height in pixels. The frame's image,
    /// pyramid and gradients are counted.
    pub(super) fn bytes_of(
        size: [usize; 2],
        channels: usize,
        options: &RegistrationOptions,
    ) -> usize {
        let sizes = Pyramid::sizes(size, options.levels);
        let pad = options.pad_px();
        let levels: usize = sizes.iter().map(|&size| PyramidLevel::samples(size, pad)).sum();
        let image = size[0] * size[1] * channels;
        size_of::<f32>() * (image + levels) + PolarGradients::bytes_of(&sizes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_the_samples() {
        let options = RegistrationOptions::default();
        for (w, h, channels) in [(1, 1, 3), (31, 70, 1), (65, 64, 3), (320, 240, 1)] {
            let frame = Frame::new(Image::filled(w, h, channels, 0.5), &options);
            let levels: usize = frame.pyramid.levels.iter().map(|l| l.value.len()).sum();
            let samples = w * h * channels + levels;
            let expected = size_of::<f32>() * samples + frame.gradients().bytes();
            assert_eq!(Frame::bytes_of([w, h], channels, &options), expected);
        }
    }
}
