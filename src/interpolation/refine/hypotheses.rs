//! Hypotheses about a block's pixels. A hypothesis is a motion together with a visibility: the set of frames that show
//! the surface. It has a cost and a weight at every pixel. The block's colours are the weighted mean of the hypotheses.

use super::blocks::BlockArea;
use super::costs::PointGrid;
use super::four_frames::{CompensatedFrames, MiddleFrames, NEGLIGIBLE_WEIGHT, fuse};
use super::motions::AffineMotion;
use super::{MOTION_CHANNELS, RefinedBlock, SharedInputs};
use crate::interpolation::warp::{cross_fade, difference};
use crate::raster::{Image, max_filter};
use nalgebra::{Point2, Vector2};
use std::borrow::Cow;

/// Increase of a hypothesis's cost by which its weight falls to 1/e, for pixel values of 0 to 1.
const SOFTNESS: f32 = 0.02;
/// Minimum weight of a hypothesis, so that the sum of weights is positive.
const MIN_WEIGHT: f32 = 1e-30;
/// Prior cost of the hypothesis that only one of the pair's two frames sees the surface, for an instant halfway between
/// the frames. At other instants, this cost is divided by 2f. f is the time from the instant to the frame that does not
/// see the surface, as a fraction of the frame interval.
const ONE_FRAME_COST: f32 = 0.1;
/// Minimum of 2f in the prior cost [`ONE_FRAME_COST`]/(2f), which prevents division by 0. f is the time from the
/// instant to the frame that does not see the surface, as a fraction of the frame interval.
const MIN_DOUBLE_FRACTION: f32 = 1e-3;
/// Weight of a term in a hypothesis's cost: the amount by which the cost of another motion is smaller
/// ([`BlockHypotheses::better_explained`]).
const BETTER_EXPLAINED_WEIGHT: f32 = 2.0;
/// Motion below which a surface counts as static, pixels per frame.
const AT_REST_PX: f32 = 1.0;

/// Visibility of the surface in the two middle frames (the pair between which the instant lies), according to a
/// hypothesis.
enum Visibility {
    /// No surface is assumed. The colours are the cross-fade of the two warped frames.
    CrossFade,
    /// Both middle frames see the surface. Holds the index of the motion, and the windowed mean difference of the
    /// two compensated frames at the block's pixels.
    BothFrames(usize, Vec<f32>),
    /// Only one middle frame sees the surface. Holds the index of the motion, and the number of the frame: 1 for
    /// the earlier frame, 2 for the later frame.
    OneFrame(usize, usize),
}

/// A hypothesis, with a cost and a weight for each of the block's pixels.
struct Hypothesis {
    visibility: Visibility,
    costs: Vec<f32>,
    weights: Vec<f32>,
}

impl Hypothesis {
    fn new(visibility: Visibility, costs: Vec<f32>) -> Self {
        let weight = |cost: &f32| (-cost / SOFTNESS).exp().max(MIN_WEIGHT);
        Self { visibility, weights: costs.iter().map(weight).collect(), costs }
    }
}

/// A block of pixels, with the frames compensated by each candidate motion.
pub struct BlockHypotheses<'a> {
    shared: &'a SharedInputs<'a>,
    area: BlockArea,
    compensated: Vec<CompensatedFrames<'a>>,
    /// Grid of points at which costs are computed.
    points: PointGrid,
    /// Mean difference of the two warped frames over the window around each of the block's pixels.
    costs: Vec<f32>,
    /// Whether the two warped frames agree in the block. If they do, no hypothesis except the cross-fade is tried, and
    /// the frames before and after the pair are averaged in.
    agree: bool,
}

impl<'a> BlockHypotheses<'a> {
    /// Compensates the frames around the instant by each candidate motion of a block.
    pub fn new(
        shared: &'a SharedInputs<'a>,
        area: BlockArea,
        motions: Vec<AffineMotion>,
        agree: bool,
    ) -> Self {
        let corner = Point2::from(area.origin.map(|v| v as f64));
        let pixels = PointGrid { corner, center: area.center(), side: area.side, step: 1 };
        let points = PointGrid {
            corner: corner - Vector2::repeat(shared.points.margin_px() as f64),
            side: shared.points.side(),
            step: shared.points.step,
            ..pixels
        };
        let [before, earlier, later, after] = shared.frames.images();
        let [earlier, later] = [earlier, later].map(|frame| frame.filter(|_| !agree));
        let frames = [before, earlier, later, after];
        let compensate = |motion| CompensatedFrames::new(motion, frames, pixels, points);
        let compensated = motions.into_iter().map(compensate).collect();
        Self { shared, area, compensated, points, costs: area.crop(shared.costs, 1), agree }
    }

