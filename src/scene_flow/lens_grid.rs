//! Lens distortion, tabulated.

use crate::camera::Camera;
use nalgebra::Point2;

/// Distance between the nodes of the grid, pixels. Between them, positions are interpolated. For a lens with 5 % of
/// distortion at the corners, this is exact to 0.006 pixels.
const STEP: usize = 4;

/// Positions in a camera's image with lens distortion, at the nodes of a grid over its pinhole image.
pub struct LensGrid {
    columns: usize,
    rows: usize,
    /// Position of each node in the camera's image minus that in the pinhole image, row by row, pixels; NaN if it is unknown.
    displacements: Vec<[f32; 2]>,
}

impl LensGrid {
    /// Tabulates the lens of a camera. `pinhole` is a camera without distortion at the same place and in the same
    /// direction. Nodes that can't be projected have no displacement.
    pub fn new(camera: &Camera, pinhole: &Camera) -> Self {
        let [columns, rows] =
            [pinhole.width, pinhole.height].map(|size| size.div_ceil(STEP).max(1) + 1);
        let displacement = |k: usize| {
            let node = Point2::new((k % columns * STEP) as f64, (k / columns * STEP) as f64);
            let there = camera.project_cam(&pinhole.ray(&node)?.into())?;
            Some([(there.x - node.x) as f32, (there.y - node.y) as f32])
        };
        let displacements =
            (0..columns * rows).map(|k| displacement(k).unwrap_or([f32::NAN; 2])).collect();
        Self { columns, rows, displacements }
    }

    /// Returns the size of the grid in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.displacements.as_slice())
    }

    /// Returns the position in the camera's image of a position in the pinhole image, pixels. `None` beside nodes that can't
    /// be projected.
    #[inline(always)]
    pub fn distorted(&self, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
        let split = |at: f32, nodes: usize| {
            // The cast saturates at 0. There are at least two nodes.
            let at = at / STEP as f32;
            let first = (at as usize).min(nodes - 2);
            (first, (at - first as f32).clamp(0.0, 1.0))
        };
        let ((column, fx), (row, fy)) = (split(x, self.columns), split(y, self.rows));
        let at = |dx: usize, dy: usize| self.displacements[(row + dy) * self.columns + column + dx];
        let mix = |a: [f32; 2], b: [f32; 2], f: f32| [0, 1].map(|c| a[c] + (b[c] - a[c]) * f);
        let upper = mix(at(0, 0), at(1, 0), fx);
        let [dx, dy] = mix(upper, mix(at(0, 1), at(1, 1), fx), fy);
        (!dx.is_nan() && !dy.is_nan()).then_some([x + dx, y + dy])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use nalgebra::Isometry3;

    #[test]
    fn positions_are_those_of_the_lens() {
        let size = [(640, 500.0), (481, 490.0)];
        let [(width, fx), (height, fy)] = size;
        let (cx, cy) = (322.0, 236.0);
        let camera = |model: CameraModel| Camera {
            width,
            height,
            model,
            cam_from_world: Isometry3::identity(),
        };
        let (k1, k2, p1, p2) = (-0.18, 0.06, 1e-3, -5e-4);
        let lens = camera(CameraModel::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 });
        let pinhole = camera(CameraModel::Pinhole { fx, fy, cx, cy });
        let grid = LensGrid::new(&lens, &pinhole);
        for (x, y) in (0..=640).step_by(7).flat_map(|x| (0..=481).step_by(7).map(move |y| (x, y))) {
            let ray = pinhole.ray(&Point2::new(f64::from(x), f64::from(y))).unwrap();
            let there = lens.project_cam(&ray.into()).unwrap();
            let [u, v] = grid.distorted([x as f32, y as f32]).unwrap();
            let error = (f64::from(u) - there.x).hypot(f64::from(v) - there.y);
            assert!(error < 0.006, "{x}, {y}: {error} px");
        }
    }
}
