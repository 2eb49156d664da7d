//! The tracker beside OpenCV's `calcOpticalFlowPyrLK`: the same points, window, levels and
//! iterations. Times are processor time, taken in turns; their ratio is the median of ratios.
//!
//! And the registration of a pair of frames, everything included, beside dense flow (DIS, medium)
//! in both directions.
//!
//! `cargo bench --bench klt`

#[path = "../common/bodies.rs"]
#[allow(dead_code)]
mod bodies;
mod peer;
#[path = "../common/worlds.rs"]
mod worlds;

use nalgebra::Point2;
use peer::Peer;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::Capture;
use stlfr::host::process_cpu_s;
use stlfr::raster::Image;
use stlfr::raster::read_image;
use stlfr::registration::{
    Frame, FrameStore, KltParameters, Pyramid, RegistrationOptions, Tracker, corners,
    epipolar_check, temporal_flow,
};

const REPEATS: usize = 41;

/// Two images on disk as OpenCV reads them, points, and the true position of each, if known.
struct Problem {
    name: String,
    files: [std::path::PathBuf; 2],
    truth: Option<Truth>,
}

type Truth = Box<dyn Fn(&Point2<f64>) -> Option<Point2<f64>>>;

fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len() as f64 - 1.0) * fraction) as usize).copied().unwrap_or(f64::NAN)
}

fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

fn problems(folder: &Path) -> Vec<Problem> {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/klt");
    let mut all = vec![Problem {
        name: "desk (real, 320×240)".into(),
        files: [golden.join("img0.pgm"), golden.join("img1.pgm")],
        truth: None,
    }];
    let camera = worlds::line_rig(1, 640).remove(0);
    for case in worlds::cases() {
        let files = [1.0, 2.0].map(|time| {
            let path = folder.join(format!("{}{time}.png", case.name));
            let image = case.world.film(&camera, time, 0.009, time as u64).to_gray();
            stlfr::raster::write_image(&path, &image, None, stlfr::raster::BitDepth::Eight)
                .expect("an image can be written");
            path
        });
        let (camera, world) = (camera.clone(), case.world);
        all.push(Problem {
            name: format!("{} (640×480)", case.name),
            files,
            truth: Some(Box::new(move |p| {
                let surface = world.seen(&camera, p, 1.0)?;
                world
                    .is_seen(&surface, &camera, 2.0)
                    .then(|| world.position(&surface, &camera, 2.0))?
            })),
        });
    }
    all
}

/// The position of each point in the second image, if it was tracked.
type Tracked = Vec<Option<Point2<f64>>>;

/// Pyramids and tracks; on the calling thread, or on all of the pool's.
fn ours(
    images: &[Image; 2],
    points: &[Point2<f64>],
    options: &RegistrationOptions,
    pool: bool,
) -> Tracked {
    let pyramid = |image: &Image| Pyramid::new(image, options.levels, options.pad_px());
    let track = |chunk: &[Point2<f64>], a: &Pyramid, b: &Pyramid| {
        let mut tracker = Tracker::new(options);
        chunk.iter().map(|&p| Some(tracker.track(a, b, p, p)?.position)).collect::<Vec<_>>()
    };
    if pool {
        let (a, b) = rayon::join(|| pyramid(&images[0]), || pyramid(&images[1]));
        points.par_chunks(64).flat_map_iter(|chunk| track(chunk, &a, &b)).collect()
    } else {
        let (a, b) = (pyramid(&images[0]), pyramid(&images[1]));
        track(points, &a, &b)
    }
}

fn errors(tracked: &Tracked, points: &[Point2<f64>], truth: &Truth) -> Vec<f64> {
    points.iter().zip(tracked).filter_map(|(p, q)| Some((truth(p)? - (*q)?).norm())).collect()
}

/// A recording, and what registers the pair of its frames 1 and 2.
struct PairProblem {
    options: RegistrationOptions,
    images: [Image; 2],
    times_s: Vec<Option<Vec<f64>>>,
    store: FrameStore,
}

