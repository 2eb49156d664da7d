//! What an estimate was made of, drawn: beside `offsets.json`.

use super::{Estimate, PairEstimate};
use crate::capture::Capture;
use crate::chart::{Chart, ChartPoint, Series, svg};

/// Four charts: each pair's own estimate against the joint one, the share of its candidates that
/// agree, the estimates of single triples of frames over time, and the features' distances from
/// their epipolar lines by the clocks as they are and as they were found (the paper's Fig. 23).
pub fn plot(estimate: &Estimate, capture: &Capture) -> String {
    svg(
        &[
            pairs(estimate, capture),
            shares(estimate, capture),
            over_time(estimate, capture),
            distances(estimate),
        ],
        2,
    )
}

/// Milliseconds in a second.
const MS: f64 = 1e3;

/// What the joint estimate has for a pair, seconds, at a time on its first camera's clock.
fn joint_s(estimate: &Estimate, capture: &Capture, [i, j]: [usize; 2], time_s: f64) -> Option<f64> {
    let ahead = |c: usize| {
        let camera = &estimate.offsets.cameras[c];
        let since = time_s - capture.cameras[c].clock.times_s[0];
        Some(camera.offset_s? + 1e-6 * camera.rate_ppm.unwrap_or(0.0) * since)
    };
    Some(ahead(j)? - ahead(i)?)
}

fn name(capture: &Capture, [i, j]: [usize; 2]) -> String {
    format!("{}–{}", capture.cameras[i].id, capture.cameras[j].id)
}

fn pairs(estimate: &Estimate, capture: &Capture) -> Chart {
    let points = estimate.pairs.iter().enumerate().filter_map(|(k, pair)| {
        let joint = joint_s(estimate, capture, pair.cameras, pair.center_s)?;
        Some(ChartPoint {
            x: k as f64,
            y: MS * (pair.offset_s - joint),
            bar: 2.0 * MS * pair.std_err_s,
            x_range: None,
        })
    });
    let names: Vec<String> = estimate.pairs.iter().map(|p| name(capture, p.cameras)).collect();
    Chart {
        title: "Each pair alone, against all pairs together".into(),
        x_label: labelled("pair", &names),
        y_label: "difference, ms; bars are 2 standard errors".into(),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        rules: vec![(0.0, String::new())],
        ..Chart::default()
    }
}

/// An axis of numbers and, where there is room, what they stand for.
fn labelled(what: &str, names: &[String]) -> String {
    match names {
        [] => what.into(),
        [only] => format!("{what} (0: {only})"),
        [first, .., last] => format!("{what} (0: {first} … {}: {last})", names.len() - 1),
    }
}

fn shares(estimate: &Estimate, capture: &Capture) -> Chart {
    let share = |p: &PairEstimate| p.inliers as f64 / p.candidates.max(1) as f64;
    let points = estimate.pairs.iter().enumerate().map(|(k, p)| (k as f64, share(p)).into());
    let names: Vec<String> = estimate.pairs.iter().map(|p| name(capture, p.cameras)).collect();
    Chart {
        title: "Candidates that agree".into(),
        x_label: labelled("pair", &names),
        y_label: "share".into(),
        y_shows: Some((0.0, 1.0)),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        ..Chart::default()
    }
}

fn over_time(estimate: &Estimate, capture: &Capture) -> Chart {
    let mut series = [
        Series { label: "RANSAC and WLS (the paper's)".into(), dots: true, ..Series::default() },
        Series { label: "weighted by information".into(), dots: true, ..Series::default() },
    ];
    for pair in &estimate.pairs {
        for frame in &pair.frames {
            let time_s = capture.cameras[frame.camera].clock.times_s[frame.frame];
            let Some(joint) = joint_s(estimate, capture, pair.cameras, time_s) else { continue };
            for (series, value) in series.iter_mut().zip([frame.offset_s, frame.by_information_s]) {
                series.points.push((time_s, MS * (value - joint)).into());
            }
        }
    }
    Chart {
        title: "Single triples of frames, against all together".into(),
        x_label: "time, s".into(),
        y_label: "difference, ms".into(),
        series: series.into(),
        rules: vec![(0.0, String::new())],
        ..Chart::default()
    }
}

/// How many of the shares of a distribution are drawn.
const QUANTILES: usize = 60;

fn distances(estimate: &Estimate) -> Chart {
    let mut before = Vec::new();
    let mut after = Vec::new();
    for pair in &estimate.pairs {
        for (sample, weight) in pair.samples.iter() {
            let sign = if sample.cameras == pair.cameras { 1.0 } else { -1.0 };
            let value = sign * sample.offset_s();
            let time_i = if sign > 0.0 { sample.time_a_s } else { sample.time_b_s };
            let own = pair.offset_s + pair.rate * (time_i - pair.center_s);
            // Outliers say nothing about clocks.
            if *weight > 0.1 / (pair.sigma_px * pair.sigma_px) {
                before.push((value * sample.across_px_s).abs());
                after.push(((value - own) * sample.across_px_s).abs());
            }
        }
    }
    let series = |label: &str, mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let quantile = |k: usize| {
            let share = k as f64 / QUANTILES as f64;
            let at = (share * (values.len() - 1) as f64).round() as usize;
            (100.0 * share, values[at]).into()
        };
        let points =
            if values.is_empty() { Vec::new() } else { (0..QUANTILES).map(quantile).collect() };
        Series { label: label.into(), points, line: true, ..Series::default() }
    };
    Chart {
        title: "Distances from the epipolar lines".into(),
        x_label: "percentile of the features that agree".into(),
        y_label: "pixels".into(),
        log_y: true,
        series: vec![series("clocks as they are", before), series("with the offsets", after)],
        ..Chart::default()
    }
}
