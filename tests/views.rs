//! The view of `stlfr render`, by file, by name and shifted; and the example that `stlfr info` prints.

mod common;

use common::wall::{FRAME_S, H, Scene, W};
use common::{assert_refused, read_json, run, stderr, stlfr, succeed, text};
use serde_json::json;
use std::path::Path;
use stlfr::raster::{Image, read_image};

/// A recording whose truth shows a view between its cameras.
fn recorded() -> (Scene, tempfile::TempDir) {
    let scene = Scene { shared: [true; 3], offsets_s: [0.0; 3], ..Scene::default() };
    let folder = scene.film();
    let view = |id: &str, like: Option<&str>, x_m: f64| {
        json!({"id": id, "time_s": 0.1, "like": like, "camera": scene.camera([x_m, 0.0, 0.0]),
            "image": "a.png", "depth": "a.npy", "motion": "a.npy"})
    };
    let views = [view("t0-between", None, 0.03), view("t0-cam0", Some("cam0"), -0.06)];
    let truth = json!({"format": "stlfr-truth", "version": 1, "scene": "wall", "rig": "three",
        "offsets": [], "shutter": [], "views": views});
    std::fs::create_dir(folder.path().join("truth")).unwrap();
    std::fs::write(folder.path().join("truth/truth.json"), truth.to_string()).unwrap();
    (scene, folder)
}

/// Renders a view; the image, and the notes.
#[track_caller]
fn rendered(folder: &Path, view: &[&str]) -> (Image, String) {
    let path = folder.join("view.png");
    let words = ["render", text(folder), "--time", "0.1", "-o", text(&path)];
    let output = succeed(&[&words, view].concat());
    let image = read_image(&path).unwrap().0;
    std::fs::remove_file(&path).unwrap();
    (image, stderr(&output))
}

#[test]
fn a_view_is_named_like_its_truth_copied_from_a_capture_or_shifted() {
    let (scene, root) = recorded();
    let folder = root.path();
    let (between, notes) = rendered(folder, &["--like", "between"]);
    assert!(!notes.contains("The view is"), "{notes}");
    let expected = scene.image([0.03, 0.0, 0.0], 2.5 * FRAME_S);
    let errors = between.data().iter().zip(expected.data()).map(|(a, b)| (a - b).abs());
    let mean = errors.sum::<f32>() / (W * H) as f32;
    assert!(mean < 0.02, "{mean}");

    let file = folder.join("view.json");
    let mut camera = read_json(&folder.join("capture.json"))["cameras"][2].clone();
    std::fs::write(&file, camera.to_string()).unwrap();
    for view in [
        &["--like", "t0-between"][..],
        &["--like", "cam1", "--shift", "0.03,0,0"],
        &["--camera", text(&file), "--shift", "-0.03,0,0"],
    ] {
        let (image, _) = rendered(folder, view);
        assert_eq!(image.data(), between.data(), "{view:?}");
    }
    assert_eq!(
        rendered(folder, &["--like", "t0-cam0"]).0.data(),
        rendered(folder, &["--like", "cam0"]).0.data()
    );
    camera["fov"] = json!(1);
    std::fs::write(&file, camera.to_string()).unwrap();
    let refused =
        run(&["render", text(folder), "--camera", text(&file), "--time", "0.1", "-o", "a.png"]);
    assert_refused(&refused, 2, "view.json: fov: ");
}

#[test]
fn an_unknown_name_is_refused_with_the_names_that_there_are() {
    let (_, root) = recorded();
    let refused =
        run(&["render", text(root.path()), "--like", "betwen", "--time", "0.1", "-o", "a.png"]);
    assert_refused(&refused, 2, "--like: ");
    assert!(stderr(&refused).contains("'betwen'; there are cam0, cam1, cam2, between\n"));
}

#[test]
fn a_view_far_from_the_rig_is_warned_of() {
    let (_, root) = recorded();
    let notes = |shift: &str| rendered(root.path(), &["--like", "cam1", "--shift", shift]).1;
    assert!(!notes("0,0,-0.11").contains("view"));
    assert!(notes("0,0,-0.5").contains("The view is 0.500 m from the nearest camera"));
    assert!(notes("1.6,0,0").contains("Cameras see only"), "{}", notes("1.6,0,0"));
}

#[test]
fn the_example_of_info_works() {
    let (_, root) = recorded();
    let info = succeed(&["-q", "info", text(root.path()), "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    let example = info["example"].as_str().unwrap();
    assert!(example.contains(" --like cam1 --shift -0.03,0,0 --time 0.06 "), "{example}");
    let words: Vec<&str> = example.split(' ').skip(1).collect();
    let output = stlfr().args(words).current_dir(root.path()).output().unwrap();
    assert!(output.status.success() && !stderr(&output).contains("view"), "{}", stderr(&output));
    assert!(root.path().join("view.png").is_file());
    let page = String::from_utf8(succeed(&["info", text(root.path())]).stdout).unwrap();
    assert!(page.contains(&format!("\nExample  {example}\n")), "{page}");
}
