//! Costs of candidate motions. A cost is the difference of motion-compensated frames, averaged over a window. Window
//! means change little from pixel to pixel, so costs are computed on a coarse grid of points and interpolated.

use super::FourFrames;
use super::motions::{AffineMotion, MotionHypotheses};
use crate::interpolation::InterpolationOptions;
use crate::interpolation::tracked_pair::{TrackMotion, TrackedPair};
use crate::interpolation::warp::difference;
use crate::raster::{Image, box_filter, sample_all};
use nalgebra::{Point2, Vector2};
use std::sync::OnceLock;

/// Minimum number of points along a window's radius at which costs are computed. (With costs at every pixel, images of
/// six scenes at 640×480 are 0.02 dB better on average, from −0.12 to +0.14 dB, and refinement takes twice as long.)
const MIN_POINTS_IN_RADIUS: usize = 2;
/// Minimum side of the cells of [`FrameCosts`], pixels. The side is also at least four times the radius of the windows
/// over which costs are averaged.
const MIN_CELL_PX: usize = 16;

/// A square grid of points at pixel centres. The grid may extend beyond the image.
#[derive(Clone, Copy)]
pub struct PointGrid {
    /// Top-left corner of the first point's pixel, in pixels of the image.
    pub corner: Point2<f64>,
    /// Position in the image, in pixels, from which offsets are measured in [`AffineMotion::at`].
    pub center: Point2<f64>,
    /// Number of points along a side.
    pub side: usize,
    /// Distance between neighbouring points, pixels.
    pub step: usize,
}

impl PointGrid {
    /// Returns the positions to which a motion takes the grid's points in a frame (0 before, 1 earlier, 2 later, 3
    /// after), in pixels, row by row.
    pub fn positions(&self, motion: &AffineMotion, frame: usize) -> Vec<[f32; 2]> {
        let mut positions = Vec::with_capacity(self.side * self.side);
        for row in 0..self.side {
            let y = (row * self.step) as f64 + 0.5;
            let from_center = |x: f64| self.corner - self.center + Vector2::new(x, y);
            let position = |x: f64| self.center + from_center(x) + motion.at(frame, from_center(x));
            // The motion is affine, so that positions along a row are equidistant.
            let (first, per_px) = (position(0.5), position(1.5) - position(0.5));
            positions.extend((0..self.side).map(|k| {
                let position = first + per_px * (k * self.step) as f64;
                [position.x as f32, position.y as f32]
            }));
        }
        positions
    }

    /// Samples the image of a frame (0 before, 1 earlier, 2 later, 3 after) at the positions to which a motion takes
    /// the grid's points. The result has one pixel per point.
    pub fn sample(&self, image: &Image, motion: &AffineMotion, frame: usize) -> Image {
        let mut samples = vec![0.0; self.side * self.side * image.channels()];
        sample_all(image, self.positions(motion, frame).into_iter(), &mut samples);
        Image::from_data(self.side, self.side, image.channels(), samples)
    }
}

/// The grid of points at which the costs of a block, or of a cell of [`FrameCosts`], are computed. It covers the
/// block and the windows around the block's pixels.
#[derive(Clone, Copy, Debug)]
pub struct CostPoints {
    /// Distance between neighbouring points, pixels.
    pub step: usize,
    /// Radius of the windows over which costs are averaged, as a number of steps between neighbouring points.
    pub radius: usize,
    /// Side of the block or cell, pixels.
    block: usize,
}

impl CostPoints {
    /// Creates the grid of points for windows of this radius and blocks of this side, both in pixels.
    pub fn new(window_radius_px: usize, block: usize) -> Self {
        let step = (window_radius_px / MIN_POINTS_IN_RADIUS).max(1);
        Self { step, radius: (window_radius_px + step / 2) / step, block }
    }

    /// Returns the distance from the first point to the block's first pixel along each axis, pixels.
    pub fn margin_px(&self) -> usize {
        self.radius * self.step
    }

    /// Returns the number of points along each side of the grid. The grid covers the block, and a margin for the
    /// windows around the block's outermost points.
    pub fn side(&self) -> usize {
        (self.block - 1).div_ceil(self.step) + 1 + 2 * self.radius
    }

