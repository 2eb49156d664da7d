//! The command `stlfr compare`, which compares rendered views with the ground truth.

use super::CliError;
use super::files::{CommandOutput, OptionsArgs, ffmpeg_for, open_capture};
use super::print::{Page, decimals};
use crate::capture::{Capture, Truth};
use crate::compare::results::{Headline, MethodHeadline, ViewMethod};
use crate::compare::video::VideoOptions;
use crate::compare::{
    CompareOptions, ComparedLightField, FILES, Renderer, Summary, compare, errors_frames,
    score_offsets,
};
use crate::json;
use crate::method::Method;
use crate::metrics::Scores;
use crate::offset::{MAX_OFFSETS_BYTES, Offsets};
use crate::options::RenderOptions;
use crate::progress::Reporter;
use crate::toolchain::{Environment, project_root, review};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Compare rendered views with the ground truth, and with traditional light field rendering. Write pictures,
/// metrics.json and report.html.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr compare .captures/demo\n  \
    stlfr compare .captures/demo --video -o review\n  \
    stlfr compare .captures/demo --offsets mine.json")]
pub struct CompareArgs {
    /// The capture's folder; the capture must have ground truth.
    capture: PathBuf,
    /// Folder of the report [default: CAPTURE/review].
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Also write a video: ground truth, traditional and space-time light field rendering side by side.
    #[arg(long)]
    video: bool,
    /// Only score the offsets in this file, which has the format that `stlfr offsets --json` prints.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["output", "video", "options", "preset", "set"])]
    offsets: Option<PathBuf>,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &CompareArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if let Some(file) = &args.offsets {
        return print_scores(&args.capture, file, page, reporter);
    }
    let options = args.options.read()?;
    let out = args.output.clone().unwrap_or_else(|| args.capture.join("review"));
    let output = CommandOutput::Folder(&out, &FILES);
    let capture = open_capture(&args.capture, Some(output), reporter)?;
    let summary = with_truth(capture, &options, &out, args.video, reporter)?;
    print(&summary, page);
    Ok(())
}

/// Compares the temporal offsets in a file with the ground truth, and prints their errors.
fn print_scores(
    folder: &Path,
    file: &Path,
    page: &mut Page,
    reporter: &Reporter,
) -> Result<(), CliError> {
    let capture = open_capture(folder, None, reporter)?;
    let truth = Truth::open(folder)?.ok_or_else(|| {
        CliError::BadInput(format!("{}: has no truth to score against", folder.display()))
    })?;
    let wrong = |reason: String| CliError::BadInput(format!("{}: {reason}", file.display()));
    let offsets: Offsets =
        json::read_within(file, MAX_OFFSETS_BYTES).map_err(|e| wrong(e.to_string()))?;
    let reference = &capture.cameras[capture.reference].id;
    let cameras = score_offsets(&offsets, &truth, reference, capture.frame_s()).map_err(wrong)?;
    page.line(format_args!(
        "{:<12} {:>12} {:>12} {:>14} {:>8}",
        "camera", "true", "given", "error", "z"
    ));
    for camera in &cameras {
        let digits = decimals(camera.std_err_s.map(|s| 1e3 * s));
        let frame_digits = decimals(camera.std_err_frames);
        let error = camera
            .error_frames
            .map_or("unknown".to_owned(), |frames| format!("{frames:+.frame_digits$} frame"));
        page.line(format_args!(
            "{:<12} {:>9.digits$} ms {:>12} {:>14} {:>8}",
            camera.camera,
            1e3 * camera.truth_s.unwrap_or(f64::NAN),
            camera.offset_s.map_or("-".to_owned(), |s| format!("{:.digits$} ms", 1e3 * s)),
            error,
            camera.z.map_or("-".to_owned(), |z| format!("{z:+.2}")),
        ));
    }
    let errors = errors_frames(&cameras);
    match errors.last() {
        Some(worst) => page.line(format_args!(
            "{} of {} cameras: median error {:.5} frame, worst {worst:.5}",
            errors.len(),
            cameras.len(),
            errors[(errors.len() - 1) / 2],
        )),
        None => page.line(format_args!("0 of {} cameras", cameras.len())),
    }
    Ok(())
}

/// Renders views, compares them with the ground truth, and writes the report into the folder `out`. If `video` is true,
/// also writes a video.
pub fn with_truth(
    capture: Arc<Capture>,
    options: &RenderOptions,
    out: &Path,
    video: bool,
    reporter: &Reporter,
) -> Result<Summary, CliError> {
    let ffmpeg = video.then(|| ffmpeg_for("--video")).transpose()?;
    let truth = Truth::open(&capture.folder)?;
    let field = ComparedLightField::open(capture, options, reporter)?;
    let compare_options = CompareOptions {
        sync: field.options().sync,
        video: ffmpeg.map(|ffmpeg| VideoOptions { ffmpeg, ..VideoOptions::default() }),
        ..CompareOptions::default()
    };
    let summary = compare(&field, truth.as_ref(), out, &compare_options, reporter)?;
    match project_root().ok().and_then(|root| Environment::find(&root)) {
        Some(environment) => {
            review(&environment, &summary.review, reporter)?;
        }
        None => reporter.note("review.blend needs Blender's Python package: run stlfr setup."),
    }
    Ok(summary)
}

