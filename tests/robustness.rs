//! Bad and extreme input: refused in one sentence, or worked with; never a panic, a hang, or a
//! number that is not finite. Every find is a test with a name.

mod common;

use common::wall::{
    FOCAL_PX, FRAME_S, H, Scene, W, edit, estimate, open, texture, view, write_json,
};
use common::{assert_refused, run, stderr};
use serde_json::{Value, json};
use std::path::Path;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{LightField, RenderError};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::ViewOptions;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;
use stlfr::raster::{BitDepth, write_image};
use stlfr::registration::RegistrationOptions;
use tempfile::TempDir;

#[track_caller]
fn assert_offsets(scene: &Scene, found: &Offsets, tolerance_frames: f64) {
    let reference_s = scene.offsets_s[1];
    for (camera, truth_s) in found.cameras.iter().zip(scene.offsets_s) {
        let error = (camera.offset_s.expect(&camera.id) - (truth_s - reference_s)) / FRAME_S;
        assert!(error.abs() <= tolerance_frames, "{}: {error} frame", camera.id);
    }
}

#[track_caller]
fn assert_unknown(found: &Offsets, cameras: &[usize], words: &str) {
    for &c in cameras {
        let camera = &found.cameras[c];
        assert_eq!((camera.offset_s, camera.std_err_s), (None, None), "{camera:?}");
        assert!(camera.reason.as_ref().unwrap().contains(words), "{camera:?}");
    }
}

#[test]
fn offsets_of_the_wall_are_found() {
    let scene = Scene::default();
    let folder = scene.film();
    assert_offsets(&scene, &estimate(&open(&folder)), 0.01);
}

#[test]
fn shared_and_own_clocks_mix() {
    // With the reference, camera 1; then two others of one clock that is not the reference's.
    let with = Scene {
        offsets_s: [0.0, 0.0, 0.4 * FRAME_S],
        shared: [true, true, false],
        ..Scene::default()
    };
    let folder = with.film();
    let found = estimate(&open(&folder));
    assert_offsets(&with, &found, 0.01);
    assert_eq!((found.cameras[0].offset_s, found.cameras[0].std_err_s), (Some(0.0), Some(0.0)));
    let without = Scene {
        offsets_s: [0.3 * FRAME_S, 0.0, 0.3 * FRAME_S],
        shared: [true, false, true],
        ..Scene::default()
    };
    let folder = without.film();
    let found = estimate(&open(&folder));
    assert_offsets(&without, &found, 0.01);
    assert_eq!(found.cameras[0].offset_s, found.cameras[2].offset_s);
}

#[test]
fn motion_along_the_epipolar_lines_shows_no_offset() {
    let scene = Scene { velocity: [1.0, 0.0], ..Scene::default() };
    let folder = scene.film();
    assert_unknown(&estimate(&open(&folder)), &[0, 2], "the motion runs along them");
}

#[test]
fn what_rests_shows_no_offset() {
    let scene = Scene { velocity: [0.0; 2], ..Scene::default() };
    let folder = scene.film();
    assert_unknown(&estimate(&open(&folder)), &[0, 2], "too few features move");
}

#[test]
fn blank_frames_show_no_offset_and_no_view() {
    for value in [0.0, 0.5, 1.0] {
        let scene = Scene { frames: 3, ..Scene::default() };
        let folder = scene.film();
        let blank = Image::filled(W, H, 1, value);
        for (c, k) in (0..9).map(|n| (n / 3, n % 3)) {
            let path = folder.path().join(format!("cam{c}/{k}.png"));
            write_image(&path, &blank, None, BitDepth::Eight).unwrap();
        }
        let capture = open(&folder);
        let offsets = estimate(&capture);
        assert_unknown(&offsets, &[0, 2], "too few features can be followed");
        let field = LightField::new(capture, offsets, &RegistrationOptions::default());
        let image = field.synchronized(1, 0.03, &ViewOptions::default()).unwrap();
        assert!(image.data().iter().all(|v| (v - value).abs() < 0.01));
        let lost =
            field.view(&view(&scene.camera([0.01, 0.0, 0.0])), 0.03, &ViewOptions::default());
        assert!(matches!(lost, Err(RenderError::NoPoints)), "{lost:?}");
    }
}

