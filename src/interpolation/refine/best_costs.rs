//! How well the motions around a frame's pixels explain them.

use super::candidates::Candidates;
use super::cost_points::CostPoints;
use super::patch::Patch;
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::difference;
use crate::interpolation::{Motion, RefineOptions};
use crate::raster::{Image, box_filter};
use nalgebra::{Point2, Vector2};
use std::sync::OnceLock;

/// Minimum side of the cells, pixels, which share their candidate motions; it is at least four times a window's
/// radius. Larger: motions of other surfaces are tried; smaller: time.
const MIN_CELL: usize = 16;

/// Per pixel of a frame, the smallest cost of any motion around it: its difference from where the motion leads in
/// another frame. Where it is small the pixel shows a surface that moves so, and none that moves otherwise.
/// Cells are computed when first asked for.
pub struct BestCosts<'a> {
    frame: &'a Image,
    /// The other frames, each with its index in [`Motion::to`].
    others: Vec<(usize, &'a Image)>,
    /// From their positions in the frame.
    candidates: Candidates<'a>,
    /// Points in a window's radius, and pixels from a point to the next.
    radius: usize,
    step: usize,
    /// Side of a cell, pixels.
    side: usize,
    cells: Vec<OnceLock<Vec<f32>>>,
    across: usize,
}

