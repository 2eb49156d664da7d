use super::*;
use crate::raster::write_image;
use serde_json::{Value, json};

/// Writes and opens a capture of two cameras with three frames each, in a temporary folder. `change` edits
/// `capture.json` before it is written.
fn written(change: impl FnOnce(&mut Value)) -> (tempfile::TempDir, Result<Capture, CaptureError>) {
    let folder = tempfile::tempdir().unwrap();
    let camera = |id: &str| {
        json!({"id": id, "frames": format!("{id}/%02d.png"), "width": 8, "height": 6,
            "model": "PINHOLE", "params": [8.0, 8.0, 4.0, 3.0],
            "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]},
            "clock": {"rate_hz": 30.0, "first_s": 100.0, "shared": false}})
    };
    let mut json = json!({"format": "stlfr-capture", "version": 1, "name": "two",
        "cameras": [camera("a"), camera("b")]});
    for id in ["a", "b"] {
        for k in 0..3 {
            let path = folder.path().join(format!("{id}/{k:02}.png"));
            write_image(&path, &Image::filled(8, 6, 3, 0.5), None, BitDepth::Eight).unwrap();
        }
    }
    change(&mut json);
    std::fs::write(folder.path().join(CAPTURE_FILE), json.to_string()).unwrap();
    let capture = Capture::open(folder.path());
    (folder, capture)
}

#[test]
fn opens_with_the_defaults() {
    let (_folder, capture) = written(|_| ());
    let capture = capture.unwrap();
    assert_eq!((capture.reference, capture.cameras.len()), (0, 2));
    assert_eq!((capture.time_origin_s, capture.cameras[1].clock.times_s[0]), (100.0, 0.0));
    assert!((capture.frame_s() - 1.0 / 30.0).abs() < 1e-12);
    assert_eq!(capture.read_frame(1, 2).unwrap().pixel(3, 3), [128.0 / 255.0; 3]);
}

/// Returns a diagonal `calibration_covariance` of two cameras' poses, in which each parameter has the given variance.
fn covariance(variance: f64) -> Value {
    let row = |k: usize| [vec![0.0; k], vec![variance]].concat();
    json!({"lens": [], "rows": (0..12).map(row).collect::<Vec<_>>()})
}

#[test]
fn calibration_errors_are_read_or_their_field_is_named() {
    assert_eq!(written(|_| ()).1.unwrap().calibration_errors, None);
    let (_folder, capture) = written(|j| j["calibration_covariance"] = covariance(1e-6));
    let errors = capture.unwrap().calibration_errors.unwrap();
    assert_eq!((errors.parameters.len(), errors.covariance[(3, 3)]), (12, 1e-6));
    let (_folder, capture) = written(|j| {
        j["cameras"][1]["calibration_std"] = json!({"focal_relative": 0.005, "centre_m": 0.001});
    });
    let errors = capture.unwrap().calibration_errors.unwrap();
    assert_eq!(errors.covariance.diagonal().as_slice(), [1e-6, 1e-6, 1e-6, 0.005 * 0.005]);
    assert!(errors.parameters.iter().all(|p| p.0 == 1));
    type Break = fn(&mut Value);
    let cases: &[(Break, &str)] = &[
        (|j| j["calibration_covariance"]["rows"][3][0] = json!(1.0), "no covariance"),
        (|j| j["calibration_covariance"]["rows"][3] = json!([1.0]), "rows[3]: has 1 numbers"),
        (|j| j["calibration_covariance"]["lens"] = json!(["focal"]), "have 14 numbers"),
        (|j| j["calibration_covariance"]["lens"] = json!(["focal", "focal"]), "twice"),
        (|j| j["calibration_covariance"] = covariance(-1.0), "no covariance"),
        (|j| j["cameras"][0]["calibration_std"] = json!({}), "a calibration_std too"),
        (|j| j["cameras"][0]["calibration_std"] = json!({"centre_m": -1}), "(a).calibration_std"),
        (|j| j["cameras"][0]["calibration_std"] = json!({"rotation": 1}), "rotation"),
    ];
    for (make_wrong, words) in cases {
        let (_folder, capture) = written(|j| {
            j["calibration_covariance"] = covariance(1e-6);
            make_wrong(j);
        });
        let message = capture.unwrap_err().to_string();
        assert!(message.contains("capture.json") && message.contains(words), "{message}");
    }
}

