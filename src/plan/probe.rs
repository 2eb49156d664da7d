//! What dearer methods gain on views of this capture. Refinement, beside triangulation: how much it changes views
//! between its cameras, beside the error of held-out frames. All cameras' images and weights in time: the errors
//! of held-out frames alone.

use crate::camera::Camera;
use crate::light_field::held_out::{
    by_distance_from, halfway_to_neighbor, inner_cameras, only, recorded, well_covered_frames,
};
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::{BlendMethod, BlendOptions, Rendered};
use crate::metrics::moving_part;
use crate::options::RenderOptions;
use crate::raster::Image;
use crate::registration::RegistrationOptions;

/// Number of held-out frames, each of another camera, spread over the recording. Gains differ by half a decibel
/// between instants.
const FRAMES: usize = 4;

/// Number of nearest cameras from which a held-out frame is rendered.
const NEIGHBORS: usize = 4;

/// Fractions of the frame interval at which views may be rendered, the preferred one first.
const FRACTIONS: [f64; 3] = [0.5, 0.25, 0.75];

/// Dilation of the changing part for its parallax in a neighbouring view, pixels.
const PARALLAX_PX: usize = 16;

/// Smallest distance of an instant from a frame, as a fraction of the interval; nearer, synchronization has no error.
const MIN_FRACTION: f64 = 0.1;

/// Smallest changing part that is measured, pixels.
const MIN_PIXELS: usize = 64;

/// Frames that are held out, to be rendered from their cameras' neighbours.
pub struct Probe {
    frames: Vec<HeldOutFrame>,
}

struct HeldOutFrame {
    /// The light field of the neighbours alone.
    neighbors: LightField,
    camera: Camera,
    /// The camera's id and the frame's number.
    name: String,
    time_s: f64,
    /// Where and when views are made: halfway to the nearest neighbour, between this frame and the
    /// next.
    view: Camera,
    view_s: f64,
    /// The frame, corrected to the reference's gains.
    truth: Image,
    /// The camera whose brightness `neighbors` renders.
    bright_as: usize,
    registration: RegistrationOptions,
    /// Where the frame differs from those before and after it, row by row; and what is near that.
    changing: Vec<bool>,
    near_changing: Vec<bool>,
}

impl Probe {
    /// `None` where no frame lies between its neighbours' frames, as with one clock for all, or
    /// hardly anything changes.
    pub fn open(
        whole: &LightField,
        registration: &RegistrationOptions,
    ) -> Result<Option<Self>, RenderError> {
        let times_s = whole.offsets().common_times_s(whole.capture());
        let mut frames = Vec::new();
        for camera in inner_cameras(whole.capture()) {
            let Some(times_s) = &times_s[camera] else { continue };
            frames.extend(HeldOutFrame::open(
                whole,
                (camera, times_s),
                frames.len(),
                registration,
            )?);
            if frames.len() == FRAMES {
                break;
            }
        }
        Ok((!frames.is_empty()).then_some(Self { frames }))
    }

    /// The held-out frames, as people write them.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.frames.iter().map(|f| f.name.as_str()).collect();
        names.join(", ")
    }

    /// How much better, decibels, views by dearer options can be than by cheaper ones where things
    /// change: 10·log₁₀(1 + D/E), D the squared difference of the two halfway between the cameras,
    /// and E the squared error of the dearer ones on the held-out frames, each summed up. That is
    /// the gain if all that the dearer options change is for the better, and views are as wrong as
    /// those of held-out cameras. `None` where none can be rendered, or nothing is seen.
    ///
    /// What held-out frames gain is no guide here: they stand twice as far from their neighbours as
    /// views do, the proxy is off by twice as much there, and an outline in the wrong place costs a
    /// sharp view more than a blurred one.
    pub fn possible_gain_db(
        &self,
        field: &LightField,
        cheaper: &RenderOptions,
        dearer: &RenderOptions,
    ) -> Result<Option<f64>, RenderError> {
        let (mut difference, mut error) = (0.0, 0.0);
        for frame in &self.frames {
            let cheap = rendered(field, &frame.view, frame.view_s, cheaper)?;
            let dear = rendered(field, &frame.view, frame.view_s, dearer)?;
            let again = rendered(&frame.neighbors, &frame.camera, frame.time_s, dearer)?;
            let (Some(cheap), Some(dear), Some(again)) = (cheap, dear, again) else { continue };
            let seen = cheap.coverage.iter().zip(&dear.coverage).map(|(a, b)| *a && *b);
            let counts = seen.zip(&frame.near_changing).map(|(a, b)| a && *b);
            difference += squared(&cheap.image, &dear.image, counts);
            let counts: Vec<bool> =
                again.coverage.iter().zip(&frame.changing).map(|(a, b)| *a && *b).collect();
            error += frame.squared_error(field, &again, &counts);
        }
        // Nothing seen, or no error at all: 0/0, or more than any budget.
        let gain_db = 10.0 * (difference / error).ln_1p() / std::f64::consts::LN_10;
        Ok(gain_db.is_finite().then_some(gain_db))
    }
}

/// Squared errors of held-out frames, summed up, by the weights that they are blended with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeldOutErrors {
    pub in_space: f64,
    pub in_space_and_time: f64,
}

impl HeldOutErrors {
    /// The error by this blend; by the better of both if the blend is to be decided, too.
    pub fn by(&self, blend: BlendMethod, is_decided_later: bool) -> f64 {
        match blend {
            _ if is_decided_later => self.in_space.min(self.in_space_and_time),
            BlendMethod::SpaceTime => self.in_space_and_time,
            BlendMethod::Lumigraph | BlendMethod::Uniform => self.in_space,
        }
    }
}

