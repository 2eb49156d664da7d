//! Tests of the refinement on synthetic scenes: a textured square, a train and a panning camera.

use super::*;
use crate::random::Random;
use crate::raster::Tiles;
use nalgebra::{Matrix2, Point2, Vector2};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PixelMotion {
    motion_px: f32,
    change_px: f32,
    cost: f32,
}

/// Returns the refined image and the motion of each pixel. `motions` are used twice: to compute the pair costs, and in
/// the refinement.
fn refined(
    frames: &FourFrames,
    warps: [&Warp; 2],
    motions: &[TrackMotion],
    options: &InterpolationOptions,
) -> (Image, Vec<PixelMotion>) {
    let costs = pair_costs(frames, motions, options);
    let (image, motions) = super::refined(frames, warps, motions.to_vec(), &costs, options);
    let of_pixel =
        |&[motion_px, change_px, cost]: &[f32; 3]| PixelMotion { motion_px, change_px, cost };
    (image, motions.data().as_chunks().0.iter().map(of_pixel).collect())
}

pub(super) fn pair_costs(
    frames: &FourFrames,
    motions: &[TrackMotion],
    options: &InterpolationOptions,
) -> PairCosts {
    let of_frame = |frame: usize| {
        let from = |m: &TrackMotion| {
            let own = m.to[frame];
            TrackMotion { at: m.at + own, to: m.to.map(|to| to - own), ..*m }
        };
        motions.iter().map(from).collect()
    };
    let size = [frames.earlier.width(), frames.earlier.height()];
    PairCosts::of_motions(size, [1, 2].map(of_frame), options)
}

const W: usize = 96;
const H: usize = 64;

fn texture(x: f32, y: f32, seed: f32) -> f32 {
    0.5 + 0.2 * (x * 0.9 + seed).sin() * (y * 0.7).cos() + 0.2 * (x * 0.31 - y * 0.53 + seed).sin()
}

/// Renders a textured square that moves right by 6 px per frame in front of a static textured wall.
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

fn motions() -> Vec<TrackMotion> {
    let mut all = Vec::new();
    for y in (2..H).step_by(5) {
        for x in (2..W).step_by(5) {
            let on_square = (35..62).contains(&x) && (20..44).contains(&y);
            let step = if on_square { 6.0 } else { 0.0 };
            let to = [-1.5, -0.5, 0.5, 1.5].map(|t| Vector2::new(step * t, 0.0));
            let at = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            all.push(TrackMotion { at, to, deformation: Matrix2::identity() });
        }
    }
    all
}

/// Returns tracks without motion. Their positions are those of the tracks that [`motions`] returns.
fn at_rest() -> Vec<TrackMotion> {
    motions().into_iter().map(|m| TrackMotion { to: [Vector2::zeros(); 4], ..m }).collect()
}

fn around(frames: &[Image; 4], fraction: f32) -> FourFrames<'_> {
    let [before, earlier, later, after] = frames;
    let fractions = RowFractions::constant(f64::from(fraction));
    FourFrames { before: Some(before), earlier, later, after: Some(after), fractions, parts: None }
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
    // Costs are computed at every pixel for the first radius, and at every second pixel for the second radius.
    for window_radius_px in [2, 4] {
        let options = InterpolationOptions { window_radius_px, ..InterpolationOptions::default() };
        let (result, _) = refined(&four, [&still, &still], &motions(), &options);
        let (cross_faded, _) = refined(&four, [&still, &still], &[], &options);
        let (before, after) = (psnr(&cross_faded, &truth), psnr(&result, &truth));
        assert!(after > before + 8.0, "{window_radius_px}: {before} {after}");
    }
}

fn noisy(image: &Image, amplitude: f32, random: &mut Random) -> Image {
    let noise = |v: &f32| v + amplitude * random.signed() as f32;
    let data = image.data().iter().map(noise).collect();
    Image::from_data(W, H, 1, data)
}

/// In a static scene, the mean of four frames has half the noise variance of the mean of two frames, even without
/// tracks.
#[test]
fn static_scenes_are_averaged() {
    let mut random = Random::new(3);
    let truth = scene(0.0);
    let frames = [0; 4].map(|_| noisy(&truth, 0.02, &mut random));
    let still = Warp::identity(W, H);
    let of = |frames: FourFrames| {
        psnr(&refined(&frames, [&still, &still], &[], &InterpolationOptions::default()).0, &truth)
    };
    let four = of(around(&frames, 0.5));
    let two = of(FourFrames { before: None, after: None, ..around(&frames, 0.5) });
    assert!((2.7..3.3).contains(&(four - two)), "{two} {four}");
}

/// Renders two dark wagons in front of a light wall. They move right by 8 px per frame. The wall is visible only in
/// the gap of 8 px between them.
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

fn motions_of_train() -> Vec<TrackMotion> {
    let still = at_rest().into_iter().filter(|m| !(12.0..52.0).contains(&m.at.y));
    let left = 12.0 + 4.0;
    let on_wagons = at_rest().into_iter().filter(|m| {
        let x = m.at.x - left;
        let on_wagon = (3.0..25.0).contains(&x) || (39.0..61.0).contains(&x);
        on_wagon && (17.0..47.0).contains(&m.at.y)
    });
    let moving = on_wagons
        .map(|m| TrackMotion { to: [-12.0, -4.0, 4.0, 12.0].map(|x| Vector2::new(x, 0.0)), ..m });
    still.chain(moving).collect()
}

