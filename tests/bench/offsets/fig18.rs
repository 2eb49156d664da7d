//! Fig. 18: simulated tracks with a growing fraction of outliers.
//!
//! 200 tracks, 10 to 20 pixels of motion in all directions, the correspondences `p_i(t+Δt)` and
//! `p_j(t')` perturbed by 0.5 px; outliers have `p_j` uniform in the image. `t̃ = 0.3 Δt`.

use super::{median, percentile, save};
use nalgebra::{Isometry3, Matrix2, Point2, Vector2};
use std::path::Path;
use stlfr::camera::{Camera, CameraModel};
use stlfr::capture::FrameTimes;
use stlfr::chart::{Chart, Series};
use stlfr::offset::{
    Candidate, Mixture, Observation, ThreeFrames, consensus_value, ransac, weighted_least_squares,
};
use stlfr::random::Random;
use stlfr::registration::{FlowDirection, Track};

/// Tracks per simulation.
const TRACKS: usize = 200;
/// The true `t̃`, in Δt.
const TRUE_FRACTION: f64 = 0.3;
/// The standard deviation of correspondences, pixels.
const NOISE_PX: f64 = 0.5;
/// Simulations per fraction of outliers.
const SEEDS: u64 = 500;
/// Image width and height, pixels.
const SIZE: [f64; 2] = [640.0, 480.0];
/// γ of eq. (12), times Δt.
const GAMMA: f64 = 70.0;
/// RANSAC's tolerance, in Δt.
const TOLERANCE: f64 = 0.05;

const NAMES: [&str; 4] =
    ["RANSAC alone", "WLS alone", "both (the paper)", "mixture by information"];

fn camera(x: f64) -> Camera {
    Camera {
        width: SIZE[0] as usize,
        height: SIZE[1] as usize,
        model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
        cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
    }
}

/// The candidates of one simulation; Δt is 1.
fn candidates(outlier_fraction: f64, random: &mut Random) -> Vec<Candidate> {
    let (i, j) = (camera(0.0), camera(0.06));
    let three = ThreeFrames {
        camera_i: &i,
        camera_j: &j,
        times_i: FrameTimes::global(&[0.0, 1.0]),
        index_i: 0,
        curved: false,
        min_across_px: 1.0,
    };
    let mut tracks = Vec::new();
    let mut in_j = Vec::new();
    for k in 0..TRACKS {
        let start = Point2::new(SIZE[0] * random.unit(), SIZE[1] * random.unit());
        let angle = std::f64::consts::TAU * random.unit();
        let motion = (10.0 + 10.0 * random.unit()) * Vector2::new(angle.cos(), angle.sin());
        let disparity = Vector2::new(10.0 + 20.0 * random.unit(), 0.0);
        let mut noise = || NOISE_PX * Vector2::new(random.gaussian(), random.gaussian());
        let later = start + motion + noise();
        let inlier = start + motion * TRUE_FRACTION - disparity + noise();
        tracks.push(Track {
            direction: FlowDirection::Forward,
            before: None,
            earlier: start,
            later,
            after: None,
            deformation: Matrix2::identity(),
            residual: 0.0,
            forward_backward_error_px: 0.0,
        });
        let is_outlier = (k as f64) < outlier_fraction * TRACKS as f64;
        let anywhere = Point2::new(SIZE[0] * random.unit(), SIZE[1] * random.unit());
        in_j.push(Some(if is_outlier { anywhere } else { inlier }));
    }
    let tracks: Vec<&Track> = tracks.iter().collect();
    three.candidates(&tracks, &in_j)
}

/// The four estimators' errors, in Δt; no estimate is an error of 1.
fn errors(candidates: &[Candidate]) -> [f64; 4] {
    let mut values: Vec<f64> = candidates.iter().map(|c| c.time_s).collect();
    values.sort_by(f64::total_cmp);
    let inliers = &values[ransac(&values, TOLERANCE)];
    let observations: Vec<Observation> = candidates
        .iter()
        .map(|c| Observation { value_s: c.time_s, at_s: 0.0, across_px_s: c.across_px_s })
        .collect();
    let mixture = consensus_value(&observations)
        .and_then(|(start, _)| Mixture::fit(&observations, 1.0, start, false));
    let estimates = [
        (!inliers.is_empty()).then(|| inliers.iter().sum::<f64>() / inliers.len() as f64),
        weighted_least_squares(&values, GAMMA),
        weighted_least_squares(inliers, GAMMA),
        mixture.map(|m| m.value_s),
    ];
    estimates.map(|t| t.map_or(1.0, |t| (t - TRUE_FRACTION).abs()))
}

pub fn run(output: &Path) -> Result<(), Box<dyn std::error::Error>> {
    println!("Fig. 18: |error| / Δt, median and 95th percentile of {SEEDS} seeds");
    println!("{:>9}  {}", "outliers", NAMES.map(|n| format!("{n:>22}")).join(" "));
    let series =
        |k: usize| Series { label: NAMES[k].into(), line: true, dots: true, ..Series::default() };
    let mut medians: Vec<Series> = (0..NAMES.len()).map(series).collect();
    let mut tails = medians.clone();
    let mut last = [0.0; 4];
    for tenth in 1..=9 {
        let fraction = 0.1 * f64::from(tenth);
        let all: Vec<[f64; 4]> = (0..SEEDS)
            .map(|seed| errors(&candidates(fraction, &mut Random::new(1000 * seed + tenth as u64))))
            .collect();
        let mut line = format!("{:>8.0}% ", 100.0 * fraction);
        for k in 0..NAMES.len() {
            let estimator_errors: Vec<f64> = all.iter().map(|e| e[k]).collect();
            let (middle, tail) = (median(&estimator_errors), percentile(&estimator_errors, 0.95));
            line += &format!(" {:>12.4} / {:>7.4}", middle, tail);
            medians[k].points.push((100.0 * fraction, middle).into());
            tails[k].points.push((100.0 * fraction, tail).into());
            last[k] = middle;
        }
        println!("{line}");
    }
    println!(
        "at 90 %: the paper's {:.1} % (at most 15 %), the mixture {:.1} % (at most 2 %)",
        100.0 * last[2],
        100.0 * last[3]
    );
    let chart = |title: &str, series: Vec<Series>| Chart {
        title: title.into(),
        x_label: "outliers, %".into(),
        y_label: "|error| / Δt".into(),
        log_y: true,
        series,
        rules: vec![(0.15, "15 %".into()), (0.02, "2 %".into())],
        ..Chart::default()
    };
    let charts =
        [chart("Fig. 18: outliers, median of 500 seeds", medians), chart("95th percentile", tails)];
    save(output, "fig18", &charts)
}
