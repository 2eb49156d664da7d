//! Rolling shutters on a moving wall whose images are a formula: every row at its own time.

mod common;

use common::wall::{FRAME_S, Scene, W, by_proxy, estimate, open, view};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;

/// Readouts of the three cameras: half a frame, none, and almost a third.
const READOUTS_S: [f64; 3] = [0.5 * FRAME_S, 0.0, 0.3 * FRAME_S];

fn rolling() -> Scene {
    Scene { velocity: [2.5, 2.0], readouts_s: READOUTS_S, frames: 6, ..Scene::default() }
}

/// The capture as if all shutters were global.
fn without_readouts(capture: &Capture) -> Arc<Capture> {
    let mut capture = capture.clone();
    capture.cameras.iter_mut().for_each(|c| c.clock.readout_s = 0.0);
    Arc::new(capture)
}

/// The largest error of the offsets, frames; infinite if one is unknown.
fn error_frames(scene: &Scene, offsets: &Offsets) -> f64 {
    let of = |(c, truth_s): (usize, &f64)| {
        let found_s = offsets.cameras[c].offset_s.unwrap_or(f64::INFINITY);
        (found_s - truth_s).abs() / FRAME_S
    };
    scene.offsets_s.iter().enumerate().map(of).fold(0.0, f64::max)
}

/// PSNR without a border, dB.
fn psnr_db(image: &Image, truth: &Image) -> f64 {
    const BORDER_PX: usize = 10;
    let (mut sum, mut count) = (0.0, 0.0);
    for y in BORDER_PX..truth.height() - BORDER_PX {
        for x in BORDER_PX..W - BORDER_PX {
            sum += f64::from(image.pixel(x, y)[0] - truth.pixel(x, y)[0]).powi(2);
            count += 1.0;
        }
    }
    -10.0 * (sum / count).log10()
}

fn true_offsets(scene: &Scene, capture: &Capture) -> Offsets {
    let mut offsets = Offsets::known(capture);
    for (camera, offset_s) in offsets.cameras.iter_mut().zip(scene.offsets_s) {
        camera.offset_s = Some(offset_s);
    }
    offsets
}

#[test]
fn offsets_of_rolling_shutters_are_those_of_the_middle_rows() {
    let scene = rolling();
    let folder = scene.film();
    let capture = open(&folder);
    let known = error_frames(&scene, &estimate(&capture));
    let ignored = error_frames(&scene, &estimate(&without_readouts(&capture)));
    println!("offset error, frames: readout known {known:.4}, ignored {ignored:.4}");
    assert!(known < 0.01, "{known}");
    assert!(ignored > 2.0 * known, "{ignored} {known}");
}

/// The readouts of all cameras are guessed alike, with a standard error. Their differences and the offsets come out, and
/// views use them.
#[test]
fn readouts_are_estimated_with_the_offsets() {
    let scene = rolling();
    let folder = scene.film();
    let capture = open(&folder);
    let mut guessed = (*capture).clone();
    for camera in &mut guessed.cameras {
        camera.clock.readout_s = 0.3 * FRAME_S;
        camera.clock.readout_std_s = 0.3 * FRAME_S;
    }
    let guessed = Arc::new(guessed);
    let offsets = estimate(&guessed);
    let ignored = error_frames(&scene, &estimate(&without_readouts(&capture)));
    let estimated = error_frames(&scene, &offsets);
    println!("offset error, frames: readout estimated {estimated:.4}, ignored {ignored:.4}");
    assert!(estimated < 0.01 && ignored > 2.0 * estimated, "{estimated} {ignored}");
    let found: Vec<[f64; 2]> = offsets
        .cameras
        .iter()
        .map(|c| [c.readout_s, c.readout_std_err_s].map(|s| s.unwrap() / FRAME_S))
        .collect();
    println!("readouts and standard errors, frames: {found:?}");
    for (c, [readout, std_err]) in found.iter().enumerate() {
        let truth = READOUTS_S.map(|s| s / FRAME_S);
        assert!((readout - truth[c]).abs() < 2.0 * std_err && *std_err < 0.2, "{c}: {found:?}");
        let difference = (readout - found[1][0]) - (truth[c] - truth[1]);
        assert!(difference.abs() < 0.03, "{c}: {found:?}");
    }
    let saved = serde_json::to_value(&offsets).unwrap();
    let read: Offsets = serde_json::from_value(saved).unwrap();
    assert_eq!(read, offsets);
    let place = [-0.03, 0.0, 0.0];
    let target = view(&scene.camera(place));
    let instant_s = 2.4 * FRAME_S;
    let truth = scene.image(place, instant_s);
    let mut exact = offsets.clone();
    exact.cameras.iter_mut().for_each(|c| c.readout_s = None);
    let db = [(guessed, offsets), (without_readouts(&capture), exact)].map(|(capture, offsets)| {
        let field = LightField::new(capture, offsets);
        let seen = field.view(&target, instant_s, &by_proxy(ProxyMethod::Depth)).unwrap();
        psnr_db(&seen.image.to_gray(), &truth)
    });
    println!("view: readout estimated {:.1} dB, ignored {:.1} dB", db[0], db[1]);
    assert!(db[0] > db[1] + 3.0, "{db:?}");
}

