//! Beyond the paper: where the two warped frames disagree, per-pixel motion and visibility; where the
//! frames before and after agree too, their mean, which has less noise. Where nothing moves, that
//! is all that is done.
//!
//! Beside a moving outline the warp mixes the motions on both sides, and the cross dissolve mixes
//! a frame that sees the background with one that doesn't. There, blocks of pixels try the motions
//! of the tracks around them, each under three hypotheses: both frames see the point (then they
//! agree with each other), only the earlier does (then it agrees with the frame before it), or
//! only the later (then it agrees with the frame after it; the nearer the instant is to a frame, the
//! less likely only the other sees the point). Every pixel is the mean of all of
//! these and of the warp's dissolve, weighted by how well each agrees over a small window. Blocks overlap
//! and fade into each other, so that none has a border.
//!
//! Known limits: what is seen in none of the four frames is not found; a window of a few pixels
//! decides, so outlines are right to about two pixels.

mod block;
mod rest;

use super::warp::{Warp, warped};
use super::windows::{box_mean, difference, mixed};
use super::{Motion, RefineOptions};
use crate::raster::{Image, Tiles};
use crate::registration::Neighbors;
use block::Work;
use rayon::prelude::*;

/// The frames around an instant, and where it lies between the middle two.
pub struct FourFrames<'a> {
    pub before: Option<&'a Image>,
    pub earlier: &'a Image,
    pub later: &'a Image,
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt, 0 at the earlier frame.
    pub share: f32,
    /// What of the image is asked for, if not all: tiles of its size. The rest is not refined.
    pub parts: Option<&'a Tiles>,
}

/// Blocks stand this far apart, pixels, and are twice as large: or as far as twice a window's radius,
/// where that is more: from 640 pixels on they grow with the image, as what they show and the windows
/// around them do, which would soon cost more than the blocks. Larger: one motion for pixels that move
/// differently; smaller: more blocks to try.
const MIN_STEP: usize = 8;

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
    let cost = |a: &Image, b: &Image| box_mean(&difference(a, b), w, h, options.window_radius_px);
    let costs = cost(&warped[0], &warped[1]);
    let outer_counts = outer_weight(frames, options) > 0.0;
    let outer_costs = [frames.before, frames.after]
        .map(|f| f.filter(|_| outer_counts).map(|f| cost(f, &dissolved)));

    let neighbors = Neighbors::new(motions.iter().map(|m| m.at));
    let step = MIN_STEP.max(2 * options.window_radius_px);
    let work = Work {
        frames,
        motions,
        neighbors,
        dissolved: &dissolved,
        costs: &costs,
        outer_costs,
        options,
        step,
    };
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

