//! `stlfr tradeoff`: which points it measures against what, and that it measures nothing twice.

mod common;

use common::wall::{Scene, open};
use common::{assert_refused, edit, run, stlfr, succeed, text, tiny_copy};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::tradeoff::{Against, Point, Tradeoff, TradeoffOptions, tradeoff};
use tempfile::TempDir;

/// Qualities are compared after rounding to this step.
const ROUNDING_DB: f64 = 0.01;

/// What the measurements in a capture's cache hold, by kind and name, without their checksums.
fn measured(capture: &Path) -> BTreeMap<String, Value> {
    let folders = std::fs::read_dir(capture.join(".stlfr/cache")).into_iter().flatten().flatten();
    let folders = folders.filter(|f| f.file_name().to_string_lossy().starts_with("tradeoff-"));
    let mut found = BTreeMap::new();
    for folder in folders {
        let kind = folder.file_name().into_string().unwrap();
        let entries = std::fs::read_dir(folder.path()).unwrap().flatten();
        for entry in entries.filter(|e| !e.file_name().to_string_lossy().starts_with('.')) {
            let file = std::fs::read(entry.path()).unwrap(); // written whole
            let value = serde_json::from_slice(&file[32..]).unwrap();
            found.insert(format!("{kind}/{}", entry.file_name().display()), value);
        }
    }
    found
}

/// Whether `later` only adds to `earlier`.
fn extends(earlier: &Value, later: &Value) -> bool {
    match (earlier, later) {
        (Value::Object(a), Value::Object(b)) => {
            a.iter().all(|(k, v)| b.get(k).is_some_and(|w| extends(v, w)))
        }
        (Value::Array(a), Value::Array(b)) => {
            a.len() <= b.len() && a.iter().zip(b).all(|(v, w)| extends(v, w))
        }
        (a, b) => a == b,
    }
}

/// Asserts that the best combination is on the Pareto front, and that no combination is faster and better by more than
/// rounding than one that is on it.
fn assert_pareto_front(found: &Tradeoff) {
    let trade = |p: &Point| Some((p.wall_s?.median, p.quality_db?));
    let all: Vec<(f64, f64)> = found.points.iter().filter_map(trade).collect();
    let front: Vec<(f64, f64)> = found.pareto_front().filter_map(trade).collect();
    let best_db = |of: &[(f64, f64)]| of.iter().map(|(_, db)| *db).fold(f64::NAN, f64::max);
    assert!(best_db(&front) >= best_db(&all) - ROUNDING_DB, "{front:?} of {all:?}");
    for (seconds, db) in front {
        let dominates = |&&(s, q): &&(f64, f64)| s < seconds && q > db + ROUNDING_DB;
        assert_eq!(all.iter().find(dominates), None, "{seconds} s, {db} dB is on the front");
    }
}

/// A capture without truth, in which a board moves before a wall.
fn capture_without_truth() -> TempDir {
    Scene { board: Some([-0.8, -0.5]), ..Scene::default() }.film()
}

