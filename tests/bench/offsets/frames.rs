//! Figs. 19 to 22: the offset of a pair, frame by frame. The estimators are the paper's and Zhou and
//! Tao's, from the three or four frames that they need, and the default method, from the neighbouring
//! frames and from the whole recording.
//!
//! `frames CAPTURE ROTATING`: of CAPTURE, the neighbours whose offset is nearest to 0.3 frame (Fig. 19),
//! to 0.5 (20), and the latter with a frame lost without a trace (21); of ROTATING, in which all motion
//! runs along the epipolar lines at one instant, those nearest to 0.3 (22). Without captures, synthetic
//! ones.

use super::captures::by_default;
use super::scene::{self, SyntheticCapture};
use super::zhou_tao::{FourPoints, cross_ratio_offset};
use super::{median, save};
use nalgebra::Point2;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::{Capture, FrameTimes, Truth};
use stlfr::chart::{Chart, ChartPoint, Series};
use stlfr::offset::{ThreeFrames, ransac, weighted_least_squares};
use stlfr::registration::{FrameStore, RegistrationOptions, Track, flow, temporal_flow};

const NAMES: [&str; 4] =
    ["the paper's", "Zhou and Tao", "default, neighbouring frames", "default, whole recording"];
/// RANSAC's tolerance, frames.
const TOLERANCE: f64 = 0.05;
/// γ of eq. (12), times Δt.
const GAMMA: f64 = 70.0;
/// Inliers that an estimate needs.
const MIN_INLIERS: usize = 12;
/// The motion that a feature needs, in any direction, pixels: static ones have no candidate.
const MIN_MOTION_PX: f64 = 1.0;

type Failure = Box<dyn std::error::Error>;

/// `t̃` and its standard error, in frames; the latter is NaN where the estimator gives none.
type FrameOffset = Option<[f64; 2]>;

/// `t̃` of frames k and k + 1 of camera i and frame m of camera j, by the paper's estimator and by Zhou
/// and Tao's.
fn frame_offsets(
    frames: &FrameStore,
    [i, j]: [usize; 2],
    [k, m]: [usize; 2],
) -> Result<[FrameOffset; 2], Failure> {
    let cameras = &frames.capture().cameras;
    let (times_i, times_j) = (&cameras[i].clock.times_s, &cameras[j].clock.times_s);
    let interval = times_i[k + 1] - times_i[k];
    let tracks = temporal_flow(frames, i, k)?;
    let moves = |t: &&Track| t.in_forward_set() && t.motion().norm() >= MIN_MOTION_PX;
    let tracks: Vec<&Track> = tracks.iter().filter(moves).collect();
    let (source, target) = (frames.get(i, k)?, frames.get(j, m)?);
    let starts: Vec<_> = tracks.iter().map(|t| (t.earlier, t.earlier + 0.5 * t.motion())).collect();
    let in_j: Vec<Option<Point2<f64>>> = flow(&source, &target, &starts, frames.options())
        .into_iter()
        .map(|f| f.map(|f| f.target))
        .collect();
    let three = ThreeFrames {
        camera_i: &cameras[i].camera,
        camera_j: &cameras[j].camera,
        times_i: FrameTimes::global(times_i),
        index_i: k,
        curved: false,
        min_across_px: 0.0,
    };
    let straight = three.candidates(&tracks, &in_j).iter().map(|c| c.time_s / interval).collect();
    let four = if m + 1 < times_j.len() {
        four_point_candidates(frames, [i, j], [k, m], &tracks, &in_j)?
    } else {
        Vec::new()
    };
    Ok([ransac_and_wls(straight), ransac_and_wls(four)].map(|t| Some([t?, f64::NAN])))
}