    /// Returns, for each point, the mean of `values` over the window around the point. `values` and the result have one
    /// value per point, row by row.
    pub fn window_means(&self, values: &[f32]) -> Vec<f32> {
        box_filter(values, self.side(), self.side(), self.radius)
    }

    /// Interpolates the points' values bilinearly to the block's pixels.
    pub fn at_pixels(&self, values: &[f32]) -> Vec<f32> {
        let (side, step, radius) = (self.side(), self.step, self.radius);
        let mut out = Vec::with_capacity(self.block * self.block);
        if step == 1 {
            let rows = values.chunks_exact(side).skip(radius).take(self.block);
            rows.for_each(|row| out.extend_from_slice(&row[radius..][..self.block]));
            return out;
        }
        // If `k` is the last point, it is returned itself, and its interpolation weight is 0.
        let next = |k: usize| (k + 1).min(side - 1);
        let mut row = vec![0.0; side];
        for y in 0..self.block {
            let (above, fraction) = (radius + y / step, (y % step) as f32 / step as f32);
            let [a, b] = [above, next(above)].map(|k| &values[k * side..][..side]);
            for ((out, a), b) in row.iter_mut().zip(a).zip(b) {
                *out = a + (b - a) * fraction;
            }
            for x in 0..self.block {
                let (left, fraction) = (radius + x / step, (x % step) as f32 / step as f32);
                out.push(row[left] + (row[next(left)] - row[left]) * fraction);
            }
        }
        out
    }
}

/// Minimum costs of the two frames of a pair, over the motions of tracks. At each point of the earlier and of the later
/// frame, the cost is the smallest mean difference between this frame and an adjacent frame, over the motions of all
/// nearby tracks.
///
/// The costs don't depend on the instant. They depend on the inputs of [`Self::new`], on the pair's images, and on the
/// frames before and after the pair. Often only parts of the frames need costs. The frames are therefore divided into
/// square cells. All costs of a cell are computed when one of them is first read.
pub struct PairCosts([FrameCosts; 2]);

impl PairCosts {
    /// Creates the costs of a frame pair of this width and height, for the motions of the pair's tracks. Costs are
    /// computed when they are first read.
    pub fn new(tracked: &TrackedPair, size: [usize; 2], options: &InterpolationOptions) -> Self {
        let earlier = tracked.motions(options.curved, |_, track| track.earlier);
        let later = tracked.motions(options.curved, |_, track| track.later);
        Self::of_motions(size, [earlier, later], options)
    }

    /// Creates the costs from the motions of tracks, given twice: first measured from the tracks' positions in the
    /// earlier frame, then measured from their positions in the later frame. `size` is the frames' width and height.
    pub(super) fn of_motions(
        size: [usize; 2],
        [earlier, later]: [Vec<TrackMotion>; 2],
        options: &InterpolationOptions,
    ) -> Self {
        let options = options.scaled_to(size);
        let side = MIN_CELL_PX.max(4 * options.window_radius_px);
        let cells = size.map(|length| length.div_ceil(side)).iter().product();
        Self([(1, earlier), (2, later)].map(|(frame, motions)| FrameCosts {
            frame,
            size,
            motions: MotionHypotheses::new(motions, options.search_radius_px),
            points: CostPoints::new(options.window_radius_px, side),
            cells: (0..cells).map(|_| OnceLock::new()).collect(),
        }))
    }

    /// Returns the costs of the earlier frame (`n` = 0) or of the later frame (`n` = 1).
    pub(super) fn of(&self, n: usize) -> &FrameCosts {
        &self.0[n]
    }

    /// Returns the approximate size in memory once all cells are computed, bytes.
    pub fn bytes(&self) -> usize {
        let of_frame = |costs: &FrameCosts| {
            let cell =
                size_of::<OnceLock<Vec<f32>>>() + costs.points_per_side().pow(2) * size_of::<f32>();
            costs.cells.len() * cell + costs.motions.motions.len() * size_of::<TrackMotion>()
        };
        self.0.iter().map(of_frame).sum()
    }
}

