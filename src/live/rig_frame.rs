//! Viewpoints of pictures: the cameras, the ground-truth images, and free positions in the rig's own axes. These axes
//! are x to the right, y up and z ahead, in metres. Their origin is the mean of the cameras' centres.

use super::{LiveError, PictureRequest, Place, ViewDirection};
use crate::camera::{Camera, CameraModel};
use crate::capture::Capture;
use crate::text::number;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// Maximum distance of viewpoints from the cameras' bounding box, along each axis, as a fraction of the box's longest
/// side. [`MARGIN_SPACINGS`] applies instead if it gives a longer distance.
const MARGIN_FRACTION: f64 = 0.5;
/// Maximum distance of viewpoints from the cameras' bounding box, along each axis, as a multiple of the spacing of
/// neighbouring cameras. [`MARGIN_FRACTION`] applies instead if it gives a longer distance.
const MARGIN_SPACINGS: f64 = 2.0;
/// Maximum distance of viewpoints from the camera of a rig with a single camera, along each axis, metres.
const LONE_MARGIN_M: f64 = 0.1;
/// Distance from the viewpoint at which a camera's weight has fallen to half, as a multiple of the spacing of
/// neighbouring cameras. The view's direction is the mean of the cameras' viewing directions with these weights.
const SOFT_SPACINGS: f64 = 0.5;
/// Range of allowed zooms. A zoom is the focal length of a picture as a multiple of the reference camera's focal
/// length.
pub(super) const ZOOMS: std::ops::RangeInclusive<f64> = 0.25..=16.0;
/// Maximum angle by which the user may rotate a view to each side, up and down, degrees. It is measured from the
/// direction that the viewpoint has by default.
pub(super) const MAX_TURN_DEG: f64 = 20.0;
/// Minimum width and height of a requested picture, pixels.
const MIN_SIZE_PX: u32 = 16;

/// Coordinate frame of a camera rig, with its cameras and the viewpoints of ground-truth images.
#[derive(Clone, Debug)]
pub struct RigFrame {
    /// Transform from the rig's axes to the world, metres. In this transform, the rig's axes are x to the right, y down
    /// and z ahead.
    world_from_rig: Isometry3<f64>,
    /// Cameras of the rig, in the capture's order.
    cameras: Vec<Camera>,
    reference: usize,
    truths: Vec<Camera>,
    /// Median distance between neighbouring cameras, metres. 0 for a single camera.
    pub(super) spacing_m: f64,
}

/// Returns two weighted sums over the cameras, in world coordinates: of their viewing directions, and of their downward
/// axes.
fn axis_sums(cameras: &[Camera], weight: impl Fn(&Camera) -> f64) -> [Vector3<f64>; 2] {
    let mut sums = [Vector3::zeros(); 2];
    for camera in cameras {
        let down = camera.cam_from_world.rotation.inverse() * Vector3::y();
        sums[0] += camera.axis() * weight(camera);
        sums[1] += down * weight(camera);
    }
    sums
}

/// Returns the rotation `world_from_cam` of a camera that looks along `ahead`, with its y axis as close to `down` as
/// possible. `None` if the two vectors are parallel, or if one is almost 0.
fn looking(ahead: Vector3<f64>, down: Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let ahead = ahead.try_normalize(1e-6)?;
    let right = down.cross(&ahead).try_normalize(1e-6)?;
    let down = ahead.cross(&right);
    let axes = Matrix3::from_columns(&[right, down, ahead]);
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)))
}

impl RigFrame {
    /// Creates the coordinate frame of a capture's cameras. The axis `ahead` has the cameras' mean direction, or the
    /// reference camera's direction if the mean is undefined. `spacing_m` is the median distance between neighbouring
    /// cameras. `truths` are the cameras of the ground-truth images.
    pub fn new(capture: &Capture, spacing_m: f64, truths: Vec<Camera>) -> Self {
        let cameras: Vec<Camera> = capture.cameras.iter().map(|c| c.camera.clone()).collect();
        let count = cameras.len() as f64;
        let [ahead, down] = axis_sums(&cameras, |_| 1.0);
        let reference = capture.reference;
        let rotation = looking(ahead / count, down / count)
            .unwrap_or_else(|| cameras[reference].cam_from_world.rotation.inverse());
        let middle = cameras.iter().map(|c| c.center().coords).sum::<Vector3<f64>>() / count;
        let world_from_rig = Isometry3::from_parts(middle.into(), rotation);
        Self { world_from_rig, cameras, reference, truths, spacing_m }
    }

