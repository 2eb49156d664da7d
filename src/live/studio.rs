//! Pictures of a light field, made as they are asked for.

use super::encode::{Colors, encode, encode_saved};
use super::true_views::TrueViews;
use super::{Level, LiveError, Method, PictureRequest, Places};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::compare::TRADITIONAL;
use crate::host::BoundedCache;
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{LightField, Moment, RenderError};
use crate::lumigraph::Rendered;
use crate::method::Method as _;
use crate::options::{Preset, ProxyMethod, RenderOptions, TrailOptions, ViewOptions};
use crate::progress::Reporter;
use crate::raster::luma;
use std::sync::Arc;
use std::time::Instant;

/// How much memory instants may take that views are made from, bytes. Larger: memory; smaller: two viewers at
/// two times, with two methods each, make every instant anew (five of eight cameras of 640×480 fit).
const MAX_INSTANT_BYTES: usize = 160 << 20;
/// How much of the colours that stand for cameras is mixed into the picture. More: the scene can't be told;
/// less: the cameras can't.
const TINT: f32 = 0.5;

/// Whether to go on: a viewer may have asked for something else.
pub(super) type Proceed<'p> = &'p (dyn Fn() -> bool + Sync);

/// A picture as it is sent.
pub struct Picture {
    /// A PNG file's.
    pub bytes: Vec<u8>,
    /// The methods that made it, such as `refined, mesh`; empty for the truth.
    pub made_by: String,
    /// How long it took, seconds.
    pub seconds: f64,
}

/// What is asked of the light field.
struct Asked<'p> {
    target: &'p Camera,
    /// In the light field, seconds.
    time_s: f64,
    level: Level,
    proceed: Proceed<'p>,
}

