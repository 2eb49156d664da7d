//! Comparison of rendered images with the ground truth (§8 of the paper).
//!
//! [`compare`] renders every view of which the ground truth has an image, measures the differences, and writes these
//! files into one folder:
//!
//! - `metrics.json`: all scores; the same bytes in every run, for any number of threads
//! - `timings.json`: run times of the stages
//! - `report.html`: scores, plots, and a viewer of the pictures in `images/`
//! - `sheets/`: truth, methods and difference images side by side, as lossless WebP
//! - `images/`: the rendered images, in the bit depth of the capture's frames
//! - `review.json`: the layout of the Blender file `review.blend`
//! - `review.mp4`, and the lossless videos in `video/`, if the options ask for a video
//!
//! | file | contents |
//! |---|---|
//! | `mod.rs` | the renderer's interface, options, errors, the summary |
//! | `driver.rs` | the loop over all instants, then the files of the report |
//! | `light_field.rs` | the renderer of a light field |
//! | `instant.rs` | one instant: synchronizes the cameras and measures their images |
//! | `views.rs` | one view at an instant: blends the view by every method, and measures the results |
//! | `truths.rs` | the ground-truth images and their moving parts |
//! | `results.rs` | the contents of `metrics.json` and `timings.json`, and the main results |
//! | `sheet.rs`, `lettering.rs` | pictures with labels |
//! | `viewer.rs` | the data of the report's viewer |
//! | `report.rs`, `report.html`, `report.css`, `report.js` | the report |
//! | `video.rs` | the review video |
//! | `review.rs` | the layout of `review.blend` |
//!
//! Known limits: images are measured after rounding to the bit depth of their files. The ground-truth images contain an
//! unknown amount of rendering noise, which bounds every PSNR.

mod driver;
mod instant;
pub mod lettering;
mod light_field;
mod offset_score;
mod report;
pub mod results;
mod review;
pub mod sheet;
pub(crate) mod truths;
pub mod video;
mod viewer;
mod views;

pub use driver::compare;

pub use light_field::ComparedLightField;
pub use offset_score::{errors_frames, score_offsets};

use crate::camera::Camera;
use crate::capture::CaptureError;
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{Images, LightField};
use crate::lumigraph::Rendered;
use crate::method::Method;
use crate::metrics::flip;
use crate::options::{ProxyMethod, RenderOptions};
use crate::raster::ImageFileError;
use results::{Headline, StageTime};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Names of the files and folders that every comparison may write into its folder. Folders have a final `/`.
pub const FILES: [&str; 8] = [
    "report.html",
    "metrics.json",
    "timings.json",
    "review.json",
    "review.blend",
    "images/",
    "sheets/",
    "video/",
];

/// Synchronization method (method of temporal interpolation) of traditional light field rendering, the baseline: each
/// camera's frame nearest in time.
pub const TRADITIONAL: SyncMethod = SyncMethod::Nearest;

/// Renders the images that are compared with the ground truth. [`ComparedLightField`] implements this trait for an
/// opened light field. Tests implement it with images of known error. Its methods are called one after another, so an
/// implementation may use all cores and a cache.
///
/// Times are seconds on the reference's clock, from the capture's start
/// ([`Capture::time_origin_s`](crate::capture::Capture::time_origin_s) subtracted). An `Err` is a sentence for the
/// report that says why the image can't be rendered. The report then lacks this image, and the comparison continues.
pub trait Renderer: Sync {
    /// Returns the light field, with the capture and its temporal offsets.
    fn field(&self) -> &LightField;

    /// Interpolates a camera's image at the time `time_s` from frames of the capture, by the given synchronization
    /// method. `camera` is an index into the capture's cameras.
    fn synchronized(
        &self,
        sync: SyncMethod,
        camera: usize,
        time_s: f64,
    ) -> Result<Arc<Synchronized>, String>;

    /// Renders a view by blending images of the capture's cameras.
    fn view(&self, view: &ComparedView) -> Result<Rendered, String>;

    /// Returns the options of all rendering stages. They are written into `metrics.json`.
    fn options(&self) -> &RenderOptions;

