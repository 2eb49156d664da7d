//! The results of a comparison, as they are written into `metrics.json` and `timings.json`.

use super::CompareOptions;
use crate::interpolation::SyncMethod;
use crate::method::{Method, methods};
use crate::metrics::{RegionScores, Scores, median};
use crate::options::ProxyMethod;
use serde::Serialize;
use std::time::Instant;

/// Contents of `metrics.json`: all results except run times, so that every run writes the same bytes.
#[derive(Clone, Debug, Serialize)]
pub struct Metrics {
    pub format: &'static str,
    pub version: u32,
    /// Version of the stlfr program.
    pub stlfr: &'static str,
    pub capture: CaptureFacts,
    pub options: CompareOptions,
    /// Options of all rendering stages.
    pub renderer: serde_json::Value,
    pub headline: Headline,
    pub offsets: Vec<OffsetResult>,
    pub sync: Vec<SyncResult>,
    pub views: Vec<ViewResult>,
}

/// Facts about the capture that was compared.
#[derive(Clone, Debug, Serialize)]
pub struct CaptureFacts {
    pub name: String,
    pub scene: String,
    pub rig: String,
    pub reference: String,
    pub cameras: usize,
    /// Smallest and largest number of frames among the cameras.
    pub frames: (usize, usize),
    /// Image size of the reference camera: width and height, pixels.
    pub size_px: (usize, usize),
    /// Frame interval of the reference camera, seconds. It is the unit of all errors "in frames".
    pub frame_s: f64,
    pub bits: u32,
}

/// The main results of a comparison. Gains are medians over images, in decibels of PSNR.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Headline {
    pub offset: OffsetHeadline,
    pub sync: SyncHeadline,
    pub views: Vec<ViewHeadline>,
    /// Median scores of every [`ViewMethod`] with every proxy geometry. The first entry is the baseline, traditional
    /// light field rendering.
    pub methods: Vec<MethodHeadline>,
    /// Number of images that could not be rendered: synchronized images of cameras, and blended views. A camera whose
    /// image is missing when a view is blended counts as another missing image.
    pub missing_images: usize,
    /// Number of images that the comparison asked for: synchronized images of cameras, blended views, and for every
    /// blended view one image of each camera.
    pub wanted_images: usize,
    /// The most frequent reason for a missing image. `None` if no image is missing.
    pub missing_reason: Option<String>,
}

/// Scores of one [`ViewMethod`] with one proxy geometry: medians over all views.
#[derive(Clone, Debug, Serialize)]
pub struct MethodHeadline {
    pub proxy: ProxyMethod,
    pub method: ViewMethod,
    /// Whether `stlfr render`, if given the options of the comparison, would use this method with this proxy geometry.
    pub is_rendered: bool,
    pub scores: RegionScores,
    pub views: usize,
}

/// Summary of the errors of the estimated temporal offsets against the ground truth, in frames.
#[derive(Clone, Debug, Default, Serialize)]
pub struct OffsetHeadline {
    pub median_frames: Option<f64>,
    pub worst_frames: Option<f64>,
    /// Number of cameras that don't share the reference's clock, so that their offsets have to be estimated.
    pub unknown_clocks: usize,
    /// Number of cameras that don't share the reference's clock and whose offset was estimated.
    pub estimated: usize,
}

/// PSNR gain of the chosen synchronization method over the nearest frame, on the pixels of moving surfaces, over all
/// cameras and instants.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SyncHeadline {
    pub method: SyncMethod,
    pub median_gain_db: Option<f64>,
    pub least_gain_db: Option<f64>,
    pub images: usize,
}

/// PSNR gain of space-time light field rendering (ST-LFR) over traditional light field rendering, and PSNR gap between
/// ST-LFR and perfect synchronization. Medians over all views with one proxy geometry, in decibels.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ViewHeadline {
    pub proxy: ProxyMethod,
    pub gain_whole_db: Option<f64>,
    pub gain_moving_db: Option<f64>,
    /// PSNR with perfect synchronization minus PSNR of space-time light field rendering (ST-LFR), over the whole image:
    /// median over views, decibels. Negative if ST-LFR is better. `None` if no view has both values.
    pub gap_whole_db: Option<f64>,
    pub gap_moving_db: Option<f64>,
    pub views: usize,
}

/// A camera's estimated and true temporal offset.
#[derive(Clone, Debug, Serialize)]
pub struct OffsetResult {
    pub camera: String,
    pub shares_clock: bool,
    pub offset_s: Option<f64>,
    pub std_err_s: Option<f64>,
    pub truth_s: Option<f64>,
    pub error_frames: Option<f64>,
    pub std_err_frames: Option<f64>,
    /// The offset's error divided by its standard error. `None` if the error or the standard error is unknown, or if
    /// the standard error is 0.
    pub z: Option<f64>,
    /// Sentence that says why the offset is unknown. `None` if the offset is known.
    pub reason: Option<String>,
}

