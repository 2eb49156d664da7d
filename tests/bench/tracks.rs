//! Tracks against the truth, scene by scene: how accurate they are, before and after the epipolar
//! test; what the checks remove of the wrong ones, and lose of the right ones.
//!
//! `cargo bench --bench tracks [-- CAPTURE…]`: filmed captures with `truth/tracks`, whose points are
//! tracked; without any, the five worlds of `tests/common/worlds.rs`, whose corners are.
//!
//! `cargo bench --bench tracks -- --gains CAPTURE…`: for each camera, its gains of red, green and blue, and how much
//! they are found to change over its recording, %.

#[path = "../common/bodies.rs"]
#[allow(dead_code)]
mod bodies;
#[path = "tracks/points.rs"]
mod points;
#[path = "../common/worlds.rs"]
mod worlds;

use bodies::{Recording, Surface};
use nalgebra::{Point2, Vector2};
use points::CameraPoints;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;
use stlfr::camera::{Camera, EpipolarGeometry};
use stlfr::capture::{Capture, FrameTimes, Truth};
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::random::Random;
use stlfr::registration::{
    FlowDirection, FrameStore, ReferenceQuery, RegistrationOptions, Track, Verdict, epipolar_check,
    neighbor_consensus, select_references, temporal_flow, temporal_flow_of,
};
use worlds::Case;

const FRAMES: usize = 8;
const DELAYS: [f64; 3] = [0.0, 0.37, 0.71];

/// Motion over this between two frames is large, pixels.
const LARGE_PX: f64 = 20.0;

/// Whose positions are known.
enum Known {
    World { case: Case, cameras: Vec<Camera> },
    Film { points: Vec<CameraPoints> },
}

#[derive(Clone, Copy)]
enum Point {
    Surface(Surface),
    Numbered(usize),
}

/// A track, and the point that it started on.
#[derive(Clone)]
struct Sample {
    track: Track,
    point: Point,
}

struct Scene {
    name: String,
    known: Known,
    capture: Arc<Capture>,
    times_s: Vec<Option<Vec<f64>>>,
    /// The pairs to score.
    pairs: Vec<(usize, usize)>,
}

impl Scene {
    fn world(case: Case) -> Self {
        let cameras = worlds::line_rig(3, 640);
        let folder =
            PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(".captures/bodies").join(case.name);
        if !folder.join("capture.json").exists() {
            let (world, first_frames) = (&case.world, &DELAYS);
            Recording { world, cameras: &cameras, first_frames, frames: FRAMES, noise: 0.009 }
                .write(&folder);
        }
        let capture = Arc::new(Capture::open(&folder).expect("a capture"));
        let times_s = capture.cameras.iter().map(|c| Some(c.clock.times_s.clone())).collect();
        let name = case.name.to_owned();
        let known = Known::World { case, cameras };
        Self { name, known, capture, times_s, pairs: vec![(1, 2), (0, 4), (2, 3)] }
    }

    fn film(folder: &str) -> Self {
        let capture = Arc::new(Capture::open(folder.as_ref()).expect("a capture"));
        let truth = Truth::open(folder.as_ref()).expect("readable truth").expect("truth");
        let points = points::read(&truth);
        // True times: this is about tracks, not about offsets.
        let times_s = points
            .iter()
            .map(|c| Some(c.times_s.iter().map(|t| t - capture.time_origin_s).collect()))
            .collect();
        let last = capture.cameras[0].frames.len() - 2;
        let pairs = [1, 3, 6].map(|c| (c % capture.cameras.len(), last / 2)).to_vec();
        Self { name: folder.to_owned(), known: Known::Film { points }, capture, times_s, pairs }
    }

    /// Where the point is in a camera's frame, if it is in front; and whether it is seen.
    fn place(&self, point: Point, camera: usize, frame: usize) -> Option<(Point2<f64>, bool)> {
        match (&self.known, point) {
            (Known::World { case, cameras }, Point::Surface(surface)) => {
                let time = DELAYS[camera] + frame as f64;
                let p = case.world.position(&surface, &cameras[camera], time)?;
                Some((p, case.world.is_seen(&surface, &cameras[camera], time)))
            }
            (Known::Film { points }, Point::Numbered(n)) => {
                let point = points[camera].frames.get(frame)?.get(n)?;
                point.px.x.is_finite().then_some((point.px, point.visible))
            }
            _ => None,
        }
    }

