//! The parameters of a camera's calibration. Calibration errors are described as changes of these parameters.

use super::{Camera, CameraModel};
use nalgebra::{UnitQuaternion, Vector3};

/// One parameter of a camera's calibration. The unit of its changes follows from the kind of parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraParameter {
    /// Rotation of the camera about its centre, around the world's axis x (0), y (1) or z (2), radians.
    Rotation(usize),
    /// Translation of the camera's centre along the world's axis x (0), y (1) or z (2), metres.
    Center(usize),
    /// Natural logarithm of the focal lengths. A change scales fx and fy by the same factor.
    Focal,
    /// Coordinate x (0) or y (1) of the principal point, pixels.
    PrincipalPoint(usize),
    /// Distortion parameter of the lens model. Index 0 is the first parameter after the principal point in COLMAP's
    /// order.
    Distortion(usize),
}

impl CameraParameter {
    /// The six parameters of a pose: the rotations about the axes x, y and z, then the translations along these axes.
    pub const POSE: [Self; 6] = [
        Self::Rotation(0),
        Self::Rotation(1),
        Self::Rotation(2),
        Self::Center(0),
        Self::Center(1),
        Self::Center(2),
    ];

    /// Returns whether the parameter belongs to the lens model, not to the pose.
    pub fn is_of_lens(self) -> bool {
        !matches!(self, Self::Rotation(_) | Self::Center(_))
    }
}

impl CameraModel {
    /// Returns the number of focal lengths among the parameters, 1 or 2. In COLMAP's order the focal lengths come
    /// first, then the principal point.
    pub fn focal_count(&self) -> usize {
        let has_one_focal =
            ["SIMPLE_", "RADIAL"].iter().any(|start| self.name().starts_with(start));
        if has_one_focal { 1 } else { 2 }
    }

    /// Returns the number of parameters after the focal lengths and the principal point.
    pub fn distortion_count(&self) -> usize {
        self.params().len() - self.focal_count() - 2
    }
}

impl Camera {
    /// Returns the camera with `change` added to one parameter of its calibration. The unit of `change` is stated at
    /// the variants of [`CameraParameter`]. If the camera model lacks the parameter, such as the third distortion
    /// parameter of a pinhole, the camera is returned unchanged.
    pub fn with_change(&self, parameter: CameraParameter, change: f64) -> Self {
        let mut camera = self.clone();
        let axis = |axis: usize| Vector3::ith(axis, change);
        match parameter {
            CameraParameter::Rotation(k) => {
                let center = self.center();
                let turn = UnitQuaternion::from_scaled_axis(-axis(k));
                camera.cam_from_world.rotation = self.cam_from_world.rotation * turn;
                let shift = -(camera.cam_from_world.rotation * center.coords);
                camera.cam_from_world.translation.vector = shift;
            }
            CameraParameter::Center(k) => {
                camera.cam_from_world.translation.vector -= self.cam_from_world.rotation * axis(k);
            }
            CameraParameter::Focal => {
                let focal = 0..self.model.focal_count();
                camera.model = self.model.changed(focal, |px| px * change.exp());
            }
            CameraParameter::PrincipalPoint(k) => {
                let at = self.model.focal_count() + k;
                camera.model = self.model.changed(at..at + 1, |px| px + change);
            }
            CameraParameter::Distortion(k) => {
                let at = self.model.focal_count() + 2 + k;
                camera.model = self.model.changed(at..at + 1, |v| v + change);
            }
        }
        camera
    }
}

impl CameraModel {
    /// Returns the model with `change` applied to the parameters whose indices are in `which`. Indices are in COLMAP's
    /// order.
    fn changed(&self, which: std::ops::Range<usize>, change: impl Fn(f64) -> f64) -> Self {
        let mut params = self.params();
        for value in params.get_mut(which).into_iter().flatten() {
            *value = change(*value);
        }
        // Name and number of parameters come from the model itself, so the conversion can't fail.
        Self::from_params(self.name(), &params).unwrap_or(*self)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::pinhole_at;
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_turn_keeps_the_centre_and_a_move_the_direction() {
        let mut camera = pinhole_at([0.3, -0.2, 0.5]);
        let center = camera.center();
        camera.cam_from_world.rotation = UnitQuaternion::from_euler_angles(0.2, -0.4, 1.0);
        camera.cam_from_world.translation.vector =
            -(camera.cam_from_world.rotation * center.coords);
        for k in 0..3 {
            let turned = camera.with_change(CameraParameter::Rotation(k), 0.01);
            assert!((turned.center() - center).norm() < 1e-12);
            let turn = turned.cam_from_world.rotation.inverse() * camera.cam_from_world.rotation;
            assert!((turn.scaled_axis() - Vector3::ith(k, 0.01)).norm() < 1e-12);
            let moved = camera.with_change(CameraParameter::Center(k), 0.01);
            assert!((moved.center() - center - Vector3::ith(k, 0.01)).norm() < 1e-12);
            assert_eq!(moved.cam_from_world.rotation, camera.cam_from_world.rotation);
        }
    }

    #[test]
    fn lens_numbers_change_the_image() {
        let camera = pinhole_at([0.0; 3]);
        let p = Point3::new(0.3, -0.2, 2.0);
        let (fx, _, cx, cy) = camera.model.intrinsics();
        let before = camera.project(&p).unwrap();
        let zoomed = camera.with_change(CameraParameter::Focal, 0.01).project(&p).unwrap();
        let away = |q: nalgebra::Point2<f64>| (q - nalgebra::Point2::new(cx, cy)).norm();
        assert!((away(zoomed) / away(before) - 0.01_f64.exp()).abs() < 1e-12 && fx > 0.0);
        let moved = camera.with_change(CameraParameter::PrincipalPoint(1), 2.0);
        assert!((moved.project(&p).unwrap() - before - Vector3::y().xy() * 2.0).norm() < 1e-9);
        assert_eq!(camera.with_change(CameraParameter::Distortion(2), 1.0).model, camera.model);
    }
}
