//! Blending weights at the nodes of a square grid over the view. Between the nodes, weights are interpolated. In
//! unstructured lumigraph rendering (Buehler et al., SIGGRAPH 2001), weights are interpolated over a triangulation of
//! the view instead.

use crate::camera::Camera;
use std::ops::Range;

/// Blending weights at the two rows of grid nodes that enclose a row of the view.
pub(super) struct WeightGrid {
    /// Distance between neighbouring nodes, pixels.
    pub step: usize,
    /// Columns of the view that have nodes, ascending. The last of these columns is the view's last column.
    pub columns: Vec<usize>,
    /// Index, among the grid's rows of nodes, of the upper one of the two stored rows. `None` before the rows are
    /// filled.
    above: Option<usize>,
    /// Weights at the nodes of the two stored rows, the upper row first. Each row holds the first source's weights at
    /// all nodes, then the second source's, and so on.
    rows: [Vec<f32>; 2],
    /// Weights at the columns with nodes, interpolated vertically to the current row of the view. The order is that of
    /// `rows`.
    between: Vec<f32>,
}

impl WeightGrid {
    /// Creates a grid with a node every `step` pixels in both directions. `None` if every pixel would be a node, or if
    /// the view has a single column.
    pub fn new(target: &Camera, sources: usize, step: usize) -> Option<Self> {
        let column = |k: usize| (k * step).min(target.width - 1);
        let columns: Vec<usize> = (0..=target.width.div_ceil(step)).map(column).collect();
        let row = || vec![0.0; sources * columns.len()];
        let (rows, between) = ([row(), row()], row());
        (step > 1 && target.width > 1).then_some(Self { step, columns, above: None, rows, between })
    }

    /// Interpolates the weights vertically to row `y` of the view. `fill` computes the weights of one row of nodes; its
    /// arguments are the index of that row, the columns with nodes, and the output, ordered as in `rows`.
    pub fn set_row(&mut self, y: usize, mut fill: impl FnMut(usize, &[usize], &mut [f32])) {
        let above = y / self.step;
        if self.above != Some(above) {
            let is_next = self.above.is_some_and(|last| last + 1 == above);
            self.rows.swap(0, 1);
            for k in usize::from(is_next)..2 {
                fill(above + k, &self.columns, &mut self.rows[k]);
            }
            self.above = Some(above);
        }
        let fraction = (y % self.step) as f32 / self.step as f32;
        let [above, below] = &self.rows;
        for ((between, a), b) in self.between.iter_mut().zip(above).zip(below) {
            *between = a + (b - a) * fraction;
        }
    }

    /// Returns a source's weights, in the current row of the view, at the nodes that enclose a range of columns. The
    /// first node is at the range's first column, which must have a node. The last node is the first one at or after
    /// the range's end. `None` if all these weights are 0.
    pub fn around(&self, source: usize, columns: Range<usize>) -> Option<&[f32]> {
        let (from, last) = (columns.start / self.step, columns.end.div_ceil(self.step));
        let first = source * self.columns.len();
        let weights = &self.between[first + from..=first + last];
        weights.iter().any(|w| *w > 0.0).then_some(weights)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Random, camera_at, rig, sources, tilted, turned};
    use super::super::{BlendOptions, DepthMap, Proxy, blend};
    use crate::camera::CameraModel;
    use crate::raster::Image;

    #[test]
    fn interpolated_weights_are_near_computed_ones_and_cover_the_same_pixels() {
        let mut random = Random::new(37);
        let cameras = rig();
        // Images of different colours, so that every change of a weight shows.
        let images: Vec<Image> = cameras
            .iter()
            .map(|c| Image::filled(c.width, c.height, 3, random.unit() as f32))
            .collect();
        let mut bent = camera_at([0.05, 0.0, 0.1]);
        bent.model = CameraModel::OpenCv {
            fx: 70.0,
            fy: 70.0,
            cx: 48.0,
            cy: 36.0,
            k1: -0.1,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        };
        // The viewpoints are between the cameras, at a camera, and beside all cameras; one view is rotated, and one has
        // lens distortion.
        let targets = [
            camera_at([0.013, 0.02, 0.1]),
            cameras[2].clone(),
            camera_at([-0.6, 0.1, -0.2]),
            turned(camera_at([0.1, 0.0, 0.0]), [0.1, 0.3, 0.2]),
            bent,
        ];
        for target in &targets {
            let pixels = (target.width * target.height) as f64;
            let mut depth = Proxy::Plane(tilted()).depth_map(target).data().to_vec();
            // Some pixels have no depth, and some show the sky.
            for depth_m in [f32::NAN, f32::INFINITY] {
                (0..20).for_each(|_| depth[random.in_range(0.0, pixels) as usize] = depth_m);
            }
            let depth = DepthMap::from_data(target.width, target.height, depth);
            for k in [1, 3] {
                let [computed, interpolated, wide] = [1, 4, 7].map(|weight_step_px| {
                    let options =
                        BlendOptions { cameras: k, weight_step_px, ..BlendOptions::default() };
                    blend(&sources(&cameras, &images), &depth, target, &options)
                });
                for other in [interpolated, wide] {
                    assert!(computed.coverage == other.coverage);
                    let apart = computed.image.data().iter().zip(other.image.data());
                    let apart: Vec<f64> = apart.map(|(a, b)| f64::from((a - b).abs())).collect();
                    let mean = apart.iter().sum::<f64>() / apart.len() as f64;
                    assert!(mean < 0.02, "{mean}");
                }
            }
        }
    }
}
