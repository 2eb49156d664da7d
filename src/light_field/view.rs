//! A view (Fig. 2): the synchronized images that it is blended from, the scene's shape, the blend.

use super::{LightField, RenderError};
use crate::camera::Camera;
use crate::capture::Color;
use crate::lumigraph::{BlendOptions, DepthMap, Proxy, Rendered, Source, blend, contributing};
use crate::options::ViewOptions;
use crate::raster::{Image, Tiles};
use rayon::prelude::*;

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
        if self.usable(time_s).is_empty() {
            return Err(self.no_camera_at(time_s));
        }
        let depth = self.proxy(target, time_s, options)?.depth_map(target);
        let mut images = self.blanks(time_s);
        let needed = self.needed(&images, &depth, target, &options.blend);
        self.synchronize(&mut images, &needed, time_s, options)?;
        let rendered = self.blend_by_depth(&images, &depth, target, &options.blend);
        if rendered.coverage.iter().any(|c| *c) {
            Ok(rendered)
        } else {
            Err(RenderError::NothingSeen)
        }
    }

    /// Black images of the cameras that can give one at a time.
    pub(crate) fn blanks(&self, time_s: f64) -> Vec<Option<Image>> {
        let mut images = vec![None; self.times_s.len()];
        for c in self.usable(time_s) {
            images[c] = Some(self.blank(c));
        }
        images
    }

    /// The cameras, of those with an image, that a view is blended from, and which parts of their
    /// images: most of a large rig are nowhere among the best.
    pub(crate) fn needed(
        &self,
        images: &[Option<Image>],
        depth: &DepthMap,
        target: &Camera,
        options: &BlendOptions,
    ) -> Vec<(usize, Tiles)> {
        let needed = contributing(&self.sources(images), depth, target, options);
        let sources = (0..images.len()).filter(|&c| images[c].is_some());
        sources.zip(needed).filter(|(_, parts)| parts.any()).collect()
    }

    /// Puts parts of these cameras' images at a time among `images`.
    pub(crate) fn synchronize(
        &self,
        images: &mut [Option<Image>],
        needed: &[(usize, Tiles)],
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<(), RenderError> {
        let of =
            |(c, parts): &(usize, Tiles)| self.synchronized_in(*c, time_s, options, Some(parts));
        let synchronized: Vec<Image> = needed.par_iter().map(of).collect::<Result<_, _>>()?;
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
        images: &[Option<Image>],
        proxy: &Proxy,
        target: &Camera,
        options: &BlendOptions,
    ) -> Rendered {
        self.blend_by_depth(images, &proxy.depth_map(target), target, options)
    }

    pub(crate) fn blend_by_depth(
        &self,
        images: &[Option<Image>],
        depth: &DepthMap,
        target: &Camera,
        options: &BlendOptions,
    ) -> Rendered {
        let gains = self.frames.gains();
        let corrected: Option<Vec<Option<Image>>> = (!gains.are_equal()).then(|| {
            let correct = |(camera, image): (usize, &Option<Image>)| {
                let image = image.as_ref()?;
                Some(gains.corrected(camera, image).unwrap_or_else(|| image.clone()))
            };
            images.par_iter().enumerate().map(correct).collect()
        });
        let images = corrected.as_deref().unwrap_or(images);
        blend(&self.sources(images), depth, target, options)
    }

    /// The cameras that have an image.
    fn sources<'a>(&'a self, images: &'a [Option<Image>]) -> Vec<Source<'a>> {
        let cameras = self.capture().cameras.iter().zip(images);
        let sources =
            cameras.filter_map(|(c, image)| Some(Source::new(&c.camera, image.as_ref()?)));
        sources.collect()
    }
}
