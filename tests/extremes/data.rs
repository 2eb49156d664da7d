//! Degenerate data: what the formulas give for next to no input.
//!
//! Fast implementations are compared with [`naive`](crate::naive) as well.

use crate::common::edit;
use crate::common::wall::{
    FRAME_S, H, Scene, W, by_plane, by_proxy, estimate, estimate_by, field_of, open, view,
};
use crate::naive;
use nalgebra::{Matrix2, Point2, Point3, Vector2};
use stlfr::camera::Camera;
use stlfr::interpolation::{
    Edge, EdgeFeature, SyncMethod, Warp, edge_set, morph_warp, real_edges, triangulated,
};
use stlfr::light_field::{LightField, RenderError};
use stlfr::lumigraph::{DepthEdges, Mesh, Plane, Proxy};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, write_image};
use stlfr::registration::{FlowDirection, Pyramid, RegistrationOptions, Track, neighbor_consensus};

/// Half a step of 8 bits and its rounding: the same picture.
const STEP: f32 = 1.0 / 255.0;

/// A feature that is at a place at the instant, and came from `moved` beside it.
fn feature(at: [f64; 2], moved: [f64; 2]) -> EdgeFeature {
    let target = Point2::from(at);
    let source = target + Vector2::from(moved);
    EdgeFeature { source, other: target - Vector2::from(moved), target }
}

fn edge(a: EdgeFeature, b: EdgeFeature, mean_fitness: Option<f64>) -> Edge {
    Edge { ends: [a, b], mean_fitness }
}

/// The warp at every pixel, and that it is the formula's to within the tolerance of clusters: on its grid's
/// points, with a grid of 1 everywhere. Returns the latter.
#[track_caller]
fn morphed(edges: &[Edge], boost: f64, bound_px: f64) -> Vec<Point2<f64>> {
    let mut all = Vec::new();
    let bound_px = bound_px + naive::MORPH_TOLERANCE_PX;
    for grid_px in [4, 1] {
        let warp = morph_warp(edges, [W, H], boost, grid_px);
        all = warp.source.iter().map(|s| Point2::from(*s).cast::<f64>()).collect();
        for (k, found) in all.iter().enumerate() {
            let (x, y) = (k % W, k / W);
            if x % grid_px != 0 || y % grid_px != 0 {
                continue;
            }
            let at = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            let exact = naive::morph(edges, at, boost).unwrap_or(at);
            let apart = (found - exact).norm();
            assert!(apart <= bound_px, "{at}: {found}, must be {exact}: {apart}, {boost}");
        }
    }
    all
}

fn at_pixel(warp: &[Point2<f64>], x: usize, y: usize) -> Vector2<f64> {
    warp[y * W + x] - Point2::new(x as f64 + 0.5, y as f64 + 0.5)
}

fn triangulation_warp(features: &[EdgeFeature], width: usize, height: usize) -> Warp {
    let triangles = triangulated(features.iter().map(|f| f.source), width, height);
    stlfr::interpolation::triangulation_warp(&triangles, features, width, height)
}

#[test]
fn no_feature_leaves_the_image_as_it_is() {
    let edges = edge_set(&[], &[], W, H);
    let warp = morphed(&edges, 4.0, 1e-4);
    for (x, y) in (0..H).flat_map(|y| (0..W).map(move |x| (x, y))) {
        assert!(at_pixel(&warp, x, y).norm() < 1e-4);
    }
    let flat = triangulation_warp(&[], W, H);
    assert_eq!(flat.source[0], [0.5, 0.5]);
}

#[test]
fn one_feature_and_two_take_their_own_places_along() {
    let one = [feature([30.5, 20.5], [3.0, -2.0])];
    let two = [one[0], feature([60.5, 50.5], [-4.0, 1.0])];
    for features in [&one[..], &two[..]] {
        let edges = edge_set(features, &[], W, H);
        // Edges end in a feature; on it only they count, and all agree.
        let warp = morphed(&edges, 4.0, 1e-3);
        let triangles = triangulation_warp(features, W, H);
        for f in features {
            let (x, y) = (f.target.x as usize, f.target.y as usize);
            assert!((at_pixel(&warp, x, y) - (f.source - f.target)).norm() < 1e-3);
            let found = Point2::from(triangles.source[y * W + x]).cast::<f64>();
            assert!((found - f.source).norm() < 1e-3, "{found}");
        }
        // The corners stay where they are.
        assert!(at_pixel(&warp, 0, 0).norm() < 0.5 && at_pixel(&warp, W - 1, H - 1).norm() < 0.5);
    }
}

