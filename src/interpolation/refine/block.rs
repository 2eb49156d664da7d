//! The refinement of one block of pixels, by the motions of the tracks around it, each under three
//! hypotheses of visibility.

use super::PixelMotion;
use super::best_costs::BestCosts;
use super::candidates::Candidates;
use super::cost_points::CostPoints;
use super::four_frames::FourFrames;
use super::layout::Layout;
use super::patch::Patch;
use super::square::Square;
use super::static_block::{average, is_static};
use crate::interpolation::RefineOptions;
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::{cross_fade, difference, largest_around};
use crate::raster::{Image, box_filter};
use nalgebra::{Point2, Vector2};

/// Maximum number of motions that the outer frames are warped by where the middle ones agree. Larger: time;
/// smaller: at the border of two surfaces one of them is not averaged.
const MAX_AGREEING_MOTIONS: usize = 2;

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

/// Refines the blocks of an image.
pub struct BlockRefiner<'a> {
    pub frames: &'a FourFrames<'a>,
    /// The candidate motions.
    pub candidates: Candidates<'a>,
    /// How well motions explain the earlier and the later frame.
    pub best_costs: [BestCosts<'a>; 2],
    /// The cross-fade of the two warped frames.
    pub cross_faded: &'a Image,
    /// Mean difference of the two warped frames over the window around each pixel, row by row.
    pub costs: &'a [f32],
    /// Distance of the places that each pixel comes from in the two frames, row by row.
    pub motion_px: &'a [f32],
    /// Costs of the frame before and of the frame after, not warped, and the cross-fade; `None` if
    /// the frame does not exist or has no weight.
    pub outer_costs: [Option<Vec<f32>>; 2],
    /// With lengths scaled to the image's size.
    pub options: &'a RefineOptions,
    /// Where the blocks lie.
    pub layout: Layout,
    /// Where a block's costs are computed.
    pub points: CostPoints,
}

/// A frame around a block, warped to the instant.
struct Warped {
    /// At the block's pixels.
    colors: Image,
    /// At the points of the costs.
    points: Image,
}

/// The weighted sum of a block's hypotheses, per pixel.
struct WeightedSums {
    colors: Vec<f32>,
    motions: Option<Vec<PixelMotion>>,
    weights: Vec<f32>,
}

/// A refined block, row by row. Pixels outside the image are black.
pub struct RefinedBlock {
    pub colors: Vec<f32>,
    /// `None` where the warped frames agree, whose motion holds, or nobody asked.
    pub motions: Option<Vec<PixelMotion>>,
}

