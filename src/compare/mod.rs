//! §8: the results beside the truth.
//!
//! [`compare`] renders what the truth has images of, measures it, and writes into one folder
//!
//! - `metrics.json`: every number; the same bytes from run to run, whatever the thread count
//! - `timings.json`: how long the stages took
//! - `report.html`: all of it for a reader, in one file
//! - `sheets/`: truth, methods and their differences side by side
//! - `images/`: the rendered images, in the input's bit depth
//! - `review.json`: what stands beside what, for `review.blend`
//! - `review.mp4` and the lossless movies in `video/`, if asked for
//!
//! | file | what |
//! |---|---|
//! | `mod.rs` | the interface to the renderer, options, errors, the summary |
//! | `driver.rs` | all instants, then the folder's files |
//! | `instant.rs` | one instant: synchronize the cameras and measure them |
//! | `views.rs` | one view at an instant: blend it by every method and measure that |
//! | `truths.rs` | the truth's images and moving parts |
//! | `metrics.rs`, `ssim.rs`, `flip.rs`, `filter.rs` | the metrics |
//! | `mask.rs` | the moving part |
//! | `results.rs` | what is found, as it is written; the headline |
//! | `sheet.rs` | pictures with labels |
//! | `report.rs`, `report.html`, `plots.rs` | the report |
//! | `video.rs` | the review video |
//! | `review.rs` | what `review.blend` is laid out from |
//!
//! Known limits: what is measured is what the files hold, after rounding to their bit depth. The
//! noise of the truth itself, which bounds every PSNR, is not known here.

mod driver;
mod filter;
pub mod flip;
mod instant;
mod light_field;
pub mod mask;
pub mod metrics;
mod offset_score;
mod plots;
mod report;
pub mod results;
mod review;
pub mod sheet;
pub mod ssim;
pub(crate) mod truths;
pub mod video;
mod views;

pub use driver::compare;

pub use light_field::{ComparedLightField, sync_name};
pub use offset_score::{OffsetScore, ScoredOffset};

use crate::camera::Camera;
use crate::capture::{Capture, CaptureError, TruthError};
use crate::raster::Image;
use results::{Headline, StageTime};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The sync rung of traditional light field rendering, which everything is compared with.
pub const NEAREST: &str = "nearest";

/// What is compared: a light field of one capture, with its preparation (registration, offsets)
/// done. Calls come from one thread, one after the other, so that an implementation may use all
/// cores and keep caches.
///
/// Times are seconds on the reference's clock, from the capture's start
/// ([`Capture::time_origin_s`] subtracted). An `Err` is one sentence for the report: why this
/// image can't be made. It leaves out the camera or the view, and ends nothing.
pub trait Renderer: Sync {
    fn capture(&self) -> &Capture;

    /// Every camera's offset, as `offsets --json` states it.
    fn offsets(&self) -> Vec<CameraOffset>;

    /// The sync rungs, cheapest first.
    fn sync_rungs(&self) -> Vec<String>;

    /// The proxy rungs, cheapest first.
    fn proxies(&self) -> Vec<String>;

    /// A filming camera's image at a time, by one of [`Self::sync_rungs`].
    fn synchronized(&self, sync: &str, camera: usize, time_s: f64) -> Result<Image, String>;

    /// A view blended from one image a filming camera (`None`: left out), through the proxy of
    /// that index. The proxy must not depend on the images, only on the view and the time.
    fn view(
        &self,
        images: &[Option<Image>],
        proxy: usize,
        target: &Camera,
        time_s: f64,
    ) -> Result<RenderedView, String>;

    /// The first and the last time at which all cameras can give an image.
    fn covered_span_s(&self) -> Option<(f64, f64)>;

    /// The options of all stages, to be written beside the numbers.
    fn options(&self) -> serde_json::Value;

    /// What the preparation took.
    fn timings(&self) -> Vec<StageTime>;
}

/// A rendered image, and which of its pixels a camera sees, row by row.
#[derive(Clone, Debug)]
pub struct RenderedView {
    pub image: Image,
    pub coverage: Vec<bool>,
}

/// An estimated offset: time on the reference's clock = time on the camera's clock + `offset_s`.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraOffset {
    pub id: String,
    pub offset_s: Option<f64>,
    pub std_err_s: Option<f64>,
    /// Why there is no offset.
    pub reason: Option<String>,
}

