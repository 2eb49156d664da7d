//! Cameras on a circle around a place.

use super::worlds::line_rig;
use nalgebra::{Isometry3, Point3, Vector3};
use stlfr::camera::Camera;

/// Four cameras on a circle with a radius of `radius_m` around a place, `width`×3/4, `angle_deg` degrees apart, that look at
/// the place. It lies on the z axis, `place_m` from the origin.
pub fn arc_rig(width: usize, angle_deg: f64, place_m: f64, radius_m: f64) -> Vec<Camera> {
    let place = Point3::new(0.0, 0.0, place_m);
    let mut cameras = line_rig(4, width);
    for (k, camera) in cameras.iter_mut().enumerate() {
        let angle = (k as f64 - 1.5) * angle_deg.to_radians();
        let center = place + radius_m * Vector3::new(angle.sin(), 0.0, -angle.cos());
        camera.cam_from_world = Isometry3::face_towards(&center, &place, &Vector3::y()).inverse();
    }
    cameras
}
