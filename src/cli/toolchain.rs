//! The commands `stlfr setup`, `stlfr check` and `stlfr demo`, which need the Python environment.

use super::error::written;
use super::files::{CommandOutput, open_capture};
use super::print::Page;
use super::values::image_size;
use super::{CliError, compare};
use crate::capture::Capture;
use crate::compare::FILES;
use crate::host::write_json;
use crate::options::RenderOptions;
use crate::progress::Reporter;
use crate::toolchain::{
    Check, FilmOptions, FilmedScene, build_extension, check, ensure_environment, film, project_root,
};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Set up the Python environment with pinned versions; `demo`, `capture` and `check` do this by themselves.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr setup\n  \
    stlfr setup --extension stlfr.zip")]
pub struct SetupArgs {
    /// Also build the Blender extension, to be installed from disk in Blender's preferences.
    #[arg(long, value_name = "FILE.zip")]
    extension: Option<PathBuf>,
}

pub fn run_setup(args: &SetupArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if let Some(zip) = &args.extension {
        if zip.extension().is_none_or(|e| e != "zip") {
            return Err(CliError::BadInput("--extension: must name a .zip".into()));
        }
        CommandOutput::File(zip).check(None)?;
    }
    let environment = ensure_environment(&project_root()?, reporter)?;
    let Some(zip) = &args.extension else {
        page.line(environment.python.display());
        return Ok(());
    };
    build_extension(&environment, zip, reporter)?;
    page.line(zip.display());
    Ok(())
}

/// Check a capture's calibration against COLMAP: by projections, and by a reconstruction from the images of one
/// instant.
///
/// The last line is the verdict: the calibration is right, the calibration is wrong (exit code 1), or the images can't
/// decide. The exit code is also 1 if the program's own projections are inconsistent.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr check .captures/demo\n  \
    stlfr check .captures/demo --json check.json")]
pub struct CheckArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// JSON file for the measured values.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run_check(args: &CheckArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    // An invalid capture or output is reported before the set-up of the Python environment, which may take minutes.
    open_capture(&args.capture, args.json.as_deref().map(CommandOutput::File), reporter)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    let check = check(&environment, &args.capture, reporter)?;
    if let Some(json) = &args.json {
        written(json, write_json(json, &check.values))?;
    }
    for line in &check.table {
        page.line(line);
    }
    if check.verdict.is_failure() { Err(refuted(check)) } else { Ok(()) }
}

/// Returns the error for a calibration check with a negative verdict. The message is the verdict, which is the last
/// line of the check's table.
fn refuted(mut check: Check) -> CliError {
    CliError::Failure(check.table.pop().unwrap_or_default())
}

/// Run the whole program, end to end: set up, film a scene with eight cameras that are not synchronized, check the
/// calibration, reconstruct, and compare with the ground truth.
///
/// After an interruption, the same command continues, and keeps the frames that were filmed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr demo\n  \
    stlfr demo --size 640x480 --video -o .captures/demo-large")]
pub struct DemoArgs {
    /// Size of the images.
    #[arg(long, value_name = "WxH", default_value = "320x240", value_parser = image_size)]
    size: (u32, u32),
    /// Number of frames per camera [default: 9]. Views at 3 instants between frames are compared.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(5..=100_000))]
    frames: Option<u32>,
    /// Samples per pixel [default: 16].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    samples: Option<u32>,
    /// Also write a video: ground truth, traditional and space-time light field rendering side by side.
    #[arg(long)]
    video: bool,
    /// The capture's folder [default: .captures/demo in the source folder; with other options, a folder beside it].
    #[arg(short, long, value_name = "CAPTURE")]
    output: Option<PathBuf>,
}

/// Number of frames of the slow motion that is filmed as ground truth for `--video`.
const VIDEO_FRAMES: u32 = 48;

pub fn run_demo(args: &DemoArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    let capture = args.film(reporter)?;
    reporter.note("Reconstructing, and comparing with the truth.");
    let review = capture.folder.join("review");
    CommandOutput::Folder(&review, &FILES).check(Some(&capture.folder))?;
    let options = RenderOptions::default();
    let summary = compare::with_truth(capture, &options, &review, args.video, reporter)?;
    compare::print(&summary, page);
    Ok(())
}

impl DemoArgs {
    /// Sets up the Python environment, films the capture of the demo, and checks its calibration.
    fn film(&self, reporter: &Reporter) -> Result<Arc<Capture>, CliError> {
        let root = project_root()?;
        let folder =
            self.output.clone().unwrap_or_else(|| root.join(".captures").join(self.name()));
        CommandOutput::Capture(&folder).check(None)?;
        let environment = ensure_environment(&root, reporter)?;
        reporter.note(&format!("Filming the scene magazine into {}.", folder.display()));
        film(&environment, &self.options(&root, folder.clone()), reporter)?;
        let capture = open_capture(&folder, None, reporter)?;
        reporter.note("Checking the calibration with COLMAP.");
        let check = check(&environment, &folder, reporter)?;
        for line in &check.table {
            reporter.note(line);
        }
        if check.verdict.is_failure() { Err(refuted(check)) } else { Ok(capture) }
    }

    /// Returns the name of the capture's folder: `demo` if all options have their defaults, and otherwise a name that
    /// depends on the options.
    fn name(&self) -> String {
        let mut name = "demo".to_owned();
        if self.size != (320, 240) {
            name += &format!("-{}x{}", self.size.0, self.size.1);
        }
        name += &self.frames.map_or(String::new(), |n| format!("-{n}frames"));
        name += &self.samples.map_or(String::new(), |n| format!("-{n}samples"));
        if self.video {
            name += "-video";
        }
        name
    }

    fn options(&self, root: &Path, capture: PathBuf) -> FilmOptions {
        FilmOptions {
            rig: root.join("rigs/linear8.json"),
            scene: FilmedScene::Named("magazine".into()),
            capture,
            size_px: Some(self.size),
            frames: self.frames,
            samples: self.samples,
            engine: None,
            instants: None,
            instants_s: Vec::new(),
            tracks: None,
            truth_video: self.video.then_some(VIDEO_FRAMES),
            truth: true,
            video: false,
            part: None,
            silence_s: None,
        }
    }
}
