//! Rendering of a view, with or without a motion trail. This is the entry point of the module.

use super::graph::LightField;
use super::image_motion::Layers;
use super::scene_flow::flow_image;
use super::stages::{CameraImage, ImageMethod};
use super::trail::Overlay;
use super::view::{layers, view, view_with_layers};
use super::{Context, Geometry, RenderError, Request, Viewpoint};
use crate::camera::Camera;
use crate::host::on_workers;
use crate::lumigraph::Rendered;
use crate::options::RenderOptions;
use crate::scene_flow::Detail;

/// Renders a view, or a recording camera's image. If the options ask for a motion trail, the views at the trail's
/// instants are overlaid.
///
/// An instant of a trail is skipped if it is before the recording's start, if no camera sees a pixel of the view, or if
/// the geometry proxy can't be triangulated. The request's own instant is never skipped; if it fails, its error is
/// returned. A pixel of a trail integrates over the instants at which the view covers the pixel. The pixel counts as
/// covered if there is any such instant.
///
/// # Errors
/// [`RenderError::Time`], [`RenderError::CameraTime`] or [`RenderError::NoClock`] if there is no image at the request's
/// time, the errors of [`LightField::proxy`], [`RenderError::NothingSeen`] if no pixel is covered, and
/// [`RenderError::Stopped`] if `context` stops rendering.
pub fn render(
    field: &LightField,
    request: &Request,
    context: &Context,
) -> Result<Rendered, RenderError> {
    let instants_s = request.options.trail.instants_s(request.time_s);
    let mut overlay: Option<Overlay> = None;
    for (k, &time_s) in instants_s.iter().enumerate() {
        let context = context.at(k, instants_s.len());
        context.check()?;
        let request = Request { time_s, ..*request };
        let instant = on_workers(|| instant(field, &request, &context));
        let rendered = match (instant, &mut overlay) {
            (Err(error), Some(_)) if error.may_succeed_at_another_time() => continue,
            (rendered, _) => rendered?,
        };
        if instants_s.len() == 1 {
            return Ok(rendered);
        }
        overlay
            .get_or_insert_with(|| Overlay::like(&rendered, request.options.trail.mode))
            .add(&rendered);
    }
    overlay.map(Overlay::finish).ok_or(RenderError::NothingSeen)
}

/// Renders a view as [`render`] does. Also returns the view's layers at the request's time: its depth map, and the
/// motion of its surfaces if the motion is known.
///
/// # Errors
/// The errors of [`render`].
pub fn render_with_layers(
    field: &LightField,
    request: &Request,
    context: &Context,
) -> Result<(Rendered, Layers), RenderError> {
    let target = match request.from {
        Viewpoint::View(target) if request.options.trail.count() == 1 => {
            let request = Request { detail: Detail::WithMotion, ..*request };
            return on_workers(|| view_with_layers(field, target, &request, context));
        }
        Viewpoint::View(target) => target,
        Viewpoint::Like(camera) => &field.capture().cameras[camera].camera,
    };
    let rendered = render(field, request, context)?;
    Ok((rendered, on_workers(|| layers(field, target, request, context))?))
}

fn instant(
    field: &LightField,
    request: &Request,
    context: &Context,
) -> Result<Rendered, RenderError> {
    match request.from {
        Viewpoint::View(target) => view(field, target, request, context),
        Viewpoint::Like(camera) => {
            let by_flow = match request.uses_scene_flow() {
                true => flow_image(field, camera, request, context)?,
                false => None,
            };
            let image = match by_flow {
                Some(image) => image,
                None => {
                    let method = ImageMethod::new(request.options.sync, request.options);
                    let image = CameraImage { camera, time_s: request.time_s, method: &method };
                    image.get(field, context)?.image.clone()
                }
            };
            let coverage = vec![true; image.width() * image.height()];
            Ok(Rendered { image, coverage })
        }
    }
}

impl LightField {
    /// Renders the view of any camera at `time_s`, seconds from the capture's start, as [`render`] does without a
    /// motion trail.
    ///
    /// # Errors
    /// The errors of [`render`].
    pub fn view(
        &self,
        target: &Camera,
        time_s: f64,
        options: &RenderOptions,
    ) -> Result<Rendered, RenderError> {
        let request = Request::new(Viewpoint::View(target), time_s, options);
        on_workers(|| view(self, target, &request, &Context::unattended()))
    }

    /// Returns the geometry of a view: its depth map, and the depth maps of the cameras from which it is blended.
    ///
    /// # Errors
    /// The errors of [`Self::proxy`].
    pub fn geometry(&self, target: &Camera, request: &Request) -> Result<Geometry, RenderError> {
        on_workers(|| super::geometry::geometry(self, target, request, &Context::unattended()))
    }

    /// Returns the near, the middle and the far depth of the scene in a view along the camera's axis, metres. They are
    /// the 5th, 50th and 95th percentile of the depths of the view's pixels.
    ///
    /// # Errors
    /// The errors of [`Self::proxy`], and [`RenderError::NoPoints`] if no pixel has a finite depth.
    pub fn depth_range_m(
        &self,
        target: &Camera,
        request: &Request,
    ) -> Result<[f64; 3], RenderError> {
        let geometry = self.geometry(target, request)?;
        let mut depths_m: Vec<f32> =
            geometry.view.data().iter().copied().filter(|z| z.is_finite()).collect();
        if depths_m.is_empty() {
            return Err(RenderError::NoPoints);
        }
        depths_m.sort_unstable_by(f32::total_cmp);
        let last = (depths_m.len() - 1) as f64;
        Ok([0.05, 0.5, 0.95].map(|fraction| f64::from(depths_m[(fraction * last) as usize])))
    }
}
