//! Renders the requested pictures of a light field.

use super::encode::{Colors, encode, encode_saved};
use super::true_views::TrueViews;
use super::{Level, LiveError, PictureMethod, PictureRequest, Places};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::compare::TRADITIONAL;
use crate::interpolation::SyncMethod;
use crate::light_field::{Context, Images, LightField, RenderError, Request, Viewpoint, render};
use crate::lumigraph::Rendered;
use crate::method::Method as _;
use crate::options::{Preset, RenderOptions, TrailOptions};
use crate::progress::Reporter;
use crate::raster::luma;
use std::sync::Arc;
use std::time::Instant;

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
    /// Rendering time, seconds.
    pub seconds: f64,
}

/// A request in the light field's terms.
struct Asked<'p> {
    target: &'p Camera,
    /// Seconds from the capture's start.
    time_s: f64,
    level: Level,
    context: Context<'p>,
}

/// Renders pictures of a light field and of its truth.
pub struct Studio<'a> {
    field: &'a LightField,
    places: Arc<Places>,
    truth: TrueViews,
    full: RenderOptions,
    quick: RenderOptions,
    colors: Colors,
    words: Vec<String>,
}

impl<'a> Studio<'a> {
    /// Of a light field, with the options of pictures at rest, in which nothing is left to the capture. A truth
    /// that can't be read is noted, and left out. Trails are not shown.
    pub fn new(field: &'a LightField, options: &RenderOptions, reporter: &Reporter) -> Self {
        let capture = field.capture();
        let truth = TrueViews::open(capture).unwrap_or_else(|error| {
            reporter.note(&format!("The truth is left out: {error}."));
            TrueViews::default()
        });
        let true_cameras = truth.all().iter().map(|view| view.camera.clone()).collect();
        let places = Places::new(capture, field.spacing_m(), true_cameras);
        let colors = Colors::of(&places.rig().places());
        Self {
            field,
            places: Arc::new(places),
            truth,
            full: RenderOptions { trail: TrailOptions::default(), ..options.clone() },
            quick: Preset::Draft.options(),
            colors,
            words: Vec::new(),
        }
    }

    /// Sets the command-line words of the options, which the page shows.
    #[must_use]
    pub fn with_words(self, words: Vec<String>) -> Self {
        Self { words, ..self }
    }

    pub(super) fn words(&self) -> &[String] {
        &self.words
    }

    pub fn field(&self) -> &LightField {
        self.field
    }

    pub fn capture(&self) -> &Capture {
        self.field.capture()
    }

    pub fn places(&self) -> &Arc<Places> {
        &self.places
    }

    pub(super) fn truth(&self) -> &TrueViews {
        &self.truth
    }

    pub(super) fn colors(&self) -> &Colors {
        &self.colors
    }

    fn options(&self, level: Level) -> &RenderOptions {
        match level {
            Level::Quick => &self.quick,
            Level::Full | Level::Saved => &self.full,
        }
    }

    /// Renders and encodes a picture, as long as `proceed` returns true.
    ///
    /// # Errors
    /// Those of [`Places::camera`], those of rendering, and [`LiveError::Superseded`].
    pub fn picture(
        &self,
        request: &PictureRequest,
        proceed: Proceed,
    ) -> Result<Picture, LiveError> {
        let start = Instant::now();
        let target = self.places.camera(request)?;
        let (rendered, sync) = match self.rendered(request, &target, proceed) {
            Err(LiveError::Render(RenderError::Stopped)) => return Err(LiveError::Superseded),
            rendered => rendered?,
        };
        let proxy = self.options(request.level).proxy.method;
        let made_by = sync.map(|s| format!("{}, {}", s.name(), proxy.name())).unwrap_or_default();
        let bytes = match request.level {
            Level::Quick | Level::Full => encode(&rendered),
            Level::Saved => encode_saved(&rendered, self.capture().bit_depth()),
        };
        let bytes = bytes.map_err(LiveError::Request)?;
        Ok(Picture { bytes, made_by, seconds: start.elapsed().as_secs_f64() })
    }

