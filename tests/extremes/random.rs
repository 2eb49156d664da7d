//! Random captures through the whole pipeline, with random options: a result of finite numbers that
//! is right, or one sentence. A seed that found something is a case of its own.

use crate::common::describe;
use crate::common::random::{below, pick};
use crate::common::swing::{RATE_HZ, Swing};
use crate::common::wall::{estimate_by, open};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use stlfr::camera::Camera;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, LightField, RenderError};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, write_image};
use tempfile::TempDir;

/// When a camera's frames are taken, in frames after its first.
fn times(random: &mut Random, count: usize) -> Vec<f64> {
    let mut time = 0.0;
    (0..count)
        .map(|_| {
            let now = time;
            // A frame that was lost, and stamps that jitter.
            time += pick(random, &[1.0, 1.0, 1.0, 1.0, 0.9, 1.1, 2.0]);
            now
        })
        .collect()
}

/// A capture of a swinging wall in any size, number, order, kind of image, model and clock; and each
/// camera's true delay in frames.
fn capture(random: &mut Random) -> (TempDir, Vec<f64>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cameras = 1 + below(random, 4);
    let swing = Swing {
        width: pick(random, &[1, 7, 24, 40, 64, 96]),
        height: pick(random, &[1, 5, 24, 40, 64, 72]),
        channels: pick(random, &[1, 3]),
        cameras,
        columns: pick(random, &[1, 2, 4]),
        period: pick(random, &[8, 20, 40]),
        print: pick(random, &[0.7, 1.0, 2.0]),
        disparity_px: pick(random, &[0.5, 2.0, 4.0]),
        ..Swing::default()
    };
    // Seconds a frame, and what all clocks start at.
    let frame_s = pick(random, &[1.0 / RATE_HZ, 1.0 / RATE_HZ, 10.0, 1e-5]);
    let start_s = pick(random, &[0.0, 0.0, -3.5, 1.8e9]);
    // Unix time leaves nothing of a hundred-thousandth of a second.
    let start_s = if frame_s < 1e-3 { 0.0 } else { start_s };
    let mut delays = Vec::new();
    let described: Vec<Value> = (0..cameras)
        .map(|c| {
            let delay = swing.delay_frames(c);
            delays.push(delay);
            let count = pick(random, &[1, 2, 5, 8]);
            let times = times(random, count);
            let depth = pick(random, &[BitDepth::Eight, BitDepth::Sixteen]);
            for (k, time) in times.iter().enumerate() {
                let image = swing.truth(c, time + delay);
                let path = folder.path().join(format!("cam{c}/{k}.png"));
                write_image(&path, &image, None, depth).expect("an image");
            }
            let mut camera = swing.view(swing.place(c));
            if random.unit() < 0.3 {
                camera["model"] = json!("OPENCV");
                let mut params = camera["params"].as_array().expect("numbers").clone();
                params.extend([0.0, 0.0, 0.0, 0.0].map(|v| json!(v)));
                camera["params"] = json!(params);
            }
            let stamps: Vec<f64> = times.iter().map(|t| start_s + frame_s * t).collect();
            camera["id"] = json!(format!("cam{c}"));
            camera["frames"] = json!(format!("cam{c}/%d.png"));
            camera["color"] = json!(pick(random, &["gray", "rgb"]));
            camera["clock"] = json!({"times_s": stamps, "shared": false,
                "lost": random.unit() < 0.2, "drift": random.unit() < 0.2});
            camera
        })
        .collect();
    let reference = format!("cam{}", swing.reference());
    describe(
        folder.path(),
        &json!({"format": "stlfr-capture", "version": 1, "name": "random",
            "reference": reference, "cameras": described}),
    );
    (folder, delays)
}

/// Every number among the options, by its path, with the range that it may be in.
fn ranges() -> BTreeMap<String, (f64, f64)> {
    let mut found = BTreeMap::new();
    let default = serde_json::to_value(RenderOptions::default()).expect("options");
    let mut paths = Vec::new();
    numbers(&default, String::new(), &mut paths);
    for path in paths {
        let mut options = default.clone();
        let at = options.pointer_mut(&path).expect("its own path");
        // Too large for any range, in whatever type it is.
        *at = if at.is_f64() { json!(1e30) } else { json!(u64::MAX / 2) };
        let options: RenderOptions = serde_json::from_value(options).expect("numbers");
        let error = options.check().expect_err(&path);
        assert_eq!(error.field, path[1..].replace('/', "."));
        found.insert(path, (error.min, error.max));
    }
    found
}

