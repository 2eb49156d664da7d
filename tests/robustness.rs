//! Bad and extreme input is refused in one sentence or processed; it never causes a panic, a hang or
//! a number that is not finite. Every bug found is a test with a name.

mod common;

use common::random::{below, pick};
use common::wall::{FOCAL_PX, FRAME_S, H, Scene, W, by_plane, by_proxy, estimate};
use common::wall::{field_of, open, texture, view};
use common::{assert_refused, describe, edit, read_json, run, stderr, stlfr, succeed, text};
use serde_json::{Value, json};
use std::path::Path;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::Context;
use stlfr::light_field::RenderError;
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, write_image};
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
fn a_scene_at_rest_shows_no_offset() {
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
        let (field, options) = (field_of(&capture, offsets), RenderOptions::default());
        let image = field.synchronized(1, 0.03, &options).unwrap().image.clone();
        assert!(image.data().iter().all(|v| (v - value).abs() < 0.01));
        let refused = field.view(&view(&scene.camera([0.01, 0.0, 0.0])), 0.03, &options);
        assert!(matches!(refused, Err(RenderError::NoPoints)), "{refused:?}");
    }
}

#[test]
fn recordings_that_do_not_overlap_are_named() {
    let folder = Scene::default().film();
    edit(folder.path(), |j| j["cameras"][0]["clock"]["first_s"] = json!(100.0));
    assert_unknown(&estimate(&open(&folder)), &[0], "filmed at other times");
}

#[test]
fn cameras_in_one_place_have_no_offset() {
    let folder = Scene::default().film();
    edit(folder.path(), |j| {
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
    let (field, options) = (field_of(&capture, offsets), RenderOptions::default());
    let target = view(&scene.camera([0.02, 0.0, 0.0]));
    let first = field.view(&target, 0.0, &options).unwrap();
    assert!(first.coverage.iter().all(|c| *c));
    assert_eq!(field.view(&target, -1e6, &options).unwrap(), first);
    assert_eq!(
        field.synchronized(2, 9.0, &options).unwrap().image,
        capture.read_frame(2, 0).unwrap()
    );
}

#[test]
fn a_view_without_a_feature_in_it_has_a_depth() {
    let scene = Scene::default();
    let folder = scene.film();
    let capture = open(&folder);
    let (field, options) = (field_of(&capture, estimate(&capture)), RenderOptions::default());
    let mut pixel = scene.camera([0.02, 0.0, 0.0]);
    (pixel["width"], pixel["height"]) = (json!(1), json!(1));
    pixel["params"] = json!([FOCAL_PX, FOCAL_PX, 0.5, 0.5]);
    let time_s = 1.5 * FRAME_S;
    let rendered = field.view(&view(&pixel), time_s, &options).unwrap();
    let truth = texture(0.02 - 0.3 * time_s, -time_s);
    assert!((f64::from(rendered.image.data()[0]) - truth).abs() < 0.05);
    // Away from the scene there is none.
    let mut away = scene.camera([0.0; 3]);
    away["cam_from_world"]["rotation_wxyz"] = json!([0, 0, 1, 0]);
    let refused = field.view(&view(&away), time_s, &options);
    assert!(matches!(refused, Err(RenderError::NothingSeen)), "{refused:?}");
}

/// Cameras at the ends of every scale: focal lengths, distortion, places and sizes.
fn odd_views(scene: &Scene) -> Vec<Value> {
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
    for at in [[0.0, 0.0, -2.0], [0.0, 0.0, -50.0], [1e12, 0.0, 0.0], [0.0, 0.0, 1e6], [1e12; 3]] {
        let mut v = scene.camera([0.0; 3]);
        v["cam_from_world"]["translation"] = json!(at);
        views.push(v);
    }
    for (w, h) in [(1, 1), (1, 97), (513, 1), (5, 5)] {
        let mut v = scene.camera([0.01, 0.0, 0.0]);
        (v["width"], v["height"]) = (json!(w), json!(h));
        views.push(v);
    }
    views
}

#[test]
fn odd_views_are_rendered_or_refused() {
    let scene = Scene::default();
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, Offsets::known(&capture));
    for &method in ProxyMethod::ALL {
        let options = by_proxy(method);
        for v in &odd_views(&scene) {
            match field.view(&view(v), 1.5 * FRAME_S, &options) {
                Ok(r) => assert!(r.image.data().iter().all(|v| v.is_finite()), "{v}"),
                Err(RenderError::NoPoints | RenderError::NothingSeen) => {}
                Err(error) => panic!("{v}: {error}"),
            }
        }
    }
}

/// A capture of anything: sizes from one pixel, any kind of image, any clocks and poses.
fn anything(random: &mut Random) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let same_size = below(random, 2) == 0;
    let size = |random: &mut Random| {
        [pick(random, &[1, 2, 5, 17, 33, 48]), pick(random, &[1, 3, 5, 16, 40])]
    };
    let common_size = size(random);
    let cameras: Vec<Value> = (0..1 + below(random, 4))
        .map(|c| {
            let size = if same_size { common_size } else { size(random) };
            any_camera(random, folder.path(), c, size)
        })
        .collect();
    describe(
        folder.path(),
        &json!({"format": "stlfr-capture", "version": 1, "name": "any", "cameras": cameras}),
    );
    folder
}

