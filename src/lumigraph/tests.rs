//! Tests of view synthesis as a whole, on scenes known in closed form.

use super::*;
use crate::camera::tests::pinhole_at;
use crate::camera::{Camera, CameraModel};
pub(super) use crate::random::Random;
use crate::raster::{Image, Tiles};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};

pub(super) fn assert_covered(map: &DepthMap) {
    let missing = map.data().iter().filter(|z| !z.is_finite()).count();
    assert_eq!(missing, 0, "pixels without depth");
}

/// Returns a camera at `center`, metres, that looks along +z. It has 96×72 pixels, and its horizontal field of view is
/// 46°.
pub(super) fn camera_at(center: [f64; 3]) -> Camera {
    let model = CameraModel::Pinhole { fx: 112.0, fy: 112.0, cx: 48.0, cy: 36.0 };
    Camera { width: 96, height: 72, model, ..pinhole_at(center) }
}

/// Returns a rig of eight cameras on a line, 60 mm apart, as in the paper.
pub(super) fn rig() -> Vec<Camera> {
    (0..8).map(|k| camera_at([0.06 * (f64::from(k) - 3.5), 0.0, 0.0])).collect()
}

/// Returns the colour of a smooth texture, RGB of 0 to 1, at a position in the world, metres.
fn texture(p: &Point3<f64>) -> [f32; 3] {
    let wave = |a: f64, b: f64, c: f64| (0.5 + 0.4 * (a * p.x + b * p.y + c).sin()) as f32;
    [wave(7.0, 3.0, 0.3), wave(-4.0, 8.0, 1.0), wave(5.0, 5.0, 2.0)]
}

/// Returns the image that a camera takes of a textured plane.
fn film(camera: &Camera, plane: &Plane) -> Image {
    let mut data = Vec::new();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let ray = camera.ray_world(&Point2::new(x as f64 + 0.5, y as f64 + 0.5)).unwrap();
            let center = camera.center();
            let z = (plane.d - plane.normal.dot(&center.coords)) / plane.normal.dot(&ray);
            data.extend(texture(&(center + ray * z)));
        }
    }
    Image::from_data(camera.width, camera.height, 3, data)
}

fn noise(camera: &Camera, channels: usize, random: &mut Random) -> Image {
    let count = camera.width * camera.height * channels;
    let data = (0..count).map(|_| (random.unit() * 255.0).round() as f32 / 255.0).collect();
    Image::from_data(camera.width, camera.height, channels, data)
}

pub(super) fn sources<'a>(cameras: &'a [Camera], images: &'a [Image]) -> Vec<Source<'a>> {
    cameras.iter().zip(images).map(|(c, i)| Source::new(c, i)).collect()
}

pub(super) fn tilted() -> Plane {
    Plane { normal: Vector3::new(0.2, -0.1, 0.95).normalize(), d: 2.0 }
}

pub(super) fn turned(mut camera: Camera, angles: [f64; 3]) -> Camera {
    let center = camera.center();
    let turn = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
    camera.cam_from_world =
        Isometry3::from_parts(Translation3::from(-(turn * center.coords)), turn);
    camera
}

/// Reference implementation of [`super::blend`], pixel by pixel, with the weights of Buehler et al. Returns the RGB of
/// every pixel.
fn naive(sources: &[Source], depth: &DepthMap, target: &Camera, o: &BlendOptions) -> Vec<[f32; 3]> {
    let mut out = Vec::new();
    for y in 0..target.height {
        for x in 0..target.width {
            let ray = target.ray_world(&Point2::new(x as f64 + 0.5, y as f64 + 0.5)).unwrap();
            let point = target.center() + ray * f64::from(depth.row(y)[x]);
            let to_target = target.center() - point;
            let mut candidates: Vec<(f64, [f32; 3])> = Vec::new();
            for s in sources {
                let Some(at) = s.camera.project(&point) else { continue };
                let (w, h) = (s.camera.width as f64, s.camera.height as f64);
                let inside = at.x.min(at.y).min(w - at.x).min(h - at.y);
                if inside <= 0.0 {
                    continue;
                }
                let to_source = s.camera.center() - point;
                let angle = to_target.angle(&to_source);
                let footprint = |camera: &Camera, to: &Vector3<f64>| to.norm() / camera.focal_px();
                let ratio = footprint(s.camera, &to_source) / footprint(target, &to_target);
                let t = (inside / 4.0).min(1.0);
                let penalty = 2.0 * (angle / 2.0).tan() * (1.0 + (ratio - 1.0).max(0.0))
                    / (t * t * (3.0 - 2.0 * t));
                let mut value = [0.0; 3];
                s.image.sample_cubic(at.x as f32, at.y as f32, &mut value);
                candidates.push((penalty, value));
            }
            candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
            let threshold = candidates
                .get(o.cameras)
                .map_or(f64::INFINITY, |s| s.0.max(candidates[0].0 * 1.05));
            let (mut sum, mut total) = ([0.0; 3], 0.0);
            for (penalty, value) in &candidates {
                let weight = (1.0 - penalty / threshold).max(0.0) / penalty;
                total += weight;
                for (sum, v) in sum.iter_mut().zip(value) {
                    *sum += weight * f64::from(*v);
                }
            }
            out.push(sum.map(|s| (s / total) as f32));
        }
    }
    out
}

