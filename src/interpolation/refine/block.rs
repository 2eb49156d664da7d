//! One block of pixels under the motions around it, each under its three hypotheses.

use super::{FourFrames, outer_weight};
use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::windows::{box_mean, difference, mixed};
use crate::interpolation::{Motion, RefineOptions};
use crate::raster::{Image, sample_all};
use crate::registration::Neighbors;
use nalgebra::{Point2, Vector2};

/// Motions that the outer frames are tried by where the middle ones agree. More costs time.
const AGREEING_MOTIONS: usize = 2;

/// Twice the least share of the interval that is told from a frame.
const MIN_SHARE: f32 = 1e-3;

/// Keeps a sum of weights from being 0 where every hypothesis is far off.
const MIN_WEIGHT: f32 = 1e-30;

/// What all blocks of an image share.
pub struct Work<'a> {
    pub frames: &'a FourFrames<'a>,
    pub motions: &'a [Motion],
    pub neighbors: Neighbors,
    pub dissolved: &'a Image,
    /// Mean difference of the warped frames around each pixel.
    pub costs: &'a [f32],
    /// The same of the frames before and after, unmoved, and the dissolved one; none where they don't
    /// count.
    pub outer_costs: [Option<Vec<f32>>; 2],
    pub options: &'a RefineOptions,
    /// Between blocks, pixels.
    pub step: usize,
}

/// The weighted sum of a block's hypotheses, per pixel.
struct Sums {
    colors: Vec<f32>,
    weights: Vec<f32>,
}