/// One camera of such a capture, as the capture describes it; its frames are written.
fn any_camera(random: &mut Random, folder: &Path, c: usize, [w, h]: [usize; 2]) -> Value {
    let frames = 1 + below(random, 4);
    any_frames(random, frames, [w, h]).iter().enumerate().for_each(|(k, image)| {
        let path = folder.join(format!("cam{c}/{k}.png"));
        let depth = pick(random, &[BitDepth::Eight, BitDepth::Sixteen]);
        write_image(&path, image, None, depth).unwrap();
    });
    let mut time_s = pick(random, &[0.0, 0.0, 0.01, -5.0]);
    let times: Vec<f64> = (0..frames)
        .map(|_| {
            time_s += pick(random, &[0.04, 0.04, 0.041, 1e-6, 10.0]);
            time_s
        })
        .collect();
    let focal = pick(random, &[10.0, 50.0, 50.0, 1e4]);
    let model = pick(random, &["PINHOLE", "OPENCV"]);
    let mut params = vec![focal, focal, w as f64 / 2.0, h as f64 / 2.0];
    if model == "OPENCV" {
        params.extend([random.unit() - 0.5, random.unit() - 0.5, 0.01, 0.0]);
    }
    let x = pick(random, &[0.0, 0.06 * c as f64, 0.06 * c as f64, 1e3]);
    let rotation = pick(random, &[[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]);
    json!({"id": format!("cam{c}"), "frames": format!("cam{c}/%d.png"),
        "width": w, "height": h, "model": model, "params": params,
        "cam_from_world": {"rotation_wxyz": rotation,
            "translation": [-x, 0.0, pick(random, &[0.0, 0.0, 0.1])]},
        "color": pick(random, &["rgb", "gray"]),
        "clock": {"times_s": times, "shared": below(random, 3) == 0}})
}

/// Frames of one kind: black, noise, black and white, or a texture in motion.
fn any_frames(random: &mut Random, count: usize, [w, h]: [usize; 2]) -> Vec<Image> {
    let kind = below(random, 4);
    let speed = [2.0 * random.signed(), 2.0 * random.signed()];
    let channels = pick(random, &[1, 3]);
    let mut frame = |k: usize| {
        let data = (0..w * h * channels).map(|n| match kind {
            0 => 0.0,
            1 => random.unit() as f32,
            2 => pick(random, &[0.0, 1.0]),
            _ => {
                let (x, y) = ((n / channels) % w, n / channels / w);
                let at = |v: usize, s: f64| (v as f64 - s * k as f64) * 0.02;
                texture(at(x, speed[0]), at(y, speed[1])) as f32
            }
        });
        Image::from_data(w, h, channels, data.collect())
    };
    (0..count).map(&mut frame).collect()
}

#[test]
fn anything_that_opens_is_processed() {
    let mut random = Random::new(7);
    let (mut images, mut views) = (0, 0);
    for case in 0..150 {
        let folder = anything(&mut random);
        let capture = open(&folder);
        let estimated = estimate(&capture);
        // As if the clocks were known, so that there is something to render.
        for offsets in [estimated, Offsets::known(&capture)] {
            let mut options = by_plane(2.0);
            options.proxy.method = pick(&mut random, ProxyMethod::ALL);
            let field = field_of(&capture, offsets);
            let mut target = capture.cameras[0].camera.clone();
            target.cam_from_world.translation.x -= 0.01;
            for time_s in [0.0, 0.02, 0.04, -3.0, 1e9] {
                for &sync in SyncMethod::ALL {
                    let options = RenderOptions { sync, ..options.clone() };
                    let synchronized =
                        field.synchronized_all(time_s, &options, &Context::unattended()).unwrap();
                    for image in synchronized.iter().flatten() {
                        images += 1;
                        let finite = image.image.data().iter().all(|v| (0.0..=1.0).contains(v));
                        assert!(finite, "case {case}, {sync:?} at {time_s} s");
                    }
                }
                if let Ok(rendered) = field.view(&target, time_s, &options) {
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
    let (capture, path) = (text(folder.path()), text(&file));
    for (options, words) in [
        // Each of these panicked, hung, or took all memory.
        (r#"{"offset": {"search_s": -1}}"#, "options.json: offset.search_s: is -1.0"),
        (r#"{"registration": {"window_radius_px": 1000000000}}"#, "registration.window_radius_px"),
        (r#"{"registration": {"max_corners": 1000000000}}"#, "registration.max_corners"),
        (r#"{"interpolation": {"max_edge_length_px": 1e300}}"#, "interpolation.max_edge_length_px"),
        // And these made no sense.
        (r#"{"interpolation": {"grid_px": 0}}"#, "interpolation.grid_px"),
        (r#"{"registration": {"levels": 0}}"#, "registration.levels"),
        (r#"{"blend": {"error_angle_rad": -1}}"#, "blend.error_angle_rad"),
        (r#"{"blend": {"error_angle_rad": null}}"#, "blend.error_angle_rad"),
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
    edit(folder.path(), |j| j["cameras"][0]["frames"] = json!("a\nb%d.png"));
    let capture = text(folder.path());
    assert_refused(&run(&["offsets", capture]), 2, "cameras[0] (cam0).frames: 'a\\nb0.png'");
}

#[test]
fn a_frame_is_not_written_over() {
    let folder = Scene { shared: [true; 3], ..Scene::default() }.film();
    let capture = text(folder.path());
    let frame = folder.path().join("cam1/../cam0/1.png");
    let before = std::fs::read(&frame).unwrap();
    let render = |to: &str, times: [&str; 2]| {
        run(&["-q", "render", capture, "--like", "cam1", times[0], times[1], "-o", to])
    };
    let one = ["--time", "0.05"];
    assert_refused(&render(text(&frame), one), 2, "is a frame of the capture");
    let sequence = folder.path().join("cam0/%d.png");
    let sequence = text(&sequence);
    assert_refused(&render(sequence, ["--times", "0.01:0.05:3"]), 2, "is a frame of the capture");
    assert_refused(&render(capture, one), 2, ".png");
    std::fs::create_dir(folder.path().join("folder.png")).unwrap();
    let folder_png = folder.path().join("folder.png");
    assert_refused(&render(text(&folder_png), one), 2, "is a folder");
    let in_file = folder.path().join("capture.json/a.png");
    assert_refused(&render(text(&in_file), one), 2, "no folder");
    assert_eq!(std::fs::read(&frame).unwrap(), before);
}

#[test]
fn a_view_of_terabytes_is_refused() {
    let folder = Scene { shared: [true; 3], ..Scene::default() }.film();
    let mut v = Scene::default().camera([0.0; 3]);
    (v["width"], v["height"]) = (json!(65_536), json!(65_536));
    let file = folder.path().join("view.json");
    std::fs::write(&file, v.to_string()).unwrap();
    let (capture, out) = (text(folder.path()), folder.path().join("out.png"));
    let camera = ["--camera", text(&file), "--time", "0", "-o", text(&out)];
    let output = run(&[["render", capture].as_slice(), &camera].concat());
    assert_refused(&output, 2, "view.json: width: 65536×65536");
}

#[test]
fn a_read_only_capture_is_processed() {
    let folder = Scene::default().film();
    // Root may write anywhere: a folder of that name can't be replaced by a file.
    std::fs::create_dir_all(folder.path().join("offsets.svg/in the way")).unwrap();
    let output = succeed(&["offsets", text(folder.path()), "--json"]);
    assert!(stderr(&output).contains("not saved"), "{}", stderr(&output));
    serde_json::from_slice::<Offsets>(&output.stdout).unwrap();
}

/// Sets every offset but the reference's.
fn set_offsets(offsets: &mut Value, offset_s: f64) {
    for camera in offsets["cameras"].as_array_mut().unwrap() {
        if camera["id"] != "cam1" {
            camera["offset_s"] = json!(offset_s);
        }
    }
}

#[test]
fn offsets_in_which_frames_vanish_are_refused() {
    let folder = Scene::default().film();
    let capture = text(folder.path());
    let estimated = succeed(&["-q", "offsets", capture, "--json"]).stdout;
    let file = folder.path().join("offsets.json");
    let out = folder.path().join("out.png");
    for offset_s in [1e16, 1e300] {
        let mut offsets = read_json(&file);
        set_offsets(&mut offsets, offset_s);
        std::fs::write(&file, offsets.to_string()).unwrap();
        let view = ["-q", "render", capture, "--like", "cam1", "-o", text(&out), "--time"];
        let refused = run(&[&view[..], &["0.08"]].concat());
        assert_refused(&refused, 2, "offsets.json: cameras[0] (cam0).offset_s: is 1e");
        let refused = run(&[&view[..], &[&format!("{offset_s:e}")]].concat());
        assert_refused(&refused, 2, "cam1 has no frames around");
    }
    std::fs::remove_file(file).unwrap();
    assert_eq!(succeed(&["-q", "offsets", capture, "--json"]).stdout, estimated);
}

#[test]
fn cached_points_in_which_frames_vanish_are_measured_anew() {
    let folder = Scene::default().film();
    let out = folder.path().join("out");
    let cache = folder.path().join(".stlfr/cache/tradeoff-preparations");
    let prepared = || {
        let entries = std::fs::read_dir(&cache).into_iter().flatten().flatten();
        entries.map(|e| e.path()).find(|path| path.is_file())
    };
    // A checksum, then JSON.
    let content = |path: &Path| -> Value {
        serde_json::from_slice(&std::fs::read(path).unwrap()[32..]).unwrap()
    };
    let mut offset_s = 1e16;
    for _ in 0..2 {
        let mut tradeoff = stlfr()
            .args(["-q", "tradeoff", text(folder.path()), "--rounds", "0", "-o", text(&out)])
            .spawn()
            .unwrap();
        let has_measured = || {
            prepared().is_some_and(|p| {
                let found = content(&p)["offsets"]["cameras"][0]["offset_s"].as_f64();
                found.is_some_and(|s| s < 1.0)
            })
        };
        while !has_measured() {
            assert!(tradeoff.try_wait().unwrap().is_none(), "it ended without");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        tradeoff.kill().unwrap();
        tradeoff.wait().unwrap();
        let path = prepared().unwrap();
        let mut changed = content(&path);
        set_offsets(&mut changed["offsets"], offset_s);
        let checksum = &std::fs::read(&path).unwrap()[..32];
        std::fs::write(&path, [checksum, changed.to_string().as_bytes()].concat()).unwrap();
        offset_s = 1e300;
    }
}

#[test]
fn broken_frames_are_named() {
    let capture = |change: &dyn Fn(&Path)| {
        let folder = Scene { frames: 3, ..Scene::default() }.film();
        change(&folder.path().join("cam2/1.png"));
        run(&["-q", "offsets", text(folder.path())])
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