    /// Returns the maximum width and height of a picture, pixels: the size of the reference camera's images.
    pub fn largest_size(&self) -> [usize; 2] {
        let reference = &self.cameras[self.reference];
        [reference.width, reference.height]
    }

    /// Returns the pinhole camera of a requested picture.
    ///
    /// # Errors
    /// If the position, the rotation, the zoom or the size is out of bounds, or if there is no camera or ground-truth
    /// image with the requested index.
    pub fn camera(&self, request: &PictureRequest) -> Result<Camera, LiveError> {
        let found = |all: &[Camera], index: usize, what: &str| match all.get(index) {
            Some(camera) => self.at_camera(camera, &request.view),
            None => Err(LiveError::Request(format!("at: there is no such {what}"))),
        };
        match request.place {
            Place::Free(place) => self.at_place(place, &request.view),
            Place::Camera(index) => found(&self.cameras, index, "camera"),
            Place::Truth(index) => found(&self.truths, index, "image of the truth"),
        }
    }

    /// Converts a world point to the rig's axes: right, up, ahead, metres.
    pub fn place(&self, point: &Point3<f64>) -> [f64; 3] {
        let p = self.world_from_rig.inverse_transform_point(point);
        [p.x, -p.y, p.z]
    }

    /// Returns the cameras' positions in the rig's axes (right, up, ahead, metres), in the capture's order.
    pub fn places(&self) -> Vec<[f64; 3]> {
        self.cameras.iter().map(|c| self.place(&c.center())).collect()
    }

    /// Returns the cameras' positions, followed by the midpoints between each camera and its nearest neighbour at
    /// another position. Points are in the rig's axes, metres.
    pub fn places_and_middles(&self) -> Vec<[f64; 3]> {
        let own = self.places();
        let distance =
            |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
        let middle = |a: &[f64; 3]| {
            let others = own.iter().filter(|b| distance(a, b) > 0.0);
            let b = others.min_by(|b, c| distance(a, b).total_cmp(&distance(a, c)))?;
            Some([0, 1, 2].map(|k| 0.5 * (a[k] + b[k])))
        };
        own.iter().copied().chain(own.iter().filter_map(middle)).collect()
    }

