//! Beyond the paper: where the two warped frames of a morph disagree, per-pixel motion and
//! visibility; where the frames before and after agree too, their mean, which has less noise.
//!
//! Beside a moving outline the morph mixes the motions on both sides, and the cross dissolve mixes
//! a frame that sees the background with one that doesn't. There, blocks of pixels try the motions
//! of the tracks around them, each under three hypotheses: both frames see the point (then they
//! agree with each other), only the earlier does (then it agrees with the frame before it), or
//! only the later (then it agrees with the frame after it; the nearer the instant is to a frame, the
//! less likely only the other sees the point). Every pixel is the mean of all of
//! these and of the morph, weighted by how well each agrees over a small window. Blocks overlap
//! and fade into each other, so that none has a border.
//!
//! Known limits: what is seen in none of the four frames is not found; a window of a few pixels
//! decides, so outlines are right to about two pixels.

use super::local_motion::LocalMotion;
use super::warp::{Warp, warped};
use super::windows::{box_mean, difference, mixed};
use super::{Motion, RefineOptions};
use crate::raster::Image;
use crate::registration::Neighbors;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// The frames around an instant, and where it lies between the middle two.
pub struct FourFrames<'a> {
    pub before: Option<&'a Image>,
    pub earlier: &'a Image,
    pub later: &'a Image,
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt, 0 at the earlier frame.
    pub share: f32,
}

/// Blocks stand this far apart, pixels, and are twice as large: or as far as twice a window's radius,
/// where that is more: from 640 pixels on they grow with the image, as what they show and the windows
/// around them do, which would soon cost more than the blocks. Larger: one motion for pixels that move
/// differently; smaller: more blocks to try.
const MIN_STEP: usize = 8;

/// Motions that the outer frames are tried by where the middle ones agree. More costs time.
const AGREEING_MOTIONS: usize = 2;

/// The image at the instant: the warps' cross dissolve, refined where the warped frames disagree.
pub fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: &[Motion],
    options: &RefineOptions,
) -> Image {
    let warped = [warped(frames.earlier, warps[0]), warped(frames.later, warps[1])];
    let (w, h, channels) =
        (frames.earlier.width(), frames.earlier.height(), frames.earlier.channels());
    let dissolved = mixed(&warped[0], &warped[1], frames.share);
    let options = &scaled(options, w.max(h));
    let costs = box_mean(&difference(&warped[0], &warped[1]), w, h, options.window_radius_px);

    let neighbors = Neighbors::new(motions.iter().map(|m| m.at));
    let step = MIN_STEP.max(2 * options.window_radius_px);
    let work =
        Work { frames, motions, neighbors, dissolved: &dissolved, costs: &costs, options, step };
    // Block (bx, by) covers pixels from (bx − 1)·step to (bx + 1)·step.
    let (blocks_x, blocks_y) = (w.div_ceil(step) + 1, h.div_ceil(step) + 1);
    let blocks: Vec<Option<Vec<f32>>> = (0..blocks_x * blocks_y)
        .into_par_iter()
        .map(|k| work.block((k % blocks_x) as isize, (k / blocks_x) as isize))
        .collect();

    let mut data = dissolved.data().to_vec();
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let mut sum = [0.0; 3];
            for (bx, by) in covering(x, y, step) {
                let in_x = x + step - bx * step;
                let in_y = y + step - by * step;
                let weight = fade(in_x, step) * fade(in_y, step);
                let from = match &blocks[by * blocks_x + bx] {
                    Some(block) => &block[(in_y * 2 * step + in_x) * channels..][..channels],
                    None => dissolved.pixel(x, y),
                };
                for (sum, v) in sum.iter_mut().zip(from) {
                    *sum += weight * v;
                }
            }
            for (out, sum) in out.iter_mut().zip(sum) {
                *out = sum.clamp(0.0, 1.0);
            }
        }
    });
    Image::from_data(w, h, channels, data)
}

/// The options with their lengths as they are in an image of this size.
fn scaled(options: &RefineOptions, size_px: usize) -> RefineOptions {
    let scale = (size_px as f64 / RefineOptions::SIZE_PX).max(1.0);
    RefineOptions {
        window_radius_px: (options.window_radius_px as f64 * scale).round() as usize,
        search_radius_px: options.search_radius_px * scale,
        ..options.clone()
    }
}

