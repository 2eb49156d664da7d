//! Flows of filmed bodies whose every point is a formula: the epipolar test, long tracks, large
//! motion.

use crate::common::bodies::Recording;
use crate::common::worlds::{self, case};
use crate::pictures::{pictured, waves};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2};
use std::sync::Arc;
use stlfr::camera::{Camera, CameraModel};
use stlfr::capture::Capture;
use stlfr::host::Memo;
use stlfr::random::Random;
use stlfr::raster::{encoded_from_linear, linear_from_encoded};
use stlfr::registration::{
    FlowDirection, FrameStore, GainMethod, ReferenceQuery, RegistrationOptions, Track, Verdict,
    epipolar_check, select_references, temporal_flow,
};

fn filmed(
    case: &worlds::Case,
    cameras: &[Camera],
    delays: &[f64],
    frames: usize,
) -> (tempfile::TempDir, Arc<Capture>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let first_frames = delays;
    Recording { world: &case.world, cameras, first_frames, frames, noise: 0.004 }
        .write(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    (folder, capture)
}

fn times(capture: &Capture) -> Vec<Option<Vec<f64>>> {
    capture.cameras.iter().map(|c| Some(c.clock.times_s.clone())).collect()
}

#[test]
fn tracks_are_the_same_on_any_number_of_threads() {
    let cameras = worlds::line_rig(2, 160);
    let (_folder, capture) = filmed(&case("magazine"), &cameras, &[0.0, 0.4], 4);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
            let tracks = temporal_flow(&store, 0, 1).expect("tracks");
            let verdicts =
                epipolar_check(&store, &times(&capture), 0, 1, &tracks).expect("verdicts");
            (tracks, verdicts)
        })
    };
    let one = run(1);
    assert!(one.0.len() > 100);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

fn query(camera: usize, interval_s: [f64; 2], time_s: f64) -> ReferenceQuery {
    ReferenceQuery { camera, interval_s, time_s }
}

/// Wrong tracks across the lines are removed, right ones stay; seen through lenses that bend the
/// lines, too.
#[test]
fn the_epipolar_test_removes_what_is_off_its_line() {
    let straight = worlds::line_rig(2, 320);
    let bent: Vec<Camera> = straight
        .iter()
        .map(|camera| {
            let (fx, fy, cx, cy) = camera.model.intrinsics();
            // At the border of the image, 12 pixels.
            let model =
                CameraModel::OpenCv { fx, fy, cx, cy, k1: -0.28, k2: 0.06, p1: 1e-3, p2: -1e-3 };
            Camera { model, ..camera.clone() }
        })
        .collect();
    for cameras in [straight, bent] {
        let case = case("magazine");
        let (_folder, capture) = filmed(&case, &cameras, &[0.0, 0.4], 4);
        let options = RegistrationOptions { epipolar_tolerance_px: 1.5, ..Default::default() };
        let store = FrameStore::new(capture.clone(), &options);
        let tracks = temporal_flow(&store, 0, 1).expect("tracks");
        let mut random = Random::new(11);
        let mut counts = [0; 4];
        let wronged: Vec<(Track, bool)> = tracks
            .iter()
            .map(|track| {
                let is_wrong = random.unit() < 0.3;
                let error = Vector2::new(0.0, if random.unit() < 0.5 { 8.0 } else { -8.0 });
                let mut track = track.clone();
                if is_wrong && track.direction == FlowDirection::Backward {
                    track.earlier += error;
                } else if is_wrong {
                    track.later += error;
                }
                if is_wrong {
                    (track.before, track.after) = (None, None);
                }
                (track, is_wrong)
            })
            .collect();
        let given: Vec<Track> = wronged.iter().map(|(t, _)| t.clone()).collect();
        let verdicts = epipolar_check(&store, &times(&capture), 0, 1, &given).expect("verdicts");
        for ((_, is_wrong), verdict) in wronged.iter().zip(verdicts) {
            match (is_wrong, verdict) {
                (_, Verdict::Untestable) => {}
                (true, Verdict::Rejected) => counts[0] += 1,
                (true, Verdict::Passed) => counts[1] += 1,
                (false, Verdict::Rejected) => counts[2] += 1,
                (false, Verdict::Passed) => counts[3] += 1,
            }
        }
        let [caught, missed, harmed, kept] = counts;
        println!("{}: {counts:?}", cameras[0].model.name());
        assert!(caught > 50 && missed * 20 <= caught, "{counts:?}");
        assert!(kept > 300 && harmed * 25 <= kept, "{counts:?}");
    }
}

