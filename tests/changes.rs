//! Frames, videos and `capture.json` that change, or change and are put back, at random moments while a command runs.
//! The command gives the result of the capture as it was before or after the change, or one sentence. What it has stored
//! changes no later result. By hand, `STLFR_CHANGES=1000 cargo test --release --test changes` tries so many.

mod common;

use common::random::below;
use common::wall::{FRAME_S, Scene, write_truth};
use common::{copy_folder, edit, ffmpeg, stlfr};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, read_image};
use stlfr::video::{Codec, VideoFormat, VideoWriter};
use tempfile::TempDir;

/// Changes of each command by default.
const CHANGES: usize = 6;

const FRAMES: usize = 4;

fn changes() -> usize {
    std::env::var("STLFR_CHANGES").ok().and_then(|n| n.parse().ok()).unwrap_or(CHANGES)
}

/// Commands that store results. Their own result is in the file or folder that they end with, else on stdout.
const COMMANDS: [&str; 6] = [
    "offsets capture --json",
    "prepare capture",
    "render capture --like cam1 --time 0.07 --preset balanced -o out",
    LATER,
    "compare capture --preset balanced -o review",
    "tradeoff capture --runs 1 --rounds 0 -o points",
];

/// A command that reads frames one after the other, as the clocks are known, and stores nothing.
const LONG: &str = "render capture --like cam1 --times 0.01:0.11:25 -o video";

/// The command whose result depends on all that is stored.
const LATER: &str =
    "render capture --like cam1 --time 0.07 --sync auto --proxy auto --blend auto -o out";

/// The wall with one motion or another, as image sequences or as videos.
fn film(velocity: [f64; 2], as_videos: bool, shared: bool) -> TempDir {
    let scene = Scene { frames: FRAMES, velocity, shared: [shared; 3], ..Scene::default() };
    let folder = scene.film();
    write_truth(folder.path(), &scene);
    for c in (0..3).filter(|_| as_videos) {
        let frames = folder.path().join(format!("cam{c}"));
        let read = |k| read_image(&frames.join(format!("{k}.png"))).unwrap().0;
        let images: Vec<Image> = (0..FRAMES).map(read).collect();
        let format =
            VideoFormat { depth: BitDepth::Sixteen, rate_hz: 1.0 / FRAME_S, codec: Codec::Ffv1 };
        let path = folder.path().join(format!("cam{c}.mkv"));
        let mut video = VideoWriter::create(&ffmpeg(), &path, &images[0], format).unwrap();
        images.iter().for_each(|image| video.push(image).unwrap());
        video.finish().unwrap();
        std::fs::remove_dir_all(frames).unwrap();
    }
    edit(folder.path(), |capture| {
        for c in (0..3).filter(|_| as_videos) {
            capture["cameras"][c]["frames"] = json!(format!("cam{c}.mkv"));
        }
        // So that the two descriptions differ too.
        capture["cameras"][0]["params"][0] = json!(100.0 + velocity[1]);
    });
    folder
}

const IMAGE: &str = "out.png";
const VIDEO: &str = "out.mkv";

fn command(folder: &Path, words: &str) -> Command {
    let mut command = stlfr();
    command.current_dir(folder).arg("-q").args(words.split(' ').map(|word| match word {
        "out" => IMAGE,
        "video" => VIDEO,
        word => word,
    }));
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Values that tell how long something took, or depend on it.
const TIMES: [&str; 7] =
    ["on_front", "cpu_s", "planning_s", "preparation", "recommended", "seconds", "wall_s"];

/// A JSON file without [`TIMES`], and the points of a trade-off in the order of their names.
fn without_times(path: &Path) -> Vec<u8> {
    fn clear(value: &mut Value) {
        match value {
            Value::Array(values) => values.iter_mut().for_each(clear),
            Value::Object(fields) => {
                fields.retain(|name, _| !TIMES.contains(&name.as_str()));
                fields.values_mut().for_each(clear);
            }
            _ => {}
        }
    }
    let mut value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    clear(&mut value);
    if let Some(points) = value.get_mut("points").and_then(Value::as_array_mut) {
        points.sort_by_cached_key(Value::to_string);
    }
    value.to_string().into()
}

/// The result of a command, or its sentence.
fn result(folder: &Path, words: &str, output: std::process::Output) -> Result<Vec<u8>, String> {
    if output.status.success() {
        return Ok(match words.rsplit(' ').next() {
            Some("out") => std::fs::read(folder.join(IMAGE)).unwrap(),
            Some("video") => std::fs::read(folder.join(VIDEO)).unwrap(),
            Some("review") => without_times(&folder.join("review/metrics.json")),
            Some("points") => without_times(&folder.join("points/tradeoff.json")),
            _ if words.starts_with("prepare") => Vec::new(), // prints times
            _ => output.stdout,
        });
    }
    let sentence = String::from_utf8(output.stderr).unwrap();
    assert!(matches!(output.status.code(), Some(1 | 2)), "{words}: {:?}", output.status);
    assert_eq!(sentence.lines().count(), 1, "{words}: {sentence}");
    Err(sentence)
}

/// The result of a command on a copy of the capture in which nothing is stored.
fn from_nothing(capture: &Path, words: &str) -> Result<Vec<u8>, String> {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("capture");
    std::fs::create_dir(&copy).unwrap();
    copy_folder(capture, &copy);
    for stored in ["offsets.json", "offsets.svg"] {
        let _ = std::fs::remove_file(copy.join(stored));
    }
    let _ = std::fs::remove_dir_all(copy.join(".stlfr"));
    let output = command(folder.path(), words).output().unwrap();
    result(folder.path(), words, output)
}

/// A way to change a file or a folder.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// Another takes its place.
    Renamed,
    /// A file gets other bytes.
    Written,
}