#[test]
fn one_and_two_features_show_no_offset_and_no_shape() {
    let folder = Scene::default().film();
    let capture = open(&folder);
    for count in [1, 2] {
        let mut options = RenderOptions::default();
        options.registration.max_corners = count;
        let offsets = estimate_by(&capture, &options);
        for camera in [&offsets.cameras[0], &offsets.cameras[2]] {
            let reason = camera.reason.as_deref().expect("is unknown");
            assert!(reason.contains("too few features"), "{reason}");
        }
        // With clocks that are known, a frame is as it was filmed.
        let field = LightField::new(capture.clone(), Offsets::known(&capture));
        for &sync in SyncMethod::ALL {
            let filmed = capture.read_frame(1, 2).expect("a frame");
            let options = RenderOptions { sync, ..RenderOptions::default() };
            let found = field
                .synchronized(1, 2.0 * FRAME_S, &options)
                .expect("a frame's time")
                .image
                .clone();
            assert_eq!(found.data(), filmed.data(), "{sync:?}");
        }
    }
}

#[test]
fn all_features_on_one_line() {
    let line: Vec<EdgeFeature> =
        (0..9).map(|k| feature([8.5 + 10.0 * f64::from(k), 36.5], [0.0, 2.0])).collect();
    let edges = edge_set(&line, &[], W, H);
    assert!(edges.len() >= 8 + 4, "between neighbours, and around the image: {}", edges.len());
    let warp = morphed(&edges, 4.0, 1e-3);
    for x in 8..=88 {
        // Edges on the line outweigh each of the others, which are 5 px away or more, by 1e4.
        assert!((at_pixel(&warp, x, 36) - Vector2::new(0.0, 2.0)).norm() < 1e-2, "on the line");
    }
    // Points on a line leave a plane free to turn about it: it goes through them all the same.
    let camera = view(&Scene::default().camera([0.0; 3]));
    let points: Vec<Point3<f64>> =
        (0..20).map(|k| Point3::new(0.05 * f64::from(k) - 0.5, 0.1, 2.0)).collect();
    assert_depth(&points, &camera, 2.0);
}

/// Both proxies of points at one depth are there at that depth, all over the view.
#[track_caller]
fn assert_depth(points: &[Point3<f64>], camera: &Camera, depth_m: f32) {
    let plane = Plane::fit(points, camera).map(Proxy::Plane);
    let mesh = Mesh::build(points, camera, DepthEdges::default()).map(Proxy::Mesh);
    assert!(plane.is_some());
    // A mesh may want more support than a degenerate set has; an invented one is worse than none.
    for proxy in [plane, mesh].into_iter().flatten() {
        let map = proxy.depth_map(camera);
        for z in map.data() {
            // The mesh's back plane stands a thousandth behind all points.
            assert!((z / depth_m - 1.0).abs() < 2e-3, "{z} {proxy:?}");
        }
    }
}

#[test]
fn all_features_in_one_place() {
    let one = feature([40.5, 30.5], [2.0, 1.0]);
    let (single, many) = (vec![one], vec![one; 50]);
    let of = |features: &[EdgeFeature]| edge_set(features, &[], W, H);
    assert_eq!(of(&single), of(&many), "of vertices at one place the first stays");
    morphed(&of(&many), 4.0, 1e-3);
    assert_eq!(triangulation_warp(&single, W, H), triangulation_warp(&many, W, H));
    let camera = view(&Scene::default().camera([0.0; 3]));
    assert_depth(&[Point3::new(0.1, 0.05, 2.0); 30], &camera, 2.0);
}