impl BlockRefiner<'_> {
    /// The refined block with this top-left pixel; `None` if no track is near, or it is not needed.
    pub fn refine(&self, origin: [isize; 2]) -> Option<RefinedBlock> {
        let side = self.layout.side;
        if self.frames.parts.is_some_and(|parts| !parts.touches(origin, side)) {
            return None;
        }
        let square = Square { origin, side, image: self.layout.image };
        let max_cost = square.rows_of(self.costs).flatten().copied().fold(0.0, f32::max);
        let agree = max_cost <= self.options.min_difference;
        // Where the middle frames agree, only the outer frames remain to be averaged in.
        if agree && self.outer_costs.iter().all(Option::is_none) {
            return None;
        }
        if agree && is_static(&self.outer_costs, self.costs, self.options.outer_slack, square) {
            let outer_weight = self.frames.outer_weight(self.options);
            let colors = average(self.frames, self.cross_faded, outer_weight, square);
            return Some(RefinedBlock { colors, motions: None });
        }
        let mut candidates = self.candidates.around(&self.pixels(origin).center);
        if candidates.is_empty() {
            return None;
        }
        if agree {
            candidates.truncate(MAX_AGREEING_MOTIONS);
        }
        let patches: Vec<[Option<Warped>; 4]> =
            candidates.iter().map(|c| self.patches(c, origin, !agree)).collect();
        let mut sums = WeightedSums {
            colors: vec![0.0; side * side * self.cross_faded.channels()],
            motions: (self.frames.with_motions && !agree)
                .then(|| vec![PixelMotion::default(); side * side]),
            weights: vec![0.0; side * side],
        };
        self.add_cross_fade(&patches, square, &mut sums);
        if !agree {
            for (motion, patches) in candidates.iter().zip(&patches) {
                self.add_motion(motion, patches, square, &mut sums);
            }
        }
        Some(sums.mean(self.cross_faded.channels()))
    }

    /// Adds the cross-fade as a hypothesis of its own, at the pixels inside the image.
    fn add_cross_fade(
        &self,
        patches: &[[Option<Warped>; 4]],
        square: Square,
        sums: &mut WeightedSums,
    ) {
        let own = Warped {
            colors: self.cross_faded_at(square.origin, square.side, 1),
            points: self.cross_faded_at(
                square.origin.map(|v| v - self.points.margin_px() as isize),
                self.points.side(),
                self.points.step,
            ),
        };
        let outer: Vec<[Option<&Warped>; 2]> =
            patches.iter().map(|p| [p[0].as_ref(), p[3].as_ref()]).collect();
        let costs = square.all_of(self.costs);
        let fused = self.fused(&own, &outer, &costs);
        for (first, columns, y) in square.rows() {
            let motion_px = &self.motion_px[y * square.image[0]..][columns];
            for (k, &motion_px) in (first..).zip(motion_px) {
                let motion = PixelMotion { motion_px, change_px: 0.0, cost: costs[k] };
                let color = fused.pixel(k % square.side, k / square.side);
                sums.add(k, self.weight(motion.cost), color, motion);
            }
        }
    }

    /// The cross-fade at a square of pixels, `step` apart from the first on, the image's border repeated outwards.
    fn cross_faded_at(&self, first: [isize; 2], side: usize, step: usize) -> Image {
        let image = self.cross_faded;
        let clamp = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut data = Vec::with_capacity(side * side * image.channels());
        for k in 0..side * side {
            let x = clamp(first[0] + (k % side * step) as isize, image.width());
            let y = clamp(first[1] + (k / side * step) as isize, image.height());
            data.extend_from_slice(image.pixel(x, y));
        }
        Image::from_data(side, side, image.channels(), data)
    }

    /// The four frames around a block, warped to the instant by a motion; the middle two only if
    /// `with_middle`.
    fn patches(
        &self,
        motion: &LocalMotion,
        origin: [isize; 2],
        with_middle: bool,
    ) -> [Option<Warped>; 4] {
        let (patch, pixels) = (self.patch(origin), self.pixels(origin));
        let warped = |image: &Image, frame: usize| Warped {
            colors: pixels.sampled(image, motion, frame),
            points: patch.sampled(image, motion, frame),
        };
        let f = self.frames;
        [
            f.before.map(|image| warped(image, 0)),
            with_middle.then(|| warped(f.earlier, 1)),
            with_middle.then(|| warped(f.later, 2)),
            f.after.map(|image| warped(image, 3)),
        ]
    }

    /// The pixels of a block.
    fn pixels(&self, origin: [isize; 2]) -> Patch {
        let side = self.layout.side;
        let corner = Point2::from(origin.map(|v| v as f64));
        Patch { corner, center: corner + Vector2::repeat((side / 2) as f64), side, step: 1 }
    }

    /// The points of its costs.
    fn patch(&self, origin: [isize; 2]) -> Patch {
        let pixels = self.pixels(origin);
        Patch {
            corner: pixels.corner - Vector2::repeat(self.points.margin_px() as f64),
            side: self.points.side(),
            step: self.points.step,
            ..pixels
        }
    }

    /// By how much another motion explains a middle frame's pixels, 0 or 1, better than this one, whose costs are
    /// given; at the points of a block. The smallest within a window: at a surface's outline, windows are partly of
    /// what is behind it.
    fn better_explained(
        &self,
        n: usize,
        motion: &LocalMotion,
        origin: [isize; 2],
        costs: impl Fn(usize) -> f32,
    ) -> Vec<f32> {
        let patch = self.patch(origin);
        let deficit =
            |(k, [x, y]): (usize, [f32; 2])| (self.best_costs[n].at(x, y) - costs(k)).min(0.0);
        let places = patch.places(motion, n + 1).into_iter();
        let deficits: Vec<f32> = places.enumerate().map(deficit).collect();
        let mut excess = largest_around(&deficits, patch.side, self.points.radius);
        excess.iter_mut().for_each(|v| *v = -*v);
        excess
    }

    /// The middle frames' cross-fade, with the outer two frames averaged in where they agree with it as
    /// well as the middle ones do with each other: four frames have half the noise variance of two.
    /// The outer frames have full weight halfway between two frames, and none at a frame, which
    /// stays as filmed. `outer` holds the frames before and after, warped by several motions; each
    /// pixel takes the one of the smallest difference.
    /// `costs` are the middle frames', at the block's pixels.
    fn fused(&self, middle: &Warped, outer: &[[Option<&Warped>; 2]], costs: &[f32]) -> Image {
        let channels = middle.colors.channels();
        let full = self.frames.outer_weight(self.options);
        let mut out = middle.colors.clone();
        if full <= 0.0 {
            return out;
        }
        for n in 0..2 {
            let candidates: Vec<(&Image, Vec<f32>)> = (outer.iter().filter_map(|pair| pair[n]))
                .map(|outer| {
                    let costs = self.window_mean(&difference(&outer.points, &middle.points));
                    (&outer.colors, self.points.at_pixels(&costs))
                })
                .collect();
            for (k, out) in out.data_mut().chunks_exact_mut(channels).enumerate() {
                let by_cost =
                    |a: &&(&Image, Vec<f32>), b: &&(&Image, Vec<f32>)| a.1[k].total_cmp(&b.1[k]);
                let Some((image, cost)) = candidates.iter().min_by(by_cost) else { continue };
                let excess = (cost[k] - costs[k] - self.options.outer_slack).max(0.0);
                let weight = 0.25 * full * (-excess / self.options.outer_softness).exp();
                let at = k * channels;
                let (color, middle) = (&image.data()[at..], &middle.colors.data()[at..]);
                for ((out, color), middle) in out.iter_mut().zip(color).zip(middle) {
                    *out += weight * (color - middle);
                }
            }
        }
        out
    }

    /// Mean over the window around each of a block's points.
    fn window_mean(&self, values: &[f32]) -> Vec<f32> {
        let side = self.points.side();
        box_filter(values, side, side, self.points.radius)
    }

    /// The weight of a hypothesis by its cost.
    fn weight(&self, cost: f32) -> f32 {
        (-cost / self.options.softness).exp().max(MIN_WEIGHT)
    }

    /// Adds a motion under its three hypotheses: both frames see the point, only the earlier does, only
    /// the later does.
    fn add_motion(
        &self,
        motion: &LocalMotion,
        patches: &[Option<Warped>; 4],
        square: Square,
        sums: &mut WeightedSums,
    ) {
        let [before, Some(earlier), Some(later), after] = patches else { return };
        let cost = |a: &Warped, b: &Warped| self.window_mean(&difference(&a.points, &b.points));
        let both = cost(earlier, later);
        let only = [
            before.as_ref().map(|before| cost(before, earlier)),
            after.as_ref().map(|after| cost(later, after)),
        ];
        let others = [0, 1].map(|n| {
            let own_cost = |k: usize| only[n].as_ref().map_or(both[k], |only| only[k].min(both[k]));
            self.better_explained(n, motion, square.origin, own_cost)
        });
        let middle = Warped {
            colors: cross_fade(&earlier.colors, &later.colors, self.frames.fraction),
            points: cross_fade(&earlier.points, &later.points, self.frames.fraction),
        };
        let outer = [[before.as_ref(), after.as_ref()]];
        let fused = self.fused(&middle, &outer, &self.points.at_pixels(&both));
        let total = |costs: &[f32], explained: &[f32]| {
            let sum = costs.iter().zip(explained).map(|(a, b)| a + BETTER_EXPLAINED_WEIGHT * b);
            self.points.at_pixels(&sum.collect::<Vec<_>>())
        };
        let by_either: Vec<f32> = others[0].iter().zip(&others[1]).map(|(a, b)| a + b).collect();
        // Costs, what one frame alone costs more, and colours.
        let mut hypotheses = vec![(total(&both, &by_either), 0.0, &fused)];
        for (n, (frame, fraction)) in
            [(earlier, 1.0 - self.frames.fraction), (later, self.frames.fraction)]
                .into_iter()
                .enumerate()
        {
            if let Some(only) = &only[n] {
                // What the nearer frame does not show has had little time to appear.
                let unlikely =
                    self.options.one_frame_cost / (2.0 * fraction).max(MIN_DOUBLE_FRACTION);
                hypotheses.push((total(only, &others[n]), unlikely, &frame.colors));
            }
        }
        let steps =
            [0, 1, 2].map(|n| motion.at(n + 1, Vector2::zeros()) - motion.at(n, Vector2::zeros()));
        let change_px = |exists: bool, n: usize| {
            if exists { (steps[n + 1] - steps[n]).norm() as f32 } else { 0.0 }
        };
        let of_block = PixelMotion {
            motion_px: steps[1].norm() as f32,
            change_px: change_px(before.is_some(), 0).max(change_px(after.is_some(), 1)),
            cost: 0.0,
        };
        let at_rest = of_block.motion_px < AT_REST_PX;
        let min_costs = at_rest.then(|| square.all_of(self.costs));
        let pixel_motion = |k: usize, cost: f32| {
            let min_cost = min_costs.as_ref().map_or(0.0, |costs| costs[k]);
            PixelMotion { cost: cost.max(min_cost), ..of_block }
        };
        for (costs, more, colors) in hypotheses {
            let colors = colors.data().chunks_exact(colors.channels());
            for (k, (cost, color)) in costs.iter().zip(colors).enumerate() {
                let cost = cost + more;
                sums.add(k, self.weight(cost), color, pixel_motion(k, cost));
            }
        }
    }
}

impl WeightedSums {
    /// Adds a hypothesis at pixel k of the block.
    fn add(&mut self, k: usize, weight: f32, color: &[f32], motion: PixelMotion) {
        self.weights[k] += weight;
        if let Some(motions) = &mut self.motions {
            motions[k].add(weight, motion);
        }
        let at = k * color.len();
        for (sum, c) in self.colors[at..].iter_mut().zip(color) {
            *sum += weight * c;
        }
    }

    /// The weighted mean at every pixel; black where nothing was added.
    fn mean(mut self, channels: usize) -> RefinedBlock {
        for (color, &weight) in self.colors.chunks_exact_mut(channels).zip(&self.weights) {
            // Nothing is added outside the image. Inside, the weights are at least MIN_WEIGHT.
            if weight > 0.0 {
                color.iter_mut().for_each(|c| *c /= weight);
            }
        }
        for (motion, &weight) in self.motions.iter_mut().flatten().zip(&self.weights) {
            if weight > 0.0 {
                *motion = motion.times(1.0 / weight);
            }
        }
        RefinedBlock { colors: self.colors, motions: self.motions }
    }
}