    /// The tracks between frames k and k + 1 whose point is seen in both.
    fn tracks(&self, store: &FrameStore, camera: usize, k: usize) -> Vec<Sample> {
        let all: Vec<Sample> = match &self.known {
            Known::World { case, cameras } => temporal_flow(store, camera, k)
                .expect("tracks")
                .into_iter()
                .filter_map(|track| {
                    let (frame, p) = start(&track, k);
                    let time = DELAYS[camera] + frame as f64;
                    let surface = case.world.seen(&cameras[camera], &p, time)?;
                    Some(Sample { track, point: Point::Surface(surface) })
                })
                .collect(),
            Known::Film { points } => {
                let seen: Vec<(usize, Point2<f64>)> = points[camera].frames[k]
                    .iter()
                    .enumerate()
                    .filter(|(_, p)| p.visible)
                    .map(|(n, p)| (n, p.px))
                    .collect();
                let key = |p: &Point2<f64>| (p.x.to_bits(), p.y.to_bits());
                let numbers: HashMap<_, _> = seen.iter().map(|(n, p)| (key(p), *n)).collect();
                let starts: Vec<_> = seen.iter().map(|(_, p)| *p).collect();
                temporal_flow_of(store, camera, k, [&starts, &[]])
                    .expect("tracks")
                    .into_iter()
                    .map(|track| {
                        let point = Point::Numbered(numbers[&key(&track.earlier)]);
                        Sample { track, point }
                    })
                    .collect()
            }
        };
        all.into_iter()
            .filter(|s| {
                [k, k + 1].iter().all(|&f| self.place(s.point, camera, f).is_some_and(|p| p.1))
            })
            .collect()
    }

    /// Of a film's points that are seen in both frames: whether each moves over so many pixels.
    fn visible(&self, camera: usize, k: usize, over_px: f64) -> Vec<bool> {
        let Known::Film { points } = &self.known else { return Vec::new() };
        let frames = &points[camera].frames;
        let both = frames[k].iter().zip(&frames[k + 1]).filter(|(a, b)| a.visible && b.visible);
        both.map(|(a, b)| (b.px - a.px).norm() > over_px).collect()
    }

    fn error(&self, sample: &Sample, camera: usize, k: usize) -> f64 {
        let (frame, _) = start(&sample.track, k);
        let (other, found) =
            if frame == k { (k + 1, sample.track.later) } else { (k, sample.track.earlier) };
        self.place(sample.point, camera, other).map_or(f64::NAN, |(p, _)| (p - found).norm())
    }

    fn motion(&self, sample: &Sample, camera: usize, k: usize) -> f64 {
        let at = |frame| self.place(sample.point, camera, frame).map(|(p, _)| p);
        at(k).zip(at(k + 1)).map_or(0.0, |(a, b)| (b - a).norm())
    }

    /// How far the track's trajectory is off the epipolar line of its point's true position, in the
    /// reference camera that tests it.
    fn across(&self, sample: &Sample, camera: usize, k: usize) -> Option<f64> {
        let times = self.times_s[camera].as_ref()?;
        let interval = [times[k], times[k + 1]];
        let backward = sample.track.direction == FlowDirection::Backward;
        let time_s = if backward { interval[0] } else { interval[1] };
        let query = ReferenceQuery { camera, interval_s: interval, time_s };
        let references = select_references(&self.capture, &self.times_s, &query);
        let reference = references.first.first()?;
        let [own, other] = [camera, reference.camera].map(|c| &self.capture.cameras[c].camera);
        let trajectory = sample.track.trajectory(FrameTimes::global(times), k)?;
        let at = own.model.ideal_from_pixel(&trajectory.at(reference.time_s))?;
        let line = EpipolarGeometry::new(own, other)?.line_in_j(&at)?;
        let (p, _) = self.place(sample.point, reference.camera, reference.frame)?;
        Some(line.distance(&other.model.ideal_from_pixel(&p)?).abs())
    }
}

/// The frame in which a track's own position is exact, and that position.
fn start(track: &Track, k: usize) -> (usize, Point2<f64>) {
    if track.direction == FlowDirection::Backward {
        (k + 1, track.later)
    } else {
        (k, track.earlier)
    }
}

fn percent(count: usize, of: usize) -> f64 {
    if of == 0 { f64::NAN } else { 100.0 * count as f64 / of as f64 }
}

/// Number, median, and the fractions within 0.1 and 1 pixel.
fn row(errors: &[f64]) -> String {
    let mut sorted = errors.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |q: f64| sorted.get((q * (sorted.len() as f64 - 1.0)) as usize).copied();
    let within = |b: f64| percent(sorted.iter().filter(|e| **e <= b).count(), sorted.len());
    let or_nan = |v: Option<f64>| v.unwrap_or(f64::NAN);
    format!(
        "{:6} {:.3} {:.3} {:5.1}% {:5.1}%",
        sorted.len(),
        or_nan(at(0.5)),
        or_nan(at(0.99)),
        within(0.1),
        within(1.0)
    )
}

