//! Beyond the paper: motion and visibility per pixel where the two warped frames disagree, and the mean of
//! four frames, which has less noise, where they agree.
//!
//! Beside a moving outline the warp interpolates between the motions on both sides, and the cross dissolve
//! mixes a frame that shows the background with one that does not. There, blocks of pixels try the
//! motions of the tracks around them, each under three hypotheses. Either both frames see the point, and
//! agree with each other. Or only the earlier does, and agrees with the frame before it. Or only the
//! later does, and agrees with the frame after it. The nearer the instant is to a frame, the less likely
//! it is that only the other sees the point. A hypothesis costs more where another motion explains its pixels
//! better. Otherwise two similar bodies, at one place in successive frames, are matched to each other. Every pixel is the mean of all hypotheses and of the warped
//! frames' cross-fade, weighted by agreement over a small window. Blocks overlap and fade into each other,
//! so that their borders do not show. Static blocks are the mean of the four frames. Each pixel's motion and
//! its cost are the same weighted means.
//!
//! Known limits: a surface that none of the four frames shows is not found. One that a single frame shows can't
//! be verified. Outlines are accurate to about two
//! pixels, because a window of a few pixels decides.

mod best_costs;
mod block;
mod candidates;
mod four_frames;
mod static_block;

use super::warp::{Warp, warped};
use super::windows::{cross_fade, difference};
use super::{Motion, RefineOptions};
use crate::raster::{Image, box_filter};
use best_costs::BestCosts;
use block::{BlockRefiner, RefinedBlock};
use candidates::Candidates;
pub use four_frames::FourFrames;
use rayon::prelude::*;

/// Minimum distance between blocks, pixels; a block's side is twice the distance. The distance is at least
/// twice a window's radius, and so grows with images beyond 640 pixels. Larger: one motion for pixels that
/// move differently; smaller: more blocks, which costs time.
const MIN_STEP: usize = 8;

/// How a pixel moves, by the hypotheses that it is the mean of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelMotion {
    /// Between the earlier and the later frame, pixels.
    pub motion_px: f32,
    /// The change of the motion from one frame to the next, pixels per frame: the larger of those at the two
    /// frames. 0 where it is not known.
    pub change_px: f32,
    /// The hypotheses' cost: the mean difference of the frames over a window, 0..=1, and what counts against a
    /// hypothesis besides; at rest at least the warped frames' difference. 0 if the frames agree.
    pub cost: f32,
}

impl PixelMotion {
    fn times(self, weight: f32) -> Self {
        let Self { motion_px, change_px, cost } = self;
        Self { motion_px: weight * motion_px, change_px: weight * change_px, cost: weight * cost }
    }

    fn add(&mut self, weight: f32, other: Self) {
        self.motion_px += weight * other.motion_px;
        self.change_px += weight * other.change_px;
        self.cost += weight * other.cost;
    }
}

