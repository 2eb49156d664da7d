//! Compares every instant of the truth, then writes the folder's files.

use super::results::{CaptureFacts, Metrics, OffsetResult, headline};
use super::stage_times::StageTimes;
use super::{
    CompareError, CompareOptions, Renderer, Summary, instant, report, review, truths, video,
};
use crate::capture::{Capture, Truth};
use crate::host::{write_atomically, write_json};
use crate::progress::Reporter;
use crate::video::Codec;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Compares the renderer's images with the truth, and writes the folder `out`.
///
/// Views of the truth that stand where a filming camera does measure its synchronized image; the
/// others are blended from each camera's nearest frame (traditional LFR), from the synchronized
/// images (ST-LFR), and from the true ones (perfect sync).
///
/// # Errors
/// [`CompareError::NoTruth`] without truth; whatever is wrong with the truth or the options, before
/// anything is rendered; what can't be written. A video's error is returned after all else is written.
pub fn compare(
    renderer: &dyn Renderer,
    truth: Option<&Truth>,
    out: &Path,
    options: &CompareOptions,
    reporter: &Reporter,
) -> Result<Summary, CompareError> {
    let start = Instant::now();
    let capture = renderer.capture();
    let truth = truth.ok_or_else(|| CompareError::NoTruth { folder: capture.folder.clone() })?;
    options.check()?;
    let instants = truths::instants(truth, capture)?;
    let encoder = options.video.as_ref().map(encoder).transpose()?;

    let mut stages = StageTimes(renderer.timings());
    let task = reporter.task("Comparing with the truth", truth.views.len());
    let mut results = instant::Results::default();
    let methods = &options.methods();
    let comparison = instant::Comparison { renderer, truth, options, out, methods };
    for instant in &instants {
        comparison.compare(instant, &mut results, &mut stages)?;
        task.advance(instant.views.len());
    }
    drop(task);

    let offsets = offset_results(renderer, truth);
    let metrics = Metrics {
        format: "stlfr-metrics",
        version: 2,
        stlfr: env!("CARGO_PKG_VERSION"),
        capture: facts(capture, truth),
        options: options.clone(),
        renderer: serde_json::to_value(renderer.options()).unwrap_or_default(),
        headline: headline(options, &offsets, &results.sync, &results.views),
        offsets,
        sync: results.sync,
        views: results.views,
    };
    let write_failed = |path: &Path| {
        let path = path.to_owned();
        |source| CompareError::Write { path, source }
    };
    let path = out.join("metrics.json");
    write_json(&path, &metrics).map_err(write_failed(&path))?;
    let video = match (encoder, &options.video) {
        (Some(encoder), Some(video_options)) => stages
            .time("video", || {
                let plan =
                    video::VideoPlan::new(renderer, options.sync, Some(truth), video_options)?;
                plan.write(&encoder, out, reporter)
            })
            .map(Some),
        _ => Ok(None),
    };
    stages.add("comparison in all", start);
    let path = out.join("timings.json");
    write_json(&path, &json!({ "stages": stages.0 })).map_err(write_failed(&path))?;
    let written = video.as_ref().ok().and_then(Option::as_ref);
    let video_path = written.map(|m| m.path.as_path());
    let html = report::html(&metrics, &stages.0, &results.figures, video_path)?;
    let report = out.join("report.html");
    write_atomically(&report, html.as_bytes()).map_err(write_failed(&report))?;
    let review = out.join(review::FILE);
    write_json(&review, &review::layout(&metrics, written)).map_err(write_failed(&review))?;
    Ok(Summary { headline: metrics.headline, report, review, video: video?.map(|v| v.path) })
}

/// The video's encoder, tested before anything is rendered.
fn encoder(options: &video::VideoOptions) -> Result<video::Encoder, CompareError> {
    let codec = Codec::for_browsers(&options.ffmpeg).map_err(video::ReviewVideoError::from)?;
    Ok(video::Encoder { ffmpeg: options.ffmpeg.clone(), codec })
}

fn offset_results(renderer: &dyn Renderer, truth: &Truth) -> Vec<OffsetResult> {
    let capture = renderer.capture();
    let frame_s = Some(capture.frame_s()).filter(|f| *f > 0.0);
    let finite = |v: Option<f64>| v.filter(|v| v.is_finite());
    capture
        .cameras
        .iter()
        .enumerate()
        .map(|(index, filmed)| {
            let row = renderer.offsets().cameras.iter().find(|o| o.id == filmed.id);
            let offset_s = finite(row.and_then(|r| r.offset_s));
            let std_err_s = finite(row.and_then(|r| r.std_err_s));
            let truth_s = finite(truth.offset_s(&filmed.id));
            let error_s = offset_s.zip(truth_s).map(|(o, t)| o - t);
            let frames = |s: Option<f64>| s.zip(frame_s).map(|(s, f)| s / f);
            OffsetResult {
                camera: filmed.id.clone(),
                shares_clock: filmed.clock.shared || index == capture.reference,
                offset_s,
                std_err_s,
                truth_s,
                error_frames: frames(error_s),
                std_err_frames: frames(std_err_s),
                z: error_s.zip(std_err_s).filter(|(_, s)| *s > 0.0).map(|(e, s)| e / s),
                reason: row.and_then(|r| r.reason.clone()),
            }
        })
        .collect()
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
