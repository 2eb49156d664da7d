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
    CornerOptions, Frame, FrameStore, KltOptions, Pyramid, RegistrationOptions, Tracker, corners,
    epipolar_test, temporal_flow,
};

const REPEATS: usize = 41;

/// Two images on disk as OpenCV reads them, points, and the true position of each, if known.
struct Problem {
    name: String,
    files: [std::path::PathBuf; 2],
    truth: Option<Truth>,
}

type Truth = Box<dyn Fn(&Point2<f64>) -> Option<Point2<f64>>>;

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN)
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

type Found = Vec<Option<Point2<f64>>>;

/// Pyramids and tracks; on the calling thread, or on all of the pool's.
fn ours(images: &[Image; 2], points: &[Point2<f64>], options: &KltOptions, pool: bool) -> Found {
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

fn errors(found: &Found, points: &[Point2<f64>], truth: &Truth) -> Vec<f64> {
    points.iter().zip(found).filter_map(|(p, q)| Some((truth(p)? - (*q)?).norm())).collect()
}

/// Milliseconds of one pair, both ways: processor time on one thread, wall time on two.
fn pairs(folder: &Path, peer: &mut Peer) {
    println!(
        "one pair of 640×480, all included | tracks | 1 thread: ours, DIS medium both ways [ms] ratio | 2 threads (wall): ours, DIS, ratio"
    );
    for case in worlds::cases() {
        let cameras = worlds::line_rig(2, 640);
        let film = folder.join(format!("film-{}", case.name));
        let (world, first_frames) = (&case.world, &[0.0, 0.4]);
        bodies::Recording { world, cameras: &cameras, first_frames, frames: 4, noise: 0.009 }
            .write(&film);
        let capture = Arc::new(Capture::open(&film).expect("a capture"));
        let times: Vec<_> = capture.cameras.iter().map(|c| Some(c.clock.times_s.clone())).collect();
        let options = RegistrationOptions::default();
        let images = [1, 2].map(|k| capture.read_frame(0, k).expect("a frame"));
        let store = FrameStore::new(capture, &options);
        for (camera, k) in [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2)] {
            store.get(camera, k).expect("a frame").corners(&options);
        }
        // Decoding is left out, as it is for the peer; pyramids and corners of both are not.
        let register = || {
            let prepared = images.each_ref().map(|i| {
                let frame = Frame::new(i.clone(), &options);
                frame.corners(&options).len()
            });
            assert!(prepared[0] > 0);
            let tracks = temporal_flow(&store, 0, 1).expect("tracks");
            epipolar_test(&store, &times, 0, 1, &tracks).expect("verdicts").len()
        };
        let listed = folder.join("none");
        std::fs::write(&listed, []).expect("a file can be written");
        let file = |k: usize| film.join(format!("cam0/{k:04}.png"));
        peer.ask(&format!(
            "images {} {} {}",
            file(1).display(),
            file(2).display(),
            listed.display()
        ));
        let pool =
            |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        let (one, two) = (pool(1), pool(2));
        let mut count = 0;
        let mut ms = [vec![], vec![], vec![], vec![], vec![], vec![]];
        for _ in 0..REPEATS / 4 {
            peer.ask("threads 1");
            let start = process_cpu_s();
            count = one.install(register);
            let own = 1e3 * (process_cpu_s() - start);
            let theirs = peer.ask("dis").processor_ms;
            peer.ask("threads 2");
            let start = Instant::now();
            two.install(register);
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

fn same_points(folder: &Path, peer: &mut Peer) {
    let same = KltOptions {
        max_residual: 1.0,
        affine: stlfr::registration::AffineOptions { radius_px: 0, ..Default::default() },
        ..Default::default()
    };
    let refined = KltOptions { max_residual: 1.0, ..Default::default() };
    println!(
        "{:22} | points both | ours-OpenCV median p90 [px] | error: ours, OpenCV, refined (median, within 0.1, within 1) | ms: ours, OpenCV, ratio | two threads: OpenCV/ours (wall) | our speed-up (least walls), processor time over one thread's | refined ms",
        ""
    );
    for problem in problems(folder) {
        let images = [0, 1].map(|k| read_image(&problem.files[k]).expect("an image").0.to_gray());
        let corner_options = CornerOptions { max_corners: 2000, ..Default::default() };
        let points =
            corners(&Pyramid::new(&images[0], 1, same.pad_px()).levels()[0], &corner_options);
        // As OpenCV gets them: single precision.
        let points: Vec<Point2<f64>> =
            points.iter().map(|p| p.map(|v| f64::from((v - 0.5) as f32) + 0.5)).collect();
        let bytes: Vec<u8> = points
            .iter()
            .flat_map(|p| [p.x, p.y])
            .flat_map(|v| ((v - 0.5) as f32).to_le_bytes())
            .collect();
        let listed = folder.join("points");
        std::fs::write(&listed, bytes).expect("a file can be written");
        let [a, b] = &problem.files;
        peer.ask(&format!("images {} {} {}", a.display(), b.display(), listed.display()));
        let track = format!(
            "track {} {} {} {}",
            2 * same.radius_px + 1,
            same.levels,
            same.iterations,
            same.epsilon_px
        );
        peer.ask("threads 1");
        let (mut own_ms, mut peer_ms, mut ratios, mut refined_ms) =
            (vec![], vec![], vec![], vec![]);
        let mut found = Found::new();
        let mut best = Found::new();
        for _ in 0..REPEATS {
            let start = process_cpu_s();
            found = ours(&images, &points, &same, false);
            let own = 1e3 * (process_cpu_s() - start);
            let theirs = peer.ask(&track).processor_ms;
            own_ms.push(own);
            peer_ms.push(theirs);
            ratios.push(theirs / own);
            let start = process_cpu_s();
            best = ours(&images, &points, &refined, false);
            refined_ms.push(1e3 * (process_cpu_s() - start));
        }
        let answer = folder.join("answer");
        peer.ask(&format!("tracked {}", answer.display()));
        let table = std::fs::read(&answer).expect("the peer's answer");
        let (numbers, _) = table.as_chunks::<4>();
        let numbers: Vec<f64> = numbers.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect();
        let theirs: Found = numbers
            .chunks_exact(3)
            .map(|n| (n[2] > 0.5).then(|| Point2::new(n[0] + 0.5, n[1] + 0.5)))
            .collect();
        peer.ask("threads 2");
        let (mut both, mut walls, mut spent) = (vec![], [vec![], vec![]], [vec![], vec![]]);
        for _ in 0..REPEATS {
            for pool in [false, true] {
                let (start, processor) = (Instant::now(), process_cpu_s());
                ours(&images, &points, &same, pool);
                walls[usize::from(pool)].push(1e3 * start.elapsed().as_secs_f64());
                spent[usize::from(pool)].push(1e3 * (process_cpu_s() - processor));
            }
            both.push(peer.ask(&track).wall_ms / walls[1][walls[1].len() - 1]);
        }
        // The least of many: other work on the machine only adds to wall time. What two threads
        // can gain where they have two cores is in the processor time.
        let [one, two] = walls.map(|w| quantile(&w, 0.0));
        let [alone, shared] = spent.map(|s| median(&s));
        let differences: Vec<f64> =
            found.iter().zip(&theirs).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
        let accuracy = |found: &Found| match &problem.truth {
            None => "-".to_owned(),
            Some(truth) => {
                let e = errors(found, &points, truth);
                let share =
                    |b: f64| 100.0 * e.iter().filter(|e| **e <= b).count() as f64 / e.len() as f64;
                format!("{:.4} {:.1}% {:.1}%", median(&e), share(0.1), share(1.0))
            }
        };
        println!(
            "{:22} | {} {} | {:.4} {:.4} | {}, {}, {} | {:.1}, {:.1}, {:.2} | {:.2} | {:.2}, {:.2} | {:.1}",
            problem.name,
            points.len(),
            differences.len(),
            median(&differences),
            quantile(&differences, 0.9),
            accuracy(&found),
            accuracy(&theirs),
            accuracy(&best),
            median(&own_ms),
            median(&peer_ms),
            median(&ratios),
            median(&both),
            one / two,
            shared / alone,
            median(&refined_ms),
        );
    }
}
