//! Plots of the data behind an estimate: `offsets.svg`, beside `offsets.json`.

use super::{Estimate, PairEstimate};
use crate::capture::Capture;
use crate::chart::{Chart, ChartPoint, Series, svg};

/// Four charts, as SVG text.
///
/// They show each pair's own estimate relative to the joint one, its fraction of inliers, the estimates
/// of single frame triples over time, and the inliers' distances from their epipolar lines by the
/// nominal and by the estimated clocks (Fig. 23). `capture` must be the one of the estimate. Pairs of
/// cameras without an offset are omitted where the joint estimate is needed.
pub fn plot(estimate: &Estimate, capture: &Capture) -> String {
    svg(
        &[
            pairs(estimate, capture),
            inlier_fractions(estimate, capture),
            over_time(estimate, capture),
            distances(estimate),
        ],
        2,
    )
}

/// Milliseconds in a second.
const MS: f64 = 1e3;

/// The joint estimate of `offset_j − offset_i`, seconds, at a time on camera i's clock; `None` if
/// either camera's offset is unknown.
fn joint_s(estimate: &Estimate, capture: &Capture, [i, j]: [usize; 2], time_s: f64) -> Option<f64> {
    let offset_at = |c: usize| {
        let camera = &estimate.offsets.cameras[c];
        let elapsed_s = time_s - capture.cameras[c].clock.times_s[0];
        Some(camera.offset_s? + 1e-6 * camera.rate_ppm.unwrap_or(0.0) * elapsed_s)
    };
    Some(offset_at(j)? - offset_at(i)?)
}

fn pair_name(capture: &Capture, [i, j]: [usize; 2]) -> String {
    format!("{}–{}", capture.cameras[i].id, capture.cameras[j].id)
}

/// Each pair's estimate minus the joint one.
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
    let names: Vec<String> = estimate.pairs.iter().map(|p| pair_name(capture, p.cameras)).collect();
    Chart {
        title: "Each pair alone, against all pairs together".into(),
        x_label: labelled("pair", &names),
        y_label: "difference, ms; bars are 2 standard errors".into(),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        rules: vec![(0.0, String::new())],
        ..Chart::default()
    }
}

/// An axis label with the names of the first and the last value.
fn labelled(axis: &str, names: &[String]) -> String {
    match names {
        [] => axis.into(),
        [only] => format!("{axis} (0: {only})"),
        [first, .., last] => format!("{axis} (0: {first} … {}: {last})", names.len() - 1),
    }
}

/// The fraction of each pair's candidates that are inliers.
fn inlier_fractions(estimate: &Estimate, capture: &Capture) -> Chart {
    let fraction = |p: &PairEstimate| p.inliers as f64 / p.candidates.max(1) as f64;
    let points = estimate.pairs.iter().enumerate().map(|(k, p)| (k as f64, fraction(p)).into());
    let names: Vec<String> = estimate.pairs.iter().map(|p| pair_name(capture, p.cameras)).collect();
    Chart {
        title: "Candidates that agree".into(),
        x_label: labelled("pair", &names),
        y_label: "share".into(),
        y_shows: Some((0.0, 1.0)),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        ..Chart::default()
    }
}

/// The estimates of single frame triples minus the joint one.
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

/// The number of quantiles that a distribution is drawn with.
const QUANTILES: usize = 60;

/// The distribution of the inliers' distances from their epipolar lines (Fig. 23).
fn distances(estimate: &Estimate) -> Chart {
    let mut nominal = Vec::new();
    let mut estimated = Vec::new();
    for pair in &estimate.pairs {
        for (sample, weight) in pair.samples.iter() {
            let sign = if sample.cameras == pair.cameras { 1.0 } else { -1.0 };
            let value = sign * sample.offset_s();
            let time_i = if sign > 0.0 { sample.time_a_s } else { sample.time_b_s };
            let fitted = pair.offset_s + pair.rate * (time_i - pair.center_s);
            // Outliers carry no information about the clocks.
            if *weight > 0.1 / (pair.sigma_px * pair.sigma_px) {
                nominal.push((value * sample.across_px_s).abs());
                estimated.push(((value - fitted) * sample.across_px_s).abs());
            }
        }
    }
    let series = |label: &str, mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let quantile = |k: usize| {
            let fraction = k as f64 / QUANTILES as f64;
            let at = (fraction * (values.len() - 1) as f64).round() as usize;
            (100.0 * fraction, values[at]).into()
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
        series: vec![series("clocks as they are", nominal), series("with the offsets", estimated)],
        ..Chart::default()
    }
}
