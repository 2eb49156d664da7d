//! What the pixels of a block may show: the motions of the tracks around it, each under three hypotheses of
//! visibility, and the cross-fade of the two warped frames.

use super::PixelMotion;
use super::inputs::Inputs;
use super::patch::Patch;
use super::square::Square;
use super::tried_motion::TriedMotion;
use super::weighted_sums::{RefinedBlock, WeightedSums};
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::{cross_fade, difference, largest_around};
use crate::raster::{Image, box_filter};
use nalgebra::{Point2, Vector2};
use std::borrow::Cow;

/// Minimum of twice the time to a frame, as a fraction of the interval, which a cost is divided by. Larger:
/// ghosts near a frame; smaller: the cost overflows at a frame.
const MIN_DOUBLE_FRACTION: f32 = 1e-3;

/// Minimum weight of a hypothesis, so that their sum is positive. Larger: bad hypotheses count; smaller: f32
/// underflows.
const MIN_WEIGHT: f32 = 1e-30;

/// Weight of the cost by which another motion explains a frame's pixels better. Larger: outlines are eroded;
/// smaller: where two surfaces look alike, pixels of one are taken for the other.
const BETTER_EXPLAINED_WEIGHT: f32 = 2.0;

/// Motion, pixels per frame, below which a surface is at rest. Frames may agree at rest although something passes
/// between them. Larger: slow motion is not believed; smaller: errors of tracks count as motion.
const AT_REST_PX: f32 = 1.0;

/// Largest weight that is left out, of a hypothesis relative to a pixel's best one, or of an outer frame. Larger:
/// faint errors; smaller: frames are warped for nothing.
const MAX_LEFT_OUT: f32 = 1e-3;

/// A block, and the motions that are tried on it.
pub struct Block<'a> {
    inputs: &'a Inputs<'a>,
    square: Square,
    tried: Vec<TriedMotion<'a>>,
    /// Where costs are computed.
    points: Patch,
    /// The costs of the two warped frames, at the pixels.
    costs: Vec<f32>,
    /// Whether the motions are hypotheses of their own. If not, only the outer frames are averaged in.
    by_motion: bool,
}

/// What a pixel may show.
enum Shows {
    /// The cross-fade of the two warped frames.
    CrossFade,
    /// A surface that both frames see. The index of its motion, and its costs at the pixels, without what counts
    /// against it besides.
    Both(usize, Vec<f32>),
    /// A surface that one frame alone sees: the index of its motion; the earlier frame (1) or the later one (2).
    One(usize, usize),
}

/// The same with costs and weights at the pixels.
struct Hypothesis {
    shows: Shows,
    costs: Vec<f32>,
    weights: Vec<f32>,
}

impl<'a> Block<'a> {
    /// Of a square of pixels, with its candidate motions.
    pub fn new(
        inputs: &'a Inputs<'a>,
        square: Square,
        motions: Vec<LocalMotion>,
        by_motion: bool,
    ) -> Self {
        let corner = Point2::from(square.origin.map(|v| v as f64));
        let pixels = Patch { corner, center: square.center(), side: square.side, step: 1 };
        let points = Patch {
            corner: corner - Vector2::repeat(inputs.points.margin_px() as f64),
            side: inputs.points.side(),
            step: inputs.points.step,
            ..pixels
        };
        let frames = inputs.frames;
        let middle = [frames.earlier, frames.later].map(|frame| by_motion.then_some(frame));
        let frames = [frames.before, middle[0], middle[1], frames.after];
        let tried = |motion| TriedMotion::new(motion, frames, pixels, points);
        let tried = motions.into_iter().map(tried).collect();
        let costs = square.all_of(inputs.costs);
        Self { inputs, square, tried, points, costs, by_motion }
    }

    /// The mean of all hypotheses, weighted by their costs.
    pub fn mean(&self) -> RefinedBlock {
        let hypotheses = self.hypotheses();
        let mut best = vec![0.0_f32; self.costs.len()];
        for hypothesis in &hypotheses {
            best.iter_mut().zip(&hypothesis.weights).for_each(|(best, w)| *best = best.max(*w));
        }
        let channels = self.inputs.cross_faded.channels();
        let with_motions = self.by_motion && self.inputs.motion_px.is_some();
        let mut sums = WeightedSums::new(self.costs.len(), channels, with_motions);
        for hypothesis in &hypotheses {
            let mut shares = hypothesis.weights.iter().zip(&best);
            if shares.any(|(weight, best)| *weight > MAX_LEFT_OUT * best) {
                let colors = self.colors(hypothesis);
                sums.add(&hypothesis.weights, colors.data());
                if with_motions {
                    sums.add_motions(&hypothesis.weights, self.motions(hypothesis));
                }
            }
        }
        sums.mean()
    }