/// The same track with an error of 3 to 20 px, in any direction, at the end that was looked for.
fn made_wrong(sample: &Sample, random: &mut Random) -> Sample {
    let (angle, size) = (std::f64::consts::TAU * random.unit(), 3.0 + 17.0 * random.unit());
    let error = size * Vector2::new(angle.cos(), angle.sin());
    let mut wrong = sample.clone();
    if wrong.track.direction == FlowDirection::Backward {
        wrong.track.earlier += error;
    } else {
        wrong.track.later += error;
    }
    (wrong.track.before, wrong.track.after) = (None, None);
    wrong
}

#[derive(Default)]
struct Counts {
    before: Vec<f64>,
    after: Vec<f64>,
    moving: Vec<f64>,
    moving_after: Vec<f64>,
    /// Of a film's points, and of those with large motion: seen in both frames, followed to 1 px.
    visible: [usize; 2],
    followed: [usize; 2],
    untestable: usize,
    /// Of right tracks: all, and those that the test rejects.
    right: [usize; 2],
    /// Of tracks off the line by over ε + 1 px: all, rejected, untestable. As they come, and made.
    across: [usize; 3],
    made: [usize; 3],
    /// Of tracks wrong by over 3 px, before any check: all, and what stops them.
    wrong: usize,
    by_forward_backward: usize,
    by_residual: usize,
    by_consensus: usize,
    by_test: usize,
    together: usize,
}

/// A pair of frames to score: k and k + 1 of a camera.
struct Scoring<'a> {
    scene: &'a Scene,
    options: &'a RegistrationOptions,
    store: FrameStore,
    camera: usize,
    k: usize,
}

fn score(scene: &Scene, options: &RegistrationOptions) -> Counts {
    let mut counts = Counts::default();
    for &(camera, k) in &scene.pairs {
        let store = FrameStore::new(scene.capture.clone(), options);
        let scoring = Scoring { scene, options, store, camera, k };
        let samples = scene.tracks(&scoring.store, camera, k);
        scoring.score_tracks(&samples, &mut counts);
        scoring.score_corrupted(samples, &mut counts);
        scoring.score_unchecked(&mut counts);
    }
    counts
}

impl Scoring<'_> {
    fn verdicts(&self, samples: &[Sample]) -> Vec<Verdict> {
        let tracks: Vec<Track> = samples.iter().map(|s| s.track.clone()).collect();
        epipolar_check(&self.store, &self.scene.times_s, self.camera, self.k, &tracks)
            .expect("verdicts")
    }

    fn error(&self, sample: &Sample) -> f64 {
        self.scene.error(sample, self.camera, self.k)
    }

    /// Whether a track is off the epipolar line by over ε + 1 px.
    fn is_off_line(&self, sample: &Sample) -> bool {
        self.scene
            .across(sample, self.camera, self.k)
            .is_some_and(|d| d > self.options.epipolar_tolerance_px + 1.0)
    }

    /// The tracks as registration gives them, before and after the epipolar test.
    fn score_tracks(&self, samples: &[Sample], counts: &mut Counts) {
        let visible = self.scene.visible(self.camera, self.k, LARGE_PX);
        counts.visible[0] += visible.len();
        counts.visible[1] += visible.iter().filter(|large| **large).count();
        for (sample, verdict) in samples.iter().zip(self.verdicts(samples)) {
            let error = self.error(sample);
            let accepted = verdict != Verdict::Rejected;
            let moved_px = self.scene.motion(sample, self.camera, self.k);
            let moving = moved_px > 0.5;
            if error <= 1.0 {
                counts.followed[0] += 1;
                counts.followed[1] += usize::from(moved_px > LARGE_PX);
            }
            counts.before.push(error);
            counts.after.extend(accepted.then_some(error));
            counts.moving.extend(moving.then_some(error));
            counts.moving_after.extend((moving && accepted).then_some(error));
            counts.untestable += usize::from(verdict == Verdict::Untestable);
            if error <= 1.0 {
                counts.right[0] += 1;
                counts.right[1] += usize::from(!accepted);
            }
        }
    }

    /// Every right track, made wrong once, a tenth of them at a time.
    fn score_corrupted(&self, samples: Vec<Sample>, counts: &mut Counts) {
        let right: Vec<Sample> = samples.into_iter().filter(|s| self.error(s) < 1.0).collect();
        let mut random = Random::new(5);
        for turn in 0..10 {
            let given: Vec<Sample> = (0..right.len())
                .map(|n| match n % 10 == turn {
                    true => made_wrong(&right[n], &mut random),
                    false => right[n].clone(),
                })
                .collect();
            for (n, (sample, verdict)) in given.iter().zip(self.verdicts(&given)).enumerate() {
                if n % 10 == turn && self.is_off_line(sample) {
                    count(&mut counts.made, verdict);
                }
            }
        }
    }

    /// Tracks without any check, and which check stops the wrong ones.
    fn score_unchecked(&self, counts: &mut Counts) {
        let unchecked = RegistrationOptions { consistency_checks: false, ..self.options.clone() };
        let raw_store = FrameStore::new(self.scene.capture.clone(), &unchecked);
        let raw = self.scene.tracks(&raw_store, self.camera, self.k);
        let tracks: Vec<Track> = raw.iter().map(|s| s.track.clone()).collect();
        let consensus = neighbor_consensus(&tracks, self.options);
        let thresholds = self.options.consistency();
        for ((sample, verdict), agrees) in raw.iter().zip(self.verdicts(&raw)).zip(consensus) {
            if self.is_off_line(sample) {
                count(&mut counts.across, verdict);
            }
            if !(self.error(sample) > 3.0) {
                continue;
            }
            let stops = [
                sample.track.forward_backward_error_px > thresholds.forward_backward_error_px,
                sample.track.residual > thresholds.residual,
                !agrees,
                verdict == Verdict::Rejected,
            ];
            counts.wrong += 1;
            counts.by_forward_backward += usize::from(stops[0]);
            counts.by_residual += usize::from(stops[1]);
            counts.by_consensus += usize::from(stops[2]);
            counts.by_test += usize::from(stops[3]);
            counts.together += usize::from(stops.contains(&true));
        }
    }
}

