//! The trade-off between speed and accuracy: measures time and quality of every useful combination of methods and
//! main parameters on one capture.
//!
//! [`tradeoff`] measures, and writes these files into one folder:
//!
//! - `tradeoff.json`: every combination with its options, quality, time and preparation time
//! - `tradeoff.svg`: a chart of quality against time, with a numbered Pareto front
//! - `recommended.json`: the recommended options, for the command-line argument `--options`
//!
//! Measurements are cached in the capture's folder, so that an interrupted run can be resumed.
//!
//! **Combinations** ([`methods`], [`variations`]): first, every synchronization method is combined with every proxy
//! and blend method. The presets, and the methods that the automatic choice `auto` finds for the capture, are
//! added. Then the combinations on the Pareto front are varied, in one or more rounds. Each variation changes one
//! main parameter, or the offset method if clocks are unknown.
//!
//! **Quality** is the PSNR of the moving part of the image, averaged over views with a ground-truth image. Without
//! ground truth, frames of held-out cameras are the reference images; the other cameras render each of them at the
//! frame's own time. PSNR of all pixels and FLIP are also written. Quality is the same from run to run.
//!
//! **Time** is the time in seconds for one view at a new instant between frames that are already registered: the
//! median of several runs. Registration of frames, and estimation of the cameras' temporal offsets, count as
//! preparation, and are timed separately.
//!
//! | file | content |
//! |---|---|
//! | `mod.rs` | the sequence of steps, `tradeoff.json`, the folder of results |
//! | `combination.rs` | the combinations to measure |
//! | `targets.rs` | the reference images |
//! | `measure.rs`, `store.rs` | measuring, and the cache of measurements |
//! | `pareto.rs` | the Pareto front |
//! | `summary.rs` | conversion of measurements to the points of the trade-off |
//! | `plot.rs` | the chart |
//!
//! Known limits: if cameras share a clock, a held-out camera's frame has the same time as the other cameras'
//! frames. Quality then depends on the proxy and blend methods but not on synchronization. Preparation is timed
//! only once.

mod combination;
mod measure;
mod pareto;
mod plot;
mod store;
mod summary;
mod targets;

pub use combination::{Variable, methods, most_accurate, name, variations};
pub use summary::{MeanScores, Point, PreparationTime, Spread};
pub use targets::Against;

use crate::capture::{CAPTURE_FILE, Capture, CaptureError, Truth};
use crate::compare::CompareError;
use crate::host::temporary::{is_temporary, remove_abandoned};
use crate::host::{Elapsed, write_atomically};
use crate::light_field::RenderError;
use crate::method::{Method, methods};
use crate::options::{AutoOptions, Preset, RenderOptions};
use crate::progress::Reporter;
use measure::Bench;
use pareto::{Trade, fastest_within, pareto_front};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use store::{CachedPoint, Store};
use summary::{summarized, trade};
use targets::TargetScene;

/// Names of the files in a trade-off's folder.
pub const FILES: [&str; 3] = ["tradeoff.json", "tradeoff.svg", "recommended.json"];

/// Options of [`tradeoff`].
#[derive(Clone, Debug)]
pub struct TradeoffOptions {
    /// Number of runs in which the rendering time of each combination of options is measured.
    pub runs: usize,
    /// Number of rounds in which the combinations on the Pareto front are varied by single parameters. With 0, only
    /// combinations of methods are measured.
    pub rounds: usize,
    /// Options that all combinations have in common, except for the varied methods and parameters.
    pub base: RenderOptions,
    /// Additional combinations to measure.
    pub also: Vec<RenderOptions>,
    pub clock: TimingClock,
}

/// The kind of rendering time from which the Pareto front is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TimingClock {
    /// Wall-clock time: what a user waits for.
    #[default]
    Wall,
    /// Processor time over all threads: for machines that do other work at the same time.
    Cpu,
}

methods!(TimingClock {
    Wall = "wall": "Wall-clock time: what a user waits for",
    Cpu = "cpu": "Processor time over all threads: where the machine does other work too",
});

impl TimingClock {
    fn of(self, elapsed: &Elapsed) -> f64 {
        match self {
            Self::Wall => elapsed.wall_s,
            Self::Cpu => elapsed.cpu_s,
        }
    }
}