#[test]
fn equals_the_naive_one() {
    let mut random = Random::new(31);
    for round in 0..6 {
        let cameras: Vec<Camera> = rig()
            .into_iter()
            .map(|c| turned(c, [0.0; 3].map(|_: f64| random.in_range(-0.05, 0.05))))
            .collect();
        let images: Vec<Image> = cameras.iter().map(|c| noise(c, 3, &mut random)).collect();
        let sources = sources(&cameras, &images);
        let target = turned(
            camera_at([random.in_range(-0.2, 0.2), random.in_range(-0.1, 0.1), 0.1]),
            [0.02, -0.03, 0.1],
        );
        let options =
            BlendOptions { cameras: 1 + round, weight_step_px: 1, ..BlendOptions::default() };
        let depth = Proxy::Plane(tilted()).depth_map(&target);
        let got = blend(&sources, &depth, &target, &options);
        let want = naive(&sources, &depth, &target, &options);
        for ((pixel, want), covered) in got.image.data().chunks(3).zip(want).zip(got.coverage) {
            if covered {
                for (a, b) in pixel.iter().zip(want) {
                    assert!((a - b.clamp(0.0, 1.0)).abs() < 2e-3, "{a} {b}");
                }
            } else {
                assert!(want[0].is_nan());
            }
        }
    }
}

#[test]
fn a_plane_scene_over_its_plane_is_exact_to_the_sampling() {
    let plane = tilted();
    let cameras = rig();
    let images: Vec<Image> = cameras.iter().map(|c| film(c, &plane)).collect();
    let target = turned(camera_at([0.03, 0.05, 0.2]), [0.02, 0.03, 0.1]);
    let truth = film(&target, &plane);
    let depth = Proxy::Plane(plane).depth_map(&target);
    let rendered = blend(&sources(&cameras, &images), &depth, &target, &BlendOptions::default());
    let covered = rendered.coverage.iter().filter(|c| **c).count();
    assert!(covered > 96 * 72 * 9 / 10, "{covered}");
    // The outermost pixels may be sampled at an image's border, where the filter lacks neighbours.
    for y in 12..60 {
        for x in 12..84 {
            for (a, b) in rendered.image.pixel(x, y).iter().zip(truth.pixel(x, y)) {
                assert!((a - b).abs() < 2e-3, "{x} {y}: {a} {b}");
            }
        }
    }
}

#[test]
fn inputs_are_reproduced_whatever_the_proxy() {
    let mut random = Random::new(32);
    let cameras: Vec<Camera> =
        rig().into_iter().map(|c| turned(c, [0.03, random.in_range(-0.2, 0.2), 0.4])).collect();
    let images: Vec<Image> = cameras.iter().map(|c| noise(c, 3, &mut random)).collect();
    let sources = sources(&cameras, &images);
    let n = 96 * 72;
    let wild = (0..n).map(|_| random.in_range(-0.1, 5.0) as f32).collect();
    for depths in [vec![f32::NAN; n], vec![f32::INFINITY; n], vec![0.3; n], wild] {
        let depth = DepthMap::from_data(96, 72, depths);
        for (camera, image) in cameras.iter().zip(&images) {
            let rendered = blend(&sources, &depth, camera, &BlendOptions::default());
            assert!(rendered.coverage.iter().all(|c| *c));
            for (a, b) in rendered.image.data().iter().zip(image.data()) {
                assert!((a - b).abs() < 1e-4, "{a} {b}");
            }
        }
    }
}

