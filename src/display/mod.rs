//! Pictures of several views for displays of light fields, and for two eyes.
//!
//! The views stand side by side and look in one direction. Each is sheared (off-axis), so that all show the same
//! rectangle of one plane, that of convergence: what lies in it has no parallax. They are never turned towards each
//! other.

mod quilt;

pub use quilt::{QuiltLayout, QuiltLayoutError};

use crate::camera::{Camera, CameraModel};
use nalgebra::Vector3;

/// The view `offset_m` metres to the right of a view, sheared about the plane `convergence_m` metres ahead. Distortion
/// is dropped.
pub fn sheared(view: &Camera, offset_m: f64, convergence_m: f64) -> Camera {
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let model = CameraModel::Pinhole { fx, fy, cx: cx + fx * offset_m / convergence_m, cy };
    Camera { model, ..view.shifted(Vector3::x() * offset_m) }
}

/// The views of the left and of the right eye, `distance_m` apart.
pub fn stereo(view: &Camera, distance_m: f64, convergence_m: f64) -> [Camera; 2] {
    [-0.5, 0.5].map(|side| sheared(view, side * distance_m, convergence_m))
}

/// The cone, symmetric about a view's axis, that cameras cover, degrees: seen from the point of the axis in the plane of
/// convergence, there are cameras to the left and to the right of all of it. 0 if the view doesn't stand among them.
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
