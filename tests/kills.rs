//! Commands that are killed at random moments: run again they give the same bytes, and nothing that
//! they had begun is left. By hand, `STLFR_KILLS=200 cargo test --release --test kills -- --nocapture`
//! kills so many and prints a table.
//!
//! Of four processes that share a sequence three are killed, and one has a wrong clock; `STLFR_KILLS=30` is ten rounds.

mod common;

use common::random::below;
use common::wall::{FRAME_S, H, Scene, W};
use common::{stderr, stlfr};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, read_image, write_image};
use stlfr::video::{Codec, VideoFormat, VideoWriter};

/// Kills by default: each command once or a few times.
const KILLS: usize = 13;

const FRAMES: usize = 6;

/// Kills by default of processes that share a sequence: three a round.
const SHARED_KILLS: usize = 6;

/// The instant of the truth, between frames.
const TRUTH_S: f64 = 0.1;

/// A command that writes.
struct Writer {
    name: &'static str,
    /// Its arguments; the output, relative to the run's folder, is the last one.
    arguments: Vec<String>,
    /// Outputs that hold times, and differ from run to run.
    timed: &'static [&'static str],
}

/// What the commands read: a capture with truth and its twin of videos, both with offsets to estimate,
/// and a calibration with images.
struct Sources {
    folder: tempfile::TempDir,
    /// An ffmpeg, and a source tree without an environment: nothing here needs Blender.
    tools: tempfile::TempDir,
}

impl Sources {
    fn film() -> Self {
        let [folder, tools] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let ffmpeg = common::ffmpeg();
        symlink(&ffmpeg, tools.path().join("ffmpeg")).unwrap();
        std::fs::create_dir(tools.path().join("blender")).unwrap();
        std::fs::write(tools.path().join("blender/requirements.txt"), "").unwrap();
        let scene = Scene { frames: FRAMES, ..Scene::default() };
        let capture = scene.film();
        film_truth(&scene, capture.path());
        copy(capture.path(), &folder.path().join("capture"));
        film_videos(&ffmpeg, capture.path(), &folder.path().join("videos"));
        let sources = Self { folder, tools };
        let export = ["export", "capture", "--format", "colmap-text", "-o", "sparse"];
        let exported = sources.command_in(sources.folder.path(), &export).output().unwrap();
        assert!(exported.status.success(), "{}", stderr(&exported));
        sources
    }

    /// A command whose working folder is a copy of the sources.
    fn command_in(&self, folder: &Path, arguments: &[impl AsRef<str>]) -> Command {
        let mut command = stlfr();
        command.current_dir(folder).arg("-q").args(arguments.iter().map(AsRef::as_ref));
        command.env("STLFR_HOME", self.tools.path()).env("PATH", self.tools.path());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    /// A folder with a fresh copy of them.
    fn copied(&self) -> tempfile::TempDir {
        let copied = tempfile::tempdir().unwrap();
        copy(self.folder.path(), copied.path());
        copied
    }
}

/// Truth of one instant: a camera's own image, everywhere in motion.
fn film_truth(scene: &Scene, capture: &Path) {
    let truth = capture.join("truth");
    let image = scene.image(scene.centers_m[1], TRUTH_S);
    write_image(&truth.join("0.png"), &image, None, BitDepth::Sixteen).unwrap();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({H}, {W}), }}\n");
    let mut motion = b"\x93NUMPY\x01\x00".to_vec();
    motion.extend((header.len() as u16).to_le_bytes());
    motion.extend(header.as_bytes());
    motion.extend((0..W * H).flat_map(|_| 2_f32.to_le_bytes()));
    std::fs::write(truth.join("0.npy"), motion).unwrap();
    let offsets: Vec<_> =
        (0..3).map(|c| json!({"id": format!("cam{c}"), "offset_s": scene.offsets_s[c]})).collect();
    let described = json!({"format": "stlfr-truth", "version": 1, "scene": "wall", "rig": "row",
        "offsets": offsets, "shutter": [], "views": [{"id": "t0-cam1", "time_s": TRUTH_S,
            "like": "cam1", "camera": scene.camera(scene.centers_m[1]), "image": "0.png",
            "depth": "none.npy", "motion": "0.npy"}]});
    std::fs::write(truth.join("truth.json"), described.to_string()).unwrap();
}