/// The image at the instant: the cross dissolve of the two warped frames, refined where they disagree, and
/// averaged with the outer frames where these agree. Values are in 0..=1.
///
/// `warps` take the earlier and the later frame to the instant; they have the frames' size. `motions` are those
/// of the tracks at the instant. Without motions, only static blocks are averaged. Beside the image, how each
/// pixel moves, row by row, if that is wanted.
pub fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: &[Motion],
    options: &RefineOptions,
) -> (Image, Option<Vec<PixelMotion>>) {
    let (w, h) = (frames.earlier.width(), frames.earlier.height());
    let options = &scaled(options, w.max(h));
    let step = MIN_STEP.max(2 * options.window_radius_px);
    // A block that touches what is needed, the windows around its pixels, and the windows of their costs.
    let near = frames.parts.map(|parts| parts.grown(2 * step + 2 * options.window_radius_px));
    let warped = [(frames.earlier, warps[0]), (frames.later, warps[1])]
        .map(|(image, warp)| warped(image, warp, near.as_ref()));
    let cross_faded = cross_fade(&warped[0], &warped[1], frames.fraction);
    let cost = |a: &Image, b: &Image| box_filter(&difference(a, b), w, h, options.window_radius_px);
    let costs = cost(&warped[0], &warped[1]);
    let outer_counts = frames.outer_weight(options) > 0.0;
    let outer_costs = [frames.before, frames.after]
        .map(|f| f.filter(|_| outer_counts).map(|f| cost(f, &cross_faded)));

    let motion_px = motion_px(warps);
    let best_costs = [
        BestCosts::new(
            (1, frames.earlier),
            [(0, frames.before), (2, Some(frames.later))],
            motions,
            options,
        ),
        BestCosts::new(
            (2, frames.later),
            [(1, Some(frames.earlier)), (3, frames.after)],
            motions,
            options,
        ),
    ];
    let refiner = BlockRefiner {
        frames,
        candidates: Candidates::new(motions.to_vec(), options),
        best_costs,
        cross_faded: &cross_faded,
        costs: &costs,
        motion_px: &motion_px,
        outer_costs,
        options,
        step,
    };
    // Block (bx, by) covers pixels from (bx − 1)·step to (bx + 1)·step.
    let (blocks_x, blocks_y) = (w.div_ceil(step) + 1, h.div_ceil(step) + 1);
    let blocks: Vec<Option<RefinedBlock>> = (0..blocks_x * blocks_y)
        .into_par_iter()
        .map(|k| refiner.refine((k % blocks_x) as isize, (k / blocks_x) as isize))
        .collect();

    let pixel_motion = |(&motion_px, cost)| PixelMotion { motion_px, change_px: 0.0, cost };
    let motions = frames.with_motions.then(|| {
        let motions = motion_px.iter().zip(costs).map(pixel_motion).collect();
        blended_motions(motions, w, &blocks, step)
    });
    (blended(&cross_faded, &blocks, step), motions)
}

/// The distance of the places that each pixel comes from in the two frames, row by row.
pub(super) fn motion_px(warps: [&Warp; 2]) -> Vec<f32> {
    let places = warps[0].source.iter().zip(&warps[1].source);
    places.map(|([ax, ay], [bx, by])| (ax - bx).hypot(ay - by)).collect()
}

/// The blocks, which fade into each other, and the cross-faded frames where there is none.
fn blended(cross_faded: &Image, blocks: &[Option<RefinedBlock>], step: usize) -> Image {
    let (w, h, channels) = (cross_faded.width(), cross_faded.height(), cross_faded.channels());
    let mut data = cross_faded.data().to_vec();
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let mut sum = [0.0; 3];
            for (block, within, weight) in covering(x, y, w, step) {
                let from = match &blocks[block] {
                    Some(block) => &block.colors[within * channels..][..channels],
                    None => cross_faded.pixel(x, y),
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

/// The same of how pixels move, in an image that is `w` wide; `motions` are those of the warped frames.
fn blended_motions(
    mut motions: Vec<PixelMotion>,
    w: usize,
    blocks: &[Option<RefinedBlock>],
    step: usize,
) -> Vec<PixelMotion> {
    motions.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let mut sum = PixelMotion::default();
            for (block, within, weight) in covering(x, y, w, step) {
                let block = blocks[block].as_ref().and_then(|block| block.motions.as_deref());
                sum.add(weight, block.map_or(*out, |motions| motions[within]));
            }
            *out = sum;
        }
    });
    motions
}

/// The options with their lengths scaled to an image whose longer side is `size_px`.
fn scaled(options: &RefineOptions, size_px: usize) -> RefineOptions {
    let scale = (size_px as f64 / RefineOptions::SIZE_PX).max(1.0);
    RefineOptions {
        window_radius_px: (options.window_radius_px as f64 * scale).round() as usize,
        search_radius_px: options.search_radius_px * scale,
        ..options.clone()
    }
}

