//! A view (Fig. 2): the synchronized images that it is blended from, the scene's shape, the blend.

use super::{Geometry, LightField, RenderError};
use crate::camera::Camera;
use crate::capture::{Color, FilmedCamera};
use crate::host::on_workers;
use crate::interpolation::Synchronized;
use crate::lumigraph::{BlendOptions, DepthMap, Rendered, Source, blend, contributing};
use crate::options::ViewOptions;
use crate::raster::{Image, Tiles};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

impl LightField {
    /// The view from anywhere at a time.
    ///
    /// # Errors
    /// [`RenderError::Time`] or [`RenderError::NoClock`] if no camera has an image at that time,
    /// those of [`Self::proxy`], and [`RenderError::NothingSeen`] if no pixel is covered.
    pub fn view(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Rendered, RenderError> {
        on_workers(|| self.view_while(target, time_s, options, &mut || true))
    }

    /// [`Self::view`]; ends with [`RenderError::Stopped`] where `proceed` returns false, which is called
    /// between its steps.
    pub(crate) fn view_while(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
        proceed: &mut dyn FnMut() -> bool,
    ) -> Result<Rendered, RenderError> {
        let mut go_on = || if proceed() { Ok(()) } else { Err(RenderError::Stopped) };
        if self.usable(time_s).is_empty() {
            return Err(self.no_camera_at(time_s));
        }
        let mut images = self.blanks(time_s);
        let whole = self.synchronize_geometry(&mut images, target, time_s, options)?;
        go_on()?;
        self.keep_candidates(&mut images, target, time_s, options);
        let geometry = self.geometry(&images, target, time_s, options)?;
        let mut needed = self.needed(&images, &geometry, target, &options.blend);
        needed.retain(|(c, _)| !whole.contains(c));
        go_on()?;
        self.synchronize(&mut images, &needed, time_s, options)?;
        go_on()?;
        let rendered = self.blend(&images, &geometry, target, &options.blend);
        if rendered.coverage.iter().any(|c| *c) {
            Ok(rendered)
        } else {
            Err(RenderError::NothingSeen)
        }
    }

    /// Black images of the cameras that can give one at a time.
    pub(crate) fn blanks(&self, time_s: f64) -> Vec<Option<Synchronized>> {
        let mut images = vec![None; self.times_s.len()];
        for c in self.usable(time_s) {
            images[c] = Some(Synchronized::filmed(self.blank(c)));
        }
        images
    }

    /// Puts the images that the geometry is estimated from among `images`; which cameras' they are.
    pub(crate) fn synchronize_geometry(
        &self,
        images: &mut [Option<Synchronized>],
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Vec<usize>, RenderError> {
        let cameras = self.geometry_cameras(target, time_s, options);
        self.share_joint(&cameras, time_s, options)?;
        let of = |c: &usize| self.synchronized(*c, time_s, options);
        let synchronized: Vec<Synchronized> =
            cameras.par_iter().map(of).collect::<Result<_, _>>()?;
        for (&c, image) in cameras.iter().zip(synchronized) {
            images[c] = Some(image);
        }
        Ok(cameras)
    }

    /// The cameras, of those with an image, that a view is blended from, and which parts of their
    /// images: most of a large rig are nowhere among the best.
    pub(crate) fn needed(
        &self,
        images: &[Option<Synchronized>],
        geometry: &Geometry,
        target: &Camera,
        options: &BlendOptions,
    ) -> Vec<(usize, Tiles)> {
        let sources = self.sources(images, geometry);
        let needed = contributing(&sources, &geometry.view, target, options);
        let sources = (0..images.len()).filter(|&c| images[c].is_some());
        sources.zip(needed).filter(|(_, parts)| parts.any()).collect()
    }

    /// Puts parts of these cameras' images at a time among `images`.
    pub(crate) fn synchronize(
        &self,
        images: &mut [Option<Synchronized>],
        needed: &[(usize, Tiles)],
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<(), RenderError> {
        let of =
            |(c, parts): &(usize, Tiles)| self.synchronized_in(*c, time_s, options, Some(parts));
        let synchronized: Vec<Synchronized> =
            needed.par_iter().map(of).collect::<Result<_, _>>()?;
        for ((c, _), image) in needed.iter().zip(synchronized) {
            images[*c] = Some(image);
        }
        Ok(())
    }

    /// A black image of a camera's kind.
    fn blank(&self, camera: usize) -> Image {
        let filmed = &self.capture().cameras[camera];
        let channels = if filmed.color == Color::Gray { 1 } else { 3 };
        Image::filled(filmed.camera.width, filmed.camera.height, channels, 0.0)
    }

    /// Blends a view from one image a camera, as filmed, in the capture's order (`None`: the camera
    /// has none). The view is as bright as the reference records it.
    pub fn blend(
        &self,
        images: &[Option<Synchronized>],
        geometry: &Geometry,
        target: &Camera,
        options: &BlendOptions,
    ) -> Rendered {
        self.blend_corrected(&self.corrected(images), geometry, target, options)
    }

    /// The same from images as bright as the reference records them.
    pub(super) fn blend_corrected(
        &self,
        images: &[Option<Synchronized>],
        geometry: &Geometry,
        target: &Camera,
        options: &BlendOptions,
    ) -> Rendered {
        blend(&self.sources(images, geometry), &geometry.view, target, options)
    }

    /// The images as bright as the reference records them.
    pub(super) fn corrected<'a>(
        &self,
        images: &'a [Option<Synchronized>],
    ) -> Cow<'a, [Option<Synchronized>]> {
        let gains = self.gains();
        if gains.are_equal() {
            return Cow::Borrowed(images);
        }
        let correct = |(camera, image): (usize, &Option<Synchronized>)| {
            let s = image.as_ref()?;
            let image = gains.corrected(camera, &s.image).unwrap_or_else(|| s.image.clone());
            Some(Synchronized { image, interpolation_error_px: s.interpolation_error_px.clone() })
        };
        Cow::Owned(images.par_iter().enumerate().map(correct).collect())
    }

    /// The cameras that have an image.
    fn sources<'a>(
        &'a self,
        images: &'a [Option<Synchronized>],
        geometry: &'a Geometry,
    ) -> Vec<Source<'a>> {
        let cameras = self.capture().cameras.iter().zip(images).zip(&geometry.sources);
        let source =
            |((filmed, image), depth): ((&'a FilmedCamera, _), &'a Option<Arc<DepthMap>>)| {
                let Synchronized { image, interpolation_error_px }: &Synchronized =
                    Option::as_ref(image)?;
                let (depth, interpolation_error_px) =
                    (depth.as_deref(), interpolation_error_px.as_deref());
                Some(Source { camera: &filmed.camera, image, depth, interpolation_error_px })
            };
        cameras.filter_map(source).collect()
    }
}