/// The same capture with a video a camera.
fn film_videos(ffmpeg: &Path, capture: &Path, videos: &Path) {
    copy(capture, videos);
    for c in 0..3 {
        let folder = videos.join(format!("cam{c}"));
        let frames: Vec<Image> =
            (0..FRAMES).map(|k| read_image(&folder.join(format!("{k}.png"))).unwrap().0).collect();
        let format =
            VideoFormat { depth: BitDepth::Sixteen, rate_hz: 1.0 / FRAME_S, codec: Codec::Ffv1 };
        let path = videos.join(format!("cam{c}.mkv"));
        let mut video = VideoWriter::create(ffmpeg, &path, &frames[0], format).unwrap();
        frames.iter().for_each(|frame| video.push(frame).unwrap());
        video.finish().unwrap();
        std::fs::remove_dir_all(folder).unwrap();
    }
    common::edit(videos, |json| {
        for c in 0..3 {
            json["cameras"][c]["frames"] = format!("cam{c}.mkv").into();
        }
    });
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// How many processes to kill.
fn kills(default: usize) -> usize {
    std::env::var("STLFR_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(default)
}

fn writers() -> Vec<Writer> {
    let writer = |name, arguments: &str, timed| Writer {
        name,
        arguments: arguments.split(' ').map(str::to_owned).collect(),
        timed,
    };
    vec![
        writer("offsets", "offsets capture", &[]),
        writer("plan", "plan capture -o out/options.json", &[]),
        writer("render, image", "render capture --like cam1 --time 0.1 -o out/a.png", &[]),
        writer(
            "render, images",
            "render capture --like cam1 --times 0.05:0.15:9 -o out/%d.png",
            &[],
        ),
        writer("render, video", "render capture --like cam1 --times 0.05:0.15:9 -o out/a.mkv", &[]),
        writer("render of videos", "render videos --like cam1 --time 0.1 -o out/a.png", &[]),
        writer("rig", "rig line --count 100 -o out/rig.json", &[]),
        writer("export, colmap", "export capture --format colmap -o out/sparse", &[]),
        writer("export, nerf", "export capture --format nerf -o out/transforms.json", &[]),
        writer("import", "import sparse --images capture --rate 25 -o out", &[]),
        writer("compare", "compare capture -o out", &["timings.json", "report.html"]),
        writer("compare --video", "compare capture --video", &["timings.json", "report.html"]),
        writer(
            "tradeoff",
            "tradeoff capture --rounds 0 --runs 1 -o out",
            &["tradeoff-", "tradeoff.json", "tradeoff.svg", "recommended.json"],
        ),
    ]
}

/// The files below a folder with their bytes; those with times have none.
fn files(folder: &Path, timed: &[&str]) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap().flatten() {
            let path = entry.path();
            let below = path.strip_prefix(folder).unwrap();
            if path.is_dir() {
                folders.push(path);
            } else if let Ok(bytes) = std::fs::read(&path) {
                let name = below.to_string_lossy();
                if name.contains("/.stlfr/cache/hashes/") {
                    continue; // named by the times of the copy's files
                }
                let prefixes = ["out/", "capture/review/", "capture/.stlfr/cache/"];
                let name = prefixes.iter().find_map(|p| name.strip_prefix(p));
                let is_timed = name.is_some_and(|name| timed.iter().any(|t| name.starts_with(t)));
                found.insert(below.to_owned(), if is_timed { Vec::new() } else { bytes });
            }
        }
    }
    found
}

/// Temporary folders below a folder.
fn left(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap().flatten() {
            if entry.file_name().to_string_lossy().ends_with(".tmp") {
                found.push(entry.path());
            } else if entry.path().is_dir() {
                folders.push(entry.path());
            }
        }
    }
    found
}

/// What the kills of one command came to.
#[derive(Default)]
struct Row {
    kills: usize,
    /// Kills that came before the command's own end.
    in_time: usize,
    /// Kills that left a temporary folder.
    left: usize,
    /// Reruns that failed, left something, or gave other bytes, each in a sentence.
    wrong: Vec<String>,
}