impl PairProblem {
    fn new(case: &worlds::Case, recording: &Path) -> Self {
        let cameras = worlds::line_rig(2, 640);
        let (world, first_frames) = (&case.world, &[0.0, 0.4]);
        bodies::Recording { world, cameras: &cameras, first_frames, frames: 4, noise: 0.009 }
            .write(recording);
        let capture = Arc::new(Capture::open(recording).expect("a capture"));
        let times_s = capture.cameras.iter().map(|c| Some(c.clock.times_s.clone())).collect();
        let options = RegistrationOptions::default();
        let images = [1, 2].map(|k| capture.read_frame(0, k).expect("a frame"));
        let store = FrameStore::new(capture, &options);
        for (camera, k) in [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2)] {
            store.get(camera, k).expect("a frame").corners(&options);
        }
        Self { options, images, times_s, store }
    }

    /// The number of tracks. Decoding is not included, as for the peer; pyramids and corners of both
    /// frames are.
    fn register(&self) -> usize {
        let corners = |i: &Image| Frame::new(i.clone(), &self.options).corners(&self.options).len();
        let (a, b) = rayon::join(|| corners(&self.images[0]), || corners(&self.images[1]));
        assert!(a > 0 && b > 0);
        let tracks = temporal_flow(&self.store, 0, 1).expect("tracks");
        epipolar_check(&self.store, &self.times_s, 0, 1, &tracks).expect("verdicts").len()
    }
}

/// Milliseconds of one pair, both ways: processor time on one thread, wall time on two.
fn pairs(folder: &Path, peer: &mut Peer) {
    println!(
        "one pair of 640×480, all included | tracks | 1 thread: ours, DIS medium both ways [ms] ratio | 2 threads (wall): ours, DIS, ratio"
    );
    let no_points = folder.join("none");
    std::fs::write(&no_points, []).expect("a file can be written");
    let pool = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
    let (one, two) = (pool(1), pool(2));
    for case in worlds::cases() {
        let recording = folder.join(format!("film-{}", case.name));
        let problem = PairProblem::new(&case, &recording);
        let file = |k: usize| recording.join(format!("cam0/{k:04}.png"));
        let [a, b] = [file(1), file(2)];
        peer.ask(&format!("images {} {} {}", a.display(), b.display(), no_points.display()));
        let mut count = 0;
        let mut ms = [vec![], vec![], vec![], vec![], vec![], vec![]];
        for _ in 0..REPEATS / 4 {
            peer.ask("threads 1");
            let start = process_cpu_s();
            count = one.install(|| problem.register());
            let own = 1e3 * (process_cpu_s() - start);
            let theirs = peer.ask("dis").processor_ms;
            peer.ask("threads 2");
            let start = Instant::now();
            two.install(|| problem.register());
            let own_wall = 1e3 * start.elapsed().as_secs_f64();
            let their_wall = peer.ask("dis").wall_ms;
            let row = [own, theirs, theirs / own, own_wall, their_wall, their_wall / own_wall];
            for (all, v) in ms.iter_mut().zip(row) {
                all.push(v);
            }
        }
        let m = ms.map(|v| median(&v));
        println!(
            "{:22} | {count} | {:.0}, {:.0}, {:.2} | {:.0}, {:.0}, {:.2}",
            case.name, m[0], m[1], m[2], m[3], m[4], m[5]
        );
    }
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut peer = Peer::start();
    if !std::env::args().any(|a| a == "--pairs") {
        same_points(folder.path(), &mut peer);
    }
    pairs(folder.path(), &mut peer);
}

/// The corners of an image, as OpenCV gets them: in single precision.
fn rounded_corners(image: &Image, pad_px: usize) -> Vec<Point2<f64>> {
    corners(&Pyramid::new(image, 1, pad_px).levels[0], 2000)
        .iter()
        .map(|p| p.map(|v| f64::from((v - 0.5) as f32) + 0.5))
        .collect()
}

/// Gives the peer the problem's images and points.
fn send(problem: &Problem, points: &[Point2<f64>], folder: &Path, peer: &mut Peer) {
    let bytes: Vec<u8> = points
        .iter()
        .flat_map(|p| [p.x, p.y])
        .flat_map(|v| ((v - 0.5) as f32).to_le_bytes())
        .collect();
    let file = folder.join("points");
    std::fs::write(&file, bytes).expect("a file can be written");
    let [a, b] = &problem.files;
    peer.ask(&format!("images {} {} {}", a.display(), b.display(), file.display()));
}

/// The tracks of the peer's last command.
fn peer_tracks(folder: &Path, peer: &mut Peer) -> Tracked {
    let answer = folder.join("answer");
    peer.ask(&format!("tracked {}", answer.display()));
    let table = std::fs::read(&answer).expect("the peer's answer");
    let (numbers, _) = table.as_chunks::<4>();
    let numbers: Vec<f64> = numbers.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect();
    numbers
        .chunks_exact(3)
        .map(|n| (n[2] > 0.5).then(|| Point2::new(n[0] + 0.5, n[1] + 0.5)))
        .collect()
}