/// Adds a verdict to all, rejected, untestable.
fn count(counts: &mut [usize; 3], verdict: Verdict) {
    counts[0] += 1;
    counts[1] += usize::from(verdict == Verdict::Rejected);
    counts[2] += usize::from(verdict == Verdict::Untestable);
}

/// Prints the gains of each camera, and their largest change over its recording. The cameras' clocks are taken as one clock.
fn print_gains(folder: &str) {
    let capture = Arc::new(Capture::open(folder.as_ref()).expect("a capture"));
    let field = LightField::new(capture.clone(), Offsets::known(&capture));
    let gains = field.gains(&RegistrationOptions::default());
    println!("{folder}");
    for ((camera, [r, g, b]), curve) in
        capture.cameras.iter().zip(&gains.factors).zip(&gains.curves)
    {
        let change = 100.0 * curve.largest_change();
        println!("  {:<8} {r:.3} {g:.3} {b:.3}, changes by {change:.1} %", camera.id);
    }
}

fn main() {
    let folders: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if std::env::args().any(|argument| argument == "--gains") {
        return folders.iter().for_each(|folder| print_gains(folder));
    }
    let scenes: Vec<Scene> = if folders.is_empty() {
        worlds::cases().into_iter().map(Scene::world).collect()
    } else {
        folders.iter().map(|f| Scene::film(f)).collect()
    };
    let options = RegistrationOptions::default();
    println!("errors: number, median, 99 % [px], within 0.1 px, within 1 px");
    for scene in &scenes {
        let c = score(scene, &options);
        println!("{}", scene.name);
        println!("  all, before the epipolar test    {}", row(&c.before));
        println!("  all, after                       {}", row(&c.after));
        println!("  moving, before                   {}", row(&c.moving));
        println!("  moving, after                    {}", row(&c.moving_after));
        for (name, k) in [("points", 0), ("that move over 20 px", 1)] {
            if c.visible[k] > 0 {
                let followed = percent(c.followed[k], c.visible[k]);
                println!(
                    "  {name}, seen in both: {}, followed to 1 px {followed:.1}%",
                    c.visible[k]
                );
            }
        }
        println!(
            "  untestable                       {:.1}%",
            percent(c.untestable, c.before.len())
        );
        println!(
            "  right ones rejected              {:.2}% of {}",
            percent(c.right[1], c.right[0]),
            c.right[0]
        );
        for (name, [all, rejected, untestable]) in [("as they come", c.across), ("made", c.made)] {
            println!(
                "  off the line by over ε + 1 px, {name}: {all}, rejected {:.1}%, untestable {:.1}%, of the testable rejected {:.1}%",
                percent(rejected, all),
                percent(untestable, all),
                percent(rejected, all - untestable)
            );
        }
        println!(
            "  wrong by over 3 px, unchecked: {}; stopped by forward-backward error {:.0}%, residual {:.0}%, neighbours {:.0}%, epipolar test {:.0}%, together {:.1}%",
            c.wrong,
            percent(c.by_forward_backward, c.wrong),
            percent(c.by_residual, c.wrong),
            percent(c.by_consensus, c.wrong),
            percent(c.by_test, c.wrong),
            percent(c.together, c.wrong)
        );
    }
}