fn numbers(value: &Value, path: String, out: &mut Vec<String>) {
    match value {
        Value::Number(_) => out.push(path),
        Value::Object(fields) => {
            for (name, field) in fields {
                numbers(field, format!("{path}/{name}"), out);
            }
        }
        _ => {}
    }
}

/// The defaults with some numbers anywhere in their ranges, mostly at their ends.
fn options(random: &mut Random, ranges: &BTreeMap<String, (f64, f64)>) -> RenderOptions {
    let mut options = serde_json::to_value(RenderOptions::default()).expect("options");
    for (path, &(min, max)) in ranges {
        if random.unit() > 0.15 {
            continue;
        }
        let at = options.pointer_mut(path).expect("a path of theirs");
        let inside = min + (max - min) * random.unit().powi(4);
        let value = pick(random, &[min, max, inside, inside]);
        *at = if at.is_f64() { json!(value) } else { json!(value as u64) };
    }
    options["sync"] = json!(pick(random, &["nearest", "morph", "edge-morph", "refined"]));
    options["trail"] = json!({"duration_s": 0.0});
    let options: RenderOptions = serde_json::from_value(options).expect("numbers");
    options.check().expect("they are in range");
    options
}

#[track_caller]
fn assert_finite(image: &Image, what: &str) {
    assert!(image.data().iter().all(|v| (0.0..=1.0).contains(v)), "{what}");
}

/// One capture from offsets to a view: whether there was one, and the offsets' errors in frames and
/// in standard errors.
fn processed(seed: u64, options: &RenderOptions) -> (bool, Vec<(f64, f64)>) {
    let mut random = Random::new(seed);
    let (folder, delays) = capture(&mut random);
    let capture = open(&folder);
    // Every offset in it is finite, or unknown with a reason.
    let estimated = estimate_by(&capture, options);
    let text = serde_json::to_string(&estimated).expect("JSON");
    assert_eq!(serde_json::from_str::<Offsets>(&text).expect("JSON"), estimated, "{seed}");
    let frame_s = Some(capture.frame_s()).filter(|f| *f > 0.0);
    let errors = estimated.cameras.iter().zip(delays).filter_map(|(camera, delay)| {
        let std_err = camera.std_err_s.filter(|s| *s > 0.0)? / frame_s?;
        let error = camera.offset_s? / frame_s? - delay;
        Some((error, error / std_err))
    });
    let errors = errors.collect();
    let mut seen = false;
    for offsets in [estimated, Offsets::known(&capture)] {
        let field = LightField::new(capture.clone(), offsets);
        let mut options = options.clone();
        options.proxy.method = pick(&mut random, ProxyMethod::ALL);
        let time_s = field.common_span_s().map_or(0.0, |(a, b)| a + random.unit() * (b - a));
        for &sync in SyncMethod::ALL {
            let images = field.synchronized_all(
                time_s,
                &RenderOptions { sync, ..options.clone() },
                &Context::unattended(),
            );
            for image in images.unwrap_or_else(|e| panic!("{seed}: {e}")).iter().flatten() {
                assert_finite(&image.image, &format!("{seed}: {sync:?}"));
            }
        }
        let mut target: Camera = capture.cameras[0].camera.clone();
        target.cam_from_world.translation.x -= 0.02;
        match field.view(&target, time_s, &options) {
            Ok(view) => {
                seen = true;
                assert_finite(&view.image, &format!("{seed}: view"));
            }
            Err(RenderError::Capture(e)) => panic!("{seed}: {e}"),
            Err(error) => {
                let text = error.to_string();
                assert!(!text.is_empty() && text.lines().count() == 1, "{seed}: {text}");
            }
        }
    }
    (seen, errors)
}

#[test]
fn random_captures() {
    let mut views = 0;
    let mut known = Vec::new();
    for seed in 1000..1070 {
        let (seen, errors) = processed(seed, &RenderOptions::default());
        views += usize::from(seen);
        known.extend(errors.into_iter().map(|(error, z)| (seed, error, z)));
    }
    assert!(views > 10 && known.len() > 9, "{views} views, {} offsets", known.len());
    let wrong: Vec<_> = known.iter().filter(|(_, e, z)| e.abs() > 0.1 && z.abs() > 6.0).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn random_options() {
    let ranges = ranges();
    assert!(ranges.len() > 20, "{}", ranges.len());
    let mut random = Random::new(77);
    let mut views = 0;
    for seed in 2000..2040 {
        let (seen, _) = processed(seed, &options(&mut random, &ranges));
        views += usize::from(seen);
    }
    assert!(views > 3, "{views}");
}
