//! Comparison of views from a site's published frames with views from the capture.

use super::PublishError;
use super::frame::Published;
use super::quality::Quality;
use crate::camera::{Camera, CameraModel};
use crate::light_field::{LightField, LoadedFrame};
use crate::options::RenderOptions;
use crate::raster::Image;
use crate::scene_flow::{Detail, MappedFrame, blend, confidences};

/// Number of views by which a site's quality is measured. The views differ in viewpoint and instant.
const HELD: usize = 4;

/// Returns the PSNR, decibels, of views from the published frames against the same views from the capture. Each view is
/// halfway between two cameras. The instants are spread over the span `span_s`, seconds. Only pixels with content in
/// both images are compared. The views are rendered here and not by a browser. A view without any difference has no
/// value in the result.
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
        let ours = blend(&mapped, &confidences(&mapped), &view, time, Detail::Full).rendered;
        let theirs = field.view(&view, time_s, options)?;
        let both: Vec<bool> =
            ours.coverage.iter().zip(&theirs.coverage).map(|(a, b)| *a && *b).collect();
        found.extend(psnr_db(&ours.image.to_rgb(), &theirs.image.to_rgb(), &both));
    }
    Ok(found)
}

/// Returns a view halfway between a camera and its nearest neighbour. The camera is `held` places after the reference
/// camera in the list of cameras, which wraps around. The view's size is halved `halvings` times. `None` if all cameras
/// are at the same place, or if the view is too small to be halved.
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