#[test]
fn the_view_changes_continuously_as_it_moves() {
    let plane = Plane { normal: Vector3::z(), d: 1.5 };
    let mut random = Random::new(33);
    let cameras = rig();
    // Images of different colours, so that any jump of a weight shows.
    let images: Vec<Image> =
        cameras.iter().map(|c| Image::filled(c.width, c.height, 3, random.unit() as f32)).collect();
    let sources = sources(&cameras, &images);
    for k in [1, 2, 4] {
        let options = BlendOptions { cameras: k, ..BlendOptions::default() };
        let view = |x: f64| {
            let target = camera_at([x, 0.021, 0.0]);
            let depth = Proxy::Plane(plane).depth_map(&target);
            blend(&sources, &depth, &target, &options)
        };
        let mut last = view(-0.25);
        let mut largest: f32 = 0.0;
        for step in 1..200 {
            let next = view(-0.25 + 0.0004 * f64::from(step));
            for (k, (a, b)) in next.image.data().iter().zip(last.image.data()).enumerate() {
                if next.coverage[k / 3] && last.coverage[k / 3] {
                    largest = largest.max((a - b).abs());
                }
            }
            last = next;
        }
        assert!(largest < 0.4, "k = {k}: {largest}");
    }
}

#[test]
fn the_order_of_the_cameras_does_not_matter() {
    let mut random = Random::new(34);
    let mut cameras = rig();
    let mut images: Vec<Image> = cameras.iter().map(|c| noise(c, 3, &mut random)).collect();
    // The view is in the middle of the rig, where cameras on both sides are equally distant.
    let target = camera_at([0.0; 3]);
    let depth = Proxy::Plane(tilted()).depth_map(&target);
    let options = BlendOptions::default();
    let forward = blend(&sources(&cameras, &images), &depth, &target, &options);
    cameras.reverse();
    images.reverse();
    let backward = blend(&sources(&cameras, &images), &depth, &target, &options);
    for (a, b) in forward.image.data().iter().zip(backward.image.data()) {
        assert!((a - b).abs() < 1e-5);
    }
}

/// Checks that the blend reads the tiles that [`contributing`] returns, and no other tiles.
#[test]
fn tiles_that_do_not_contribute_may_show_anything() {
    let mut random = Random::new(36);
    let cameras = rig();
    for grays in [0, 3, 8] {
        let channels = |k: usize| if k < grays { 1 } else { 3 };
        let images: Vec<Image> =
            cameras.iter().enumerate().map(|(k, c)| noise(c, channels(k), &mut random)).collect();
        for x in [-0.3, -0.1, 0.013, 0.03] {
            let target = camera_at([x, 0.02, 0.1]);
            let depth = Proxy::Plane(tilted()).depth_map(&target);
            let options = BlendOptions { cameras: 2, ..BlendOptions::default() };
            let all = blend(&sources(&cameras, &images), &depth, &target, &options);
            let needed = contributing(&sources(&cameras, &images), &depth, &target, &options);
            let any: Vec<bool> = needed.iter().map(Tiles::any).collect();
            assert!(any.contains(&true) && any.contains(&false), "{any:?}");
            for (k, tiles) in needed.into_iter().enumerate() {
                let with = |blacked: &dyn Fn([isize; 2]) -> bool| {
                    let mut images = images.clone();
                    let pixels = images[k].data_mut().chunks_exact_mut(channels(k));
                    for (at, pixel) in pixels.enumerate() {
                        if blacked([(at % 96) as isize, (at / 96) as isize]) {
                            pixel.fill(0.0);
                        }
                    }
                    blend(&sources(&cameras, &images), &depth, &target, &options)
                };
                assert!(with(&|at| !tiles.touches(at, 1)) == all, "camera {k}, x = {x}");
                assert_eq!(with(&|_| true) == all, !tiles.any(), "camera {k}, x = {x}");
            }
        }
    }
}

#[test]
fn uniform_is_the_mean() {
    let cameras = rig();
    let images: Vec<Image> = (0..8).map(|k| Image::filled(96, 72, 1, k as f32 / 8.0)).collect();
    let target = camera_at([0.0; 3]);
    let options = BlendOptions { method: BlendMethod::Uniform, ..BlendOptions::default() };
    let depth = Proxy::Plane(Plane { normal: Vector3::z(), d: 9.0 }).depth_map(&target);
    let rendered = blend(&sources(&cameras, &images), &depth, &target, &options);
    assert_eq!(rendered.image.channels(), 1);
    assert!((rendered.image.pixel(48, 36)[0] - 3.5 / 8.0).abs() < 1e-6);
}

