//! What refinement can gain on views of this capture: how much it changes views between its cameras,
//! beside the error of held-out frames.

use crate::camera::Camera;
use crate::light_field::held_out::{
    by_distance_from, halfway_to_neighbor, inner_cameras, only, recorded, well_covered_frames,
};
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::Rendered;
use crate::metrics::moving_part;
use crate::options::ViewOptions;
use crate::raster::Image;

/// How many held-out frames are rendered, each of another camera, spread over the recording: what
/// refinement gains differs by half a decibel from instant to instant. More cost three views each;
/// fewer depend on their instants.
const FRAMES: usize = 4;

/// How many neighbours, the nearest ones, a held-out frame is rendered from. More cost time; fewer
/// than two are on one side.
const NEIGHBORS: usize = 4;

/// Fractions of the way from a frame to the next at which views may be rendered, the preferred one
/// first. More: an instant between most cameras' frames is found more often; fewer: less often.
const FRACTIONS: [f64; 3] = [0.5, 0.25, 0.75];

/// How far around what changes in a camera's frame it may lie in a view beside it, pixels. Larger: noise
/// of what stands still counts; smaller: what is near is missed.
const PARALLAX_PX: usize = 16;

/// An instant nearer to a frame than this fraction of the interval shows no errors of
/// synchronization. Larger: hardly an instant is left; smaller: what is measured is noise.
const MIN_FRACTION: f64 = 0.1;

/// A changing part smaller than this is not measured, pixels. Larger: small bodies don't count;
/// smaller: a few noisy pixels decide.
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
    /// As the reference would have recorded it.
    truth: Image,
    /// The camera whose brightness `neighbors` renders.
    bright_as: usize,
    /// Where the frame differs from those before and after it, row by row; and what is near that.
    changing: Vec<bool>,
    near_changing: Vec<bool>,
}

impl Probe {
    /// `None` where no frame lies between its neighbours' frames, as with one clock for all, or
    /// hardly anything changes.
    pub fn open(whole: &LightField) -> Result<Option<Self>, RenderError> {
        let times_s = whole.offsets().common_times_s(whole.capture());
        let mut frames = Vec::new();
        for camera in inner_cameras(whole.capture()) {
            let Some(times_s) = &times_s[camera] else { continue };
            frames.extend(HeldOutFrame::open(whole, camera, times_s, frames.len())?);
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
    /// What held-out frames gain is no guide: they stand twice as far from their neighbours as
    /// views do, the proxy is off by twice as much there, and an outline in the wrong place costs a
    /// sharp view more than a blurred one.
    pub fn possible_gain_db(
        &self,
        field: &LightField,
        cheaper: &ViewOptions,
        dearer: &ViewOptions,
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
            let counts = again.coverage.iter().zip(&frame.changing).map(|(a, b)| *a && *b);
            let image = field.gains().corrected(frame.bright_as, &again.image);
            error += squared(&image.unwrap_or(again.image), &frame.truth, counts);
        }
        // Nothing seen, or no error at all: 0/0, or more than any budget.
        let gain_db = 10.0 * (difference / error).ln_1p() / std::f64::consts::LN_10;
        Ok(gain_db.is_finite().then_some(gain_db))
    }
}

impl HeldOutFrame {
    /// The `number`-th of [`FRAMES`] frames, of this camera; `None` if it shows nothing.
    fn open(
        whole: &LightField,
        index: usize,
        times_s: &[f64],
        number: usize,
    ) -> Result<Option<Self>, RenderError> {
        let capture = whole.capture();
        let filmed = &capture.cameras[index];
        let mut neighbors = by_distance_from(capture, index);
        neighbors.truncate(NEIGHBORS);
        let (less, known) = only(capture, whole.offsets(), &neighbors);
        let bright_as = neighbors[less.reference];
        let field = LightField::new(less, known, whole.frames().options());
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
            truth: whole.gains().corrected(index, &truth).unwrap_or(truth),
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
    options: &ViewOptions,
) -> Result<Option<Rendered>, RenderError> {
    match field.view(at, time_s, options) {
        Ok(view) => Ok(Some(view)),
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