/// The four blocks that a pixel lies in.
fn covering(x: usize, y: usize, step: usize) -> [(usize, usize); 4] {
    let (bx, by) = (x / step, y / step);
    [(bx, by), (bx + 1, by), (bx, by + 1), (bx + 1, by + 1)]
}

/// A block's weight at a pixel within it: a triangle, so that overlapping blocks' weights sum to 1.
fn fade(within: usize, step: usize) -> f32 {
    let d = (within as f32 + 0.5 - step as f32).abs() / step as f32;
    1.0 - d
}

struct Work<'a> {
    frames: &'a FourFrames<'a>,
    motions: &'a [Motion],
    neighbors: Neighbors,
    dissolved: &'a Image,
    /// The morph's: mean difference of the warped frames around each pixel.
    costs: &'a [f32],
    options: &'a RefineOptions,
    /// Between blocks, pixels.
    step: usize,
}

/// The weighted sum of a block's hypotheses, per pixel.
struct Sums {
    colors: Vec<f32>,
    weights: Vec<f32>,
}

impl Work<'_> {
    /// The refined block, row by row; `None` where nothing is near.
    fn block(&self, bx: isize, by: isize) -> Option<Vec<f32>> {
        let (w, h) = (self.dissolved.width(), self.dissolved.height());
        let channels = self.dissolved.channels();
        let (step, block) = (self.step as isize, 2 * self.step);
        let origin = [(bx - 1) * step, (by - 1) * step];
        let center = Point2::new((origin[0] + step) as f64, (origin[1] + step) as f64);
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
        if agree && self.outer_weight() <= 0.0 {
            return None;
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
        // The morph's own hypothesis.
        let radius = self.options.window_radius_px;
        let side = block + 2 * radius;
        let (own, costs) = self.morphed(origin, side);
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

    /// The morph's image and costs over a block with the windows around it; beyond the image's
    /// border its last pixels go on.
    fn morphed(&self, origin: [isize; 2], side: usize) -> (Image, Vec<f32>) {
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
            for (k, out) in patch.chunks_exact_mut(channels).enumerate() {
                let x = origin[0] - radius as isize + (k % side) as isize;
                let y = origin[1] - radius as isize + (k / side) as isize;
                let at = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let from = at - Vector2::new(origin[0] as f64, origin[1] as f64) - middle;
                let shift = motion.at(frame, from);
                image.sample_cubic((at.x + shift.x) as f32, (at.y + shift.y) as f32, out);
            }
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
        let full = self.outer_weight();
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

    /// How much the outer frames count at most: 0 at a frame, most halfway between two.
    fn outer_weight(&self) -> f32 {
        let share = self.frames.share;
        self.options.outer_share * 4.0 * share * (1.0 - share)
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

/// Twice the least share of the interval that is told from a frame.
const MIN_SHARE: f32 = 1e-3;

/// Keeps a sum of weights from being 0 where every hypothesis is far off.
const MIN_WEIGHT: f32 = 1e-30;

impl Sums {
    fn add(&mut self, k: usize, weight: f32, color: &[f32]) {
        self.weights[k] += weight;
        let at = k * color.len();
        for (sum, c) in self.colors[at..].iter_mut().zip(color) {
            *sum += weight * c;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const W: usize = 96;
    const H: usize = 64;

    fn texture(x: f32, y: f32, seed: f32) -> f32 {
        0.5 + 0.2 * (x * 0.9 + seed).sin() * (y * 0.7).cos()
            + 0.2 * (x * 0.31 - y * 0.53 + seed).sin()
    }

    /// A textured square that moves right by 6 px a frame over a still textured wall.
    fn scene(frame: f32) -> Image {
        let left = 30.0 + 6.0 * frame;
        let data = (0..W * H)
            .map(|k| {
                let (x, y) = ((k % W) as f32 + 0.5, (k / W) as f32 + 0.5);
                if x >= left && x < left + 30.0 && (18.0..46.0).contains(&y) {
                    texture(x - left, y, 3.0)
                } else {
                    0.6 * texture(x, y, 0.0)
                }
            })
            .collect();
        Image::from_data(W, H, 1, data)
    }

    fn motions() -> Vec<Motion> {
        let mut all = Vec::new();
        for y in (2..H).step_by(5) {
            for x in (2..W).step_by(5) {
                let on_square = (35..62).contains(&x) && (20..44).contains(&y);
                let step = if on_square { 6.0 } else { 0.0 };
                let to = [-1.5, -0.5, 0.5, 1.5].map(|t| Vector2::new(step * t, 0.0));
                all.push(Motion { at: Point2::new(x as f64 + 0.5, y as f64 + 0.5), to });
            }
        }
        all
    }

    fn error(image: &Image, truth: &Image) -> f64 {
        let sum: f64 =
            (image.data().iter().zip(truth.data())).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        -10.0 * (sum / (W * H) as f64).log10()
    }

    #[test]
    fn outlines_come_out_right_where_a_dissolve_shows_both() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let truth = scene(0.5);
        let four = FourFrames {
            before: Some(&frames[0]),
            earlier: &frames[1],
            later: &frames[2],
            after: Some(&frames[3]),
            share: 0.5,
        };
        let still = Warp::identity(W, H);
        let options = RefineOptions::default();
        let result = refined(&four, [&still, &still], &motions(), &options);
        let dissolved = refined(&four, [&still, &still], &[], &options);
        let (before, after) = (error(&dissolved, &truth), error(&result, &truth));
        assert!(after > before + 8.0, "{before} {after}");
    }

    /// No track tells how the square moves; the wall that the later frame sees where it stood is not
    /// shown yet.
    #[test]
    fn near_a_frame_what_only_the_other_sees_is_not_shown() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let four = FourFrames {
            before: Some(&frames[0]),
            earlier: &frames[1],
            later: &frames[2],
            after: Some(&frames[3]),
            share: 0.05,
        };
        let still: Vec<Motion> =
            motions().iter().map(|m| Motion { to: [Vector2::zeros(); 4], ..*m }).collect();
        let warp = Warp::identity(W, H);
        let result = refined(&four, [&warp, &warp], &still, &RefineOptions::default());
        let found = error(&result, &frames[1]);
        assert!(found > 35.0, "{found}");
    }

    #[test]
    fn where_the_frames_agree_nothing_changes() {
        let frame = scene(0.0);
        let four =
            FourFrames { before: None, earlier: &frame, later: &frame, after: None, share: 0.3 };
        let still = Warp::identity(W, H);
        let result = refined(&four, [&still, &still], &motions(), &RefineOptions::default());
        let worst = (result.data().iter().zip(frame.data())).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f32::max) < 1e-6);
    }

    #[test]
    fn four_frames_have_less_noise_than_two_and_a_frame_stays_as_filmed() {
        let clean = scene(0.0);
        let mut random = Random::new(1);
        let mut noisy = || {
            let data = clean.data().iter().map(|v| v + 0.03 * random.signed() as f32).collect();
            Image::from_data(W, H, 1, data)
        };
        let frames = [noisy(), noisy(), noisy(), noisy()];
        let still: Vec<Motion> =
            motions().iter().map(|m| Motion { to: [Vector2::zeros(); 4], ..*m }).collect();
        let warp = Warp::identity(W, H);
        let at = |share: f32, outer_share: f32| {
            let four = FourFrames {
                before: Some(&frames[0]),
                earlier: &frames[1],
                later: &frames[2],
                after: Some(&frames[3]),
                share,
            };
            let options = RefineOptions { outer_share, ..RefineOptions::default() };
            refined(&four, [&warp, &warp], &still, &options)
        };
        let (two, four) = (error(&at(0.5, 0.0), &clean), error(&at(0.5, 1.0), &clean));
        assert!(four > two + 2.0, "{two} {four}");
        for outer_share in [0.0, 1.0] {
            assert!(error(&at(0.0, outer_share), &frames[1]) > 90.0);
        }
    }

    #[test]
    fn the_fades_of_overlapping_blocks_sum_to_one() {
        for (step, x) in [8, 13, 51].into_iter().flat_map(|s| (0..3 * s).map(move |x| (s, x))) {
            let sum: f32 = covering(x, x, step)
                .iter()
                .map(|(bx, by)| fade(x + step - bx * step, step) * fade(x + step - by * step, step))
                .sum();
            assert!((sum - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn tiny_images_are_no_trouble() {
        for (w, h) in [(1, 1), (3, 17), (16, 2)] {
            let (a, b) = (Image::filled(w, h, 3, 0.1), Image::filled(w, h, 3, 0.9));
            let four = FourFrames {
                before: Some(&a),
                earlier: &a,
                later: &b,
                after: Some(&b),
                share: 0.5,
            };
            let still = Warp::identity(w, h);
            let result = refined(&four, [&still, &still], &motions(), &RefineOptions::default());
            assert!(result.data().iter().all(|v| v.is_finite()));
        }
    }
}
