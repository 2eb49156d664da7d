//! Tests of stereo as a whole, on scenes known in closed form, and of its kernels against naive reference
//! implementations.

use super::cost_volume::DepthLevels;
use super::semi_global::aggregate;
use super::*;
use crate::camera::tests::pinhole_at;
use crate::camera::{Camera, CameraModel};
use crate::random::Random;
use crate::raster::Image;

const W: usize = 128;
const H: usize = 96;
const FOCAL_PX: f64 = 150.0;
const WALL_M: f64 = 2.0;
const BOARD_M: f64 = 1.2;
/// Left, right, upper and lower edge of the test scene's board, metres.
const BOARD: [f64; 4] = [-0.16, 0.14, -0.12, 0.15];

fn camera_at(center: [f64; 3]) -> Camera {
    with_lens(center, FOCAL_PX)
}

fn with_lens(center: [f64; 3], f: f64) -> Camera {
    let model = CameraModel::Pinhole { fx: f, fy: f, cx: W as f64 / 2.0, cy: H as f64 / 2.0 };
    Camera { width: W, height: H, model, ..pinhole_at(center) }
}

/// Returns five cameras on a line, 6 cm apart.
fn cameras() -> Vec<Camera> {
    (0..5).map(|k| camera_at([0.06 * (f64::from(k) - 2.0), 0.0, 0.0])).collect()
}

fn texture(x: f64, y: f64, seed: f64) -> f32 {
    let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c * seed).sin();
    let sum = wave(31.0, 13.0, 1.0) + wave(-17.0, 41.0, 2.0) + wave(67.0, -23.0, 0.7);
    (0.5 + 0.14 * sum) as f32
}

/// Returns the depth, metres, and the grey value at pixel (x, y) of a camera that sees a board in front of a wall.
fn seen(camera: &Camera, x: usize, y: usize) -> (f64, f32) {
    let center = camera.center();
    let rx = (x as f64 + 0.5 - W as f64 / 2.0) / camera.focal_px();
    let ry = (y as f64 + 0.5 - H as f64 / 2.0) / camera.focal_px();
    let depth = BOARD_M - center.z;
    let (bx, by) = (center.x + rx * depth, center.y + ry * depth);
    let [left, right, upper, lower] = BOARD;
    if bx > left && bx < right && by > upper && by < lower {
        return (depth, texture(bx, by, 5.0));
    }
    let depth = WALL_M - center.z;
    (depth, 0.7 * texture(center.x + rx * depth, center.y + ry * depth, 1.0))
}

fn film(camera: &Camera) -> Image {
    let data = (0..W * H).map(|k| seen(camera, k % W, k / W).1).collect();
    Image::from_data(W, H, 1, data)
}

fn range() -> [f64; 2] {
    [0.9 / WALL_M, 1.1 / BOARD_M]
}

/// Estimates the inverse depths of all five cameras. Returns the cameras and their inverse depths.
fn depths_of_all(options: &StereoOptions) -> (Vec<Camera>, Vec<InverseDepths>) {
    let cameras = cameras();
    let images: Vec<Image> = cameras.iter().map(film).collect();
    let pairs = cameras.iter().zip(&images);
    let views: Vec<StereoImage> =
        pairs.map(|(camera, image)| StereoImage { camera, image }).collect();
    let matcher = Matcher::new(&views, range(), options);
    let depths = (0..5).map(|k| matcher.depths(k, range()).unwrap()).collect();
    drop(views);
    (cameras, depths)
}

/// Returns the absolute errors of a camera's inverse depths, sorted, in pixels of disparity at a baseline of 6 cm.
/// `inverse` gives the estimated inverse depth of a pixel, 1/m. Only pixels at least `margin` pixels away from the
/// image's border and from the board's outline are included.
fn errors(camera: &Camera, inverse: impl Fn(usize) -> f64, margin: usize) -> Vec<f64> {
    let truth = |x: usize, y: usize| 1.0 / seen(camera, x, y).0;
    let mut px = Vec::new();
    for y in margin..H - margin {
        for x in margin..W - margin {
            let corners = [(x - margin, y - margin), (x + margin, y - margin)];
            let more = [(x - margin, y + margin), (x + margin, y + margin)];
            if corners.iter().chain(&more).all(|&(u, v)| truth(u, v) == truth(x, y)) {
                px.push((inverse(y * W + x) - truth(x, y)).abs() * FOCAL_PX * 0.06);
            }
        }
    }
    px.sort_by(f64::total_cmp);
    px
}