/// A recording of noise, new in every frame: each correspondence in it is wrong.
#[test]
fn all_outliers() {
    let scene = Scene::default();
    let folder = scene.film();
    let mut random = Random::new(5);
    for (camera, frame) in (0..3).flat_map(|c| (0..scene.frames).map(move |k| (c, k))) {
        let data = (0..W * H).map(|_| random.unit() as f32).collect();
        let path = folder.path().join(format!("cam{camera}/{frame}.png"));
        write_image(&path, &Image::from_data(W, H, 1, data), None, BitDepth::Eight).unwrap();
    }
    let capture = open(&folder);
    let offsets = estimate(&capture);
    for camera in [&offsets.cameras[0], &offsets.cameras[2]] {
        assert!(camera.offset_s.is_none() && camera.reason.is_some(), "{camera:?}");
    }
    let field = field_of(&capture, Offsets::known(&capture));
    let target = view(&scene.camera([0.02, 0.0, 0.0]));
    let refused = field.view(&target, 1.5 * FRAME_S, &RenderOptions::default());
    assert!(matches!(refused, Err(RenderError::NoPoints)), "{:?}", refused.err());

    // Tracks that move like none of their neighbours are dropped; those that agree stay.
    let options = RegistrationOptions::default();
    let track = |at: Point2<f64>, motion: Vector2<f64>| Track {
        direction: FlowDirection::Both,
        before: None,
        earlier: at,
        later: at + motion,
        after: None,
        deformation: Matrix2::identity(),
        residual: 0.0,
        forward_backward_error_px: 0.0,
    };
    let mut wild = Vec::new();
    for _ in 0..200 {
        let at = Point2::new(random.in_range(0.0, 96.0), random.in_range(0.0, 72.0));
        wild.push(track(at, Vector2::new(random.signed(), random.signed()) * 40.0));
    }
    let passed = neighbor_consensus(&wild, &options).into_iter().filter(|k| *k).count();
    // Of a track's 36 neighbours one agrees by chance, to the fifth of its motion that may differ;
    // two must.
    assert!(passed <= 60, "{passed} of 200 by chance");
    for t in &mut wild {
        t.later = t.earlier + Vector2::new(30.0, 0.0);
    }
    assert!(neighbor_consensus(&wild, &options).into_iter().all(|k| k));
}

#[test]
fn all_offsets_equal() {
    for shift in [0.0, 0.35] {
        let s = shift * FRAME_S;
        let scene = Scene { offsets_s: [s, 0.0, s], ..Scene::default() };
        let offsets = estimate(&open(&scene.film()));
        let [a, b] = [0, 2].map(|c| offsets.cameras[c].offset_s.expect("is known") / FRAME_S);
        assert!((a - shift).abs() < 0.01 && (b - shift).abs() < 0.01, "{a} {b}");
        assert!((a - b).abs() < 0.01, "{a} {b}");
    }
}

#[test]
fn constant_saturated_and_black_images() {
    for value in [0.5, 1.0, 0.0] {
        let scene = Scene::default();
        let folder = scene.film();
        let flat = Image::filled(W, H, 1, value);
        for (camera, frame) in (0..3).flat_map(|c| (0..scene.frames).map(move |k| (c, k))) {
            let path = folder.path().join(format!("cam{camera}/{frame}.png"));
            write_image(&path, &flat, None, BitDepth::Eight).unwrap();
        }
        let capture = open(&folder);
        for camera in &estimate(&capture).cameras {
            let unknown = camera.reason.as_deref().is_some_and(|r| r.contains("too few features"));
            assert_eq!(unknown, camera.id != "cam1", "{value}: {camera:?}");
        }
        let field = field_of(&capture, Offsets::known(&capture));
        let (target, time_s) = (view(&scene.camera([0.02, 0.0, 0.0])), 1.6 * FRAME_S);
        for &method in ProxyMethod::ALL {
            // Nothing shows where anything is,
            let refused = field.view(&target, time_s, &by_proxy(method));
            assert!(matches!(refused, Err(RenderError::NoPoints)), "{:?}", refused.err());
        }
        // but at whatever depth, it looks the same.
        for &sync in SyncMethod::ALL {
            let options = by_plane(2.0).with_sync(sync);
            let own = field.synchronized(1, time_s, &options).unwrap().image.clone();
            let seen = field.view(&target, time_s, &options).unwrap();
            let covered = seen.image.data().iter().zip(&seen.coverage).filter(|(_, c)| **c);
            for found in own.data().iter().chain(covered.map(|(v, _)| v)) {
                assert!((found - value).abs() <= 0.5 * STEP + 1e-6, "{sync:?}: {found}");
            }
        }
    }
}