#[test]
fn recordings_that_do_not_overlap_are_named() {
    let folder = Scene::default().film();
    edit(&folder, |j| j["cameras"][0]["clock"]["first_s"] = json!(100.0));
    assert_unknown(&estimate(&open(&folder)), &[0], "filmed at other times");
}

#[test]
fn cameras_in_one_place_have_no_offset() {
    let folder = Scene::default().film();
    edit(&folder, |j| {
        for c in [0, 2] {
            j["cameras"][c]["cam_from_world"] = j["cameras"][1]["cam_from_world"].clone();
        }
    });
    assert_unknown(&estimate(&open(&folder)), &[0, 2], "another place");
}

#[test]
fn one_frame_a_camera_is_the_same_at_any_time() {
    let scene = Scene { frames: 1, offsets_s: [0.0; 3], ..Scene::default() };
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = estimate(&capture);
    assert_unknown(&offsets, &[0, 2], "one frame");
    let field = LightField::new(capture, offsets, &RegistrationOptions::default());
    let target = view(&scene.camera([0.02, 0.0, 0.0]));
    let first = field.view(&target, 0.0, &ViewOptions::default()).unwrap();
    assert!(first.coverage.iter().all(|c| *c));
    assert_eq!(field.view(&target, -1e6, &ViewOptions::default()).unwrap(), first);
    assert_eq!(
        field.synchronized(2, 9.0, &ViewOptions::default()).unwrap(),
        scene_image(&folder, 2, 0)
    );
}

fn scene_image(folder: &TempDir, camera: usize, frame: usize) -> Image {
    open(folder).read_frame(camera, frame).unwrap()
}

#[test]
fn a_view_without_a_feature_in_it_has_a_depth() {
    let scene = Scene::default();
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = estimate(&capture);
    let field = LightField::new(capture, offsets, &RegistrationOptions::default());
    let mut pixel = scene.camera([0.02, 0.0, 0.0]);
    (pixel["width"], pixel["height"]) = (json!(1), json!(1));
    pixel["params"] = json!([FOCAL_PX, FOCAL_PX, 0.5, 0.5]);
    let rendered = field.view(&view(&pixel), 1.5 * FRAME_S, &ViewOptions::default()).unwrap();
    let time_s = 1.5 * FRAME_S;
    let truth = texture(0.02 - 0.3 * time_s, -time_s);
    assert!((f64::from(rendered.image.data()[0]) - truth).abs() < 0.05);
    // Away from the scene there is none.
    let mut away = scene.camera([0.0; 3]);
    away["cam_from_world"]["rotation_wxyz"] = json!([0, 0, 1, 0]);
    assert!(matches!(
        field.view(&view(&away), time_s, &ViewOptions::default()),
        Err(RenderError::NothingSeen)
    ));
}

