//! Ready-made camera paths, which are chosen by name and fitted to any camera rig. A path is made as large as the rig's
//! extent and one condition allow: everything that a view of the path shows, at the scene's depths, lies inside of the
//! image of at least one camera.
//!
//! The rig is modelled by two parabolas: the cameras' centres and the cameras' directions, as functions of the
//! coordinate along the rig's longest extent. The model suits lines, arcs and grids of cameras.
//!
//! Known limit: occlusion is not considered. Surfaces that no camera sees may leave holes in the views.

use super::{CameraPath, PathError, PathKey};
use crate::camera::{Camera, CameraModel};
use crate::method::methods;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// A ready-made camera path, which is chosen by name and fitted to a rig.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReadyMadePath {
    #[default]
    Sweep,
    Orbit,
    BulletTime,
    Dolly,
}

methods!(ReadyMadePath {
    Sweep = "sweep": "from one end of the rig to the other",
    Orbit = "orbit": "a loop along the rig, aimed at the subject",
    BulletTime = "bullet-time": "time stops, the view moves along the rig, time goes on",
    Dolly = "dolly": "ahead towards the subject, and back",
});

/// Data to which a ready-made path is fitted: the rig, the depths of the scene, and the times of the recording and the
/// video.
#[derive(Clone, Copy, Debug)]
pub struct PathScene<'a> {
    /// Cameras of the rig, at least one.
    pub cameras: &'a [Camera],
    /// Camera whose image size the views have. Its field of view is narrowed for the views. Its distortion and its
    /// principal point are ignored.
    pub lens: &'a Camera,
    /// Depths of the scene in front of `lens`, metres: of the scene's nearest part, of the subject, and of the scene's
    /// farthest part.
    pub depths_m: [f64; 3],
    /// First and last instant that the views may show, seconds from the capture's start. `frozen_s` may lie outside of
    /// this span.
    pub span_s: (f64, f64),
    /// Instant at which time is frozen, seconds from the capture's start. All views show this instant, except that time
    /// runs at the start and at the end of a bullet-time video. If it is `None`, time runs within `span_s`; a
    /// bullet-time video then freezes time in its middle part, at the middle of `span_s`.
    pub frozen_s: Option<f64>,
    /// Duration of the video, seconds.
    pub duration_s: f64,
}

/// Number of intervals between the keys of a ready-made path. Splines through the keys approximate the path's formula.
/// With fewer keys, an orbit deviates from its ellipse between them.
const KEYS: usize = 24;

/// Candidates for the field of view of a path's views. Each is the width of a view divided by the width of the view of
/// [`PathScene::lens`], at the same depth. With a narrower field of view, the path can be larger.
const LENSES: [f64; 4] = [0.95, 0.85, 0.7, 0.55];

/// Sufficient extent of a path, as a fraction of the rig's extent. The fields of view in [`LENSES`] are tried in their
/// order, until one allows a path of this extent.
const ENOUGH: f64 = 0.6;

/// Number of bisections in the search for the largest extent of a path.
const HALVINGS: usize = 12;

/// Number of grid points along each side of a view. Each grid point, at each of the scene's depths, must be inside of
/// at least one camera's image.
const SEEN_POINTS: usize = 9;

/// Times at which time stops and starts again in a bullet-time video, as fractions of the video's duration.
const STOP: [f64; 2] = [0.25, 0.75];

/// Maximum length of a dolly movement (towards the subject), as a fraction of the distance to the scene's nearest part.
const DOLLY: f64 = 0.4;

impl ReadyMadePath {
    /// Returns this ready-made path, fitted to a scene.
    ///
    /// # Errors
    /// If a time or the duration in `scene` is out of range.
    pub fn path(self, scene: &PathScene) -> Result<CameraPath, PathError> {
        let rig = RigCurve::new(scene);
        let mut best: Option<(f64, f64)> = None;
        for field in LENSES {
            let is_seen = |extent: f64| {
                let views = self.keys(scene, &rig, (extent, field));
                views.iter().all(|key| rig.sees(&key.camera, scene.cameras))
            };
            let extent = largest(is_seen);
            if extent.is_some_and(|extent| best.is_none_or(|(found, _)| extent > found)) {
                best = extent.map(|extent| (extent, field));
            }
            if best.is_some_and(|(extent, _)| extent >= ENOUGH) {
                break;
            }
        }
        // If the cameras don't see all of a view even without any movement, the path stands still, with the narrowest
        // field of view.
        let (extent, field) = best.unwrap_or((0.0, LENSES[LENSES.len() - 1]));
        CameraPath::new(self.keys(scene, &rig, (extent, field)), false)
    }

