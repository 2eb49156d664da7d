//! Many views of one instant, beside views rendered one by one.

mod common;

use common::bodies::{Recording, World, board_before_wall, pose};
use common::worlds::line_rig;
use nalgebra::Translation3;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, LightField};
use stlfr::lumigraph::{BlendMethod, Rendered};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{Preset, ProxyMethod, RenderOptions};
use tempfile::TempDir;

/// A board that moves right, before a still wall.
fn world() -> World {
    board_before_wall(|frames| pose([0.0; 3], [0.02 * frames, 0.0, 1.3]))
}

/// Four cameras, every other one a quarter of a frame later.
fn filmed() -> (TempDir, LightField) {
    let (world, cameras) = (world(), line_rig(4, 320));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let first_frames = &[0.0, 0.25, 0.0, 0.25];
    Recording { world: &world, cameras: &cameras, first_frames, frames: 5, noise: 0.004 }
        .write(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let offsets = Offsets::known(&capture);
    let field = LightField::new(capture, offsets);
    (folder, field)
}

/// Between two cameras, and above one.
fn places(field: &LightField) -> [Camera; 2] {
    let first = &field.capture().cameras[1].camera;
    [[-0.03, 0.0, 0.0], [0.0, 0.05, 0.0]].map(|[x, y, z]| {
        let mut camera = first.clone();
        camera.cam_from_world = Translation3::new(x, y, z) * camera.cam_from_world;
        camera
    })
}

/// Views from both places of a light field that is used for the first time.
fn alone(field: &LightField, time_s: f64, options: &RenderOptions) -> Vec<Rendered> {
    let fresh = || LightField::new(Arc::new(field.capture().clone()), field.offsets().clone());
    let view = |target: &Camera| fresh().view(target, time_s, options).expect("a view");
    places(field).iter().map(view).collect()
}

/// Whatever was rendered before, by whatever options, a view is the same.
#[test]
fn views_of_an_instant_are_the_same_bytes_as_one_by_one() {
    let (_folder, field) = filmed();
    let time_s = 2.1 / 30.0 - field.capture().time_origin_s;
    let mut all: Vec<RenderOptions> =
        [Preset::Draft, Preset::Balanced].map(|p| p.options()).to_vec();
    // Fewer cameras than there are have weight.
    let mut few = all[1].clone();
    few.blend.method = BlendMethod::SpaceTime;
    few.proxy.depth.cameras = 2;
    all.push(few);
    all.push(RenderOptions::default());
    all.push(RenderOptions::default().with_sync(SyncMethod::AllCameras));
    let by_proxy = |options: &RenderOptions, method: ProxyMethod| {
        let mut options = options.clone();
        options.proxy.method = method;
        let expected = alone(&field, time_s, &options);
        (options, expected)
    };
    let mut all: Vec<(RenderOptions, Vec<Rendered>)> = (all.iter())
        .flat_map(|options| ProxyMethod::ALL.iter().map(|&method| by_proxy(options, method)))
        .collect();
    // Cameras whose images are cached whole, and others.
    for is_cached in [false, true] {
        for (options, expected) in &all {
            if is_cached {
                field.synchronized_all(time_s, options, &Context::unattended()).expect("images");
            }
            let views = places(&field).map(|target| field.view(&target, time_s, options).unwrap());
            assert!(views.to_vec() == *expected, "{is_cached}, {options:?}");
        }
        all.reverse();
    }
}