#[test]
fn every_wrong_field_is_named() {
    type Break = fn(&mut Value);
    let cases: &[(Break, &str)] = &[
        (|j| j["format"] = json!("x"), "format"),
        (|j| j["version"] = json!(2), "version"),
        (|j| j["extra"] = json!(2), "extra"),
        (|j| j["cameras"] = json!([]), "cameras"),
        (|j| j["reference"] = json!("zz"), "reference"),
        (|j| j["cameras"][1]["id"] = json!("a"), "two cameras"),
        (|j| j["cameras"][1]["frames"] = json!("../b/%02d.png"), "(b).frames"),
        (|j| j["cameras"][1]["frames"] = json!("b.mkv"), "(b).frames"),
        (|j| j["cameras"][1]["width"] = json!(9), "00.png"),
        (|j| j["cameras"][1]["params"] = json!([1]), "(b).model"),
        (|j| j["cameras"][1]["clock"] = json!({"shared": false}), "(b).clock"),
        (|j| j["cameras"][1]["clock"] = json!({"shared": false, "times_s": [0, 1]}), "2 entries"),
        (|j| j["cameras"][1]["clock"] = json!({"shared": false, "times_s": [0, 1, 1]}), "ascend"),
        (|j| j["cameras"][1]["clock"]["rate_hz"] = json!(0), "rate_hz"),
        (|j| j["cameras"][1]["clock"]["readout_s"] = json!(-0.01), "(b).clock: readout_s is -0.01"),
        (|j| j["cameras"][1]["clock"]["readout_s"] = json!(0.034), "(b).clock: readout_s is 0.034"),
        (|j| j["cameras"][1]["clock"]["readout_s"] = json!(1e300), "(b).clock: readout_s"),
        (|j| j["cameras"][1]["clock"]["readout_s"] = json!("x"), "cameras[1].clock.readout_s"),
        (|j| j["cameras"][1]["clock"]["readout_std_s"] = json!(-1), "readout_std_s is -1.0, must"),
        (
            |j| j["cameras"][1]["clock"]["first_s"] = json!(1e300),
            "(b).clock: the times must be within",
        ),
        (|j| j["cameras"][1]["clock"]["rate_hz"] = json!(1e300), "ascend by at least"),
        // The times differ in the file. Subtracting the reference's first time rounds them to equal values.
        (
            |j| {
                j["cameras"][0]["clock"]["first_s"] = json!(-1e11);
                j["cameras"][1]["clock"] = json!({"shared": false, "times_s": [0, 1e-8, 2e-8]});
            },
            "(b).clock",
        ),
        (|j| j["cameras"][0]["version"] = json!(1), "cameras[0].version"),
        (|j| j["cameras"][1]["clock"]["shared"] = json!(null), "cameras[1].clock.shared"),
        (|j| j["version"] = json!("1"), "version: "),
    ];
    for (make_wrong, expected) in cases {
        let (_folder, capture) = written(make_wrong);
        let message = capture.unwrap_err().to_string();
        assert!(message.contains(expected) && !message.contains('\n'), "{expected}: {message}");
    }
}

#[test]
fn a_readout_is_at_most_a_frame_interval() {
    let (_folder, capture) = written(|j| {
        j["cameras"][1]["clock"]["readout_s"] = json!(1.0 / 30.0);
    });
    let capture = capture.unwrap();
    let [global, rolling] = [0, 1].map(|c| capture.cameras[c].row_times());
    assert!(global.are_global());
    assert!((rolling.offset_s(5.5) - rolling.offset_s(0.5) - 1.0 / 30.0).abs() < 1e-15);
}

#[test]
fn the_hash_follows_the_content() {
    let (folder, capture) = written(|_| ());
    let hash = || Capture::open(folder.path()).unwrap().content_hash().unwrap().to_owned();
    let capture = capture.unwrap();
    let before = capture.content_hash().unwrap();
    assert_eq!((before.len(), before), (64, hash().as_str()));
    let frame = folder.path().join("b/01.png");
    write_image(&frame, &Image::filled(8, 6, 3, 0.4), None, BitDepth::Eight).unwrap();
    let changed = hash();
    assert!(before != changed && before == capture.content_hash().unwrap());
    let description = folder.path().join(CAPTURE_FILE);
    let text = std::fs::read_to_string(&description).unwrap();
    std::fs::write(&description, text + " ").unwrap();
    assert!(![before, &changed].contains(&hash().as_str()));
}