/// The minimum cost at each point of a frame. A cost is the mean difference between this frame and an adjacent frame,
/// over the window around the point. The adjacent frame is compensated by the motion of nearby tracks. The minimum is
/// over the candidate motions and over both adjacent frames. If it is small, one of the motions agrees with the frames
/// at the point.
pub(super) struct FrameCosts {
    /// Number of this frame: 1 for the earlier, 2 for the later frame of the pair.
    frame: usize,
    /// Width and height of the frame, pixels.
    size: [usize; 2],
    /// Candidate motions, indexed by the tracks' positions in this frame.
    motions: MotionHypotheses,
    /// Points of a cell at which costs are computed. A cell is a square of pixels for which the same motions are tried.
    points: CostPoints,
    /// Cells of the frame, row by row. Each cell holds the minimum costs at its points, row by row.
    cells: Vec<OnceLock<Vec<f32>>>,
}

impl FrameCosts {
    fn points_per_side(&self) -> usize {
        self.points.block.div_ceil(self.points.step)
    }

    /// Returns the minimum cost over all motions of nearby tracks, at the point nearest to a pixel position of this
    /// frame. The cost is infinite if no track is near. `frames` are the pair for which the costs were created, and
    /// the frames before and after the pair.
    pub fn at(&self, frames: &FourFrames, [x, y]: [f32; 2]) -> f32 {
        let pixel = |v: f32, size: usize| (v.max(0.0) as usize).min(size - 1);
        let at = [pixel(x, self.size[0]), pixel(y, self.size[1])];
        let (step, side) = (self.points.step, self.points.block);
        let [column, row] = at.map(|v| v / side);
        let cell = self.cells[row * self.size[0].div_ceil(side) + column].get_or_init(|| {
            let corner = Point2::from([column, row].map(|v| (v * side) as f64));
            self.cell(frames, corner)
        });
        let [x, y] = at.map(|v| v % side / step);
        cell[y * self.points_per_side() + x]
    }

