//! Request of a view: viewpoint, time, options and images.

use super::RenderError;
use super::graph::LightField;
use super::stages::Images;
use crate::camera::Camera;
use crate::options::{ProxyMethod, RenderOptions};

/// The viewpoint of a request.
#[derive(Clone, Copy, Debug)]
pub enum Viewpoint<'a> {
    /// Any camera, including one of a place from which nothing was filmed.
    View(&'a Camera),
    /// A filming camera, by its index: the result is its own image at the instant.
    Like(usize),
}

/// A view to render.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    pub from: Viewpoint<'a>,
    /// Seconds on the reference camera's clock, from the capture's start.
    pub time_s: f64,
    /// Options of all stages; every `auto` is already replaced by a method.
    pub options: &'a RenderOptions,
    /// The images from which the view is blended.
    pub images: Images<'a>,
    /// The images from which depth per pixel is estimated.
    pub shape: Images<'a>,
}

impl<'a> Request<'a> {
    /// A request in which all images are synchronized by the options' method.
    pub fn new(from: Viewpoint<'a>, time_s: f64, options: &'a RenderOptions) -> Self {
        let images = Images::By(options.sync);
        Self { from, time_s, options, images, shape: images }
    }
}

impl Request<'_> {
    /// Whether the view is rendered by scene flow, from the frames' depth and motion. This needs the options'
    /// own images: given images, or those of another method, are blended by estimated depths instead.
    pub(super) fn uses_scene_flow(&self) -> bool {
        self.options.proxy.method == ProxyMethod::SceneFlow
            && [self.images, self.shape]
                .iter()
                .all(|i| matches!(i, Images::By(sync) if *sync == self.options.sync))
    }
}

impl LightField {
    /// Checks that images exist at all of these times, seconds from the capture's start.
    ///
    /// # Errors
    /// The error of [`super::render()`] for the first of the times that lies outside the recordings.
    pub fn check_times(&self, from: Viewpoint, times_s: &[f64]) -> Result<(), RenderError> {
        times_s.iter().try_for_each(|&time_s| match from {
            Viewpoint::Like(camera) => self.bracket(camera, time_s).map(drop),
            Viewpoint::View(_) if self.usable(time_s).is_empty() => Err(self.no_camera_at(time_s)),
            Viewpoint::View(_) => Ok(()),
        })
    }
}