/// What is compared, and how it is measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompareOptions {
    /// The sync rung of ST-LFR.
    pub sync: String,
    /// Measure all sync rungs on the filming cameras, not only `nearest` and `sync`.
    pub all_rungs: bool,
    /// A surface point that moves more than this within ±1 frame belongs to the moving part.
    /// Larger: slow motion isn't measured apart. Smaller: the moving part fills with what any
    /// method renders well.
    pub moving_threshold_px: f32,
    /// What the moving part is dilated by. Smaller: ghosts beside a moving edge are missed.
    /// Larger: the still background dilutes the numbers.
    pub moving_dilation_px: usize,
    /// FLIP's viewing condition; its authors' by default.
    pub pixels_per_degree: f64,
    /// What the difference images of the sheets are multiplied by.
    pub difference_gain: f32,
    /// How many views the report holds the pictures of; the sheets have all.
    pub report_views: usize,
    /// A side-by-side video too.
    pub video: Option<video::VideoOptions>,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            sync: "refined".into(),
            all_rungs: false,
            moving_threshold_px: 0.5,
            moving_dilation_px: 2,
            pixels_per_degree: flip::DEFAULT_PIXELS_PER_DEGREE,
            difference_gain: 4.0,
            report_views: 12,
            video: None,
        }
    }
}

/// Why there is no comparison. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error("{folder} has no truth/truth.json to compare with")]
    NoTruth { folder: PathBuf },
    #[error(transparent)]
    Truth(#[from] TruthError),
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("truth/truth.json: views[{index}] ({id}): {reason}")]
    View { index: usize, id: String, reason: String },
    #[error("sync '{name}' is not one of {known}")]
    Rung { name: String, known: String },
    #[error("{field} is {value}, must be {wanted}")]
    Option { field: &'static str, value: f64, wanted: &'static str },
    #[error("{path}: {source}")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("the report could not be filled in: {0}")]
    Report(#[from] minijinja::Error),
    #[error(transparent)]
    Video(#[from] video::VideoError),
}

/// The numbers that matter, and where the rest is.
#[derive(Clone, Debug)]
pub struct Summary {
    pub headline: Headline,
    pub report: PathBuf,
    /// What `review.blend` is laid out from.
    pub review: PathBuf,
    pub video: Option<PathBuf>,
}

impl CompareOptions {
    fn check(&self, renderer: &dyn Renderer) -> Result<(), CompareError> {
        let known = renderer.sync_rungs();
        if !known.contains(&self.sync) {
            let known = known.join(", ");
            return Err(CompareError::Rung { name: self.sync.clone(), known });
        }
        let positive = [
            ("pixels_per_degree", self.pixels_per_degree),
            ("difference_gain", f64::from(self.difference_gain)),
        ];
        for (field, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(CompareError::Option { field, value, wanted: "positive" });
            }
        }
        let threshold = f64::from(self.moving_threshold_px);
        if !(threshold.is_finite() && threshold >= 0.0) {
            let field = "moving_threshold_px";
            return Err(CompareError::Option { field, value: threshold, wanted: "0 or more" });
        }
        Ok(())
    }

    /// The rungs to measure, in the ladder's order.
    fn rungs(&self, renderer: &dyn Renderer) -> Vec<String> {
        let wanted = |r: &String| self.all_rungs || *r == NEAREST || *r == self.sync;
        renderer.sync_rungs().into_iter().filter(wanted).collect()
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let number = |v: Option<f64>| v.map_or("unknown".into(), |v| format!("{v:.4}"));
        let gain = |v: Option<f64>| v.map_or("unknown".into(), |v| format!("{v:+.1} dB"));
        let h = &self.headline;
        writeln!(
            f,
            "offsets    error {} frame in the median, {} at worst; {} of {} unknown clocks estimated",
            number(h.offset.median_frames),
            number(h.offset.worst_frames),
            h.offset.estimated,
            h.offset.unknown_clocks,
        )?;
        writeln!(
            f,
            "sync       {}: {} against the nearest frame on the moving part (median of {} images, worst {})",
            h.sync.rung,
            gain(h.sync.median_gain_db),
            h.sync.images,
            gain(h.sync.least_gain_db),
        )?;
        for view in &h.views {
            writeln!(
                f,
                "views      {}: {} against traditional LFR, {} against perfect sync on the moving part (median of {})",
                view.proxy,
                gain(view.gain_moving_db),
                gain(view.gap_moving_db.map(|gap| 0.0 - gap)),
                view.views,
            )?;
        }
        if h.left_out > 0 {
            writeln!(
                f,
                "left out   {} images that could not be made; the report says why",
                h.left_out
            )?;
        }
        if let Some(video) = &self.video {
            writeln!(f, "video      {}", video.display())?;
        }
        write!(f, "report     {}", self.report.display())
    }
}

#[cfg(test)]
mod tests;