/// Zhou and Tao's candidates, in frames; the fourth point is the feature's in camera j's next frame.
fn four_point_candidates(
    frames: &FrameStore,
    [i, j]: [usize; 2],
    [k, m]: [usize; 2],
    tracks: &[&Track],
    in_j: &[Option<Point2<f64>>],
) -> Result<Vec<f64>, Failure> {
    let cameras = &frames.capture().cameras;
    let (times_i, times_j) = (&cameras[i].clock.times_s, &cameras[j].clock.times_s);
    let interval = times_i[k + 1] - times_i[k];
    let frame_j = times_j[m + 1] - times_j[m];
    let (target, next) = (frames.get(j, m)?, frames.get(j, m + 1)?);
    let corresponding: Vec<(usize, Point2<f64>)> =
        in_j.iter().enumerate().filter_map(|(n, p)| Some((n, (*p)?))).collect();
    let starts: Vec<_> = corresponding.iter().map(|(n, p)| (*p, p + tracks[*n].motion())).collect();
    let ends = flow(&target, &next, &starts, frames.options());
    let mut candidates = Vec::new();
    for ((n, p), end) in corresponding.iter().zip(ends) {
        let Some(end) = end else { continue };
        let points =
            FourPoints { in_i: [tracks[*n].earlier, tracks[*n].later], in_j: [*p, end.target] };
        let pair = [&cameras[i].camera, &cameras[j].camera];
        candidates
            .extend(cross_ratio_offset(pair, &points, [interval, frame_j]).map(|t| t / interval));
    }
    Ok(candidates)
}

/// The paper's consensus of candidates, in frames; `None` for too few inliers.
fn ransac_and_wls(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let inliers = ransac(&values, TOLERANCE);
    (inliers.len() >= MIN_INLIERS).then(|| weighted_least_squares(&values[inliers], GAMMA))?
}

/// The second camera's clock by the default method from a range of images of each camera, or the reason
/// why it is unknown.
fn default_method(
    capture: &Capture,
    pair: [usize; 2],
    images: [Range<usize>; 2],
) -> Result<Result<SecondClock, String>, Failure> {
    let mut part = capture.clone();
    part.cameras = pair.map(|c| capture.cameras[c].clone()).into();
    part.reference = 0;
    for (camera, images) in part.cameras.iter_mut().zip(images.clone()) {
        camera.frames = camera.frames[images.clone()].to_vec();
        camera.clock.times_s = camera.clock.times_s[images].to_vec();
    }
    let estimate = by_default(&Arc::new(part))?;
    let camera = &estimate.offsets.cameras[1];
    let Some((offset_s, std_err_s)) = camera.offset_s.zip(camera.std_err_s) else {
        return Ok(Err(camera.reason.clone().unwrap_or_default()));
    };
    let lost_before = camera.lost_before.clone().unwrap_or_default();
    let missing =
        |m: usize| lost_before.iter().filter(|&&n| n + images[1].start <= m).count() as f64;
    let frame_s = capture.frame_s();
    let times_s = capture.cameras[pair[1]].clock.times_s.iter().enumerate();
    let times_s = times_s.map(|(m, t)| t + offset_s + frame_s * missing(m)).collect();
    Ok(Ok(SecondClock { times_s, std_err_s, lost_before }))
}

/// The estimated clock of a pair's second camera.
struct SecondClock {
    /// The times of all its images on the first camera's clock.
    times_s: Vec<f64>,
    std_err_s: f64,
    /// Numbered within the range of images.
    lost_before: Vec<usize>,
}

/// The range of `image` and the `after` following ones, with one more on either side.
fn neighbouring(image: usize, after: usize, count: usize) -> Range<usize> {
    image.saturating_sub(1)..(image + after + 2).min(count)
}

/// The estimates and the truth, frame by frame.
struct Figure {
    series: [Series; 4],
    truth: Series,
    /// By estimator and frame: |error| in frames and in standard errors, and the standard error.
    errors: [Vec<[f64; 3]>; 4],
    /// By estimator: the frames without an estimate.
    missing: [Vec<usize>; 4],
}

impl Figure {
    fn new() -> Self {
        let series = |name: &str| Series { label: name.into(), dots: true, ..Series::default() };
        let series = NAMES.map(series);
        let truth = Series { label: "truth".into(), line: true, faint: true, ..Series::default() };
        Self { series, truth, errors: Default::default(), missing: Default::default() }
    }

