//! Projection of surface elements from one camera into another, and lens distortion.

use crate::camera::Camera;
use nalgebra::{Matrix3, Point2};
use std::ops::Range;

/// Mapping of a pixel `(x, y)` with inverse depth `q` from one pinhole camera to another. The homogeneous pixel in the
/// other camera is `A (x, y, 1) + q b`. A and b are computed in f64 and stored in f32. With f32, positions in an image
/// 4,000 pixels wide are exact to 0.0005 pixels.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    pub(super) a: [[f32; 3]; 3],
    pub(super) b: [f32; 3],
}

/// Smallest third homogeneous coordinate of a valid projected point. A point with a smaller one is behind the camera
/// or almost in its principal plane, and outside every image.
pub const MIN_RATIO: f32 = 1e-6;
/// Distance between positions at which lens distortion is computed to bound its effect, pixels.
const SAMPLE_STEP: usize = 8;
/// Both coordinates of an invalid projected point, pixels.
pub const BEHIND_PX: f32 = -1e9;

impl Projection {
    /// Computes the projection from one camera to another, both without lens distortion. `None` if the intrinsic
    /// matrix of `from` is singular.
    pub fn new(from: &Camera, to: &Camera) -> Option<Self> {
        let to_from = to.cam_from_world * from.cam_from_world.inverse();
        let rotation = to_from.rotation.to_rotation_matrix();
        let a = intrinsic_matrix(to) * rotation.matrix() * intrinsic_matrix(from).try_inverse()?;
        let b = intrinsic_matrix(to) * to_from.translation.vector;
        let a = [0, 1, 2].map(|i| [0, 1, 2].map(|j| a[(i, j)] as f32));
        Some(Self { a, b: [b.x as f32, b.y as f32, b.z as f32] })
    }

    /// Projects a pixel with inverse depth `q` to the other camera. Returns its pixel and inverse depth there, `[u,
    /// v, q]`. A point behind the camera gets a pixel far outside the image, and the inverse depth 0.
    #[inline(always)]
    pub fn project(&self, x: f32, y: f32, q: f32) -> [f32; 3] {
        let [u, v, q, _] = self.project_and_near(x, y, q);
        [u, v, q]
    }

    /// Like [`Self::project`]. Returns also the ratio of the inverse depth in the other camera to `q`, which is 0 behind
    /// it: `[u, v, q, ratio]`.
    #[inline(always)]
    pub fn project_and_near(&self, x: f32, y: f32, q: f32) -> [f32; 4] {
        let [u, v, w] = self.homogeneous(x, y, q);
        let is_behind = w < MIN_RATIO;
        // Where the ratio is too small for a division, the quotients aren't used. Selections are vectorized; a return
        // isn't.
        let inverse = 1.0 / w;
        let select = |value: f32, behind: f32| if is_behind { behind } else { value };
        [
            select(u * inverse, BEHIND_PX),
            select(v * inverse, BEHIND_PX),
            select(q * inverse, 0.0),
            select(inverse, 0.0),
        ]
    }

    /// Returns the homogeneous pixel in the other camera of a pixel with inverse depth `q`.
    #[inline(always)]
    pub fn homogeneous(&self, x: f32, y: f32, q: f32) -> [f32; 3] {
        let row = |i: usize| {
            let [a, b, c] = self.a[i];
            a * x + b * y + c + q * self.b[i]
        };
        [row(0), row(1), row(2)]
    }
}

fn intrinsic_matrix(camera: &Camera) -> Matrix3<f64> {
    let (fx, fy, cx, cy) = camera.model.intrinsics();
    Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
}

/// Returns the undistorted position of a pixel of a view: its position in a pinhole camera with the same intrinsics.
/// `None` where the lens model can't be inverted.
pub fn undistorted(view: &Camera, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
    if view.model.is_pinhole() {
        return Some([x, y]);
    }
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let ray = view.ray(&Point2::new(f64::from(x), f64::from(y)))?;
    Some([(cx + fx * ray.x) as f32, (cy + fy * ray.y) as f32])
}

/// Returns the largest ratio of a distance in a view without lens distortion to the same distance with it; 1 for a pinhole
/// camera. It is that of short distances near the border of the view. Infinite where the lens model can't be inverted.
pub fn stretch(view: &Camera) -> f32 {
    if view.model.is_pinhole() {
        return 1.0;
    }
    let [width, height] = [view.width, view.height].map(|side| side as f32);
    let (across, down) = (samples(0..view.width), samples(0..view.height));
    let across = across.flat_map(|x| [[x, 0.0], [x, height]]);
    let down = down.flat_map(|y| [[0.0, y], [width, y]]);
    across.chain(down).fold(1.0f32, |stretch, [x, y]| {
        // A pixel towards the middle.
        let step = |at: f32, size: f32| at + if 2.0 * at < size { 1.0 } else { -1.0 };
        let place = undistorted(view, [x, y]);
        let beside = [[step(x, width), y], [x, step(y, height)]].map(|at| undistorted(view, at));
        let distance = |beside: Option<[f32; 2]>| {
            let ([u, v], [a, b]) = (place?, beside?);
            Some((u - a).hypot(v - b))
        };
        stretch.max(
            beside.map(|b| distance(b).unwrap_or(f32::INFINITY)).into_iter().fold(0.0, f32::max),
        )
    })
}

/// Returns positions from the start to the end of a range, both included, at most [`SAMPLE_STEP`] pixels apart.
pub fn samples(range: Range<usize>) -> impl Iterator<Item = f32> {
    let end = range.end;
    range.step_by(SAMPLE_STEP).chain([end]).map(|at| at as f32)
}

/// Applies a view's lens distortion to a position of a pinhole camera with the same intrinsics. This is the inverse
/// of [`undistorted`]. `None` beyond the range in which the lens model is monotonic.
pub fn distorted(view: &Camera, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
    if view.model.is_pinhole() {
        return Some([x, y]);
    }
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let ideal = Point2::new((f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy);
    view.model.is_short_of_fold(&ideal).then(|| {
        let pixel = view.model.pixel_from_normalized(&ideal);
        [pixel.x as f32, pixel.y as f32]
    })
}