#[test]
fn odd_views_are_rendered_or_refused() {
    let scene = Scene::default();
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = Offsets::known(&capture);
    let lens = [-0.3, 0.1, 1e-3, 1e-3];
    let mut views = Vec::new();
    for focal in [1e-300, 1e-3, 1.0, 1e3, 1e9, 1e300] {
        let mut v = scene.camera([0.01, 0.0, 0.0]);
        v["params"] = json!([focal, focal, 48.0, 36.0]);
        views.push(v.clone());
        v["model"] = json!("OPENCV");
        v["params"] = json!([focal, focal, 48.0, 36.0, lens[0], lens[1], lens[2], lens[3]]);
        views.push(v);
    }
    for distortion in [1e-300, -100.0, 1e9, 1e308] {
        let mut v = scene.camera([0.01, 0.0, 0.0]);
        v["model"] = json!("OPENCV");
        v["params"] = json!([100.0, 100.0, 48.0, 36.0, distortion, distortion, 0.1, distortion]);
        views.push(v);
    }
    for at in [[0.0, 0.0, -2.0], [0.0, 0.0, -50.0], [1e300, 0.0, 0.0], [0.0, 0.0, 1e6], [1e154; 3]]
    {
        let mut v = scene.camera([0.0; 3]);
        v["cam_from_world"]["translation"] = json!(at);
        views.push(v);
    }
    for (w, h) in [(1, 1), (1, 97), (513, 1), (5, 5)] {
        let mut v = scene.camera([0.01, 0.0, 0.0]);
        (v["width"], v["height"]) = (json!(w), json!(h));
        views.push(v);
    }
    for rung in [ProxyMethod::Plane, ProxyMethod::Mesh] {
        let mut options = RenderOptions::default();
        options.proxy.method = rung;
        let field = LightField::new(capture.clone(), offsets.clone(), &options.registration);
        for v in &views {
            match field.view(&view(v), 1.5 * FRAME_S, &options.view()) {
                Ok(r) => assert!(r.image.data().iter().all(|v| v.is_finite()), "{v}"),
                Err(RenderError::NoPoints | RenderError::NothingSeen) => {}
                Err(error) => panic!("{v}: {error}"),
            }
        }
    }
}

/// Numbers without a pattern, the same in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n
    }

    fn unit(&mut self) -> f64 {
        self.below(1 << 20) as f64 / f64::from(1 << 20)
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }
}

/// A capture of anything: sizes from one pixel, any kind of image, any clocks and poses.
fn anything(random: &mut Random) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let same_size = random.below(2) == 0;
    let mut size = [random.pick(&[1, 2, 5, 17, 33, 48]), random.pick(&[1, 3, 5, 16, 40])];
    let cameras: Vec<Value> = (0..1 + random.below(4))
        .map(|c| {
            if !same_size {
                size = [random.pick(&[1, 2, 5, 17, 33, 48]), random.pick(&[1, 3, 5, 16, 40])];
            }
            let [w, h] = size;
            let frames = 1 + random.below(4);
            let kind = random.below(4);
            let speed = [random.unit() * 4.0 - 2.0, random.unit() * 4.0 - 2.0];
            let channels = random.pick(&[1, 3]);
            for k in 0..frames {
                let data = (0..w * h * channels).map(|n| match kind {
                    0 => 0.0,
                    1 => random.unit() as f32,
                    2 => random.pick(&[0.0, 1.0]),
                    _ => {
                        let (x, y) = ((n / channels) % w, n / channels / w);
                        let at = |v: usize, s: f64| (v as f64 - s * k as f64) * 0.02;
                        texture(at(x, speed[0]), at(y, speed[1])) as f32
                    }
                });
                let image = Image::from_data(w, h, channels, data.collect());
                let path = folder.path().join(format!("cam{c}/{k}.png"));
                let depth = random.pick(&[BitDepth::Eight, BitDepth::Sixteen]);
                write_image(&path, &image, None, depth).unwrap();
            }
            let mut time_s = random.pick(&[0.0, 0.0, 0.01, -5.0]);
            let times: Vec<f64> = (0..frames)
                .map(|_| {
                    time_s += random.pick(&[0.04, 0.04, 0.041, 1e-6, 10.0]);
                    time_s
                })
                .collect();
            let focal = random.pick(&[10.0, 50.0, 50.0, 1e4]);
            let model = random.pick(&["PINHOLE", "OPENCV"]);
            let mut params = vec![focal, focal, w as f64 / 2.0, h as f64 / 2.0];
            if model == "OPENCV" {
                params.extend([random.unit() - 0.5, random.unit() - 0.5, 0.01, 0.0]);
            }
            let x = random.pick(&[0.0, 0.06 * c as f64, 0.06 * c as f64, 1e3]);
            json!({"id": format!("cam{c}"), "frames": format!("cam{c}/%d.png"),
                "width": w, "height": h, "model": model, "params": params,
                "cam_from_world": {"rotation_wxyz": random.pick(&[[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]),
                    "translation": [-x, 0.0, random.pick(&[0.0, 0.0, 0.1])]},
                "color": random.pick(&["rgb", "gray"]),
                "clock": {"times_s": times, "shared": random.below(3) == 0}})
        })
        .collect();
    write_json(
        folder.path(),
        &json!({"format": "stlfr-capture", "version": 1, "name": "any",
        "cameras": cameras}),
    );
    folder
}

