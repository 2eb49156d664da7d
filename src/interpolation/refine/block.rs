//! The refinement of one block of pixels, by the motions of the tracks around it, each under three
//! hypotheses of visibility.

use super::four_frames::FourFrames;
use super::static_block::{average, is_static};
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::{cross_fade, difference};
use crate::interpolation::{Motion, RefineOptions};
use crate::raster::{Image, box_filter, sample_all};
use crate::registration::Neighbors;
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

/// Refines the blocks of an image.
pub struct BlockRefiner<'a> {
    pub frames: &'a FourFrames<'a>,
    pub motions: &'a [Motion],
    /// The motions' positions.
    pub neighbors: Neighbors,
    /// The cross-fade of the two warped frames.
    pub cross_faded: &'a Image,
    /// Mean difference of the two warped frames over the window around each pixel, row by row.
    pub costs: &'a [f32],
    /// The same of the frame before and of the frame after, not warped, and the cross-fade; `None` if
    /// the frame does not exist or has no weight.
    pub outer_costs: [Option<Vec<f32>>; 2],
    /// With lengths scaled to the image's size.
    pub options: &'a RefineOptions,
    /// Distance between blocks, pixels; half a block's side.
    pub step: usize,
}

/// The weighted sum of a block's hypotheses, per pixel.
struct WeightedSums {
    colors: Vec<f32>,
    weights: Vec<f32>,
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
        let [w, h] = self.image;
        let inside =
            move |x: isize, y: isize| x >= 0 && y >= 0 && (x as usize) < w && (y as usize) < h;
        (0..self.side * self.side).map(move |k| {
            let x = self.origin[0] + (k % self.side) as isize;
            let y = self.origin[1] + (k / self.side) as isize;
            inside(x, y).then_some((x as usize, y as usize))
        })
    }
}

