//! Many views of one instant: what doesn't depend on the viewpoint is computed once.

use super::geometry::{CameraDepths, sampled};
use super::points::nearest;
use super::{Geometry, LightField, RenderError};
use crate::camera::Camera;
use crate::interpolation::Synchronized;
use crate::lumigraph::{DepthMap, Rendered};
use crate::options::{ProxyMethod, ViewOptions};
use crate::stereo::fuse;
use std::ops::Deref;
use std::sync::Arc;

/// A light field at one instant, for views from anywhere.
///
/// Its views are those of [`LightField::view`], byte by byte, over a plane and a mesh. With depth per pixel they
/// differ: a `Moment` estimates every camera's depths in one common range, and a view takes those of the cameras
/// nearest to it.
pub struct Moment<'a> {
    field: Held<'a>,
    time_s: f64,
    options: ViewOptions,
    /// Of all cameras, as bright as the reference records them.
    images: Vec<Option<Synchronized>>,
    depths: Option<Depths>,
}

/// The light field of a moment.
enum Held<'a> {
    Borrowed(&'a LightField),
    Shared(Arc<LightField>),
}

impl Deref for Held<'_> {
    type Target = LightField;

    fn deref(&self) -> &LightField {
        match self {
            Self::Borrowed(field) => field,
            Self::Shared(field) => field,
        }
    }
}

/// What all views of an instant share: the cameras' images, and their depths if the options want them.
type Prepared = (Vec<Option<Synchronized>>, Option<Depths>);

/// Depths of all cameras.
struct Depths {
    estimated: CameraDepths,
    in_cameras: Vec<Option<DepthMap>>,
}

impl LightField {
    /// All cameras' images at a time, and their depths if the options want them.
    ///
    /// # Errors
    /// [`RenderError::Time`] or [`RenderError::NoClock`] if no camera has an image at that time, and those
    /// of [`Self::synchronized`].
    pub fn moment(&self, time_s: f64, options: &ViewOptions) -> Result<Moment<'_>, RenderError> {
        let (images, depths) = self.prepared(time_s, options)?;
        let field = Held::Borrowed(self);
        Ok(Moment { field, time_s, options: options.clone(), images, depths })
    }

    /// [`Self::moment`] that keeps the light field alive.
    ///
    /// # Errors
    /// Those of [`Self::moment`].
    pub fn shared_moment(
        self: Arc<Self>,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Moment<'static>, RenderError> {
        let (images, depths) = self.prepared(time_s, options)?;
        let field = Held::Shared(self);
        Ok(Moment { field, time_s, options: options.clone(), images, depths })
    }

    fn prepared(&self, time_s: f64, options: &ViewOptions) -> Result<Prepared, RenderError> {
        let usable = self.usable(time_s);
        if usable.is_empty() {
            return Err(self.no_camera_at(time_s));
        }
        let images = self.synchronized_all(time_s, options)?;
        let images = self.corrected(&images).into_owned();
        let depths = match options.proxy.method {
            ProxyMethod::Depth => self.depths_of_all(&usable, &images, time_s, options)?,
            ProxyMethod::Plane | ProxyMethod::Mesh => None,
        };
        Ok((images, depths))
    }

    /// `None` with fewer than two cameras, or if no point of the scene is known.
    fn depths_of_all(
        &self,
        cameras: &[usize],
        images: &[Option<Synchronized>],
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Option<Depths>, RenderError> {
        if cameras.len() < 2 {
            return Ok(None);
        }
        let filmed = &self.capture().cameras;
        let middle = nearest(filmed, cameras, &filmed[self.capture().reference].camera)[0];
        let middle = &filmed[middle].camera;
        let points = match self.proxy(middle, time_s, options) {
            Ok(proxy) => sampled(&proxy.depth_map(middle), middle),
            Err(RenderError::NoPoints | RenderError::NothingSeen) => return Ok(None),
            Err(error) => return Err(error),
        };
        let estimated = self.estimated(images, (cameras, cameras.len()), &points, options);
        Ok(estimated.map(|estimated| {
            let in_cameras = self.in_cameras(&estimated, &self.surfaces(&estimated, |_| true));
            Depths { estimated, in_cameras }
        }))
    }
}

impl Moment<'_> {
    /// The view from anywhere.
    ///
    /// # Errors
    /// Those of [`LightField::proxy`], and [`RenderError::NothingSeen`] if no pixel is covered.
    pub fn view(&self, target: &Camera) -> Result<Rendered, RenderError> {
        let geometry = self.geometry(target)?;
        let rendered =
            self.field.blend_corrected(&self.images, &geometry, target, &self.options.blend);
        if rendered.coverage.contains(&true) { Ok(rendered) } else { Err(RenderError::NothingSeen) }
    }

    /// The images of all cameras, in the capture's order, as bright as the reference records them.
    pub fn images(&self) -> &[Option<Synchronized>] {
        &self.images
    }

    /// The scene's shape as a view needs it.
    ///
    /// # Errors
    /// Those of [`LightField::proxy`].
    pub fn geometry(&self, target: &Camera) -> Result<Geometry, RenderError> {
        if let Some(Depths { estimated, in_cameras }) = &self.depths {
            let cameras = &self.field.capture().cameras;
            let mut near = nearest(cameras, &self.field.usable(self.time_s), target);
            near.truncate(self.options.proxy.depth.cameras);
            let surfaces = self.field.surfaces(estimated, |c| near.contains(&c));
            if !surfaces.is_empty() {
                let view = fuse(target, &surfaces);
                return Ok(Geometry { view, sources: in_cameras.clone() });
            }
        }
        let proxy = self.field.proxy(target, self.time_s, &self.options)?;
        Ok(Geometry { view: proxy.depth_map(target), sources: vec![None; self.images.len()] })
    }
}
