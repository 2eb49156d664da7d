//! `stlfr info`: what a capture holds, and deleting what is cached.

mod common;

use common::wall::{FRAME_S, Scene};
use common::{assert_refused, edit, run, stderr, succeed, text, tiny_copy};
use serde_json::{Value, json};
use std::path::Path;
use stlfr::raster::BitDepth;
use stlfr::video::{Codec, VideoFormat, VideoWriter};

fn info(folder: &Path) -> Value {
    serde_json::from_slice(&succeed(&["-q", "info", text(folder), "--json"]).stdout).unwrap()
}

fn page(folder: &Path) -> String {
    String::from_utf8(succeed(&["-q", "info", text(folder)]).stdout).unwrap()
}

#[test]
fn offsets_are_unknown_then_estimated_then_outdated_then_edited() {
    let folder = Scene { frames: 6, ..Scene::default() }.film();
    let root = folder.path();
    let before = info(root);
    assert_eq!((&before["reference"], &before["offsets"]), (&json!("cam1"), &json!("missing")));
    let camera = &before["cameras"][0];
    assert_eq!((&camera["clock"], &camera["frames"]), (&json!("unknown"), &json!(6)));
    assert_eq!(camera["rate_hz"].as_f64().map(|hz| (hz * FRAME_S * 1e6).round()), Some(1e6));
    assert!(camera["offset_s"].is_null());
    assert!(page(root).contains("without 2 of unknown clock"), "{}", page(root));

    let offsets = succeed(&["-q", "offsets", text(root), "--json"]).stdout;
    let offsets: Value = serde_json::from_slice(&offsets).unwrap();
    let after = info(root);
    assert_eq!((&after["offsets"], &after["truth"]), (&json!("estimated"), &json!({})));
    for camera in [0, 2] {
        assert_eq!(after["cameras"][camera]["clock"], "estimated");
        for field in ["offset_s", "std_err_s"] {
            assert_eq!(after["cameras"][camera][field], offsets["cameras"][camera][field]);
        }
    }
    let [all, any] = ["times_of_all_s", "times_of_any_s"].map(|span| after[span].clone());
    assert!(all[0].as_f64() > any[0].as_f64() && all[1].as_f64() < any[1].as_f64());
    assert!(page(root).contains("estimated: ") && page(root).contains(" ± "), "{}", page(root));

    edit(root, |capture| capture["name"] = json!("another"));
    assert_eq!(info(root)["offsets"], "outdated");
    edit(root, |capture| capture["name"] = before["name"].clone());
    let file = root.join("offsets.json");
    let mut edited = common::read_json(&file);
    edited["cameras"][0]["offset_s"] = json!(0.011);
    std::fs::write(&file, edited.to_string()).unwrap();
    let after = info(root);
    assert_eq!(
        (&after["offsets"], &after["cameras"][0]["clock"]),
        (&json!("edited"), &json!("edited"))
    );
    assert_eq!(after["cameras"][0]["offset_s"], 0.011);
}

#[test]
fn true_images_are_listed_with_their_times() {
    let folder = tiny_copy();
    let found = info(folder.path());
    let truth = common::read_json(&folder.path().join("truth/truth.json"));
    for view in truth["views"].as_array().unwrap() {
        let times = found["truth"][view["id"].as_str().unwrap()].as_array().unwrap();
        assert!(times.contains(&view["time_s"]), "{times:?}");
    }
    let page = page(folder.path());
    assert!(page.contains("\nTruth "), "{page}");
    // Views of one instant are in one row.
    let times: Vec<&Value> =
        truth["views"].as_array().unwrap().iter().map(|v| &v["time_s"]).collect();
    let instants = times.iter().enumerate().filter(|(k, time)| !times[..*k].contains(time)).count();
    let rows = page.lines().filter(|line| line.contains(" at ") && line.ends_with(" s")).count();
    assert!(times.len() > instants && (1..=instants).contains(&rows), "{page}");
}

#[test]
fn a_video_is_not_decoded_and_what_is_cached_is_deleted_by_kind() {
    let scene = Scene::default();
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let format = VideoFormat { depth: BitDepth::Eight, rate_hz: 25.0, codec: Codec::Ffv1 };
    let image = |k: usize| scene.image(scene.centers_m[1], k as f64 * FRAME_S);
    let path = root.join("video.mkv");
    let mut video = VideoWriter::create(&common::ffmpeg(), &path, &image(0), format).unwrap();
    (0..4).for_each(|k| video.push(&image(k)).unwrap());
    video.finish().unwrap();
    let mut camera: Value = scene.camera([0.0; 3]);
    camera["id"] = json!("a");
    camera["frames"] = json!("video.mkv");
    camera["clock"] = json!({"rate_hz": 25.0, "first_s": 0.0, "shared": true});
    let capture =
        json!({"format": "stlfr-capture", "version": 1, "name": "one", "cameras": [camera]});
    common::describe(root, &capture);

    let before = info(root);
    assert_eq!(
        (&before["cameras"][0]["frames"], &before["offsets"]),
        (&Value::Null, &json!("unchecked"))
    );
    assert!(before["cache"].as_array().unwrap().iter().all(|found| found["kind"] != "video"));
    let view = ["-q", "render", text(root), "--like", "a", "--time", "0.04", "-o"];
    succeed(&[&view[..], &[text(&root.join("a.png"))]].concat());
    let after = info(root);
    assert_eq!(after["cameras"][0]["frames"], 4);
    let cached = after["cache"].as_array().unwrap();
    let video = cached.iter().find(|found| found["kind"] == "video").unwrap();
    assert!(video["entries"] == 1 && video["bytes"].as_u64().unwrap() > 1000, "{video}");
    assert!(page(root).contains("--delete-cache [KIND]"), "{}", page(root));

    let refused = run(&["info", text(root), "--delete-cache", "../.."]);
    assert_refused(&refused, 2, "no '../..' is cached");
    std::fs::write(root.join("capture.json"), "{").unwrap();
    assert_refused(&run(&["info", text(root)]), 2, "capture.json");
    let deleted = succeed(&["info", text(root), "--delete-cache", "video"]);
    assert!(String::from_utf8_lossy(&deleted.stdout).starts_with("Deleted 1 entry, "));
    assert!(!root.join(".stlfr/cache/video").exists() && path.exists());
    succeed(&["info", text(root), "--delete-cache"]);
    let again = succeed(&["info", text(root), "--delete-cache"]);
    assert_eq!(again.stdout, b"Nothing was cached.\n", "{}", stderr(&again));
    assert!(!root.join(".stlfr/cache").exists());
    assert_refused(&run(&["info", "/nowhere", "--delete-cache"]), 2, "/nowhere/capture.json");
}

#[test]
fn a_kind_that_is_not_cached_is_refused_with_those_that_are() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::write(root.join("capture.json"), "{}").unwrap();
    let delete = |kind: &str| run(&["info", text(root), "--delete-cache", kind]);
    for kind in ["", "..", "../cache", "offsets", "video"] {
        let sentence = format!("--delete-cache: no '{kind}' is cached, nor is anything else");
        assert_refused(&delete(kind), 2, &sentence);
    }
    // A kind of another version of the program is deleted by its name.
    let old = root.join(".stlfr/cache/flows");
    std::fs::create_dir_all(&old).unwrap();
    std::fs::write(old.join("0".repeat(32)), "old").unwrap();
    assert_refused(&delete("video"), 2, "no 'video' is cached, but flows");
    let deleted = String::from_utf8(delete("flows").stdout).unwrap();
    assert!(deleted.starts_with("Deleted 1 entry") && !old.exists(), "{deleted}");
}