/// Without motion compensation, both frames are dark at the gap's position, because each shows another wagon there. The
/// light wall must nevertheless appear in the gap.
#[test]
fn what_other_motions_explain_does_not_fill_a_gap() {
    let frames = [-1.0, 0.0, 1.0, 2.0].map(train);
    let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
    let motions = motions_of_train();
    let (result, _) = refined(&four, [&still, &still], &motions, &InterpolationOptions::default());
    let gap = || (20..44).flat_map(|y| (46..51).map(move |x| (x, y)));
    let darkest = gap().map(|(x, y)| result.pixel(x, y)[0]).fold(1.0, f32::min);
    // The wall's values in the gap are at least 0.37.
    assert!(darkest > 0.3, "{darkest}");
}

#[test]
fn pixels_move_as_their_tracks_and_cost_more_without() {
    let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
    let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
    let options = InterpolationOptions::default();
    let (_, followed) = refined(&four, [&still, &still], &motions(), &options);
    let (_, lost) = refined(&four, [&still, &still], &at_rest(), &options);
    let at = |motions: &[PixelMotion], x: usize, y: usize| motions[y * W + x];
    for (x, y) in [(40, 25), (48, 32), (55, 38)] {
        let (followed, lost) = (at(&followed, x, y), at(&lost, x, y));
        assert!((followed.motion_px - 6.0).abs() < 0.5, "{followed:?}");
        assert!(followed.cost < 0.02, "{followed:?}");
        assert!(lost.motion_px < 0.5 && lost.cost > 0.05, "{lost:?}");
    }
    assert!(at(&followed, 5, 5) == PixelMotion::default(), "{:?}", at(&followed, 5, 5));
}

/// The square moves to the left between the first two frames, and to the right afterwards.
#[test]
fn the_change_of_a_bouncing_bodys_motion_is_known() {
    let frames = [1.0, 0.0, 1.0, 2.0].map(scene);
    let (four, still) = (around(&frames, 0.5), Warp::identity(W, H));
    let bounced = |m: TrackMotion| match m.to[2].x {
        0.0 => m,
        _ => TrackMotion { to: [3.0, -3.0, 3.0, 9.0].map(|x| Vector2::new(x, 0.0)), ..m },
    };
    let bouncing: Vec<TrackMotion> = motions().into_iter().map(bounced).collect();
    let of = |motions: &[TrackMotion]| {
        let (_, motions) =
            refined(&four, [&still, &still], motions, &InterpolationOptions::default());
        motions[32 * W + 48]
    };
    let (steady, bouncing) = (of(&motions()), of(&bouncing));
    assert!(steady.change_px < 0.5, "{steady:?}");
    assert!((bouncing.change_px - 12.0).abs() < 0.5, "{bouncing:?}");
}

/// A slowly panned texture stays sharp. The frames before and after the pair are averaged in with motion compensation,
/// or without compensation if the difference is small.
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
        &InterpolationOptions::default(),
    );
    psnr(&result, &pan(0.5))
}

/// No track follows the square. The wall behind it, which only the later frame shows, must not appear in an image close
/// to the earlier frame's time.
#[test]
fn near_a_frame_what_only_the_other_shows_does_not_appear() {
    let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
    let four = around(&frames, 0.05);
    let still = at_rest();
    let warp = Warp::identity(W, H);
    let (result, _) = refined(&four, [&warp, &warp], &still, &InterpolationOptions::default());
    let db = psnr(&result, &frames[1]);
    assert!(db > 35.0, "{db}");
}

#[test]
fn where_the_frames_agree_nothing_changes() {
    let frame = scene(0.0);
    let (before, after, fractions) = (None, None, RowFractions::constant(0.3));
    let four = FourFrames { before, earlier: &frame, later: &frame, after, fractions, parts: None };
    let still = Warp::identity(W, H);
    let (result, _) =
        refined(&four, [&still, &still], &motions(), &InterpolationOptions::default());
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
    let of = |frames: FourFrames| {
        refined(&frames, [&warp, &warp], &still, &InterpolationOptions::default()).0
    };
    let without = |four: FourFrames<'_>| of(FourFrames { before: None, after: None, ..four });
    let four = psnr(&of(around(&frames, 0.5)), &clean);
    let two = psnr(&without(around(&frames, 0.5)), &clean);
    assert!(four > two + 2.0, "{two} {four}");
    for at_a_frame in [of(around(&frames, 0.0)), without(around(&frames, 0.0))] {
        assert!(psnr(&at_a_frame, &frames[1]) > 90.0);
    }
}

/// The needed tiles are bit-identical to the same tiles of the whole image.
#[test]
fn needed_tiles_equal_those_of_the_whole_image() {
    let frames = [-1.0, 0.0, 1.0, 2.0].map(scene);
    let still = Warp::identity(W, H);
    let of = |parts: Option<&Tiles>| {
        let four = FourFrames { parts, ..around(&frames, 0.5) };
        refined(&four, [&still, &still], &motions(), &InterpolationOptions::default())
    };
    let (whole, motions_of_whole) = of(None);
    let mut parts = Tiles::none(W, H);
    parts.mark_sample(29.0, 20.0);
    parts.mark_sample(70.0, 46.0);
    let (some, motions_of_some) = of(Some(&parts));
    let same =
        |k: usize| some.data()[k] == whole.data()[k] && motions_of_some[k] == motions_of_whole[k];
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
            fractions: RowFractions::constant(0.5),
            parts: None,
        };
        let still = Warp::identity(w, h);
        let (result, _) =
            refined(&four, [&still, &still], &motions(), &InterpolationOptions::default());
        assert!(result.data().iter().all(|v| v.is_finite()));
    }
}