#[test]
fn depths_are_right_to_a_fraction_of_a_pixel_away_from_outlines() {
    for (halvings, limit_px) in [(0, 0.05), (1, 0.08)] {
        let (cameras, depths) = depths_of_all(&StereoOptions { halvings, ..Default::default() });
        for (camera, depths) in cameras.iter().zip(&depths) {
            let px = errors(camera, |k| f64::from(depths.values[k]), 12);
            assert!(px.len() > 1000);
            assert!(px[px.len() / 2] < limit_px, "{halvings}: {}", px[px.len() / 2]);
            assert!(px[px.len() * 95 / 100] < 0.3, "{halvings}: {}", px[px.len() * 95 / 100]);
        }
    }
}

#[test]
fn outlines_are_right_to_two_pixels() {
    let (cameras, depths) = depths_of_all(&StereoOptions::default());
    for (camera, depths) in cameras.iter().zip(&depths) {
        let px = errors(camera, |k| f64::from(depths.values[k]), 3);
        let wrong = px.iter().filter(|e| **e > 1.0).count() as f64 / px.len() as f64;
        assert!(wrong < 0.02, "{wrong}");
    }
}

/// Checks fused depths of views from places without a camera. The views include parts of the wall behind the board that
/// no camera sees.
#[test]
fn the_fused_surface_is_that_of_the_scene_in_any_view() {
    let (cameras, depths) = depths_of_all(&StereoOptions::default());
    let pairs = cameras.iter().zip(&depths);
    let surfaces: Vec<Surface> = pairs.map(|(camera, depths)| Surface { camera, depths }).collect();
    for center in [[0.03, 0.0, 0.0], [0.02, -0.08, 0.0], [0.0, 0.0, 0.15], [-0.04, 0.03, -0.1]] {
        let target = camera_at(center);
        let fused = fuse(&target, &surfaces);
        assert!(fused.data().iter().all(|z| z.is_finite()), "{center:?}");
        let px = errors(&target, |k| 1.0 / f64::from(fused.data()[k]), 8);
        let wrong = px.iter().filter(|e| **e > 0.5).count() as f64 / px.len() as f64;
        assert!(px[px.len() / 2] < 0.03 && wrong < 0.03, "{center:?}: {wrong}");
    }
}

/// Checks views in which one pixel of a camera covers several pixels. The wall behind the board must not be visible
/// between the board's splats.
#[test]
fn the_fused_surface_has_no_holes_where_the_view_enlarges() {
    let (cameras, depths) = depths_of_all(&StereoOptions::default());
    let pairs = cameras.iter().zip(&depths);
    let surfaces: Vec<Surface> = pairs.map(|(camera, depths)| Surface { camera, depths }).collect();
    for (center, focal_px, margin) in
        [([0.02, 0.0, 0.7], FOCAL_PX, 16), ([0.03, 0.0, 0.0], 3.0 * FOCAL_PX, 24)]
    {
        let target = with_lens(center, focal_px);
        let fused = fuse(&target, &surfaces);
        let px = errors(&target, |k| 1.0 / f64::from(fused.data()[k]), margin);
        let wrong = px.iter().filter(|e| **e > 0.5).count() as f64 / px.len() as f64;
        assert!(px.len() > 1000 && wrong < 0.03, "{focal_px}: {wrong} of {}", px.len());
    }
}

#[test]
fn without_a_camera_at_another_place_there_is_no_depth() {
    let camera = camera_at([0.0; 3]);
    let image = film(&camera);
    let view = StereoImage { camera: &camera, image: &image };
    let options = StereoOptions::default();
    for views in [vec![view], vec![view; 3]] {
        let matcher = Matcher::new(&views, range(), &options);
        assert_eq!(matcher.depths(0, range()), None);
    }
}

