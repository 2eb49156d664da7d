//! The refinement of one block of pixels, by the motions of the tracks around it, each under three
//! hypotheses of visibility.

use super::PixelMotion;
use super::best_costs::BestCosts;
use super::candidates::Candidates;
use super::four_frames::FourFrames;
use super::layout::Layout;
use super::patch::Patch;
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

/// A block's square of pixels, part of which may be outside the image.
#[derive(Clone, Copy)]
struct Square {
    /// The top-left pixel.
    origin: [isize; 2],
    side: usize,
    /// Width and height of the image.
    image: [usize; 2],
}

impl Square {
    /// The pixels row by row, `None` for those outside the image.
    fn pixels(self) -> impl Iterator<Item = Option<(usize, usize)>> {
        (0..self.side * self.side).map(move |k| self.pixel(k))
    }

    /// Pixel k, row by row, `None` outside the image.
    fn pixel(self, k: usize) -> Option<(usize, usize)> {
        let at = |n: usize, k: usize| {
            let at = usize::try_from(self.origin[n] + k as isize).ok()?;
            (at < self.image[n]).then_some(at)
        };
        Some((at(0, k % self.side)?, at(1, k / self.side)?))
    }
}

impl BlockRefiner<'_> {
    /// The refined block with this top-left pixel; `None` if no track is near, or it is not needed.
    pub fn refine(&self, origin: [isize; 2]) -> Option<RefinedBlock> {
        let side = self.layout.side;
        if self.frames.parts.is_some_and(|parts| !parts.touches(origin, side)) {
            return None;
        }
        let square = Square { origin, side, image: self.layout.image };
        let indices = || square.pixels().flatten().map(|(x, y)| y * square.image[0] + x);
        let max_cost = indices().map(|k| self.costs[k]).fold(0.0, f32::max);
        let agree = max_cost <= self.options.min_difference;
        // Where the middle frames agree, only the outer frames remain to be averaged in.
        if agree && self.outer_costs.iter().all(Option::is_none) {
            return None;
        }
        if agree && is_static(&self.outer_costs, self.costs, self.options.outer_slack, indices) {
            let outer_weight = self.frames.outer_weight(self.options);
            let colors = average(self.frames, self.cross_faded, outer_weight, square.pixels());
            return Some(RefinedBlock { colors, motions: None });
        }
        let mut candidates = self.candidates.around(&self.patch(origin).center);
        if candidates.is_empty() {
            return None;
        }
        if agree {
            candidates.truncate(MAX_AGREEING_MOTIONS);
        }
        let patches: Vec<[Option<Image>; 4]> =
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
        patches: &[[Option<Image>; 4]],
        square: Square,
        sums: &mut WeightedSums,
    ) {
        let radius = self.options.window_radius_px;
        let side = square.side + 2 * radius;
        let (own, costs) = self.cross_fade_patch(square.origin, side);
        let outer: Vec<[Option<&Image>; 2]> =
            patches.iter().map(|p| [p[0].as_ref(), p[3].as_ref()]).collect();
        let fused = self.fused(&own, &outer, &costs);
        for (k, pixel) in square.pixels().enumerate() {
            if let Some((column, row)) = pixel {
                let (x, y) = (k % square.side + radius, k / square.side + radius);
                let motion_px = self.motion_px[row * square.image[0] + column];
                let motion = PixelMotion { motion_px, change_px: 0.0, cost: costs[y * side + x] };
                sums.add(k, self.weight(motion.cost), fused.pixel(x, y), motion);
            }
        }
    }

    /// The cross-fade and its costs over a block with the windows around it, the image's border repeated
    /// outwards.
    fn cross_fade_patch(&self, origin: [isize; 2], side: usize) -> (Image, Vec<f32>) {
        let (w, h) = (self.cross_faded.width(), self.cross_faded.height());
        let channels = self.cross_faded.channels();
        let radius = self.options.window_radius_px as isize;
        let clamp = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut image = vec![0.0; side * side * channels];
        let mut costs = vec![0.0; side * side];
        for (k, color) in image.chunks_exact_mut(channels).enumerate() {
            let x = clamp(origin[0] - radius + (k % side) as isize, w);
            let y = clamp(origin[1] - radius + (k / side) as isize, h);
            color.copy_from_slice(self.cross_faded.pixel(x, y));
            costs[k] = self.costs[y * w + x];
        }
        (Image::from_data(side, side, channels, image), costs)
    }

    /// The four frames around a block, warped to the instant by a motion; the middle two only if
    /// `with_middle`.
    fn patches(
        &self,
        motion: &LocalMotion,
        origin: [isize; 2],
        with_middle: bool,
    ) -> [Option<Image>; 4] {
        let patch = self.patch(origin);
        let warped = |image: &Image, frame: usize| patch.sampled(image, motion, frame);
        let f = self.frames;
        [
            f.before.map(|image| warped(image, 0)),
            with_middle.then(|| warped(f.earlier, 1)),
            with_middle.then(|| warped(f.later, 2)),
            f.after.map(|image| warped(image, 3)),
        ]
    }

    /// A block with the windows around it.
    fn patch(&self, origin: [isize; 2]) -> Patch {
        let radius = self.options.window_radius_px;
        let at = |offset: isize| Point2::from(origin.map(|v| (v + offset) as f64));
        Patch {
            corner: at(-(radius as isize)),
            center: at(self.layout.side as isize / 2),
            side: self.layout.side + 2 * radius,
        }
    }

    /// By how much another motion explains a middle frame's pixels, 0 or 1, better than this one, whose costs are
    /// given; over a block with the windows around it. The smallest within a window: at a surface's
    /// outline, windows are partly of what is behind it.
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
        let mut excess = largest_around(&deficits, patch.side, self.options.window_radius_px);
        excess.iter_mut().for_each(|v| *v = -*v);
        excess
    }

    /// The middle frames' cross-fade, with the outer two frames averaged in where they agree with it as
    /// well as the middle ones do with each other: four frames have half the noise variance of two.
    /// The outer frames have full weight halfway between two frames, and none at a frame, which
    /// stays as filmed. `outer` holds the frames before and after, warped by several motions; each
    /// pixel takes the one of the smallest difference.
    fn fused(&self, middle: &Image, outer: &[[Option<&Image>; 2]], costs: &[f32]) -> Image {
        let (side, channels) = (middle.width(), middle.channels());
        let full = self.frames.outer_weight(self.options);
        let mut out = middle.clone();
        if full <= 0.0 {
            return out;
        }
        for n in 0..2 {
            let candidates: Vec<(&Image, Vec<f32>)> = outer
                .iter()
                .filter_map(|pair| pair[n])
                .map(|image| (image, self.window_mean(&difference(image, middle), side)))
                .collect();
            for (k, out) in out.data_mut().chunks_exact_mut(channels).enumerate() {
                let by_cost =
                    |a: &&(&Image, Vec<f32>), b: &&(&Image, Vec<f32>)| a.1[k].total_cmp(&b.1[k]);
                let Some((image, cost)) = candidates.iter().min_by(by_cost) else { continue };
                let excess = (cost[k] - costs[k] - self.options.outer_slack).max(0.0);
                let weight = 0.25 * full * (-excess / self.options.outer_softness).exp();
                let at = k * channels;
                let (color, middle) = (&image.data()[at..], &middle.data()[at..]);
                for ((out, color), middle) in out.iter_mut().zip(color).zip(middle) {
                    *out += weight * (color - middle);
                }
            }
        }
        out
    }

    /// Mean over the window of a patch that is `side` pixels wide and high.
    fn window_mean(&self, values: &[f32], side: usize) -> Vec<f32> {
        box_filter(values, side, side, self.options.window_radius_px)
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
        patches: &[Option<Image>; 4],
        square: Square,
        sums: &mut WeightedSums,
    ) {
        let radius = self.options.window_radius_px;
        let side = square.side + 2 * radius;
        let [before, Some(earlier), Some(later), after] = patches else { return };
        let cost = |a: &Image, b: &Image| self.window_mean(&difference(a, b), side);
        let both = cost(earlier, later);
        let only = [
            before.as_ref().map(|before| cost(before, earlier)),
            after.as_ref().map(|after| cost(later, after)),
        ];
        let [others_earlier, others_later] = [0, 1].map(|n| {
            let own_cost = |k: usize| only[n].as_ref().map_or(both[k], |only| only[k].min(both[k]));
            self.better_explained(n, motion, square.origin, own_cost)
        });
        let middle = cross_fade(earlier, later, self.frames.fraction);
        let fused = self.fused(&middle, &[[before.as_ref(), after.as_ref()]], &both);
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
        let pixel_motion = |k: usize, cost: f32| {
            let pixel = square.pixel(k).filter(|_| at_rest);
            let min_cost = pixel.map_or(0.0, |(x, y)| self.costs[y * square.image[0] + x]);
            PixelMotion { cost: cost.max(min_cost), ..of_block }
        };
        for k in 0..square.side * square.side {
            let (x, y) = (k % square.side + radius, k / square.side + radius);
            let at = y * side + x;
            let cost = both[at] + BETTER_EXPLAINED_WEIGHT * (others_earlier[at] + others_later[at]);
            sums.add(k, self.weight(cost), fused.pixel(x, y), pixel_motion(k, cost));
            for (costs, others, color, fraction) in [
                (&only[0], others_earlier[at], earlier.pixel(x, y), 1.0 - self.frames.fraction),
                (&only[1], others_later[at], later.pixel(x, y), self.frames.fraction),
            ] {
                if let Some(costs) = costs {
                    // What the nearer frame does not show has had little time to appear.
                    let unlikely =
                        self.options.one_frame_cost / (2.0 * fraction).max(MIN_DOUBLE_FRACTION);
                    let cost = costs[at] + unlikely + BETTER_EXPLAINED_WEIGHT * others;
                    sums.add(k, self.weight(cost), color, pixel_motion(k, cost));
                }
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