impl Default for TradeoffOptions {
    fn default() -> Self {
        let (base, also) = (RenderOptions::default(), Vec::new());
        Self { runs: 3, rounds: 1, base, also, clock: TimingClock::Wall }
    }
}

/// Maximum loss of quality of the recommended combination relative to the best quality of all combinations, in
/// decibels of PSNR. A difference of this size is invisible.
pub const SLACK_DB: f64 = 0.2;

/// The reason why a trade-off can't be measured, as one sentence.
#[derive(Debug, thiserror::Error)]
pub enum TradeoffError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    Compare(#[from] CompareError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("{folder}: {reason}")]
    Folder { folder: PathBuf, reason: String },
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("no combination can render this capture: {reason}")]
    Nothing { reason: String },
}

/// The content of `tradeoff.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(title = "stlfr trade-off")]
#[serde(deny_unknown_fields)]
pub struct Tradeoff {
    pub format: String,
    pub version: u32,
    pub stlfr: String,
    /// Name of the capture.
    pub capture: String,
    pub cameras: usize,
    /// Width and height, in pixels, of the view whose rendering time is measured.
    pub size_px: (usize, usize),
    /// Number of threads that render a view.
    pub threads: usize,
    pub against: Against,
    /// Kind of rendering time from which the Pareto front is computed.
    pub clock: TimingClock,
    /// Number of views with reference images over which quality is averaged.
    pub views: usize,
    /// Time that the automatic choice of methods (`auto`) takes, seconds.
    pub planning_s: f64,
    /// The measured combinations, fastest first. Combinations that can't be rendered are last.
    pub points: Vec<Point>,
    /// Index, in `points`, of the recommended combination: the fastest whose quality is within 0.2 dB of the best.
    pub recommended: usize,
}

/// Returns the JSON Schema of `tradeoff.json`.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(Tradeoff).into()
}

impl Tradeoff {
    /// Returns the measured combination with this label: a preset's name, or [`AUTO`].
    pub fn labelled(&self, label: &str) -> Option<&Point> {
        self.points.iter().find(|p| p.labels.iter().any(|l| l == label))
    }

    /// Returns the measured combinations on the Pareto front of time and quality, fastest first.
    pub fn pareto_front(&self) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(|p| p.on_front)
    }
}

/// Label of the combination of methods that the automatic choice finds for the capture ([`crate::plan`]).
pub const AUTO: &str = "auto";

/// Measures time and quality of views for many combinations of options, and writes the results into the folder
/// `out`.
pub fn tradeoff(
    capture: &Arc<Capture>,
    options: &TradeoffOptions,
    out: &Path,
    reporter: &Reporter,
) -> Result<Tradeoff, TradeoffError> {
    refuse_foreign(out)?;
    let truth = Truth::open(&capture.folder)?;
    let store = Store::open(capture, truth.as_ref(), reporter)?;
    let base = &options.base;
    let prepared = store.prepared(base)?;
    let scene = TargetScene { capture, offsets: &prepared.offsets, base };
    let looking = reporter.phase("views to measure against");
    let (targets, timed) = scene.targets(truth.as_ref())?;
    drop(looking);
    let (runs, clock) = (options.runs, options.clock);
    let bench = Bench { store, targets, timed, runs, clock, reporter };
    let auto = RenderOptions { auto: AutoOptions::all(), ..base.clone() };
    let planned = bench.store.planned(&auto)?;
    let mut labels = vec![(AUTO, planned.options.clone())];
    for preset in Preset::ALL {
        labels.push((preset.name(), bench.store.planned(&preset.options())?.options));
    }

    let mut wanted = methods(base);
    add(&mut wanted, labels.iter().map(|(_, options)| options.clone()));
    add(&mut wanted, options.also.iter().cloned());
    let mut points = bench.measure("methods", &wanted)?;
    let variable =
        Variable { offsets: prepared.offsets_took.is_some(), cameras: capture.cameras.len() };
    for round in 1..=options.rounds {
        let trades: Vec<Trade> = points.iter().map(|point| trade(&bench, point)).collect();
        for k in pareto_front(&trades) {
            add(&mut wanted, variations(&points[k].options, variable));
        }
        points = bench.measure(&format!("around the Pareto front, {round}"), &wanted)?;
    }
    let tradeoff = gathered(&bench, &points, &labels, planned.took.wall_s)?;
    write(&tradeoff, out)?;
    Ok(tradeoff)
}

