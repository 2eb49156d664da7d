//! What the program reads back of its own: damaged at random, it gives the same result as without it, or
//! one sentence; never another result, never a panic. By hand,
//! `STLFR_FLIPS=1000 cargo test --release --test caches -- --nocapture --test-threads 1` damages each
//! cache so often and prints a table.

mod common;

use common::random::below;
use common::wall::{FRAME_S, Scene};
use common::{assert_refused, edit, read_json, run, stderr, stlfr, succeed, text};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::capture::{Capture, Opening};
use stlfr::offset::{OffsetOptions, Offsets, SavedOffsets, offsets_from_images, resolve_offsets};
use stlfr::progress::Reporter;
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, read_image};
use stlfr::registration::{FrameStore, RegistrationOptions};
use stlfr::tradeoff::{Tradeoff, TradeoffOptions, tradeoff};
use stlfr::video::{Codec, VideoFormat, VideoWriter};
use tempfile::TempDir;

/// Damages of each cache by default: seconds in all.
const FLIPS: usize = 12;

fn flips() -> usize {
    std::env::var("STLFR_FLIPS").ok().and_then(|n| n.parse().ok()).unwrap_or(FLIPS)
}

/// A file that is cut, or with another digit somewhere, or with some other bytes.
fn damaged(whole: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    let kind = random.unit();
    if kind < 0.3 {
        bytes.truncate(below(random, whole.len()));
        return bytes;
    }
    let digits: Vec<usize> = (0..whole.len()).filter(|k| whole[*k].is_ascii_digit()).collect();
    if kind < 0.6 && !digits.is_empty() {
        let digit = &mut bytes[digits[below(random, digits.len())]];
        *digit = b'0' + (*digit - b'0' + 1 + below(random, 9) as u8) % 10;
        return bytes;
    }
    for _ in 0..1 + below(random, 3) {
        bytes[below(random, whole.len())] ^= 1 + below(random, 255) as u8;
    }
    bytes
}

/// What came of a damaged cache.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    Same,
    /// Ended in one sentence.
    Sentence,
    /// Used as given, which is said: only of offsets.json.
    Given,
}

/// The outcomes of one cache's damages; it panics for any that may not be.
fn outcomes(
    cache: &str,
    file: impl Fn(&mut Random) -> PathBuf,
    outcome: impl Fn() -> Result<Outcome, String>,
) {
    let mut random = Random::new(5);
    let mut counts = BTreeMap::new();
    for n in 0..flips() {
        let path = file(&mut random);
        let whole = std::fs::read(&path).unwrap();
        let bytes = damaged(&whole, &mut random);
        std::fs::write(&path, &bytes).unwrap();
        let found = catch_unwind(AssertUnwindSafe(&outcome))
            .unwrap_or_else(|_| Err("a panic".into()))
            .unwrap_or_else(|why| {
                let kept = common::root().join("target").join(format!("damaged-{cache}"));
                std::fs::write(&kept, &bytes).unwrap();
                panic!("{cache}, damage {n} of {}: {why}; kept as {kept:?}", path.display())
            });
        *counts.entry(found).or_insert(0) += 1;
        // What was not made anew is restored.
        std::fs::write(&path, &whole).unwrap();
    }
    let count = |outcome| counts.get(&outcome).copied().unwrap_or(0);
    println!(
        "| {cache} | {} | {} | {} | {} | 0 | 0 |",
        flips(),
        count(Outcome::Same),
        count(Outcome::Given),
        count(Outcome::Sentence),
    );
}

/// One line, as every error is.
fn one_sentence(error: impl std::fmt::Display) -> Result<Outcome, String> {
    let sentence = error.to_string();
    let is_one = !sentence.trim().is_empty() && sentence.lines().count() == 1;
    if is_one { Ok(Outcome::Sentence) } else { Err(format!("says {sentence:?}")) }
}

fn same(is_same: bool) -> Result<Outcome, String> {
    if is_same { Ok(Outcome::Same) } else { Err("another result".into()) }
}