/// A camera that records more light is told, and what it sees still tested; equal ones are equal.
#[test]
fn a_brighter_camera_is_as_good_as_another() {
    let cameras = worlds::line_rig(3, 320);
    let (folder, equal) = filmed(&case("magazine"), &cameras, &[0.0, 0.4, 0.7], 3);
    let passed = |capture: &Arc<Capture>, gains: GainMethod| {
        let options = RegistrationOptions { gains, ..Default::default() };
        let store = FrameStore::new(capture.clone(), &options);
        let tracks = temporal_flow(&store, 0, 1).expect("tracks");
        // The third camera's clock is unknown, so that the bright one alone tests.
        let mut times = times(capture);
        times[2] = None;
        let verdicts = epipolar_check(&store, &times, 0, 1, &tracks).expect("verdicts");
        verdicts.iter().filter(|v| **v == Verdict::Passed).count()
    };
    let told = |capture: &Arc<Capture>| {
        let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
        store.gains().clone()
    };
    assert!(told(&equal).are_equal());
    let all = passed(&equal, GainMethod::Estimated);
    let factors = [1.5, 1.3, 1.7];
    for k in 0..3 {
        let path = folder.path().join(format!("cam1/{k:04}.png"));
        let mut image = image::open(&path).expect("its image").to_rgb8();
        for pixel in image.pixels_mut() {
            for (value, factor) in pixel.0.iter_mut().zip(factors) {
                let light = factor * linear_from_encoded(f64::from(*value) / 255.0);
                *value = (255.0 * encoded_from_linear(light)).round().min(255.0) as u8;
            }
        }
        image.save(&path).expect("its image");
    }
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let gains = told(&capture);
    for (gain, factor) in gains.factors[1].into_iter().zip(factors) {
        assert!((gain / factor - 1.0).abs() < 0.02, "{gains:?}");
    }
    assert_eq!([0, 2].map(|camera| gains.factors[camera]), [[1.0; 3]; 2]);
    let whole = std::fs::read(folder.path().join("cam1/0001.png")).expect("its image");
    let corrected = passed(&capture, GainMethod::Estimated);
    let uncorrected = passed(&capture, GainMethod::Equal);
    assert!(all > 300 && corrected * 20 >= 19 * all, "{all} {corrected}");
    assert!(uncorrected * 10 < 8 * all, "{all} {uncorrected}");
    // What can't be read is not compared, and stops nobody who does not need it.
    std::fs::write(folder.path().join("cam1/0001.png"), &whole[..60]).expect("half an image");
    assert!(told(&capture).are_equal());
}

/// What the nearest camera does not see, the next one tells.
#[test]
fn a_blind_reference_is_replaced_by_the_next() {
    let cameras = worlds::line_rig(3, 320);
    let (folder, _) = filmed(&case("magazine"), &cameras, &[0.0, 0.4, 0.7], 3);
    let blind = image::GrayImage::from_pixel(320, 240, image::Luma([128]));
    for k in 0..3 {
        blind.save(folder.path().join(format!("cam1/{k:04}.png"))).expect("its images");
    }
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let mut tracks = temporal_flow(&store, 0, 1).expect("tracks");
    for track in tracks.iter_mut().step_by(7).filter(|t| t.direction != FlowDirection::Backward) {
        (track.later.y, track.before, track.after) = (track.later.y + 9.0, None, None);
    }
    let helped = epipolar_check(&store, &times(&capture), 0, 1, &tracks).expect("verdicts");
    let count = |all: &[Verdict], which| all.iter().filter(|v| **v == which).count();
    assert!(count(&helped, Verdict::Passed) * 10 > 7 * helped.len(), "{helped:?}");
    assert!(count(&helped, Verdict::Rejected) * 20 > helped.len(), "{helped:?}");
}

