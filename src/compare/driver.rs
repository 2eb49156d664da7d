//! Runs a comparison with the ground truth: the loop over all instants, then the files of the report.

use super::results::{CaptureFacts, Metrics, OffsetResult, StageTimes, headline};
use super::{
    CompareError, CompareOptions, Renderer, Summary, instant, report, review, truths, video,
};
use crate::capture::{Capture, FilmedCamera, Truth};
use crate::host::{write_atomically, write_json};
use crate::progress::Reporter;
use crate::video::Codec;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Compares the renderer's images with the ground truth, and writes the results into the folder `out`.
///
/// A ground-truth image with the pose of a camera of the array is compared with this camera's synchronized image, which
/// is interpolated at the image's instant. Any other ground-truth image is compared with three blended views per proxy
/// geometry. They are blended from each camera's nearest frame (traditional light field rendering), from the
/// synchronized images (space-time light field rendering), and from the ground-truth images of all cameras (perfect
/// synchronization).
///
/// # Errors
/// [`CompareError::NoTruth`] if `truth` is `None`. The ground truth and the options are checked before anything is
/// rendered. A file that can't be written is an error. If the video fails, all other files are written before the
/// video's error is returned.
pub fn compare(
    renderer: &dyn Renderer,
    truth: Option<&Truth>,
    out: &Path,
    options: &CompareOptions,
    reporter: &Reporter,
) -> Result<Summary, CompareError> {
    let start = Instant::now();
    let capture = renderer.field().capture();
    let truth = truth.ok_or_else(|| CompareError::NoTruth { folder: capture.folder.clone() })?;
    options.check()?;
    let instants = truths::instants(truth, capture)?;
    // ffmpeg is run once before rendering, so that a broken ffmpeg is found early.
    let codec = options.video.as_ref().map(|video| Codec::for_browsers(&video.ffmpeg)).transpose();
    let codec = codec.map_err(video::ReviewVideoError::from)?;

    let mut stages = StageTimes(renderer.timings());
    let task = reporter.task("Comparing with the truth", truth.views.len());
    let mut results = instant::Results::default();
    let comparison = instant::Comparison { renderer, truth, options, out };
    for instant in &instants {
        comparison.compare(instant, &mut results, &mut stages)?;
        task.advance(instant.views.len());
    }
    drop(task);

    let offsets = offset_results(renderer, truth);
    let rendered = renderer.options().proxy.method;
    let metrics = Metrics {
        format: "stlfr-metrics",
        version: 2,
        stlfr: env!("CARGO_PKG_VERSION"),
        capture: facts(capture, truth),
        options: options.clone(),
        renderer: serde_json::to_value(renderer.options()).unwrap_or_default(),
        headline: headline(options, rendered, &offsets, &results.sync, &results.views),
        offsets,
        sync: results.sync,
        views: results.views,
    };
    let written = |path: &Path, result: std::io::Result<()>| {
        result.map_err(|source| CompareError::Write { path: path.to_owned(), source })
    };
    let path = out.join("metrics.json");
    written(&path, write_json(&path, &metrics))?;
    let video = codec.map(|codec| {
        stages.time("video", || video::ReviewVideo::write(&comparison, codec, reporter))
    });
    stages.add("comparison in all", start);
    let path = out.join("timings.json");
    written(&path, write_json(&path, &json!({ "stages": stages.0 })))?;
    let whole_video = video.as_ref().and_then(|video| video.as_ref().ok());
    let video_path = whole_video.map(|video| video.path.as_path());
    let html = report::html(&metrics, &stages.0, &results.figures, video_path)?;
    let report = out.join("report.html");
    written(&report, write_atomically(&report, html.as_bytes()))?;
    let review = out.join(review::FILE);
    written(&review, write_json(&review, &review::layout(&metrics, whole_video)))?;
    let video = video.transpose()?.map(|video| video.path);
    Ok(Summary { headline: metrics.headline, report, review, video })
}

fn offset_results(renderer: &dyn Renderer, truth: &Truth) -> Vec<OffsetResult> {
    let capture = renderer.field().capture();
    let frame_s = Some(capture.frame_s()).filter(|f| *f > 0.0);
    let result = |(index, filmed): (usize, &FilmedCamera)| {
        let given = renderer.field().offsets().cameras.iter().find(|o| o.id == filmed.id);
        let shares_clock = filmed.clock.shared || index == capture.reference;
        let truth_s = truth.offset_s(&filmed.id);
        OffsetResult { shares_clock, ..OffsetResult::new(&filmed.id, given, truth_s, frame_s) }
    };
    capture.cameras.iter().enumerate().map(result).collect()
}

fn facts(capture: &Capture, truth: &Truth) -> CaptureFacts {
    let reference = &capture.cameras[capture.reference];
    let counts = || capture.cameras.iter().map(|c| c.frames.len());
    CaptureFacts {
        name: capture.name.clone(),
        scene: truth.scene.clone(),
        rig: truth.rig.clone(),
        reference: reference.id.clone(),
        cameras: capture.cameras.len(),
        frames: (counts().min().unwrap_or(0), counts().max().unwrap_or(0)),
        size_px: (reference.camera.width, reference.camera.height),
        frame_s: capture.frame_s(),
        bits: truths::bits(capture.bit_depth()),
    }
}
