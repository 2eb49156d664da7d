//! Measurements of the rig that need no images: lens distortion and the arrangement of the cameras.

use crate::capture::Capture;
use nalgebra::{DMatrix, Point2, Vector3};

/// Number of grid points along each side of an image at which lens distortion is evaluated.
const SIDE: usize = 17;

/// Returns the largest displacement of a pixel by lens distortion over all cameras, in pixels.
pub fn largest_distortion_px(capture: &Capture) -> f64 {
    let mut largest: f64 = 0.0;
    for camera in capture.cameras.iter().map(|c| &c.camera) {
        if camera.model.is_pinhole() {
            continue;
        }
        let at = |k: usize, size: usize| size as f64 * k as f64 / (SIDE - 1) as f64;
        for k in 0..SIDE * SIDE {
            let pixel = Point2::new(at(k % SIDE, camera.width), at(k / SIDE, camera.height));
            // A pixel outside the lens model's domain has no undistorted position.
            if let Some(ideal) = camera.model.ideal_from_pixel(&pixel) {
                largest = largest.max((ideal - pixel).norm());
            }
        }
    }
    largest
}

/// Returns the extent of the camera centres across their main direction, divided by the extent along it: 0 for a line
/// of cameras, 1 for a square grid. Returns 0 if all cameras have the same position.
pub fn extent_ratio(capture: &Capture) -> f64 {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center().coords).collect();
    let mean = centers.iter().sum::<Vector3<f64>>() / centers.len() as f64;
    let offsets = DMatrix::from_fn(centers.len(), 3, |row, column| (centers[row] - mean)[column]);
    let mut extents: Vec<f64> = offsets.singular_values().iter().copied().collect();
    extents.sort_by(|a, b| b.total_cmp(a));
    match extents.as_slice() {
        [along, across, ..] if *along > 0.0 => across / along,
        _ => 0.0,
    }
}
