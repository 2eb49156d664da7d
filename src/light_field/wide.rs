//! Wide arrays: cameras that stand around the scene, many degrees apart, and look at a common place.
//!
//! Features can hardly be matched between such cameras. The range of the scene's depths is therefore not found from
//! triangulated points, but from the volume that at least half of the cameras see.

use super::graph::LightField;
use crate::camera::Camera;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

/// Mean squared angle between cameras' optical axes and their common direction below which the axes count as parallel, rad². Far
/// above rounding errors, and far below that of a wide array.
const PARALLEL: f64 = 1e-9;
/// Minimum angle between neighbouring cameras of a wide array, seen from the place that all cameras look at, radians.
/// It is the largest angle at which features of neighbouring cameras are still matched reliably.
pub const MIN_WIDE_ANGLE_RAD: f64 = 0.12;
/// Maximum angle between neighbouring cameras of a wide array with which scene flow still finds surfaces of one camera in
/// another, radians. It lies between 45 degrees, where views by scene flow are better than by a plane, and 60, where they
/// aren't.
pub const MAX_MATCHED_ANGLE_RAD: f64 = 0.9;
/// Maximum, in a wide array, of the baseline with which scene flow converts inverse depths to disparities. The maximum
/// is given as an angle in radians: the baseline divided by the distance to the place that all cameras look at.
const MATCHING_ANGLE_RAD: f64 = 0.2;
/// Minimum fraction of the other cameras that must see a point, so that the point counts for a camera's range of
/// depths.
const MIN_SEEING: f64 = 0.5;
/// Number of rows, and of columns, of a grid of pixels over a camera's image. Points on the rays of these pixels are
/// tested to find the camera's range of depths.
const RAYS: usize = 9;
/// Smallest and largest inverse depth that is tested to find a camera's range of depths, as multiples of the inverse
/// distance to the place that all cameras look at.
const SEARCHED: [f64; 2] = [0.2, 8.0];
/// Number of inverse depths that are tested along a ray to find a camera's range of depths. Successive inverse depths
/// differ by a constant factor.
const STEPS: usize = 64;

/// The place that all cameras of a wide array look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CommonPlace {
    /// The place in the world, metres.
    pub at: Point3<f64>,
    /// Median distance between the cameras' centres and the place, metres.
    pub distance_m: f64,
}

impl CommonPlace {
    /// Finds the place that all cameras look at, if the array is wide. `None` if there is no such place, because the
    /// cameras look in parallel or away from each other. Also `None` if the angle between neighbours is at most
    /// [`MIN_WIDE_ANGLE_RAD`]. `spacing_m` is the distance between neighbours, metres.
    fn of(cameras: &[&Camera], spacing_m: f64) -> Option<Self> {
        let place = nearest_to_axes(cameras)?;
        let mut distances: Vec<f64> = cameras.iter().map(|c| (c.center() - place).norm()).collect();
        distances.sort_by(f64::total_cmp);
        let distance_m = distances[distances.len() / 2];
        let sees = |c: &&Camera| c.project(&place).is_some_and(|pixel| c.contains(&pixel));
        let is_wide = cameras.iter().all(sees) && spacing_m > MIN_WIDE_ANGLE_RAD * distance_m;
        is_wide.then_some(Self { at: place, distance_m })
    }

    /// Returns the minimum and the maximum inverse depth, 1/m, in the camera with index `own`, of the points that at
    /// least half of the other cameras see. `None` if there are no such points.
    fn range(&self, cameras: &[&Camera], own: usize) -> Option<[f64; 2]> {
        let min_seeing = (MIN_SEEING * (cameras.len() - 1) as f64).ceil() as usize;
        let ratio = (SEARCHED[1] / SEARCHED[0]).powf(1.0 / (STEPS - 1) as f64);
        let camera = cameras[own];
        let mut range: Option<[f64; 2]> = None;
        for k in 0..RAYS * RAYS {
            let at = |k: usize, size: usize| (k as f64 + 0.5) / RAYS as f64 * size as f64;
            let pixel = Point2::new(at(k % RAYS, camera.width), at(k / RAYS, camera.height));
            let Some(ray) = camera.ray_world(&pixel) else { continue };
            for step in 0..STEPS {
                let q = SEARCHED[0] * ratio.powi(step as i32) / self.distance_m;
                let point = camera.center() + ray / q;
                let sees = |c: &Camera| c.project(&point).is_some_and(|p| c.contains(&p));
                let others = cameras.iter().enumerate().filter(|(c, _)| *c != own);
                if others.filter(|(_, c)| sees(c)).count() >= min_seeing {
                    let [min, max] = range.unwrap_or([q, q]);
                    range = Some([min.min(q), max.max(q)]);
                }
            }
        }
        range
    }
}

impl LightField {
    fn filming(&self) -> Vec<&Camera> {
        self.capture().cameras.iter().map(|c| &c.camera).collect()
    }

    /// Returns the place that all cameras look at. `None` if the array isn't wide ([`CommonPlace::of`]).
    pub(super) fn common_place(&self) -> Option<CommonPlace> {
        CommonPlace::of(&self.filming(), self.spacing_m())
    }

    /// Returns the angle between neighbouring cameras of a wide array, radians. It is seen from the place that all cameras
    /// look at. `None` if the array isn't wide: the angle is at most [`MIN_WIDE_ANGLE_RAD`], or there is no such place.
    pub fn wide_angle_rad(&self) -> Option<f64> {
        // The cameras of a wide array are away from the place, so the distance is positive.
        let half_chord = |place: CommonPlace| 0.5 * self.spacing_m() / place.distance_m;
        self.common_place().map(|place| 2.0 * half_chord(place).min(1.0).asin())
    }

