//! Epipolar geometry of two cameras i and j. The pixels p_i and p_j of one scene point satisfy `p_jᵀ F p_i = 0`. This
//! is eq. (1) of the paper with the two cameras exchanged.

use super::Camera;
use nalgebra::{Matrix3, Point2, Vector2, Vector3};

/// A line in an image: all pixel positions `p` with `normal · p + offset = 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpipolarLine {
    /// Unit vector perpendicular to the line.
    pub normal: Vector2<f64>,
    /// Signed distance of the origin of pixel coordinates from the line, pixels. It is positive on the side to which
    /// the normal points.
    pub offset: f64,
}

impl EpipolarLine {
    /// Returns the signed distance of the pixel position `p` from the line, pixels. It is positive on the side to which
    /// the normal points.
    pub fn distance(&self, p: &Point2<f64>) -> f64 {
        self.normal.dot(&p.coords) + self.offset
    }

    /// Returns the point of the line nearest to `p`, pixels.
    pub fn nearest(&self, p: &Point2<f64>) -> Point2<f64> {
        p - self.normal * self.distance(p)
    }
}

/// The fundamental matrix F of an ordered pair of cameras (i, j), eq. (1) of the paper.
///
/// Pixel positions in both images are undistorted, as returned by
/// [`ideal_from_pixel`](super::CameraModel::ideal_from_pixel).
#[derive(Clone, Debug)]
pub struct EpipolarGeometry {
    /// The matrix F. The pixel `p_i` of image i has the epipolar line `j_from_i · p_i` in image j.
    j_from_i: Matrix3<f64>,
}

/// Minimum baseline, as a fraction of the distance from the world's origin to the farther camera centre. A shorter
/// baseline counts as 0, because its direction is dominated by rounding errors.
const MIN_BASELINE_FRACTION: f64 = 1e-12;

/// Minimum length of the normal of an epipolar line F p, as a fraction of the norm of F. If the normal is shorter, the
/// pixel p counts as the epipole.
const MIN_LINE_FRACTION: f64 = 1e-12;

impl EpipolarGeometry {
    /// Computes the fundamental matrix of the ordered pair (i, j).
    ///
    /// `None` if both cameras have the same centre. Their images are then related by a homography, and there are no
    /// epipolar lines.
    pub fn new(camera_i: &Camera, camera_j: &Camera) -> Option<Self> {
        let (ci, cj) = (camera_i.center(), camera_j.center());
        let baseline = cj - ci;
        let scale = ci.coords.norm().max(cj.coords.norm());
        if !(baseline.norm() > MIN_BASELINE_FRACTION * scale) || baseline.norm() == 0.0 {
            return None;
        }
        // F is defined up to scale. A baseline of unit length avoids underflow and overflow.
        let t = -(camera_j.cam_from_world.rotation * baseline.normalize());
        let rotation = (camera_j.cam_from_world.rotation
            * camera_i.cam_from_world.rotation.inverse())
        .to_rotation_matrix();
        let essential = t.cross_matrix() * rotation.matrix();
        let k_inv = |camera: &Camera| {
            let (fx, fy, cx, cy) = camera.model.intrinsics();
            // The array lists the matrix's columns.
            Matrix3::from([[1.0 / fx, 0.0, 0.0], [0.0, 1.0 / fy, 0.0], [-cx / fx, -cy / fy, 1.0]])
        };
        Some(Self { j_from_i: k_inv(camera_j).transpose() * essential * k_inv(camera_i) })
    }

    /// Returns the epipolar line in image j of the pixel `p_i` of image i. Pixel and line are undistorted.
    ///
    /// `None` if the pixel is the epipole, which has no epipolar line.
    pub fn line_in_j(&self, p_i: &Point2<f64>) -> Option<EpipolarLine> {
        let l = self.j_from_i * Vector3::new(p_i.x, p_i.y, 1.0);
        let length = l.xy().norm();
        // At the epipole the normal is 0 up to rounding errors.
        if !(length > MIN_LINE_FRACTION * self.j_from_i.norm()) {
            return None;
        }
        Some(EpipolarLine { normal: l.xy() / length, offset: l.z / length })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::pinhole_at;
    use super::*;
    use nalgebra::{Point3, UnitQuaternion};

    #[test]
    fn a_line_rig_has_horizontal_epipolar_lines() {
        let (a, b) = (pinhole_at([0.0; 3]), pinhole_at([0.06, 0.0, 0.0]));
        let line =
            EpipolarGeometry::new(&a, &b).unwrap().line_in_j(&Point2::new(100.0, 77.0)).unwrap();
        assert!(line.normal.x.abs() < 1e-12 && (line.normal.y.abs() - 1.0).abs() < 1e-12);
        assert!(line.distance(&Point2::new(300.0, 77.0)).abs() < 1e-9);
        assert!((line.distance(&Point2::new(300.0, 80.0)).abs() - 3.0).abs() < 1e-9);
    }

    #[test]
    fn images_of_one_point_satisfy_it() {
        let mut a = pinhole_at([0.1, -0.3, 0.2]);
        let mut b = pinhole_at([0.5, 0.2, -0.1]);
        a.cam_from_world.rotation = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3);
        b.cam_from_world.rotation = UnitQuaternion::from_euler_angles(-0.1, 0.05, 0.2);
        let pair = EpipolarGeometry::new(&a, &b).unwrap();
        for k in 0..50 {
            let k = f64::from(k);
            let p = Point3::new((k * 0.7).sin(), (k * 1.3).cos(), 4.0 + (k * 0.4).sin());
            let (pa, pb) = (a.project(&p).unwrap(), b.project(&p).unwrap());
            assert!(pair.line_in_j(&pa).unwrap().distance(&pb).abs() < 1e-9);
        }
    }

    #[test]
    fn coincident_cameras_have_no_epipolar_geometry() {
        let a = pinhole_at([1e7, 0.0, 0.0]);
        assert!(EpipolarGeometry::new(&a, &a).is_none());
    }

    #[test]
    fn the_epipole_has_no_line() {
        let (a, b) = (pinhole_at([0.0; 3]), pinhole_at([0.0, 0.0, 1.0]));
        let pair = EpipolarGeometry::new(&a, &b).unwrap();
        assert_eq!(pair.line_in_j(&Point2::new(320.0, 240.0)), None);
        assert!(pair.line_in_j(&Point2::new(321.0, 240.0)).is_some());
    }
}
