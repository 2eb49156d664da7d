//! Many views of one instant: what doesn't depend on the viewpoint is computed once.

use super::geometry::{CameraDepths, sampled};
use super::points::nearest;
use super::{Geometry, LightField, RenderError};
use crate::camera::Camera;
use crate::host::on_workers;
use crate::interpolation::Synchronized;
use crate::lumigraph::{BlendMethod, DepthMap, Rendered};
use crate::options::{ProxyMethod, ViewOptions};
use crate::raster::Image;
use crate::stereo::fuse;
use std::borrow::Cow;
use std::ops::Deref;
use std::sync::Arc;

/// What the depths of a pixel of a camera take, bytes: as they are estimated, and as a map, each with a
/// standard error. Larger: caches hold fewer instants than they could; smaller: more memory than they are to.
const DEPTH_BYTES: usize = 16;

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
type Shared = (Vec<Option<Synchronized>>, Option<Depths>);

/// Depths of all cameras.
struct Depths {
    estimated: CameraDepths,
    in_cameras: Vec<Option<Arc<DepthMap>>>,
}

impl LightField {
    /// All cameras' images at a time, and their depths if the options want them.
    ///
    /// # Errors
    /// [`RenderError::Time`] or [`RenderError::NoClock`] if no camera has an image at that time, and those
    /// of [`Self::synchronized`].
    pub fn moment(&self, time_s: f64, options: &ViewOptions) -> Result<Moment<'_>, RenderError> {
        self.moment_while(time_s, options, &|| true)
    }

    /// [`Self::moment`], as long as `proceed` says so: it is asked before every camera's image, and
    /// before the depths.
    ///
    /// # Errors
    /// Those of [`Self::moment`], and [`RenderError::Stopped`].
    pub fn moment_while(
        &self,
        time_s: f64,
        options: &ViewOptions,
        proceed: &(dyn Fn() -> bool + Sync),
    ) -> Result<Moment<'_>, RenderError> {
        let (images, depths) = on_workers(|| self.shared(time_s, options, proceed))?;
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
        let (images, depths) = on_workers(|| self.shared(time_s, options, &|| true))?;
        let field = Held::Shared(self);
        Ok(Moment { field, time_s, options: options.clone(), images, depths })
    }

    fn shared(
        &self,
        time_s: f64,
        options: &ViewOptions,
        proceed: &(dyn Fn() -> bool + Sync),
    ) -> Result<Shared, RenderError> {
        let usable = self.usable(time_s);
        if usable.is_empty() {
            return Err(self.no_camera_at(time_s));
        }
        let images = self.synchronized_all_while(time_s, options, proceed)?;
        if !proceed() {
            return Err(RenderError::Stopped);
        }
        let images = match self.corrected(&images) {
            Cow::Owned(corrected) => corrected,
            Cow::Borrowed(_) => images,
        };
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
        self.view_by(target, &self.options)
    }

    /// The same images, by the proxy and the blend of other options.
    ///
    /// # Errors
    /// Those of [`Self::view`].
    pub fn view_by(&self, target: &Camera, options: &ViewOptions) -> Result<Rendered, RenderError> {
        on_workers(|| {
            let geometry = self.geometry_by(target, options)?;
            let images = self.candidates(target, options);
            let rendered = self.field.blend_corrected(&images, &geometry, target, &options.blend);
            let is_seen = rendered.coverage.contains(&true);
            if is_seen { Ok(rendered) } else { Err(RenderError::NothingSeen) }
        })
    }

    /// The images that a view is blended from.
    fn candidates(
        &self,
        target: &Camera,
        options: &ViewOptions,
    ) -> Cow<'_, [Option<Synchronized>]> {
        if options.blend.method != BlendMethod::SpaceTime {
            return Cow::Borrowed(&self.images);
        }
        let mut images = self.images.clone();
        self.field.keep_candidates(&mut images, target, self.time_s, options);
        Cow::Owned(images)
    }

    /// Which cameras the pixels of [`Self::view_by`] come from: that view with every camera's image replaced by a colour,
    /// RGB of 0 to 1, in the capture's order. A pixel's colour is the mean of theirs by the camera's weights.
    ///
    /// # Errors
    /// Those of [`Self::geometry`].
    ///
    /// # Panics
    /// If there are fewer colours than cameras.
    pub fn sources(
        &self,
        target: &Camera,
        options: &ViewOptions,
        colors: &[[f32; 3]],
    ) -> Result<Rendered, RenderError> {
        let geometry = self.geometry_by(target, options)?;
        let tinted = |(image, color): (&Option<Synchronized>, &[f32; 3])| {
            let Synchronized { image, interpolation_error_px } = image.as_ref()?;
            let (width, height) = (image.width(), image.height());
            let image = Image::from_data(width, height, 3, color.repeat(width * height));
            Some(Synchronized { image, interpolation_error_px: interpolation_error_px.clone() })
        };
        assert!(colors.len() >= self.images.len(), "a colour for each camera");
        let images = self.candidates(target, options);
        let tinted: Vec<_> = images.iter().zip(colors).map(tinted).collect();
        Ok(self.field.blend_corrected(&tinted, &geometry, target, &options.blend))
    }

    /// About how much memory it holds, bytes.
    pub fn bytes(&self) -> usize {
        let of_image = |s: &Synchronized| {
            size_of_val(s.image.data()) + s.interpolation_error_px.as_deref().map_or(0, size_of_val)
        };
        let pixels = |s: &Synchronized| s.image.width() * s.image.height();
        let depths = |s: &Synchronized| self.depths.as_ref().map_or(0, |_| DEPTH_BYTES * pixels(s));
        self.images.iter().flatten().map(|s| of_image(s) + depths(s)).sum()
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
        on_workers(|| self.geometry_by(target, &self.options))
    }

    fn geometry_by(&self, target: &Camera, options: &ViewOptions) -> Result<Geometry, RenderError> {
        let depths = self.depths.as_ref().filter(|_| options.proxy.method == ProxyMethod::Depth);
        if let Some(Depths { estimated, in_cameras }) = depths {
            let cameras = &self.field.capture().cameras;
            let mut near = nearest(cameras, &self.field.usable(self.time_s), target);
            near.truncate(options.proxy.depth.cameras);
            let surfaces = self.field.surfaces(estimated, |c| near.contains(&c));
            if !surfaces.is_empty() {
                let view = fuse(target, &surfaces);
                return Ok(Geometry { view, sources: in_cameras.clone() });
            }
        }
        let proxy = self.field.proxy(target, self.time_s, options)?;
        Ok(Geometry { view: proxy.depth_map(target), sources: vec![None; self.images.len()] })
    }
}
