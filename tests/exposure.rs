//! A camera whose automatic exposure and white balance change while it films: what comes of it is what comes of the
//! same recording without the change.

mod common;

use common::arc::arc_rig;
use common::bodies::{Recording, board_before_wall, pose};
use common::scores::psnr_db;
use common::wall::estimate;
use common::worlds::line_rig;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, LightField, Request, Viewpoint, render};
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::{
    BitDepth, Image, encoded_from_linear, linear_from_encoded, read_image, write_image,
};
use stlfr::registration::{GainMethod, RegistrationOptions};
use tempfile::TempDir;

const FRAMES: usize = 10;
const FIRST_FRAMES: [f64; 3] = [0.0, 0.4, 0.75];
/// The camera whose gains change.
const CHANGING: usize = 1;
/// Factors on its light, by channel, in its last frame; 1 in its first.
const LAST: [f64; 3] = [1.5, 1.4, 1.2];
/// Margin that is left out of comparisons, pixels.
const MARGIN: usize = 8;

/// Three cameras that film a board on a curve before a still wall.
fn filmed() -> TempDir {
    let world = board_before_wall(|frames| {
        let angle = 0.35 * frames;
        pose([0.0; 3], [0.12 * angle.cos(), 0.1 * angle.sin(), 1.3])
    });
    let (cameras, folder) = (line_rig(3, 160), tempfile::tempdir().expect("a temporary folder"));
    Recording {
        world: &world,
        cameras: &cameras,
        first_frames: &FIRST_FRAMES,
        frames: FRAMES,
        noise: 0.004,
    }
    .write(folder.path());
    folder
}

/// The factors on the changing camera's light at a frame, which may lie between two.
fn factors(frame: f64) -> [f64; 3] {
    LAST.map(|last| (last.ln() * frame / (FRAMES - 1) as f64).exp())
}

/// The image with its light multiplied by these factors, clipped.
fn brightened(image: &Image, factors: [f64; 3]) -> Image {
    let value = |(k, v): (usize, &f32)| {
        let light = factors[k % 3] * linear_from_encoded(f64::from(*v));
        encoded_from_linear(light).min(1.0) as f32
    };
    let data = image.data().iter().enumerate().map(value).collect();
    Image::from_data(image.width(), image.height(), 3, data)
}

/// A copy of the recording, in which the light of some frames is multiplied by factors. A change is a camera, a frame, and
/// the factors by channel.
fn copy_with(folder: &Path, changes: impl Iterator<Item = (usize, usize, [f64; 3])>) -> TempDir {
    let changed = tempfile::tempdir().expect("a temporary folder");
    common::copy_folder(folder, changed.path());
    for (camera, frame, factors) in changes {
        let path = changed.path().join(format!("cam{camera}/{frame:04}.png"));
        let image = read_image(&path).expect("a frame").0;
        write_image(&path, &brightened(&image, factors), None, BitDepth::Eight)
            .expect("a frame can be written");
    }
    changed
}

/// The same recording with changing gains.
fn with_change(folder: &Path) -> TempDir {
    copy_with(folder, (0..FRAMES).map(|k| (CHANGING, k, factors(k as f64))))
}

/// Factors on the light of four cameras, by channel. The first is the reference.
const FACTORS: [[f64; 3]; 4] = [[1.0; 3], [1.35, 1.25, 1.2], [0.7, 0.72, 0.65], [1.0; 3]];

/// The same recording, whose cameras have other gains.
fn with_factors(folder: &Path) -> TempDir {
    let cameras = FACTORS.into_iter().enumerate();
    copy_with(folder, cameras.flat_map(|(c, factors)| (0..3).map(move |k| (c, k, factors))))
}

/// Four cameras 15 degrees apart look at a place between a still board and a wall.
fn filmed_around() -> TempDir {
    let world = board_before_wall(|_| pose([10.0, -15.0, 5.0], [0.0, 0.0, 1.6]));
    let cameras = arc_rig(256, 15.0, 1.8, 1.6);
    let folder = tempfile::tempdir().expect("a temporary folder");
    Recording {
        world: &world,
        cameras: &cameras,
        first_frames: &[0.0; 4],
        frames: 3,
        noise: 0.004,
    }
    .write(folder.path());
    folder
}

fn opened(folder: &Path) -> LightField {
    let capture = Arc::new(Capture::open(folder).expect("a capture"));
    LightField::new(capture.clone(), Offsets::known(&capture))
}

/// An instant in frames on the world's clock, seconds from the capture's start.
fn time_s(field: &LightField, frames: f64) -> f64 {
    frames / 30.0 - field.capture().time_origin_s
}

/// The view from halfway between the first two cameras, and its coverage.
fn view(field: &LightField, frames: f64, options: &RenderOptions) -> (Image, Vec<bool>) {
    let mut target = field.capture().cameras[CHANGING].camera.clone();
    target.cam_from_world.translation.x += 0.03;
    let rendered = field.view(&target, time_s(field, frames), options).expect("a view");
    (rendered.image, rendered.coverage)
}