    fn keys(self, scene: &PathScene, rig: &RigCurve, extent_and_field: (f64, f64)) -> Vec<PathKey> {
        let (extent, field) = extent_and_field;
        let model = narrowed(scene.lens, field);
        let key = |k: usize| {
            let passed = k as f64 / KEYS as f64;
            let pose = match self {
                Self::Sweep => rig.pose([extent * (2.0 * passed - 1.0), 0.0], 0.0),
                Self::BulletTime => {
                    let moved = ((passed - STOP[0]) / (STOP[1] - STOP[0])).clamp(0.0, 1.0);
                    rig.pose([extent * (2.0 * eased(moved) - 1.0), 0.0], 0.0)
                }
                Self::Orbit => {
                    let (sin, cos) = (TAU * passed).sin_cos();
                    rig.aimed([extent * sin, extent * cos])
                }
                Self::Dolly => {
                    let ahead_m = DOLLY * rig.depths_m[0] * 0.5 * (1.0 - (TAU * passed).cos());
                    rig.pose([0.0; 2], extent * ahead_m)
                }
            };
            let camera = Camera { model, cam_from_world: pose, ..scene.lens.clone() };
            let (first_s, last_s) = scene.span_s;
            let time_s = self.time_s(scene, passed);
            let time_s = scene.frozen_s.map_or_else(|| time_s.clamp(first_s, last_s), |_| time_s);
            let at_s = scene.duration_s * passed;
            // An orbit is a closed loop, and needs no rest at its ends.
            let rest = self != Self::Orbit && (k == 0 || k == KEYS);
            PathKey { at_s, time_s, camera, rest }
        };
        (0..=KEYS).map(key).collect()
    }

    /// Returns the instant of the recording that is shown after a fraction `passed` of the video, seconds from the
    /// capture's start. Time runs at its true speed, or more slowly if the recording is shorter than the video. In
    /// bullet time, it stops during the middle half of the video.
    fn time_s(self, scene: &PathScene, passed: f64) -> f64 {
        let (first_s, last_s) = scene.span_s;
        let middle_s = 0.5 * (first_s + last_s);
        if self != Self::BulletTime {
            let half_s = 0.5 * (last_s - first_s).min(scene.duration_s);
            let runs_s = middle_s + half_s * (2.0 * passed - 1.0);
            return scene.frozen_s.unwrap_or(runs_s);
        }
        let stop_s = scene.frozen_s.unwrap_or(middle_s);
        let [stops, goes_on] = STOP;
        let running_s = 0.5 * scene.duration_s * stops;
        if passed <= stops {
            // Time runs at full speed first, then slows down until it stops.
            let left = 1.0 - passed / stops;
            stop_s - (stop_s - first_s).clamp(0.0, running_s) * left * left
        } else if passed >= goes_on {
            let past = (passed - goes_on) / (1.0 - goes_on);
            stop_s + (last_s - stop_s).clamp(0.0, running_s) * past * past
        } else {
            stop_s
        }
    }
}

/// Ease-in-out function: maps 0 to 0 and 1 to 1, with derivative 0 at both ends.
fn eased(x: f64) -> f64 {
    0.5 * (1.0 - (PI * x).cos())
}

/// Returns the largest extent of a path from 0 to 1 for which `is_seen` is true, by bisection. `is_seen` returns
/// whether cameras see all views of a path with a given extent; it must also be true for all smaller extents. `None` if
/// it is false for the extent 0.
fn largest(is_seen: impl Fn(f64) -> bool) -> Option<f64> {
    if !is_seen(0.0) {
        return None;
    }
    if is_seen(1.0) {
        return Some(1.0);
    }
    let (mut seen, mut unseen) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (seen + unseen);
        if is_seen(middle) { seen = middle } else { unseen = middle }
    }
    Some(seen)
}

