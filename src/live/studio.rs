//! Renders the requested pictures of a light field.

use super::encode::{Colors, encode, encode_saved};
use super::overlays::{Weights, depth_picture};
use super::true_views::TrueViews;
use super::{Level, LiveError, PictureMethod, PictureRequest, Place, RigFrame, ViewDirection};
use crate::camera::Camera;
use crate::compare::TRADITIONAL;
use crate::interpolation::SyncMethod;
use crate::light_field::{
    Context, GivenImages, Images, LightField, RenderError, Request, Viewpoint, render,
};
use crate::lumigraph::Rendered;
use crate::method::Method as _;
use crate::options::{Preset, ProxyMethod, RenderOptions, TrailOptions};
use crate::progress::Reporter;
use std::sync::Arc;

/// Size of the view with which geometry is computed beforehand, pixels. It is small, since only the cameras'
/// depths are cached.
const SMALL_PX: [u32; 2] = [32, 24];

/// Called during rendering; rendering stops if it returns false, as when the viewer has sent a newer request.
pub(super) type Proceed<'p> = &'p (dyn Fn() -> bool + Sync);

/// An encoded picture.
pub struct Picture {
    /// A PNG file.
    pub bytes: Vec<u8>,
    /// The methods by which it was rendered, such as `refined, mesh`; empty for the truth.
    pub made_by: String,
    /// For a picture of depths: the depths of the first and the last colour, metres.
    pub depths_m: Option<[f32; 2]>,
}

/// A picture before it is encoded.
struct Made {
    rendered: Rendered,
    /// The methods by which it was rendered; `None` for the truth.
    by: Option<(SyncMethod, ProxyMethod)>,
    depths_m: Option<[f32; 2]>,
}

/// The options and images from which a view is rendered.
struct ViewInputs<'a> {
    options: &'a RenderOptions,
    /// The synchronized images of the instant, if they are cached.
    images: Option<GivenImages>,
}

/// Renders pictures of a light field and of its truth.
pub struct Studio<'a> {
    pub(super) field: &'a LightField,
    pub(super) rig: Arc<RigFrame>,
    pub(super) truth: TrueViews,
    pub(super) colors: Colors,
    /// The command-line arguments that are equivalent to the options; the page shows them.
    pub(super) words: Vec<String>,
    full: RenderOptions,
    quick: RenderOptions,
}

impl<'a> Studio<'a> {
    /// A studio for a light field. `options` are for pictures at rest; every `auto` in them is already
    /// replaced by a method, and a motion trail is ignored. `words` are the equivalent command-line
    /// arguments. If the truth can't be read, a note is shown, and there are no true pictures.
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

    /// The options of full quality.
    pub(super) fn full(&self) -> &RenderOptions {
        &self.full
    }

    /// The options of full quality, with the methods that the request chooses.
    fn chosen(&self, request: &PictureRequest) -> RenderOptions {
        let mut options = self.full.clone();
        options.sync = request.sync.unwrap_or(options.sync);
        options.proxy.method = request.proxy.unwrap_or(options.proxy.method);
        options
    }

    /// The time of a request, converted to seconds from the capture's start.
    fn time_s(&self, request: &PictureRequest) -> f64 {
        request.time_s - self.field.capture().time_origin_s
    }

    /// Renders and encodes a picture. Stops as soon as `proceed` returns false.
    ///
    /// # Errors
    /// The errors of [`RigFrame::camera`] and of rendering, and [`LiveError::Superseded`] if it was stopped.
    pub(super) fn picture(
        &self,
        request: &PictureRequest,
        proceed: Proceed,
    ) -> Result<Picture, LiveError> {
        let target = self.rig.camera(request)?;
        let made = if request.method == PictureMethod::Truth {
            Made { rendered: self.truth.view(request, &target)?, by: None, depths_m: None }
        } else {
            match self.rendered(request, &target, &Context::new(&|_, _| proceed())) {
                Err(RenderError::Stopped) => return Err(LiveError::Superseded),
                made => made?,
            }
        };
        let bytes = match request.level {
            Level::Quick | Level::Full => encode(&made.rendered),
            Level::Saved => encode_saved(&made.rendered, self.field.capture().bit_depth()),
        };
        let by = made.by.map(|(sync, proxy)| format!("{}, {}", sync.name(), proxy.name()));
        Ok(Picture {
            bytes: bytes.map_err(LiveError::Request)?,
            made_by: by.unwrap_or_default(),
            depths_m: made.depths_m,
        })
    }