/// A camera at half the rate has no frame in the interval; its own tracks tell what is between.
#[test]
fn a_slower_reference_is_interpolated() {
    let cameras = worlds::line_rig(2, 320);
    let (folder, full) = filmed(&case("magazine"), &cameras, &[0.0, 0.4], 4);
    let path = |k: usize| folder.path().join(format!("cam1/{k:04}.png"));
    std::fs::rename(path(2), path(1)).expect("its second frame");
    for k in [2, 3] {
        let _ = std::fs::remove_file(path(k));
    }
    let own = full.cameras[0].clock.times_s.clone();
    let step = own[1] - own[0];
    let file = folder.path().join("capture.json");
    let text = std::fs::read_to_string(&file).expect("the capture");
    let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let first = full.cameras[1].clock.times_s[0] - own[0];
    json["cameras"][1]["clock"] =
        serde_json::json!({"times_s": [first, first + 2.0 * step], "shared": true});
    std::fs::write(&file, json.to_string()).expect("the capture");
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    let times = times(&capture);
    let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let own = times[0].as_ref().expect("known");
    let slow = times[1].as_ref().expect("known");
    assert!(slow[0] < own[1] && own[2] < slow[1], "{own:?} {slow:?}");
    let chosen = select_references(&capture, &times, &query(0, [own[1], own[2]], own[2])).first;
    assert_eq!(chosen.len(), 1);
    assert_eq!((chosen[0].frame, chosen[0].time_s), (0, own[2]));
    assert_eq!(chosen[0].between, Some([slow[0], slow[1]]));
    let tracks = temporal_flow(&store, 0, 1).expect("tracks");
    let counts = |wrong: f64| {
        let given: Vec<Track> = tracks
            .iter()
            .map(|t| {
                let mut t = Track { before: None, after: None, ..t.clone() };
                // At the end that was looked for.
                if t.direction == FlowDirection::Backward {
                    t.earlier.y += wrong;
                } else {
                    t.later.y += wrong;
                }
                t
            })
            .collect();
        let verdicts = epipolar_check(&store, &times, 0, 1, &given).expect("verdicts");
        [Verdict::Passed, Verdict::Rejected].map(|v| verdicts.iter().filter(|w| **w == v).count())
    };
    let [passed, rejected] = counts(0.0);
    assert!(passed > tracks.len() / 2 && rejected * 50 <= passed, "{passed} {rejected}");
    let [passed, rejected] = counts(8.0);
    assert!(rejected > tracks.len() / 2 && passed * 20 <= rejected, "{passed} {rejected}");
}

/// Without its clock, a camera is no reference, and its own tracks are not tested.
#[test]
fn unknown_times_are_left_out() {
    let cameras = worlds::line_rig(3, 160);
    let (_folder, capture) = filmed(&case("magazine"), &cameras, &[0.0, 0.4, 0.2], 3);
    let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let tracks = temporal_flow(&store, 1, 0).expect("tracks");
    let mut known = times(&capture);
    (known[0], known[2]) = (None, None);
    let alone = epipolar_check(&store, &known, 1, 0, &tracks).expect("verdicts");
    assert!(alone.iter().all(|v| *v == Verdict::Untestable));
    let mut known = times(&capture);
    known[1] = None;
    let own = epipolar_check(&store, &known, 1, 0, &tracks).expect("verdicts");
    assert!(own.iter().all(|v| *v == Verdict::Untestable));
    let both = epipolar_check(&store, &times(&capture), 1, 0, &tracks).expect("verdicts");
    assert!(both.iter().filter(|v| **v == Verdict::Passed).count() > tracks.len() / 3);
}

/// Cameras of one frame each, as many as centres, at times in seconds.
fn placed(centers: &[[f64; 3]], times_s: &[f64]) -> (Capture, Vec<Option<Vec<f64>>>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut cameras = worlds::line_rig(centers.len(), 16);
    for (camera, center) in cameras.iter_mut().zip(centers) {
        camera.cam_from_world = Isometry3::from_parts(
            Translation3::new(-center[0], -center[1], -center[2]),
            UnitQuaternion::identity(),
        );
    }
    let first_frames = vec![0.0; cameras.len()];
    let (world, first_frames) = (&case("ball").world, &first_frames);
    Recording { world, cameras: &cameras, first_frames, frames: 1, noise: 0.0 }
        .write(folder.path());
    let capture = Capture::open(folder.path()).expect("a capture");
    let times = times_s.iter().map(|&t| Some(vec![t, t + 1.0])).collect();
    (capture, times)
}

#[test]
fn a_line_has_one_reference_and_a_grid_a_row_s_and_a_column_s() {
    let line: Vec<[f64; 3]> = (0..5).map(|c| [0.06 * f64::from(c), 0.0, 0.0]).collect();
    // Camera 2 asks at its second frame, t = 1: of its neighbours, 3 is nearer in time.
    let (capture, times) = placed(&line, &[0.9, 0.4, 0.0, 0.7, 0.95]);
    let chosen = select_references(&capture, &times, &query(2, [0.0, 1.0], 1.0)).first;
    let names: Vec<_> = chosen.iter().map(|r| (r.camera, r.frame)).collect();
    assert_eq!(names, [(3, 0)]);
    // At t = 0, eq. (5) takes frames within [0, 1] only, and camera 1 is nearer.
    let chosen = select_references(&capture, &times, &query(2, [0.0, 1.0], 0.0)).first;
    assert_eq!(chosen.iter().map(|r| r.camera).collect::<Vec<_>>(), [1]);

    let grid: Vec<[f64; 3]> =
        (0..9).map(|c| [0.06 * f64::from(c % 3), 0.06 * f64::from(c / 3), 0.0]).collect();
    let (capture, times) = placed(&grid, &[0.5, 0.2, 0.9, 0.6, 0.0, 0.3, 0.5, 0.8, 0.5]);
    let chosen = select_references(&capture, &times, &query(4, [0.0, 1.0], 1.0)).first;
    // Row: 3 (at 0.6) before 5; column: 7 (at 0.8) before 1; 7 is the nearer in time.
    assert_eq!(chosen.iter().map(|r| r.camera).collect::<Vec<_>>(), [7, 3]);
    // Only the frame that lies within the interval can be a reference's.
    let late: Vec<_> = times
        .iter()
        .map(|t| t.as_ref().map(|t| t.iter().map(|t| t + 5.0).collect::<Vec<_>>()))
        .collect();
    assert!(select_references(&capture, &late, &query(4, [0.0, 1.0], 1.0)).first.is_empty());
}

