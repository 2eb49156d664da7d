//! Units, places, clocks and orders are the file's: the same film in others gives the same offsets
//! and the same image.
//!
//! The same means: offsets to 1e-6 frame, values to 1/255. Images that are turned with their cameras
//! are summed in another order, which may turn a threshold's decision on a feature: there offsets
//! agree to a tenth of their standard error, and 99 % of the values to 1/255.

use crate::common::wall::{FRAME_S, H, Scene, W, estimate_by, open, turned, view};
use nalgebra::{UnitQuaternion, Vector3};
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::Image;

/// Offsets, and the view from beside the reference camera between two frames, upright.
fn reconstructed(scene: &Scene, options: &RenderOptions) -> (Offsets, Image) {
    let folder = scene.film();
    let capture = open(&folder);
    let offsets = estimate_by(&capture, options);
    let field = LightField::new(capture, offsets.clone(), &options.registration);
    let rendered = field
        .view(&view(&scene.camera([0.02, 0.0, 0.0])), scene.time_s(1.6), &options.view())
        .unwrap();
    (offsets, turned(&rendered.image, (4 - scene.quarter_turns) % 4))
}

/// How two reconstructions differ.
#[derive(Debug)]
struct Change {
    /// The largest of the offsets, frames, and in standard errors.
    offset_frames: f64,
    offset_std_errs: f64,
    /// Values that differ by more than 1/255.
    values: usize,
}

fn change(scene: &Scene, options: &RenderOptions) -> Change {
    let (offsets, image) = reconstructed(&Scene::default(), options);
    let (others, other) = reconstructed(scene, options);
    let mut change = Change { offset_frames: 0.0, offset_std_errs: 0.0, values: 0 };
    for a in &offsets.cameras {
        let b = others.cameras.iter().find(|b| b.id == a.id).expect("the same cameras");
        let (a_s, b_s) = (a.offset_s.expect("is known"), b.offset_s.expect("is known"));
        let apart_s = (a_s - b_s / scene.slowness).abs();
        change.offset_frames = change.offset_frames.max(apart_s / FRAME_S);
        let std_err_s = a.std_err_s.expect("has an error");
        if std_err_s > 0.0 {
            change.offset_std_errs = change.offset_std_errs.max(apart_s / std_err_s);
        }
    }
    let pairs = image.data().iter().zip(other.data());
    change.values = pairs.filter(|(a, b)| !((*a - *b).abs() <= 1.0 / 255.0)).count();
    change
}

#[track_caller]
fn assert_same(scene: &Scene, offset_frames: f64) {
    let change = change(scene, &RenderOptions::default());
    assert!(change.offset_frames <= offset_frames && change.values == 0, "{change:?}");
}

#[test]
fn millimetres_and_megametres() {
    for scale in [1e-6, 1e-3, 1e3, 1e6] {
        assert_same(&Scene { scale, ..Scene::default() }, 1e-6);
    }
}

#[test]
fn ten_thousand_kilometres_away() {
    assert_same(&Scene { origin_m: 1e7, ..Scene::default() }, 1e-6);
}

#[test]
fn a_turned_world() {
    for axis in [Vector3::x(), Vector3::y(), Vector3::new(0.3, -0.5, 0.8)] {
        let turn = UnitQuaternion::new(axis.normalize() * 2.0);
        assert_same(&Scene { turn, ..Scene::default() }, 1e-6);
    }
}

#[test]
fn unix_time() {
    // 2.4e-7 s is what an f64 second still holds there.
    assert_same(&Scene { start_s: 1.8e9, ..Scene::default() }, 2.4e-7 / FRAME_S);
}

#[test]
fn a_frame_in_ten_seconds_and_a_hundred_thousand_a_second() {
    for rate_hz in [0.1, 1e5] {
        let slowness = 1.0 / (rate_hz * FRAME_S);
        assert_same(&Scene { slowness, ..Scene::default() }, 1e-6);
    }
}

#[test]
fn cameras_in_another_order() {
    for order in [[2, 1, 0], [1, 2, 0]] {
        assert_same(&Scene { order, ..Scene::default() }, 1e-6);
    }
}

#[test]
fn images_turned_with_their_cameras() {
    let mut options = RenderOptions::default();
    // Where a track stops depends on the order in which its window is summed.
    options.registration.klt.epsilon_px = 1e-5;
    options.registration.klt.iterations = 60;
    for quarter_turns in 1..4 {
        let change = change(&Scene { quarter_turns, ..Scene::default() }, &options);
        assert!(change.offset_std_errs <= 0.1 && change.values <= W * H / 100, "{change:?}");
    }
}