    /// Returns the baseline, metres, with which scene flow converts inverse depths to disparities in pixels: twice the
    /// distance between neighbouring cameras. In a wide array, the baseline is at most [`MATCHING_ANGLE_RAD`] times the
    /// distance to the common place, since surfaces of a wide array are matched less precisely.
    pub(super) fn matching_baseline_m(&self) -> f64 {
        let baseline_m = 2.0 * self.spacing_m();
        let longest_m = self.common_place().map(|p| MATCHING_ANGLE_RAD * p.distance_m);
        longest_m.map_or(baseline_m, |longest_m| baseline_m.min(longest_m))
    }

    /// Returns the minimum and the maximum inverse depth, 1/m, in any of the given cameras, of the points that at least
    /// half of the other cameras see ([`CommonPlace::range`]). `None` if there are no such points.
    pub(super) fn common_range(
        &self,
        place: CommonPlace,
        cameras: impl Iterator<Item = usize>,
    ) -> Option<[f64; 2]> {
        let filming = self.filming();
        cameras.filter_map(|c| place.range(&filming, c)).reduce(union)
    }
}

/// Returns the smallest range that contains two ranges.
pub(super) fn union(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the point of the world, metres, that is nearest to the cameras' optical axes in the least-squares sense.
/// `None` for parallel axes.
fn nearest_to_axes(cameras: &[&Camera]) -> Option<Point3<f64>> {
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for camera in cameras {
        let axis = camera.axis();
        let across = Matrix3::identity() - axis * axis.transpose();
        normal += across;
        right += across * camera.center().coords;
    }
    // The smallest eigenvalue is the sum of the squared sines of the angles between the axes and their common direction.
    let is_parallel = normal.symmetric_eigenvalues().min() < PARALLEL * cameras.len() as f64;
    let inverse = normal.try_inverse().filter(|_| !is_parallel)?;
    Some(Point3::from(inverse * right)).filter(|p| p.coords.norm().is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use nalgebra::Isometry3;

    /// Returns cameras on a circle with a radius of 2 m around the origin, `step_deg` degrees apart. All look at the
    /// origin.
    fn ring(count: usize, step_deg: f64) -> Vec<Camera> {
        let camera = |k: usize| {
            let angle = (k as f64 - 0.5 * (count - 1) as f64) * step_deg.to_radians();
            let center = Point3::new(2.0 * angle.sin(), 0.0, -2.0 * angle.cos());
            Camera {
                width: 640,
                height: 480,
                model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
                cam_from_world: Isometry3::face_towards(&center, &Point3::origin(), &Vector3::y())
                    .inverse(),
            }
        };
        (0..count).map(camera).collect()
    }

    fn place(cameras: &[Camera], spacing_m: f64) -> Option<CommonPlace> {
        CommonPlace::of(&cameras.iter().collect::<Vec<_>>(), spacing_m)
    }

    #[test]
    fn cameras_around_a_place_are_wide_and_others_are_not() {
        let found = place(&ring(6, 17.0), 0.59).unwrap();
        assert!(
            (found.distance_m - 2.0).abs() < 1e-9 && found.at.coords.norm() < 1e-9,
            "{found:?}"
        );
        // The cameras are 2 degrees apart, as in the simulated rig `arc8`.
        assert_eq!(place(&ring(8, 2.0), 0.07), None);
        let mut parallel = ring(3, 17.0);
        for (k, camera) in parallel.iter_mut().enumerate() {
            camera.cam_from_world = Isometry3::translation(k as f64, 0.0, 0.0);
        }
        assert_eq!(place(&parallel, 1.0), None);
        // Turned together and away from the world's origin, their axes are parallel up to rounding.
        for k in 0..2000 {
            let random = |step: usize| ((k * step) as f64 * 0.618_033_988_749).fract() * 2.0 - 1.0;
            let turned = Isometry3::new(
                Vector3::new(random(1), random(2), random(3)),
                Vector3::new(random(5), random(7), random(11)) * 3.0,
            );
            let turned: Vec<Camera> = parallel[..2]
                .iter()
                .map(|c| Camera { cam_from_world: c.cam_from_world * turned, ..c.clone() })
                .collect();
            assert_eq!(place(&turned, 0.1), None, "{k}");
        }
        // The cameras look outwards, and their axes meet behind them.
        let mut outward = ring(4, 17.0);
        let turn = Isometry3::rotation(Vector3::y() * std::f64::consts::PI);
        outward.iter_mut().for_each(|c| c.cam_from_world = turn * c.cam_from_world);
        assert_eq!(place(&outward, 0.59), None);
    }

    #[test]
    fn the_range_of_depths_is_what_half_of_the_other_cameras_see() {
        let cameras = ring(3, 30.0);
        let all: Vec<&Camera> = cameras.iter().collect();
        let [min, max] = place(&cameras, 1.0).unwrap().range(&all, 1).unwrap();
        assert!(min < 1.0 / 2.5 && max > 1.0 / 1.6, "{min} {max}");
        // A camera 30 degrees to the side sees no point nearer than 0.4 m on the middle camera's rays. The tested
        // depths end at 10 m.
        assert!(max < 1.0 / 0.4 && min >= 0.1 - 1e-9, "{min} {max}");
    }
}