impl<'a> BestCosts<'a> {
    /// Of a frame and of the `others` where they exist, each with its index in [`Motion::to`]. `options` have
    /// lengths scaled to the image's size.
    pub fn new(
        (index, frame): (usize, &'a Image),
        others: [(usize, Option<&'a Image>); 2],
        motions: &[Motion],
        options: &'a RefineOptions,
    ) -> Self {
        let from_frame = |m: &Motion| {
            let own = m.to[index];
            Motion { at: m.at + own, to: m.to.map(|to| to - own), ..*m }
        };
        let side = MIN_CELL.max(4 * options.window_radius_px);
        let CostPoints { radius, step, .. } = CostPoints::new(options.window_radius_px, side);
        let across = frame.width().div_ceil(side);
        let cells = across * frame.height().div_ceil(side);
        Self {
            frame,
            others: others.into_iter().filter_map(|(k, image)| Some((k, image?))).collect(),
            candidates: Candidates::new(motions.iter().map(from_frame).collect(), options),
            radius,
            step,
            side,
            cells: (0..cells).map(|_| OnceLock::new()).collect(),
            across,
        }
    }

    /// Points along a cell's side.
    fn points(&self) -> usize {
        self.side.div_ceil(self.step)
    }

    /// At a place in the frame, of the point nearest to the pixel there; infinite where no motion is near.
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let pixel = |v: f32, size: usize| (v.max(0.0) as usize).min(size - 1);
        let (x, y) = (pixel(x, self.frame.width()), pixel(y, self.frame.height()));
        let ([column, row], [x, y]) =
            ([x, y].map(|v| v / self.side), [x, y].map(|v| v % self.side));
        let cell = self.cells[row * self.across + column]
            .get_or_init(|| self.cell(Point2::from([column, row].map(|v| (v * self.side) as f64))));
        cell[y / self.step * self.points() + x / self.step]
    }

    /// Costs of the cell whose top-left corner this is, row by row. Each point is in the middle of the pixels that it
    /// stands for.
    fn cell(&self, corner: Point2<f64>) -> Vec<f32> {
        let (radius, points) = (self.radius, self.points());
        let side = points + 2 * radius;
        let first = (self.step / 2) as f64 - (radius * self.step) as f64;
        let patch = Patch {
            corner: corner + Vector2::repeat(first),
            center: corner + Vector2::repeat(self.side as f64 / 2.0),
            side,
            step: self.step,
        };
        let own = patch.sampled(self.frame, &LocalMotion::default(), 0);
        let mut best = vec![f32::INFINITY; points * points];
        for motion in self.candidates.around(&patch.center) {
            for (index, image) in &self.others {
                let other = patch.sampled(image, &motion, *index);
                let costs = box_filter(&difference(&own, &other), side, side, radius);
                for (row, best) in best.chunks_exact_mut(points).enumerate() {
                    let costs = &costs[(row + radius) * side + radius..];
                    best.iter_mut().zip(costs).for_each(|(best, cost)| *best = best.min(*cost));
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;

    const SIZE: usize = 60;

    /// Vertical stripes that are `shift` px to the right, in front of which a bright square hides some.
    fn stripes(shift: f32, square: bool) -> Image {
        let value = |k: usize| {
            let (x, y) = ((k % SIZE) as f32, (k / SIZE) as f32);
            let hidden = (22.0..38.0).contains(&x) && (22.0..38.0).contains(&y);
            if square && hidden { 1.0 } else { 0.4 + 0.3 * (0.5 * (x - shift) + 0.1 * y).sin() }
        };
        Image::from_data(SIZE, SIZE, 1, (0..SIZE * SIZE).map(value).collect())
    }

    #[test]
    fn what_a_motion_explains_costs_nothing() {
        let motion = |k: usize| Motion {
            at: Point2::new(5.0 * (k % 12) as f64 + 3.0, 5.0 * (k / 12) as f64 + 3.0),
            to: [0.0, 0.0, 3.0, 6.0].map(|x| Vector2::new(x, 0.0)),
            deformation: Matrix2::identity(),
        };
        let motions: Vec<Motion> = (0..144).map(motion).collect();
        let (frame, later) = (stripes(0.0, false), stripes(3.0, true));
        let before = stripes(0.0, false);
        let options = RefineOptions::default();
        let new = |before| {
            BestCosts::new((1, &frame), [(0, before), (2, Some(&later))], &motions, &options)
        };
        let [alone, with_before] = [None, Some(&before)].map(new);
        assert!(alone.at(10.5, 10.5) < 1e-3 && alone.at(50.5, 30.5) < 1e-3);
        // The later frame hides it; the frame before shows it.
        assert!(alone.at(27.5, 30.5) > 0.1);
        assert!(with_before.at(27.5, 30.5) < 1e-3);
        // Outside, that of the nearest pixel.
        assert!(alone.at(-5.0, 10.5) == alone.at(0.5, 10.5));
    }

    /// In an image of several cells whose size is no multiple of theirs.
    #[test]
    fn costs_equal_direct_ones() {
        let (w, h) = (41, 37);
        let value = |k: usize, x_px: f32| {
            0.5 + 0.4 * (0.7 * ((k % w) as f32 - x_px) + 0.9 * (k / w) as f32).sin()
        };
        let of = |x_px| Image::from_data(w, h, 1, (0..w * h).map(|k| value(k, x_px)).collect());
        let (frame, later) = (of(0.0), of(2.3));
        let motion = |k: usize| Motion {
            at: Point2::new(6.0 * (k % 7) as f64 + 2.0, 6.0 * (k / 7) as f64 + 2.0),
            to: [0.0, 0.0, 3.0, 6.0].map(|x| Vector2::new(x, 0.0)),
            deformation: Matrix2::identity(),
        };
        let motions: Vec<Motion> = (0..49).map(motion).collect();
        let options = RefineOptions { window_radius_px: 3, ..RefineOptions::default() };
        let others = [(0, None), (2, Some(&later))];
        let costs = BestCosts::new((1, &frame), others, &motions, &options);
        for (x, y) in [(3, 3), (15, 16), (16, 15), (25, 33), (32, 20), (33, 30)] {
            let offset = |k: usize, size: usize| (k % size) as isize - 3;
            let difference = |k: usize| {
                let [x, y] = [x + offset(k, 7), y + offset(k / 7, 7)].map(|v| v as usize);
                (frame.pixel(x, y)[0] - later.pixel(x + 3, y)[0]).abs()
            };
            let direct = (0..49).map(difference).sum::<f32>() / 49.0;
            let cost = costs.at(x as f32 + 0.5, y as f32 + 0.5);
            assert!((cost - direct).abs() < 1e-5, "({x}, {y}): {cost} {direct}");
        }
    }

    #[test]
    fn without_motions_nothing_is_explained() {
        let frame = stripes(0.0, false);
        let options = RefineOptions::default();
        let costs = BestCosts::new((1, &frame), [(0, Some(&frame)), (2, None)], &[], &options);
        assert!(costs.at(30.0, 30.0) == f32::INFINITY);
    }
}