/// The image of the changing camera at an instant.
fn like(field: &LightField, frames: f64, options: &RenderOptions) -> Image {
    let request = Request::new(Viewpoint::Like(CHANGING), time_s(field, frames), options);
    render(field, &request, &Context::unattended()).expect("an image").image
}

#[test]
fn changing_gains_are_recovered_and_steady_ones_are_equal() {
    let folder = filmed();
    let options = RegistrationOptions::default();
    let steady = opened(folder.path()).gains(&options);
    assert!(steady.are_equal(), "{steady:?}");

    let changed = with_change(folder.path());
    let field = opened(changed.path());
    let gains = field.gains(&options);
    for camera in [0, 2] {
        assert!(gains.curves[camera].is_constant() && gains.factors[camera] == [1.0; 3]);
    }
    for (k, time_s) in field.capture().cameras[CHANGING].clock.times_s.iter().enumerate() {
        for (found, true_gain) in gains.at(CHANGING, *time_s).into_iter().zip(factors(k as f64)) {
            assert!((found / true_gain - 1.0).abs() < 0.015, "frame {k}: {found} {true_gain}");
        }
    }
    // Stored and read again.
    field.prepare(&RenderOptions::default(), |_| ()).expect("a capture that can be prepared");
    assert_eq!(opened(changed.path()).gains(&options), gains);
}

/// Features are hardly matched between cameras 15 degrees apart.
#[test]
fn gains_of_cameras_around_the_scene_are_recovered() {
    let folder = filmed_around();
    let options = RegistrationOptions::default();
    let equal = opened(folder.path()).gains(&options);
    assert!(equal.are_equal(), "{equal:?}");

    let changed = with_factors(folder.path());
    let field = opened(changed.path());
    assert_eq!(field.capture().reference, 0);
    let gains = field.gains(&options);
    for (found, expected) in gains.factors.iter().flatten().zip(FACTORS.iter().flatten()) {
        assert!((found / expected - 1.0).abs() < 0.02, "{:?}", gains.factors);
    }
    // Stored and read again.
    field.prepare(&RenderOptions::default(), |_| ()).expect("a capture that can be prepared");
    assert_eq!(opened(changed.path()).gains(&options), gains);
}

/// At two instants near the ends of the recording, where the gains differ most from those of the middle frame.
#[test]
fn views_and_synchronized_images_are_those_without_the_change() {
    let folder = filmed();
    let changed = with_change(folder.path());
    let (steady, changing) = (opened(folder.path()), opened(changed.path()));
    let mut options = RenderOptions::default();
    let mut uncorrected = options.clone();
    uncorrected.registration.gains = GainMethod::Equal;
    for frames in [1.15, 8.15] {
        let expected = view(&steady, frames, &options).0;
        let found = view(&changing, frames, &options).0;
        let without = view(&changing, frames, &uncorrected).0;
        let [found, without] = [found, without].map(|image| psnr_db(&image, &expected, MARGIN));
        println!("view at {frames}: {found:.1} dB, {without:.1} dB uncorrected");
        assert!(found > 50.0 && found > without + 6.0, "{found} dB, {without} dB uncorrected");
    }
    let methods = [SyncMethod::Nearest, SyncMethod::Crossfade, SyncMethod::Refined];
    let by_flow = [(SyncMethod::Refined, ProxyMethod::SceneFlow)];
    let all = methods.map(|sync| (sync, ProxyMethod::Depth)).into_iter().chain(by_flow);
    for (sync, proxy) in all.chain([(SyncMethod::AllCameras, ProxyMethod::Depth)]) {
        (options.sync, options.proxy.method) = (sync, proxy);
        for frames in [1.9, 7.9] {
            let own = factors(frames - FIRST_FRAMES[CHANGING]);
            let expected = brightened(&like(&steady, frames, &options), own);
            let found = psnr_db(&like(&changing, frames, &options), &expected, MARGIN);
            println!("{sync:?}, {proxy:?} at {frames}: {found:.1} dB");
            let least = if proxy == ProxyMethod::SceneFlow { 43.0 } else { 50.0 };
            assert!(found > least, "{sync:?}, {proxy:?} at {frames}: {found} dB");
        }
    }
}

#[test]
fn offsets_are_as_good_as_without_the_change() {
    let folder = filmed();
    common::edit(folder.path(), |capture| {
        for camera in capture["cameras"].as_array_mut().expect("a list") {
            camera["clock"] = serde_json::json!({"rate_hz": 30.0, "first_s": 0.0, "shared": false});
        }
    });
    let changed = with_change(folder.path());
    let largest_error = |folder: &Path| {
        let offsets = estimate(&Arc::new(Capture::open(folder).expect("a capture")));
        let error = |(camera, first): (usize, f64)| {
            let found_s = offsets.cameras[camera].offset_s.unwrap_or(f64::INFINITY);
            (30.0 * found_s - first).abs()
        };
        FIRST_FRAMES.into_iter().enumerate().map(error).fold(0.0, f64::max)
    };
    let [steady, changing] = [folder.path(), changed.path()].map(largest_error);
    println!("offsets: {steady:.4} frame, {changing:.4} with the change");
    assert!(steady < 0.02 && changing < steady + 0.01, "{steady} {changing}");
}
