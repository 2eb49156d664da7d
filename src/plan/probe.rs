//! What rungs can gain on views of this capture: cameras' own frames, rendered from their neighbours.

use crate::capture::Capture;
use crate::offset::Offsets;
use crate::raster::Image;
use crate::render::left_out::{filmed, inner_cameras, only, others, shown_frames};
use crate::render::{LightField, RenderError, RenderOptions};

/// Cameras that are rendered, one frame of each, spread over the film: what refinement gains differs
/// by half a decibel from instant to instant. More cost a view by every rung that is tried.
const FRAMES: usize = 4;

/// Cameras, the nearest, that each is rendered from. More cost time; fewer than two are on one side.
const NEIGHBORS: usize = 4;

/// An instant nearer to a frame than this share of the interval shows no sync rung's errors.
const BETWEEN: f64 = 0.1;

/// A changing part smaller than this tells nothing, pixels.
const LEAST_PIXELS: usize = 64;

/// Frames to render from their cameras' neighbours.
pub struct Probe {
    frames: Vec<LeftOut>,
}

struct LeftOut {
    /// Of the neighbours alone.
    field: LightField,
    camera: crate::camera::Camera,
    /// The camera's id, and the frame.
    name: String,
    time_s: f64,
    truth: Image,
    /// Where it differs from the frames beside it.
    changing: Vec<bool>,
}

impl Probe {
    /// `None` where no frame lies between its neighbours' frames, as with one clock for all, or
    /// hardly anything changes.
    pub fn open(
        capture: &Capture,
        offsets: &Offsets,
        options: &RenderOptions,
    ) -> Result<Option<Self>, RenderError> {
        let times_s = offsets.common_times_s(capture);
        let mut frames = Vec::new();
        for index in inner_cameras(capture) {
            let Some(times_s) = &times_s[index] else { continue };
            let mut from = others(capture, index);
            from.truncate(NEIGHBORS);
            let (less, known) = only(capture, offsets, &from);
            let field = LightField::new(less, known, options.clone());
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
            frames.push(LeftOut { field, camera, name, time_s, truth, changing });
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

    /// How much better, decibels, views by dearer rungs can be than by cheaper ones where the frames
    /// change: 10·log₁₀(1 + D/E), with D the mean square of what the two views differ by, and E of
    /// what the dearer one and the frame do. So much it is if all that the dearer rungs change is
    /// for the better. `None` where one can't be rendered, or nothing is seen.
    ///
    /// The plain difference of the two views' errors is no guide: a left-out camera stands twice as
    /// far from its neighbours as views do, the proxy is off by twice as much there, and an outline in
    /// the wrong place costs a sharp view more than a blurred one.
    pub fn possible_gain_db(
        &mut self,
        cheaper: &RenderOptions,
        dearer: &RenderOptions,
    ) -> Result<Option<f64>, RenderError> {
        let (mut difference, mut error) = (0.0, 0.0);
        for frame in &mut self.frames {
            let mut views = Vec::new();
            for options in [cheaper, dearer] {
                frame.field.set_options(options.clone());
                frame.field.forget_points();
                match frame.field.view(&frame.camera, frame.time_s) {
                    Ok(view) => views.push((view.image.to_gray(), view.coverage)),
                    Err(RenderError::Capture(error)) => return Err(error.into()),
                    Err(_) => return Ok(None),
                }
            }
            let truth = frame.truth.to_gray();
            let [(cheap, cheap_sees), (dear, dear_sees)] = views.as_slice() else {
                return Ok(None);
            };
            for (k, truth) in truth.data().iter().enumerate() {
                if frame.changing[k] && cheap_sees[k] && dear_sees[k] {
                    difference += f64::from(dear.data()[k] - cheap.data()[k]).powi(2);
                    error += f64::from(dear.data()[k] - truth).powi(2);
                }
            }
        }
        // Nothing seen, or a view without any error: 0/0, or a bound that is none.
        let gain_db = 10.0 * (difference / error).ln_1p() / std::f64::consts::LN_10;
        Ok(gain_db.is_finite().then_some(gain_db))
    }
}