/// At instants between frames, at a frame's time, and where the last rows are before the instant.
#[test]
fn a_camera_s_image_at_an_instant_has_all_rows_at_that_instant() {
    let scene = rolling();
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = true_offsets(&scene, &capture);
    let options = RenderOptions::default().with_sync(SyncMethod::Refined);
    for frames in [1.3, 1.5, 2.0, 2.9] {
        let instant_s = (frames + scene.offsets_s[0] / FRAME_S) * FRAME_S;
        let truth = scene.image(scene.centers_m[0], instant_s);
        let db = [capture.clone(), without_readouts(&capture)].map(|capture| {
            let field = LightField::new(capture, offsets.clone());
            psnr_db(&field.synchronized(0, instant_s, &options).unwrap().image, &truth)
        });
        println!("image at frame {frames}: readout known {:.1} dB, ignored {:.1} dB", db[0], db[1]);
        assert!(db[0] > 30.0 && db[0] > db[1] + 6.0, "{frames}: {db:?}");
    }
}

#[test]
fn views_undo_the_readout_by_every_proxy() {
    let scene = rolling();
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = true_offsets(&scene, &capture);
    let place = [-0.03, 0.0, 0.0];
    let target = view(&scene.camera(place));
    let instant_s = 2.4 * FRAME_S;
    let truth = scene.image(place, instant_s);
    for method in [ProxyMethod::Mesh, ProxyMethod::Depth, ProxyMethod::SceneFlow] {
        let db = [capture.clone(), without_readouts(&capture)].map(|capture| {
            let field = LightField::new(capture, offsets.clone());
            let seen = field.view(&target, instant_s, &by_proxy(method)).unwrap();
            psnr_db(&seen.image.to_gray(), &truth)
        });
        println!("{method:?}: readout known {:.1} dB, ignored {:.1} dB", db[0], db[1]);
        assert!(db[0] > 26.0 && db[0] > db[1] + 3.0, "{method:?}: {db:?}");
    }
}

/// A readout of 0 is a global shutter, to the last bit.
#[test]
fn a_readout_of_zero_changes_nothing() {
    let scene = Scene { readouts_s: [0.0; 3], ..rolling() };
    let folder = scene.film();
    let without = open(&folder);
    let path = folder.path().join("capture.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    for camera in json["cameras"].as_array_mut().unwrap() {
        camera["clock"]["readout_s"] = 0.into();
    }
    std::fs::write(&path, json.to_string()).unwrap();
    let zero = open(&folder);
    let [a, b] = [without, zero].map(|capture| {
        let offsets = estimate(&capture);
        let target = view(&scene.camera([0.02, 0.01, 0.0]));
        let field = LightField::new(capture, offsets.clone());
        let options = by_proxy(ProxyMethod::Depth);
        let seen = field.view(&target, 1.7 * FRAME_S, &options).unwrap();
        (offsets, seen.image)
    });
    assert_eq!(format!("{:?}", a.0), format!("{:?}", b.0));
    assert!(a.1 == b.1);
}
