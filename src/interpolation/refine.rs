//! Beyond the paper: where the two warped frames of a morph disagree, per-pixel motion and
//! visibility.
//!
//! Beside a moving outline the morph mixes the motions on both sides, and the cross dissolve mixes
//! a frame that sees the background with one that doesn't. There, blocks of pixels try the motions
//! of the tracks around them, each under three hypotheses: both frames see the point (then they
//! agree with each other), only the earlier does (then it agrees with the frame before it), or
//! only the later (then it agrees with the frame after it). Every pixel is the mean of all of
//! these and of the morph, weighted by how well each agrees over a small window. Blocks overlap
//! and fade into each other, so that none has a border.
//!
//! Known limits: what is seen in none of the four frames is not found; a window of a few pixels
//! decides, so outlines are right to about two pixels.

use super::{RefineOptions, Warp};
use crate::raster::Image;
use crate::registration::Neighbors;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// A track at the instant, and the displacements from there to where it is in the four frames:
/// before, earlier, later, after. Pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pub at: Point2<f64>,
    pub to: [Vector2<f64>; 4],
}

/// The frames around an instant, and where it lies between the middle two.
pub struct FourFrames<'a> {
    pub before: Option<&'a Image>,
    pub earlier: &'a Image,
    pub later: &'a Image,
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt, 0 at the earlier frame.
    pub share: f32,
}

/// Blocks stand this far apart, pixels, and are twice as large. Larger: one motion for pixels that
/// move differently; smaller: more blocks to try.
const STEP: usize = 8;
const BLOCK: usize = 2 * STEP;

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
    let dissolved: Vec<f32> = (warped[0].data().iter().zip(warped[1].data()))
        .map(|(a, b)| a + (b - a) * frames.share)
        .collect();
    let dissolved = Image::from_data(w, h, channels, dissolved);
    let costs = box_mean(&difference(&warped[0], &warped[1]), w, h, options.window_radius_px);

    let neighbors = Neighbors::new(motions.iter().map(|m| m.at));
    let work = Work { frames, motions, neighbors, dissolved: &dissolved, costs: &costs, options };
    // Block (bx, by) covers pixels from (bx − 1)·STEP to (bx + 1)·STEP.
    let (blocks_x, blocks_y) = (w.div_ceil(STEP) + 1, h.div_ceil(STEP) + 1);
    let blocks: Vec<Option<Vec<f32>>> = (0..blocks_x * blocks_y)
        .into_par_iter()
        .map(|k| work.block((k % blocks_x) as isize, (k / blocks_x) as isize))
        .collect();

    let mut data = dissolved.data().to_vec();
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let mut sum = [0.0; 3];
            for (bx, by) in covering(x, y) {
                let in_x = x + STEP - bx * STEP;
                let in_y = y + STEP - by * STEP;
                let weight = fade(in_x) * fade(in_y);
                let from = match &blocks[by * blocks_x + bx] {
                    Some(block) => &block[(in_y * BLOCK + in_x) * channels..][..channels],
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

/// The four blocks that a pixel lies in.
fn covering(x: usize, y: usize) -> [(usize, usize); 4] {
    let (bx, by) = (x / STEP, y / STEP);
    [(bx, by), (bx + 1, by), (bx, by + 1), (bx + 1, by + 1)]
}

/// A block's weight at a pixel within it: a triangle, so that overlapping blocks' weights sum to 1.
fn fade(within: usize) -> f32 {
    let d = (within as f32 + 0.5 - STEP as f32).abs() / STEP as f32;
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
}

/// The weighted sum of a block's hypotheses, per pixel.
struct Sums {
    colors: Vec<f32>,
    weights: Vec<f32>,
}

impl Work<'_> {
    /// The refined block, row by row; `None` where the warped frames agree, or nothing is near.
    fn block(&self, bx: isize, by: isize) -> Option<Vec<f32>> {
        let (w, h) = (self.dissolved.width(), self.dissolved.height());
        let channels = self.dissolved.channels();
        let origin = [(bx - 1) * STEP as isize, (by - 1) * STEP as isize];
        let pixel = |x: usize, y: usize| {
            let (x, y) = (origin[0] + x as isize, origin[1] + y as isize);
            let inside = x >= 0 && y >= 0 && (x as usize) < w && (y as usize) < h;
            inside.then_some((x as usize, y as usize))
        };
        let places = || (0..BLOCK).flat_map(|y| (0..BLOCK).map(move |x| (x, y)));
        let worst = places()
            .filter_map(|(x, y)| pixel(x, y))
            .map(|(x, y)| self.costs[y * w + x])
            .fold(0.0, f32::max);
        if worst <= self.options.min_difference {
            return None;
        }
        let center =
            Point2::new((origin[0] + STEP as isize) as f64, (origin[1] + STEP as isize) as f64);
        let candidates = self.candidates(&center);
        if candidates.is_empty() {
            return None;
        }
        let mut sums =
            Sums { colors: vec![0.0; BLOCK * BLOCK * channels], weights: vec![0.0; BLOCK * BLOCK] };
        for (k, (x, y)) in places().enumerate() {
            if let Some((x, y)) = pixel(x, y) {
                let cost = self.costs[y * w + x];
                sums.add(k, self.weight(cost), self.dissolved.pixel(x, y));
            }
        }
        for candidate in &candidates {
            self.try_motion(candidate, origin, &mut sums);
        }
        for (color, &weight) in sums.colors.chunks_exact_mut(channels).zip(&sums.weights) {
            // Outside the image nothing was added; inside, the weights are at least MIN_WEIGHT.
            if weight > 0.0 {
                color.iter_mut().for_each(|c| *c /= weight);
            }
        }
        Some(sums.colors)
    }

    fn weight(&self, cost: f32) -> f32 {
        (-cost / self.options.softness).exp().max(MIN_WEIGHT)
    }

    /// The motions around a place, nearest first: each the mean of the tracks that move alike,
    /// weighted by nearness.
    fn candidates(&self, center: &Point2<f64>) -> Vec<[Vector2<f64>; 4]> {
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
            let (mut sum, mut total) = ([Vector2::zeros(); 4], 0.0);
            let mut members = 0;
            for k in seed..near.len() {
                let other = &self.motions[near[k]].to;
                // Between the middle frames, whose tracks are the surest.
                let apart = ((other[2] - other[1]) - (own[2] - own[1])).norm();
                if taken[k] || apart > self.options.same_motion_px {
                    continue;
                }
                taken[k] = true;
                members += 1;
                let weight = 1.0 / (1.0 + distance(near[k])).powi(4);
                for (sum, to) in sum.iter_mut().zip(other) {
                    *sum += to * weight;
                }
                total += weight;
            }
            if members >= self.options.min_tracks {
                candidates.push(sum.map(|s| s / total));
            }
        }
        candidates
    }

    /// Adds a motion under its three hypotheses.
    fn try_motion(&self, to: &[Vector2<f64>; 4], origin: [isize; 2], sums: &mut Sums) {
        let radius = self.options.window_radius_px;
        let side = BLOCK + 2 * radius;
        let channels = self.dissolved.channels();
        let cut = |image: &Image, shift: &Vector2<f64>| {
            let mut patch = vec![0.0; side * side * channels];
            for (k, out) in patch.chunks_exact_mut(channels).enumerate() {
                let x = origin[0] - radius as isize + (k % side) as isize;
                let y = origin[1] - radius as isize + (k / side) as isize;
                let (x, y) = (x as f32 + 0.5 + shift.x as f32, y as f32 + 0.5 + shift.y as f32);
                image.sample_bilinear(x, y, out);
            }
            Image::from_data(side, side, channels, patch)
        };
        let earlier = cut(self.frames.earlier, &to[1]);
        let later = cut(self.frames.later, &to[2]);
        let cost = |a: &Image, b: &Image| box_mean(&difference(a, b), side, side, radius);
        let both = cost(&earlier, &later);
        let only_earlier = self.frames.before.map(|f| cost(&cut(f, &to[0]), &earlier));
        let only_later = self.frames.after.map(|f| cost(&later, &cut(f, &to[3])));
        let share = self.frames.share;
        let mut mixed = [0.0; 3];
        for k in 0..BLOCK * BLOCK {
            let (x, y) = (k % BLOCK + radius, k / BLOCK + radius);
            let at = y * side + x;
            let (a, b) = (earlier.pixel(x, y), later.pixel(x, y));
            for (out, (a, b)) in mixed.iter_mut().zip(a.iter().zip(b)) {
                *out = a + (b - a) * share;
            }
            sums.add(k, self.weight(both[at]), &mixed[..channels]);
            for (costs, color) in [(&only_earlier, a), (&only_later, b)] {
                if let Some(costs) = costs {
                    let cost = costs[at] + self.options.one_frame_cost;
                    sums.add(k, self.weight(cost), color);
                }
            }
        }
    }
}

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