/// What a capture's path becomes, and the moments as fractions of the command's duration.
#[derive(Debug)]
struct Change {
    path: PathBuf,
    way: Way,
    at: f64,
    /// When all is put back, if it is.
    back: Option<f64>,
}

impl Change {
    fn any(random: &mut Random, as_videos: bool) -> Self {
        let camera = below(random, 3);
        let path = match below(random, 5) {
            0 => "capture.json".into(),
            1 => format!("truth/{}", ["truth.json", "0.png", "depth.npy"][below(random, 3)]),
            _ if as_videos => format!("cam{camera}.mkv"),
            2 => format!("cam{camera}"),
            _ => format!("cam{camera}/{}.png", below(random, FRAMES)),
        };
        let is_folder = !path.contains('.');
        let way = if is_folder || random.unit() < 0.5 { Way::Renamed } else { Way::Written };
        let at = random.unit();
        let back = (random.unit() < 0.6).then(|| at + (1.2 - at) * random.unit());
        Self { path: path.into(), way, at, back }
    }

    /// Exchanges what is at the path with what is in the other capture.
    fn apply(&self, capture: &Path, other: &Path) {
        let (own, other) = (capture.join(&self.path), other.join(&self.path));
        let kept = capture.with_extension("kept");
        match self.way {
            Way::Renamed => {
                std::fs::rename(&own, &kept).unwrap();
                std::fs::rename(&other, &own).unwrap();
                std::fs::rename(&kept, &other).unwrap();
            }
            Way::Written => {
                let bytes = [&own, &other].map(|path| std::fs::read(path).unwrap());
                std::fs::write(own, &bytes[1]).unwrap();
                std::fs::write(other, &bytes[0]).unwrap();
            }
        }
    }
}

/// Runs a command on a fresh copy of the first capture, while it changes.
fn try_change(words: &str, captures: &[TempDir; 2], took: Duration, change: &Change) {
    let folder = tempfile::tempdir().unwrap();
    let [capture, other] = ["capture", "other"].map(|name| folder.path().join(name));
    for (from, to) in captures.iter().zip([&capture, &other]) {
        std::fs::create_dir(to).unwrap();
        copy_folder(from.path(), to);
    }
    let mut allowed = vec![from_nothing(&capture, words)];
    change.apply(&capture, &other);
    allowed.push(from_nothing(&capture, words));
    change.apply(&capture, &other);

    let start = Instant::now();
    let wait = |fraction: f64| {
        std::thread::sleep(took.mul_f64(fraction).saturating_sub(start.elapsed()));
    };
    let child = command(folder.path(), words).spawn().unwrap();
    wait(change.at);
    change.apply(&capture, &other);
    if let Some(back) = change.back {
        wait(back);
        change.apply(&capture, &other);
    }
    let found = result(folder.path(), words, child.wait_with_output().unwrap());
    assert!(found.is_err() || allowed.contains(&found), "{words}: another result, {change:?}");
    for later in [words, LATER] {
        let output = command(folder.path(), later).output().unwrap();
        let found = result(folder.path(), later, output);
        assert!(found == from_nothing(&capture, later), "{words}: stored wrongly, {change:?}");
    }
}

fn try_changes(commands: &[&str], as_videos: bool, shared: bool) {
    let captures = [[0.3, 1.0], [-0.4, 0.7]].map(|velocity| film(velocity, as_videos, shared));
    let mut random = Random::new(36);
    for words in commands {
        let start = Instant::now();
        let first = from_nothing(captures[0].path(), words);
        let took = start.elapsed();
        assert!(first.is_ok(), "{first:?}");
        // Those that run every method take ten times as long.
        let is_long = ["compare", "tradeoff"].iter().any(|name| words.starts_with(name));
        for _ in 0..if is_long { changes().div_ceil(3) } else { changes() } {
            let change = Change::any(&mut random, as_videos);
            try_change(words, &captures, took, &change);
        }
    }
}

#[test]
fn images_that_change_under_a_command_are_told_or_change_nothing() {
    try_changes(&COMMANDS, false, false);
    try_changes(&[LONG], false, true);
}

#[test]
fn videos_that_change_under_a_command_are_told_or_change_nothing() {
    try_changes(&COMMANDS, true, false);
}
