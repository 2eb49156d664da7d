//! Tests on scenes in closed form: textured walls that move, filmed by cameras that are not synchronized.

mod background;
mod search;
mod views;

use super::frame::levels;
use super::geometry::Projection;
use super::matching::{MAX_OBSERVATIONS, Observations, PatchMatcher};
use super::observing_frame::ObservingFrame;
use super::patch::Patch;
use super::*;
use crate::camera::{Camera, CameraModel};
use crate::random::Random;
use crate::raster::Image;
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion};

const SIZE: [usize; 2] = [96, 72];
const FOCAL_PX: f64 = 100.0;
const SPACING_M: f64 = 0.1;
/// Maximum speed that is searched, pixels per frame.
const MAX_SPEED: f32 = 12.0;

fn camera_at(x: f64, y: f64) -> Camera {
    Camera {
        width: SIZE[0],
        height: SIZE[1],
        model: CameraModel::Pinhole { fx: FOCAL_PX, fy: FOCAL_PX, cx: 48.0, cy: 36.0 },
        cam_from_world: Isometry3::from_parts(
            Translation3::new(-x, -y, 0.0),
            UnitQuaternion::identity(),
        ),
    }
}

/// A textured rectangle in a plane parallel to the image planes.
#[derive(Clone, Copy)]
struct Wall {
    depth_m: f64,
    /// Velocity parallel to the image planes, metres per frame.
    velocity: [f64; 2],
    /// Half of the rectangle's sides, metres.
    half_m: [f64; 2],
    /// Half of the side of the middle part, a square that has a single colour, metres.
    plain_m: f64,
}

/// Static wall behind everything else, which fills the image.
const STILL: Wall =
    Wall { depth_m: 3.0, velocity: [0.0; 2], half_m: [f64::INFINITY; 2], plain_m: 0.0 };
const MOVING: Wall = Wall { depth_m: 2.0, velocity: [0.06, -0.03], half_m: [0.3; 2], plain_m: 0.0 };

impl Wall {
    /// Returns the position where a camera's ray through `pixel` meets the wall at `time`, in the wall's own
    /// coordinates, metres. `None` if the ray misses the wall.
    fn hit(&self, camera: &Camera, pixel: [f64; 2], time: f64) -> Option<[f64; 2]> {
        let ray = camera.ray_world(&Point2::from(pixel)).unwrap();
        let point = camera.center() + ray * self.depth_m;
        let place = [point.x - self.velocity[0] * time, point.y - self.velocity[1] * time];
        (0..2).all(|c| place[c].abs() <= self.half_m[c]).then_some(place)
    }

    fn color(&self, [x, y]: [f64; 2]) -> [f32; 3] {
        if x.abs().max(y.abs()) < self.plain_m {
            return [0.8; 3];
        }
        let seed = self.depth_m;
        let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c * seed).sin();
        let bright =
            0.5 + 0.15 * (wave(31.0, 7.0, 1.0) + wave(-11.0, 37.0, 2.0) + wave(19.0, -23.0, 3.0));
        let tint = 0.1 * wave(13.0, 17.0, 5.0);
        [bright + tint, bright, bright - tint].map(|v| v as f32)
    }
}

/// Films walls with 4 × 4 samples per pixel.
fn filmed(camera: &Camera, walls: &[Wall], time: f64) -> Image {
    let sample = |k: usize, n: usize| {
        let [dx, dy] = [n % 4, n / 4].map(|step| (step as f64 + 0.5) / 4.0);
        let pixel = [(k % SIZE[0]) as f64 + dx, (k / SIZE[0]) as f64 + dy];
        let seen = walls.iter().find_map(|w| Some((w, w.hit(camera, pixel, time)?)));
        seen.map_or([0.0; 3], |(wall, place)| wall.color(place))
    };
    let color = |k: usize| {
        let samples = (0..16).map(|n| sample(k, n));
        let sum = samples.fold([0.0; 3], |sum, c| [0, 1, 2].map(|k| sum[k] + c[k]));
        sum.map(|v| v / 16.0)
    };
    let data = (0..SIZE[0] * SIZE[1]).flat_map(color).collect();
    Image::from_data(SIZE[0], SIZE[1], 3, data)
}