/// All that an instant depends on: the time, bit by bit, and the images.
type InstantKey = (u64, &'static str);

/// A light field with its truth, and what its pictures share.
pub struct Studio<'a> {
    field: &'a LightField,
    places: Arc<Places>,
    truth: TrueViews,
    full: ViewOptions,
    quick: ViewOptions,
    /// By the full options.
    instants: BoundedCache<InstantKey, Arc<Moment<'a>>>,
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
            full: ViewOptions { trail: TrailOptions::default(), ..options.view() },
            quick: Preset::Draft.options().view(),
            instants: BoundedCache::new(MAX_INSTANT_BYTES),
            colors,
            words: Vec::new(),
        }
    }

    /// The same with the words of a command line that choose the options, which the page shows.
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

    fn options(&self, level: Level) -> &ViewOptions {
        match level {
            Level::Quick => &self.quick,
            Level::Full | Level::Saved => &self.full,
        }
    }

    /// The picture, as long as `proceed` says so.
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
        let asked = Asked { target, time_s, level: request.level, proceed };
        let (rendered, sync) = match request.method {
            Method::Truth => return Ok((self.truth.view(request, target)?, None)),
            Method::SpaceTime => self.view(&asked)?,
            Method::Traditional => (self.traditional(&asked)?, TRADITIONAL),
            Method::Sources => self.tinted(&asked)?,
        };
        Ok((rendered, Some(sync)))
    }

    /// Prepares the instant of a picture, so that views of it are quick, as long as `proceed` says so. What can't be
    /// prepared is said where it is asked for.
    pub fn prepare(&self, request: &PictureRequest, proceed: Proceed) {
        let sync = match request.method {
            Method::Truth => return,
            Method::SpaceTime | Method::Sources => self.full.sync,
            Method::Traditional => TRADITIONAL,
        };
        let time_s = request.time_s - self.capture().time_origin_s;
        drop(self.instant(sync, time_s, proceed));
    }

    /// The view, from the prepared instant if it is, and how its images were synchronized.
    fn view(&self, asked: &Asked) -> Result<(Rendered, SyncMethod), RenderError> {
        let options = self.options(asked.level);
        let sync = self.full.sync;
        match self.prepared(sync, asked.time_s) {
            // With depth per pixel, a prepared instant's views are others than those of `stlfr render`.
            Some(instant) if asked.level != Level::Saved => {
                Ok((instant.view_by(asked.target, options)?, sync))
            }
            _ => Ok((self.afresh(asked, options)?, options.sync)),
        }
    }

    /// The view as `stlfr render` makes it.
    fn afresh(&self, asked: &Asked, options: &ViewOptions) -> Result<Rendered, RenderError> {
        self.field.view_while(asked.target, asked.time_s, options, &mut || (asked.proceed)())
    }

    /// The view from each camera's nearest frame. With depth per pixel it is shown over the same shape as
    /// [`Self::view`], since frames of other instants than the view's show none; it is saved as
    /// `stlfr render --sync nearest` makes it.
    fn traditional(&self, asked: &Asked) -> Result<Rendered, RenderError> {
        let nearest = self.options(asked.level).clone().with_sync(TRADITIONAL);
        let is_saved = asked.level == Level::Saved;
        if nearest.proxy.method == ProxyMethod::Depth && !is_saved {
            return self.over_depth(asked, &nearest);
        }
        match self.prepared(TRADITIONAL, asked.time_s) {
            Some(instant) if !is_saved => instant.view_by(asked.target, &nearest),
            _ => self.afresh(asked, &nearest),
        }
    }

    /// The view by other options, over the shape that the synchronized images show.
    fn over_depth(&self, asked: &Asked, options: &ViewOptions) -> Result<Rendered, RenderError> {
        let &Asked { target, time_s, proceed, .. } = asked;
        let geometry = self.instant(self.full.sync, time_s, proceed)?.geometry(target)?;
        if !proceed() {
            return Err(RenderError::Stopped);
        }
        let images: Vec<Option<Synchronized>> = self.field.synchronized_all(time_s, options)?;
        let rendered = self.field.blend(&images, &geometry, target, &options.blend);
        if rendered.coverage.contains(&true) { Ok(rendered) } else { Err(RenderError::NothingSeen) }
    }

    /// The view with the cameras' colours, and how its images were synchronized.
    fn tinted(&self, asked: &Asked) -> Result<(Rendered, SyncMethod), RenderError> {
        let &Asked { target, time_s, level, proceed } = asked;
        let options = self.options(level);
        let (instant, sync) = match (self.prepared(self.full.sync, time_s), level) {
            (Some(instant), _) => (instant, self.full.sync),
            // Weights hardly depend on the images, and what shines through may be a frame.
            (None, Level::Quick) => (self.instant(TRADITIONAL, time_s, proceed)?, TRADITIONAL),
            (None, _) => (self.instant(self.full.sync, time_s, proceed)?, self.full.sync),
        };
        let mut view = instant.view_by(target, options)?;
        let tint = instant.sources(target, options, self.colors.rgb())?;
        let shown = view.image.to_rgb();
        view.image = tint.image;
        let pixels = view.image.data_mut().chunks_exact_mut(3);
        for (pixel, shown) in pixels.zip(shown.data().chunks_exact(3)) {
            let gray = luma(shown);
            pixel.iter_mut().for_each(|v| *v = gray * (1.0 - TINT) + *v * TINT);
        }
        Ok((view, sync))
    }

    fn key(sync: SyncMethod, time_s: f64) -> InstantKey {
        (time_s.to_bits(), sync.name())
    }

    fn prepared(&self, sync: SyncMethod, time_s: f64) -> Option<Arc<Moment<'a>>> {
        self.instants.get(&Self::key(sync, time_s))
    }

    /// All cameras' images at a time by the full options, with the depths that those want, cached.
    fn instant(
        &self,
        sync: SyncMethod,
        time_s: f64,
        proceed: Proceed,
    ) -> Result<Arc<Moment<'a>>, RenderError> {
        if let Some(instant) = self.prepared(sync, time_s) {
            return Ok(instant);
        }
        let mut options = self.full.clone().with_sync(sync);
        if sync == TRADITIONAL && sync != self.full.sync {
            // Frames of other instants show no depths.
            options.proxy.method = ProxyMethod::Mesh;
        }
        let instant = Arc::new(self.field.moment_while(time_s, &options, proceed)?);
        self.instants.insert(Self::key(sync, time_s), instant.clone(), instant.bytes());
        Ok(instant)
    }
}
