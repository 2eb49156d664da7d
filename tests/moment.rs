//! Many views of one instant, beside views computed one by one.

mod common;

use common::bodies::{Recording, World, board_before_wall, pose};
use common::scores::psnr_db;
use common::worlds::line_rig;
use nalgebra::Translation3;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::light_field::LightField;
use stlfr::lumigraph::{BlendMethod, Rendered};
use stlfr::offset::Offsets;
use stlfr::options::{Preset, ProxyMethod, RenderOptions, ViewOptions};
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
    let field = LightField::new(capture, offsets, &RenderOptions::default().registration);
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

fn both(field: &LightField, time_s: f64, options: &ViewOptions) -> Vec<[Rendered; 2]> {
    let moment = field.moment(time_s, options).expect("an instant of the recording");
    let pair = |target: &Camera| {
        let alone = field.view(target, time_s, options).expect("a view");
        [moment.view(target).expect("a view"), alone]
    };
    places(field).iter().map(pair).collect()
}

#[test]
fn views_of_a_moment_are_the_same_bytes_as_one_by_one() {
    let (_folder, field) = filmed();
    let time_s = 2.1 / 30.0 - field.capture().time_origin_s;
    let mut all: Vec<ViewOptions> =
        [Preset::Draft, Preset::Balanced].map(|p| p.options().view()).to_vec();
    // Fewer cameras than there are have weight.
    let mut few = all[1].clone();
    few.blend.method = BlendMethod::SpaceTime;
    few.proxy.depth.cameras = 2;
    all.push(few);
    all.push(RenderOptions::default().view());
    for method in [ProxyMethod::Plane, ProxyMethod::Mesh] {
        for mut options in all.clone() {
            options.proxy.method = method;
            for [of_moment, alone] in both(&field, time_s, &options) {
                assert!(of_moment == alone, "{method:?}");
            }
        }
    }
}

/// There, depths are estimated in another range, and by all cameras.
#[test]
fn over_depth_per_pixel_they_are_as_near_to_the_truth() {
    let (_folder, field) = filmed();
    for method in [BlendMethod::Lumigraph, BlendMethod::SpaceTime] {
        let mut options = RenderOptions::default().view();
        options.proxy.method = ProxyMethod::Depth;
        options.blend.method = method;
        let mut gains_db = Vec::new();
        for frames in (0..16).map(|k| 1.05 + 0.125 * f64::from(k)) {
            let time_s = frames / 30.0 - field.capture().time_origin_s;
            let views = both(&field, time_s, &options);
            for (target, rendered) in places(&field).iter().zip(&views) {
                let truth = world().film(target, frames, 0.0, 1);
                let [of_moment, alone] = rendered.each_ref().map(|r| psnr_db(&r.image, &truth, 24));
                // Where levels lie decides on a few pixels at outlines.
                assert!(of_moment - alone > -0.6, "{method:?}: {of_moment} dB, {alone} dB");
                assert!(of_moment.min(alone) > 34.0, "{method:?}: {of_moment} dB, {alone} dB");
                gains_db.push(of_moment - alone);
            }
        }
        let mean_db = gains_db.iter().sum::<f64>() / gains_db.len() as f64;
        // 0.00 and 0.02 were measured; of 60 views 0.03, with a standard error of 0.03.
        assert!(mean_db.abs() < 0.1, "{method:?}: {mean_db} dB: {gains_db:?} dB");
    }
}

#[test]
fn outside_of_the_recording_there_is_no_moment() {
    let (_folder, field) = filmed();
    let error = field.moment(10.0, &ViewOptions::default()).map(drop).unwrap_err();
    assert!(error.to_string().contains("no camera has frames around"), "{error}");
}

#[test]
fn a_moment_can_keep_its_light_field() {
    let (_folder, field) = filmed();
    let time_s = 2.1 / 30.0 - field.capture().time_origin_s;
    let (options, target) = (Preset::Draft.options().view(), &places(&field)[0]);
    let expected = field.view(target, time_s, &options).unwrap();
    let moment = Arc::new(field).shared_moment(time_s, &options).unwrap();
    assert!(moment.view(target).unwrap() == expected);
}