/// Prints the main results of a comparison with the ground truth, and the paths of the written files.
pub fn print(summary: &Summary, page: &mut Page) {
    for line in lines(&summary.headline) {
        page.line(line);
    }
    if let Some(video) = &summary.video {
        page.line(format_args!("video: {}", video.display()));
    }
    let blend = summary.review.with_file_name("review.blend");
    if blend.is_file() {
        page.line(format_args!("review: {}", blend.display()));
    }
    page.line(format_args!("report: {}", summary.report.display()));
}

fn lines(headline: &Headline) -> Vec<String> {
    let shown = |value: Option<f64>, unit: &str, decimals: usize| match value {
        Some(value) => format!("{value:.decimals$} {unit}"),
        None => "unknown".to_owned(),
    };
    let (offset, sync) = (&headline.offset, &headline.sync);
    let mut lines = vec![
        format!(
            "offsets: worst error {}, median {}; {} of {} unknown clocks estimated",
            shown(offset.worst_frames, "frame", 4),
            shown(offset.median_frames, "frame", 4),
            offset.estimated,
            offset.unknown_clocks,
        ),
        format!(
            "synchronized images, {}: {} over the nearest frame on the moving part (median of {}; least {})",
            sync.method.name(),
            shown(sync.median_gain_db, "dB", 2),
            sync.images,
            shown(sync.least_gain_db, "dB", 2),
        ),
    ];
    lines.extend(table(&headline.methods));
    if headline.missing_images > 0 {
        let reason = headline.missing_reason.as_deref().unwrap_or_default();
        let remedy = if reason.contains("clock is unknown") {
            "; film more motion and texture, or write the offset into offsets.json"
        } else {
            ""
        };
        lines.push(format!(
            "{} of {} images could not be made, most often because {reason}{remedy}; the report says which",
            headline.missing_images, headline.wanted_images
        ));
    }
    lines
}

/// Returns the lines of the score table. It has traditional light field rendering with one geometry proxy, space-time
/// light field rendering with every proxy, and light field rendering of perfectly synchronized images with the proxy
/// that `stlfr render` uses.
fn table(methods: &[MethodHeadline]) -> Vec<String> {
    let Some(baseline) = methods.first() else { return Vec::new() };
    let rendered = methods.iter().find(|m| m.is_rendered).map(|m| m.proxy);
    let number = |value: Option<f64>, width: usize, decimals: usize| match value {
        Some(value) => format!("{value:>width$.decimals$}"),
        None => format!("{:>width$}", "-"),
    };
    let cells =
        |s: &Scores| [number(s.psnr_db, 8, 2), number(s.ssim, 7, 3), number(s.flip, 7, 3)].concat();
    let row = |m: &MethodHeadline| {
        let mark = if m.is_rendered { "*" } else { "" };
        let name = format!("{mark:<2}{}, {}", m.method.help(), m.proxy.name());
        format!("{name:<30}{}{}", cells(&m.scores.moving), cells(&m.scores.whole))
    };
    let shown = |m: &&MethodHeadline| match m.method {
        ViewMethod::TraditionalLfr => m.proxy == baseline.proxy,
        ViewMethod::StLfr => true,
        ViewMethod::PerfectSync => Some(m.proxy) == rendered,
    };
    let head = format!(
        "{:<30}{:>22}{:>22}",
        format!("median of {} views", baseline.views),
        "moving: dB, SSIM, FLIP",
        "whole: dB, SSIM, FLIP"
    );
    let rows = methods.iter().filter(shown).map(row);
    let note =
        "* what render uses with these options; the first row is the same whatever the options";
    std::iter::once(head).chain(rows).chain([note.to_owned()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::RegionScores;
    use crate::options::ProxyMethod;

    #[test]
    fn the_table_has_one_baseline_and_marks_what_render_uses() {
        let mut methods = Vec::new();
        for method in ViewMethod::ALL {
            for proxy in [ProxyMethod::Plane, ProxyMethod::Mesh] {
                let whole = Scores { psnr_db: Some(31.0), ..Scores::default() };
                let moving = Scores { psnr_db: Some(25.5), ssim: Some(0.9), ..whole };
                methods.push(MethodHeadline {
                    proxy,
                    method: *method,
                    is_rendered: *method == ViewMethod::StLfr && proxy == ProxyMethod::Mesh,
                    scores: RegionScores { whole, moving },
                    views: 2,
                });
            }
        }
        let lines = table(&methods);
        assert_eq!(lines.iter().filter(|l| l.contains("Traditional LFR")).count(), 1);
        let marked: Vec<_> = lines.iter().filter(|l| l.starts_with("* ST-LFR, mesh")).collect();
        assert!(
            marked.len() == 1 && marked[0].contains("25.50  0.900      -   31.00"),
            "{lines:?}"
        );
        assert!(lines.iter().any(|l| l.contains("Perfect sync, mesh")) && lines.len() == 6);
        assert!(table(&[]).is_empty());
    }
}
