//! Rendering of a view (the paper's Fig. 2): computes the scene's geometry and the cameras' images, and blends them.

use super::camera_image::{image_in, images_of};
use super::geometry::{Geometry, geometry, nearest_cameras};
use super::graph::LightField;
use super::image_motion::Layers;
use super::scene_flow::flow_view;
use super::stages::{CameraImage, CameraImages, ImageMethod, ImageSource, Instant};
use super::{Context, RenderError, Request};
use crate::camera::Camera;
use crate::capture::{Color, FilmedCamera};
use crate::interpolation::Synchronized;
use crate::lumigraph::{BlendMethod, BlendOptions, Rendered, Source, blend, contributing};
use crate::raster::{Image, Tiles};
use crate::scene_flow::{Detail, FlowView};
use rayon::prelude::*;
use std::sync::Arc;

/// Renders the view of the camera `target` at the request's time.
pub(super) fn view(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Rendered, RenderError> {
    view_with_layers(field, target, request, context).map(|(rendered, _)| rendered)
}

/// Renders a view as [`view()`] does, and returns it with its depth map. With [`Detail::WithMotion`], the motion of the
/// view's surfaces is returned too, if the view is rendered by scene flow.
pub(super) fn view_with_layers(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<(Rendered, Layers), RenderError> {
    let &Request { time_s, options, .. } = request;
    if field.usable(time_s).is_empty() {
        return Err(field.no_camera_at(time_s));
    }
    context.check()?;
    if request.uses_scene_flow()
        && let Some(view) = flow_view(field, target, request, context)?
    {
        let FlowView { rendered, depths, motions } = view;
        let is_seen = rendered.coverage.contains(&true);
        let layers = Layers { depths, surfaces: motions };
        return if is_seen { Ok((rendered, layers)) } else { Err(RenderError::NothingSeen) };
    }
    let geometry = geometry(field, target, request, context)?;
    context.check()?;
    let images = images(field, target, request, &geometry, context)?;
    context.check()?;
    let rendered = field.blend(&images, &geometry, target, &options.blend);
    let is_seen = rendered.coverage.contains(&true);
    let layers = Layers { depths: geometry.view, surfaces: None };
    if is_seen { Ok((rendered, layers)) } else { Err(RenderError::NothingSeen) }
}

/// Computes the depth map of a view, and the motion of its surfaces if the view is rendered by scene flow.
pub(super) fn layers(
    field: &LightField,
    target: &Camera,
    request: &Request,
    context: &Context,
) -> Result<Layers, RenderError> {
    let with_motion = Request { detail: Detail::WithMotion, ..*request };
    if request.uses_scene_flow()
        && let Some(view) = flow_view(field, target, &with_motion, context)?
    {
        return Ok(Layers { depths: view.depths, surfaces: view.motions });
    }
    Ok(Layers { depths: geometry(field, target, request, context)?.view, surfaces: None })
}

/// Computes the images from which a view is blended, gain-corrected to the reference camera's exposure. The result has
/// one element per camera: `None` if the view doesn't need the camera's image.
fn images(
    field: &LightField,
    target: &Camera,
    request: &Request,
    geometry: &Geometry,
    context: &Context,
) -> Result<CameraImages, RenderError> {
    let &Request { time_s, options, images, .. } = request;
    let instant = Instant::new(time_s, options);
    let near = nearest_cameras(field, target, time_s, options);
    let candidates = match options.blend.method {
        BlendMethod::SpaceTime => near.clone(),
        BlendMethod::Lumigraph | BlendMethod::Uniform => field.usable(time_s),
    };
    let source = ImageSource::new(images, options);
    let method = match &source {
        ImageSource::Synchronized(method) => &**method,
        ImageSource::Given(_) => {
            let in_time = options.blend.method == BlendMethod::SpaceTime;
            let all = || (0..field.capture().cameras.len()).collect();
            let candidates: Vec<usize> = if in_time { near } else { all() };
            return images_of(field, &source, &candidates, instant, context);
        }
    };
    // The whole images of the nearest cameras are needed, and cached images need no computation. For other cameras,
    // only the tiles that contribute are computed.
    let mut whole = near;
    let is_cached = |&c: &usize| field.cached(&CameraImage { camera: c, time_s, method }).is_some();
    whole.extend(candidates.iter().copied().filter(is_cached));
    whole.retain(|c| candidates.contains(c));
    whole.sort_unstable();
    whole.dedup();
    let mut all = images_of(field, &source, &whole, instant, context)?;
    let missing: Vec<usize> = candidates.into_iter().filter(|&c| all[c].is_none()).collect();
    if missing.is_empty() {
        return Ok(all);
    }
    for &c in &missing {
        all[c] = Some(Arc::new(Synchronized::filmed(blank(&field.capture().cameras[c]))));
    }
    let needed = needed(field, &all, geometry, target, &options.blend);
    let gains = field.gains(&options.registration);
    let with_error = options.blend.method == BlendMethod::SpaceTime;
    let method = &ImageMethod { with_error, ..method.clone() };
    let partial = |(c, parts): &(usize, Tiles)| {
        let image = CameraImage { camera: *c, time_s, method };
        let mut filmed = image_in(field, &image, Some(parts), context)?;
        if let Some(image) = gains.corrected(*c, field.own_time_s(*c, time_s), &filmed.image) {
            filmed.image = image;
        }
        Ok((*c, Arc::new(filmed)))
    };
    let needed = needed.par_iter().filter(|(c, _)| missing.contains(c)).map(partial);
    for (c, image) in needed.collect::<Result<Vec<_>, RenderError>>()? {
        all[c] = Some(image);
    }
    Ok(all)
}

/// Returns the indices of the cameras that contribute to a view, each with the contributing tiles of its image. In a
/// large rig, most cameras have weight 0 everywhere in the view.
fn needed(
    field: &LightField,
    images: &CameraImages,
    geometry: &Geometry,
    target: &Camera,
    options: &BlendOptions,
) -> Vec<(usize, Tiles)> {
    let sources = sources(field, images, geometry, options.method);
    let needed = contributing(&sources, &geometry.view, target, options);
    let cameras = (0..images.len()).filter(|&c| images[c].is_some());
    cameras.zip(needed).filter(|(_, parts)| parts.any()).collect()
}

impl LightField {
    /// Blends a view from one image per camera, in the capture's order. The images must be gain-corrected to the
    /// reference camera's exposure. `None`: the camera has no image.
    pub fn blend(
        &self,
        images: &[Option<Arc<Synchronized>>],
        geometry: &Geometry,
        target: &Camera,
        options: &BlendOptions,
    ) -> Rendered {
        blend(&sources(self, images, geometry, options.method), &geometry.view, target, options)
    }
}

/// Returns a black image with a camera's size and number of channels.
fn blank(filmed: &FilmedCamera) -> Image {
    let channels = if filmed.color == Color::Gray { 1 } else { 3 };
    Image::filled(filmed.camera.width, filmed.camera.height, channels, 0.0)
}

/// Returns the inputs of a blend: all cameras that have an image. Interpolation errors are included only for
/// [`BlendMethod::SpaceTime`].
fn sources<'a>(
    field: &'a LightField,
    images: &'a [Option<Arc<Synchronized>>],
    geometry: &'a Geometry,
    method: BlendMethod,
) -> Vec<Source<'a>> {
    let source = |camera: usize| {
        let Synchronized { image, interpolation_error_px } = images[camera].as_deref()?;
        let interpolation_error_px =
            interpolation_error_px.as_deref().filter(|_| method == BlendMethod::SpaceTime);
        let depth = geometry.sources[camera].as_deref();
        Some(Source {
            camera: &field.capture().cameras[camera].camera,
            image,
            depth,
            interpolation_error_px,
        })
    };
    (0..images.len()).filter_map(source).collect()
}