/// Returns the frames of four cameras in a line. Each camera films three frames, with a temporal offset that is a
/// multiple of a quarter of a frame interval.
fn recording(walls: &[Wall]) -> Vec<[FlowFrame; 3]> {
    recording_at(walls, [0.0, 0.5, 0.25, 0.75])
}

/// Returns the [`recording`] by cameras with these temporal offsets, frame intervals.
fn recording_at(walls: &[Wall], offsets: [f64; 4]) -> Vec<[FlowFrame; 3]> {
    let frames = |c: usize| {
        let camera = camera_at(SPACING_M * c as f64, 0.0);
        [0, 1, 2].map(|k| {
            let time = k as f64 + offsets[c];
            FlowFrame::new(&camera, &filmed(&camera, walls, time), time)
        })
    };
    (0..4).map(frames).collect()
}

/// Returns the scene flow maps of the cameras' middle frames, one for each camera.
fn maps(recording: &[[FlowFrame; 3]]) -> Vec<FlowMap> {
    let matched = |c: usize| {
        let own = &recording[c];
        let others = recording.iter().enumerate().filter(|(other, _)| *other != c);
        let nearest = others.map(|(_, frames)| {
            let distance = |f: &&FlowFrame| (f.time - own[1].time).abs();
            frames.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
        });
        (&own[1], [&own[0], &own[2]].into_iter().chain(nearest).collect())
    };
    let frames: Vec<(&FlowFrame, Vec<&FlowFrame>)> = (0..recording.len()).map(matched).collect();
    estimated(&frames, &[], MAX_SPEED, &|| true)
}

/// Returns the scene flow maps of frames that are matched with others. `stills` is the static background of each camera
/// with its map, or empty. The maximum speed is in pixels per frame.
fn estimated(
    frames: &[(&FlowFrame, Vec<&FlowFrame>)],
    stills: &[(&StillImage, &FlowMap)],
    max_speed: f32,
    proceed: &(dyn Fn() -> bool + Sync),
) -> Vec<FlowMap> {
    let all = frames.iter().map(|(f, others)| [&[*f], &others[..]].concat());
    let all: Vec<Vec<&FlowFrame>> = all.collect();
    let camera = |frame: &FlowFrame| (frame.view.center().x / SPACING_M).round() as usize;
    let pyramid = |frame: &&FlowFrame| match stills.get(camera(frame)) {
        Some((still, _)) => frame.pyramid_before(still),
        None => frame.pyramid(),
    };
    let levels: Vec<Vec<Vec<MatchingImage>>> =
        all.iter().map(|f| f.iter().map(pyramid).collect()).collect();
    let mut list = Vec::new();
    for (frames, levels) in all.iter().zip(&levels) {
        let mut both =
            frames.iter().zip(levels).map(|(frame, levels)| PyramidFrame { frame, levels });
        let frame = both.next().unwrap();
        let of_camera = stills.get(camera(frame.frame));
        let background = of_camera.map(|(_, map)| Background::new(frame, map));
        list.push(EstimatedFrame { frame, others: both.collect(), background });
    }
    let limits = Limits { inverse_depth: [0.2, 1.0], max_speed };
    Estimation { frames: &list, limits, baseline_m: 2.0 * SPACING_M }.run(proceed)
}

/// Returns the middle frames of the cameras other than the second, in which that of the second is observed.
fn observations<'a>(
    recording: &'a [[FlowFrame; 3]],
    levels: &'a [Vec<MatchingImage>],
) -> Observations<'a> {
    let frame = |c: usize| PyramidFrame { frame: &recording[c][1], levels: &levels[c] };
    Observations::new([0, 2, 3].map(|c| ObservingFrame::new(frame(1), frame(c)).unwrap()))
}

/// Returns the pyramid of a frame with silhouettes before the static wall.
fn silhouetted(frame: &FlowFrame) -> Vec<MatchingImage> {
    let still = [0; 3].map(|_| CompactImage::new(&filmed(&frame.view, &[STILL], 0.0)));
    frame.pyramid_before(&StillImage::new(&still, 0.6))
}