/// The wall with a clock that drifts and one that loses frames, so that every field is there.
fn filmed() -> TempDir {
    let folder = Scene { frames: 6, ..Scene::default() }.film();
    edit(folder.path(), |capture| {
        capture["cameras"][0]["clock"]["drift"] = json!(true);
        capture["cameras"][2]["clock"]["lost"] = json!(true);
    });
    folder
}

fn frames_of(folder: &Path) -> FrameStore {
    let capture = Arc::new(Capture::open(folder).unwrap());
    FrameStore::new(capture, &RegistrationOptions::default())
}

#[test]
fn damaged_offsets_are_no_estimate() {
    let folder = filmed();
    let (options, silent) = (OffsetOptions::default(), Reporter::silent());
    let frames = frames_of(folder.path());
    let estimated = offsets_from_images(&frames, &options, &silent).unwrap();
    let path = folder.path().join("offsets.json");
    let own = Offsets::saved(frames.capture()).unwrap();
    assert!(matches!(own, SavedOffsets::Estimated { .. }));

    outcomes(
        "offsets.json, `offsets`",
        |_| path.clone(),
        || match offsets_from_images(&frames, &options, &silent) {
            Ok(found) => same(found == estimated),
            Err(error) => one_sentence(error),
        },
    );
    outcomes(
        "offsets.json, `render`",
        |_| path.clone(),
        || {
            let saved = Offsets::saved(frames.capture());
            match resolve_offsets(&frames, &options, &silent) {
                Err(error) => one_sentence(error),
                Ok(found) if found == estimated => Ok(Outcome::Same),
                // A digit that changed may be an edit; it is said.
                Ok(found) if saved.ok() == Some(SavedOffsets::Edited(found.clone())) => {
                    Ok(Outcome::Given)
                }
                Ok(_) => Err("another result".into()),
            }
        },
    );
}