/// Adds to `wanted` those combinations of options in `more` that it does not contain yet.
fn add(wanted: &mut Vec<RenderOptions>, more: impl IntoIterator<Item = RenderOptions>) {
    for options in more {
        if !wanted.contains(&options) {
            wanted.push(options);
        }
    }
}

fn gathered(
    bench: &Bench,
    points: &[CachedPoint],
    labels: &[(&str, RenderOptions)],
    planning_s: f64,
) -> Result<Tradeoff, TradeoffError> {
    let trades: Vec<Trade> = points.iter().map(|point| trade(bench, point)).collect();
    let best = fastest_within(&trades, SLACK_DB).ok_or_else(|| TradeoffError::Nothing {
        reason: points.iter().find_map(|p| p.reason.clone()).unwrap_or_default(),
    })?;
    let front = pareto_front(&trades);
    let mut order: Vec<usize> = (0..points.len()).collect();
    // The times of points that can't be rendered are NaN, which is sorted last.
    order.sort_by(|&a, &b| trades[a].seconds.total_cmp(&trades[b].seconds));
    let recommended = order.iter().position(|&k| k == best).unwrap_or_default();
    let points =
        order.into_iter().map(|k| summarized(bench, &points[k], front.contains(&k), labels));
    let points = points.collect::<Result<_, _>>()?;
    let camera = &bench.timed.camera;
    let against = bench.against();
    Ok(Tradeoff {
        format: "stlfr-tradeoff".into(),
        version: 1,
        stlfr: env!("CARGO_PKG_VERSION").into(),
        capture: bench.store.capture.name.clone(),
        cameras: bench.store.capture.cameras.len(),
        size_px: (camera.width, camera.height),
        threads: rayon::current_num_threads(),
        against,
        clock: bench.clock,
        views: bench.targets.iter().filter(|t| t.against == against).count(),
        planning_s,
        points,
        recommended,
    })
}

fn write(tradeoff: &Tradeoff, out: &Path) -> Result<(), TradeoffError> {
    write_json(&out.join("recommended.json"), &tradeoff.points[tradeoff.recommended].options)?;
    let path = out.join("tradeoff.svg");
    write_atomically(&path, plot::svg(tradeoff).as_bytes())
        .map_err(|source| TradeoffError::Write { path, source })?;
    write_json(&out.join("tradeoff.json"), tradeoff)
}

/// Writes a value as a JSON file, atomically.
fn write_json(path: &Path, value: &impl Serialize) -> Result<(), TradeoffError> {
    let failed = |source| TradeoffError::Write { path: path.to_owned(), source };
    crate::host::write_json(path, value).map_err(failed)
}

/// Returns an error if the folder is a capture, is no folder, or contains files that do not belong to a trade-off.
fn refuse_foreign(folder: &Path) -> Result<(), TradeoffError> {
    let refused = |reason: String| Err(TradeoffError::Folder { folder: folder.to_owned(), reason });
    if folder.join(CAPTURE_FILE).exists() {
        return refused("is a capture, and a trade-off needs a folder of its own".into());
    }
    remove_abandoned(folder);
    if folder.exists() && !folder.is_dir() {
        return refused("is no folder".into());
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for name in entries.map(|entry| entry.file_name()) {
        // Temporary files belong to a trade-off that another process is computing.
        let name_text = name.to_string_lossy();
        if !FILES.contains(&&*name_text) && !is_temporary(&name) {
            return refused(format!(
                "holds {name_text}, which is no part of a trade-off: give a folder of its own"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("new");
        assert!(refuse_foreign(&missing).is_ok() && refuse_foreign(folder.path()).is_ok());
        std::fs::write(folder.path().join("tradeoff.json"), "{}").unwrap();
        assert!(refuse_foreign(folder.path()).is_ok());
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = refuse_foreign(folder.path()).unwrap_err().to_string();
        assert!(error.contains("thesis.tex"), "{error}");
        let error = refuse_foreign(&folder.path().join("thesis.tex")).unwrap_err().to_string();
        assert!(error.contains("is no folder"), "{error}");
    }
}