/// Returns the intrinsics of a pinhole camera, with its principal point in the middle of the image. Its view at any
/// depth is `field` times as wide as the view of `lens`.
fn narrowed(lens: &Camera, field: f64) -> CameraModel {
    let (fx, fy, ..) = lens.model.intrinsics();
    let (cx, cy) = (0.5 * lens.width as f64, 0.5 * lens.height as f64);
    CameraModel::Pinhole { fx: fx / field, fy: fy / field, cx, cy }
}

/// Model of a camera rig: the cameras' positions and directions as two parabolas along the rig's longest extent.
struct RigCurve {
    /// Mean of the cameras' centres in the world, metres.
    center: Vector3<f64>,
    /// Mean direction of the cameras' z axes, unit vector in the world.
    ahead: Vector3<f64>,
    /// Mean direction of the cameras' y axes, unit vector in the world.
    down: Vector3<f64>,
    /// Two vectors in the world, metres: along the longest and along the second longest extent of the cameras' centres.
    /// The length of a vector is the maximum distance, along it, of a camera's centre from `center`.
    axes: [Vector3<f64>; 2],
    /// Coefficients of 1, s and s² in the parabola of the cameras' positions, metres. The coordinate s runs from −1 to
    /// 1 along the rig's longest extent.
    places: [Vector3<f64>; 3],
    /// Coefficients of 1, s and s² in the parabola of the cameras' directions. The coordinate s runs from −1 to 1 along
    /// the rig's longest extent.
    aheads: [Vector3<f64>; 3],
    /// Depths of the scene, measured from `center` along `ahead`, metres: of the scene's nearest part, of the subject,
    /// and of the scene's farthest part.
    depths_m: [f64; 3],
}

impl RigCurve {
    fn new(scene: &PathScene) -> Self {
        let count = scene.cameras.len() as f64;
        let mean = |of: &dyn Fn(&Camera) -> Vector3<f64>| {
            scene.cameras.iter().map(of).sum::<Vector3<f64>>() / count
        };
        let center = mean(&|camera| camera.center().coords);
        let unit = |v: Vector3<f64>, or: Vector3<f64>| v.try_normalize(1e-9).unwrap_or(or);
        let ahead = unit(mean(&|camera| camera.axis()), scene.lens.axis());
        let down_of = |camera: &Camera| {
            camera.cam_from_world.rotation.inverse_transform_vector(&Vector3::y())
        };
        let down = unit(mean(&down_of), down_of(scene.lens));
        let offsets = || scene.cameras.iter().map(|camera| camera.center().coords - center);
        let scatter: Matrix3<f64> = offsets().map(|offset| offset * offset.transpose()).sum();
        let right = down.cross(&ahead);
        let [first, second] = extents(&scatter, right);
        let half = |axis: &Vector3<f64>| offsets().map(|o| o.dot(axis).abs()).fold(0.0, f64::max);
        let half_m = half(&first);
        let along: Vec<f64> =
            offsets().map(|o| if half_m > 0.0 { o.dot(&first) / half_m } else { 0.0 }).collect();
        let fit = |of: &dyn Fn(&Camera) -> Vector3<f64>| {
            parabola(&along, &scene.cameras.iter().map(of).collect::<Vec<_>>())
        };
        let places = fit(&|camera| camera.center().coords);
        let aheads = fit(&|camera| camera.axis());
        let behind_m = ahead.dot(&(scene.lens.center().coords - center));
        let depths_m = scene.depths_m.map(|depth_m| depth_m + behind_m);
        let axes = [first * half_m, second * half(&second)];
        Self { center, ahead, down, axes, places, aheads, depths_m }
    }

    /// Returns the position in the world, metres, at the rig coordinates (s, t). The coordinate s runs from −1 to 1
    /// along the longest extent of the rig, and t from −1 to 1 along the second longest.
    fn place(&self, [s, t]: [f64; 2]) -> Vector3<f64> {
        at(&self.places, s) + self.axes[1] * t
    }

