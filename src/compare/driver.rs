//! The driver: every instant of the truth, then the folder's files.

use super::results::{self, CaptureFacts, Metrics, OffsetResult, StageTime};
use super::{
    CompareError, CompareOptions, Renderer, Summary, instant, report, review, truths, video,
};
use crate::capture::{Capture, Truth, write_atomically};
use crate::progress::Reporter;
use crate::video::Codec;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// Compares what the renderer makes with the truth, and writes the folder `out`.
///
/// Views of the truth that stand where a filming camera does measure its synchronized image; the
/// others are blended from each camera's nearest frame (traditional LFR), from the synchronized
/// images (ST-LFR), and from the true ones (perfect sync).
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
    options.check(renderer)?;
    let instants = truths::instants(truth, capture)?;
    let codec = options.video.as_ref().map(|v| Codec::for_browsers(&v.ffmpeg)).transpose();
    let codec = codec.map_err(video::VideoError::from)?;

    let mut stages = Stages(renderer.timings());
    let task = reporter.task("Comparing with the truth", truth.views.len());
    let rungs = options.rungs(renderer);
    let mut found = instant::Found::default();
    let work = instant::Work { renderer, truth, options, out, rungs: &rungs };
    for instant in &instants {
        work.compare(instant, &mut found, &mut stages)?;
        task.advance(instant.views.len());
    }
    drop(task);

    let offsets = offset_results(renderer, truth);
    let metrics = Metrics {
        format: "stlfr-metrics",
        version: 1,
        stlfr: env!("CARGO_PKG_VERSION"),
        capture: facts(capture, truth),
        options: options.clone(),
        renderer: renderer.options(),
        headline: results::headline(options, &offsets, &found.sync, &found.views),
        offsets,
        sync: found.sync,
        views: found.views,
    };
    write_json(&out.join("metrics.json"), &metrics)?;
    // A failing video is told once everything else is written.
    let video = match (codec, &options.video) {
        (Some(codec), Some(video_options)) => stages
            .time("video", || {
                let plan = video::Plan::new(renderer, Some(truth), video_options)?;
                let ffmpeg = &video_options.ffmpeg;
                plan.write(renderer, &options.sync, codec, ffmpeg, out, reporter)
            })
            .map(Some),
        _ => Ok(None),
    };
    stages.0.push(StageTime {
        stage: "comparison in all".into(),
        seconds: start.elapsed().as_secs_f64(),
    });
    write_json(&out.join("timings.json"), &serde_json::json!({ "stages": stages.0 }))?;
    let report = out.join("report.html");
    let made = video.as_ref().ok().and_then(Option::as_ref);
    let html = report::html(&metrics, &stages.0, &found.figures, made.map(|m| m.path.as_path()))?;
    write(&report, html.as_bytes())?;
    let review = out.join(review::FILE);
    write_json(&review, &review::layout(&metrics, made))?;
    Ok(Summary { headline: metrics.headline, report, review, video: video?.map(|v| v.path) })
}

/// Times of the stages, each the sum of its parts.
pub(super) struct Stages(Vec<StageTime>);

impl Stages {
    /// Runs one part of a stage.
    pub fn time<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let seconds = start.elapsed().as_secs_f64();
        match self.0.iter_mut().find(|s| s.stage == stage) {
            Some(known) => known.seconds += seconds,
            None => self.0.push(StageTime { stage: stage.to_owned(), seconds }),
        }
        result
    }
}

fn offset_results(renderer: &dyn Renderer, truth: &Truth) -> Vec<OffsetResult> {
    let capture = renderer.capture();
    let estimated = renderer.offsets();
    let frame_s = Some(capture.frame_s()).filter(|f| *f > 0.0);
    let finite = |v: Option<f64>| v.filter(|v| v.is_finite());
    capture
        .cameras
        .iter()
        .enumerate()
        .map(|(index, filmed)| {
            let row = estimated.iter().find(|o| o.id == filmed.id);
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

fn write(path: &Path, bytes: &[u8]) -> Result<(), CompareError> {
    write_atomically(path, bytes)
        .map_err(|source| CompareError::Write { path: path.to_owned(), source })
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), CompareError> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| CompareError::Write { path: path.to_owned(), source: e.into() })?;
    text.push('\n');
    write(path, text.as_bytes())
}