    fn hypotheses(&self) -> Vec<Hypothesis> {
        let mut all = vec![self.hypothesis(Shows::CrossFade, self.costs.clone())];
        if self.by_motion {
            for (k, tried) in self.tried.iter().enumerate() {
                self.add_hypotheses_of(k, tried, &mut all);
            }
        }
        all
    }

    fn hypothesis(&self, shows: Shows, costs: Vec<f32>) -> Hypothesis {
        let softness = self.inputs.options.softness;
        let weight = |cost: &f32| (-cost / softness).exp().max(MIN_WEIGHT);
        Hypothesis { shows, weights: costs.iter().map(weight).collect(), costs }
    }

    /// Adds a motion under its three hypotheses: both frames see the point, only the earlier does, only
    /// the later does.
    fn add_hypotheses_of(&self, index: usize, tried: &TriedMotion, all: &mut Vec<Hypothesis>) {
        let cost = |a: usize, b: usize| {
            Some(self.window_mean(&difference(tried.at_points(a)?, tried.at_points(b)?)))
        };
        let Some(both) = cost(1, 2) else { return };
        let by_one = [cost(0, 1), cost(2, 3)];
        let explained = [0, 1].map(|n| {
            let own = |k: usize| by_one[n].as_ref().map_or(both[k], |one| one[k].min(both[k]));
            self.better_explained(n, &tried.motion, own)
        });
        let at_pixels = |costs: &[f32], explained: &[f32]| {
            let sum = costs.iter().zip(explained).map(|(a, b)| a + BETTER_EXPLAINED_WEIGHT * b);
            self.inputs.points.at_pixels(&sum.collect::<Vec<_>>())
        };
        let by_either: Vec<f32> =
            explained[0].iter().zip(&explained[1]).map(|(a, b)| a + b).collect();
        let shows = Shows::Both(index, self.inputs.points.at_pixels(&both));
        all.push(self.hypothesis(shows, at_pixels(&both, &by_either)));
        let fraction = self.inputs.frames.fraction;
        for (n, fraction) in [1.0 - fraction, fraction].into_iter().enumerate() {
            let Some(costs) = &by_one[n] else { continue };
            // What the nearer frame does not show has had little time to appear.
            let one_frame_cost = self.inputs.options.one_frame_cost;
            let unlikely = one_frame_cost / (2.0 * fraction).max(MIN_DOUBLE_FRACTION);
            let mut costs = at_pixels(costs, &explained[n]);
            costs.iter_mut().for_each(|cost| *cost += unlikely);
            all.push(self.hypothesis(Shows::One(index, n + 1), costs));
        }
    }

    /// By how much another motion explains a middle frame's pixels, 0 or 1, better than this one, whose costs are
    /// given; at the points. The smallest within a window: at a surface's outline, windows are partly of what is
    /// behind it.
    fn better_explained(
        &self,
        n: usize,
        motion: &LocalMotion,
        costs: impl Fn(usize) -> f32,
    ) -> Vec<f32> {
        let best = self.inputs.best_costs.of(n);
        let deficit = |(k, place)| (best.at(self.inputs.frames, place) - costs(k)).min(0.0);
        let places = self.points.places(motion, n + 1).into_iter();
        let deficits: Vec<f32> = places.enumerate().map(deficit).collect();
        let mut excess = largest_around(&deficits, self.points.side, self.inputs.points.radius);
        excess.iter_mut().for_each(|v| *v = -*v);
        excess
    }

    /// Mean over the window around each point.
    fn window_mean(&self, values: &[f32]) -> Vec<f32> {
        box_filter(values, self.points.side, self.points.side, self.inputs.points.radius)
    }