/// Eq. (6) where the image has no gradient, exactly and fast; and everywhere else.
#[test]
fn zero_gradient_in_equation_6() {
    let flat = Image::filled(W, H, 1, 0.5);
    let mut step = flat.clone();
    for (k, v) in step.data_mut().iter_mut().enumerate() {
        // A step at x = 48 above the middle, nothing below it.
        *v = if k % W >= 48 && k / W < H / 2 { 0.9 } else { 0.2 };
    }
    let noise = {
        let mut random = Random::new(9);
        Image::from_data(W, H, 1, (0..W * H).map(|_| random.unit() as f32).collect())
    };
    let max_length_px = 60.0;
    let (a, b) = (Point2::new(48.0, 5.0), Point2::new(48.0, 25.0));
    let below = [Point2::new(48.0, 45.0), Point2::new(48.0, 65.0)];
    let across = [Point2::new(48.0, 20.0), Point2::new(48.0, 60.0)];
    assert_eq!(naive::fitness(&flat, a, b), (0.0, 0.0));
    assert_eq!(naive::fitness(&step, below[0], below[1]), (0.0, 0.0));
    assert_eq!(naive::fitness(&step, across[0], across[1]).0, 0.0, "the minimum along it");

    let mut edges = 0;
    let mut random = Random::new(10);
    for image in [&flat, &step, &noise] {
        let pyramid = Pyramid::new(image, 1, 9);
        let level = &pyramid.levels[0];
        for n in 0..300 {
            let place = |r: &mut Random| {
                Point2::new(r.in_range(1.0, W as f64 - 1.0), r.in_range(1.0, H as f64 - 1.0))
            };
            let [p, q] = match n {
                0 => [a, b],
                1 => below,
                2 => across,
                _ => [place(&mut random), place(&mut random)],
            };
            if (q - p).norm() < 1.0 || (q - p).norm() > max_length_px {
                continue;
            }
            let ends = [p, q].map(|p| EdgeFeature { source: p, other: p, target: p });
            let found = real_edges(&ends, level, level, max_length_px);
            let (min, mean) = naive::fitness(image, p, q);
            if (min - naive::MIN_FITNESS).abs() > 1e-6 {
                assert_eq!(found.len(), usize::from(min > naive::MIN_FITNESS), "{p} {q}");
            }
            for edge in found {
                edges += 1;
                assert!((edge.mean_fitness - mean).abs() < 1e-6, "{} {mean}", edge.mean_fitness);
            }
        }
    }
    assert!(edges > 30, "{edges}");
}

/// Edges all over the image with the given fitness, moving with a place's own motion.
fn scattered(random: &mut Random, fitness: impl Fn(usize) -> Option<f64>) -> Vec<Edge> {
    let place = |r: &mut Random| {
        let at = [r.in_range(0.0, W as f64), r.in_range(0.0, H as f64)];
        feature(at, [3.0 * (at[1] * 0.1).sin(), 2.0 * (at[0] * 0.08).cos()])
    };
    (0..40).map(|k| edge(place(random), place(random), fitness(k))).collect()
}

#[test]
fn f_max_equals_f_min_in_equation_8() {
    let alike = scattered(&mut Random::new(11), |_| Some(0.37));
    let virtual_ones = scattered(&mut Random::new(11), |_| None);
    let boosted = morphed(&alike, 32.0, 2e-3);
    let unboosted = morphed(&virtual_ones, 32.0, 2e-3);
    assert_eq!(boosted, unboosted, "a range of nothing boosts nothing");
    // A single real edge is both the fittest and the least fit.
    let one = scattered(&mut Random::new(11), |k| (k == 3).then_some(0.2));
    assert_eq!(morphed(&one, 32.0, 2e-3), morphed(&virtual_ones, 32.0, 2e-3));
}

#[test]
fn a_pixel_on_the_line_in_equation_7() {
    let upright = edge(feature([20.5, 10.5], [2.0, 0.0]), feature([20.5, 60.5], [2.0, 0.0]), None);
    let level = edge(feature([10.5, 40.5], [0.0, -4.0]), feature([80.5, 40.5], [0.0, -4.0]), None);
    let warp = morphed(&[upright, level], 0.0, 2e-3);
    // From the other edge's 20 px it outweighs by 1e6.
    assert!((at_pixel(&warp, 20, 20) - Vector2::new(2.0, 0.0)).norm() < 2e-3);
    assert!((at_pixel(&warp, 60, 40) - Vector2::new(0.0, -4.0)).norm() < 2e-3);
    // On both, both count the same.
    assert!((at_pixel(&warp, 20, 40) - Vector2::new(1.0, -2.0)).norm() < 1e-3);
}

