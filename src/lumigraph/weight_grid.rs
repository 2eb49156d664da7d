//! Weights at the nodes of a square grid over the view, between which they are interpolated. Buehler et al.
//! interpolate over a triangulation of the view.

use crate::camera::Camera;
use std::ops::Range;

/// The two rows of nodes around a row of the view. Weights are stored source by source.
pub(super) struct WeightGrid {
    /// Distance of the nodes, pixels.
    pub step: usize,
    width: usize,
    height: usize,
    /// Number of nodes in a row.
    pub columns: usize,
    /// Two neighbouring rows of nodes.
    rows: [NodeRow; 2],
    /// Weights at the nodes' columns, interpolated to the row of the view.
    between: Vec<f32>,
}

impl WeightGrid {
    /// Nodes every `step` pixels of a view. `None` if each pixel would be one, or the view has a single column.
    pub fn new(target: &Camera, sources: usize, step: usize) -> Option<Self> {
        let columns = target.width.div_ceil(step) + 1;
        let row = || NodeRow { index: None, weights: vec![0.0; sources * columns] };
        (step > 1 && target.width > 1).then(|| Self {
            step,
            width: target.width,
            height: target.height,
            columns,
            rows: [row(), row()],
            between: vec![0.0; sources * columns],
        })
    }

    /// Columns of the view that have nodes; the last is the view's last column.
    pub fn pixel_columns(&self) -> impl Iterator<Item = usize> + use<> {
        let (step, last) = (self.step, self.width - 1);
        (0..self.columns).map(move |column| (column * step).min(last))
    }

    /// Row of the view that a row of nodes lies in; the last is the view's last row.
    pub fn pixel_row(&self, row: usize) -> usize {
        (row * self.step).min(self.height - 1)
    }

    /// Moves to row `y` of the view; returns the indices of the node rows that must be filled.
    pub fn missing(&mut self, y: usize) -> Vec<usize> {
        let above = y / self.step;
        if self.rows[1].index == Some(above) {
            self.rows.swap(0, 1);
        }
        let needed = [above, above + 1].into_iter().zip(self.rows.each_mut());
        let missing = needed.filter_map(|(index, row)| {
            let is_missing = row.index != Some(index);
            row.index = Some(index);
            is_missing.then_some(index)
        });
        missing.collect()
    }

    /// Weights of a source in a row of nodes that must be filled.
    ///
    /// # Panics
    /// If the row is neither of the two.
    pub fn weights_mut(&mut self, row: usize, source: usize, columns: Range<usize>) -> &mut [f32] {
        let own = self.indices(source, columns);
        let row = self.rows.iter_mut().find(|known| known.index == Some(row));
        &mut row.expect("one of the two rows of nodes").weights[own]
    }

    /// Interpolates weights to row `y` of the view; its node rows must be filled.
    pub fn set_row(&mut self, y: usize) {
        let fraction = (y % self.step) as f32 / self.step as f32;
        let [above, below] = &self.rows;
        for ((between, a), b) in self.between.iter_mut().zip(&above.weights).zip(&below.weights) {
            *between = a + (b - a) * fraction;
        }
    }

    /// Weights of a source at the nodes from the first of these columns, which has a node, to the first at or after the
    /// last. `None` if all are 0.
    pub fn around(&self, source: usize, columns: Range<usize>) -> Option<&[f32]> {
        let (from, last) = (columns.start / self.step, columns.end.div_ceil(self.step));
        let weights = &self.between[self.indices(source, from..last + 1)];
        weights.iter().any(|w| *w > 0.0).then_some(weights)
    }

    /// Indices of a source's weights in a row.
    fn indices(&self, source: usize, columns: Range<usize>) -> Range<usize> {
        let first = source * self.columns;
        first + columns.start..first + columns.end
    }
}

/// Weights of one row of nodes.
struct NodeRow {
    /// The row's index; `None` before it is filled.
    index: Option<usize>,
    weights: Vec<f32>,
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
        // Images that differ all over, so that every change of a weight shows.
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
        // Among the cameras, at one of them, beside them all, turned, and by another lens.
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
            // Single pixels without depth, and at the sky.
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