    /// Returns the pose `cam_from_world` of a view at the rig coordinates (s, t), each from −1 to 1. The view has the
    /// direction that the rig's cameras have at s. The view is moved by `ahead_m` metres in this direction.
    fn pose(&self, along: [f64; 2], ahead_m: f64) -> Isometry3<f64> {
        let ahead = at(&self.aheads, along[0]).try_normalize(1e-9).unwrap_or(self.ahead);
        looking(self.place(along) + ahead * ahead_m, ahead, self.down)
    }

    /// Returns the pose `cam_from_world` of a view that looks at the subject from the rig coordinates (s, t), each from
    /// −1 to 1. The subject is the point straight ahead of the rig's centre at the subject's depth.
    fn aimed(&self, along: [f64; 2]) -> Isometry3<f64> {
        let place = self.place(along);
        let subject = self.center + self.ahead * self.depths_m[1];
        let ahead = (subject - place).try_normalize(1e-9).unwrap_or(self.ahead);
        looking(place, ahead, self.down)
    }

    /// Returns whether every point of a grid in a view, at each of the scene's depths, is inside of the image of at
    /// least one of `cameras`. Occlusion is ignored.
    fn sees(&self, view: &Camera, cameras: &[Camera]) -> bool {
        let center = view.center();
        let last = (SEEN_POINTS - 1) as f64;
        let points = (0..SEEN_POINTS * SEEN_POINTS).map(|k| {
            let [x, y] = [k % SEEN_POINTS, k / SEEN_POINTS].map(|i| i as f64 / last);
            Point2::new(x * view.width as f64, y * view.height as f64)
        });
        points.filter_map(|pixel| view.ray_world(&pixel)).all(|ray| {
            self.depths_m.iter().all(|depth_m| {
                let towards = ray.dot(&self.ahead);
                let left_m = depth_m - self.ahead.dot(&(center.coords - self.center));
                let point = center + ray * (left_m / towards);
                towards > 0.0 && left_m > 0.0 && cameras.iter().any(|c| is_inside(c, &point))
            })
        })
    }
}

fn is_inside(camera: &Camera, point: &Point3<f64>) -> bool {
    camera.project(point).is_some_and(|pixel| camera.contains(&pixel))
}

/// Returns two unit vectors: the directions of the largest and of the second largest extent of some points. `scatter`
/// is the scatter matrix of the points. The first direction has no negative component along `right`.
fn extents(scatter: &Matrix3<f64>, right: Vector3<f64>) -> [Vector3<f64>; 2] {
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let axis = |k: usize| -> Vector3<f64> { eigen.eigenvectors.column(order[k]).into_owned() };
    let first = axis(0);
    [if first.dot(&right) < 0.0 { -first } else { first }, axis(1)]
}

/// Returns the coefficients of 1, s and s² of the least-squares parabola through `values`. `along` has the coordinate s
/// of each value, from −1 to 1. If fewer than three coordinates are distinct, the parabola has a lower degree.
fn parabola(along: &[f64], values: &[Vector3<f64>]) -> [Vector3<f64>; 3] {
    let basis = |s: f64| Vector3::new(1.0, s, s * s);
    let mean = values.iter().sum::<Vector3<f64>>() / values.len() as f64;
    let normal: Matrix3<f64> = along.iter().map(|s| basis(*s) * basis(*s).transpose()).sum();
    let right: Matrix3<f64> =
        along.iter().zip(values).map(|(s, value)| basis(*s) * (value - mean).transpose()).sum();
    // If the coordinates don't determine the coefficients, the pseudo-inverse gives the smallest coefficients.
    let inverse = normal.pseudo_inverse(1e-9).unwrap_or_else(|_| Matrix3::zeros());
    let solved = inverse * right;
    let [constant, linear, square] = [0, 1, 2].map(|row| solved.row(row).transpose());
    [mean + constant, linear, square]
}

fn at([constant, linear, square]: &[Vector3<f64>; 3], s: f64) -> Vector3<f64> {
    constant + linear * s + square * (s * s)
}

/// Returns the pose `cam_from_world` of a camera at `place` that looks along `ahead`. Its y axis is the direction
/// perpendicular to `ahead` that is nearest to `down`.
fn looking(place: Vector3<f64>, ahead: Vector3<f64>, down: Vector3<f64>) -> Isometry3<f64> {
    let rotation = UnitQuaternion::face_towards(&ahead, &down);
    Isometry3::from_parts(place.into(), rotation).inverse()
}