    /// What the pixels look like if a hypothesis is right.
    fn colors(&self, hypothesis: &Hypothesis) -> Cow<'_, Image> {
        let wanted = "the middle frames are wanted where motions are hypotheses";
        match &hypothesis.shows {
            Shows::CrossFade => {
                let margin = self.inputs.points.margin_px() as isize;
                let points = self.cross_faded(
                    self.square.origin.map(|v| v - margin),
                    self.points.side,
                    self.points.step,
                );
                let pixels = self.cross_faded(self.square.origin, self.square.side, 1);
                Cow::Owned(self.fused(pixels, &points, &self.tried, &hypothesis.costs))
            }
            Shows::Both(index, costs) => {
                let tried = &self.tried[*index];
                let fraction = self.inputs.frames.fraction;
                let faded = |earlier: Option<&Image>, later: Option<&Image>| {
                    cross_fade(earlier.expect(wanted), later.expect(wanted), fraction)
                };
                let pixels = faded(tried.at_pixels(1), tried.at_pixels(2));
                let points = faded(tried.at_points(1), tried.at_points(2));
                Cow::Owned(self.fused(pixels, &points, std::slice::from_ref(tried), costs))
            }
            Shows::One(index, frame) => {
                Cow::Borrowed(self.tried[*index].at_pixels(*frame).expect(wanted))
            }
        }
    }

    /// The cross-fade of the two warped frames at a square of pixels, `step` apart from the first on, the image's
    /// border repeated outwards.
    fn cross_faded(&self, first: [isize; 2], side: usize, step: usize) -> Image {
        let image = self.inputs.cross_faded;
        let clamp = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut data = Vec::with_capacity(side * side * image.channels());
        for k in 0..side * side {
            let x = clamp(first[0] + (k % side * step) as isize, image.width());
            let y = clamp(first[1] + (k / side * step) as isize, image.height());
            data.extend_from_slice(image.pixel(x, y));
        }
        Image::from_data(side, side, image.channels(), data)
    }

    /// The middle frames' cross-fade, at the pixels and at the points, with the outer two frames averaged in where
    /// they agree with it as well as the middle ones do with each other: four frames have half the noise variance
    /// of two. The outer frames have full weight halfway between two frames, and none at a frame, which stays as
    /// filmed. They are warped by several motions; each pixel takes the one of the smallest difference. `costs` are
    /// the middle frames', at the pixels.
    fn fused(
        &self,
        mut middle: Image,
        at_points: &Image,
        tried: &[TriedMotion],
        costs: &[f32],
    ) -> Image {
        let options = self.inputs.options;
        let full = 0.25 * self.inputs.frames.outer_weight(options);
        if full <= 0.0 {
            return middle;
        }
        let channels = middle.channels();
        let filmed = middle.clone();
        for frame in [0, 3] {
            // Of each pixel the best motion and its cost.
            let mut best = vec![(0, f32::INFINITY); costs.len()];
            for (index, tried) in tried.iter().enumerate() {
                let Some(outer) = tried.at_points(frame) else { continue };
                let means = self.window_mean(&difference(outer, at_points));
                let of_motion = self.inputs.points.at_pixels(&means);
                for (best, cost) in best.iter_mut().zip(of_motion) {
                    if cost < best.1 {
                        *best = (index, cost);
                    }
                }
            }
            let weight = |((_, cost), own): (&(usize, f32), &f32)| {
                let excess = (cost - own - options.outer_slack).max(0.0);
                full * (-excess / options.outer_softness).exp()
            };
            let weights: Vec<f32> = best.iter().zip(costs).map(weight).collect();
            for (index, tried) in tried.iter().enumerate() {
                let takes = |k: usize| best[k].0 == index && weights[k] > MAX_LEFT_OUT;
                if !(0..costs.len()).any(takes) {
                    continue;
                }
                let Some(outer) = tried.at_pixels(frame) else { continue };
                let pixels = middle.data_mut().chunks_exact_mut(channels).enumerate();
                for (k, out) in pixels.filter(|(k, _)| takes(*k)) {
                    let span = k * channels..(k + 1) * channels;
                    let colors = outer.data()[span.clone()].iter().zip(&filmed.data()[span]);
                    for (out, (outer, filmed)) in out.iter_mut().zip(colors) {
                        *out += weights[k] * (outer - filmed);
                    }
                }
            }
        }
        middle
    }

    /// How the pixels move if a hypothesis is right.
    fn motions(&self, hypothesis: &Hypothesis) -> Vec<PixelMotion> {
        let costs = hypothesis.costs.iter();
        let (Shows::Both(index, _) | Shows::One(index, _)) = hypothesis.shows else {
            let motion_px = self.square.all_of(self.inputs.motion_px.unwrap_or_default());
            let of_pixel = |(motion_px, &cost)| PixelMotion { motion_px, change_px: 0.0, cost };
            return motion_px.into_iter().zip(costs).map(of_pixel).collect();
        };
        let tried = &self.tried[index];
        let at = |n: usize| tried.motion.at(n, Vector2::zeros());
        let steps = [0, 1, 2].map(|n| at(n + 1) - at(n));
        let change_px = |outer: usize, n: usize| {
            let change = tried.at_points(outer).map(|_| (steps[n + 1] - steps[n]).norm());
            change.unwrap_or(0.0) as f32
        };
        let motion_px = steps[1].norm() as f32;
        let change_px = change_px(0, 0).max(change_px(3, 1));
        let of_pixel = |(&cost, &of_warps): (&f32, &f32)| {
            let cost = if motion_px < AT_REST_PX { cost.max(of_warps) } else { cost };
            PixelMotion { motion_px, change_px, cost }
        };
        costs.zip(&self.costs).map(of_pixel).collect()
    }
}