    fn add(&mut self, k: usize, truth: f64, offsets: [FrameOffset; 4]) {
        self.truth.points.push((k as f64, truth).into());
        for (n, offset) in offsets.into_iter().enumerate() {
            let Some([t, std_err]) = offset else {
                self.missing[n].push(k);
                continue;
            };
            let bar = if std_err.is_finite() { 2.0 * std_err } else { 0.0 };
            // The four estimators side by side.
            let x = k as f64 + 0.12 * (n as f64 - 1.5);
            self.series[n].points.push(ChartPoint { x, y: t, bar, x_range: None });
            let error = (t - truth).abs();
            self.errors[n].push([error, error / std_err, std_err]);
        }
    }

    fn print(&self) {
        for (n, name) in NAMES.iter().enumerate() {
            let of = |k: usize| self.errors[n].iter().map(|e| e[k]).collect::<Vec<f64>>();
            let max = |k: usize| of(k).into_iter().fold(0.0, f64::max);
            print!("  {name:20} |error| median {:.4} worst {:.4} frame", median(&of(0)), max(0));
            if n > 1 {
                print!(
                    ", standard error {:.4} to {:.4}",
                    of(2).into_iter().fold(1.0, f64::min),
                    max(2)
                );
                print!(", |z| up to {:.1}", max(1));
            }
            println!(", none at frames {:?}", self.missing[n]);
        }
    }
}

/// One figure: the pair's offset at every frame of camera i. The frame of camera j is the one that lies
/// between by the truth, which the paper finds by searching frames ahead.
fn figure(
    title: &str,
    capture: &Arc<Capture>,
    [i, j]: [usize; 2],
    truth: &dyn Fn(usize, usize) -> f64,
) -> Result<Chart, Failure> {
    println!("{title}");
    let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let times_i = &capture.cameras[i].clock.times_s;
    let counts = [i, j].map(|c| capture.cameras[c].clock.times_s.len());
    let of_recording = default_method(capture, [i, j], counts.map(|n| 0..n))?;
    match &of_recording {
        Ok(clock) => println!("  whole recording: lost before {:?}", clock.lost_before),
        Err(reason) => println!("  whole recording: unknown: {reason}"),
    }
    let mut figure = Figure::new();
    for k in 0..times_i.len() - 1 {
        let Some(m) = (0..counts[1]).find(|&m| (0.0..1.0).contains(&truth(k, m))) else { continue };
        let images = [neighbouring(k, 1, counts[0]), neighbouring(m, 0, counts[1])];
        // No search for lost frames in a few frames.
        let mut stamped = (**capture).clone();
        stamped.cameras[j].clock.lost = false;
        let of_neighbours = default_method(&stamped, [i, j], images)?;
        let interval = times_i[k + 1] - times_i[k];
        let at = |clock: &SecondClock| {
            [(clock.times_s[m] - times_i[k]) / interval, clock.std_err_s / interval]
        };
        if let Err(reason) = &of_neighbours {
            println!("  frame {k}: {reason}");
        }
        let [paper, four_point] = frame_offsets(&frames, [i, j], [k, m])?;
        let [near, all] = [&of_neighbours, &of_recording].map(|o| o.as_ref().ok().map(at));
        figure.add(k, truth(k, m), [paper, four_point, near, all]);
    }
    figure.print();
    let Figure { series, truth, .. } = figure;
    Ok(Chart {
        title: title.into(),
        x_label: "frame".into(),
        y_label: "offset, frames; bars are 2 standard errors".into(),
        y_shows: Some((0.0, 1.0)),
        series: series.into_iter().chain([truth]).collect(),
        ..Chart::default()
    })
}

/// The true `t̃` of camera j's image m after camera i's image k of a synthetic pair, in frames.
fn synthetic_truth(
    synthetic: &SyntheticCapture,
    offset_frames: f64,
) -> impl Fn(usize, usize) -> f64 + use<> {
    let lost = synthetic.lost.clone();
    move |k, m| {
        let number = |c: usize, image: usize| {
            (0..).filter(|n| !lost[c].contains(n)).nth(image).unwrap_or(0) as f64
        };
        number(1, m) + offset_frames - number(0, k)
    }
}