impl Probe {
    /// The errors of the held-out frames where things change, by each of these options with both kinds of
    /// weights. Frames count that all can render, and pixels that all cover; `None` if there is none.
    ///
    /// All are equally sharp, so that an outline in the wrong place costs all alike.
    pub fn errors<const N: usize>(
        &self,
        field: &LightField,
        candidates: [&RenderOptions; N],
    ) -> Result<Option<[HeldOutErrors; N]>, RenderError> {
        let mut sums = [HeldOutErrors::default(); N];
        let mut is_any = false;
        for frame in &self.frames {
            let views = candidates.map(|options| frame.by_both_weights(options));
            let mut all = Vec::with_capacity(N);
            for view in views {
                all.extend(view?);
            }
            let Ok(views): Result<[[Rendered; 2]; N], _> = all.try_into() else { continue };
            let covered = |k: usize| views.iter().flatten().all(|view| view.coverage[k]);
            let counts: Vec<bool> =
                frame.changing.iter().enumerate().map(|(k, c)| *c && covered(k)).collect();
            is_any |= counts.contains(&true);
            for (sum, [in_space, in_time]) in sums.iter_mut().zip(&views) {
                sum.in_space += frame.squared_error(field, in_space, &counts);
                sum.in_space_and_time += frame.squared_error(field, in_time, &counts);
            }
        }
        Ok(is_any.then_some(sums))
    }
}

impl HeldOutFrame {
    /// The view in this frame's place with weights in space, and with those in space and time; `None` where it
    /// can't be rendered.
    fn by_both_weights(
        &self,
        options: &RenderOptions,
    ) -> Result<Option<[Rendered; 2]>, RenderError> {
        let [in_space, in_time] = [BlendMethod::default(), BlendMethod::SpaceTime].map(|method| {
            let blend = BlendOptions { method, ..options.blend.clone() };
            RenderOptions { blend, ..options.clone() }
        });
        let [in_space, in_time] = [in_space, in_time]
            .map(|options| rendered(&self.neighbors, &self.camera, self.time_s, &options));
        let (in_space, in_time) = (in_space?, in_time?);
        Ok(in_space.zip(in_time).map(<[Rendered; 2]>::from))
    }

    /// Squared error of a view against this frame, over the pixels where `counts` is true.
    fn squared_error(&self, field: &LightField, view: &Rendered, counts: &[bool]) -> f64 {
        let gains = field.gains(&self.registration);
        let image = gains.corrected(self.bright_as, &view.image);
        squared(image.as_ref().unwrap_or(&view.image), &self.truth, counts.iter().copied())
    }

    /// The `number`-th of [`FRAMES`] frames, of this camera; `None` if it shows nothing.
    fn open(
        whole: &LightField,
        (index, times_s): (usize, &[f64]),
        number: usize,
        registration: &RegistrationOptions,
    ) -> Result<Option<Self>, RenderError> {
        let capture = whole.capture();
        let filmed = &capture.cameras[index];
        let mut neighbors = by_distance_from(capture, index);
        neighbors.truncate(NEIGHBORS);
        let (less, known) = only(capture, whole.offsets(), &neighbors);
        let bright_as = neighbors[less.reference];
        let field = LightField::new(less, known);
        let covered = well_covered_frames(&field, times_s);
        let Some(&frame) = covered.get((2 * number + 1) * covered.len() / (2 * FRAMES)) else {
            return Ok(None);
        };
        let time_s = times_s[frame];
        let (truth, changing) = recorded(capture, index, frame)?;
        let count = changing.iter().filter(|c| **c).count();
        if 2 * field.between_frames(time_s, MIN_FRACTION) < neighbors.len() || count < MIN_PIXELS {
            return Ok(None);
        }
        let next_s = times_s[if frame + 1 < times_s.len() { frame + 1 } else { frame - 1 }];
        let instants = FRACTIONS.map(|fraction| time_s + fraction * (next_s - time_s));
        // The first of those that most cameras have between frames.
        let between = |s: &f64| std::cmp::Reverse(whole.between_frames(*s, MIN_FRACTION));
        let Some(view_s) = instants.into_iter().min_by_key(between) else { return Ok(None) };
        let changing_px: Vec<f32> = changing.iter().map(|c| f32::from(u8::from(*c))).collect();
        Ok(Some(Self {
            neighbors: field,
            camera: filmed.camera.clone(),
            name: format!("{}'s {frame}", filmed.id),
            time_s,
            view: halfway_to_neighbor(capture, index),
            view_s,
            near_changing: moving_part(&changing_px, truth.width(), 0.5, PARALLAX_PX),
            truth: whole.gains(registration).corrected(index, &truth).unwrap_or(truth),
            registration: registration.clone(),
            bright_as,
            changing,
        }))
    }
}

/// A view; `None` where it can't be rendered.
fn rendered(
    field: &LightField,
    at: &Camera,
    time_s: f64,
    options: &RenderOptions,
) -> Result<Option<Rendered>, RenderError> {
    renderable(field.view(at, time_s, options))
}

/// `None` where something can't be rendered. A frame that can't be read is an error.
fn renderable<T>(result: Result<T, RenderError>) -> Result<Option<T>, RenderError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(RenderError::Capture(error)) => Err(error.into()),
        Err(_) => Ok(None),
    }
}

/// The squared difference of the pixels that count, in grey.
fn squared(a: &Image, b: &Image, counts: impl Iterator<Item = bool>) -> f64 {
    let (a, b) = (a.to_gray(), b.to_gray());
    let pixels = a.data().iter().zip(b.data()).zip(counts);
    pixels.filter(|(_, counts)| *counts).map(|((a, b), _)| f64::from(a - b).powi(2)).sum()
}