/// Returns the matcher of the second camera's middle frame at the finest level.
fn matcher<'a>(
    levels: &'a [Vec<MatchingImage>],
    observations: &'a Observations<'a>,
) -> PatchMatcher<'a> {
    let disparity_px = (2.0 * SPACING_M * FOCAL_PX) as f32;
    PatchMatcher { own: &levels[1][0], observations, level: 0, scale: 1.0, disparity_px }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn depth_and_motion_of_two_walls_are_found() {
    let walls = [MOVING, STILL];
    let recording = recording(&walls);
    let maps = maps(&recording);
    for (frames, map) in recording.iter().zip(&maps) {
        let (camera, time) = (&frames[1].view, frames[1].time);
        for (of, wall) in walls.iter().enumerate() {
            let (mut disparity, mut motion) = (Vec::new(), Vec::new());
            for (k, pixel) in map.pixels().iter().enumerate() {
                let place = [(k % SIZE[0]) as f64 + 0.5, (k / SIZE[0]) as f64 + 0.5];
                let seen = walls.iter().position(|w| w.hit(camera, place, time).is_some());
                if seen != Some(of) {
                    continue;
                }
                let element = map.element(pixel);
                let error = f64::from(element.inverse_depth) - 1.0 / wall.depth_m;
                disparity.push((error * f64::from(map.disparity_px)).abs());
                let true_px = wall.velocity.map(|v| v * FOCAL_PX / wall.depth_m);
                let [du, dv] = [0, 1].map(|c| f64::from(element.velocity[c]) - true_px[c]);
                motion.push(du.hypot(dv));
            }
            let (disparity, motion) = (median(disparity), median(motion));
            assert!(disparity < 0.05, "wall {of}: {disparity} px of disparity");
            assert!(motion < 0.1, "wall {of}: {motion} px a frame");
        }
    }
}

#[test]
fn smoothing_draws_a_wrong_motion_on_a_plain_body_towards_its_surroundings() {
    let wall = Wall { plain_m: 0.11, ..MOVING };
    let recording = recording(&[wall, STILL]);
    let levels: Vec<Vec<MatchingImage>> = recording.iter().map(|f| silhouetted(&f[1])).collect();
    let observations = observations(&recording, &levels);
    let matcher = matcher(&levels, &observations);
    let FlowFrame { view, time, .. } = &recording[1][1];
    let hit =
        |k: usize| wall.hit(view, [(k % SIZE[0]) as f64 + 0.5, (k / SIZE[0]) as f64 + 0.5], *time);
    // The pixels whose patches have a single colour.
    let is_plain = |k: usize| hit(k).is_some_and(|[x, y]| x.abs().max(y.abs()) < 0.035);
    let element = |of: &Wall| Element {
        inverse_depth: (1.0 / of.depth_m) as f32,
        velocity: of.velocity.map(|v| (v * FOCAL_PX / of.depth_m) as f32),
        ..Element::default()
    };
    let truth = |k: usize| element(if hit(k).is_some() { &wall } else { &STILL });
    let pixels = || 0..SIZE[0] * SIZE[1];
    let mut elements: Vec<Element> = pixels().map(truth).collect();
    pixels().filter(|&k| is_plain(k)).for_each(|k| elements[k].velocity[0] += 4.0);
    let cost = |k: usize| {
        let (mut patch, mut costs) = (Patch::empty(), [0.0; MAX_OBSERVATIONS]);
        let pixel @ (x, y) = (k % SIZE[0], k / SIZE[0]);
        matcher.fill_patch(x, y, &mut patch);
        matcher.cost(&elements[k], pixel, &patch, f32::INFINITY, &mut costs)
    };
    let costs = pixels().map(cost).collect();
    let mut map = ElementMap {
        width: SIZE[0],
        height: SIZE[1],
        scale: 1.0,
        elements,
        costs,
        given: Vec::new(),
    };
    matcher.smooth(&mut map);
    assert!(pixels().any(is_plain));
    for k in pixels().filter(|&k| is_plain(k)) {
        let [u, v] = [0, 1].map(|c| map.elements[k].velocity[c] - truth(k).velocity[c]);
        assert!(u.hypot(v) < 2.5, "{k}: {u}, {v} of 4 px a frame");
    }
}

