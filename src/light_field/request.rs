//! Request of a view: viewpoint, time, options and images.

use super::RenderError;
use super::graph::LightField;
use super::stages::Images;
use crate::camera::Camera;
use crate::options::{ProxyMethod, RenderOptions};
use crate::scene_flow::Detail;

/// Viewpoint of a requested view.
#[derive(Clone, Copy, Debug)]
pub enum Viewpoint<'a> {
    /// Any camera, even at a place from which nothing was filmed.
    View(&'a Camera),
    /// A recording camera, by its index. The result is this camera's own image at the instant.
    Like(usize),
}

/// Request to render a view.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    pub from: Viewpoint<'a>,
    /// Time of the view, seconds on the reference camera's clock from the capture's start.
    pub time_s: f64,
    /// Options of all stages. Methods must be concrete: every `auto` is already replaced.
    pub options: &'a RenderOptions,
    /// Images from which the view is blended.
    pub images: Images<'a>,
    /// Images from which depth per pixel is estimated.
    pub shape: Images<'a>,
    /// How completely a view by scene flow is blended. Other methods ignore it.
    pub detail: Detail,
}

impl<'a> Request<'a> {
    /// Creates a request of full detail in which all cameras' images are synchronized by the method `options.sync`.
    pub fn new(from: Viewpoint<'a>, time_s: f64, options: &'a RenderOptions) -> Self {
        let images = Images::By(options.sync);
        Self { from, time_s, options, images, shape: images, detail: Detail::Full }
    }
}

impl Request<'_> {
    /// Returns whether the view is rendered by scene flow, from the depth and motion of frames. This requires that the
    /// options choose scene flow, and that all images of the request are synchronized by the method `options.sync`.
    /// Otherwise, the view is blended from the request's images by depths that are estimated from images.
    pub(super) fn uses_scene_flow(&self) -> bool {
        self.options.proxy.method == ProxyMethod::SceneFlow
            && [self.images, self.shape]
                .iter()
                .all(|i| matches!(i, Images::By(sync) if *sync == self.options.sync))
    }
}

impl LightField {
    /// Checks that images for the viewpoint `from` exist at all the times `times_s`, seconds from the capture's start.
    /// For [`Viewpoint::View`], one camera with an image at each time is enough.
    ///
    /// # Errors
    /// If any of the times lies outside the recordings: the error that [`super::render()`] returns for the first such
    /// time in the list.
    pub fn check_times(&self, from: Viewpoint, times_s: &[f64]) -> Result<(), RenderError> {
        times_s.iter().try_for_each(|&time_s| match from {
            Viewpoint::Like(camera) => self.bracket(camera, time_s).map(drop),
            Viewpoint::View(_) if self.usable(time_s).is_empty() => Err(self.no_camera_at(time_s)),
            Viewpoint::View(_) => Ok(()),
        })
    }
}