fn warped(image: &Image, warp: &Warp) -> Image {
    let channels = image.channels();
    let mut data = vec![0.0; warp.source.len() * channels];
    data.par_chunks_mut(warp.width * channels).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let [sx, sy] = warp.source[y * warp.width + x];
            image.sample_cubic(sx, sy, out);
        }
    });
    Image::from_data(warp.width, warp.height, channels, data)
}

/// Mean absolute difference of the channels, a pixel.
fn difference(a: &Image, b: &Image) -> Vec<f32> {
    let channels = a.channels();
    (a.data().chunks_exact(channels).zip(b.data().chunks_exact(channels)))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / channels as f32)
        .collect()
}

/// Mean over a (2·radius + 1)² window, of what of it lies inside.
fn box_mean(values: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    let span = |at: usize, size: usize| at.saturating_sub(radius)..(at + radius + 1).min(size);
    let mut across = vec![0.0; values.len()];
    for y in 0..h {
        let row = &values[y * w..(y + 1) * w];
        for x in 0..w {
            let range = span(x, w);
            let n = range.len() as f32;
            across[y * w + x] = row[range].iter().sum::<f32>() / n;
        }
    }
    let mut out = vec![0.0; values.len()];
    for y in 0..h {
        let range = span(y, h);
        let n = range.len() as f32;
        for from in range {
            for (out, v) in out[y * w..(y + 1) * w].iter_mut().zip(&across[from * w..]) {
                *out += v / n;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn the_fades_of_overlapping_blocks_sum_to_one() {
        for x in 0..50 {
            let sum: f32 = covering(x, x)
                .iter()
                .map(|(bx, by)| fade(x + STEP - bx * STEP) * fade(x + STEP - by * STEP))
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