impl Work<'_> {
    /// The refined block, row by row; `None` where nothing is near, or it isn't asked for.
    pub fn block(&self, bx: isize, by: isize) -> Option<Vec<f32>> {
        let (w, h) = (self.dissolved.width(), self.dissolved.height());
        let channels = self.dissolved.channels();
        let (step, block) = (self.step as isize, 2 * self.step);
        let origin = [(bx - 1) * step, (by - 1) * step];
        let center = Point2::new((origin[0] + step) as f64, (origin[1] + step) as f64);
        if self.frames.parts.is_some_and(|parts| !parts.touches(origin, block)) {
            return None;
        }
        let pixel = |x: usize, y: usize| {
            let (x, y) = (origin[0] + x as isize, origin[1] + y as isize);
            let inside = x >= 0 && y >= 0 && (x as usize) < w && (y as usize) < h;
            inside.then_some((x as usize, y as usize))
        };
        let places = || (0..block).flat_map(|y| (0..block).map(move |x| (x, y)));
        let worst = places()
            .filter_map(|(x, y)| pixel(x, y))
            .map(|(x, y)| self.costs[y * w + x])
            .fold(0.0, f32::max);
        let agree = worst <= self.options.min_difference;
        // There, all that is left to do is to average the outer frames in.
        if agree && self.outer_costs.iter().all(Option::is_none) {
            return None;
        }
        if agree && self.is_at_rest(|| places().filter_map(|(x, y)| pixel(x, y))) {
            return Some(self.averaged(places().map(|(x, y)| pixel(x, y))));
        }
        let mut candidates = self.candidates(&center);
        if candidates.is_empty() {
            return None;
        }
        if agree {
            candidates.truncate(AGREEING_MOTIONS);
        }
        let patches: Vec<[Option<Image>; 4]> =
            candidates.iter().map(|c| self.patches(c, origin, !agree)).collect();
        let mut sums =
            Sums { colors: vec![0.0; block * block * channels], weights: vec![0.0; block * block] };
        // The dissolve is a hypothesis of its own.
        let radius = self.options.window_radius_px;
        let side = block + 2 * radius;
        let (own, costs) = self.dissolve(origin, side);
        let outer: Vec<[Option<&Image>; 2]> =
            patches.iter().map(|p| [p[0].as_ref(), p[3].as_ref()]).collect();
        let fused = self.fused(&own, &outer, &costs);
        for (k, (x, y)) in places().enumerate() {
            if pixel(x, y).is_some() {
                let at = (y + radius) * side + x + radius;
                sums.add(k, self.weight(costs[at]), fused.pixel(x + radius, y + radius));
            }
        }
        if !agree {
            for patches in &patches {
                self.try_motion(patches, &mut sums);
            }
        }
        for (color, &weight) in sums.colors.chunks_exact_mut(channels).zip(&sums.weights) {
            // Outside the image nothing was added; inside, the weights are at least MIN_WEIGHT.
            if weight > 0.0 {
                color.iter_mut().for_each(|c| *c /= weight);
            }
        }
        Some(sums.colors)
    }

    /// The dissolve and its costs over a block with the windows around it; beyond the image's
    /// border its last pixels go on.
    fn dissolve(&self, origin: [isize; 2], side: usize) -> (Image, Vec<f32>) {
        let (w, h) = (self.dissolved.width(), self.dissolved.height());
        let channels = self.dissolved.channels();
        let radius = self.options.window_radius_px as isize;
        let clamp = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut image = vec![0.0; side * side * channels];
        let mut costs = vec![0.0; side * side];
        for (k, color) in image.chunks_exact_mut(channels).enumerate() {
            let x = clamp(origin[0] - radius + (k % side) as isize, w);
            let y = clamp(origin[1] - radius + (k / side) as isize, h);
            color.copy_from_slice(self.dissolved.pixel(x, y));
            costs[k] = self.costs[y * w + x];
        }
        (Image::from_data(side, side, channels, image), costs)
    }

    /// The four frames around a block, moved to the instant.
    fn patches(
        &self,
        motion: &LocalMotion,
        origin: [isize; 2],
        middle_too: bool,
    ) -> [Option<Image>; 4] {
        let radius = self.options.window_radius_px;
        let side = 2 * self.step + 2 * radius;
        let channels = self.dissolved.channels();
        let middle = Vector2::repeat(self.step as f64);
        let cut = |image: &Image, frame: usize| {
            let mut patch = vec![0.0; side * side * channels];
            let places = (0..side * side).map(|k| {
                let x = origin[0] - radius as isize + (k % side) as isize;
                let y = origin[1] - radius as isize + (k / side) as isize;
                let at = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let from = at - Vector2::new(origin[0] as f64, origin[1] as f64) - middle;
                let shift = motion.at(frame, from);
                [(at.x + shift.x) as f32, (at.y + shift.y) as f32]
            });
            sample_all(image, places, &mut patch);
            Image::from_data(side, side, channels, patch)
        };
        let f = self.frames;
        [
            f.before.map(|image| cut(image, 0)),
            middle_too.then(|| cut(f.earlier, 1)),
            middle_too.then(|| cut(f.later, 2)),
            f.after.map(|image| cut(image, 3)),
        ]
    }

    /// The middle frames' dissolve, with the outer two frames averaged in where they agree with it
    /// as well as the middle ones do with each other: four frames have half the noise of two. They
    /// count in full halfway between two frames, and not at all at a frame, which stays as filmed.
    /// `outer` holds the frames before and after, moved to the instant by several motions; each
    /// pixel takes the one that fits best.
    fn fused(&self, mixed: &Image, outer: &[[Option<&Image>; 2]], costs: &[f32]) -> Image {
        let (side, channels) = (mixed.width(), mixed.channels());
        let full = outer_weight(self.frames, self.options);
        let mut out = mixed.clone();
        if full <= 0.0 {
            return out;
        }
        for n in 0..2 {
            let tried: Vec<(&Image, Vec<f32>)> = outer
                .iter()
                .filter_map(|pair| pair[n])
                .map(|image| (image, self.window_mean(&difference(image, mixed), side)))
                .collect();
            for (k, out) in out.data_mut().chunks_exact_mut(channels).enumerate() {
                let by_cost =
                    |a: &&(&Image, Vec<f32>), b: &&(&Image, Vec<f32>)| a.1[k].total_cmp(&b.1[k]);
                let Some((image, cost)) = tried.iter().min_by(by_cost) else { continue };
                let excess = (cost[k] - costs[k] - self.options.outer_slack).max(0.0);
                let weight = 0.25 * full * (-excess / self.options.outer_softness).exp();
                let at = k * channels;
                let (color, middle) = (&image.data()[at..], &mixed.data()[at..]);
                for ((out, color), middle) in out.iter_mut().zip(color).zip(middle) {
                    *out += weight * (color - middle);
                }
            }
        }
        out
    }

    /// Mean over the window of a patch that is `side` pixels wide and high.
    fn window_mean(&self, values: &[f32], side: usize) -> Vec<f32> {
        box_mean(values, side, side, self.options.window_radius_px)
    }

    fn weight(&self, cost: f32) -> f32 {
        (-cost / self.options.softness).exp().max(MIN_WEIGHT)
    }

    /// The motions around a place, nearest first: each fitted to the tracks that move alike,
    /// weighted by nearness.
    fn candidates(&self, center: &Point2<f64>) -> Vec<LocalMotion> {
        let mut near = self.neighbors.within(center, self.options.search_radius_px);
        let distance = |k: usize| (self.motions[k].at - center).norm();
        near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
        let mut taken = vec![false; near.len()];
        let mut candidates = Vec::new();
        for seed in 0..near.len() {
            if taken[seed] || candidates.len() == self.options.max_motions {
                continue;
            }
            let own = &self.motions[near[seed]].to;
            let mut members = Vec::new();
            for k in seed..near.len() {
                let other = &self.motions[near[k]].to;
                // Between the middle frames, whose tracks are the surest.
                let apart = ((other[2] - other[1]) - (own[2] - own[1])).norm();
                if taken[k] || apart > self.options.same_motion_px {
                    continue;
                }
                taken[k] = true;
                members.push(&self.motions[near[k]]);
            }
            if members.len() >= self.options.min_tracks {
                candidates.extend(LocalMotion::fit(&members, center));
            }
        }
        candidates
    }

    /// Adds a motion under its three hypotheses.
    fn try_motion(&self, patches: &[Option<Image>; 4], sums: &mut Sums) {
        let radius = self.options.window_radius_px;
        let block = 2 * self.step;
        let side = block + 2 * radius;
        let [before, Some(earlier), Some(later), after] = patches else { return };
        let cost = |a: &Image, b: &Image| self.window_mean(&difference(a, b), side);
        let both = cost(earlier, later);
        let only_earlier = before.as_ref().map(|p| cost(p, earlier));
        let only_later = after.as_ref().map(|p| cost(later, p));
        let mix = mixed(earlier, later, self.frames.share);
        let mix = self.fused(&mix, &[[before.as_ref(), after.as_ref()]], &both);
        for k in 0..block * block {
            let (x, y) = (k % block + radius, k / block + radius);
            let at = y * side + x;
            sums.add(k, self.weight(both[at]), mix.pixel(x, y));
            for (costs, color, share) in [
                (&only_earlier, earlier.pixel(x, y), 1.0 - self.frames.share),
                (&only_later, later.pixel(x, y), self.frames.share),
            ] {
                if let Some(costs) = costs {
                    // What the nearer frame doesn't see has had little time to appear.
                    let cost =
                        costs[at] + self.options.one_frame_cost / (2.0 * share).max(MIN_SHARE);
                    sums.add(k, self.weight(cost), color);
                }
            }
        }
    }
}

impl Sums {
    fn add(&mut self, k: usize, weight: f32, color: &[f32]) {
        self.weights[k] += weight;
        let at = k * color.len();
        for (sum, c) in self.colors[at..].iter_mut().zip(color) {
            *sum += weight * c;
        }
    }
}
