//! Figs. 19 to 22: the offset of a pair, frame by frame, by the paper's estimator, by Zhou and
//! Tao's, and by the best rung's.

use super::scene::{self, Film};
use super::{median, save};
use nalgebra::Point2;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::{Capture, Truth};
use stlfr::chart::{Chart, Series, svg};
use stlfr::offset::{
    FourPoints, Observation, Residuals, ThreeFrames, cross_ratio_offset, ransac,
    weighted_least_squares,
};
use stlfr::registration::{FrameStore, RegistrationOptions, Track, flow, temporal_flow};

const NAMES: [&str; 4] = ["the paper's", "Zhou and Tao", "mixture, straight", "mixture, curved"];
const TOLERANCE: f64 = 0.05;
const GAMMA: f64 = 70.0;
const MIN_INLIERS: usize = 12;

type Failure = Box<dyn std::error::Error>;

/// `t̃` of one pair of a camera's frames against the other's, by each estimator, in frames.
fn at_frame(
    frames: &FrameStore,
    [i, j]: [usize; 2],
    k: usize,
    m: usize,
) -> Result<[Option<f64>; 4], Failure> {
    let cameras = &frames.capture().cameras;
    let (times_i, times_j) = (&cameras[i].clock.times_s, &cameras[j].clock.times_s);
    let interval = times_i[k + 1] - times_i[k];
    let tracks = temporal_flow(frames, i, k)?;
    let tracks: Vec<&Track> = tracks.iter().filter(|t| t.in_forward_set()).collect();
    let (source, target) = (frames.get(i, k)?, frames.get(j, m)?);
    let starts: Vec<_> = tracks.iter().map(|t| (t.earlier, t.earlier + 0.5 * t.motion())).collect();
    let in_j: Vec<Option<Point2<f64>>> = flow(&source, &target, &starts, frames.options())
        .into_iter()
        .map(|f| f.map(|f| f.target))
        .collect();
    let candidates = |curved| {
        let three = ThreeFrames {
            camera_i: &cameras[i].camera,
            camera_j: &cameras[j].camera,
            times_i,
            index_i: k,
            curved,
            min_across_px: 1.0,
        };
        three.candidates(&tracks, &in_j)
    };
    let straight: Vec<f64> = candidates(false).iter().map(|c| c.time_s / interval).collect();
    // The fourth point: where the features of j go in its next frame.
    let mut four = Vec::new();
    if m + 1 < times_j.len() {
        let next = frames.get(j, m + 1)?;
        let frame_j = times_j[m + 1] - times_j[m];
        let found: Vec<(usize, Point2<f64>)> =
            in_j.iter().enumerate().filter_map(|(n, p)| Some((n, (*p)?))).collect();
        let starts: Vec<_> = found.iter().map(|(n, p)| (*p, p + tracks[*n].motion())).collect();
        let ends = flow(&target, &next, &starts, frames.options());
        for ((n, p), end) in found.iter().zip(ends) {
            let Some(end) = end else { continue };
            if tracks[*n].motion().norm() < 1.0 {
                continue;
            }
            let points =
                FourPoints { in_i: [tracks[*n].earlier, tracks[*n].later], in_j: [*p, end.target] };
            let pair = [&cameras[i].camera, &cameras[j].camera];
            four.extend(
                cross_ratio_offset(pair, &points, [interval, frame_j]).map(|t| t / interval),
            );
        }
    }
    Ok([
        both(straight),
        both(four),
        mixture(&candidates(false), interval),
        mixture(&candidates(true), interval),
    ])
}

/// RANSAC and WLS, on times in frames.
fn both(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let inliers = ransac(&values, TOLERANCE);
    (inliers.len() >= MIN_INLIERS).then(|| weighted_least_squares(&values[inliers], GAMMA))?
}

fn mixture(candidates: &[stlfr::offset::Candidate], interval: f64) -> Option<f64> {
    let observations: Vec<Observation> = candidates
        .iter()
        .map(|c| Observation { value_s: c.time_s, at_s: 0.0, across_px_s: c.certain_px_s() })
        .collect();
    let residuals = Residuals { start_px: 0.5, min_px: 0.01, max_px: 2.0, range_s: 3.0 * interval };
    let found = residuals.fit(&observations, residuals.start(&observations)?.0, false)?;
    (found.inliers >= MIN_INLIERS as f64).then_some(found.value_s / interval)
}

