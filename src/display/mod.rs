//! Pictures that consist of several views: quilts for light-field displays, and stereo pairs.
//!
//! The views' cameras stand side by side and look in one direction. Each frustum is sheared (off-axis), so that all
//! views show the same rectangle of one plane, the plane of convergence. Points in this plane have no parallax. Cameras
//! are never rotated towards each other (no toe-in).

mod quilt;

pub use quilt::{QuiltLayout, QuiltLayoutError};

use crate::camera::{Camera, CameraModel};
use nalgebra::Vector3;

/// Returns the view from `offset_m` metres to the right of `view`. Its frustum is sheared, so that points
/// `convergence_m` metres ahead keep their pixels. The result is a pinhole camera: lens distortion is dropped.
pub fn sheared(view: &Camera, offset_m: f64, convergence_m: f64) -> Camera {
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let model = CameraModel::Pinhole { fx, fy, cx: cx + fx * offset_m / convergence_m, cy };
    Camera { model, ..view.shifted(Vector3::x() * offset_m) }
}

/// Returns the views of the left and the right eye, as [`sheared`] computes them. The eyes are `distance_m` metres
/// apart, with `view` in the middle. Points `convergence_m` metres ahead have no parallax.
pub fn stereo(view: &Camera, distance_m: f64, convergence_m: f64) -> [Camera; 2] {
    [-0.5, 0.5].map(|side| sheared(view, side * distance_m, convergence_m))
}

/// Returns the widest view cone, in degrees, such that every view in it has cameras to its left and to its right. The
/// cone is symmetric about the optical axis of `view`. Its apex is the point of this axis `convergence_m` metres ahead.
/// Returns 0 if `view` doesn't stand between cameras.
pub fn covered_cone_deg(view: &Camera, cameras: &[Camera], convergence_m: f64) -> f64 {
    let right_m = cameras.iter().map(|camera| (view.cam_from_world * camera.center()).x);
    let angles = right_m.map(|x| (x / convergence_m).atan());
    let [mut left, mut right] = [0.0_f64; 2];
    for angle in angles {
        left = left.max(-angle);
        right = right.max(angle);
    }
    2.0 * left.min(right).to_degrees()
}

#[cfg(test)]
mod tests;