#[test]
fn the_tiny_capture_against_its_truth_goes_on_after_a_kill() {
    let (folder, capture) = (tempfile::tempdir().unwrap(), tiny_copy());
    let capture = capture.path();
    std::fs::remove_dir_all(capture.join(".stlfr")).ok();
    let out = folder.path().join("out");
    let arguments = ["-q", "tradeoff", text(capture), "--rounds", "0", "--runs", "2"];
    let mut command = stlfr();
    command.args(arguments).arg("-o").arg(&out).stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    let started = Instant::now();
    while measured(capture).keys().filter(|k| k.starts_with("tradeoff-points/")).count() < 5 {
        assert!(started.elapsed() < Duration::from_secs(120), "nothing is measured");
        std::thread::sleep(Duration::from_millis(10));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let before = measured(capture);
    assert!(!out.join("tradeoff.json").exists(), "killed in the middle");

    let again = || succeed(&[&arguments[..], &["-o", text(&out), "--json"]].concat()).stdout;
    let printed = again();
    let after = measured(capture);
    for (name, value) in &before {
        assert!(extends(value, &after[name]), "{name} was measured again");
    }
    // All is there: times, too, stay what they are.
    assert_eq!(again(), printed);
    assert_eq!(measured(capture), after);

    let found: Tradeoff = serde_json::from_slice(&printed).unwrap();
    assert_eq!(found.against, Against::Truth);
    assert_eq!(found.views, 2);
    assert_pareto_front(&found);
    for label in ["draft", "balanced", "best", "auto"] {
        let point = found.labelled(label).expect(label);
        assert!(point.quality_db.unwrap() > 10.0 && point.moving.flip.unwrap() < 1.0);
        assert_eq!(point.wall_s.unwrap().runs, 2);
        assert!(point.preparation.unwrap().offsets_s.unwrap() > 0.0);
    }
    let file: Tradeoff =
        serde_json::from_slice(&std::fs::read(out.join("tradeoff.json")).unwrap()).unwrap();
    assert_eq!(file, found);
    assert!(std::fs::read_to_string(out.join("tradeoff.svg")).unwrap().contains("balanced"));
    let recommended = std::fs::read(out.join("recommended.json")).unwrap();
    let recommended: RenderOptions = serde_json::from_slice(&recommended).unwrap();
    assert_eq!(recommended, found.points[found.recommended].options);
}

#[test]
fn without_truth_cameras_are_held_out_and_quality_repeats() {
    let folder = capture_without_truth();
    let options = TradeoffOptions { runs: 1, rounds: 0, ..TradeoffOptions::default() };
    let measure = || {
        let out = tempfile::tempdir().unwrap();
        std::fs::remove_dir_all(folder.path().join(".stlfr")).ok();
        let found = tradeoff(&open(&folder), &options, out.path(), &Reporter::silent()).unwrap();
        let mut quality: Vec<_> = found
            .points
            .iter()
            .map(|p| (p.name.clone(), p.quality_db, p.whole, p.most_accurate_db))
            .collect();
        quality.sort_by(|a, b| a.0.cmp(&b.0));
        (found, quality)
    };
    let (found, quality) = measure();
    assert_eq!(found.against, Against::HeldOut);
    assert!(found.views >= 1);
    assert!(quality.iter().any(|q| q.3.is_some_and(|db| db < 60.0)), "methods differ");
    assert!(
        quality.iter().any(|q| q.3 == Some(99.0)),
        "the most accurate methods are the reference"
    );
    assert_eq!(measure().1, quality);
    assert!(!folder.path().join("offsets.json").exists(), "offsets are measured, not saved");
}

#[test]
fn one_camera_is_compared_with_its_most_accurate_view() {
    let folder = capture_without_truth();
    edit(folder.path(), |json| {
        json["cameras"].as_array_mut().unwrap().truncate(1);
        json["reference"] = "cam0".into();
    });
    let out = tempfile::tempdir().unwrap();
    let mut base = RenderOptions::default();
    base.proxy.plane_depth_m = Some(2.0);
    let options = TradeoffOptions { runs: 1, rounds: 0, base, ..TradeoffOptions::default() };
    let found = tradeoff(&open(&folder), &options, out.path(), &Reporter::silent());
    match found {
        Ok(found) => assert_eq!(found.against, Against::MostAccurate),
        // A mesh needs two cameras.
        Err(error) => assert!(error.to_string().contains("no point"), "{error}"),
    }
}

#[test]
fn wrong_arguments_are_refused() {
    let folder = capture_without_truth();
    let capture = text(folder.path());
    let foreign = tempfile::tempdir().unwrap();
    std::fs::write(foreign.path().join("thesis.tex"), "").unwrap();
    for (arguments, words) in [
        (vec![capture, "-o", capture], "is a capture"),
        (vec![capture, "-o", text(foreign.path())], "thesis.tex"),
        (vec!["/nowhere", "-o", "out"], "/nowhere"),
        (vec![capture, "-o", "/proc/none/out"], "/proc/none/out"),
        (vec![capture, "-o", "out", "--runs", "0"], "1 to 1000"),
        (vec![capture, "-o", "out", "--options", "/nowhere.json"], "/nowhere.json"),
        (vec![capture], "--output"),
    ] {
        let output = run(&[&["-q", "tradeoff"], arguments.as_slice()].concat());
        assert_refused(&output, 2, words);
    }
    assert!(foreign.path().join("thesis.tex").exists());
    assert_eq!(std::fs::read_dir(foreign.path()).unwrap().count(), 1);
}