#[test]
fn boosts_from_0_to_32() {
    let mut random = Random::new(12);
    let edges = scattered(&mut random, |k| (k % 3 == 0).then_some(0.1 + 0.02 * k as f64));
    let shifted: Vec<Edge> = edges
        .iter()
        .map(|e| Edge { ends: e.ends.map(|f| feature(f.target.into(), [3.0, -2.0])), ..*e })
        .collect();
    for boost in [0.0, 4.0, 10.0, 32.0] {
        morphed(&edges, boost, 6e-3);
        let warp = morphed(&shifted, boost, 1e-3);
        for (x, y) in [(0, 0), (50, 40), (95, 71)] {
            let moved = at_pixel(&warp, x, y);
            assert!((moved - Vector2::new(3.0, -2.0)).norm() < 1e-3, "whatever the weights");
        }
    }
}

#[test]
fn edges_of_zero_length_and_of_the_images() {
    let mut random = Random::new(13);
    let some = scattered(&mut random, |k| (k % 4 == 0).then_some(0.1 + 0.01 * k as f64));
    let point = feature([33.0, 21.0], [9.0, 9.0]);
    let mut with_points = some.clone();
    with_points.extend([edge(point, point, Some(0.2)); 20]);
    // No length in the source frame alone is none either.
    let collapsed = EdgeFeature { source: point.source, ..feature([60.0, 50.0], [0.0; 2]) };
    with_points.push(edge(point, collapsed, None));
    let (w, h) = (W as f64, H as f64);
    let still = |x: f64, y: f64| feature([x, y], [0.0; 2]);
    let sides = [
        edge(still(0.0, 0.0), still(w, 0.0), None),
        edge(still(0.0, 0.0), still(w, h), Some(0.15)),
        edge(still(0.0, h), still(w, 0.0), None),
    ];
    for boost in [0.0, 4.0, 32.0] {
        assert_eq!(morphed(&with_points, boost, 1e-2), morphed(&some, boost, 1e-2));
        let long = [&some[..], &sides[..]].concat();
        morphed(&long, boost, 1e-2);
        // Alone, they hold everything where it is.
        let warp = morphed(&sides, boost, 1e-4);
        assert!(at_pixel(&warp, 7, 65).norm() < 1e-4);
    }
}

#[test]
fn a_view_at_each_input_camera_at_a_frames_time_is_that_frame() {
    let scene = Scene { offsets_s: [0.0; 3], shared: [true; 3], ..Scene::default() };
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, Offsets::known(&capture));
    for cameras in [1, 3, 8] {
        for &method in ProxyMethod::ALL {
            let mut options = by_proxy(method);
            options.blend.cameras = cameras;
            for (c, filmed) in capture.cameras.iter().enumerate() {
                let seen = field.view(&filmed.camera, 2.0 * FRAME_S, &options).unwrap();
                let frame = capture.read_frame(c, 2).unwrap();
                assert!(seen.coverage.iter().all(|c| *c));
                for (a, b) in seen.image.data().iter().zip(frame.data()) {
                    assert!((a - b).abs() <= STEP, "{}: {a} {b}", filmed.id);
                }
            }
        }
    }
}

#[test]
fn one_camera_blended_from_any_number() {
    let scene = Scene { offsets_s: [0.0; 3], shared: [true; 3], ..Scene::default() };
    let folder = scene.film();
    edit(folder.path(), |json| json["cameras"].as_array_mut().expect("a list").truncate(1));
    edit(folder.path(), |json| json["reference"] = "cam0".into());
    let capture = open(&folder);
    let field = field_of(&capture, Offsets::known(&capture));
    let target = view(&scene.camera([-0.03, 0.0, 0.0]));
    let seen = [1, 2, 3, 256].map(|cameras| {
        let mut options = by_plane(2.0);
        options.blend.cameras = cameras;
        field.view(&target, FRAME_S, &options).unwrap().image
    });
    // The wall is a plane, and one camera sees most of it.
    let truth = scene.image([-0.03, 0.0, 0.0], FRAME_S);
    for image in &seen {
        assert_eq!(image, &seen[0], "one camera is blended");
        for (x, y) in (8..H - 8).flat_map(|y| (8..W - 8).map(move |x| (x, y))) {
            // Half-way between pixels, the cubic loses some of the finest waves.
            assert!((image.pixel(x, y)[0] - truth.pixel(x, y)[0]).abs() < 0.05, "{x} {y}");
        }
    }
}