    /// Returns the minimum costs at the points of a cell, row by row. `corner` is the cell's top-left corner in pixels.
    /// Each point represents a square of pixels and is at the square's centre, rounded to a pixel.
    fn cell(&self, frames: &FourFrames, corner: Point2<f64>) -> Vec<f32> {
        let images = frames.images();
        // The two adjacent frames: an outer one, and the other frame of the pair.
        let neighbors = if self.frame == 1 { [0, 2] } else { [1, 3] };
        let CostPoints { radius, step, .. } = self.points;
        let points = self.points_per_side();
        let side = points + 2 * radius;
        let first = (step / 2) as f64 - (radius * step) as f64;
        let grid = PointGrid {
            corner: corner + Vector2::repeat(first),
            center: corner + Vector2::repeat(self.points.block as f64 / 2.0),
            side,
            step,
        };
        let mut min = vec![f32::INFINITY; points * points];
        let Some(frame) = images[self.frame] else { return min };
        let own = grid.sample(frame, &AffineMotion::default(), 0);
        for motion in self.motions.around(&grid.center) {
            for neighbor in neighbors {
                let Some(image) = images[neighbor] else { continue };
                let other = grid.sample(image, &motion, neighbor);
                let costs = box_filter(&difference(&own, &other), side, side, radius);
                for (row, min) in min.chunks_exact_mut(points).enumerate() {
                    let costs = &costs[(row + radius) * side + radius..];
                    min.iter_mut().zip(costs).for_each(|(min, cost)| *min = min.min(*cost));
                }
            }
        }
        min
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::pair_costs;
    use super::*;
    use crate::interpolation::tracked_pair::RowFractions;
    use nalgebra::Matrix2;

    const SIZE: usize = 60;

    /// Renders vertical stripes, shifted by `shift` px to the right. If `square`, a bright square occludes some of
    /// the stripes.
    fn stripes(shift: f32, square: bool) -> Image {
        let value = |k: usize| {
            let (x, y) = ((k % SIZE) as f32, (k / SIZE) as f32);
            let hidden = (22.0..38.0).contains(&x) && (22.0..38.0).contains(&y);
            if square && hidden { 1.0 } else { 0.4 + 0.3 * (0.5 * (x - shift) + 0.1 * y).sin() }
        };
        Image::from_data(SIZE, SIZE, 1, (0..SIZE * SIZE).map(value).collect())
    }

    fn pair<'a>(earlier: &'a Image, later: &'a Image, before: Option<&'a Image>) -> FourFrames<'a> {
        FourFrames {
            before,
            earlier,
            later,
            after: None,
            fractions: RowFractions::constant(0.5),
            parts: None,
        }
    }

    #[test]
    fn what_a_motion_explains_costs_nothing() {
        let motion = |k: usize| TrackMotion {
            at: Point2::new(5.0 * (k % 12) as f64 + 3.0, 5.0 * (k / 12) as f64 + 3.0),
            to: [0.0, 0.0, 3.0, 6.0].map(|x| Vector2::new(x, 0.0)),
            deformation: Matrix2::identity(),
        };
        let motions: Vec<TrackMotion> = (0..144).map(motion).collect();
        let (frame, later) = (stripes(0.0, false), stripes(3.0, true));
        let before = stripes(0.0, false);
        let of = |before| {
            let frames = pair(&frame, &later, before);
            let costs = pair_costs(&frames, &motions, &InterpolationOptions::default());
            move |x: f32, y: f32| costs.of(0).at(&frames, [x, y])
        };
        let [alone, with_before] = [None, Some(&before)].map(of);
        assert!(alone(10.5, 10.5) < 1e-3 && alone(50.5, 30.5) < 1e-3);
        // The later frame occludes this point; the frame before the pair shows it.
        assert!(alone(27.5, 30.5) > 0.1);
        assert!(with_before(27.5, 30.5) < 1e-3);
        // Outside the image, the cost is that of the nearest pixel.
        assert!(alone(-5.0, 10.5) == alone(0.5, 10.5));
    }

    /// Tests an image with several cells, whose size is not a multiple of the cell size. For the larger window, costs
    /// are computed at every second pixel.
    #[test]
    fn costs_equal_direct_ones() {
        let (w, h) = (41, 37);
        let value = |k: usize, x_px: f32| {
            0.5 + 0.4 * (0.7 * ((k % w) as f32 - x_px) + 0.9 * (k / w) as f32).sin()
        };
        let of = |x_px| Image::from_data(w, h, 1, (0..w * h).map(|k| value(k, x_px)).collect());
        let (frame, later) = (of(0.0), of(2.3));
        let motion = |k: usize| TrackMotion {
            at: Point2::new(6.0 * (k % 7) as f64 + 2.0, 6.0 * (k / 7) as f64 + 2.0),
            to: [0.0, 0.0, 3.0, 6.0].map(|x| Vector2::new(x, 0.0)),
            deformation: Matrix2::identity(),
        };
        let motions: Vec<TrackMotion> = (0..49).map(motion).collect();
        let frames = pair(&frame, &later, None);
        for (radius, step) in [(3_usize, 1), (4, 2)] {
            let options = InterpolationOptions {
                window_radius_px: radius,
                ..InterpolationOptions::default()
            };
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
        let costs = pair_costs(&frames, &[], &InterpolationOptions::default());
        assert!(costs.of(0).at(&frames, [30.0, 30.0]) == f32::INFINITY);
    }

    #[test]
    fn planes_are_interpolated_exactly() {
        for (radius, block) in
            [(0, 16), (1, 16), (2, 16), (3, 16), (4, 16), (5, 20), (7, 28), (8, 32)]
        {
            let points = CostPoints::new(radius, block);
            let side = points.side();
            // A plane, evaluated at a position in pixels relative to the block's first pixel.
            let value = |x: f32, y: f32| 0.5 + 0.25 * x - 0.125 * y;
            let at = |k: usize| (k * points.step) as f32 - points.margin_px() as f32;
            let values: Vec<f32> =
                (0..side * side).map(|k| value(at(k % side), at(k / side))).collect();
            let pixels = points.at_pixels(&values);
            assert_eq!(pixels.len(), block * block);
            for (k, got) in pixels.iter().enumerate() {
                let want = value((k % block) as f32, (k / block) as f32);
                assert!((got - want).abs() < 1e-5, "{radius}, {k}: {got} {want}");
            }
            assert!(points.margin_px().abs_diff(radius) <= points.step / 2);
        }
    }
}