#[test]
fn anything_that_opens_is_worked_with() {
    let mut random = Random(7);
    let (mut images, mut views) = (0, 0);
    for case in 0..150 {
        let folder = anything(&mut random);
        let capture = open(&folder);
        let estimated = estimate(&capture);
        // As if the clocks were known, so that there is something to render.
        for offsets in [estimated, Offsets::known(&capture)] {
            let mut options = RenderOptions::default();
            options.proxy.method = random.pick(&[ProxyMethod::Plane, ProxyMethod::Mesh]);
            options.proxy.plane_depth_m = Some(2.0);
            let field = LightField::new(capture.clone(), offsets, &options.registration);
            for time_s in [0.0, 0.02, 0.04, -3.0, 1e9] {
                for &sync in SyncMethod::ALL {
                    for image in field
                        .synchronized_all(time_s, &options.view().with_sync(sync))
                        .unwrap()
                        .iter()
                        .flatten()
                    {
                        images += 1;
                        let finite = image.data().iter().all(|v| (0.0..=1.0).contains(v));
                        assert!(finite, "case {case}, {sync:?} at {time_s} s");
                    }
                }
                let mut target = capture.cameras[0].camera.clone();
                target.cam_from_world.translation.x -= 0.01;
                if let Ok(rendered) = field.view(&target, time_s, &options.view()) {
                    views += 1;
                    assert!(rendered.image.data().iter().all(|v| (0.0..=1.0).contains(v)));
                }
            }
        }
    }
    assert!(images > 1000 && views > 20, "{images} images, {views} views");
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    let folder = Scene::default().film();
    let file = folder.path().join("options.json");
    let (capture, path) = (folder.path().to_str().unwrap(), file.to_str().unwrap());
    for (options, words) in [
        // Each of these panicked, hung, or took all memory.
        (r#"{"offset": {"tolerance_share": -1}}"#, "options.json: offset.tolerance_share: is -1.0"),
        (r#"{"registration": {"klt": {"radius_px": 1000000000}}}"#, "registration.klt.radius_px"),
        (r#"{"registration": {"klt": {"iterations": 1000000000}}}"#, "registration.klt.iterations"),
        (r#"{"registration": {"corners": {"radius_px": 1000000000}}}"#, "corners.radius_px"),
        (r#"{"interpolation": {"edges": {"max_length_px": 1e300}}}"#, "edges.max_length_px"),
        // And these made no sense.
        (r#"{"interpolation": {"morph": {"rho": 32}}}"#, "interpolation.morph.rho"),
        (r#"{"interpolation": {"morph": {"grid_px": 0}}}"#, "interpolation.morph.grid_px"),
        (r#"{"registration": {"klt": {"levels": 0}}}"#, "registration.klt.levels"),
        (r#"{"blend": {"feather_px": -1}}"#, "blend.feather_px"),
        (r#"{"blend": {"feather_px": null}}"#, "blend.feather_px"),
        (r#"{"proxy": {"plane_depth_m": 0}}"#, "proxy.plane_depth_m"),
        (r#"{"proxy": {"depth": 0}}"#, "proxy.depth"),
    ] {
        std::fs::write(&file, options).unwrap();
        assert_refused(&run(&["offsets", capture, "--json", "--options", path]), 2, words);
    }
}

#[test]
fn a_line_break_in_a_name_is_still_one_line() {
    let folder = Scene { frames: 1, ..Scene::default() }.film();
    edit(&folder, |j| j["cameras"][0]["frames"] = json!("a\nb%d.png"));
    let capture = folder.path().to_str().unwrap();
    assert_refused(&run(&["offsets", capture]), 2, "cameras[0] (cam0).frames: 'a\\nb0.png'");
}

#[test]
fn a_frame_is_not_written_over() {
    let folder = Scene { shared: [true; 3], ..Scene::default() }.film();
    let capture = folder.path().to_str().unwrap();
    let frame = folder.path().join("cam1/../cam0/1.png");
    let before = std::fs::read(&frame).unwrap();
    let render = |to: &str, times: [&str; 2]| {
        run(&["-q", "render", capture, "--like", "cam1", times[0], times[1], "-o", to])
    };
    let one = ["--time", "0.05"];
    assert_refused(&render(frame.to_str().unwrap(), one), 2, "is a frame of the capture");
    let sequence = folder.path().join("cam0/%d.png");
    let sequence = sequence.to_str().unwrap();
    assert_refused(&render(sequence, ["--times", "0.01:0.05:3"]), 2, "is a frame of the capture");
    assert_refused(&render(capture, one), 2, ".png");
    std::fs::create_dir(folder.path().join("folder.png")).unwrap();
    let folder_png = folder.path().join("folder.png");
    assert_refused(&render(folder_png.to_str().unwrap(), one), 2, "is a folder");
    let in_file = folder.path().join("capture.json/a.png");
    assert_refused(&render(in_file.to_str().unwrap(), one), 2, "no folder");
    assert_eq!(std::fs::read(&frame).unwrap(), before);
}

#[test]
fn a_view_of_terabytes_is_refused() {
    let folder = Scene { shared: [true; 3], ..Scene::default() }.film();
    let mut v = Scene::default().camera([0.0; 3]);
    (v["width"], v["height"]) = (json!(65_536), json!(65_536));
    let file = folder.path().join("view.json");
    std::fs::write(&file, v.to_string()).unwrap();
    let out = folder.path().join("out.png");
    let (capture, file) = (folder.path().to_str().unwrap(), file.to_str().unwrap());
    let out = out.to_str().unwrap();
    let output = run(&["render", capture, "--camera", file, "--time", "0", "-o", out]);
    assert_refused(&output, 2, "view.json: width: 65536×65536");
}

#[test]
fn a_capture_that_may_only_be_read_is_worked_with() {
    let folder = Scene::default().film();
    // Root may write anywhere: a folder of that name can't be replaced by a file.
    std::fs::create_dir_all(folder.path().join("offsets.json/in the way")).unwrap();
    let output = run(&["offsets", folder.path().to_str().unwrap(), "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("not kept"), "{}", stderr(&output));
    serde_json::from_slice::<Offsets>(&output.stdout).unwrap();
}

#[test]
fn broken_frames_are_named() {
    let capture = |change: &dyn Fn(&Path)| {
        let folder = Scene { frames: 3, ..Scene::default() }.film();
        change(&folder.path().join("cam2/1.png"));
        run(&["-q", "offsets", folder.path().to_str().unwrap()])
    };
    let truncated = capture(&|frame| {
        let bytes = std::fs::read(frame).unwrap();
        std::fs::write(frame, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert_refused(&truncated, 2, "cam2/1.png");
    let small = Image::filled(8, 6, 1, 0.5);
    let other = capture(&|frame| write_image(frame, &small, None, BitDepth::Eight).unwrap());
    assert_refused(&other, 2, "cam2/1.png: is 8×6 pixels, its camera 96×72");
    let folder = capture(&|frame| {
        std::fs::remove_file(frame).unwrap();
        std::fs::create_dir(frame).unwrap();
    });
    assert_refused(&folder, 2, "'cam2/1.png' is not a file");
    assert_refused(&capture(&|frame| std::fs::write(frame, "").unwrap()), 2, "cam2/1.png");
}
