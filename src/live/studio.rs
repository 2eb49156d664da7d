//! Renders the requested pictures of a light field.

use super::encode::{Colors, encode, encode_saved};
use super::true_views::TrueViews;
use super::{Level, LiveError, PictureMethod, PictureRequest, RigFrame};
use crate::camera::Camera;
use crate::compare::TRADITIONAL;
use crate::interpolation::SyncMethod;
use crate::light_field::{
    Context, GivenImages, Images, LightField, RenderError, Request, Viewpoint, render,
};
use crate::lumigraph::Rendered;
use crate::method::Method as _;
use crate::options::{Preset, RenderOptions, TrailOptions};
use crate::progress::Reporter;
use crate::raster::luma;
use std::sync::Arc;

/// Opacity of the cameras' colours over the picture, in 0..=1.
const TINT: f32 = 0.5;

/// Returns whether to continue: a viewer may have sent a newer request.
pub(super) type Proceed<'p> = &'p (dyn Fn() -> bool + Sync);

/// An encoded picture.
pub struct Picture {
    /// A PNG file.
    pub bytes: Vec<u8>,
    /// The methods that made it, such as `refined, mesh`; empty for the truth.
    pub made_by: String,
}

/// Renders pictures of a light field and of its truth.
pub struct Studio<'a> {
    pub(super) field: &'a LightField,
    pub(super) rig: Arc<RigFrame>,
    pub(super) truth: TrueViews,
    pub(super) colors: Colors,
    /// The command-line arguments that give the options, which the page shows.
    pub(super) words: Vec<String>,
    full: RenderOptions,
    quick: RenderOptions,
}

impl<'a> Studio<'a> {
    /// A studio for a light field. `options` are for pictures at rest; every `auto` is already replaced by a method.
    /// `words` are the command-line arguments that give these options. If the truth can't be read, a note is shown, and
    /// there are no true pictures. Trails are not shown.
    pub fn new(
        field: &'a LightField,
        options: &RenderOptions,
        words: Vec<String>,
        reporter: &Reporter,
    ) -> Self {
        let capture = field.capture();
        let truth = TrueViews::open(capture).unwrap_or_else(|error| {
            reporter.note(&format!("The truth is left out: {error}."));
            TrueViews::default()
        });
        let true_cameras = truth.views.iter().map(|view| view.camera.clone()).collect();
        let rig = RigFrame::new(capture, field.spacing_m(), true_cameras);
        let colors = Colors::of(&rig.places());
        let full = RenderOptions { trail: TrailOptions::default(), ..options.clone() };
        let quick = Preset::Draft.options();
        Self { field, rig: Arc::new(rig), truth, colors, words, full, quick }
    }

    fn options(&self, level: Level) -> &RenderOptions {
        if level == Level::Quick { &self.quick } else { &self.full }
    }

    /// The time of a request, seconds from the capture's start.
    fn time_s(&self, request: &PictureRequest) -> f64 {
        request.time_s - self.field.capture().time_origin_s
    }

    /// Renders and encodes a picture, as long as `proceed` returns true.
    ///
    /// # Errors
    /// The errors of [`RigFrame::camera`] and of rendering, and [`LiveError::Superseded`].
    pub(super) fn picture(
        &self,
        request: &PictureRequest,
        proceed: Proceed,
    ) -> Result<Picture, LiveError> {
        let target = self.rig.camera(request)?;
        let (rendered, made_by) = match request.method {
            PictureMethod::Truth => (self.truth.view(request, &target)?, String::new()),
            _ => {
                let proceed = |_, _| proceed();
                let (rendered, sync) =
                    match self.rendered(request, &target, &Context::new(&proceed)) {
                        Err(RenderError::Stopped) => return Err(LiveError::Superseded),
                        rendered => rendered?,
                    };
                let proxy = self.options(request.level).proxy.method;
                (rendered, format!("{}, {}", sync.name(), proxy.name()))
            }
        };
        let bytes = match request.level {
            Level::Quick | Level::Full => encode(&rendered),
            Level::Saved => encode_saved(&rendered, self.field.capture().bit_depth()),
        };
        Ok(Picture { bytes: bytes.map_err(LiveError::Request)?, made_by })
    }

