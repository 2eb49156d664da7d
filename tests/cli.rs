//! The command line: help, bad input, and filming that was interrupted.

mod common;

use common::wall::Scene;
use common::{assert_refused, describe, read_json, run, stderr, stlfr, text};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant, SystemTime};
use stlfr::camera::CameraModel;
use stlfr::capture::{Capture, Truth};

#[test]
fn every_command_has_help_with_an_example() {
    let help = String::from_utf8(run(&["--help"]).stdout).unwrap();
    for command in [
        "demo",
        "setup",
        "rig",
        "capture",
        "info",
        "check",
        "offsets",
        "render",
        "compare",
        "tradeoff",
        "options",
        "farm",
        "publish",
        "calibrate",
        "refine",
    ] {
        assert!(help.contains(&format!("\n  {command} ")), "{help}");
        let output = run(&[command, "--help"]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && text.contains("Example"), "{text}");
        assert!(text.contains(&format!("\n  stlfr {command}")), "{text}");
    }
}

#[test]
fn options_are_listed_and_set_by_name() {
    let printed = |more: &[&str]| {
        let output = run(&[&["options"], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let schema: serde_json::Value = serde_json::from_str(&printed(&["--schema"])).unwrap();
    let list: serde_json::Value = serde_json::from_str(&printed(&["--json"])).unwrap();
    let table = printed(&["--preset", "draft", "--set", "trail.instants=7"]);
    assert_eq!(table.lines().count(), list.as_array().unwrap().len());
    for (line, option) in table.lines().zip(list.as_array().unwrap()) {
        let name = option["name"].as_str().unwrap();
        assert!(line.starts_with(&format!("{name} ")), "{line}");
        let path = format!("/properties/{}", name.replace('.', "/properties/"));
        assert_eq!(schema.pointer(&path).unwrap()["default"], option["default"], "{name}");
    }
    let words = |name: &str| table.lines().find(|l| l.starts_with(name)).unwrap().split(' ');
    assert!(words("trail.instants ").any(|word| word == "7"), "{table}");
    assert!(words("sync ").any(|word| word == "triangulation"), "{table}");
    assert_refused(
        &run(&["options", "--set", "blend.camera=4"]),
        2,
        "blend.camera: no such option (similar: blend.cameras)",
    );
    let output = run(&["options", "--set", "proxy.method=depht"]);
    assert_refused(&output, 2, "proxy.method: unknown variant `depht`");
    assert!(!common::stderr(&output).contains("column"));
    assert_refused(&run(&["option"]), 2, "a similar subcommand exists: 'options'");
    assert_refused(&run(&["options", "--set", "blend.cameras=0"]), 2, "blend.cameras: is 0.0");
    assert_refused(&run(&["options", "--set", "trail.mode"]), 2, "trail.mode: ");
    assert_refused(&run(&["options", "--options", "/nowhere.json"]), 2, "/nowhere.json");
}

#[test]
fn a_wrong_command_line_is_one_sentence() {
    let rig = "rigs/linear8.json";
    let capture = |more: &[&str]| run(&[&["capture", rig, "-o", "target/none"], more].concat());
    assert_refused(&run(&["fly"]), 2, "fly");
    assert_refused(&run(&["check"]), 2, "<CAPTURE>");
    assert_refused(&run(&["capture", rig, "--scene", "magazine"]), 2, "--output");
    assert_refused(&capture(&[]), 2, "--scene");
    assert_refused(&capture(&["--scene", "a", "--blend", "b"]), 2, "--blend");
    assert_refused(&capture(&["--scene", "magazine", "--size", "320"]), 2, "320x240");
    assert_refused(&capture(&["--scene", "magazine", "--size", "300x300"]), 2, "another aspect");
    assert_refused(&capture(&["--blend", "README.md"]), 2, "README.md: is not a file of Blender");
    assert_refused(&capture(&["--scene", "magazine", "--frames", "0"]), 2, "--frames");
    assert_refused(&capture(&["--scene", "magazine", "--samples", "-3"]), 2, "-3");
}

#[test]
fn missing_files_are_named() {
    let capture = ["capture", "no-rig.json", "--scene", "magazine", "-o", "target/none"];
    assert_refused(&run(&capture), 2, "no-rig.json");
    let blend = ["capture", "rigs/linear8.json", "--blend", "no.blend", "-o", "target/none"];
    assert_refused(&run(&blend), 2, "no.blend");
    let unwritable = ["capture", "rigs/linear8.json", "--scene", "magazine", "-o", "/proc/none/c"];
    assert_refused(&run(&unwritable), 2, "/proc/none/c");
    assert_refused(&run(&["check", "/nowhere/capture"]), 2, "/nowhere/capture/capture.json");
}

#[test]
fn refusals_of_the_filming_script_are_the_programs() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("capture");
    let film = |rig: &str, scene: &str| {
        run(&["-q", "capture", rig, "--scene", scene, "-o", text(&output)])
    };
    assert_refused(&film("rigs/linear8.json", "no-such-scene"), 2, "no-such-scene");
    let rig = folder.path().join("rig.json");
    std::fs::write(&rig, r#"{"format": "stlfr-rig", "version": 1}"#).unwrap();
    assert_refused(&film(text(&rig), "magazine"), 2, "rig.json");
    assert!(!output.join("capture.json").exists());
}

#[test]
fn a_folder_that_is_no_source_tree_is_named() {
    let output = stlfr().arg("setup").env("STLFR_HOME", "/nowhere").output().unwrap();
    assert_refused(&output, 1, "/nowhere");
}

#[test]
fn a_second_setup_does_nothing() {
    let first = run(&["setup", "--quiet"]);
    assert!(first.status.success(), "{}", stderr(&first));
    let python = String::from_utf8(first.stdout).unwrap();
    assert!(Path::new(python.trim()).exists(), "{python}");
    // What it did, it would say.
    let second = run(&["setup"]);
    assert_eq!((stderr(&second).as_str(), second.status.code()), ("", Some(0)));
}

#[test]
fn check_prints_a_table_and_writes_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("check.json");
    let capture = text(common::tiny_capture());
    let output = run(&["check", capture, "--json", text(&json)]);
    let table = String::from_utf8_lossy(&output.stdout);
    for k in 0..8 {
        assert!(table.contains(&format!("\ncam{k} ")), "{table}{}", stderr(&output));
    }
    let values = read_json(&json);
    assert!(values["model"]["capture_px"].as_f64().unwrap() < 1e-9);
    assert_eq!(values["model"]["lenses"].as_array().unwrap().len(), CameraModel::KNOWN.len());
    for format in values["model"]["blender"].as_array().unwrap() {
        assert!(format["blender_px"].as_f64().unwrap() < 3e-4, "{format}");
    }
    for camera in values["cameras"].as_array().unwrap() {
        let [rotation_deg, position_mm] =
            ["rotation_deg", "position_mm"].map(|field| camera[field].as_f64().unwrap());
        // What must be named when it is wrong: 0.2 degrees, 2 mm.
        assert!(rotation_deg < 0.1 && position_mm < 2.0, "{camera}");
    }
    // At this size the pixels place a camera to about the tolerance; the demo's size has room.
    let verdict = values["verdict"].as_str().unwrap();
    let may_pass = ["right", "unknown"].contains(&verdict);
    assert_eq!(output.status.code(), Some(i32::from(!may_pass)), "{}", stderr(&output));
}

/// A capture's whole frames, by name and time of writing.
fn frames(capture: &Path) -> Vec<(String, SystemTime)> {
    let mut found = Vec::new();
    for k in 0..8 {
        let Ok(folder) = std::fs::read_dir(capture.join(format!("cam{k}"))) else { continue };
        for entry in folder.map(Result::unwrap) {
            let name = entry.file_name().into_string().unwrap();
            if name.ends_with(".png") && !name.starts_with('.') {
                let written = entry.metadata().unwrap().modified().unwrap();
                found.push((format!("cam{k}/{name}"), written));
            }
        }
    }
    found.sort();
    found
}

/// Starts a command that films, kills it once so many frames are there, and checks that filming ends
/// with it; the frames there are then.
#[track_caller]
fn killed_at(command: &mut Command, capture: &Path, count: usize) -> Vec<(String, SystemTime)> {
    drop(run(&["setup", "--quiet"])); // so that the time below is the filming's
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    while frames(capture).len() < count && start.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    std::thread::sleep(Duration::from_secs(1)); // Blender ends with its parent
    let before = frames(capture);
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(before, frames(capture), "filming went on without its parent");
    assert!(before.len() >= count && !capture.join("capture.json").exists(), "{before:?}");
    before
}

#[test]
fn a_killed_capture_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let capture = folder.path().join("capture");
    let mut command = stlfr();
    command
        .args(["-q", "capture", "rigs/linear8.json", "--scene", "magazine", "--size", "64x48"])
        .args(["--frames", "3", "--samples", "1", "--no-truth", "-o"])
        .arg(&capture);
    let before = killed_at(&mut command, &capture, 3);

    assert!(command.status().unwrap().success());
    let after = frames(&capture);
    assert_eq!(after.len(), 24);
    assert!(before.iter().all(|frame| after.contains(frame)), "a whole frame was filmed again");
    Capture::open(&capture).unwrap();
}

/// At this size the pixels can't confirm the calibration, so that the demo may end after filming.
#[test]
fn a_killed_demo_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let capture = folder.path().join("capture");
    let mut command = stlfr();
    command.args(["-q", "demo", "--size", "64x48", "--frames", "6", "--samples", "1", "-o"]);
    command.arg(&capture);
    let before = killed_at(&mut command, &capture, 5);
    assert!(before.len() < 48, "{before:?}");

    let goes_on = |command: &mut Command| {
        let output = command.output().unwrap();
        let (code, message) = (output.status.code(), stderr(&output));
        assert!(
            code == Some(0) || (code == Some(1) && message.contains("the calibration is off")),
            "{message}"
        );
    };
    goes_on(&mut command);
    let after = frames(&capture);
    assert_eq!(after.len(), 48);
    assert!(before.iter().all(|frame| after.contains(frame)), "a whole frame was filmed again");
    let truth = Truth::open(&capture).unwrap().expect("the demo films truth");
    assert_eq!(truth.views.len(), 30);
    Capture::open(&capture).unwrap();

    goes_on(&mut command);
    assert_eq!(frames(&capture), after, "a second run filmed again");
}