/// Adds uniform noise with a standard deviation of 2 %.
fn add_noise(recording: &mut [[FlowFrame; 3]]) {
    let mut random = Random::new(3);
    for frame in recording.iter_mut().flatten() {
        frame.image.data_mut().iter_mut().for_each(|v| *v += 0.035 * random.signed() as f32);
    }
}

#[test]
fn the_cost_of_noise_is_that_of_true_elements() {
    let plain = Wall { plain_m: f64::INFINITY, ..STILL };
    let mut recording = recording(&[plain]);
    add_noise(&mut recording);
    let levels: Vec<Vec<MatchingImage>> = recording.iter().map(|f| f[1].pyramid()).collect();
    let observations = observations(&recording, &levels);
    let matcher = matcher(&levels, &observations);
    let element = Element { inverse_depth: 1.0 / 3.1, ..Element::default() };
    let (mut patch, mut costs) = (Patch::empty(), [0.0; MAX_OBSERVATIONS]);
    let mut cost = |x: usize| {
        matcher.fill_patch(x, 36, &mut patch);
        f64::from(matcher.cost(&element, (x, 36), &patch, f32::INFINITY, &mut costs))
    };
    let found = median((20..76).map(&mut cost).collect());
    let expected = f64::from(levels[1][0].noise_cost());
    assert!((0.8..1.25).contains(&(found / expected)), "{found} in place of {expected}");
}

#[test]
fn a_wrong_motion_does_not_match_where_most_frames_are_of_the_same_time() {
    let wall = Wall { half_m: [f64::INFINITY; 2], ..MOVING };
    let recording = recording_at(&[wall], [0.0, 0.02, -0.03, 0.01]);
    let levels: Vec<[Vec<MatchingImage>; 3]> =
        recording.iter().map(|frames| frames.each_ref().map(FlowFrame::pyramid)).collect();
    let frame =
        |c: usize, k: usize| PyramidFrame { frame: &recording[c][k], levels: &levels[c][k] };
    let others = [(1, 0), (1, 2), (0, 1), (2, 1), (3, 1)];
    let observing = others.map(|(c, k)| ObservingFrame::new(frame(1, 1), frame(c, k)).unwrap());
    let observations = Observations::new(observing);
    let disparity_px = (2.0 * SPACING_M * FOCAL_PX) as f32;
    let own = &levels[1][1][0];
    let matcher =
        PatchMatcher { own, observations: &observations, level: 0, scale: 1.0, disparity_px };
    let still = Element { inverse_depth: (1.0 / wall.depth_m) as f32, ..Element::default() };
    let velocity = wall.velocity.map(|v| (v * FOCAL_PX / wall.depth_m) as f32);
    let [wrong, right] = [still, Element { velocity, ..still }].map(|element| {
        let (mut patch, mut costs) = (Patch::empty(), [0.0; MAX_OBSERVATIONS]);
        let cost = |x: usize| {
            matcher.fill_patch(x, 36, &mut patch);
            f64::from(matcher.cost(&element, (x, 36), &patch, f32::INFINITY, &mut costs))
        };
        median((30..66).map(cost).collect())
    });
    assert!(wrong > 5.0 * right, "{wrong} and {right}");
}

#[test]
fn errors_are_about_as_large_as_their_standard_errors() {
    let mut recording = recording(&[MOVING, STILL]);
    add_noise(&mut recording);
    let maps = maps(&recording);
    let (mut disparity, mut motion) = (Vec::new(), Vec::new());
    for (frames, map) in recording.iter().zip(&maps) {
        let (camera, time) = (&frames[1].view, frames[1].time);
        for (k, pixel) in map.pixels().iter().enumerate() {
            let place = [(k % SIZE[0]) as f64 + 0.5, (k / SIZE[0]) as f64 + 0.5];
            if MOVING.hit(camera, place, time).is_none() {
                continue;
            }
            let (element, errors) = (map.element(pixel), pixel.errors());
            let error = element.inverse_depth - (1.0 / MOVING.depth_m) as f32;
            disparity.push(f64::from((error * map.disparity_px / errors.disparity_px).abs()));
            let true_px = MOVING.velocity[0] * FOCAL_PX / MOVING.depth_m;
            let error = f64::from(element.velocity[0]) - true_px;
            motion.push((error / f64::from(errors.velocity_px)).abs());
        }
    }
    let (disparity, motion) = (median(disparity), median(motion));
    assert!((0.3..1.0).contains(&disparity), "{disparity} standard errors of the disparity");
    assert!((0.3..1.0).contains(&motion), "{motion} standard errors of the velocity");
}

