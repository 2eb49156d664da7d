//! What a dearer rung gains on views of this capture: cameras' own frames, rendered from their
//! neighbours.

use crate::capture::Capture;
use crate::interpolation::Sync;
use crate::offset::Offsets;
use crate::raster::Image;
use crate::render::left_out::{filmed, inner_cameras, only, others, shown_frame};
use crate::render::{LightField, RenderError, RenderOptions};

/// Cameras that are rendered, one frame of each. More cost a view by the dearest rung each.
const PROBES: usize = 2;

/// Cameras, the nearest, that each is rendered from. More cost time; fewer than two are on one side.
const NEIGHBORS: usize = 4;

/// An instant nearer to a frame than this share of the interval shows no sync rung's errors.
const BETWEEN: f64 = 0.1;

/// A changing part smaller than this tells nothing, pixels.
const LEAST_PIXELS: usize = 64;

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// How much better the refined rung is than triangulation where the frames change, decibels of
    /// PSNR, the mean of the frames.
    pub gain_db: f64,
    /// The frames that were rendered: the camera's id, the frame.
    pub frames: Vec<(String, usize)>,
}

impl Probe {
    /// `None` where no frame lies between its neighbours' frames, as with one clock for all, or
    /// nothing changes.
    pub fn survey(
        capture: &Capture,
        offsets: &Offsets,
        options: &RenderOptions,
    ) -> Result<Option<Self>, RenderError> {
        let times_s = offsets.common_times_s(capture);
        let mut gains = Vec::new();
        let mut frames = Vec::new();
        for camera in inner_cameras(capture) {
            let Some(times_s) = &times_s[camera] else { continue };
            let mut from = others(capture, camera);
            from.truncate(NEIGHBORS);
            let (less, known) = only(capture, offsets, &from);
            let mut field = LightField::new(less, known, options.clone());
            let Some(frame) = shown_frame(&field, times_s) else { continue };
            let time_s = times_s[frame];
            if 2 * field.between_frames(time_s, BETWEEN) < from.len() {
                continue;
            }
            if let Some(gain_db) = gain(&mut field, options, capture, camera, frame, time_s)? {
                gains.push(gain_db);
                frames.push((capture.cameras[camera].id.clone(), frame));
            }
            if gains.len() == PROBES {
                break;
            }
        }
        let count = gains.len() as f64;
        let gain_db = gains.iter().sum::<f64>() / count;
        Ok((!gains.is_empty()).then_some(Self { gain_db, frames }))
    }
}

/// Of one frame; `None` where it can't be rendered or hardly changes.
fn gain(
    field: &mut LightField,
    options: &RenderOptions,
    capture: &Capture,
    camera: usize,
    frame: usize,
    time_s: f64,
) -> Result<Option<f64>, RenderError> {
    let (truth, moving) = filmed(capture, camera, frame)?;
    let mut errors = Vec::new();
    for sync in [Sync::Triangulation, Sync::Refined] {
        field.set_options(RenderOptions { sync, ..options.clone() });
        let rendered = match field.view(&capture.cameras[camera].camera, time_s) {
            Ok(rendered) => rendered,
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(_) => return Ok(None),
        };
        let counts: Vec<bool> =
            rendered.coverage.iter().zip(&moving).map(|(c, m)| *c && *m).collect();
        if counts.iter().filter(|c| **c).count() < LEAST_PIXELS {
            return Ok(None);
        }
        errors.push(squared_error(&rendered.image, &truth, &counts));
    }
    let gain_db = 10.0 * (errors[0] / errors[1]).log10();
    Ok(gain_db.is_finite().then_some(gain_db))
}

fn squared_error(image: &Image, truth: &Image, counts: &[bool]) -> f64 {
    let (image, truth) = (image.to_gray(), truth.to_gray());
    let pixels = image.data().iter().zip(truth.data()).zip(counts);
    pixels.filter(|(_, counts)| **counts).map(|((a, b), _)| f64::from(a - b).powi(2)).sum()
}
