//! Plots an offset estimate and the data behind it: the file `offsets.svg`, next to `offsets.json`.

use super::clock::ClockModel;
use super::{Estimate, PairEstimate};
use crate::capture::Capture;
use crate::chart::{Chart, ChartPoint, Series, svg};

/// Returns four charts of an offset estimate, as SVG text. `capture` must be the capture whose offsets were
/// estimated.
///
/// - The offset of each pair alone, minus the jointly estimated offset.
/// - The fraction of inliers among each pair's offset candidates.
/// - The offsets from single frame triples (two frames of one camera, one frame of another) over time, minus the
///   jointly estimated offset.
/// - The distribution of the inliers' distances from their epipolar lines, for the nominal clocks and for each pair's
///   estimated offset (Fig. 23).
///
/// The first and the third chart leave out pairs in which a camera's offset is unknown.
pub fn plot(estimate: &Estimate, capture: &Capture) -> String {
    let joint = estimate.offsets.clocks(capture);
    let pair_axis = pair_axis(estimate, capture);
    let charts = [
        pairs(estimate, &joint, &pair_axis),
        inlier_fractions(estimate, &pair_axis),
        over_time(estimate, capture, &joint),
        distances(estimate),
    ];
    svg(&charts, 2)
}

/// Number of milliseconds in a second.
const MS: f64 = 1e3;

/// Returns `offset_j − offset_i` of the cameras [i, j], seconds, by the jointly estimated clocks. `time_s` is the time,
/// seconds, on the clock of either camera: the offsets change too slowly for the difference to matter. `None` if either
/// camera's offset is unknown.
fn joint_offset_s(joint: &[Option<ClockModel>], cameras: [usize; 2], time_s: f64) -> Option<f64> {
    let [i, j] = cameras.map(|c| joint[c].as_ref().map(|clock| clock.offset_at(time_s)));
    Some(j? - i?)
}

/// Returns the label of an axis along which camera pairs are numbered. The label names the first and the last pair.
fn pair_axis(estimate: &Estimate, capture: &Capture) -> String {
    let name = |pair: &PairEstimate| {
        let [i, j] = pair.cameras.map(|c| &capture.cameras[c].id);
        format!("{i}–{j}")
    };
    match &estimate.pairs[..] {
        [] => "pair".into(),
        [only] => format!("pair (0: {})", name(only)),
        [first, .., last] => {
            format!("pair (0: {} … {}: {})", name(first), estimate.pairs.len() - 1, name(last))
        }
    }
}

/// Returns the chart of the offset of each pair alone, minus the jointly estimated offset.
fn pairs(estimate: &Estimate, joint: &[Option<ClockModel>], pair_axis: &str) -> Chart {
    let points = estimate.pairs.iter().enumerate().filter_map(|(k, pair)| {
        let joint_s = joint_offset_s(joint, pair.cameras, pair.clock.reference_s)?;
        Some(ChartPoint {
            x: k as f64,
            y: MS * (pair.clock.offset_s - joint_s),
            bar: 2.0 * MS * pair.std_err_s,
            x_range: None,
        })
    });
    Chart {
        title: "Each pair alone, against all pairs together".into(),
        x_label: pair_axis.into(),
        y_label: "difference, ms; bars are 2 standard errors".into(),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        rules: vec![(0.0, String::new())],
        ..Chart::default()
    }
}

/// Returns the chart of the fraction of inliers among each pair's offset candidates.
fn inlier_fractions(estimate: &Estimate, pair_axis: &str) -> Chart {
    let fraction = |p: &PairEstimate| p.inliers as f64 / p.candidates.max(1) as f64;
    let points = estimate.pairs.iter().enumerate().map(|(k, p)| (k as f64, fraction(p)).into());
    Chart {
        title: "Candidates that agree".into(),
        x_label: pair_axis.into(),
        y_label: "share".into(),
        y_shows: Some((0.0, 1.0)),
        series: vec![Series { points: points.collect(), dots: true, ..Series::default() }],
        ..Chart::default()
    }
}

/// Returns the chart of the offsets from single frame triples (two frames of one camera, one frame of another) over
/// time, minus the jointly estimated offset.
fn over_time(estimate: &Estimate, capture: &Capture, joint: &[Option<ClockModel>]) -> Chart {
    let mut series = [
        Series { label: "RANSAC and WLS (the paper's)".into(), dots: true, ..Series::default() },
        Series { label: "weighted by information".into(), dots: true, ..Series::default() },
    ];
    for pair in &estimate.pairs {
        for frame in &pair.frames {
            let time_s = capture.cameras[frame.camera].clock.times_s[frame.frame];
            let Some(joint_s) = joint_offset_s(joint, pair.cameras, time_s) else { continue };
            for (series, value) in series.iter_mut().zip([frame.offset_s, frame.by_information_s]) {
                series.points.push((time_s, MS * (value - joint_s)).into());
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

/// The number of quantiles with which a distribution is plotted.
const QUANTILES: usize = 60;

/// Returns the chart of the distribution of the inliers' distances from their epipolar lines (Fig. 23), for the nominal
/// clocks and for each pair's estimated offset.
fn distances(estimate: &Estimate) -> Chart {
    let (mut nominal, mut estimated) = (Vec::new(), Vec::new());
    for pair in &estimate.pairs {
        for (sample, weight) in pair.samples.iter() {
            let sign = if sample.cameras == pair.cameras { 1.0 } else { -1.0 };
            let value = sign * sample.offset_s();
            let time_i = if sign > 0.0 { sample.time_a_s } else { sample.time_b_s };
            let fitted = pair.clock.offset_at(time_i);
            // Observations of low weight are outliers, which carry no information about the clocks.
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
