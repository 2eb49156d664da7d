//! Cameras that are held out, so that their own frames are the truth of what the others render.

use super::LightField;
use super::points::nearest;
use crate::camera::Camera;
use crate::capture::{Capture, CaptureError};
use crate::interpolation::changed_pixels;
use crate::offset::Offsets;
use crate::raster::Image;
use nalgebra::Vector3;
use std::sync::Arc;

/// A capture and its offsets with some of its cameras only, in that order.
pub(crate) fn only(
    capture: &Capture,
    offsets: &Offsets,
    cameras: &[usize],
) -> (Arc<Capture>, Offsets) {
    let mut known = offsets.clone();
    known.cameras = cameras.iter().map(|&c| offsets.cameras[c].clone()).collect();
    (Arc::new(capture.with_cameras(cameras)), known)
}

/// All other cameras, the nearest first.
pub(crate) fn by_distance_from(capture: &Capture, camera: usize) -> Vec<usize> {
    let others: Vec<usize> = (0..capture.cameras.len()).filter(|&c| c != camera).collect();
    nearest(capture, &others, capture.cameras[camera].camera.center())
}

/// All cameras, those nearest to the rig's middle first: like views, they are between others. None of
/// fewer than three.
pub(crate) fn inner_cameras(capture: &Capture) -> Vec<usize> {
    let count = capture.cameras.len();
    if count < 3 {
        return Vec::new();
    }
    let centers = capture.cameras.iter().map(|c| c.camera.center().coords);
    let middle = centers.sum::<Vector3<f64>>() / count as f64;
    nearest(capture, &(0..count).collect::<Vec<_>>(), middle.into())
}

/// A view like a camera's, but halfway to its nearest neighbour at another place, if there is one.
pub(crate) fn halfway_to_neighbor(capture: &Capture, camera: usize) -> Camera {
    let mut view = capture.cameras[camera].camera.clone();
    let from_own = capture.cameras.iter().map(|c| c.camera.center() - view.center());
    let elsewhere = from_own.filter(|d| d.norm() > 0.0);
    if let Some(aside) = elsewhere.min_by(|a, b| a.norm().total_cmp(&b.norm())) {
        let shift = view.cam_from_world.rotation * (0.5 * aside);
        view.cam_from_world.translation.vector -= shift;
    }
    view
}

/// Of frames at these times, those at which the largest number of the field's cameras can give an image.
pub(crate) fn well_covered_frames(field: &LightField, times_s: &[f64]) -> Vec<usize> {
    let usable: Vec<usize> = times_s.iter().map(|t| field.usable(*t).len()).collect();
    let most = usable.iter().max().copied().unwrap_or(0).max(1);
    (0..usable.len()).filter(|&k| usable[k] == most).collect()
}

/// A frame, and where it differs from the frames beside it by more than noise, row by row.
pub(crate) fn recorded(
    capture: &Capture,
    camera: usize,
    frame: usize,
) -> Result<(Image, Vec<bool>), CaptureError> {
    let image = capture.read_frame(camera, frame)?;
    let mut moving = vec![false; image.width() * image.height()];
    for other in [frame.checked_sub(1), Some(frame + 1)].into_iter().flatten() {
        if other < capture.cameras[camera].frames.len() {
            let changed = changed_pixels(&image, &capture.read_frame(camera, other)?);
            moving.iter_mut().zip(changed).for_each(|(m, c)| *m |= c);
        }
    }
    Ok((image, moving))
}