    /// Returns the minimum and the maximum coordinates of allowed viewpoints: two points in the rig's axes, metres.
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for place in self.places() {
            for k in 0..3 {
                low[k] = low[k].min(place[k]);
                high[k] = high[k].max(place[k]);
            }
        }
        let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let margin = (MARGIN_FRACTION * extent).max(MARGIN_SPACINGS * self.spacing_m);
        let margin = if margin > 0.0 { margin } else { LONE_MARGIN_M };
        [low.map(|v| v - margin), high.map(|v| v + margin)]
    }

    /// Returns the pinhole camera of a view from a position in the rig's axes. It looks in the mean direction of nearby
    /// cameras, rotated as `view` requests.
    ///
    /// # Errors
    /// If the position is out of bounds, and the errors of [`Self::at_camera`].
    fn at_place(&self, place: [f64; 3], view: &ViewDirection) -> Result<Camera, LiveError> {
        let [low, high] = self.bounds();
        // The tolerance allows for the rounding of bounds and coordinates by the page.
        let is_inside = (0..3).all(|k| {
            let slack = 1e-6 * (high[k] - low[k]);
            (low[k] - slack..=high[k] + slack).contains(&place[k])
        });
        if !is_inside {
            let [x, y, z] = place.map(|metres| number(format!("{metres:.3}")));
            return Err(LiveError::Request(format!(
                "the viewpoint is too far from the cameras: {x} m to the right, {y} m up and {z} m ahead of their middle"
            )));
        }
        let center = self.world_from_rig * Point3::new(place[0], -place[1], place[2]);
        self.pinhole(center, self.direction(&center), view)
    }

    /// Returns the pinhole camera of a view from the position of `camera`. It looks in the direction of `camera`,
    /// rotated as `view` requests.
    ///
    /// # Errors
    /// If the size, the zoom or the rotation is out of bounds.
    fn at_camera(&self, camera: &Camera, view: &ViewDirection) -> Result<Camera, LiveError> {
        self.pinhole(camera.center(), camera.cam_from_world.rotation.inverse(), view)
    }

    /// Returns the default orientation `world_from_cam` of a view from `center`: the weighted mean orientation of the
    /// cameras. Cameras near to `center` have larger weights.
    fn direction(&self, center: &Point3<f64>) -> UnitQuaternion<f64> {
        let soft_m = (SOFT_SPACINGS * self.spacing_m).max(1e-9);
        let [ahead, down] = axis_sums(&self.cameras, |camera| {
            1.0 / ((camera.center() - center).norm_squared() / soft_m.powi(2) + 1.0)
        });
        looking(ahead, down).unwrap_or(self.world_from_rig.rotation)
    }

    /// Returns a pinhole camera at `center`, rotated from the orientation `world_from_cam` as `view` requests. At zoom
    /// 1, its field of view is that of the reference camera's image, cropped symmetrically to the aspect ratio of the
    /// picture.
    fn pinhole(
        &self,
        center: Point3<f64>,
        world_from_cam: UnitQuaternion<f64>,
        view: &ViewDirection,
    ) -> Result<Camera, LiveError> {
        self.check(view)?;
        let [right, up] = view.turn_deg.map(f64::to_radians);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), right)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), up);
        let cam_from_world = (world_from_cam * turn).inverse();
        let (fx, fy, cx, cy) = self.cameras[self.reference].model.intrinsics();
        let [width, height] = self.largest_size().map(|v| v as f64);
        let [w, h] = view.size.map(f64::from);
        let scale = (w / width).max(h / height) * view.zoom;
        let model = CameraModel::Pinhole {
            fx: scale * fx,
            fy: scale * fy,
            cx: w / 2.0 + scale * (cx - width / 2.0),
            cy: h / 2.0 + scale * (cy - height / 2.0),
        };
        let translation = -(cam_from_world * center.coords);
        let cam_from_world = Isometry3::from_parts(translation.into(), cam_from_world);
        let [width, height] = view.size.map(|v| v as usize);
        Ok(Camera { width, height, model, cam_from_world })
    }

    fn check(&self, view: &ViewDirection) -> Result<(), LiveError> {
        let wrong = |what: String| Err(LiveError::Request(what));
        if !ZOOMS.contains(&view.zoom) {
            let (low, high) = (ZOOMS.start(), ZOOMS.end());
            return wrong(format!("zoom: is {}, must be from {low} to {high}", number(view.zoom)));
        }
        if !view.turn_deg.iter().all(|t| t.abs() <= MAX_TURN_DEG) {
            return wrong(format!("turn: must be at most {MAX_TURN_DEG} degrees"));
        }
        let largest = self.largest_size().map(|v| (v as u32).max(MIN_SIZE_PX));
        if view.size.iter().zip(largest).any(|(&s, max)| s < MIN_SIZE_PX || s > max) {
            let [w, h] = view.size;
            return wrong(format!(
                "size: is {w}×{h}, must be from {MIN_SIZE_PX}×{MIN_SIZE_PX} to {}×{}",
                largest[0], largest[1]
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::pinhole_at;
    use crate::capture::{Clock, Color, FilmedCamera};
    use crate::raster::BitDepth;

    fn rig(cameras: Vec<Camera>) -> RigFrame {
        let clock = Clock { times_s: vec![0.0], shared: true, ..Clock::default() };
        let filmed = |(k, camera): (usize, Camera)| FilmedCamera {
            id: format!("cam{k}"),
            camera,
            color: Color::Rgb,
            clock: clock.clone(),
            frames: Vec::new(),
            video: None,
            bit_depth: BitDepth::Eight,
        };
        let cameras = cameras.into_iter().enumerate().map(filmed).collect();
        RigFrame::new(&Capture::without_files(cameras), 0.1, Vec::new())
    }

    fn line() -> RigFrame {
        rig([-0.1, 0.0, 0.1].map(|x| pinhole_at([x + 5.0, 2.0, -3.0])).to_vec())
    }

    fn plain(size: [u32; 2]) -> ViewDirection {
        ViewDirection { turn_deg: [0.0; 2], zoom: 1.0, size }
    }

    #[test]
    fn at_a_cameras_place_it_is_that_camera() {
        let wanted = pinhole_at([5.1, 2.0, -3.0]);
        let rig = line();
        let view = rig.at_place(rig.place(&wanted.center()), &plain([640, 480])).unwrap();
        assert_eq!(view.model, wanted.model);
        assert!(
            (view.cam_from_world.to_matrix() - wanted.cam_from_world.to_matrix()).norm() < 1e-12
        );
        let like = rig.at_camera(&wanted, &plain([640, 480])).unwrap();
        assert!(
            (like.cam_from_world.to_matrix() - wanted.cam_from_world.to_matrix()).norm() < 1e-12
        );
    }

    #[test]
    fn axes_are_right_up_and_ahead() {
        let view = line().at_place([0.05, 0.04, 0.03], &plain([640, 480])).unwrap();
        assert!((view.center() - Point3::new(5.05, 1.96, -2.97)).norm() < 1e-12);
    }

    #[test]
    fn a_narrow_picture_is_a_part_of_the_whole_one() {
        let rig = line();
        let whole = rig.at_place([0.0; 3], &plain([640, 480])).unwrap();
        let narrow = rig.at_place([0.0; 3], &plain([222, 480])).unwrap();
        let point = Point3::new(5.1, 2.1, -1.0);
        let (a, b) = (whole.project(&point).unwrap(), narrow.project(&point).unwrap());
        assert!((a.x - 320.0 - (b.x - 111.0)).abs() < 1e-9 && (a.y - b.y).abs() < 1e-9);
    }

    #[test]
    fn turning_right_moves_the_picture_left_and_turning_up_moves_it_down() {
        let rig = line();
        let at = |turn_deg| {
            let view = ViewDirection { turn_deg, ..plain([640, 480]) };
            rig.at_place([0.0; 3], &view).unwrap().project(&Point3::new(5.0, 2.0, 0.0)).unwrap()
        };
        assert!(at([5.0, 0.0]).x < 300.0 && at([0.0, 5.0]).y > 260.0);
    }

    #[test]
    fn a_rig_that_turns_inwards_is_followed() {
        let turned = |x: f64, angle: f64| {
            let mut camera = pinhole_at([0.0; 3]);
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -angle);
            camera.cam_from_world =
                Isometry3::from_parts((-(rotation * Vector3::new(x, 0.0, 0.0))).into(), rotation);
            camera
        };
        let rig = rig(vec![turned(-1.0, 0.3), turned(0.0, 0.0), turned(1.0, -0.3)]);
        let ahead = |x: f64| rig.at_place([x, 0.0, 0.0], &plain([640, 480])).unwrap().axis();
        assert!(ahead(-1.0).x > 0.2 && ahead(0.0).x.abs() < 1e-9 && ahead(1.0).x < -0.2);
    }

    #[test]
    fn what_is_out_of_bounds_is_refused_in_a_sentence() {
        let rig = line();
        let refused =
            |place, view: ViewDirection| rig.at_place(place, &view).unwrap_err().to_string();
        assert!(refused([9.0, 0.0, 0.0], plain([640, 480])).contains("too far"));
        assert!(refused([f64::NAN; 3], plain([640, 480])).contains("too far"));
        assert!(refused([0.0; 3], plain([641, 480])).starts_with("size"));
        assert!(refused([0.0; 3], plain([0, 480])).starts_with("size"));
        let zoomed = |zoom| ViewDirection { zoom, ..plain([640, 480]) };
        assert!(refused([0.0; 3], zoomed(f64::NAN)).starts_with("zoom"));
        let turned = ViewDirection { turn_deg: [0.0, 99.0], ..plain([640, 480]) };
        assert!(refused([0.0; 3], turned).starts_with("turn"));
        let [low, high] = rig.bounds();
        assert!(rig.at_place(low, &plain([640, 480])).is_ok());
        assert!(rig.at_place(high, &plain([640, 480])).is_ok());
        assert!(self::rig(vec![pinhole_at([0.0; 3])]).bounds()[1][0] > 0.0);
    }
}