impl Row {
    /// Kills the command after some of the time that it takes, once or a few times, and runs it again.
    fn kill(&mut self, writer: &Writer, sources: &Sources, whole: &Whole, random: &mut Random) {
        let folder = sources.copied();
        for _ in 0..=below(random, 3) {
            let mut child = sources.command_in(folder.path(), &writer.arguments).spawn().unwrap();
            std::thread::sleep(whole.took.mul_f64(random.unit()));
            self.in_time += usize::from(child.try_wait().unwrap().is_none());
            child.kill().unwrap();
            child.wait().unwrap();
            self.kills += 1;
        }
        self.left += usize::from(!left(folder.path()).is_empty());
        let again = sources.command_in(folder.path(), &writer.arguments).output().unwrap();
        let is_import_done =
            writer.name == "import" && stderr(&again).contains("holds files already");
        if !again.status.success() && !is_import_done {
            self.wrong.push(format!("refused: {}", stderr(&again).trim()));
        } else if let [first, ..] = left(folder.path()).as_slice() {
            self.wrong.push(format!("left: {}", first.display()));
        } else if files(folder.path(), writer.timed).keys().ne(whole.files.keys())
            && writer.timed.is_empty()
        {
            self.wrong.push("other files".into());
        } else if let Some((path, _)) = files(folder.path(), writer.timed)
            .iter()
            .find(|(path, bytes)| whole.files.get(*path).is_some_and(|whole| whole != *bytes))
        {
            self.wrong.push(format!("other bytes: {}", path.display()));
        }
    }
}

/// A run that nobody disturbed.
struct Whole {
    took: Duration,
    files: BTreeMap<PathBuf, Vec<u8>>,
}

fn undisturbed(writer: &Writer, sources: &Sources) -> Whole {
    let folder = sources.copied();
    let start = Instant::now();
    let output = sources.command_in(folder.path(), &writer.arguments).output().unwrap();
    assert!(output.status.success(), "{}: {}", writer.name, stderr(&output));
    Whole { took: start.elapsed(), files: files(folder.path(), writer.timed) }
}

#[test]
fn what_is_killed_is_done_again_as_if_nothing_had_been() {
    let kills = kills(KILLS);
    let mut random = Random::new(11);
    let sources = Sources::film();
    let mut wrong = Vec::new();
    println!(
        "| command | takes | kills | before its end | left something until the rerun | wrong |"
    );
    println!("|---|---|---|---|---|---|");
    let writers = writers();
    for writer in &writers {
        let whole = undisturbed(writer, &sources);
        let mut row = Row::default();
        while row.kills < kills.div_ceil(writers.len()) {
            row.kill(writer, &sources, &whole, &mut random);
        }
        let Row { kills, in_time, left, wrong: found } = row;
        let took = whole.took.as_secs_f64();
        println!(
            "| {} | {took:.2} s | {kills} | {in_time} | {left} | {} |",
            writer.name,
            found.len()
        );
        wrong.extend(found.into_iter().map(|sentence| format!("{}: {sentence}", writer.name)));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A library that sets a program's clock an hour ahead.
const WRONG_CLOCK: &str = r"
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = syscall(SYS_clock_gettime, clock, now);
    if (!failed && clock == CLOCK_REALTIME) now->tv_sec += 3600;
    return failed;
}";

/// Compiles [`WRONG_CLOCK`], with the linker that Rust uses.
fn wrong_clock(folder: &Path) -> PathBuf {
    let [source, library] = ["clock.c", "clock.so"].map(|name| folder.join(name));
    std::fs::write(&source, WRONG_CLOCK).unwrap();
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&source);
    assert!(compiler.status().unwrap().success());
    let seconds = |preload: &Path| -> i64 {
        let said = Command::new("date").arg("+%s").env("LD_PRELOAD", preload).output().unwrap();
        String::from_utf8(said.stdout).unwrap().trim().parse().unwrap()
    };
    assert!((3590..3700).contains(&(seconds(&library) - seconds(Path::new("")))));
    library
}

