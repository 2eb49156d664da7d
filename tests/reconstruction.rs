//! Offsets, views and metrics of the tiny capture that Blender filmed: how accurate they are, that
//! they depend on the cameras' images alone, and that they are the same from run to run.

mod common;

use common::{read_json, run, stderr, stlfr, text, tiny_capture, tiny_copy};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// Runs a command, which must succeed; what it prints.
#[track_caller]
fn printed(command: &mut Command) -> Vec<u8> {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", stderr(&output));
    output.stdout
}

/// A file's name and its bytes.
type Results = Vec<(String, Vec<u8>)>;

/// All results of a capture's images, from a copy that holds no offsets yet: offsets, a free view, a
/// camera's view, and images over time.
fn results(capture: &Path, threads: &str) -> Results {
    assert!(!capture.join("offsets.json").exists(), "offsets are to be estimated afresh");
    let out = tempfile::tempdir().unwrap();
    let view = out.path().join("view.json");
    let mut camera = read_json(&capture.join("capture.json"))["cameras"][3].clone();
    for field in ["id", "frames", "color", "clock"] {
        camera.as_object_mut().unwrap().remove(field);
    }
    let x_m = camera["cam_from_world"]["translation"][0].as_f64().unwrap();
    camera["cam_from_world"]["translation"][0] = json!(x_m - 0.025);
    std::fs::write(&view, camera.to_string()).unwrap();

    let command = |name: &str| {
        let mut command = stlfr();
        command.env("RAYON_NUM_THREADS", threads).args(["-q", name]).arg(capture);
        command
    };
    let offsets = printed(command("offsets").arg("--json"));
    let mut results = vec![("offsets --json".to_owned(), offsets)];
    let mut render = |name: &str, arguments: &[&str]| {
        let file = out.path().join(name);
        printed(command("render").args(arguments).arg("-o").arg(&file));
        if !name.contains('%') {
            results.push((name.to_owned(), std::fs::read(&file).unwrap()));
        }
    };
    let view = view.to_str().unwrap();
    render("mesh.png", &["--camera", view, "--time", "0.0831"]);
    render("plane.png", &["--camera", view, "--time", "0.07", "--proxy", "plane"]);
    let depth = r#"{"proxy": {"method": "depth"}, "blend": {"method": "space-time"}}"#;
    let options = out.path().join("depth.json");
    std::fs::write(&options, depth).unwrap();
    let options = options.to_str().unwrap();
    render("depth.png", &["--camera", view, "--time", "0.0831", "--options", options]);
    render("like.png", &["--like", "cam5", "--time", "0.0831"]);
    render("%02d.png", &["--like", "cam2", "--times", "0.05:0.1:3"]);
    for k in 0..3 {
        let name = format!("0{k}.png");
        let bytes = std::fs::read(out.path().join(&name)).unwrap();
        results.push((name, bytes));
    }
    results
}

fn with_truth_on_one_thread() -> &'static Results {
    static RESULTS: OnceLock<Results> = OnceLock::new();
    RESULTS.get_or_init(|| {
        let copy = tiny_copy();
        assert!(copy.path().join("truth/truth.json").is_file());
        results(copy.path(), "1")
    })
}

#[track_caller]
fn assert_same(results: &Results) {
    let expected = with_truth_on_one_thread();
    assert_eq!(results.len(), expected.len());
    for ((name, bytes), (_, expected)) in results.iter().zip(expected) {
        assert!(bytes == expected, "{name} differs");
    }
    let different: std::collections::HashSet<_> = results.iter().map(|(_, bytes)| bytes).collect();
    assert_eq!(different.len(), results.len(), "no two of these are the same");
}

#[test]
fn without_the_truth_no_byte_changes() {
    let copy = tiny_copy();
    std::fs::remove_dir_all(copy.path().join("truth")).unwrap();
    assert_same(&results(copy.path(), "1"));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let copy = tiny_copy();
    assert_same(&results(copy.path(), "3"));
}

/// The report's numbers, against what can be had from images of 160×120 pixels.
#[test]
fn offsets_images_and_views_are_near_the_truth() {
    let copy = tiny_copy();
    let metrics = |threads: &str, out: &str| {
        let mut command = stlfr();
        command.env("RAYON_NUM_THREADS", threads).args(["-q", "compare"]).arg(copy.path());
        printed(command.arg("-o").arg(copy.path().join(out)));
        assert!(copy.path().join(out).join("report.html").is_file());
        copy.path().join(out).join("metrics.json")
    };
    let file = metrics("2", "review");
    let found = read_json(&file);

    let offsets = found["offsets"].as_array().unwrap();
    assert_eq!(offsets.len(), 8);
    for offset in offsets {
        let error_frames = offset["error_frames"].as_f64().expect("every camera has an offset");
        assert!(error_frames.abs() <= 0.03, "{offset}");
        // What is far from 0 has the truth's sign.
        let [found_s, truth_s] = ["offset_s", "truth_s"].map(|f| offset[f].as_f64().unwrap());
        assert!(found_s * truth_s >= 0.0 && (truth_s != 0.0) == (offset["camera"] != "cam3"));
    }

    let headline = &found["headline"];
    assert_eq!(headline["missing_images"], 0);
    assert_eq!(headline["sync"]["images"], 8);
    let gain_db = headline["sync"]["median_gain_db"].as_f64().unwrap();
    assert!(gain_db >= 3.0, "synchronized images: {gain_db} dB over the nearest frame");
    let views = headline["views"].as_array().unwrap();
    let proxies: Vec<_> = views.iter().map(|view| view["proxy"].as_str().unwrap()).collect();
    // Scene flow is compared if the plan chooses it.
    assert_eq!(proxies[..3], ["plane", "mesh", "depth"]);
    assert!(matches!(proxies[3..], [] | ["scene-flow"]), "{proxies:?}");
    for view in views {
        assert_eq!(view["views"], 2);
        let gain_db = view["gain_moving_db"].as_f64().unwrap();
        assert!(gain_db >= 1.0, "over traditional LFR with the same proxy: {view}");
        assert!(view["gap_moving_db"].is_f64(), "perfect sync is measured");
    }

    std::fs::remove_file(copy.path().join("offsets.json")).unwrap();
    let again = metrics("1", "again");
    assert!(std::fs::read(file).unwrap() == std::fs::read(again).unwrap(), "metrics.json differs");
}

#[test]
fn without_truth_there_is_nothing_to_compare_with() {
    let copy = tiny_copy();
    std::fs::remove_dir_all(copy.path().join("truth")).unwrap();
    let output = run(&["-q", "compare", text(copy.path())]);
    common::assert_refused(&output, 2, "truth");
    assert!(!tiny_capture().join("offsets.json").exists(), "the shared capture stays as it was");
}
