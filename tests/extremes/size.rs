//! Size: from one pixel to 8192×4320, from one camera to 256, from 2 frames to thousands, 100,000
//! edges. What is asserted is the truth of the scene, and that memory stays where it is. The largest
//! of each is in `cargo bench --bench growth -- largest memory`.

use crate::common::scores::rms;
use crate::common::swing::{RATE_HZ, Swing};
use crate::common::wall::{Scene, by_plane, field_of};
use crate::common::{assert_refused, peak, read_json, run, stlfr, text};
use crate::naive;
use nalgebra::{Point2, Vector2};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::interpolation::{EdgeFeature, SyncMethod, edge_set, morph_warp};
use stlfr::lumigraph::{BlendOptions, Plane, Proxy, Source, blend};
use stlfr::offset::{self, Offsets};
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::random::Random;
use stlfr::registration::{Frame, FrameStore, RegistrationOptions, flow};
use tempfile::TempDir;

fn filmed(swing: &Swing) -> (TempDir, Arc<Capture>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    swing.film(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    (folder, capture)
}

fn true_offsets(capture: &Capture, swing: &Swing) -> Offsets {
    let mut offsets = Offsets::known(capture);
    for (c, camera) in offsets.cameras.iter_mut().enumerate() {
        camera.offset_s = Some(swing.delay_frames(c) / RATE_HZ);
    }
    offsets
}

/// A wall that rests looks the same at any instant, from any place that knows its depth.
#[test]
fn images_of_a_pixel_and_more() {
    for (width, height) in [(1, 1), (2, 1), (1, 3), (3, 2), (5, 5), (16, 9), (31, 33), (1, 700)] {
        // Its print is so large that neighbouring pixels hardly differ.
        let swing = Swing {
            width,
            height,
            print: 40.0,
            disparity_px: 1.0,
            synchronized: true,
            period: 1,
            ..Swing::default()
        };
        let (_folder, capture) = filmed(&swing);
        let field = field_of(&capture, Offsets::known(&capture));
        let (place, time_s) = ([0.3, 0.0], 1.5 / RATE_HZ);
        let truth = swing.image(place, 0.0);
        let options = by_plane(swing.depth_m());
        let seen = field.view(&swing.camera(place), time_s, &options).expect("a view");
        let pixels = seen.image.data().iter().zip(truth.data()).zip(&seen.coverage);
        assert!(seen.coverage.iter().any(|c| *c), "{width}×{height}");
        for ((found, truth), _) in pixels.filter(|(_, covered)| **covered) {
            // Beyond its border a camera repeats it: a third of a pixel's difference.
            assert!((found - truth).abs() < 0.03, "{width}×{height}: {found} {truth}");
        }
        let refined = options.with_sync(SyncMethod::Refined);
        let own = field.synchronized(1, time_s, &refined).expect("an image").image.clone();
        for (found, truth) in own.data().iter().zip(swing.truth(1, 0.0).data()) {
            assert!((found - truth).abs() <= 1.0 / 255.0, "{width}×{height}");
        }
    }
}

/// Each step as large as the largest images are wide, and a row or a few high, so that all indices
/// and coordinates reach the ends.
#[test]
fn rows_8192_pixels_wide() {
    let swing = Swing {
        width: 8192,
        height: 40,
        print: 2.0,
        disparity_px: 20.0,
        synchronized: true,
        frames: 4,
        ..Swing::default()
    };
    let (_folder, capture) = filmed(&swing);
    let field = field_of(&capture, Offsets::known(&capture));
    let at = 1.5;
    for sync in [SyncMethod::Triangulation, SyncMethod::EdgeMorph, SyncMethod::Refined] {
        let options = RenderOptions { sync, ..RenderOptions::default() };
        let found = field.synchronized(1, at / RATE_HZ, &options).expect("an image").image.clone();
        let off = rms(&found, &swing.truth(1, at), 8);
        assert!(off < 0.02, "{sync:?}: {off}");
    }
    // From between two cameras, at their very images' depth: pixel by pixel to the last column.
    let images = [0, 1, 2].map(|c| swing.truth(c, at));
    let cameras = [0, 1, 2].map(|c| swing.camera(swing.place(c)));
    let sources: Vec<Source> =
        cameras.iter().zip(&images).map(|(c, i)| Source::new(c, i)).collect();
    let target = swing.camera([0.5, 0.0]);
    let depth = Proxy::Plane(Plane::fronto_parallel(&target, swing.depth_m())).depth_map(&target);
    let seen = blend(&sources, &depth, &target, &BlendOptions::default());
    let off = rms(&seen.image, &swing.image([0.5, 0.0], at), 8);
    assert!(off < 1e-3, "{off}");

    // Flow at the far end is as precise as at the near one.
    let registration = RegistrationOptions::default();
    let [a, b] = [1.0, 2.0].map(|t| Frame::new(swing.truth(1, t), &registration));
    let corners = a.corners(&registration);
    let starts: Vec<_> = corners.iter().map(|p| (*p, *p)).collect();
    let moved = moved_px(&swing, 1.0, 2.0);
    let mut errors = [Vec::new(), Vec::new()];
    for found in flow(&a, &b, &starts, &registration).into_iter().flatten() {
        let error = (found.target - found.source - moved).norm();
        errors[usize::from(found.source.x > 4096.0)].push(error);
    }
    for errors in &mut errors {
        errors.sort_by(f64::total_cmp);
        assert!(errors.len() > 500, "{}", errors.len());
        assert!(errors[errors.len() / 2] < 0.02, "{}", errors[errors.len() / 2]);
    }
}

/// The wall's way between two times in frames, by its own images' formula.
fn moved_px(swing: &Swing, from: f64, to: f64) -> Vector2<f64> {
    let angle = |t: f64| std::f64::consts::TAU * t / swing.period as f64;
    let radius = swing.print * 2.0 * swing.period as f64 / std::f64::consts::TAU;
    let at = |t: f64| Vector2::new(0.9 * angle(t).cos(), angle(t).sin()) * radius;
    at(to) - at(from)
}

#[test]
fn one_camera_to_sixty_four() {
    for (cameras, columns) in [(1, 1), (2, 2), (9, 3), (64, 8)] {
        let swing = Swing {
            width: 64,
            height: 48,
            cameras,
            columns,
            disparity_px: 2.0,
            frames: 4,
            ..Swing::default()
        };
        let (_folder, capture) = filmed(&swing);
        if cameras > 1 {
            let options = RenderOptions::default();
            let silent = Reporter::silent();
            let frames = FrameStore::new(capture.clone(), &options.registration);
            let found = offset::estimate(&frames, &options.offset, &silent);
            let found = found.expect("offsets").offsets;
            for (c, camera) in found.cameras.iter().enumerate() {
                let offset_s = camera.offset_s.expect("is known");
                let error = offset_s * RATE_HZ - swing.delay_frames(c);
                assert!(error.abs() < 0.05, "{cameras}: {camera:?}, off by {error} frame");
            }
        }
        let field = field_of(&capture, true_offsets(&capture, &swing));
        let at = 1.5;
        let camera = swing.reference();
        let own = field
            .synchronized(camera, at / RATE_HZ, &RenderOptions::default())
            .expect("an image")
            .image
            .clone();
        let off = rms(&own, &swing.truth(camera, at), 6);
        assert!(off < 0.02, "{cameras}: {off}");
        if cameras > 2 {
            let place = [0.4, 0.0];
            let seen = field
                .view(&swing.camera(place), at / RATE_HZ, &RenderOptions::default())
                .expect("a view");
            let off = rms(&seen.image, &swing.image(place, at), 8);
            assert!(off < 0.03, "{cameras}: {off}");
        }
    }
}

/// 256 images of one instant, blended into a view.
#[test]
fn two_hundred_and_fifty_six_cameras() {
    let swing = Swing { width: 64, height: 48, cameras: 256, columns: 16, ..Swing::default() };
    let cameras: Vec<_> = (0..256).map(|c| swing.camera(swing.place(c))).collect();
    let images: Vec<_> = (0..256).map(|c| swing.truth(c, 0.0)).collect();
    let sources: Vec<Source> =
        cameras.iter().zip(&images).map(|(c, i)| Source::new(c, i)).collect();
    // Between cameras in the middle and at a corner, and in a camera's place.
    for place in [[-0.4, 0.3], [-14.5, 7.2], [-3.0, 3.0]] {
        let target = swing.camera(place);
        let plane = Plane::fronto_parallel(&target, swing.depth_m());
        let depth = Proxy::Plane(plane).depth_map(&target);
        for count in [1, 3, 256] {
            let options = BlendOptions { cameras: count, ..BlendOptions::default() };
            let seen = blend(&sources, &depth, &target, &options);
            let off = rms(&seen.image, &swing.image(place, 0.0), 6);
            assert!(off < 0.01, "{place:?}, {count}: {off}");
        }
    }
}

#[test]
fn two_frames() {
    let swing = Swing { frames: 2, ..Swing::default() };
    let (_folder, capture) = filmed(&swing);
    let field = field_of(&capture, true_offsets(&capture, &swing));
    for at in [0.0, 0.5, 1.0] {
        let own = field
            .synchronized(1, at / RATE_HZ, &RenderOptions::default())
            .expect("an image")
            .image
            .clone();
        let off = rms(&own, &swing.truth(1, at), 6);
        assert!(off < 0.02, "{at}: {off}");
    }
}

/// The program over recordings of 60 and of 1200 frames, forty times a period: it holds as much
/// memory for both, and finds the same.
#[test]
fn memory_is_flat_over_frames() {
    let mut peaks = Vec::new();
    for frames in [60, 1200] {
        let swing =
            Swing { width: 128, height: 96, cameras: 2, columns: 2, frames, ..Swing::default() };
        let (folder, _) = filmed(&swing);
        let mut offsets = stlfr();
        offsets.args(["--quiet", "offsets"]).arg(folder.path());
        let mut render = stlfr();
        let last = (frames - 2) as f64 / RATE_HZ;
        render.args(["--quiet", "render"]).arg(folder.path()).args(["--like", "cam0", "--times"]);
        render.arg(format!("0.1:{last}:60")).arg("-o").arg(folder.path().join("out/%d.png"));
        let runs = [peak::run(&mut offsets), peak::run(&mut render)];
        assert!(runs.iter().all(|run| run.status.success()), "{runs:?}");
        peaks.push(runs.map(|run| run.peak_mib));
        let found = read_json(&folder.path().join("offsets.json"));
        let offset_s = found["cameras"][1]["offset_s"].as_f64().expect("is known");
        let error = offset_s * RATE_HZ - swing.delay_frames(1);
        assert!(error.abs() < 0.01, "{frames}: {error}");
    }
    let [short, long] = peaks[..] else { panic!("two recordings") };
    for (short, long) in short.into_iter().zip(long) {
        // Twenty times the frames: of each it holds the time, the name and the activity.
        assert!(long < short + 16.0, "{short} MiB, {long} MiB");
    }
}

#[test]
fn a_hundred_thousand_edges() {
    let (w, h) = (4096, 2160);
    let mut random = Random::new(1);
    // A turn, of which every edge shows its own part.
    let moved = |p: Point2<f64>| Vector2::new(-0.002 * (p.y - 1080.0), 0.002 * (p.x - 2048.0));
    let features: Vec<EdgeFeature> = (0..34_000)
        .map(|_| {
            let at = [random.in_range(1.0, w as f64 - 1.0), random.in_range(1.0, h as f64 - 1.0)];
            let target = Point2::from(at);
            EdgeFeature { source: target + moved(target), other: target - moved(target), target }
        })
        .collect();
    let edges = edge_set(&features, &[], w, h);
    assert!(edges.len() > 100_000, "{}", edges.len());
    let warp = morph_warp(&edges, [w, h], 4.0, 256);
    for k in [0, 1000, 33_333] {
        // A grid point next to a feature.
        let p = features[k].target;
        let (x, y) = (p.x as usize / 256 * 256, p.y as usize / 256 * 256);
        let at = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
        let found = Point2::from(warp.source[y * w + x]).cast::<f64>();
        let exact = naive::morph(&edges, at, 4.0).expect("there are edges");
        let bound_px = 0.01 + naive::MORPH_TOLERANCE_PX;
        assert!((found - exact).norm() < bound_px, "{at}: {found} {exact}");
        assert!(x == 0 || y == 0 || (found - at - moved(at)).norm() < 0.5, "{at}: {found}");
    }
}

/// From far away, the scene is smaller than a pixel.
#[test]
fn a_view_from_far_away_is_no_full_picture() {
    let scene = Scene { shared: [true; 3], ..Scene::default() };
    let folder = scene.film();
    let (capture, out) = (text(folder.path()), folder.path().join("out.png"));
    let file = folder.path().join("view.json");
    for far_m in [1e3, 1e6, 1e9, 1e12, 1e13, 1e155] {
        for center_m in [[0.0, 0.0, -far_m], [far_m, 0.0, 0.0], [0.0, far_m, -far_m]] {
            std::fs::write(&file, scene.camera(center_m).to_string()).unwrap();
            for proxy in ["plane", "mesh", "depth"] {
                let arguments = ["--camera", text(&file), "--time", "0.05", "-o", text(&out)];
                let command = ["-q", "render", capture, "--proxy", proxy];
                let output = run(&[&command[..], &arguments].concat());
                if output.status.success() {
                    let image = image::open(&out).unwrap().into_rgba16();
                    let seen = image.pixels().filter(|pixel| pixel[3] > 0).count();
                    assert!(far_m < 1e4 && seen <= 9, "{far_m:e}, {proxy}: {seen} pixels");
                } else if far_m <= 1e12 {
                    assert_refused(&output, 2, "no camera sees any pixel of this view");
                } else {
                    assert_refused(&output, 2, "translation: must be within 1e12 of 0");
                }
                let _ = std::fs::remove_file(&out);
            }
        }
    }
}
