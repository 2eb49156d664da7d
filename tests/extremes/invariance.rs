//! Units, places, clocks and orders are the file's: the same recording in others gives the same offsets
//! and the same image.
//!
//! The same means: offsets to 1e-6 frame, values to 1/255. Images that are turned with their cameras
//! are summed in another order, which may turn a threshold's decision on a feature: there offsets
//! agree to a tenth of their standard error, and 99 % of the values to 1/255.

use crate::common::wall::{FRAME_S, H, Scene, W, estimate_by, open, turned, view};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::LazyLock;
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::Image;
use stlfr::registration::RegistrationOptions;

/// The offsets of a capture, and the view from beside the reference camera between two frames,
/// upright.
struct Reconstruction {
    offsets: Offsets,
    view: Image,
}

impl Reconstruction {
    fn new(scene: &Scene, registration: &RegistrationOptions) -> Self {
        let folder = scene.film();
        let capture = open(&folder);
        let options =
            RenderOptions { registration: registration.clone(), ..RenderOptions::default() };
        let offsets = estimate_by(&capture, &options);
        let field = LightField::new(capture, offsets.clone());
        let target = view(&scene.camera([0.02, 0.0, 0.0]));
        let seen = field.view(&target, scene.time_s(1.6), &RenderOptions::default()).unwrap();
        Self { offsets, view: turned(&seen.image, (4 - scene.quarter_turns) % 4) }
    }
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

fn change(a: &Reconstruction, b: &Reconstruction, slowness: f64) -> Change {
    let mut change = Change { offset_frames: 0.0, offset_std_errs: 0.0, values: 0 };
    for camera in &a.offsets.cameras {
        let other = b.offsets.cameras.iter().find(|b| b.id == camera.id).expect("the same cameras");
        let offset_s = camera.offset_s.expect("is known");
        let apart_s = (offset_s - other.offset_s.expect("is known") / slowness).abs();
        change.offset_frames = change.offset_frames.max(apart_s / FRAME_S);
        let std_err_s = camera.std_err_s.expect("has an error");
        if std_err_s > 0.0 {
            change.offset_std_errs = change.offset_std_errs.max(apart_s / std_err_s);
        }
    }
    let pairs = a.view.data().iter().zip(b.view.data());
    change.values = pairs.filter(|(a, b)| !((*a - *b).abs() <= 1.0 / 255.0)).count();
    change
}

#[track_caller]
fn assert_same(scene: &Scene, offset_frames: f64) {
    static UNCHANGED: LazyLock<Reconstruction> =
        LazyLock::new(|| Reconstruction::new(&Scene::default(), &RegistrationOptions::default()));
    let changed = Reconstruction::new(scene, &RegistrationOptions::default());
    let change = change(&UNCHANGED, &changed, scene.slowness);
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
    let options = RegistrationOptions::default();
    let upright = Reconstruction::new(&Scene::default(), &options);
    for quarter_turns in 1..4 {
        let scene = Scene { quarter_turns, ..Scene::default() };
        let change = change(&upright, &Reconstruction::new(&scene, &options), scene.slowness);
        assert!(change.offset_std_errs <= 0.1 && change.values <= W * H / 100, "{change:?}");
    }
}