/// How much the outer frames count at most: 0 at a frame, most halfway between two.
fn outer_weight(frames: &FourFrames, options: &RefineOptions) -> f32 {
    options.outer_share * 4.0 * frames.share * (1.0 - frames.share)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use nalgebra::{Point2, Vector2};

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

    /// The same, all at rest.
    fn at_rest() -> Vec<Motion> {
        motions().into_iter().map(|m| Motion { to: [Vector2::zeros(); 4], ..m }).collect()
    }

    fn around(frames: &[Image; 4], share: f32) -> FourFrames<'_> {
        let [before, earlier, later, after] = frames;
        let parts = None;
        FourFrames { before: Some(before), earlier, later, after: Some(after), share, parts }
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
        let four = around(&frames, 0.5);
        let still = Warp::identity(W, H);
        let options = RefineOptions::default();
        let result = refined(&four, [&still, &still], &motions(), &options);
        let dissolved = refined(&four, [&still, &still], &[], &options);
        let (before, after) = (error(&dissolved, &truth), error(&result, &truth));
        assert!(after > before + 8.0, "{before} {after}");
    }

    fn noisy(image: &Image, amplitude: f32, random: &mut Random) -> Image {
        let noise = |v: &f32| v + amplitude * random.signed() as f32;
        let data = image.data().iter().map(noise).collect();
        Image::from_data(W, H, 1, data)
    }

    /// Four frames of a still scene have half of two frames' noise; without tracks too.
    #[test]
    fn what_stands_still_is_averaged() {
        let mut random = Random::new(3);
        let truth = scene(0.0);
        let frames = [0; 4].map(|_| noisy(&truth, 0.02, &mut random));
        let still = Warp::identity(W, H);
        let options = RefineOptions::default();
        let of = |options: &RefineOptions| {
            error(&refined(&around(&frames, 0.5), [&still, &still], &[], options), &truth)
        };
        let two = of(&RefineOptions { outer_share: 0.0, ..options.clone() });
        let four = of(&options);
        assert!((2.7..3.3).contains(&(four - two)), "{two} {four}");
    }

    /// Averaged along its path, or in place where that is hardly another.
    #[test]
    fn what_moves_slowly_is_not_blurred() {
        for (step, least_db) in [(0.02, 50.0), (0.08, 45.0), (0.33, 45.0)] {
            let db = panned(step);
            assert!(db > least_db, "{step} px: {db}");
        }
    }

    fn panned(step: f32) -> f64 {
        let pan = |frame: f32| {
            let place = |k: usize| ((k % W) as f32 + 0.5 - step * frame, (k / W) as f32 + 0.5);
            let value = |k| texture(place(k).0, place(k).1, 1.0);
            Image::from_data(W, H, 1, (0..W * H).map(value).collect())
        };
        let frames = [-1.0, 0.0, 1.0, 2.0].map(pan);
        let warp = |to: f32| Warp {
            source: Warp::identity(W, H).source.iter().map(|[x, y]| [x + to, *y]).collect(),
            ..Warp::identity(W, H)
        };
        let (from_earlier, from_later) = (warp(-0.5 * step), warp(0.5 * step));
        let mut slow = at_rest();
        for motion in &mut slow {
            motion.to = [-1.5, -0.5, 0.5, 1.5].map(|t| Vector2::new(f64::from(step) * t, 0.0));
        }
        let result = refined(
            &around(&frames, 0.5),
            [&from_earlier, &from_later],
            &slow,
            &RefineOptions::default(),
        );
        error(&result, &pan(0.5))
    }

    /// No track tells how the square moves; the wall that the later frame sees where it stood is not
    /// shown yet.
    #[test]
    fn near_a_frame_what_only_the_other_sees_is_not_shown() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let four = around(&frames, 0.05);
        let still = at_rest();
        let warp = Warp::identity(W, H);
        let result = refined(&four, [&warp, &warp], &still, &RefineOptions::default());
        let found = error(&result, &frames[1]);
        assert!(found > 35.0, "{found}");
    }

    #[test]
    fn where_the_frames_agree_nothing_changes() {
        let frame = scene(0.0);
        let (before, after, parts) = (None, None, None);
        let four = FourFrames { before, earlier: &frame, later: &frame, after, share: 0.3, parts };
        let still = Warp::identity(W, H);
        let result = refined(&four, [&still, &still], &motions(), &RefineOptions::default());
        let worst = (result.data().iter().zip(frame.data())).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f32::max) < 1e-6);
    }

    #[test]
    fn four_frames_have_less_noise_than_two_and_a_frame_stays_as_filmed() {
        let clean = scene(0.0);
        let mut random = Random::new(1);
        let frames = [0; 4].map(|_| noisy(&clean, 0.03, &mut random));
        let still = at_rest();
        let warp = Warp::identity(W, H);
        let at = |share: f32, outer_share: f32| {
            let four = around(&frames, share);
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

    /// In the tiles that are asked for, to the bit.
    #[test]
    fn parts_are_what_the_whole_is_there() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let still = Warp::identity(W, H);
        let of = |parts: Option<&Tiles>| {
            let four = FourFrames { parts, ..around(&frames, 0.5) };
            refined(&four, [&still, &still], &motions(), &RefineOptions::default())
        };
        let whole = of(None);
        let mut parts = Tiles::none(W, H);
        parts.mark_sample(29.0, 20.0);
        parts.mark_sample(70.0, 46.0);
        let some = of(Some(&parts));
        let same = |k: usize| some.data()[k] == whole.data()[k];
        let asked = |k: usize| parts.touches([(k % W) as isize, (k / W) as isize], 1);
        assert!((0..W * H).filter(|k| asked(*k)).all(same));
        assert!(!(0..W * H).all(same));
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
                parts: None,
            };
            let still = Warp::identity(w, h);
            let result = refined(&four, [&still, &still], &motions(), &RefineOptions::default());
            assert!(result.data().iter().all(|v| v.is_finite()));
        }
    }
}
