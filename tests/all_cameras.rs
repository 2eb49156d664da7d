//! Synchronized images from all cameras, where one camera's own frames can't show what happened.

mod common;

use common::bodies::{Recording, World, board_before_wall, pose};
use common::scores::psnr_db;
use common::worlds::line_rig;
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::Image;
use tempfile::TempDir;

/// When the board bounces, frames on the world's clock.
const BOUNCE: f64 = 2.25;

/// A board that falls, and rises again as quickly, before a still wall.
fn bouncing() -> World {
    // 40 px a frame at 320×240.
    board_before_wall(|frames| pose([0.0; 3], [0.0, 0.2 - 0.15 * (frames - BOUNCE).abs(), 1.3]))
}

/// Four cameras, every other one a quarter of a frame later.
fn filmed(world: &World) -> (TempDir, LightField) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cameras = line_rig(4, 320);
    let first_frames = &[0.0, 0.25, 0.0, 0.25];
    Recording { world, cameras: &cameras, first_frames, frames: 6, noise: 0.004 }
        .write(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let offsets = Offsets::known(&capture);
    let field = LightField::new(capture, offsets);
    (folder, field)
}

/// A camera's image at a time in frames on the world's clock.
fn synchronized(field: &LightField, camera: usize, frames: f64, sync: SyncMethod) -> Image {
    let time_s = frames / 30.0 - field.capture().time_origin_s;
    let options = RenderOptions { sync, ..RenderOptions::default() };
    field.synchronized(camera, time_s, &options).expect("an instant of the film").image.clone()
}

#[test]
fn a_bounce_between_two_frames_is_seen_by_the_other_cameras() {
    let world = bouncing();
    let (_folder, field) = filmed(&world);
    for camera in [0, 2] {
        let truth = world.film(&field.capture().cameras[camera].camera, BOUNCE, 0.0, 5);
        let of = |sync| psnr_db(&synchronized(&field, camera, BOUNCE, sync), &truth, 8);
        let (own, all) = (of(SyncMethod::Refined), of(SyncMethod::AllCameras));
        assert!(all > own + 1.0, "cam{camera}: {own} dB alone, {all} dB from all");
    }
}

#[test]
fn a_frame_stays_as_filmed_and_one_camera_alone_is_refined() {
    let world = bouncing();
    let (folder, field) = filmed(&world);
    let frame = field.capture().read_frame(1, 2).expect("a frame");
    assert_eq!(synchronized(&field, 1, 2.25, SyncMethod::AllCameras), frame);

    common::edit(folder.path(), |capture| {
        let cameras = capture["cameras"].as_array_mut().expect("a list");
        cameras.truncate(1);
    });
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let offsets = Offsets::known(&capture);
    let alone = LightField::new(capture, offsets);
    let of = |sync| synchronized(&alone, 0, 2.3, sync);
    assert_eq!(of(SyncMethod::AllCameras), of(SyncMethod::Refined));
}