pub fn run(folders: &[String], output: &Path) -> Result<(), Failure> {
    let charts = match folders {
        [] => synthetic_figures()?,
        [capture, rotating] => {
            let mut charts = recorded_figures(
                Path::new(capture),
                &[("Fig. 19", 0.3, false), ("Fig. 20", 0.5, false), ("Fig. 21", 0.5, true)],
            )?;
            charts.extend(recorded_figures(Path::new(rotating), &[("Fig. 22", 0.3, false)])?);
            charts
        }
        _ => return Err("takes two captures, or none".into()),
    };
    save(output, "figs19-22", &charts)
}

fn synthetic_figures() -> Result<Vec<Chart>, Failure> {
    let chart = |title: &str, boards, offset: f64, frames, lost: Vec<usize>| {
        let mut synthetic = SyntheticCapture::new(boards, &[0.0, offset], frames);
        synthetic.size = [640, 480];
        synthetic.lost[1] = lost;
        let folder = tempfile::tempdir()?;
        synthetic.write(folder.path())?;
        let capture = Arc::new(Capture::open(folder.path())?);
        figure(title, &capture, [0, 1], &synthetic_truth(&synthetic, offset))
    };
    let rectangle = || scene::rectangle([0.25, 0.5]);
    Ok(vec![
        chart("Fig. 20: a rectangle, analytic", rectangle(), 0.5, 31, Vec::new())?,
        chart("Fig. 21: the same, the sixth frame lost", rectangle(), 0.5, 9, vec![6])?,
        chart("Fig. 22: a magazine, analytic", scene::rotating_magazine(), 0.3, 31, Vec::new())?,
    ])
}

/// Figures of a recorded capture: for each, its name, the offset in frames that its pair of neighbours
/// comes nearest to, and whether a frame in the middle of the recording is lost.
fn recorded_figures(folder: &Path, figures: &[(&str, f64, bool)]) -> Result<Vec<Chart>, Failure> {
    let capture = Arc::new(Capture::open(folder)?);
    let truth = Truth::open(folder)?.ok_or("has no truth")?;
    let frame_s = capture.frame_s();
    let offset = |i: usize| truth.offset_s(&capture.cameras[i].id).map(|s| s / frame_s);
    let nearest = |wanted: f64| {
        let away = |i: usize| Some(((offset(i + 1)? - offset(i)?).rem_euclid(1.0) - wanted).abs());
        let pairs = (0..capture.cameras.len() - 1).filter_map(|i| Some((i, away(i)?)));
        pairs.min_by(|x, y| x.1.total_cmp(&y.1)).map(|(i, _)| [i, i + 1])
    };
    let mut charts = Vec::new();
    for &(name, wanted, loses) in figures {
        let [i, j] = nearest(wanted).ok_or("the truth lacks cameras")?;
        let shutter = |c: usize| {
            let found = truth.shutter.iter().find(|s| s.id == capture.cameras[c].id);
            found.map(|s| s.times_s.clone())
        };
        let both = shutter(i).zip(shutter(j));
        let (shutter_i_s, mut shutter_j_s) = both.ok_or("the truth lacks shutter times")?;
        let mut part = (*capture).clone();
        let mut title = format!("{name}: {}, {wanted} frame", capture.name);
        if loses {
            let lost = shutter_j_s.len() / 2;
            shutter_j_s.remove(lost);
            let camera = &mut part.cameras[j];
            camera.frames.remove(lost);
            // Its time stamps continue without a gap.
            camera.clock.times_s.pop();
            camera.clock.lost = true;
            title += &format!(", image {lost} lost");
        }
        let by_shutter = move |k: usize, m: usize| {
            let interval = if k + 1 < shutter_i_s.len() {
                shutter_i_s[k + 1] - shutter_i_s[k]
            } else {
                frame_s
            };
            (shutter_j_s[m] - shutter_i_s[k]) / interval
        };
        charts.push(figure(&title, &Arc::new(part), [i, j], &by_shutter)?);
    }
    Ok(charts)
}