/// Scores of a camera's image that one synchronization method interpolated at one instant.
#[derive(Clone, Debug, Serialize)]
pub struct SyncResult {
    pub view: String,
    pub camera: String,
    /// Time of the image in seconds on the reference's clock, as in `truth.json`.
    pub time_s: f64,
    pub method: SyncMethod,
    pub scores: Option<RegionScores>,
    pub image: Option<String>,
    /// Sentence that says why the image is missing. `None` if there is an image.
    pub reason: Option<String>,
}

/// Method of a blended view: which images of the capture's cameras are blended. Reports show a method's help text as
/// its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ViewMethod {
    /// Traditional light field rendering: blends each camera's nearest frame.
    #[default]
    TraditionalLfr,
    /// Space-time light field rendering: blends images that the chosen synchronization method interpolated.
    StLfr,
    /// Blends the ground-truth images of all cameras at the instant. The result shows what perfect synchronization
    /// would reach.
    PerfectSync,
}

methods!(ViewMethod {
    TraditionalLfr = "traditional-lfr": "Traditional LFR",
    StLfr = "st-lfr": "ST-LFR",
    PerfectSync = "perfect-sync": "Perfect sync",
});

/// Scores of a blended view at one instant, for one method and one proxy geometry.
#[derive(Clone, Debug, Serialize)]
pub struct ViewResult {
    pub view: String,
    pub time_s: f64,
    pub proxy: ProxyMethod,
    pub method: ViewMethod,
    /// Number of cameras whose images are blended.
    pub cameras: usize,
    /// Cameras whose images are missing at this instant, so that they aren't blended, each with the reason.
    pub excluded: Vec<ExcludedCamera>,
    /// Fraction of the view's pixels that are compared with the ground truth: the pixels that every method renders with
    /// every proxy geometry. `None` if the view has no image.
    pub measured: Option<f64>,
    pub scores: Option<RegionScores>,
    pub image: Option<String>,
    pub reason: Option<String>,
}

/// A camera that has no image at an instant, with the reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExcludedCamera {
    pub camera: String,
    pub reason: String,
}

/// Wall-clock time of one stage of the comparison.
#[derive(Clone, Debug, Serialize)]
pub struct StageTime {
    pub stage: String,
    pub seconds: f64,
}

/// Wall-clock times of a comparison: one entry per stage, with the sum over all calls of the stage.
pub(super) struct StageTimes(pub Vec<StageTime>);

impl StageTimes {
    /// Runs `work`, adds its run time to the time of `stage`, and returns its result.
    pub fn time<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.add(stage, start);
        result
    }

    /// Adds the time since `start` to the time of `stage`.
    pub fn add(&mut self, stage: &str, start: Instant) {
        let seconds = start.elapsed().as_secs_f64();
        match self.0.iter_mut().find(|s| s.stage == stage) {
            Some(known) => known.seconds += seconds,
            None => self.0.push(StageTime { stage: stage.to_owned(), seconds }),
        }
    }
}

/// Returns the methods in `occurring`, each once, from the cheapest to the most expensive.
pub(super) fn used<M: Method>(occurring: impl Iterator<Item = M>) -> Vec<M> {
    let occurring: Vec<M> = occurring.collect();
    M::ALL.iter().copied().filter(|method| occurring.contains(method)).collect()
}

/// Summarizes the scores of all offsets, synchronized images (`sync`) and blended views into the main results.
/// `rendered` is the proxy geometry that `stlfr render` uses.
pub(super) fn headline(
    options: &CompareOptions,
    rendered: ProxyMethod,
    offsets: &[OffsetResult],
    sync: &[SyncResult],
    views: &[ViewResult],
) -> Headline {
    let own: Vec<_> = offsets.iter().filter(|o| !o.shares_clock).collect();
    let errors: Vec<f64> = own.iter().filter_map(|o| o.error_frames.map(f64::abs)).collect();
    let gains = sync_gains(options, sync);
    let missing = missing_reasons(sync, views);
    let cameras: usize = views.iter().map(|v| v.cameras + v.excluded.len()).sum();
    Headline {
        offset: OffsetHeadline {
            worst_frames: errors.iter().copied().max_by(f64::total_cmp),
            median_frames: median(errors),
            unknown_clocks: own.len(),
            estimated: own.iter().filter(|o| o.offset_s.is_some()).count(),
        },
        sync: SyncHeadline {
            method: options.sync,
            images: gains.len(),
            least_gain_db: gains.iter().copied().min_by(f64::total_cmp),
            median_gain_db: median(gains),
        },
        views: used(views.iter().map(|v| v.proxy))
            .into_iter()
            .map(|p| view_headline(views, p))
            .collect(),
        methods: method_headlines(views, rendered),
        missing_images: missing.len(),
        wanted_images: sync.len() + views.len() + cameras,
        missing_reason: most_frequent(&missing),
    }
}