    /// Returns the fraction of the frame interval at which the instant is, for the block's middle row.
    fn fraction(&self) -> f32 {
        self.shared.frames.fractions.at(self.area.center().y) as f32
    }

    /// Returns the block's colours and motions: at each pixel, the weighted mean of all hypotheses.
    pub fn mean(&self) -> RefinedBlock {
        let mut hypotheses = vec![Hypothesis::new(Visibility::CrossFade, self.costs.clone())];
        for index in (0..self.compensated.len()).filter(|_| !self.agree) {
            self.add_hypotheses(index, &mut hypotheses);
        }
        let mut best = vec![0.0_f32; self.costs.len()];
        for hypothesis in &hypotheses {
            best.iter_mut().zip(&hypothesis.weights).for_each(|(best, w)| *best = best.max(*w));
        }
        let (channels, pixels) = (self.shared.cross_faded.channels(), self.costs.len());
        let (mut sums, mut colors) = (vec![0.0; pixels], vec![0.0; pixels * channels]);
        let mut motions = (!self.agree).then(|| vec![0.0; pixels * MOTION_CHANNELS]);
        for hypothesis in &hypotheses {
            let weights = &hypothesis.weights;
            if weights.iter().zip(&best).all(|(w, best)| *w <= NEGLIGIBLE_WEIGHT * best) {
                continue;
            }
            sums.iter_mut().zip(weights).for_each(|(sum, w)| *sum += w);
            add_weighted(&mut colors, weights, self.colors(hypothesis).data());
            if let Some(motions) = &mut motions {
                add_weighted(motions, weights, &self.motions(hypothesis));
            }
        }
        for (color, sum) in colors.chunks_exact_mut(channels).zip(&sums) {
            color.iter_mut().for_each(|color| *color /= sum);
        }
        let all_motions = motions.iter_mut().flat_map(|m| m.chunks_exact_mut(MOTION_CHANNELS));
        for (motion, sum) in all_motions.zip(&sums) {
            let inverse = 1.0 / sum;
            motion.iter_mut().for_each(|v| *v *= inverse);
        }
        RefinedBlock { colors, motions }
    }

    /// Appends the hypotheses of motion number `index` to `all`, up to three. In the first, both middle frames see the
    /// surface, and agree. In the second, only the earlier middle frame sees it, and agrees with the frame before. In
    /// the third, only the later middle frame sees it, and agrees with the frame after. A hypothesis whose frames don't
    /// exist is left out.
    fn add_hypotheses(&self, index: usize, all: &mut Vec<Hypothesis>) {
        let (compensated, points) = (&self.compensated[index], &self.shared.points);
        let cost = |a: usize, b: usize| {
            let [a, b] = [compensated.at_points(a)?, compensated.at_points(b)?];
            Some(points.window_means(&difference(a, b)))
        };
        let Some(both) = cost(1, 2) else { return };
        let one = [cost(0, 1), cost(2, 3)];
        let better_explained = [0, 1].map(|n| {
            let own = |k: usize| one[n].as_ref().map_or(both[k], |one| one[k].min(both[k]));
            self.better_explained(n, &compensated.motion, own)
        });
        let at_pixels = |costs: &[f32], explained: &[f32]| {
            let sum = costs.iter().zip(explained).map(|(a, b)| a + BETTER_EXPLAINED_WEIGHT * b);
            points.at_pixels(&sum.collect::<Vec<_>>())
        };
        let in_either = better_explained[0].iter().zip(&better_explained[1]).map(|(a, b)| a + b);
        let costs = at_pixels(&both, &in_either.collect::<Vec<f32>>());
        let visibility = Visibility::BothFrames(index, points.at_pixels(&both));
        all.push(Hypothesis::new(visibility, costs));
        let fraction = self.fraction();
        for (n, fraction) in [1.0 - fraction, fraction].into_iter().enumerate() {
            let Some(costs) = &one[n] else { continue };
            // A frame that is nearer to the instant is less likely to miss the surface.
            let prior = ONE_FRAME_COST / (2.0 * fraction).max(MIN_DOUBLE_FRACTION);
            let mut costs = at_pixels(costs, &better_explained[n]);
            costs.iter_mut().for_each(|cost| *cost += prior);
            all.push(Hypothesis::new(Visibility::OneFrame(index, n + 1), costs));
        }
    }