/// Notes every version of every image of a folder while processes write into it.
struct Watched {
    folder: PathBuf,
    /// Names with inodes.
    versions: BTreeSet<(String, u64)>,
}

impl Watched {
    fn look(&mut self) {
        for entry in std::fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.ends_with(".png")
                && let Ok(data) = entry.metadata()
            {
                self.versions.insert((name, data.ino()));
            }
        }
    }

    fn look_until(&mut self, mut is_over: impl FnMut(&Self) -> bool) {
        while !is_over(self) {
            std::thread::sleep(Duration::from_millis(1));
            self.look();
        }
    }

    /// Images written more than once.
    fn repeated(&self) -> usize {
        let names: BTreeSet<&String> = self.versions.iter().map(|(name, _)| name).collect();
        self.versions.len() - names.len()
    }
}

/// One round: three of four are killed. Gives the images, how many were there after the last kill, and how many were
/// written twice.
fn kill_three_of_four(
    sources: &Sources,
    arguments: &[String],
    clock: &Path,
    random: &mut Random,
) -> (BTreeMap<PathBuf, Vec<u8>>, [usize; 2]) {
    let folder = sources.copied();
    let wrong = below(random, 4);
    let worker = |k: usize| {
        let mut command = sources.command_in(folder.path(), arguments);
        if k == wrong {
            command.env("LD_PRELOAD", clock);
        }
        command.spawn().unwrap()
    };
    let mut workers: Vec<_> = (0..4).map(worker).collect();
    let mut watched = Watched { folder: folder.path().join("out"), versions: BTreeSet::new() };
    for victim in &mut workers[..3] {
        let goal = watched.versions.len() + below(random, 5);
        watched.look_until(|watched| {
            watched.versions.len() >= goal || victim.try_wait().unwrap().is_some()
        });
        std::thread::sleep(Duration::from_millis(below(random, 15) as u64));
        victim.kill().unwrap();
        victim.wait().unwrap();
    }
    let written = watched.versions.len();
    watched.look_until(|_| workers[3].try_wait().unwrap().is_some());
    assert!(workers[3].wait().unwrap().success());
    let found = files(&folder.path().join("out"), &[]);
    println!("killed after {written} of {} images; clock {wrong} is wrong", found.len());
    // The capture's cache is tidied by the next command that stores there.
    assert_eq!(left(&folder.path().join("out")), Vec::<PathBuf>::new());
    (found, [written, watched.repeated()])
}

/// An image is written twice only if the first one to write it was killed before it could say so.
#[test]
fn of_four_that_share_a_sequence_three_are_killed() {
    let mut random = Random::new(39);
    let sources = Sources::film();
    let clock = wrong_clock(sources.tools.path());
    let estimated = sources.command_in(sources.folder.path(), &["offsets", "capture"]).output();
    assert!(estimated.unwrap().status.success());
    let commands = [
        "render capture --path bullet-time --duration 2 --fps 39.5 --stereo 0.02 --convergence 2 -o out/%d.png",
        "render capture --like cam1 --times 0.05:0.15:80 --trail 0.02 --trail-instants 4 -o out/%d.png",
    ];
    let commands = commands.map(|line| line.split(' ').map(str::to_owned).collect::<Vec<_>>());
    let wholes = commands.each_ref().map(|arguments| {
        let folder = sources.copied();
        let output = sources.command_in(folder.path(), arguments).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        files(&folder.path().join("out"), &[])
    });
    let rounds = kills(SHARED_KILLS).div_ceil(3);
    let (mut repeated, mut in_time) = (0, 0);
    for round in 0..rounds {
        let (arguments, whole) = (&commands[round % 2], &wholes[round % 2]);
        assert_eq!(whole.len(), 80);
        let (found, [written, again]) =
            kill_three_of_four(&sources, arguments, &clock, &mut random);
        assert!(&found == whole, "{:?}", found.keys());
        repeated += again;
        in_time += usize::from(written < whole.len());
        assert!(again <= 3, "{again} images were written twice");
    }
    println!("{rounds} rounds: same bytes; {repeated} images were written twice");
    assert!(2 * in_time >= rounds, "killed before the end in {in_time} of {rounds} rounds");
}