/// Returns why images are missing: one reason per synchronized image or blended view that could not be rendered, and
/// one per camera whose image is missing when a view is blended.
fn missing_reasons<'a>(sync: &'a [SyncResult], views: &'a [ViewResult]) -> Vec<&'a str> {
    let unknown = |reason: &'a Option<String>| reason.as_deref().unwrap_or("no image");
    let cameras = sync.iter().filter(|s| s.scores.is_none()).map(|s| unknown(&s.reason));
    let blended = views.iter().filter(|v| v.scores.is_none()).map(|v| unknown(&v.reason));
    let excluded = views.iter().flat_map(|v| &v.excluded).map(|camera| &*camera.reason);
    cameras.chain(blended).chain(excluded).collect()
}

fn most_frequent(reasons: &[&str]) -> Option<String> {
    let count = |reason: &&&str| reasons.iter().filter(|other| other == reason).count();
    reasons.iter().max_by_key(count).map(|reason| (*reason).to_owned())
}

/// Returns the median scores, over all views, of every [`ViewMethod`] with every proxy geometry. The baseline is first:
/// traditional light field rendering with the cheapest proxy geometry.
fn method_headlines(views: &[ViewResult], rendered: ProxyMethod) -> Vec<MethodHeadline> {
    let mut found = Vec::new();
    for method in used(views.iter().map(|v| v.method)) {
        for proxy in used(views.iter().map(|v| v.proxy)) {
            let of = views.iter().filter(|v| v.method == method && v.proxy == proxy);
            let scores: Vec<RegionScores> = of.filter_map(|v| v.scores).collect();
            let region = |part: fn(&RegionScores) -> Scores| {
                let over = |value: fn(&Scores) -> Option<f64>| {
                    median(scores.iter().filter_map(|s| value(&part(s))).collect())
                };
                let pixels = scores.iter().map(|s| part(s).pixels).sum();
                Scores {
                    pixels,
                    psnr_db: over(|s| s.psnr_db),
                    ssim: over(|s| s.ssim),
                    flip: over(|s| s.flip),
                }
            };
            found.push(MethodHeadline {
                proxy,
                method,
                is_rendered: method == ViewMethod::StLfr && proxy == rendered,
                scores: RegionScores { whole: region(|s| s.whole), moving: region(|s| s.moving) },
                views: scores.len(),
            });
        }
    }
    found
}

/// Returns the PSNR gains of the chosen synchronization method over the nearest frame, in decibels, on the pixels of
/// moving surfaces. There is one gain for each camera and instant at which both methods rendered an image.
fn sync_gains(options: &CompareOptions, sync: &[SyncResult]) -> Vec<f64> {
    let psnr = |view: &str, method: SyncMethod| {
        let found = sync.iter().find(|s| s.view == view && s.method == method)?;
        found.scores?.moving.psnr_db
    };
    let chosen = sync.iter().filter(|s| s.method == options.sync);
    chosen
        .filter_map(|s| Some(psnr(&s.view, s.method)? - psnr(&s.view, super::TRADITIONAL)?))
        .collect()
}

fn view_headline(all: &[ViewResult], proxy: ProxyMethod) -> ViewHeadline {
    let by =
        |method: ViewMethod| all.iter().filter(move |v| v.proxy == proxy && v.method == method);
    let ours = || by(ViewMethod::StLfr);
    // Returns the median PSNR gain of ST-LFR over another method.
    let over = |other: ViewMethod, psnr: fn(&RegionScores) -> Option<f64>| {
        let gain = |v: &ViewResult| {
            let same = by(other).find(|o| o.view == v.view)?;
            Some(psnr(&v.scores?)? - psnr(&same.scores?)?)
        };
        median(ours().filter_map(gain).collect())
    };
    let (traditional, perfect) = (ViewMethod::TraditionalLfr, ViewMethod::PerfectSync);
    ViewHeadline {
        proxy,
        gain_whole_db: over(traditional, |s| s.whole.psnr_db),
        gain_moving_db: over(traditional, |s| s.moving.psnr_db),
        gap_whole_db: over(perfect, |s| s.whole.psnr_db).map(|v| 0.0 - v),
        gap_moving_db: over(perfect, |s| s.moving.psnr_db).map(|v| 0.0 - v),
        views: ours().filter(|v| v.scores.is_some()).count(),
    }
}