#[test]
fn standard_errors_without_texture_are_those_of_the_prior() {
    let mut recording = recording(&[STILL]);
    let textured = maps(&recording).remove(0).pixels()[40 * SIZE[0] + 40].errors();
    for frame in recording.iter_mut().flatten() {
        frame.image.data_mut().fill(0.5);
    }
    let plain = maps(&recording).remove(0).pixels()[40 * SIZE[0] + 40].errors();
    assert!(textured.disparity_px < 0.1 && textured.velocity_px < 0.2, "{textured:?}");
    assert!(plain.disparity_px > 1.0 && plain.velocity_px > 1.0, "{plain:?}");
}

#[test]
fn an_outline_leaves_plain_background_beside_it_uncertain() {
    let plain = Wall { plain_m: f64::INFINITY, ..STILL };
    let body = Wall { velocity: [0.0; 2], ..MOVING };
    let recording = recording(&[body, plain]);
    let levels: Vec<Vec<MatchingImage>> = recording.iter().map(|f| f[1].pyramid()).collect();
    let observations = observations(&recording, &levels);
    let matcher = matcher(&levels, &observations);
    let element = Element { inverse_depth: 0.5, ..Element::default() };
    let [width, height] = SIZE;
    let (elements, costs) = (vec![element; width * height], vec![0.0; width * height]);
    let map = ElementMap { width, height, scale: 1.0, elements, costs, given: Vec::new() };
    // In the second camera, the body covers the columns 28 to 57 and the rows 21 to 50.
    let error_px = |errors: &[ElementErrors], x: usize| {
        median((26..46).map(|y| f64::from(errors[y * width + x].disparity_px)).collect())
    };
    let (all, of_surface) = (matcher.errors(&map), matcher.surface_errors(&map, 0));
    let [beside, inside] = [60, 44].map(|x| [&all, &of_surface].map(|e| error_px(e, x)));
    assert!(beside[0] < 0.2 && beside[1] > 1.0, "{beside:?}");
    assert!(inside[1] < 0.2, "{inside:?}");
}

#[test]
fn any_number_of_threads_gives_the_same_maps() {
    let recording = recording(&[MOVING, STILL]);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| maps(&recording))
    };
    assert!(on(1) == on(3));
}

#[test]
fn an_estimation_that_may_not_go_on_has_no_maps() {
    let recording = recording(&[STILL]);
    let frames = [(&recording[0][1], vec![&recording[1][1]])];
    assert!(estimated(&frames, &[], MAX_SPEED, &|| false).is_empty());
}

#[test]
fn projections_are_those_of_the_cameras() {
    let from = camera_at(0.0, 0.0);
    let mut to = camera_at(0.3, -0.1);
    to.cam_from_world.rotation = UnitQuaternion::from_euler_angles(0.05, -0.1, 0.2);
    let projection = Projection::new(&from, &to).unwrap();
    for (x, y, depth_m) in [(10.5, 20.5, 1.0), (60.0, 3.0, 2.5), (95.0, 71.0, 40.0)] {
        let point = from.center() + from.ray_world(&Point2::new(x, y)).unwrap() * depth_m;
        let expected = to.project(&point).unwrap();
        let [u, v, q] = projection.project(x as f32, y as f32, (1.0 / depth_m) as f32);
        assert!(
            (f64::from(u) - expected.x).abs() < 1e-3 && (f64::from(v) - expected.y).abs() < 1e-3
        );
        let z = (to.cam_from_world * point).z;
        assert!((f64::from(q) - 1.0 / z).abs() < 1e-5 / z);
    }
    let mut backward = camera_at(0.0, 0.0);
    backward.cam_from_world.rotation =
        UnitQuaternion::from_euler_angles(0.0, std::f64::consts::PI, 0.0);
    let behind = Projection::new(&from, &backward).unwrap();
    assert!(behind.project(48.0, 36.0, 0.5)[0] < -1e6);
}

