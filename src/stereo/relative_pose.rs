//! Projection of one camera's pixels, at given inverse depths, into another camera.

use crate::camera::{Camera, CameraModel};
use nalgebra::{Matrix3, Point2, Vector3};

/// Transform from the axes of a reference camera to the axes of another camera, with the other camera's lens.
///
/// A point of the reference camera is given by its ray r = (x, y, 1) and its inverse depth ρ. Its position in the
/// reference camera's axes is `r / ρ`. All positions are multiplied by ρ, so that they are finite at infinity too.
pub(super) struct RelativePose {
    rotation: Matrix3<f32>,
    shift: Vector3<f32>,
    model: CameraModel,
    intrinsics: [f32; 4],
    is_pinhole: bool,
}

impl RelativePose {
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let rotation = to.cam_from_world.rotation * from.cam_from_world.rotation.inverse();
        let shift = to.cam_from_world.rotation * (from.center() - to.center());
        let (fx, fy, cx, cy) = to.model.intrinsics();
        Self {
            rotation: rotation.to_rotation_matrix().into_inner().cast(),
            shift: shift.cast(),
            model: to.model,
            intrinsics: [fx, fy, cx, cy].map(|v| v as f32),
            is_pinhole: to.model.is_pinhole(),
        }
    }

    /// Rotates the reference camera's ray (x, y, 1) into the other camera's axes.
    #[inline(always)]
    pub fn rotated(&self, x: f32, y: f32) -> Vector3<f32> {
        self.rotation * Vector3::new(x, y, 1.0)
    }

    /// Returns the point on a rotated ray at the inverse depth `inverse`, 1/m. The point is in the other camera's axes,
    /// and multiplied by `inverse`.
    #[inline(always)]
    pub fn point(&self, rotated: &Vector3<f32>, inverse: f32) -> Vector3<f32> {
        rotated + self.shift * inverse
    }

    /// Projects a point, as returned by [`Self::point`], into the other camera, pixels. The result is NaN or infinite
    /// if the camera doesn't see the point.
    #[inline(always)]
    pub fn pixel(&self, q: &Vector3<f32>) -> [f32; 2] {
        if !(q.z > 0.0) {
            return [f32::NAN; 2];
        }
        let (nx, ny) = (q.x / q.z, q.y / q.z);
        if self.is_pinhole {
            let [fx, fy, cx, cy] = self.intrinsics;
            return [fx * nx + cx, fy * ny + cy];
        }
        let normalized = Point2::new(f64::from(nx), f64::from(ny));
        // Outside the range in which the lens polynomial is monotonic, the polynomial would map the point back into the
        // image.
        if !self.model.is_short_of_fold(&normalized) {
            return [f32::NAN; 2];
        }
        let pixel = self.model.pixel_from_normalized(&normalized);
        [pixel.x as f32, pixel.y as f32]
    }

    /// Projects the points on the ray (x, y, 1) at the inverse depths `inverses`, 1/m, into the other camera. Writes
    /// their positions to `xs` and `ys`, pixels. They are NaN or infinite where the camera doesn't see a point.
    #[inline(always)]
    pub fn path(&self, [x, y]: [f32; 2], inverses: &[f32], xs: &mut [f32], ys: &mut [f32]) {
        let rotated = self.rotated(x, y);
        if !self.is_pinhole {
            for ((inverse, x), y) in inverses.iter().zip(xs).zip(ys) {
                [*x, *y] = self.pixel(&self.point(&rotated, *inverse));
            }
            return;
        }
        let [fx, fy, cx, cy] = self.intrinsics;
        for ((inverse, x), y) in inverses.iter().zip(xs).zip(ys) {
            let z = rotated.z + self.shift.z * inverse;
            let scale = if z > 0.0 { 1.0 / z } else { f32::NAN };
            *x = fx * (rotated.x + self.shift.x * inverse) * scale + cx;
            *y = fy * (rotated.y + self.shift.y * inverse) * scale + cy;
        }
    }
}