#[test]
fn gray_cameras_give_luminance_and_colored_ones_color() {
    let gray = |image: Image| {
        let pixels = image.data().chunks_exact(3);
        let data = pixels.map(|p| crate::raster::gray_from_rgb([p[0], p[1], p[2]])).collect();
        Image::from_data(image.width(), image.height(), 1, data)
    };
    let plane = tilted();
    let cameras = rig();
    let images: Vec<Image> = cameras
        .iter()
        .enumerate()
        .map(|(k, c)| if k % 3 == 0 { film(c, &plane) } else { gray(film(c, &plane)) })
        .collect();
    let sources = sources(&cameras, &images);
    let options = BlendOptions::default();
    // The viewpoints are between two cameras, at a coloured camera, and at a grey camera.
    for x in [0.013, cameras[3].center().x, cameras[4].center().x] {
        let target = camera_at([x, 0.0, 0.0]);
        let depth = Proxy::Plane(plane).depth_map(&target);
        let rendered = blend(&sources, &depth, &target, &options);
        let truth = film(&target, &plane);
        for y in 0..72 {
            for x in 20..76 {
                for (a, b) in rendered.image.pixel(x, y).iter().zip(truth.pixel(x, y)) {
                    assert!((a - b).abs() < 0.01, "{x} {y}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn a_camera_does_not_contribute_where_the_point_is_occluded() {
    // A wall at 2 m and a small screen at 1 m. The left camera sees the screen where the view
    // sees the wall.
    let cameras = vec![camera_at([-0.2, 0.0, 0.0]), camera_at([0.3, 0.0, 0.0])];
    let images = vec![Image::filled(96, 72, 1, 1.0), Image::filled(96, 72, 1, 0.25)];
    let target = camera_at([0.0; 3]);
    let wall = Proxy::Plane(Plane { normal: Vector3::z(), d: 2.0 });
    let screen = DepthMap::from_data(96, 72, vec![1.0; 96 * 72]);
    let mut sources = sources(&cameras, &images);
    let depth = wall.depth_map(&target);
    let middle = |sources: &[Source]| {
        blend(sources, &depth, &target, &BlendOptions::default()).image.pixel(48, 36)[0]
    };
    assert!(middle(&sources) > 0.5);
    sources[0].depth = Some(&screen);
    assert!((middle(&sources) - 0.25).abs() < 0.01);
    let own = wall.depth_map(&cameras[0]);
    sources[0].depth = Some(&own);
    assert!(middle(&sources) > 0.5, "its own surface does not occlude itself");
}

#[test]
fn degenerate_views() {
    let cameras = rig();
    let images: Vec<Image> = cameras.iter().map(|c| film(c, &tilted())).collect();
    let sources = sources(&cameras, &images);
    let options = BlendOptions::default();

    let away = turned(camera_at([0.0; 3]), [0.0, std::f64::consts::PI, 0.0]);
    let depth = DepthMap::from_data(96, 72, vec![2.0; 96 * 72]);
    let none = blend(&sources, &depth, &away, &options);
    assert!(none.coverage.iter().all(|c| !c) && none.image.data().iter().all(|v| *v == 0.0));

    let none = blend(&[], &depth, &cameras[0], &options);
    assert!(none.coverage.iter().all(|c| !c), "no cameras");

    let mut one = camera_at([0.01, 0.0, 0.0]);
    one.model = CameraModel::Pinhole { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5 };
    (one.width, one.height) = (1, 1);
    let depth = Proxy::Plane(tilted()).depth_map(&one);
    assert_eq!(blend(&sources, &depth, &one, &options).coverage, [true], "1×1");

    let sky = DepthMap::from_data(96, 72, vec![f32::INFINITY; 96 * 72]);
    let rendered = blend(&sources, &sky, &camera_at([0.01, 0.0, 0.0]), &options);
    assert!(rendered.image.data().iter().all(|v| v.is_finite()));
    assert!(rendered.coverage.iter().all(|c| *c));

    for options in [
        BlendOptions { cameras: 0, ..options.clone() },
        BlendOptions { cameras: 99, ..options.clone() },
    ] {
        let target = camera_at([0.01, 0.0, 0.0]);
        let depth = Proxy::Plane(tilted()).depth_map(&target);
        let rendered = blend(&sources, &depth, &target, &options);
        assert!(rendered.image.data().iter().all(|v| v.is_finite()));
        assert!(rendered.coverage[36 * 96 + 48]);
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let mut random = Random::new(35);
    let cameras = rig();
    let images: Vec<Image> = cameras.iter().map(|c| noise(c, 3, &mut random)).collect();
    let target = camera_at([0.02, 0.01, 0.0]);
    let points: Vec<Point3<f64>> = (0..200)
        .map(|_| {
            let at = [random.in_range(-0.6, 0.6), random.in_range(-0.5, 0.5)];
            Point3::new(at[0], at[1], random.in_range(1.5, 1.6))
        })
        .collect();
    let render = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mesh = Mesh::build(&points, &target, DepthEdges::default()).unwrap();
            let depth = Proxy::Mesh(mesh).depth_map(&target);
            blend(&sources(&cameras, &images), &depth, &target, &BlendOptions::default())
        })
    };
    assert_eq!(render(1), render(3));
}

#[test]
fn options_round_trip_and_refuse_unknown_fields() {
    let text = serde_json::to_string(&BlendOptions::default()).unwrap();
    assert_eq!(serde_json::from_str::<BlendOptions>(&text).unwrap(), BlendOptions::default());
    assert!(serde_json::from_str::<BlendOptions>(r#"{"camera": 3}"#).is_err());
}

/// Returns sources with the given interpolation errors: for each source, one error per pixel of its image, in pixels.
fn interpolated<'a>(
    cameras: &'a [Camera],
    images: &'a [Image],
    interpolation_error_px: &'a [Vec<f32>],
) -> Vec<Source<'a>> {
    let pairs = sources(cameras, images).into_iter().zip(interpolation_error_px);
    pairs.map(|(source, px)| Source { interpolation_error_px: Some(px), ..source }).collect()
}

#[test]
fn what_was_interpolated_far_gives_way_to_what_was_filmed_then() {
    // One camera is to the left of the view, and the other equally far to the right.
    let cameras = [camera_at([-0.03, 0.0, 0.0]), camera_at([0.03, 0.0, 0.0])];
    let target = camera_at([0.0; 3]);
    let images = [0.0, 1.0].map(|v| Image::filled(96, 72, 1, v));
    let depth = Proxy::Plane(Plane::fronto_parallel(&target, 2.0)).depth_map(&target);
    let by_place = BlendOptions::default();
    let by_both = BlendOptions { method: BlendMethod::SpaceTime, ..by_place.clone() };
    let middle = |px: [f32; 2], options: &BlendOptions| {
        let px = px.map(|px| vec![px; 96 * 72]);
        blend(&interpolated(&cameras, &images, &px), &depth, &target, options).image.pixel(48, 36)
            [0]
    };
    assert!((middle([0.0, 40.0], &by_place) - 0.5).abs() < 0.01);
    assert!((middle([0.0, 0.0], &by_both) - 0.5).abs() < 0.01);
    assert!((middle([20.0, 20.0], &by_both) - 0.5).abs() < 0.01);
    assert!(middle([0.0, 40.0], &by_both) < 0.2);
    assert!(middle([40.0, 0.0], &by_both) > 0.8);
    // Weights are continuous in time too: they don't jump where the interpolation error becomes 0.
    let (near, at) = (middle([0.0, 1e-4], &by_both), middle([0.0, 0.0], &by_both));
    assert!((near - at).abs() < 1e-3, "{near} {at}");
}

#[test]
fn a_frame_comes_back_at_its_place_and_time() {
    let cameras = rig();
    let mut random = Random::new(31);
    let images: Vec<Image> = cameras.iter().map(|c| noise(c, 3, &mut random)).collect();
    let mut px = vec![vec![0.0; 96 * 72]; cameras.len()];
    let options = BlendOptions { method: BlendMethod::SpaceTime, ..BlendOptions::default() };
    for k in [0, 3, 7] {
        let depth = Proxy::Plane(tilted()).depth_map(&cameras[k]);
        let found = blend(&interpolated(&cameras, &images, &px), &depth, &cameras[k], &options);
        let apart = found.image.data().iter().zip(images[k].data()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-4, "camera {k}");
        // If a camera's image has an interpolation error, neighbouring cameras contribute.
        px[k] = vec![30.0; 96 * 72];
        let found = blend(&interpolated(&cameras, &images, &px), &depth, &cameras[k], &options);
        assert!(found.image != images[k]);
        px[k] = vec![0.0; 96 * 72];
    }
}
