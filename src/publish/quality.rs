//! How finely frames, depth and motion are stored, and what that costs beside `render`'s pictures.

use super::PublishError;
use super::flow::FlowSteps;
use super::frame::PublishedFrame;
use crate::camera::{Camera, CameraModel};
use crate::light_field::{LightField, LoadedFrame};
use crate::options::RenderOptions;
use crate::raster::Image;
use crate::scene_flow::{MappedFrame, blend, confidences};
use serde::Serialize;
use std::collections::BTreeMap;

/// How frames are stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Quality {
    /// How often a frame is halved.
    pub halvings: usize,
    /// JPEG's, 1 to 100.
    pub jpeg: u8,
    pub steps: FlowSteps,
}

/// Steps of depth and motion where they are finest: half a step moves a pixel between two cameras by a hundredth of a pixel
/// or two.
const FINEST: FlowSteps = FlowSteps {
    block_px: 1,
    disparity_px: 1.0 / 16.0,
    velocity_px: 1.0 / 16.0,
    acceleration_px: 1.0 / 4.0,
    rate_px: 1.0 / 8.0,
};

/// Qualities of frames of one size, best first: that of JPEG, the block's side, and the multiple of the finest steps.
const LADDER: [(u8, usize, f32); 11] = [
    (94, 1, 1.0),
    (92, 1, 2.0),
    (90, 1, 4.0),
    (86, 1, 4.0),
    (80, 1, 6.0),
    (75, 1, 8.0),
    (75, 2, 4.0),
    (70, 2, 4.0),
    (60, 2, 6.0),
    (60, 3, 6.0),
    (50, 4, 6.0),
];
/// How often frames may be halved so that a site is small enough.
const MAX_HALVINGS: usize = 3;

impl Quality {
    /// All qualities of frames that are halved at least so often, best first.
    pub fn ladder(halvings: usize) -> impl Iterator<Item = Self> {
        let more = halvings..(halvings + 1).max(MAX_HALVINGS + 1);
        more.flat_map(|halvings| {
            LADDER.map(|(jpeg, block_px, multiple)| {
                let steps = FlowSteps {
                    block_px,
                    disparity_px: multiple * FINEST.disparity_px,
                    velocity_px: multiple * FINEST.velocity_px,
                    acceleration_px: multiple * FINEST.acceleration_px,
                    rate_px: multiple * FINEST.rate_px,
                };
                Self { halvings, jpeg, steps }
            })
        })
    }
}

/// Places and instants at which the pictures of a site are compared with `render`'s.
const HELD: usize = 4;

/// The published frames by camera and index.
pub(super) type Published = BTreeMap<(usize, usize), PublishedFrame>;

/// PSNR of views from what is published beside the same views from the capture, dB, at places between two cameras and
/// instants between two frames. Nothing of the browser's drawing is in them.
pub(super) fn measured(
    field: &LightField,
    options: &RenderOptions,
    published: &Published,
    quality: &Quality,
    span_s: (f64, f64),
) -> Result<Vec<f64>, PublishError> {
    let mut found = Vec::new();
    for k in 0..HELD {
        let fraction = (k as f64 + 0.5) / HELD as f64;
        let time_s = span_s.0 + fraction * (span_s.1 - span_s.0);
        let Some(view) = held_view(field, k, quality.halvings) else { break };
        let ids = field.frames_of_view(&view, time_s);
        let frames = ids.iter().filter_map(|id| published.get(id));
        let decoded = frames.map(|f| f.decoded(&quality.steps));
        let decoded: Vec<LoadedFrame> =
            decoded.collect::<Result<_, String>>().map_err(PublishError::Encoding)?;
        let mapped: Vec<MappedFrame> = decoded.iter().map(LoadedFrame::mapped).collect();
        let time = field.in_frames(time_s);
        let ours = blend(&mapped, &confidences(&mapped), &view, time).rendered;
        let theirs = field.view(&view, time_s, options)?;
        let both: Vec<bool> =
            ours.coverage.iter().zip(&theirs.coverage).map(|(a, b)| *a && *b).collect();
        found.extend(psnr_db(&ours.image.to_rgb(), &theirs.image.to_rgb(), &both));
    }
    Ok(found)
}

/// A view between the reference camera, or one beside it, and the camera nearest to that. `None` for a single camera.
fn held_view(field: &LightField, held: usize, halvings: usize) -> Option<Camera> {
    let capture = field.capture();
    let cameras: Vec<&Camera> = capture.cameras.iter().map(|c| &c.camera).collect();
    let from = cameras[(capture.reference + held) % cameras.len()];
    let distance = |c: &&Camera| (c.center() - from.center()).norm();
    let others = cameras.iter().copied().filter(|c| distance(c) > 0.0);
    let nearest = others.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let (fx, fy, cx, cy) = from.model.intrinsics();
    let middle = 0.5 * (nearest.center() - from.center());
    let mut view = from.shifted(from.cam_from_world.rotation * middle);
    view.model = CameraModel::Pinhole { fx, fy, cx, cy };
    (0..halvings).try_fold(view, |view, _| view.halved())
}

fn psnr_db(a: &Image, b: &Image, mask: &[bool]) -> Option<f64> {
    let pixels = a.data().chunks_exact(3).zip(b.data().chunks_exact(3)).zip(mask);
    let (mut squares, mut values) = (0.0, 0usize);
    for ((a, b), _) in pixels.filter(|(_, is_compared)| **is_compared) {
        squares += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        values += 3;
    }
    (values > 0 && squares > 0.0).then(|| -10.0 * (squares / values as f64).log10())
}
