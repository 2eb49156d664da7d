//! Description of a published light field (JSON), which the page reads first.

use super::frame::{Published, PublishedFrame};
use super::quality::Quality;
use crate::light_field::LightField;
use nalgebra::Isometry3;
use serde_json::{Value, json};

/// Number of frames per file of a site. A view is blended from at most eight frames, one per camera. If eight cameras
/// film one after the other, these are eight successive frames.
const FRAMES_A_FILE: usize = 8;

/// Returns the frames of each file of a site, as ((camera index, frame index), frame). `order` has the indices of the
/// frames in order of time. Files, and frames in a file, are in this order.
pub(super) fn files<'a>(
    order: &[(usize, usize)],
    published: &'a Published,
) -> Vec<Vec<((usize, usize), &'a PublishedFrame)>> {
    let frames: Vec<_> = order.iter().filter_map(|id| Some((*id, published.get(id)?))).collect();
    frames.chunks(FRAMES_A_FILE).map(<[_]>::to_vec).collect()
}

/// Returns the description of a light field for the page. Times are in frame intervals of the reference camera from the
/// capture's start. Lengths are in metres of the world.
pub(super) fn scene(
    field: &LightField,
    files: &[Vec<((usize, usize), &PublishedFrame)>],
    quality: &Quality,
    span_s: (f64, f64),
) -> Value {
    let capture = field.capture();
    let of_camera = |camera: usize| {
        files.iter().flatten().find(|((c, _), _)| *c == camera).map(|(_, frame)| *frame)
    };
    let in_frames = |(first, last): (f64, f64)| [field.in_frames(first), field.in_frames(last)];
    let cameras = (0..capture.cameras.len()).filter_map(|camera| {
        let frame = of_camera(camera)?;
        let (fx, fy, cx, cy) = frame.view.model.intrinsics();
        Some(json!({
            "camera": camera,
            "size": [frame.view.width, frame.view.height],
            "lens": [fx, fy, cx, cy],
            "pose": pose(&frame.view.cam_from_world),
            "is_color": frame.is_color,
            "disparity_px": frame.map.disparity_px,
            "blocks": [frame.map.width, frame.map.height],
            // A static light field doesn't change in time, and has no span of time per camera.
            "filmed": field.span_s(camera).filter(|_| !capture.is_static()).map(in_frames),
        }))
    });
    let max_inverse_depth = files.iter().flatten();
    let max_inverse_depth = max_inverse_depth.map(|(_, f)| f.map.max_inverse_depth(&quality.steps));
    let frame = |((camera, _), f): &((usize, usize), &PublishedFrame)| {
        json!([camera, f.time, f.jpeg.len(), f.flow.len()])
    };
    let frames = |file: &Vec<_>| Value::from(file.iter().map(frame).collect::<Vec<_>>());
    let [start, end] = in_frames(span_s);
    json!({
        "name": capture.name,
        "steps": quality.steps,
        "span": [start, end],
        // The page computes seconds from a time by: origin_s + frame_s · time.
        "origin_s": capture.time_origin_s,
        "frame_s": if end > start { (span_s.1 - span_s.0) / (end - start) } else { 0.0 },
        "spacing_m": field.spacing_m(),
        "max_inverse_depth": max_inverse_depth.fold(0.0, f32::max),
        "cameras": cameras.collect::<Vec<_>>(),
        "reference": capture.reference,
        // For each file, the list of its frames as [camera, time, bytes of the image, bytes of depth and motion].
        "files": files.iter().map(frames).collect::<Vec<_>>(),
    })
}

/// Returns the upper three rows of the 4×4 matrix `cam_from_world`, row by row.
fn pose(cam_from_world: &Isometry3<f64>) -> Vec<f64> {
    let matrix = cam_from_world.to_matrix();
    (0..3).flat_map(|row| (0..4).map(move |column| matrix[(row, column)])).collect()
}