impl BlockRefiner<'_> {
    /// The refined block (`bx`, `by`), of twice the step a side, row by row; `None` if no track is near,
    /// or it is not needed. Pixels outside the image are black.
    pub fn refine(&self, bx: isize, by: isize) -> Option<Vec<f32>> {
        let (w, h) = (self.cross_faded.width(), self.cross_faded.height());
        let (step, side) = (self.step as isize, 2 * self.step);
        let origin = [(bx - 1) * step, (by - 1) * step];
        if self.frames.parts.is_some_and(|parts| !parts.touches(origin, side)) {
            return None;
        }
        let square = Square { origin, side, image: [w, h] };
        let indices = || square.pixels().flatten().map(|(x, y)| y * w + x);
        let max_cost = indices().map(|k| self.costs[k]).fold(0.0, f32::max);
        let agree = max_cost <= self.options.min_difference;
        // Where the middle frames agree, only the outer frames remain to be averaged in.
        if agree && self.outer_costs.iter().all(Option::is_none) {
            return None;
        }
        if agree && is_static(&self.outer_costs, self.costs, self.options.outer_slack, indices) {
            let outer_weight = self.frames.outer_weight(self.options);
            return Some(average(self.frames, self.cross_faded, outer_weight, square.pixels()));
        }
        let center = Point2::new((origin[0] + step) as f64, (origin[1] + step) as f64);
        let mut candidates = self.candidates(&center);
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
            weights: vec![0.0; side * side],
        };
        self.add_cross_fade(&patches, square, &mut sums);
        if !agree {
            for patches in &patches {
                self.add_motion(patches, &mut sums);
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
            if pixel.is_some() {
                let (x, y) = (k % square.side + radius, k / square.side + radius);
                sums.add(k, self.weight(costs[y * side + x]), fused.pixel(x, y));
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
        let radius = self.options.window_radius_px;
        let side = 2 * self.step + 2 * radius;
        let channels = self.cross_faded.channels();
        let middle = Vector2::repeat(self.step as f64);
        let warped = |image: &Image, frame: usize| {
            let mut patch = vec![0.0; side * side * channels];
            let positions = (0..side * side).map(|k| {
                let x = origin[0] - radius as isize + (k % side) as isize;
                let y = origin[1] - radius as isize + (k / side) as isize;
                let at = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let from = at - Vector2::new(origin[0] as f64, origin[1] as f64) - middle;
                let shift = motion.at(frame, from);
                [(at.x + shift.x) as f32, (at.y + shift.y) as f32]
            });
            sample_all(image, positions, &mut patch);
            Image::from_data(side, side, channels, patch)
        };
        let f = self.frames;
        [
            f.before.map(|image| warped(image, 0)),
            with_middle.then(|| warped(f.earlier, 1)),
            with_middle.then(|| warped(f.later, 2)),
            f.after.map(|image| warped(image, 3)),
        ]
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

    /// The candidate motions around a point, nearest first: each fitted to tracks that move alike, weighted
    /// by nearness.
    fn candidates(&self, center: &Point2<f64>) -> Vec<LocalMotion> {
        let mut near = self.neighbors.within(center, self.options.search_radius_px);
        let distance = |k: usize| (self.motions[k].at - center).norm();
        near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
        let mut assigned = vec![false; near.len()];
        let mut candidates = Vec::new();
        for seed in 0..near.len() {
            if assigned[seed] || candidates.len() == self.options.max_motions {
                continue;
            }
            let own = &self.motions[near[seed]];
            let mut members = Vec::new();
            for k in seed..near.len() {
                // Between the middle frames, where tracks are most accurate.
                let distance_px = own.distance(&self.motions[near[k]]);
                if assigned[k] || distance_px > self.options.same_motion_px {
                    continue;
                }
                assigned[k] = true;
                members.push(&self.motions[near[k]]);
            }
            if members.len() >= self.options.min_tracks {
                candidates.extend(LocalMotion::fit(&members, center));
            }
        }
        candidates
    }

    /// Adds a motion under its three hypotheses: both frames see the point, only the earlier does, only
    /// the later does.
    fn add_motion(&self, patches: &[Option<Image>; 4], sums: &mut WeightedSums) {
        let radius = self.options.window_radius_px;
        let block = 2 * self.step;
        let side = block + 2 * radius;
        let [before, Some(earlier), Some(later), after] = patches else { return };
        let cost = |a: &Image, b: &Image| self.window_mean(&difference(a, b), side);
        let both = cost(earlier, later);
        let only_earlier = before.as_ref().map(|p| cost(p, earlier));
        let only_later = after.as_ref().map(|p| cost(later, p));
        let middle = cross_fade(earlier, later, self.frames.fraction);
        let fused = self.fused(&middle, &[[before.as_ref(), after.as_ref()]], &both);
        for k in 0..block * block {
            let (x, y) = (k % block + radius, k / block + radius);
            let at = y * side + x;
            sums.add(k, self.weight(both[at]), fused.pixel(x, y));
            for (costs, color, fraction) in [
                (&only_earlier, earlier.pixel(x, y), 1.0 - self.frames.fraction),
                (&only_later, later.pixel(x, y), self.frames.fraction),
            ] {
                if let Some(costs) = costs {
                    // What the nearer frame does not show has had little time to appear.
                    let cost = costs[at]
                        + self.options.one_frame_cost / (2.0 * fraction).max(MIN_DOUBLE_FRACTION);
                    sums.add(k, self.weight(cost), color);
                }
            }
        }
    }
}

impl WeightedSums {
    /// Adds a hypothesis at pixel k of the block.
    fn add(&mut self, k: usize, weight: f32, color: &[f32]) {
        self.weights[k] += weight;
        let at = k * color.len();
        for (sum, c) in self.colors[at..].iter_mut().zip(color) {
            *sum += weight * c;
        }
    }

    /// The weighted mean at every pixel; black where nothing was added.
    fn mean(mut self, channels: usize) -> Vec<f32> {
        for (color, &weight) in self.colors.chunks_exact_mut(channels).zip(&self.weights) {
            // Nothing is added outside the image. Inside, the weights are at least MIN_WEIGHT.
            if weight > 0.0 {
                color.iter_mut().for_each(|c| *c /= weight);
            }
        }
        self.colors
    }
}