#[test]
fn offsets_that_were_edited_are_used_as_given_and_estimated_all_the_same() {
    let folder = filmed();
    let root = folder.path();
    let out = root.join("out.png");
    let render = ["render", text(root), "--like", "cam0", "--time", "0.1", "-o", text(&out)];
    let estimated = succeed(&["offsets", text(root)]).stdout;
    assert!(stderr(&succeed(&render)).contains("those of offsets.json"));
    let before = std::fs::read(&out).unwrap();

    let file = root.join("offsets.json");
    let mut edited = read_json(&file);
    edited["cameras"][0]["offset_s"] = json!(0.011);
    edited["cameras"].as_array_mut().unwrap().reverse();
    std::fs::write(&file, edited.to_string()).unwrap();
    let note = stderr(&succeed(&render));
    assert!(note.contains("edited by hand: its offsets are used as given"), "{note}");
    assert_ne!(std::fs::read(&out).unwrap(), before, "they are used");
    // Whatever the options, an edit is not written over.
    let options = root.join("options.json");
    std::fs::write(&options, r#"{"offset": {"method": "joint"}}"#).unwrap();
    let note = stderr(&succeed(&[&render[..], &["--options", text(&options)]].concat()));
    assert!(note.contains("used as given"), "{note}");

    let again = succeed(&["offsets", text(root)]);
    assert!(stderr(&again).contains("edited by hand"), "{}", stderr(&again));
    assert_eq!(again.stdout, estimated, "what the images say");
    assert_eq!(read_json(&file), edited, "left as it is");

    // Laid out otherwise, it is no edit.
    std::fs::remove_file(&file).unwrap();
    succeed(&["offsets", text(root)]);
    std::fs::write(&file, read_json(&file).to_string()).unwrap();
    assert!(stderr(&succeed(&render)).contains("those of offsets.json"));
    assert_eq!(std::fs::read(&out).unwrap(), before);
    // Of an earlier version, without a checksum: estimated anew.
    let mut earlier = read_json(&file);
    earlier.as_object_mut().unwrap().remove("checksum");
    earlier["cameras"][0]["offset_s"] = json!(0.011);
    std::fs::write(&file, earlier.to_string()).unwrap();
    assert!(stderr(&succeed(&render)).contains("were estimated"));
    // As `offsets --json` prints them, by anybody.
    let printed = succeed(&["-q", "offsets", text(root), "--json"]).stdout;
    std::fs::write(&file, printed).unwrap();
    assert!(stderr(&succeed(&render)).contains("used as given"));
}

type Edit = fn(&mut Value);

#[test]
fn edited_offsets_are_validated_field_by_field() {
    let folder = filmed();
    let root = folder.path();
    succeed(&["-q", "offsets", text(root)]);
    let file = root.join("offsets.json");
    let whole = read_json(&file);
    let cases: [(Edit, &str); 26] = [
        (|o| o["reference"] = json!("cam0"), "reference: is 'cam0', the capture's is 'cam1'"),
        (|o| o["cameras"][0]["id"] = json!("cam9"), "cameras[0].id: no camera of the capture"),
        (|o| o["cameras"][1]["id"] = json!("cam0"), "cameras[1].id: 'cam0' is there twice"),
        (|o| drop(o["cameras"].as_array_mut().unwrap().pop()), "cameras: 'cam2' is missing"),
        (|o| o["cameras"][1]["offset_s"] = json!(0.1), "(cam1).offset_s: must be 0 on the ref"),
        (|o| o["cameras"][1]["std_err_s"] = json!(0.1), "(cam1).std_err_s: must be 0 on the ref"),
        (|o| o["cameras"][0]["offset_s"] = json!(-1e4), "(cam0).offset_s: is -10000.0, which puts"),
        (|o| o["cameras"][0]["offset_s"] = json!("soon"), "cameras[0].offset_s: invalid type"),
        (|o| o["cameras"][0]["offset_s"] = Value::Null, "(cam0).std_err_s: must be null"),
        (|o| o["cameras"][0]["std_err_s"] = json!(-1e-3), "(cam0).std_err_s: is -0.001, must be"),
        (|o| o["cameras"][0]["std_err_s"] = json!(1e3), "(cam0).std_err_s: is 1000.0, must be"),
        (|o| o["cameras"][0]["std_err_s"] = Value::Null, "(cam0).std_err_s: is missing"),
        (|o| o["cameras"][0]["rate_ppm"] = json!(1001), "(cam0).rate_ppm: is 1001.0, must be"),
        (|o| o["cameras"][0]["rate_std_err_ppm"] = json!(-1), "(cam0).rate_std_err_ppm: is -1.0"),
        (|o| o["cameras"][0]["rate_std_err_ppm"] = Value::Null, "rate_std_err_ppm: is missing"),
        (
            |o| {
                let camera = o["cameras"][2].as_object_mut().unwrap();
                camera
                    .extend([("rate_ppm".into(), json!(5)), ("rate_std_err_ppm".into(), json!(1))]);
            },
            "(cam2).rate_ppm: must be 0: the capture",
        ),
        (|o| o["cameras"][0]["readout_s"] = json!(0.01), "(cam0).readout_s: must be absent: the"),
        (|o| o["cameras"][2]["readout_std_err_s"] = json!(0.01), "is there without a readout_s"),
        (|o| o["cameras"][0]["lost_before"] = json!([2]), "(cam0).lost_before: must be empty: the"),
        (|o| o["cameras"][2]["lost_before"] = json!([3, 2]), "lost_before: must ascend"),
        (|o| o["cameras"][2]["lost_before"] = json!([6]), "lost_before: has image 6, and the"),
        (
            |o| o["cameras"][2]["lost_before"] = json!([1, 1, 1, 1, 1, 1, 1]),
            "lost_before: has 7 entries",
        ),
        (|o| o["cameras"][2]["reason"] = json!("so"), "(cam2).reason: is there although"),
        (
            |o| {
                o["cameras"][2]["offset_s"] = Value::Null;
                o["cameras"][2]["std_err_s"] = Value::Null;
            },
            "(cam2).reason: is missing",
        ),
        (|o| o["cameras"][2]["lost_befor"] = json!([]), "cameras[2].lost_befor: unknown field"),
        (|o| o["camera"] = json!([]), "camera: unknown field"),
    ];
    for (change, words) in cases {
        let mut edited = whole.clone();
        change(&mut edited);
        std::fs::write(&file, edited.to_string()).unwrap();
        for command in ["offsets", "plan"] {
            let refused = run(&["-q", command, text(root)]);
            assert_refused(&refused, 2, words);
            assert!(stderr(&refused).contains("offsets.json: "), "{}", stderr(&refused));
            assert!(stderr(&refused).contains("without the file, offsets are estimated"));
        }
    }
}

#[test]
fn offsets_that_are_no_offsets_are_refused() {
    let folder = filmed();
    let (root, file) = (folder.path(), folder.path().join("offsets.json"));
    for text_of_file in ["", "{", "null", "[1]", "{\"cameras\": [{\"offset_s\": 1e999}]}"] {
        std::fs::write(&file, text_of_file).unwrap();
        assert_refused(&run(&["-q", "offsets", text(root)]), 2, "offsets.json: ");
    }
}

/// A capture of one video.
fn video(frames: usize) -> (TempDir, PathBuf) {
    let ffmpeg = common::ffmpeg();
    let scene = Scene::default();
    let folder = tempfile::tempdir().unwrap();
    let format = VideoFormat { depth: BitDepth::Eight, rate_hz: 1.0 / FRAME_S, codec: Codec::Ffv1 };
    let image = |k: usize| scene.image(scene.centers_m[1], k as f64 * FRAME_S);
    let path = folder.path().join("video.mkv");
    let mut video = VideoWriter::create(&ffmpeg, &path, &image(0), format).unwrap();
    (0..frames).for_each(|k| video.push(&image(k)).unwrap());
    video.finish().unwrap();
    let mut camera: Value = scene.camera([0.0; 3]);
    camera["id"] = json!("a");
    camera["frames"] = json!("video.mkv");
    camera["clock"] = json!({"rate_hz": 1.0 / FRAME_S, "first_s": 0.0, "shared": true});
    common::describe(
        folder.path(),
        &json!({"format": "stlfr-capture", "version": 1, "name": "one", "cameras": [camera]}),
    );
    (folder, ffmpeg)
}

/// The folder of the one decoded video; its cache entry has the same name without the extension.
fn decoded(folder: &Path) -> PathBuf {
    let cache = folder.join(".stlfr/cache/video");
    let mut folders = std::fs::read_dir(cache).unwrap().flatten().map(|e| e.path());
    folders.find(|path| path.is_dir()).unwrap()
}

#[test]
fn damaged_frames_of_a_video_are_decoded_anew() {
    let (folder, ffmpeg) = video(5);
    let opened = || {
        let reporter = &Reporter::silent();
        Capture::open_with(folder.path(), &Opening { ffmpeg: Some(&ffmpeg), reporter })
    };
    let frames = |capture: &Capture| -> Vec<Image> {
        (0..capture.cameras[0].frames.len()).map(|k| capture.read_frame(0, k).unwrap()).collect()
    };
    let first = opened().unwrap();
    let whole = frames(&first);
    let cache = decoded(folder.path());
    let outcome = || match opened() {
        Ok(capture) => {
            let is_same_clock = capture.cameras[0].clock == first.cameras[0].clock;
            same(is_same_clock && frames(&capture) == whole)
        }
        Err(error) => one_sentence(error),
    };
    let list = cache.with_extension("");
    outcomes("a video's cache entry", |_| list.clone(), outcome);
    outcomes("a video's frames.json", |_| cache.join("frames.json"), outcome);
    let any_frame = |random: &mut Random| cache.join(format!("{:06}.png", below(random, 5)));
    outcomes("a video's frame", any_frame, outcome);

    // Swapped frames, one that is gone, zeros, a pipe, and a list without a checksum.
    let [zero, one] = ["000000.png", "000001.png"].map(|f| cache.join(f));
    let swap = || {
        std::fs::rename(&zero, cache.join("x")).unwrap();
        std::fs::rename(&one, &zero).unwrap();
        std::fs::rename(cache.join("x"), &one).unwrap();
    };
    let vanish = || std::fs::remove_file(&one).unwrap();
    let nullify = || {
        let length = std::fs::metadata(&one).unwrap().len() as usize;
        std::fs::write(&one, vec![0; length]).unwrap();
    };
    let pipe = || {
        std::fs::remove_file(&list).unwrap();
        common::make_pipe(&list);
    };
    let unsigned = || std::fs::write(&list, &std::fs::read(&list).unwrap()[32..]).unwrap();
    let pipe_for_lock = || {
        vanish();
        let lock = cache.with_extension("lock");
        std::fs::remove_file(&lock).unwrap();
        common::make_pipe(&lock);
    };
    let damages: [&dyn Fn(); 6] = [&swap, &vanish, &nullify, &pipe, &unsigned, &pipe_for_lock];
    for damage in damages {
        damage();
        let view = ["render", text(folder.path()), "--like", "a", "--time", "0.04", "-o"];
        let out = folder.path().join("out.png");
        let output = succeed(&[&view[..], &[text(&out)]].concat());
        let note = stderr(&output);
        assert_eq!(note.matches("is damaged or of another version").count(), 1, "{note}");
        assert_eq!(read_image(&out).unwrap().0, whole[1]);
        assert_eq!(outcome(), Ok(Outcome::Same));
        assert!(!stderr(&succeed(&[&view[..], &[text(&out)]].concat())).contains("damaged"));
    }
}

/// All that is the same from run to run, point by point, and whether every time is one.
fn quality(found: &Tradeoff) -> (Vec<String>, bool) {
    let mut points: Vec<String> = found
        .points
        .iter()
        .map(|p| format!("{} {:?} {:?} {:?}", p.name, p.quality_db, p.whole, p.most_accurate_db))
        .collect();
    points.sort();
    let text = serde_json::to_value(found).unwrap().to_string();
    (points, !text.contains("NaN"))
}

#[test]
fn damaged_measurements_are_made_anew() {
    let folder = Scene { frames: 3, shared: [true, true, false], ..Scene::default() }.film();
    let capture = Arc::new(Capture::open(folder.path()).unwrap());
    let out = tempfile::tempdir().unwrap();
    let options = TradeoffOptions { runs: 1, rounds: 0, ..TradeoffOptions::default() };
    let measured = || tradeoff(&capture, &options, out.path(), &Reporter::silent());
    let whole = quality(&measured().unwrap());
    let cache = folder.path().join(".stlfr/cache");
    let names = |kind: &str| {
        let entries = std::fs::read_dir(cache.join(format!("tradeoff-{kind}"))).unwrap();
        let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
        found.sort();
        found
    };
    let outcome = || match measured() {
        Ok(found) => same(quality(&found) == whole),
        Err(error) => one_sentence(error),
    };
    for kind in ["preparations", "plans", "points"] {
        let files = names(kind);
        assert!(!files.is_empty(), "{kind}");
        let any = |random: &mut Random| files[below(random, files.len())].clone();
        outcomes(&format!("trade-off, {kind}"), any, outcome);
    }

    // A point with a camera that isn't there, and the place of one taken by another.
    let files = names("points");
    let whole = std::fs::read(&files[0]).unwrap();
    let mut point: Value = serde_json::from_slice(&whole[32..]).unwrap();
    point["cameras"] = json!([99]);
    let other = [&whole[..32], point.to_string().as_bytes()].concat();
    std::fs::write(&files[0], other).unwrap();
    std::fs::copy(&files[2], &files[1]).unwrap();
    let mut command = stlfr();
    command.args(["tradeoff", text(folder.path()), "--rounds", "0", "--runs", "1", "-o"]);
    let output = command.arg(out.path()).output().unwrap();
    let notes = stderr(&output);
    assert!(output.status.success(), "{notes}");
    assert_eq!(notes.matches("is damaged or of another version").count(), 2, "{notes}");
    assert_eq!(outcome(), Ok(Outcome::Same));
}
