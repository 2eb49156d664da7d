//! How well the motions around a frame's pixels explain them.

use super::candidates::Candidates;
use super::cost_points::CostPoints;
use super::four_frames::FourFrames;
use super::patch::Patch;
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::difference;
use crate::interpolation::{Motion, RefineOptions};
use crate::raster::box_filter;
use nalgebra::{Point2, Vector2};
use std::sync::OnceLock;

/// Minimum side of the cells, pixels, which share their candidate motions; it is at least four times a window's
/// radius. Larger: motions of other surfaces are tried; smaller: time.
const MIN_CELL: usize = 16;

/// Per point of a frame, the smallest cost of any motion around it: its difference from where the motion leads in
/// another frame. Where it is small the point shows a surface that moves so, and none that moves otherwise.
/// It depends on no instant. Cells are computed when first asked for.
pub struct BestCosts {
    /// The frame: 1 the earlier, 2 the later.
    frame: usize,
    /// Width and height of the frame.
    size: [usize; 2],
    /// From their positions in the frame.
    candidates: Candidates,
    /// Points in a window's radius, and pixels from a point to the next.
    radius: usize,
    step: usize,
    /// Side of a cell, pixels.
    side: usize,
    cells: Vec<OnceLock<Vec<f32>>>,
    across: usize,
}

/// Those of the earlier and of the later frame of a pair: what of refinement is the same at all instants between
/// them.
pub struct PairCosts([BestCosts; 2]);

impl PairCosts {
    /// By the motions of the tracks around the earlier frame, and around the later one: as [`Motion`] has them, at
    /// that frame's instant. `size` is the frames' width and height.
    pub fn new(size: [usize; 2], motions: [Vec<Motion>; 2], options: &RefineOptions) -> Self {
        let options = &options.scaled(size[0].max(size[1]));
        let [earlier, later] = motions;
        Self([(1, earlier), (2, later)].map(|(frame, m)| BestCosts::new(frame, size, m, options)))
    }

    /// Of the earlier frame (0) or the later one (1).
    pub(super) fn of(&self, n: usize) -> &BestCosts {
        &self.0[n]
    }

    /// About how much memory it takes when all of it is computed, bytes.
    pub fn bytes(&self) -> usize {
        let of_frame = |best: &BestCosts| {
            let cell = size_of::<OnceLock<Vec<f32>>>() + best.points().pow(2) * size_of::<f32>();
            best.cells.len() * cell + best.candidates.count() * size_of::<Motion>()
        };
        self.0.iter().map(of_frame).sum()
    }
}

impl BestCosts {
    /// Of a frame of this size, 1 or 2, by motions around their positions there. `options` have lengths scaled to the
    /// image's size.
    fn new(frame: usize, size: [usize; 2], motions: Vec<Motion>, options: &RefineOptions) -> Self {
        let side = MIN_CELL.max(4 * options.window_radius_px);
        let CostPoints { radius, step, .. } = CostPoints::new(options.window_radius_px, side);
        let [across, down] = size.map(|length| length.div_ceil(side));
        let candidates = Candidates::new(motions, options);
        let cells = (0..across * down).map(|_| OnceLock::new()).collect();
        Self { frame, size, candidates, radius, step, side, cells, across }
    }

    /// Points along a cell's side.
    fn points(&self) -> usize {
        self.side.div_ceil(self.step)
    }

    /// At a place in the frame, of the point nearest to the pixel there; infinite where no motion is near.
    /// `frames` are those of the pair.
    pub fn at(&self, frames: &FourFrames, [x, y]: [f32; 2]) -> f32 {
        let pixel = |v: f32, size: usize| (v.max(0.0) as usize).min(size - 1);
        let (x, y) = (pixel(x, self.size[0]), pixel(y, self.size[1]));
        let ([column, row], [x, y]) =
            ([x, y].map(|v| v / self.side), [x, y].map(|v| v % self.side));
        let cell = self.cells[row * self.across + column].get_or_init(|| {
            let corner = Point2::from([column, row].map(|v| (v * self.side) as f64));
            self.cell(frames, corner)
        });
        cell[y / self.step * self.points() + x / self.step]
    }

