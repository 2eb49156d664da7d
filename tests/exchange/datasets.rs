//! What is exported comes back.

use crate::common::{assert_refused, edit, run, stderr, succeed, synthetic, text};
use crate::{clocks, open};
use serde_json::json;
use std::path::Path;
use stlfr::exchange::read_nerf;
use stlfr::raster::read_image;

/// All frames, poses and times of two captures are the same, camera by camera.
#[track_caller]
fn assert_same(found: &Path, expected: &Path, times_s: &[Vec<f64>], is_named: bool) {
    let (found, expected) = (open(found), open(expected));
    assert_eq!(found.cameras.len(), expected.cameras.len());
    for (b, camera) in expected.cameras.iter().enumerate() {
        let a = if is_named { found.camera_index(&camera.id).unwrap() } else { b };
        let [pose, other] = [&found.cameras[a], camera].map(|c| c.camera.cam_from_world);
        assert!((pose.to_homogeneous() - other.to_homogeneous()).amax() < 1e-6, "{pose} {other}");
        let times = found.times_in_file_s(a);
        assert_eq!(times.len(), times_s[b].len());
        for (time, expected) in times.iter().zip(&times_s[b]) {
            assert!((time - expected).abs() <= 1e-9, "{time} {expected}");
        }
        for frame in 0..times.len() {
            let (image, other) =
                (found.read_frame(a, frame).unwrap(), expected.read_frame(b, frame).unwrap());
            let off = image.data().iter().zip(other.data()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f32::max) <= 1.0 / 255.0, "{} {frame}", camera.id);
        }
    }
}

/// A capture whose cameras are synchronized: rendered at the frames' times, images are the frames.
#[test]
fn synchronized_images_come_back_in_every_format() {
    let folder = synthetic::capture(&[0.0, 0.0, 0.0], 4);
    edit(folder.path(), |json| {
        for c in 0..3 {
            json["cameras"][c]["clock"]["shared"] = json!(true);
        }
    });
    let capture = text(folder.path());
    let times_s: Vec<Vec<f64>> =
        vec![(0..4).map(|k| f64::from(k) / synthetic::RATE_HZ).collect(); 3];
    let out = tempfile::tempdir().unwrap();
    for (format, calibration, images) in [
        ("colmap", "sparse/0", "images"),
        ("nerf", "transforms.json", "."),
        ("llff", "poses_bounds.npy", "."),
    ] {
        let data = out.path().join(format);
        let mut export =
            vec!["-q", "export", capture, "--synchronized", "--format", format, "-o", text(&data)];
        if format == "llff" {
            export.extend(["--near", "1", "--far", "6"]);
        }
        succeed(&export);
        let again = out.path().join(format!("{format}-again"));
        let [calibration, images] = [calibration, images].map(|name| data.join(name));
        succeed(&[
            "import",
            text(&calibration),
            "--images",
            text(&images),
            "--shared",
            "-o",
            text(&again),
        ]);
        assert_same(&again, folder.path(), &times_s, format != "llff");
        // It takes nothing of what is there.
        assert_refused(&run(&export), 2, "holds files already");
    }
    let outside = ["--times", "0.05:0.3:3", "-o", "target/none"];
    let export = ["-q", "export", capture, "--synchronized", "--format", "nerf"];
    let words = "not all cameras film at 0.1750 s; all do from 0.0000 to 0.1000 s";
    assert_refused(&run(&[&export[..], &outside].concat()), 2, words);
    let frames = ["export", capture, "--frames", "--near", "1", "--far", "2", "--format", "llff"];
    assert_refused(&run(&[&frames[..], &["-o", "target/none"]].concat()), 2, "llff has no times");
}

/// Frames as they were filmed have their times on the reference's clock, and come back as a synchronized clock's.
#[test]
fn filmed_frames_come_back_with_their_estimated_times() {
    let folder = synthetic::capture(&[0.0, 0.3, 0.6], 3);
    let offset_s = [-0.3, 0.0, 0.3].map(|frames| frames / synthetic::RATE_HZ);
    let camera = |k: usize| json!({"id": format!("cam{k}"), "offset_s": offset_s[k], "std_err_s": if k == 1 { 0.0 } else { 1e-5 }});
    let offsets = json!({"reference": "cam1", "cameras": [camera(0), camera(1), camera(2)]});
    std::fs::write(folder.path().join("offsets.json"), offsets.to_string()).unwrap();
    let times_s: Vec<Vec<f64>> = offset_s
        .iter()
        .map(|offset| (0..3).map(|k| f64::from(k) / synthetic::RATE_HZ + offset).collect())
        .collect();
    let out = tempfile::tempdir().unwrap();
    for (format, calibration, images) in
        [("colmap", "sparse/0", "images"), ("nerf", "transforms.json", ".")]
    {
        let data = out.path().join(format);
        succeed(&[
            "export",
            text(folder.path()),
            "--frames",
            "--format",
            format,
            "-o",
            text(&data),
        ]);
        let again = out.path().join(format!("{format}-again"));
        let [calibration, images] = [calibration, images].map(|name| data.join(name));
        let output =
            succeed(&["import", text(&calibration), "--images", text(&images), "-o", text(&again)]);
        assert!(stderr(&output).contains("as of one clock"), "{}", stderr(&output));
        assert_same(&again, folder.path(), &times_s, true);
        assert!(clocks(&again).iter().all(|clock| clock["shared"] == true));
    }
    let times = std::fs::read(out.path().join("colmap/sparse/0/times.bin")).unwrap();
    // Nine images; the first is the reference's, image 1 at 0 ns.
    assert_eq!(
        times[..20],
        [&9_u64.to_le_bytes()[..], &1_u32.to_le_bytes(), &0_i64.to_le_bytes()].concat()
    );
    assert_eq!(times.len(), 8 + 9 * 12);
}

/// Lenses that the formats can't hold are straightened.
#[test]
fn distorted_lenses_are_undistorted_on_request() {
    let folder = synthetic::capture(&[0.0, 0.0], 2);
    edit(folder.path(), |json| {
        for c in 0..2 {
            json["cameras"][c]["clock"]["shared"] = json!(true);
            json["cameras"][c]["model"] = json!("SIMPLE_RADIAL");
            json["cameras"][c]["params"] = json!([170.0, 81.0, 60.0, -0.05]);
        }
    });
    let out = tempfile::tempdir().unwrap();
    let data = out.path().join("data");
    let export =
        ["-q", "export", text(folder.path()), "--synchronized", "--format", "llff", "--near", "1"];
    let export = [&export[..], &["--far", "6", "-o", text(&data)]].concat();
    assert_refused(&run(&export), 2, "data: can't describe cam0: it knows one focal length");
    succeed(&[&export[..], &["--undistort"]].concat());
    assert!(data.join("cam00.mp4").is_file() && data.join("cam01.mp4").is_file());
    let nerf = out.path().join("nerf");
    let arguments =
        ["export", text(folder.path()), "--synchronized", "--undistort", "--format", "nerf"];
    succeed(&[&arguments[..], &["-o", text(&nerf)]].concat());
    let cameras = read_nerf(&nerf.join("transforms.json")).unwrap();
    assert_eq!(cameras[0].camera.model.params(), [170.0, 170.0, 81.0, 60.0]);
    let (image, _) = read_image(&nerf.join("images/cam0/0000.png")).unwrap();
    assert_eq!((image.width(), image.height()), (160, 120));
}