/// A capture of one camera with so many frames: a surface that goes around in a circle, once in 40 frames. Its
/// frames are links to 40 images.
fn circling(frames: usize) -> (tempfile::TempDir, Arc<Capture>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let value = waves(&mut Random::new(5), 1);
    let shift = |k: usize| {
        let angle = std::f64::consts::TAU * (k % 40) as f64 / 40.0;
        Vector2::new(6.0 * angle.cos(), 6.0 * angle.sin())
    };
    std::fs::create_dir(folder.path().join("cam0")).expect("a folder");
    for k in 0..40 {
        let s = shift(k);
        let image = pictured(64, 48, 1, 255.0, |x, y, c| value(x - s.x, y - s.y, c));
        let path = folder.path().join(format!("image{k}.png"));
        stlfr::raster::write_image(&path, &image, None, stlfr::raster::BitDepth::Eight)
            .expect("an image can be written");
    }
    for k in 0..frames {
        std::os::unix::fs::symlink(
            folder.path().join(format!("image{}.png", k % 40)),
            folder.path().join(format!("cam0/{k:04}.png")),
        )
        .expect("a link");
    }
    let camera = worlds::line_rig(1, 64).remove(0);
    let rotation = [1.0, 0.0, 0.0, 0.0];
    let capture = serde_json::json!({"format": "stlfr-capture", "version": 1, "name": "circle",
        "cameras": [{"id": "cam0", "frames": "cam0/%04d.png", "width": 64, "height": 48,
            "model": "PINHOLE", "params": camera.model.params(), "color": "gray",
            "cam_from_world": {"rotation_wxyz": rotation, "translation": [0, 0, 0]},
            "clock": {"rate_hz": 30.0, "first_s": 0.0, "shared": false}}]});
    std::fs::write(folder.path().join("capture.json"), capture.to_string()).expect("a file");
    let capture = Arc::new(Capture::open(folder.path()).expect("a capture"));
    (folder, capture)
}

/// The memory of a store does not grow with the number of frames.
#[test]
fn a_frame_store_stays_within_its_bound() {
    const FRAMES: usize = 400;
    const BOUND: usize = 1 << 20;
    let (_folder, capture) = circling(FRAMES);
    let options = RegistrationOptions::default();
    let store = FrameStore::with_memo(capture, &options, Arc::new(Memo::new(BOUND)));
    for k in 0..FRAMES {
        assert!(!store.get(0, k).expect("a frame").corners(&options).is_empty());
        assert!(store.memo.bytes() <= BOUND, "{} bytes", store.memo.bytes());
    }
}

/// 40 pixels a frame at 640×480: most corners of the body are found.
#[test]
fn large_motion_is_followed() {
    let cameras = worlds::line_rig(1, 640);
    let case = case("fast");
    // Where it goes across the middle.
    const START: f64 = 7.0;
    let (_folder, capture) = filmed(&case, &cameras, &[START], 2);
    let store = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let tracks = temporal_flow(&store, 0, 0).expect("tracks");
    let (mut right, mut wrong, mut longest) = (0, 0, 0.0_f64);
    for t in tracks.iter().filter(|t| t.in_forward_set()) {
        let Some(surface) = case.world.seen(&cameras[0], &t.earlier, START) else { continue };
        if surface.body == 0 || !case.world.is_seen(&surface, &cameras[0], START + 1.0) {
            continue;
        }
        let truth = case.world.position(&surface, &cameras[0], START + 1.0).expect("it is seen");
        longest = longest.max((truth - t.earlier).norm());
        if (t.later - truth).norm() < 1.0 {
            right += 1;
        } else {
            wrong += 1;
        }
    }
    assert!(longest > 40.0, "{longest}");
    assert!(right > 500 && wrong * 50 < right, "{right} right, {wrong} wrong");
}