/// The four blocks that a pixel is in, the pixel's index in each, and each one's weight there, in an image that is
/// `w` wide.
fn covering(x: usize, y: usize, w: usize, step: usize) -> [(usize, usize, f32); 4] {
    let (bx, by, across) = (x / step, y / step, w.div_ceil(step) + 1);
    [(bx, by), (bx + 1, by), (bx, by + 1), (bx + 1, by + 1)].map(|(bx, by)| {
        let (in_x, in_y) = (x + step - bx * step, y + step - by * step);
        (by * across + bx, in_y * 2 * step + in_x, fade(in_x, step) * fade(in_y, step))
    })
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
    use crate::raster::Tiles;
    use nalgebra::{Matrix2, Point2, Vector2};

    const W: usize = 96;
    const H: usize = 64;

    fn texture(x: f32, y: f32, seed: f32) -> f32 {
        0.5 + 0.2 * (x * 0.9 + seed).sin() * (y * 0.7).cos()
            + 0.2 * (x * 0.31 - y * 0.53 + seed).sin()
    }

    /// A textured square that moves right by 6 px per frame in front of a static textured wall.
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
                let at = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
                all.push(Motion { at, to, deformation: Matrix2::identity() });
            }
        }
        all
    }

    /// The same tracks without motion.
    fn at_rest() -> Vec<Motion> {
        motions().into_iter().map(|m| Motion { to: [Vector2::zeros(); 4], ..m }).collect()
    }

    fn around(frames: &[Image; 4], fraction: f32) -> FourFrames<'_> {
        let [before, earlier, later, after] = frames;
        let parts = None;
        let with_motions = true;
        FourFrames {
            before: Some(before),
            earlier,
            later,
            after: Some(after),
            fraction,
            parts,
            with_motions,
        }
    }

    fn psnr(image: &Image, truth: &Image) -> f64 {
        let sum: f64 =
            (image.data().iter().zip(truth.data())).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        -10.0 * (sum / (W * H) as f64).log10()
    }

    #[test]
    fn outlines_are_right_where_a_cross_fade_shows_both_frames() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let truth = scene(0.5);
        let four = around(&frames, 0.5);
        let still = Warp::identity(W, H);
        let options = RefineOptions::default();
        let (result, _) = refined(&four, [&still, &still], &motions(), &options);
        let (cross_faded, _) = refined(&four, [&still, &still], &[], &options);
        let (before, after) = (psnr(&cross_faded, &truth), psnr(&result, &truth));
        assert!(after > before + 8.0, "{before} {after}");
    }

    fn noisy(image: &Image, amplitude: f32, random: &mut Random) -> Image {
        let noise = |v: &f32| v + amplitude * random.signed() as f32;
        let data = image.data().iter().map(noise).collect();
        Image::from_data(W, H, 1, data)
    }

    /// Four frames of a static scene have half of two frames' noise variance, without tracks too.
    #[test]
    fn static_scenes_are_averaged() {
        let mut random = Random::new(3);
        let truth = scene(0.0);
        let frames = [0; 4].map(|_| noisy(&truth, 0.02, &mut random));
        let still = Warp::identity(W, H);
        let options = RefineOptions::default();
        let of = |options: &RefineOptions| {
            psnr(&refined(&around(&frames, 0.5), [&still, &still], &[], options).0, &truth)
        };
        let two = of(&RefineOptions { outer_share: 0.0, ..options.clone() });
        let four = of(&options);
        assert!((2.7..3.3).contains(&(four - two)), "{two} {four}");
    }

    /// Two dark wagons, in front of a light wall that only a gap of 8 px between them shows, move right by 8 px
    /// per frame.
    fn train(frame: f32) -> Image {
        let left = 12.0 + 8.0 * frame;
        let value = |k: usize| {
            let (x, y) = ((k % W) as f32 + 0.5 - left, (k / W) as f32 + 0.5);
            let on_wagon = (0.0..28.0).contains(&x) || (36.0..64.0).contains(&x);
            let wagon = on_wagon && (14.0..50.0).contains(&y);
            if wagon { 0.2 * texture(x, y, 3.0) } else { 0.25 + 0.9 * texture(x + left, y, 0.0) }
        };
        Image::from_data(W, H, 1, (0..W * H).map(value).collect())
    }

    fn motions_of_train() -> Vec<Motion> {
        let still = at_rest().into_iter().filter(|m| !(12.0..52.0).contains(&m.at.y));
        let left = 12.0 + 4.0;
        let on_wagons = at_rest().into_iter().filter(|m| {
            let x = m.at.x - left;
            let on_wagon = (3.0..25.0).contains(&x) || (39.0..61.0).contains(&x);
            on_wagon && (17.0..47.0).contains(&m.at.y)
        });
        let moving = on_wagons
            .map(|m| Motion { to: [-12.0, -4.0, 4.0, 12.0].map(|x| Vector2::new(x, 0.0)), ..m });
        still.chain(moving).collect()
    }

    /// At rest, the gap's place is dark in both frames: another wagon in each.
    #[test]
    fn what_other_motions_explain_does_not_fill_a_gap() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(train);
        let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
        let motions = motions_of_train();
        let (result, _) = refined(&four, [&still, &still], &motions, &RefineOptions::default());
        let gap = || (20..44).flat_map(|y| (46..51).map(move |x| (x, y)));
        let darkest = gap().map(|(x, y)| result.pixel(x, y)[0]).fold(1.0, f32::min);
        // The wall is 0.37 or more there.
        assert!(darkest > 0.3, "{darkest}");
    }

    #[test]
    fn pixels_move_as_their_tracks_and_cost_more_without() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
        let options = RefineOptions::default();
        let (_, followed) = refined(&four, [&still, &still], &motions(), &options);
        let (_, lost) = refined(&four, [&still, &still], &at_rest(), &options);
        let at = |motions: &Option<Vec<PixelMotion>>, x: usize, y: usize| {
            motions.as_ref().unwrap()[y * W + x]
        };
        for (x, y) in [(40, 25), (48, 32), (55, 38)] {
            let (followed, lost) = (at(&followed, x, y), at(&lost, x, y));
            assert!((followed.motion_px - 6.0).abs() < 0.5, "{followed:?}");
            assert!(followed.cost < 0.02, "{followed:?}");
            assert!(lost.motion_px < 0.5 && lost.cost > 0.05, "{lost:?}");
        }
        assert!(at(&followed, 5, 5) == PixelMotion::default(), "{:?}", at(&followed, 5, 5));
    }

    /// Before the earlier frame it moved the other way.
    #[test]
    fn the_change_of_a_bouncing_bodys_motion_is_known() {
        let frames = [1.0, 0.0, 1.0, 2.0].map(scene);
        let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
        let bounced = |m: Motion| match m.to[2].x {
            0.0 => m,
            _ => Motion { to: [3.0, -3.0, 3.0, 9.0].map(|x| Vector2::new(x, 0.0)), ..m },
        };
        let bouncing: Vec<Motion> = motions().into_iter().map(bounced).collect();
        let of = |motions: &[Motion]| {
            let (_, motions) = refined(&four, [&still, &still], motions, &RefineOptions::default());
            motions.unwrap()[32 * W + 48]
        };
        let (steady, bouncing) = (of(&motions()), of(&bouncing));
        assert!(steady.change_px < 0.5, "{steady:?}");
        assert!((bouncing.change_px - 12.0).abs() < 0.5, "{bouncing:?}");
    }

    /// Frames are averaged along the trajectory, or in place where the difference is small.
    #[test]
    fn slow_motion_is_not_blurred() {
        for (step, min_db) in [(0.02, 50.0), (0.08, 45.0), (0.33, 45.0)] {
            let db = panned(step);
            assert!(db > min_db, "{step} px: {db}");
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
        let (result, _) = refined(
            &around(&frames, 0.5),
            [&from_earlier, &from_later],
            &slow,
            &RefineOptions::default(),
        );
        psnr(&result, &pan(0.5))
    }

    /// No track follows the square. The wall that only the later frame shows in its place must not appear
    /// yet.
    #[test]
    fn near_a_frame_what_only_the_other_shows_does_not_appear() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let four = around(&frames, 0.05);
        let still = at_rest();
        let warp = Warp::identity(W, H);
        let (result, _) = refined(&four, [&warp, &warp], &still, &RefineOptions::default());
        let db = psnr(&result, &frames[1]);
        assert!(db > 35.0, "{db}");
    }

    #[test]
    fn where_the_frames_agree_nothing_changes() {
        let frame = scene(0.0);
        let (before, after, parts, with_motions) = (None, None, None, false);
        let four = FourFrames {
            before,
            earlier: &frame,
            later: &frame,
            after,
            fraction: 0.3,
            parts,
            with_motions,
        };
        let still = Warp::identity(W, H);
        let (result, _) = refined(&four, [&still, &still], &motions(), &RefineOptions::default());
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
        let at = |fraction: f32, outer_share: f32| {
            let four = around(&frames, fraction);
            let options = RefineOptions { outer_share, ..RefineOptions::default() };
            refined(&four, [&warp, &warp], &still, &options).0
        };
        let (two, four) = (psnr(&at(0.5, 0.0), &clean), psnr(&at(0.5, 1.0), &clean));
        assert!(four > two + 2.0, "{two} {four}");
        for outer_share in [0.0, 1.0] {
            assert!(psnr(&at(0.0, outer_share), &frames[1]) > 90.0);
        }
    }

    #[test]
    fn the_fades_of_overlapping_blocks_sum_to_one() {
        for (step, x) in [8, 13, 51].into_iter().flat_map(|s| (0..3 * s).map(move |x| (s, x))) {
            let sum: f32 = covering(x, x, 3 * step, step).iter().map(|(.., weight)| weight).sum();
            assert!((sum - 1.0).abs() < 1e-6);
        }
    }

    /// To the bit.
    #[test]
    fn needed_tiles_equal_those_of_the_whole_image() {
        let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
        let still = Warp::identity(W, H);
        let of = |parts: Option<&Tiles>| {
            let four = FourFrames { parts, ..around(&frames, 0.5) };
            refined(&four, [&still, &still], &motions(), &RefineOptions::default())
        };
        let (whole, motions_of_whole) = of(None);
        let mut parts = Tiles::none(W, H);
        parts.mark_sample(29.0, 20.0);
        parts.mark_sample(70.0, 46.0);
        let (some, motions_of_some) = of(Some(&parts));
        let [motions_of_whole, motions_of_some] =
            [motions_of_whole, motions_of_some].map(Option::unwrap);
        let same = |k: usize| {
            some.data()[k] == whole.data()[k] && motions_of_some[k] == motions_of_whole[k]
        };
        let needed = |k: usize| parts.touches([(k % W) as isize, (k / W) as isize], 1);
        assert!((0..W * H).filter(|k| needed(*k)).all(same));
        assert!(!(0..W * H).all(same));
    }

    #[test]
    fn tiny_images_stay_finite() {
        for (w, h) in [(1, 1), (3, 17), (16, 2)] {
            let (a, b) = (Image::filled(w, h, 3, 0.1), Image::filled(w, h, 3, 0.9));
            let four = FourFrames {
                before: Some(&a),
                earlier: &a,
                later: &b,
                after: Some(&b),
                fraction: 0.5,
                parts: None,
                with_motions: true,
            };
            let still = Warp::identity(w, h);
            let (result, _) =
                refined(&four, [&still, &still], &motions(), &RefineOptions::default());
            assert!(result.data().iter().all(|v| v.is_finite()));
        }
    }
}