/// One figure: the pair's offset at every frame of camera i, the frame of j being the one that lies
/// between by the truth, as the paper finds it by searching frames ahead.
fn figure(
    title: &str,
    capture: &Arc<Capture>,
    pair: [usize; 2],
    truth: &dyn Fn(usize, usize) -> f64,
) -> Result<Chart, Failure> {
    let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let [i, j] = pair;
    let times_i = &capture.cameras[i].clock.times_s;
    let mut series: Vec<Series> = NAMES
        .iter()
        .map(|n| Series { label: (*n).into(), line: true, dots: true, ..Series::default() })
        .collect();
    let mut true_line = Series { label: "truth".into(), line: true, ..Series::default() };
    let mut errors: [Vec<f64>; 4] = Default::default();
    let mut missing = [0; 4];
    for k in 0..times_i.len() - 1 {
        let images = 0..capture.cameras[j].clock.times_s.len();
        let Some(m) = images.clone().find(|&m| (0.0..1.0).contains(&truth(k, m))) else { continue };
        true_line.points.push((k as f64, truth(k, m)).into());
        for (n, found) in at_frame(&frames, pair, k, m)?.into_iter().enumerate() {
            match found {
                Some(t) => {
                    series[n].points.push((k as f64, t).into());
                    errors[n].push((t - truth(k, m)).abs());
                }
                None => missing[n] += 1,
            }
        }
    }
    println!("{title}");
    for (n, name) in NAMES.iter().enumerate() {
        println!(
            "  {name:18} |error| median {:.4} worst {:.4} frame, none at {} frames",
            median(&errors[n]),
            errors[n].iter().copied().fold(0.0, f64::max),
            missing[n]
        );
    }
    series.push(true_line);
    Ok(Chart {
        title: title.into(),
        x_label: "frame".into(),
        y_label: "offset, frames".into(),
        y_shows: Some((0.0, 1.0)),
        series,
        ..Chart::default()
    })
}

/// The offset of camera j's frame m after camera i's frame k, in frames, for a film of boards.
fn of_boards(film: &Film, offset_frames: f64) -> impl Fn(usize, usize) -> f64 + use<> {
    let lost = film.lost.clone();
    move |k, m| {
        let number = |c: usize, image: usize| {
            (0..).filter(|n| !lost[c].contains(n)).nth(image).unwrap_or(0) as f64
        };
        number(1, m) + offset_frames - number(0, k)
    }
}

pub fn run(folders: &[String], output: &Path) -> Result<(), Failure> {
    let mut charts = Vec::new();
    let mut boards =
        |title: &str, boards, offset: f64, frames, lost: Vec<usize>| -> Result<(), Failure> {
            let mut film = Film::new(boards, &[0.0, offset], frames);
            film.size = [640, 480];
            film.lost[1] = lost;
            let folder = tempfile::tempdir()?;
            film.write(folder.path())?;
            let capture = Arc::new(Capture::open(folder.path())?);
            charts.push(figure(title, &capture, [0, 1], &of_boards(&film, offset))?);
            Ok(())
        };
    boards(
        "Fig. 20: a rectangle, 0.5 frame, analytic",
        scene::rectangle([0.25, 0.5]),
        0.5,
        31,
        Vec::new(),
    )?;
    boards(
        "Fig. 21: the same, the sixth frame lost",
        scene::rectangle([0.25, 0.5]),
        0.5,
        9,
        vec![6],
    )?;
    boards(
        "Fig. 22: a turning magazine, analytic",
        scene::rotating_magazine(),
        0.3,
        31,
        Vec::new(),
    )?;
    for folder in folders {
        charts.extend(filmed(Path::new(folder))?);
    }
    save(output, "figs19-22.svg", &svg(&charts, 2))
}

/// Of a filmed capture: the neighbours whose offset is nearest to 0.3 and to 0.5 frame, and the
/// latter with a frame lost without a trace.
fn filmed(folder: &Path) -> Result<Vec<Chart>, Failure> {
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
    for (wanted, loses) in [(0.3, false), (0.5, false), (0.5, true)] {
        let Some([i, j]) = nearest(wanted) else { continue };
        let shutter = |c: usize| truth.shutter_s(&capture.cameras[c].id).map(<[f64]>::to_vec);
        let Some((of_i, mut of_j)) = shutter(i).zip(shutter(j)) else { continue };
        let mut part = (*capture).clone();
        let lost = of_j.len() / 2;
        if loses {
            of_j.remove(lost);
            part.cameras[j].frames.remove(lost);
            // Its clock goes on as if nothing had happened.
            part.cameras[j].clock.times_s.pop();
        }
        let title = format!(
            "{}: {} and {}{}",
            capture.name,
            capture.cameras[i].id,
            capture.cameras[j].id,
            if loses { format!(", frame {lost} lost") } else { String::new() }
        );
        let by_shutter = move |k: usize, m: usize| {
            let interval = if k + 1 < of_i.len() { of_i[k + 1] - of_i[k] } else { frame_s };
            (of_j[m] - of_i[k]) / interval
        };
        charts.push(figure(&title, &Arc::new(part), [i, j], &by_shutter)?);
    }
    Ok(charts)
}