#[test]
fn a_list_is_no_object() {
    let folder = Scene { shared: [true; 3], frames: 3, ..Scene::default() }.film();
    let root = folder.path();
    let list = root.join("list.json");
    for (content, words) in [
        (r#"[]"#, "list.json: must be an object"),
        (r#"{"registration": []}"#, "registration: invalid type: sequence, expected an object"),
        (r#"{"preset": "draft", "blend": [1]}"#, "blend: invalid type: sequence"),
    ] {
        std::fs::write(&list, content).unwrap();
        let output = run(&["plan", text(root), "--options", text(&list)]);
        assert_refused(&output, 2, words);
    }
    let view = ["-q", "render", text(root), "--camera", text(&list), "--time", "0", "-o", "o.png"];
    std::fs::write(&list, r#"[96, 72, "PINHOLE", [9, 9, 9, 9], [[1, 0, 0, 0], [0, 0, 0]]]"#)
        .unwrap();
    assert_refused(&run(&view), 2, "list.json: invalid type: sequence, expected an object");
    let capture = read_json(&root.join("capture.json"));
    let fields = ["format", "version", "name", "reference", "cameras"].map(|f| capture[f].clone());
    describe(root, &json!(fields));
    let output = run(&["offsets", text(root)]);
    assert_refused(&output, 2, "capture.json: invalid type: sequence, expected an object");
    let file = root.join("capture.json");
    let output = run(&["offsets", text(&file)]);
    assert_refused(&output, 2, "capture.json: is a file, and a capture is a folder");
    std::fs::remove_file(&file).unwrap();
    assert_refused(&run(&["offsets", text(root)]), 2, "capture.json: No such file");
    std::fs::create_dir(root.join(".film")).unwrap();
    assert_refused(&run(&["offsets", text(root)]), 2, "is not filmed to its end");
}