#[test]
fn a_distorted_camera_is_undistorted_and_its_view_distorted_again() {
    let mut camera = camera_at(0.0, 0.0);
    camera.model = CameraModel::SimpleRadial { f: FOCAL_PX, cx: 48.0, cy: 36.0, k: -0.15 };
    let pinhole = camera_at(0.0, 0.0);
    let image = filmed(&camera, &[STILL], 0.0);
    let frame = FlowFrame::new(&camera, &image, 0.0);
    let truth = filmed(&pinhole, &[STILL], 0.0);
    let margin = [frame.view.width - SIZE[0], frame.view.height - SIZE[1]].map(|m| m / 2);
    assert!(margin.iter().all(|m| (1..12).contains(m)), "{margin:?}");
    for k in 0..SIZE[0] * SIZE[1] {
        let (x, y) = (k % SIZE[0], k / SIZE[0]);
        let (u, v) = (x + margin[0], y + margin[1]);
        let is_inside = (4..SIZE[0] - 4).contains(&x) && (4..SIZE[1] - 4).contains(&y);
        if frame.films([u as f32 + 0.5, v as f32 + 0.5]) && is_inside {
            let difference = frame.image.pixel(u, v)[1] - truth.pixel(x, y)[1];
            assert!(difference.abs() < 0.03, "{x}, {y}: {difference}");
        }
    }
}

#[test]
fn all_that_a_distorted_camera_films_is_in_its_frame() {
    let mut camera = camera_at(0.0, 0.0);
    for k in [-0.15, 0.1] {
        camera.model = CameraModel::SimpleRadial { f: FOCAL_PX, cx: 50.0, cy: 35.0, k };
        let frame = FlowFrame::new(&camera, &filmed(&camera, &[STILL], 0.0), 0.0);
        // All pixels, from the image's border on.
        let [right, bottom] = SIZE.map(|size| size as f64 - 0.01);
        for (x, y) in (0..=SIZE[1]).flat_map(|y| (0..=SIZE[0]).map(move |x| (x, y))) {
            let place = Point2::new((x as f64).clamp(0.01, right), (y as f64).clamp(0.01, bottom));
            let there = frame.view.project_cam(&camera.ray(&place).unwrap().into()).unwrap();
            assert!(frame.films([there.x as f32, there.y as f32]), "{k}: {place}");
        }
    }
}

#[test]
fn colors_of_a_distorted_camera_are_interpolated_in_its_own_image() {
    let mut camera = camera_at(0.0, 0.0);
    camera.model = CameraModel::SimpleRadial { f: FOCAL_PX, cx: 48.0, cy: 36.0, k: -0.15 };
    let image = filmed(&camera, &[STILL], 0.0);
    let frame = FlowFrame::new(&camera, &image, 0.0);
    for (x, y) in (4..SIZE[0] - 4).zip((4..SIZE[1] - 4).cycle()) {
        let place = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
        let there = frame.view.project_cam(&camera.ray(&place).unwrap().into()).unwrap();
        let color = frame.color([there.x as f32, there.y as f32]);
        let difference = color[1] - image.pixel(x, y)[1];
        assert!(difference.abs() < 0.005, "{x}, {y}: {difference}");
    }
}

#[test]
fn images_of_any_size_have_levels() {
    for (width, height, expected) in
        [(1, 1, 1), (47, 300, 1), (96, 96, 2), (640, 480, 4), (8192, 8192, 5)]
    {
        assert_eq!(levels(width, height), expected, "{width}×{height}");
    }
}

#[test]
fn a_stored_map_is_the_same_and_a_damaged_one_is_refused() {
    let recording = recording(&[MOVING, STILL]);
    let map = maps(&recording).remove(0);
    let mut stored = postcard::to_allocvec(&map).unwrap();
    assert!(2 * stored.len() < map.bytes(), "{} of {} bytes", stored.len(), map.bytes());
    assert_eq!(postcard::from_bytes::<FlowMap>(&stored).unwrap(), map);
    stored.truncate(stored.len() / 2);
    assert!(postcard::from_bytes::<FlowMap>(&stored).is_err());
}