    /// The options and images of a view. A quick picture has the chosen options if they need no further
    /// estimation, so that it looks the same in motion and at rest.
    fn inputs<'o>(
        &'o self,
        request: &PictureRequest,
        target: &Camera,
        chosen: &'o RenderOptions,
    ) -> ViewInputs<'o> {
        if request.level != Level::Quick {
            return ViewInputs { options: chosen, images: None };
        }
        let time_s = self.time_s(request);
        let images = self.field.cached_instant(time_s, chosen);
        let view = Request::new(Viewpoint::View(target), time_s, chosen);
        let is_ready = images.is_some() && self.field.has_cached_geometry(target, &view);
        ViewInputs { options: if is_ready { chosen } else { &self.quick }, images }
    }

    /// A picture of the light field.
    fn rendered(
        &self,
        request: &PictureRequest,
        target: &Camera,
        context: &Context,
    ) -> Result<Made, RenderError> {
        let chosen = self.chosen(request);
        let ViewInputs { options, images } = self.inputs(request, target, &chosen);
        let view = Request::new(Viewpoint::View(target), self.time_s(request), options);
        let sync = if images.is_some() { chosen.sync } else { options.sync };
        let by = |sync: SyncMethod| Some((sync, options.proxy.method));
        let made = |rendered, by| Made { rendered, by, depths_m: None };
        match request.method {
            PictureMethod::Traditional => {
                // Depth can't be estimated from frames of different instants, so that traditional LFR gets
                // the depth of ST-LFR. A saved picture is an exception, since it equals that of `stlfr render
                // --sync nearest`.
                let is_saved = request.level == Level::Saved;
                let shape = Images::By(if is_saved { TRADITIONAL } else { options.sync });
                let nearest = RenderOptions { sync: TRADITIONAL, ..options.clone() };
                let images = Images::By(TRADITIONAL);
                let view = Request { options: &nearest, images, shape, ..view };
                Ok(made(render(self.field, &view, context)?, by(TRADITIONAL)))
            }
            PictureMethod::Depth => {
                let geometry = self.field.geometry(target, &view)?;
                let picture = depth_picture(&geometry.view).ok_or(RenderError::NothingSeen)?;
                Ok(Made { rendered: picture.0, by: by(sync), depths_m: Some(picture.1) })
            }
            PictureMethod::Sources | PictureMethod::Weights => {
                let (images, sync) = match images {
                    Some(images) => (images, sync),
                    None => self.images(request, options, context)?,
                };
                let rendered = self.explained(request, &view, &images)?;
                Ok(made(rendered, by(sync)))
            }
            PictureMethod::SpaceTime | PictureMethod::Truth => {
                let given = images.as_ref().map_or(view.images, Images::Given);
                let view = Request { images: given, ..view };
                Ok(made(render(self.field, &view, context)?, by(sync)))
            }
        }
    }

    /// The cameras' images at the request's instant, and the method by which they are synchronized.
    fn images(
        &self,
        request: &PictureRequest,
        options: &RenderOptions,
        context: &Context,
    ) -> Result<(GivenImages, SyncMethod), RenderError> {
        // Weights hardly depend on the images, so that for a quick picture the nearest frames suffice below
        // the colours.
        let sync = if request.is_quick() { TRADITIONAL } else { options.sync };
        let options = RenderOptions { sync, ..options.clone() };
        Ok((self.field.corrected_all(self.time_s(request), &options, context)?, sync))
    }

    /// The cameras from which a view is blended, as stripes or as numbers.
    fn explained(
        &self,
        request: &PictureRequest,
        view: &Request,
        images: &GivenImages,
    ) -> Result<Rendered, RenderError> {
        let Viewpoint::View(target) = view.from else { return Err(RenderError::NothingSeen) };
        let given = Request { images: Images::Given(images), ..*view };
        let geometry = self.field.geometry(target, &given)?;
        let weights = Weights::new(self.field, images, &geometry, target, &view.options.blend);
        Ok(match request.method {
            PictureMethod::Weights => weights.picture(),
            _ => weights.striped(self.colors.rgb()),
        })
    }

    /// Computes the cameras' images and depths at a picture's instant beforehand, so that views at this
    /// instant are quick. Stops when `proceed` returns false. Errors are ignored here; they are reported when
    /// a picture is requested.
    pub(super) fn prepare(&self, request: &PictureRequest, proceed: Proceed) {
        let chosen = self.chosen(request);
        let sync = match request.method {
            PictureMethod::Truth => return,
            PictureMethod::Traditional => TRADITIONAL,
            _ => chosen.sync,
        };
        let options = RenderOptions { sync, ..chosen.clone() };
        let time_s = self.time_s(request);
        let goes_on = |_, _| proceed();
        let context = Context::new(&goes_on);
        let prepared = self.field.synchronized_all(time_s, &options, &context);
        if prepared.is_err() || chosen.proxy.method != ProxyMethod::Depth {
            return;
        }
        for place in self.rig.places_and_middles() {
            let view = ViewDirection { turn_deg: [0.0; 2], zoom: 1.0, size: SMALL_PX };
            let request = PictureRequest { place: Place::Free(place), view, ..request.clone() };
            let Ok(target) = self.rig.camera(&request) else { continue };
            let view = Request::new(Viewpoint::View(&target), time_s, &chosen);
            if !proceed() {
                return;
            }
            if !self.field.has_cached_geometry(&target, &view) {
                let _ = self.field.geometry(&target, &view);
            }
        }
    }
}