    /// Returns the run times of the preparation, which opens the light field and reads or estimates the offsets.
    fn timings(&self) -> Vec<StageTime>;
}

/// A view to render for the comparison.
#[derive(Clone, Copy, Debug)]
pub struct ComparedView<'a> {
    pub target: &'a Camera,
    pub time_s: f64,
    pub proxy: ProxyMethod,
    /// The images of the capture's cameras that are blended into the view.
    pub images: Images<'a>,
    /// The images of the capture's cameras from which the depth of each pixel is estimated.
    pub shape: Images<'a>,
}

/// Options of a comparison of rendered images with the ground truth.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompareOptions {
    /// The synchronization method of space-time light field rendering (ST-LFR): how a camera's image between two of its
    /// frames is made.
    pub sync: SyncMethod,
    /// True to measure the cameras' images by all synchronization methods, false to measure them only by `nearest` and
    /// by the method in `sync`.
    pub all_methods: bool,
    /// Threshold that defines the moving part of an image, pixels. A pixel belongs to the moving part if its surface
    /// point moves by more than this value within one frame before or after the image's instant.
    pub moving_threshold_px: f32,
    /// Dilation of the mask of an image's moving part, pixels. Each pixel of the mask grows by this value to the left,
    /// right, top and bottom, into a square.
    pub moving_dilation_px: usize,
    /// Viewing condition of the FLIP metric: pixels per degree of visual angle.
    pub pixels_per_degree: f64,
    /// Factor by which the difference images of the comparison sheets are amplified.
    pub difference_gain: f32,
    /// Options of the side-by-side review video. If it is `None`, no video is made.
    pub video: Option<video::VideoOptions>,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            sync: SyncMethod::Refined,
            all_methods: false,
            moving_threshold_px: 0.5,
            moving_dilation_px: 2,
            pixels_per_degree: flip::DEFAULT_PIXELS_PER_DEGREE,
            difference_gain: 4.0,
            video: None,
        }
    }
}

/// Reason why a comparison failed. The message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error("{folder} has no truth/truth.json to compare with")]
    NoTruth { folder: PathBuf },
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    #[error("truth/truth.json: views[{index}] ({id}): {reason}")]
    View { index: usize, id: String, reason: String },
    #[error("{field} is {value}, must be {wanted}")]
    Option { field: &'static str, value: f64, wanted: &'static str },
    #[error("{path}: {source}")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("the report could not be filled in: {0}")]
    Report(#[from] minijinja::Error),
    #[error(transparent)]
    Video(#[from] video::ReviewVideoError),
}

/// The main results of a comparison, and the paths of its main files.
#[derive(Clone, Debug)]
pub struct Summary {
    pub headline: Headline,
    pub report: PathBuf,
    /// Path of `review.json`, the layout of `review.blend`.
    pub review: PathBuf,
    pub video: Option<PathBuf>,
}

impl CompareOptions {
    fn check(&self) -> Result<(), CompareError> {
        let video = self.video.clone().unwrap_or_default();
        let (gain, threshold) = (self.difference_gain.into(), self.moving_threshold_px.into());
        let fields = [
            ("pixels_per_degree", self.pixels_per_degree, self.pixels_per_degree > 0.0, "positive"),
            ("difference_gain", gain, gain > 0.0, "positive"),
            ("moving_threshold_px", threshold, threshold >= 0.0, "0 or more"),
            ("video.rate_hz", video.rate_hz, video.rate_hz > 0.0, "positive"),
            ("video.frames", video.frames as f64, video.frames > 0, "1 or more"),
        ];
        match fields.into_iter().find(|(_, value, is_valid, _)| !(value.is_finite() && *is_valid)) {
            Some((field, value, _, wanted)) => Err(CompareError::Option { field, value, wanted }),
            None => Ok(()),
        }
    }

    /// Returns the synchronization methods whose images are measured, from the cheapest to the most expensive.
    fn methods(&self) -> Vec<SyncMethod> {
        let wanted = |m: &SyncMethod| self.all_methods || [TRADITIONAL, self.sync].contains(m);
        SyncMethod::ALL.iter().copied().filter(wanted).collect()
    }
}

#[cfg(test)]
mod tests;