/// Processor time on one thread, milliseconds a repetition, and the tracks.
#[derive(Default)]
struct OneThread {
    own_ms: Vec<f64>,
    peer_ms: Vec<f64>,
    ratios: Vec<f64>,
    own: Tracked,
}

/// Times on two threads.
struct TwoThreads {
    /// The peer's wall time over ours, median.
    ratio: f64,
    /// Our wall time on one thread over that on two.
    speed_up: f64,
    /// Our processor time on two threads over that on one.
    overhead: f64,
}

/// A problem's images and points, with the options of both trackers.
struct Comparison<'a> {
    images: &'a [Image; 2],
    points: &'a [Point2<f64>],
    options: &'a RegistrationOptions,
    /// The command that makes the peer track.
    command: String,
}

impl Comparison<'_> {
    fn one_thread(&self, peer: &mut Peer) -> OneThread {
        peer.ask("threads 1");
        let mut all = OneThread::default();
        for _ in 0..REPEATS {
            let start = process_cpu_s();
            all.own = ours(self.images, self.points, self.options, false);
            let own = 1e3 * (process_cpu_s() - start);
            let theirs = peer.ask(&self.command).processor_ms;
            all.own_ms.push(own);
            all.peer_ms.push(theirs);
            all.ratios.push(theirs / own);
        }
        all
    }

    fn two_threads(&self, peer: &mut Peer) -> TwoThreads {
        peer.ask("threads 2");
        let (mut ratios, mut walls, mut cpu) = (vec![], [vec![], vec![]], [vec![], vec![]]);
        for _ in 0..REPEATS {
            for pool in [false, true] {
                let (start, processor) = (Instant::now(), process_cpu_s());
                ours(self.images, self.points, self.options, pool);
                walls[usize::from(pool)].push(1e3 * start.elapsed().as_secs_f64());
                cpu[usize::from(pool)].push(1e3 * (process_cpu_s() - processor));
            }
            ratios.push(peer.ask(&self.command).wall_ms / walls[1][walls[1].len() - 1]);
        }
        // The minimum of many: other work on the machine only adds to wall time. The gain that two
        // threads have on two idle cores shows in the processor time.
        let [one, two] = walls.map(|w| quantile(&w, 0.0));
        let [alone, shared] = cpu.map(|s| median(&s));
        TwoThreads { ratio: median(&ratios), speed_up: one / two, overhead: shared / alone }
    }
}

/// Median error, and the percentages within 0.1 and 1 pixel.
fn accuracy(tracked: &Tracked, points: &[Point2<f64>], truth: Option<&Truth>) -> String {
    let Some(truth) = truth else { return "-".to_owned() };
    let e = errors(tracked, points, truth);
    let percent = |b: f64| 100.0 * e.iter().filter(|e| **e <= b).count() as f64 / e.len() as f64;
    format!("{:.4} {:.1}% {:.1}%", median(&e), percent(0.1), percent(1.0))
}

fn same_points(folder: &Path, peer: &mut Peer) {
    let options = RegistrationOptions::default();
    println!(
        "{:22} | points both | ours-OpenCV median p90 [px] | error: ours, OpenCV (median, within 0.1, within 1) | ms: ours, OpenCV, ratio | two threads: OpenCV/ours (wall) | our speed-up (minimal walls), processor time over one thread's",
        ""
    );
    for problem in problems(folder) {
        let images = [0, 1].map(|k| read_image(&problem.files[k]).expect("an image").0.to_gray());
        let points = rounded_corners(&images[0], options.pad_px());
        send(&problem, &points, folder, peer);
        let KltParameters { window_radius_px, levels, iterations, epsilon_px } = (&options).into();
        let side = 2 * window_radius_px + 1;
        let command = format!("track {side} {levels} {iterations} {epsilon_px}");
        let comparison =
            Comparison { images: &images, points: &points, options: &options, command };
        let one = comparison.one_thread(peer);
        let theirs = peer_tracks(folder, peer);
        let two = comparison.two_threads(peer);
        let differences: Vec<f64> =
            one.own.iter().zip(&theirs).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
        let accuracy = |tracked| accuracy(tracked, &points, problem.truth.as_ref());
        println!(
            "{:22} | {} {} | {:.4} {:.4} | {}, {} | {:.1}, {:.1}, {:.2} | {:.2} | {:.2}, {:.2}",
            problem.name,
            points.len(),
            differences.len(),
            median(&differences),
            quantile(&differences, 0.9),
            accuracy(&one.own),
            accuracy(&theirs),
            median(&one.own_ms),
            median(&one.peer_ms),
            median(&one.ratios),
            two.ratio,
            two.speed_up,
            two.overhead,
        );
    }
}
