//! Renders the pictures of a light field that the page in the browser requests.

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
use crate::scene_flow::Detail;
use std::sync::Arc;

/// Width and height of the views for which geometry is computed in advance, pixels. The views are small to save time.
/// Only the depth maps of the filming cameras are cached for later views, and the size of these maps doesn't depend on
/// the size of the view.
const SMALL_PX: [u32; 2] = [32, 24];

/// Function that is called during rendering. Rendering stops when the function returns false, for example because the
/// viewer has sent a newer request.
pub(super) type Proceed<'p> = &'p (dyn Fn() -> bool + Sync);

/// An encoded picture, with the methods by which it was rendered.
pub struct Picture {
    /// Contents of a PNG file.
    pub bytes: Vec<u8>,
    /// Names of the two methods by which the picture was rendered, for synchronization and for the geometry proxy, such
    /// as `refined, mesh`. Empty for a ground-truth image.
    pub made_by: String,
    /// Depths of the first and the last colour of a depth picture's scale, metres. `None` for other pictures.
    pub depths_m: Option<[f32; 2]>,
}

/// A rendered picture before it is encoded.
struct Made {
    rendered: Rendered,
    /// Synchronization method and proxy method by which the picture was rendered. `None` for a ground-truth image.
    by: Option<(SyncMethod, ProxyMethod)>,
    depths_m: Option<[f32; 2]>,
}

/// The options with which a view is rendered, and the camera images from which it is rendered.
struct ViewInputs<'a> {
    options: &'a RenderOptions,
    /// Synchronized images of all cameras at the view's instant. `None` if they must be computed.
    images: Option<GivenImages>,
}

/// Renders pictures of a light field, and shows its ground-truth images.
pub struct Studio<'a> {
    pub(super) field: &'a LightField,
    pub(super) rig: Arc<RigFrame>,
    pub(super) truth: TrueViews,
    pub(super) colors: Colors,
    /// Command-line arguments that are equivalent to the options for full quality. The page shows them to the user.
    pub(super) words: Vec<String>,
    full: RenderOptions,
    quick: RenderOptions,
}

impl<'a> Studio<'a> {
    /// Creates a studio for a light field. `options` are the options for full quality: every automatic choice in them
    /// must already be replaced by a method, and a motion trail is ignored. `words` are the equivalent command-line
    /// arguments. The light field's in-memory cache is enlarged. If the ground truth can't be read, a note is shown, and
    /// no ground-truth images are available.
    pub fn new(
        field: &'a LightField,
        options: &RenderOptions,
        words: Vec<String>,
        reporter: &Reporter,
    ) -> Self {
        field.enlarge_cache();
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

    /// Returns the options with which pictures of full quality are rendered.
    pub(super) fn full(&self) -> &RenderOptions {
        &self.full
    }

    /// Returns the options for full quality. If the request names a synchronization method or a proxy method, this
    /// method replaces the method in the options.
    fn chosen(&self, request: &PictureRequest) -> RenderOptions {
        let mut options = self.full.clone();
        options.sync = request.sync.unwrap_or(options.sync);
        options.proxy.method = request.proxy.unwrap_or(options.proxy.method);
        options
    }

    /// Converts the time of a request to seconds from the capture's start.
    fn time_s(&self, request: &PictureRequest) -> f64 {
        request.time_s - self.field.capture().time_origin_s
    }

    /// Renders and encodes a picture. Stops as soon as `proceed` returns false.
    ///
    /// # Errors
    /// The errors of [`RigFrame::camera`] and of rendering, and [`LiveError::Superseded`] if `proceed` returned false.
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

    /// Returns the options with which the requested picture is rendered; for a quick picture also the synchronized
    /// images, if they are cached. Pictures of full quality have the options `chosen`. A quick picture has these
    /// options too if all intermediate results are cached, so that the picture looks nearly the same in motion and at
    /// rest. Otherwise, it has the options of the preset `draft`.
    fn inputs<'o>(
        &'o self,
        request: &PictureRequest,
        target: &Camera,
        chosen: &'o RenderOptions,
    ) -> ViewInputs<'o> {
        let time_s = self.time_s(request);
        if request.level != Level::Quick || self.is_quick_by_flow(request, target, chosen) {
            return ViewInputs { options: chosen, images: None };
        }
        let images = self.field.cached_instant(time_s, chosen);
        let view = Request::new(Viewpoint::View(target), time_s, chosen);
        let is_ready = images.is_some() && self.field.has_cached_geometry(target, &view);
        ViewInputs { options: if is_ready { chosen } else { &self.quick }, images }
    }

    /// Returns whether a picture is a quick one by scene flow: the options `chosen` say so, and depth and motion of its
    /// frames are in memory or on disk.
    fn is_quick_by_flow(
        &self,
        request: &PictureRequest,
        target: &Camera,
        chosen: &RenderOptions,
    ) -> bool {
        request.is_quick()
            && request.method.is_by_flow(chosen)
            && self.field.has_flow(target, self.time_s(request), chosen)
    }

    /// Renders a picture of the light field, without the encoding as a file. `target` is the camera of the picture.
    fn rendered(
        &self,
        request: &PictureRequest,
        target: &Camera,
        context: &Context,
    ) -> Result<Made, RenderError> {
        let chosen = self.chosen(request);
        let ViewInputs { options, images } = self.inputs(request, target, &chosen);
        let detail = if request.is_quick() { Detail::Quick } else { Detail::Full };
        let view = Request::new(Viewpoint::View(target), self.time_s(request), options);
        let view = Request { detail, ..view };
        let sync = if images.is_some() { chosen.sync } else { options.sync };
        let by = |sync: SyncMethod| Some((sync, options.proxy.method));
        let made = |rendered, by| Made { rendered, by, depths_m: None };
        match request.method {
            PictureMethod::Traditional => {
                // Depth can't be estimated from frames of different instants. Traditional light field rendering
                // therefore gets the depth of space-time light field rendering. A saved picture is an exception,
                // because it must equal the picture of `stlfr render --sync nearest`.
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

    /// Returns the cameras' images at the request's instant, and the method by which they are synchronized. For a quick
    /// picture, each image is the camera's frame nearest in time.
    fn images(
        &self,
        request: &PictureRequest,
        options: &RenderOptions,
        context: &Context,
    ) -> Result<(GivenImages, SyncMethod), RenderError> {
        // Weights hardly depend on the images, so that the nearest frames suffice for a quick picture.
        let sync = if request.is_quick() { TRADITIONAL } else { options.sync };
        let options = RenderOptions { sync, ..options.clone() };
        Ok((self.field.corrected_all(self.time_s(request), &options, context)?, sync))
    }

    /// Renders the blending weights of the cameras in a view, as coloured stripes or as numbers, depending on the
    /// request's method.
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

    /// Computes the cameras' images and depth maps at a picture's instant in advance, so that other views at this
    /// instant are rendered quickly. Stops when `proceed` returns false. Errors are ignored here, because the next
    /// request for a picture reports them.
    pub(super) fn prepare(&self, request: &PictureRequest, proceed: Proceed) {
        let chosen = self.chosen(request);
        if request.method.is_by_flow(&chosen) {
            // What other views need was computed for this picture.
            return;
        }
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
