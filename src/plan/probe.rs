//! What rungs can gain on views of this capture: how much they change views between its cameras, beside
//! the error of cameras' own frames, rendered from their neighbours.

use crate::camera::Camera;
use crate::compare::mask::moving_part;
use crate::lumigraph::Rendered;
use crate::raster::Image;
use crate::render::left_out::{beside, filmed, inner_cameras, only, others, shown_frames};
use crate::render::{LightField, RenderError, RenderOptions};

/// Cameras that are rendered, one frame of each, spread over the film: what refinement gains differs
/// by half a decibel from instant to instant. More cost a view by every rung that is tried.
const FRAMES: usize = 4;

/// Cameras, the nearest, that each is rendered from. More cost time; fewer than two are on one side.
const NEIGHBORS: usize = 4;

/// Shares of the way from a frame to the next at which views may be made.
const SHARES: [f64; 3] = [0.5, 0.25, 0.75];

/// How far around what changes in a camera's frame it may lie in a view beside it, pixels. Larger: noise
/// of what stands still counts; smaller: what is near is missed.
const ASIDE_PX: usize = 16;

/// An instant nearer to a frame than this share of the interval shows no sync rung's errors.
const BETWEEN: f64 = 0.1;

/// A changing part smaller than this tells nothing, pixels.
const LEAST_PIXELS: usize = 64;

/// Frames to render from their cameras' neighbours.
pub struct Probe {
    frames: Vec<LeftOut>,
}

struct LeftOut {
    /// Of the neighbours alone, by the dearer rungs.
    field: LightField,
    camera: Camera,
    /// The camera's id, and the frame.
    name: String,
    time_s: f64,
    /// Where and when views are made: halfway to the nearest neighbour, between this frame and the
    /// next.
    beside: Camera,
    beside_s: f64,
    /// As the reference would have recorded it.
    truth: Image,
    /// The camera as bright as which `field` renders.
    bright_as: usize,
    /// Where the frame differs from those before and after it, row by row; and what is near that.
    changing: Vec<bool>,
    near_changing: Vec<bool>,
}

impl Probe {
    /// `None` where no frame lies between its neighbours' frames, as with one clock for all, or
    /// hardly anything changes.
    pub fn open(whole: &LightField, dearer: &RenderOptions) -> Result<Option<Self>, RenderError> {
        let (capture, offsets) = (whole.capture(), whole.offsets());
        let times_s = offsets.common_times_s(capture);
        let mut frames = Vec::new();
        for index in inner_cameras(capture) {
            let Some(times_s) = &times_s[index] else { continue };
            let mut from = others(capture, index);
            from.truncate(NEIGHBORS);
            let (less, known) = only(capture, offsets, &from);
            let bright_as = from[less.reference];
            let field = LightField::new(less, known, dearer.clone());
            let shown = shown_frames(&field, times_s);
            let Some(&frame) = shown.get((2 * frames.len() + 1) * shown.len() / (2 * FRAMES))
            else {
                continue;
            };
            let time_s = times_s[frame];
            let (truth, changing) = filmed(capture, index, frame)?;
            let count = changing.iter().filter(|c| **c).count();
            if 2 * field.between_frames(time_s, BETWEEN) < from.len() || count < LEAST_PIXELS {
                continue;
            }
            let (id, camera) = (&capture.cameras[index].id, &capture.cameras[index].camera);
            let (name, camera) = (format!("{id}'s {frame}"), camera.clone());
            let next_s = times_s[if frame + 1 < times_s.len() { frame + 1 } else { frame - 1 }];
            let instants = SHARES.map(|share| time_s + share * (next_s - time_s));
            // The first of those that most cameras have between frames.
            let between = |s: &f64| std::cmp::Reverse(whole.between_frames(*s, BETWEEN));
            let Some(beside_s) = instants.into_iter().min_by_key(between) else { continue };
            let changing_px: Vec<f32> = changing.iter().map(|c| f32::from(u8::from(*c))).collect();
            frames.push(LeftOut {
                field,
                camera,
                name,
                time_s,
                beside: beside(capture, index),
                beside_s,
                near_changing: moving_part(&changing_px, truth.width(), 0.5, ASIDE_PX),
                truth: whole.gains().corrected(index, &truth).unwrap_or(truth),
                bright_as,
                changing,
            });
            if frames.len() == FRAMES {
                break;
            }
        }
        Ok((!frames.is_empty()).then_some(Self { frames }))
    }

    /// Which frames they are.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.frames.iter().map(|f| f.name.as_str()).collect();
        names.join(", ")
    }

    /// How much better, decibels, views by dearer rungs can be than by cheaper ones where things change:
    /// 10·log₁₀(1 + D/E), D the squared difference of the two halfway between the filming cameras, and E
    /// the squared error of the dearer ones where they show filmed frames again, each summed up. So much
    /// it is if all that the dearer rungs change is for the better, and views are as wrong as those of
    /// left-out cameras. `None` where none can be rendered, or nothing is seen.
    ///
    /// What left-out cameras' frames gain is no guide: they stand twice as far from their neighbours as
    /// views do, the proxy is off by twice as much there, and an outline in the wrong place costs a
    /// sharp view more than a blurred one.
    pub fn possible_gain_db(
        &self,
        field: &mut LightField,
        cheaper: &RenderOptions,
        dearer: &RenderOptions,
    ) -> Result<Option<f64>, RenderError> {
        let (mut difference, mut error) = (0.0, 0.0);
        for frame in &self.frames {
            let mut views = Vec::new();
            for options in [cheaper, dearer] {
                field.set_options(options.clone());
                views.extend(view(field, &frame.beside, frame.beside_s)?);
            }
            let again = view(&frame.field, &frame.camera, frame.time_s)?;
            let ([cheap, dear], Some(again)) = (views.as_slice(), again) else { continue };
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

/// A view that shares nothing with the last one; `None` where it can't be rendered.
fn view(field: &LightField, at: &Camera, time_s: f64) -> Result<Option<Rendered>, RenderError> {
    field.forget_points();
    match field.view(at, time_s) {
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