    /// Costs of the cell whose top-left corner this is, row by row. Each point is in the middle of the pixels that it
    /// stands for.
    fn cell(&self, frames: &FourFrames, corner: Point2<f64>) -> Vec<f32> {
        let FourFrames { before, earlier, later, after, .. } = *frames;
        let (frame, others) = match self.frame {
            1 => (earlier, [(0, before), (2, Some(later))]),
            _ => (later, [(1, Some(earlier)), (3, after)]),
        };
        let (radius, points) = (self.radius, self.points());
        let side = points + 2 * radius;
        let first = (self.step / 2) as f64 - (radius * self.step) as f64;
        let patch = Patch {
            corner: corner + Vector2::repeat(first),
            center: corner + Vector2::repeat(self.side as f64 / 2.0),
            side,
            step: self.step,
        };
        let own = patch.sampled(frame, &LocalMotion::default(), 0);
        let mut best = vec![f32::INFINITY; points * points];
        for motion in self.candidates.around(&patch.center) {
            for (index, image) in others {
                let Some(image) = image else { continue };
                let other = patch.sampled(image, &motion, index);
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
    use super::super::tests::pair_costs;
    use super::*;
    use crate::raster::Image;
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

    fn pair<'a>(earlier: &'a Image, later: &'a Image, before: Option<&'a Image>) -> FourFrames<'a> {
        let (after, fraction, parts, with_motions) = (None, 0.5, None, false);
        FourFrames { before, earlier, later, after, fraction, parts, with_motions }
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
        let of = |before| {
            let frames = pair(&frame, &later, before);
            let costs = pair_costs(&frames, &motions, &RefineOptions::default());
            move |x: f32, y: f32| costs.of(0).at(&frames, [x, y])
        };
        let [alone, with_before] = [None, Some(&before)].map(of);
        assert!(alone(10.5, 10.5) < 1e-3 && alone(50.5, 30.5) < 1e-3);
        // The later frame hides it; the frame before shows it.
        assert!(alone(27.5, 30.5) > 0.1);
        assert!(with_before(27.5, 30.5) < 1e-3);
        // Outside, that of the nearest pixel.
        assert!(alone(-5.0, 10.5) == alone(0.5, 10.5));
    }

    /// In an image of several cells whose size is no multiple of theirs. With the larger window, every second pixel of
    /// it counts.
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
        let frames = pair(&frame, &later, None);
        for (radius, step) in [(3_usize, 1), (4, 2)] {
            let options = RefineOptions { window_radius_px: radius, ..RefineOptions::default() };
            let costs = pair_costs(&frames, &motions, &options);
            for (x, y) in [(5, 5), (15, 17), (17, 15), (25, 31), (33, 21), (33, 29)] {
                let offsets = || (0..=2 * radius).step_by(step);
                let difference = |(dx, dy): (usize, usize)| {
                    let (x, y) = (x + dx - radius, y + dy - radius);
                    (frame.pixel(x, y)[0] - later.pixel(x + 3, y)[0]).abs()
                };
                let window = offsets().flat_map(|dy| offsets().map(move |dx| (dx, dy)));
                let direct: Vec<f32> = window.map(difference).collect();
                let direct = direct.iter().sum::<f32>() / direct.len() as f32;
                let cost = costs.of(0).at(&frames, [x as f32 + 0.5, y as f32 + 0.5]);
                assert!((cost - direct).abs() < 1e-5, "{radius}, ({x}, {y}): {cost} {direct}");
            }
        }
    }

    #[test]
    fn without_motions_nothing_is_explained() {
        let frame = stripes(0.0, false);
        let frames = pair(&frame, &frame, Some(&frame));
        let costs = pair_costs(&frames, &[], &RefineOptions::default());
        assert!(costs.of(0).at(&frames, [30.0, 30.0]) == f32::INFINITY);
    }
}