/// Checks that the inverse depths of uniform images, tiny images and images of NaN are within the given range, up to
/// twice the tolerance. The range may be a single value, or extend from the sky to the lens.
#[test]
fn whatever_the_images_depths_are_within_the_range() {
    for (w, h) in [(1, 1), (2, 3), (17, 1), (40, 30)] {
        for value in [0.0, 0.5, f32::NAN] {
            for range in [[0.4, 0.4], [1e-5, 1e6], [0.4, 0.8]] {
                let small = |x: f64| Camera { width: w, height: h, ..camera_at([x, 0.0, 0.0]) };
                let cameras = [0.0, 0.06, 0.12].map(small);
                let image = Image::filled(w, h, 1, value);
                let views = cameras.each_ref().map(|camera| StereoImage { camera, image: &image });
                let options = StereoOptions::default();
                let matcher = Matcher::new(&views, range, &options);
                let depths = matcher.depths(1, range).unwrap();
                let [low, high] = range.map(|v| v as f32);
                let slack = 2.0 * depths.tolerance;
                let inside = |v: &f32| (low - slack..=high + slack).contains(v);
                assert!(depths.values.iter().all(inside), "{w}×{h}, {value}, {range:?}");
            }
        }
    }
}

/// Reference implementation of semi-global matching: Hirschmüller's recursion, direction by direction. `jump` is the
/// penalty P2 between two pixels.
fn naive(costs: &[u8], [w, h, n]: [usize; 3], jump: impl Fn(usize, usize) -> i32) -> Vec<i32> {
    let mut sums = vec![0; costs.len()];
    for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)] {
        let mut path = vec![0; costs.len()];
        let mut order: Vec<(i32, i32)> =
            (0..h as i32).flat_map(|y| (0..w as i32).map(move |x| (x, y))).collect();
        order.sort_by_key(|(x, y)| (dy * y, dx * x));
        for (x, y) in order {
            let k = (y * w as i32 + x) as usize;
            let (px, py) = (x - dx, y - dy);
            let inside = px >= 0 && py >= 0 && px < w as i32 && py < h as i32;
            for d in 0..n {
                let mut best = 0;
                if inside {
                    let p = (py * w as i32 + px) as usize;
                    let before = &path[p * n..(p + 1) * n];
                    let least = *before.iter().min().unwrap();
                    best = before[d].min(least + jump(k, p));
                    if d > 0 {
                        best = best.min(before[d - 1] + 6);
                    }
                    if d + 1 < n {
                        best = best.min(before[d + 1] + 6);
                    }
                    best -= least;
                }
                path[k * n + d] = i32::from(costs[k * n + d]) + best;
            }
        }
        sums.iter_mut().zip(&path).for_each(|(sum, p)| *sum += p);
    }
    sums
}

#[test]
fn semi_global_matching_equals_the_recursion() {
    let mut random = Random::new(3);
    for (w, h, n) in [(1, 1, 1), (7, 5, 9), (12, 9, 33)] {
        let costs: Vec<u8> = (0..w * h * n).map(|_| (random.unit() * 72.0) as u8).collect();
        // In a uniform image, the penalty P2 is equal everywhere.
        let gray = Image::filled(w, h, 1, 0.5);
        let sums: Vec<i32> = aggregate(&costs, &gray, n).into_iter().map(i32::from).collect();
        assert_eq!(sums, naive(&costs, [w, h, n], |_, _| 70));
    }
}

#[test]
fn levels_span_the_range() {
    let levels = DepthLevels::new([0.5, 1.0], 0.11);
    assert_eq!(levels.count, 6);
    assert!((levels.at(0.0) - 0.5).abs() < 1e-6 && (levels.at(5.0) - 1.0).abs() < 1e-6);
    assert_eq!(DepthLevels::new([0.5, 0.5], 0.1).count, 1);
    assert_eq!(DepthLevels::new([1e-5, 1e9], 1e-3).count, 1024);
}