    /// The picture, and how its images were synchronized; `None` for the truth.
    fn rendered(
        &self,
        request: &PictureRequest,
        target: &Camera,
        proceed: Proceed,
    ) -> Result<(Rendered, Option<SyncMethod>), LiveError> {
        let time_s = request.time_s - self.capture().time_origin_s;
        let proceed = |_, _| proceed();
        let context = Context::new(&proceed);
        let asked = Asked { target, time_s, level: request.level, context };
        let (rendered, sync) = match request.method {
            PictureMethod::Truth => return Ok((self.truth.view(request, target)?, None)),
            PictureMethod::SpaceTime => self.view(&asked)?,
            PictureMethod::Traditional => (self.traditional(&asked)?, TRADITIONAL),
            PictureMethod::Sources => self.tinted(&asked)?,
        };
        Ok((rendered, Some(sync)))
    }

    /// Computes the cameras' images at the instant of a picture, so that views of it are quick, as long as `proceed`
    /// returns true. An error shows when the picture is asked for.
    pub fn prepare(&self, request: &PictureRequest, proceed: Proceed) {
        let sync = match request.method {
            PictureMethod::Truth => return,
            PictureMethod::SpaceTime | PictureMethod::Sources => self.full.sync,
            PictureMethod::Traditional => TRADITIONAL,
        };
        let time_s = request.time_s - self.capture().time_origin_s;
        let options = RenderOptions { sync, ..self.full.clone() };
        let _ = self.field.synchronized_all(time_s, &options, &Context::new(&|_, _| proceed()));
    }

    /// The view, and how its images were synchronized. A quick one takes the images of full quality if they are cached.
    fn view(&self, asked: &Asked) -> Result<(Rendered, SyncMethod), RenderError> {
        let options = self.options(asked.level);
        let request = Request::new(Viewpoint::View(asked.target), asked.time_s, options);
        if asked.level == Level::Quick
            && let Some(images) = self.field.cached_instant(asked.time_s, &self.full)
        {
            let request = Request { images: Images::Given(&images), ..request };
            return Ok((render(self.field, &request, &asked.context)?, self.full.sync));
        }
        Ok((render(self.field, &request, &asked.context)?, options.sync))
    }

    /// The view from each camera's nearest frame. It is shown over the shape of [`Self::view`], since frames of other
    /// instants than the view's show none; it is saved as `stlfr render --sync nearest` makes it.
    fn traditional(&self, asked: &Asked) -> Result<Rendered, RenderError> {
        let mut options = self.options(asked.level).clone();
        let shape = if asked.level == Level::Saved { TRADITIONAL } else { options.sync };
        options.sync = TRADITIONAL;
        let request = Request::new(Viewpoint::View(asked.target), asked.time_s, &options);
        render(self.field, &Request { shape: Images::By(shape), ..request }, &asked.context)
    }

    /// The view with the cameras' colours, and how its images were synchronized.
    fn tinted(&self, asked: &Asked) -> Result<(Rendered, SyncMethod), RenderError> {
        let &Asked { target, time_s, level, ref context } = asked;
        let full = &self.full;
        let (images, sync) = match (self.field.cached_instant(time_s, full), level) {
            (Some(images), _) => (images, full.sync),
            // Weights hardly depend on the images, and what shines through may be a frame.
            (None, Level::Quick) => {
                let nearest = RenderOptions { sync: TRADITIONAL, ..full.clone() };
                (self.field.corrected_all(time_s, &nearest, context)?, TRADITIONAL)
            }
            (None, _) => (self.field.corrected_all(time_s, full, context)?, full.sync),
        };
        let tinted = images.with_colors(self.colors.rgb());
        let options = self.options(level);
        let request = Request::new(Viewpoint::View(target), time_s, options);
        let shown = Request { images: Images::Given(&images), ..request };
        let mut view = render(self.field, &shown, context)?;
        let request = Request { images: Images::Given(&tinted), ..request };
        let tint = render(self.field, &request, context)?;
        let shown = view.image.to_rgb();
        view.image = tint.image;
        let pixels = view.image.data_mut().chunks_exact_mut(3);
        for (pixel, shown) in pixels.zip(shown.data().chunks_exact(3)) {
            let gray = luma(shown);
            pixel.iter_mut().for_each(|v| *v = gray * (1.0 - TINT) + *v * TINT);
        }
        Ok((view, sync))
    }
}