    /// Returns, for each cost point of the block, the amount by which another motion has a smaller cost than `motion`
    /// in middle frame `n` (0: earlier, 1: later). The amount is 0 if no other motion has a smaller cost. `costs(k)` is
    /// the cost of `motion` at point `k`. Each amount is the minimum over a window, because windows at the outline of a
    /// surface contain background.
    fn better_explained(
        &self,
        n: usize,
        motion: &AffineMotion,
        costs: impl Fn(usize) -> f32,
    ) -> Vec<f32> {
        let min_costs = self.shared.pair_costs.of(n);
        let deficit = |(k, at)| (min_costs.at(self.shared.frames, at) - costs(k)).min(0.0);
        let positions = self.points.positions(motion, n + 1).into_iter();
        let deficits: Vec<f32> = positions.enumerate().map(deficit).collect();
        let mut excess = max_filter(&deficits, self.points.side, self.shared.points.radius);
        excess.iter_mut().for_each(|v| *v = -*v);
        excess
    }

    /// Returns the block's colours according to a hypothesis.
    fn colors(&self, hypothesis: &Hypothesis) -> Cow<'_, Image> {
        let given = "the middle frames are compensated unless they agree";
        let (middle, compensated) = match &hypothesis.visibility {
            Visibility::CrossFade => {
                let margin = self.shared.points.margin_px() as isize;
                let first = self.area.origin.map(|v| v - margin);
                let middle = MiddleFrames {
                    at_pixels: self.cross_faded(self.area.origin, self.area.side, 1),
                    at_points: self.cross_faded(first, self.points.side, self.points.step),
                    costs: &hypothesis.costs,
                };
                (middle, &self.compensated[..])
            }
            Visibility::BothFrames(index, costs) => {
                let frames = &self.compensated[*index];
                let faded = |middle: [Option<&Image>; 2]| {
                    let [earlier, later] = middle.map(|image| image.expect(given));
                    cross_fade(earlier, later, self.fraction())
                };
                let at_pixels = faded([1, 2].map(|n| frames.at_pixels(n)));
                let at_points = faded([1, 2].map(|n| frames.at_points(n)));
                (MiddleFrames { at_pixels, at_points, costs }, std::slice::from_ref(frames))
            }
            Visibility::OneFrame(index, frame) => {
                return Cow::Borrowed(self.compensated[*index].at_pixels(*frame).expect(given));
            }
        };
        let outer_weight = self.shared.frames.outer_weight(self.area.center().y);
        Cow::Owned(fuse(middle, compensated, &self.shared.points, outer_weight))
    }

    /// Returns the cross-fade of the two warped frames, sampled on a square grid of `side`×`side` points. The
    /// points are `step` pixels apart, and the first point is pixel `first`. Outside the image, its border pixels
    /// are repeated.
    fn cross_faded(&self, first: [isize; 2], side: usize, step: usize) -> Image {
        let image = self.shared.cross_faded;
        let clamp = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut data = Vec::with_capacity(side * side * image.channels());
        for k in 0..side * side {
            let x = clamp(first[0] + (k % side * step) as isize, image.width());
            let y = clamp(first[1] + (k / side * step) as isize, image.height());
            data.extend_from_slice(image.pixel(x, y));
        }
        Image::from_data(side, side, image.channels(), data)
    }

    /// Returns the motions of the block's pixels according to a hypothesis, [`MOTION_CHANNELS`] values per pixel.
    fn motions(&self, hypothesis: &Hypothesis) -> Vec<f32> {
        let (Visibility::BothFrames(index, _) | Visibility::OneFrame(index, _)) =
            hypothesis.visibility
        else {
            return self.area.crop(self.shared.warp_motions.data(), MOTION_CHANNELS);
        };
        let compensated = &self.compensated[index];
        let at = |n: usize| compensated.motion.at(n, Vector2::zeros());
        let steps = [0, 1, 2].map(|n| at(n + 1) - at(n));
        let change_px = |outer: usize, n: usize| {
            let change = compensated.at_points(outer).map(|_| (steps[n + 1] - steps[n]).norm());
            change.unwrap_or(0.0) as f32
        };
        let motion_px = steps[1].norm() as f32;
        let change_px = change_px(0, 0).max(change_px(3, 1));
        let of_pixel = |(&cost, &of_warps): (&f32, &f32)| {
            // Both frames may show the same static surface although a body occludes it at the instant. The cost is
            // therefore at least the mean difference of the two warped frames.
            let cost = if motion_px < AT_REST_PX { cost.max(of_warps) } else { cost };
            [motion_px, change_px, cost]
        };
        hypothesis.costs.iter().zip(&self.costs).flat_map(of_pixel).collect()
    }
}

/// Adds the channels of pixels, multiplied by the pixels' weights, to `sums`. `values` and `sums` have interleaved
/// channels.
fn add_weighted(sums: &mut [f32], weights: &[f32], values: &[f32]) {
    let channels = sums.len() / weights.len();
    let values = values.chunks_exact(channels);
    for ((sums, values), w) in sums.chunks_exact_mut(channels).zip(values).zip(weights) {
        sums.iter_mut().zip(values).for_each(|(sum, v)| *sum += w * v);
    }
}
