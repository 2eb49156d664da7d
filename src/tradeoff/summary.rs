//! Summarizes the measurements of each combination of options as a [`Point`] of the trade-off between time and quality.

use super::measure::Bench;
use super::pareto::Trade;
use super::store::CachedPoint;
use super::targets::{Against, Target};
use super::{TradeoffError, name};
use crate::host::Elapsed;
use crate::metrics::{RegionScores, Scores, median};
use crate::options::RenderOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Measured quality and processing time of one combination of methods and parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Name of the combination: its methods, and the parameters that differ from their defaults.
    pub name: String,
    /// Names of the presets whose options equal this combination's options. Also `auto`, if the automatic choice of
    /// methods gives these options.
    pub labels: Vec<String>,
    /// Options of all stages, in the format of an options file.
    #[schemars(with = "serde_json::Value")]
    pub options: RenderOptions,
    /// Whether the combination is on the Pareto front.
    pub on_front: bool,
    /// Reason why the combination can't be rendered; `None` if it can. If there is a reason, there are no measurements.
    pub reason: Option<String>,
    /// Quality from which the Pareto front is computed: PSNR of the moving part, or of all pixels if nothing moves, in
    /// decibels. `None` if the quality wasn't measured.
    pub quality_db: Option<f64>,
    pub moving: MeanScores,
    pub whole: MeanScores,
    /// PSNR against the view that the most accurate methods render, in decibels. `None` if the capture has ground
    /// truth, or if the combination can't be rendered.
    pub most_accurate_db: Option<f64>,
    /// Wall-clock time of one view at a new instant, seconds. `None` if the combination can't be rendered.
    pub wall_s: Option<Spread>,
    /// Processor time of one view at a new instant, summed over all threads, seconds. `None` if the combination can't
    /// be rendered.
    pub cpu_s: Option<Spread>,
    pub preparation: Option<PreparationTime>,
}

/// Mean scores over all compared views, either of the moving part of the image or of all pixels. Views without such
/// pixels are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeanScores {
    /// Mean PSNR in decibels; `None` if no view has a score. A view that is identical to the reference image counts as
    /// 99 dB.
    pub psnr_db: Option<f64>,
    pub flip: Option<f64>,
}

/// Statistics of the times that a view took in several runs, in seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Spread {
    pub median: f64,
    pub min: f64,
    pub max: f64,
    pub runs: usize,
}

/// Wall-clock times of the preparation before a view is rendered, in seconds. One preparation suffices for all views at
/// instants between the same two frames of each camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PreparationTime {
    /// Time to estimate the temporal offsets of the capture's cameras. `None` if the clocks are known.
    pub offsets_s: Option<f64>,
    /// Time to decode and register one pair of frames of every camera.
    pub registration_s: f64,
}

impl PreparationTime {
    pub fn sum_s(&self) -> f64 {
        self.offsets_s.unwrap_or(0.0) + self.registration_s
    }
}

/// PSNR, in decibels, that replaces the infinite value of identical images in means.
const IDENTICAL_DB: f64 = 99.0;

/// Step, in decibels, to which qualities are rounded before combinations are compared.
const STEP_DB: f64 = 0.01;

/// Returns the time and the quality of a combination of options, from its measurements `point`. The time is the median
/// over the runs. A value is NaN if the combination can't be rendered or the value wasn't measured.
pub(super) fn trade(bench: &Bench, point: &CachedPoint) -> Trade {
    let seconds = spread(point, |elapsed| bench.clock.of(elapsed)).map_or(f64::NAN, |s| s.median);
    let quality = quality_db(bench, point).unwrap_or(f64::NAN);
    Trade { seconds, quality: (quality / STEP_DB).round() * STEP_DB }
}

/// Summarizes the measurements of a combination of options. `on_front` tells whether the combination is on the Pareto
/// front of all combinations. `labels` are the names of the presets and `auto`, each with the options that it stands
/// for.
pub(super) fn summarized(
    bench: &Bench,
    cached: &CachedPoint,
    on_front: bool,
    labels: &[(&str, RenderOptions)],
) -> Result<Point, TradeoffError> {
    let own = labels.iter().filter(|(_, options)| *options == cached.options);
    let prepared = match cached.reason {
        Some(_) => None,
        None => Some(bench.store.prepared(&cached.options)?),
    };
    let against = bench.against();
    Ok(Point {
        name: name(&cached.options),
        labels: own.map(|(label, _)| (*label).to_owned()).collect(),
        options: cached.options.clone(),
        on_front,
        reason: cached.reason.clone(),
        quality_db: quality_db(bench, cached),
        moving: mean(bench, cached, against, |s| &s.moving),
        whole: mean(bench, cached, against, |s| &s.whole),
        most_accurate_db: mean(bench, cached, Against::MostAccurate, |s| &s.whole).psnr_db,
        wall_s: spread(cached, |elapsed| elapsed.wall_s),
        cpu_s: spread(cached, |elapsed| elapsed.cpu_s),
        preparation: prepared.map(|prepared| PreparationTime {
            offsets_s: prepared.offsets_took.map(|t| t.wall_s),
            registration_s: prepared.registration_took.wall_s,
        }),
    })
}

fn quality_db(bench: &Bench, point: &CachedPoint) -> Option<f64> {
    let against = bench.against();
    let moving = mean(bench, point, against, |s| &s.moving).psnr_db;
    moving.or_else(|| mean(bench, point, against, |s| &s.whole).psnr_db)
}

fn mean(
    bench: &Bench,
    point: &CachedPoint,
    against: Against,
    region: impl Fn(&RegionScores) -> &Scores,
) -> MeanScores {
    if point.reason.is_some() {
        return MeanScores::default();
    }
    let targets = bench.targets.iter().filter(|t| t.against == against);
    let score = |t: &Target| point.scores.get(&t.id).map(&region).filter(|s| s.pixels > 0);
    let scores: Vec<&Scores> = targets.filter_map(score).collect();
    let mean = |value: fn(&Scores) -> Option<f64>| {
        let values: Vec<f64> = scores.iter().filter_map(|s| value(s)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    MeanScores {
        psnr_db: mean(|s| Some(s.psnr_db.unwrap_or(IDENTICAL_DB))),
        flip: mean(|s| s.flip),
    }
}

/// Returns statistics of the rendering times of a combination of options, over all timed runs. `seconds` selects
/// wall-clock time or processor time. `None` if the combination can't be rendered or wasn't timed.
fn spread(point: &CachedPoint, seconds: impl Fn(&Elapsed) -> f64) -> Option<Spread> {
    if point.reason.is_some() {
        return None;
    }
    let values: Vec<f64> = point.runs.iter().map(seconds).collect();
    let min = values.iter().copied().fold(f64::INFINITY, f64::min);
    let max = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let runs = values.len();
    Some(Spread { median: median(values)?, min, max, runs })
}
