//! Calibrated cameras, and the conventions for coordinates that the whole program follows.
//!
//! - World: right-handed coordinates, in metres.
//! - Camera: COLMAP's axes, +x right, +y down, +z forward. Poses are `cam_from_world`.
//! - Pixels: the centre of the top-left pixel is (0.5, 0.5).
//! - Lens models: COLMAP's names and order of parameters.
//!
//! Known limit: a viewing ray is represented by its point on the normalized plane z = 1. The field of view is therefore
//! below 180°.

mod distortion;
mod epipolar;
mod format;
mod model;
mod parameter;
mod prism;
mod radial_curve;
mod solve;

pub use epipolar::{EpipolarGeometry, EpipolarLine};
pub use format::{CameraFormat, CameraFormatError, MAX_QUATERNION_ERROR, PoseFormat, ViewFormat};
pub use model::CameraModel;
pub use parameter::CameraParameter;

use nalgebra::{Isometry3, Point2, Point3, Translation3, Vector3};

/// A calibrated camera: image size, lens model, and pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Lens model: maps points of the normalized plane z = 1 to pixels.
    pub model: CameraModel,
    /// Pose: maps world coordinates, in metres, to camera coordinates (+x right, +y down, +z forward).
    pub cam_from_world: Isometry3<f64>,
}

/// Minimum depth of a point that can be projected, as a fraction of its distance from the camera's centre. It allows
/// rays up to 89.9999° from the optical axis.
const MIN_DEPTH_FRACTION: f64 = 1e-6;

impl Camera {
    /// Returns the camera for an image of half the resolution. An odd last row or column is dropped. `None` if the
    /// image is less than 2 pixels wide or high.
    pub fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        let model = self.model.halved();
        (width > 0 && height > 0).then(|| Self { width, height, model, ..self.clone() })
    }

    /// Projects a world point, in metres, to a pixel position. The position may lie outside of the image.
    ///
    /// `None` for NaN, and for a point behind the camera, at its centre, at 90° from its axis, or outside of the range
    /// in which the lens model is invertible ([`CameraModel::is_short_of_fold`]).
    pub fn project(&self, point_world: &Point3<f64>) -> Option<Point2<f64>> {
        let p = self.cam_from_world * point_world;
        self.project_cam(&p)
    }

    /// Projects a point in camera coordinates, in metres, to a pixel position. `None` for the same points as
    /// [`Self::project`].
    pub fn project_cam(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        if !(p.z > MIN_DEPTH_FRACTION * p.coords.norm()) {
            return None;
        }
        let n = Point2::new(p.x / p.z, p.y / p.z);
        if !self.model.is_short_of_fold(&n) {
            return None;
        }
        let pixel = self.model.pixel_from_normalized(&n);
        (pixel.x.is_finite() && pixel.y.is_finite()).then_some(pixel)
    }

    /// Returns the viewing direction of a pixel in camera coordinates, scaled to z = 1.
    ///
    /// `None` where the lens model can't be inverted, which is far outside of the image and only for lenses with
    /// distortion.
    pub fn ray(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        let n = self.model.normalized_from_pixel(pixel)?;
        Some(Vector3::new(n.x, n.y, 1.0))
    }

    /// Returns the viewing direction of a pixel in world coordinates. Its component along the optical axis is 1, so its
    /// length is at least 1. `None` where [`Self::ray`] is `None`.
    pub fn ray_world(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        Some(self.cam_from_world.rotation.inverse_transform_vector(&self.ray(pixel)?))
    }

    /// Returns the centre of projection in world coordinates, metres.
    pub fn center(&self) -> Point3<f64> {
        self.cam_from_world.inverse_transform_point(&Point3::origin())
    }

    /// Returns the camera translated by `shift_m`, in metres along the camera's own axes: right, down and forward.
    pub fn shifted(&self, shift_m: Vector3<f64>) -> Self {
        let cam_from_world = Translation3::from(-shift_m) * self.cam_from_world;
        Self { cam_from_world, ..self.clone() }
    }

    /// Returns the direction of the optical axis in world coordinates, with unit length.
    pub fn axis(&self) -> Vector3<f64> {
        self.cam_from_world.rotation.inverse_transform_vector(&Vector3::z())
    }

    /// Returns whether a pixel position lies in the image or on its border. False for NaN.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x <= self.width as f64
            && pixel.y <= self.height as f64
    }

    /// Returns the mean of the two focal lengths, pixels. Near the optical axis, this is the number of pixels per
    /// radian.
    pub fn focal_px(&self) -> f64 {
        let (fx, fy, ..) = self.model.intrinsics();
        0.5 * (fx + fy)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    /// Returns a 640×480 pinhole camera with its centre at `center`, looking along +z of the world.
    pub(crate) fn pinhole_at(center: [f64; 3]) -> Camera {
        Camera {
            width: 640,
            height: 480,
            model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
            cam_from_world: Isometry3::from_parts(
                Translation3::new(-center[0], -center[1], -center[2]),
                UnitQuaternion::identity(),
            ),
        }
    }

    #[test]
    fn axis_point_is_at_the_principal_point() {
        let cam = pinhole_at([1.0, 2.0, 3.0]);
        let p = cam.project(&Point3::new(1.0, 2.0, 5.0)).unwrap();
        assert_eq!((p.x, p.y), (320.0, 240.0));
    }

    #[test]
    fn y_points_down_and_x_right() {
        let cam = pinhole_at([0.0; 3]);
        let p = cam.project(&Point3::new(0.1, 0.2, 1.0)).unwrap();
        assert!((p.x - (320.0 + 68.6)).abs() < 1e-12 && (p.y - (240.0 + 137.2)).abs() < 1e-12);
    }

    #[test]
    fn points_behind_or_beside_the_camera_have_no_image() {
        let cam = pinhole_at([0.0; 3]);
        for p in [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, f64::NAN]] {
            assert_eq!(cam.project(&Point3::from(p)), None, "{p:?}");
        }
    }

    #[test]
    fn points_beyond_the_fold_have_no_image() {
        let mut cam = pinhole_at([0.0; 3]);
        let (f, cx, cy) = (686.0, 320.0, 240.0);
        cam.model = CameraModel::SimpleRadial { f, cx, cy, k: -0.5 };
        assert!(cam.project(&Point3::new(0.8, 0.0, 1.0)).is_some());
        assert_eq!(cam.project(&Point3::new(0.9, 0.0, 1.0)), None);
    }

    #[test]
    fn rays_and_projection_are_inverse() {
        let mut cam = pinhole_at([0.3, -0.2, 0.1]);
        cam.cam_from_world.rotation = UnitQuaternion::from_euler_angles(0.2, -0.4, 0.1);
        let pixel = Point2::new(101.5, 402.25);
        let p = cam.center() + cam.ray_world(&pixel).unwrap() * 3.7;
        assert!((cam.project(&p).unwrap() - pixel).norm() < 1e-9);
    }
}