    /// A picture of the light field, and the sync method of the images that it is blended from. A quick picture is
    /// blended from the images of full quality if they are cached.
    fn rendered(
        &self,
        request: &PictureRequest,
        target: &Camera,
        context: &Context,
    ) -> Result<(Rendered, SyncMethod), RenderError> {
        let &PictureRequest { method, level, .. } = request;
        let time_s = self.time_s(request);
        let options = self.options(level);
        let view = Request::new(Viewpoint::View(target), time_s, options);
        if method == PictureMethod::Traditional {
            // No depth can be estimated from frames of different instants, so that the depth is that of ST-LFR. A
            // saved picture is as `stlfr render --sync nearest` renders it.
            let shape = if level == Level::Saved { TRADITIONAL } else { options.sync };
            let nearest = RenderOptions { sync: TRADITIONAL, ..options.clone() };
            let [images, shape] = [TRADITIONAL, shape].map(Images::By);
            let view = Request { options: &nearest, images, shape, ..view };
            return Ok((render(self.field, &view, context)?, TRADITIONAL));
        }
        let is_quick = level == Level::Quick;
        let cached = is_quick.then(|| self.field.cached_instant(time_s, &self.full)).flatten();
        match (method, cached) {
            (PictureMethod::Sources, Some(images)) => {
                Ok((self.tinted(&view, &images, context)?, self.full.sync))
            }
            (PictureMethod::Sources, None) => {
                // Weights hardly depend on the images, so that the nearest frames will do beneath the colours.
                let sync = if is_quick { TRADITIONAL } else { self.full.sync };
                let options = RenderOptions { sync, ..self.full.clone() };
                let images = self.field.corrected_all(time_s, &options, context)?;
                Ok((self.tinted(&view, &images, context)?, sync))
            }
            (_, Some(images)) => {
                let view = Request { images: Images::Given(&images), ..view };
                Ok((render(self.field, &view, context)?, self.full.sync))
            }
            (_, None) => Ok((render(self.field, &view, context)?, options.sync)),
        }
    }

    /// A grey view of these images, tinted with the colours of the cameras that each pixel is blended from.
    fn tinted(
        &self,
        view: &Request,
        images: &GivenImages,
        context: &Context,
    ) -> Result<Rendered, RenderError> {
        let tinted = images.with_colors(self.colors.rgb());
        let of = |images| {
            let request = Request { images: Images::Given(images), ..*view };
            render(self.field, &request, context)
        };
        let mut view = of(images)?;
        let shown = view.image.to_rgb();
        view.image = of(&tinted)?.image;
        let pixels = view.image.data_mut().chunks_exact_mut(3);
        for (pixel, shown) in pixels.zip(shown.data().chunks_exact(3)) {
            let gray = luma(shown);
            pixel.iter_mut().for_each(|v| *v = gray * (1.0 - TINT) + *v * TINT);
        }
        Ok(view)
    }

    /// Computes the cameras' images at the instant of a picture beforehand, so that views of this instant are quick.
    /// Stops when `proceed` returns false. Errors are ignored: they show when a picture is requested.
    pub(super) fn prepare(&self, request: &PictureRequest, proceed: Proceed) {
        let sync = match request.method {
            PictureMethod::Truth => return,
            PictureMethod::SpaceTime | PictureMethod::Sources => self.full.sync,
            PictureMethod::Traditional => TRADITIONAL,
        };
        let options = RenderOptions { sync, ..self.full.clone() };
        let time_s = self.time_s(request);
        let _ = self.field.synchronized_all(time_s, &options, &Context::new(&|_, _| proceed()));
    }
}