/// A result that was computed from changed frames must not be stored under the key of the old content.
#[test]
fn a_frame_that_changes_while_it_is_used_is_refused() {
    let change = |folder: &tempfile::TempDir| {
        let frame = folder.path().join("b/01.png");
        write_image(&frame, &Image::filled(8, 6, 3, 0.4), None, BitDepth::Eight).unwrap();
    };
    let refused = |error: CaptureError| {
        let message = error.to_string();
        assert!(message.ends_with("b/01.png: changed while it was being used"), "{message}");
    };
    // The content is hashed first. Then the changed frame is read.
    let (folder, capture) = written(|_| ());
    let capture = capture.unwrap();
    capture.content_hash().unwrap();
    change(&folder);
    refused(capture.read_frame(1, 1).unwrap_err());
    capture.read_frame(1, 2).unwrap();
    // The frame is read first. After the change, the content is hashed and the frame is read again.
    let (folder, capture) = written(|_| ());
    let capture = capture.unwrap();
    capture.read_frame(1, 1).unwrap();
    capture.read_frame(1, 1).unwrap();
    change(&folder);
    refused(capture.content_hash().unwrap_err());
    refused(capture.read_frame(1, 1).unwrap_err());
}

#[test]
fn fewer_cameras_are_another_content_with_the_same_frames() {
    let (folder, capture) = written(|_| ());
    let capture = capture.unwrap();
    let second = capture.with_cameras(&[1]);
    assert_eq!((second.reference, second.cameras[0].id.as_str()), (0, "b"));
    second.read_frame(0, 1).unwrap();
    let hashes = [&capture, &second].map(|capture| capture.content_hash().unwrap());
    assert_ne!(hashes[0], hashes[1]);
    let frame = folder.path().join("b/01.png");
    write_image(&frame, &Image::filled(8, 6, 3, 0.4), None, BitDepth::Eight).unwrap();
    assert!(capture.read_frame(1, 1).is_err());
}

#[test]
fn a_frame_that_changes_before_it_is_read_is_told() {
    let (folder, capture) = written(|_| ());
    let (capture, path) = (capture.unwrap(), folder.path().join("b/01.png"));
    let other = folder.path().join("other.png");
    write_image(&other, &Image::filled(8, 6, 3, 0.25), None, BitDepth::Eight).unwrap();
    let kept = folder.path().join("kept.png");
    std::fs::rename(&path, &kept).unwrap();
    std::fs::rename(&other, &path).unwrap();
    let changed = |result: Result<String, CaptureError>| {
        let message = result.unwrap_err().to_string();
        assert!(message.ends_with("b/01.png: changed while it was being used"), "{message}");
    };
    changed(capture.read_frame(1, 1).map(|_| String::new()));
    changed(capture.content_hash().map(str::to_owned));
    // Once restored, the file is the same as when the capture was opened.
    std::fs::rename(&kept, &path).unwrap();
    capture.read_frame(1, 1).unwrap();
    capture.content_hash().unwrap();
}

#[test]
fn a_true_image_that_changes_after_it_was_hashed_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let truth = serde_json::json!({"format": "stlfr-truth", "version": 1, "scene": "a", "rig": "b",
        "offsets": [], "shutter": [], "views": []});
    std::fs::create_dir(folder.path().join("truth")).unwrap();
    std::fs::write(folder.path().join("truth/truth.json"), truth.to_string()).unwrap();
    let image = |value| {
        let path = folder.path().join("truth/a.png");
        write_image(&path, &Image::filled(8, 6, 3, value), None, BitDepth::Eight).unwrap();
    };
    image(0.5);
    let camera = written(|_| ()).1.unwrap().cameras[0].camera.clone();
    let truth = Truth::open(folder.path()).unwrap().unwrap();
    truth.hash("a.png").unwrap();
    truth.image("a.png", &camera).unwrap();
    image(0.25);
    let message = truth.image("a.png", &camera).unwrap_err().to_string();
    assert!(message.ends_with("a.png: changed while it was being used"), "{message}");
}
