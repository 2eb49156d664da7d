//! `stlfr setup`, `stlfr capture`, `stlfr check` and `stlfr demo`: the commands that need the Python environment.

use super::error::written;
use super::files::{CommandOutput, must_be_a_file, open_capture};
use super::print::Page;
use super::values::image_size;
use super::{CliError, compare};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::capture::{Capture, MAX_FRAMES};
use stlfr::compare::FILES;
use stlfr::host::write_json;
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::rig::Rig;
use stlfr::toolchain::{
    Check, CheckVerdict, FilmOptions, FilmedScene, build_extension, check, ensure_environment,
    film, project_root,
};

/// Set up the pinned Python environment, once; `demo`, `capture` and `check` do it by themselves.
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

/// Film a scene in Blender with a simulated camera rig. After an interruption, the same command
/// continues.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr capture rigs/linear8.json --scene magazine -o .captures/magazine --size 320x240\n  \
    stlfr capture rigs/linear8.json --blend my-scene.blend -o .captures/mine --frames 30\n\n\
    In a .blend, an object named `rig` (or else the scene's camera) says where the rig stands.")]
#[command(group = clap::ArgGroup::new("source").required(true))]
pub struct CaptureArgs {
    /// The rig's file, such as rigs/linear8.json.
    rig: PathBuf,
    /// A scene of blender/scenes.
    #[arg(long, value_name = "NAME", group = "source")]
    scene: Option<String>,
    /// A .blend file of your own.
    #[arg(long, value_name = "FILE", group = "source")]
    blend: Option<PathBuf>,
    /// The capture's folder.
    #[arg(short, long = "output", value_name = "CAPTURE")]
    output: PathBuf,
    /// Size at which all cameras film, of the same aspect as in the rig.
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    size: Option<(u32, u32)>,
    /// Frames of the reference camera; the others film as long [default: 9].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES as i64))]
    frames: Option<u32>,
    /// Samples a pixel, four times as many for truth [default: 16].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    samples: Option<u32>,
    /// Blender's render engine. Workbench is many times faster, and lacks shadows and highlights.
    #[arg(long, value_name = "ENGINE", value_parser = ["cycles", "workbench"])]
    engine: Option<String>,
    /// Instants at which the truth is rendered [default: 3].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    instants: Option<u32>,
    /// The instants of the truth, in seconds on the reference camera's clock, such as 0.1,0.15.
    #[arg(
        long,
        value_name = "T,T",
        value_delimiter = ',',
        conflicts_with = "instants",
        allow_hyphen_values = true
    )]
    instants_s: Vec<f64>,
    /// Points of the scene whose tracks belong to the truth [default: 0].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    tracks: Option<u32>,
    /// Frames of true slow motion from the rig's first view [default: 0].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=MAX_FRAMES as i64))]
    truth_video: Option<u32>,
    /// Film without truth.
    #[arg(long)]
    no_truth: bool,
    /// Store each camera's frames as one lossless video (FFV1 in Matroska) in place of images.
    #[arg(long)]
    video: bool,
}

pub fn run_capture(
    args: &CaptureArgs,
    page: &mut Page,
    reporter: &Reporter,
) -> Result<(), CliError> {
    // Wrong arguments are errors before a set-up that may take minutes.
    for file in std::iter::once(&args.rig).chain(&args.blend) {
        must_be_a_file(file)?;
    }
    Rig::read(&args.rig)?;
    CommandOutput::Capture(&args.output).check(None)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    film(&environment, &args.options(), reporter)?;
    page.line(args.output.display());
    Ok(())
}

impl CaptureArgs {
    fn options(&self) -> FilmOptions {
        FilmOptions {
            rig: self.rig.clone(),
            scene: match (&self.scene, &self.blend) {
                (_, Some(file)) => FilmedScene::Blend(file.clone()),
                (name, None) => FilmedScene::Named(name.clone().unwrap_or_default()),
            },
            capture: self.output.clone(),
            size_px: self.size,
            frames: self.frames,
            samples: self.samples,
            engine: self.engine.clone(),
            instants: self.instants,
            instants_s: self.instants_s.clone(),
            tracks: self.tracks,
            truth_video: self.truth_video,
            truth: !self.no_truth,
            video: self.video,
        }
    }
}

/// Check a capture's calibration against COLMAP: projections, and a reconstruction from the pixels
/// of one instant.
///
/// The last line is the verdict: the calibration is right, it is off, or the images can't tell.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr check .captures/demo\n  \
    stlfr check .captures/demo --json check.json")]
pub struct CheckArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// File for the measured values.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run_check(args: &CheckArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    // A wrong capture or output is an error before a set-up that may take minutes.
    open_capture(&args.capture, args.json.as_deref().map(CommandOutput::File), reporter)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    let check = check(&environment, &args.capture, reporter)?;
    if let Some(json) = &args.json {
        written(json, write_json(json, &check.values))?;
    }
    for line in &check.table {
        page.line(line);
    }
    if check.verdict == CheckVerdict::Right { Ok(()) } else { Err(refuted(check)) }
}

/// The error of a calibration that isn't confirmed.
fn refuted(mut check: Check) -> CliError {
    CliError::Failure(check.table.pop().unwrap_or_default())
}

/// Everything, end to end: set up, film a scene with eight cameras that are not synchronized,
/// check the calibration, reconstruct, and compare with the truth.
///
/// If it is interrupted, the same command resumes it; frames that were filmed are used again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr demo\n  \
    stlfr demo --size 640x480 --video -o .captures/demo-large")]
pub struct DemoArgs {
    /// Size of the images.
    #[arg(long, value_name = "WxH", default_value = "320x240", value_parser = image_size)]
    size: (u32, u32),
    /// Frames a camera [default: 9]; 3 instants between them are compared.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(5..=100_000))]
    frames: Option<u32>,
    /// Samples a pixel [default: 16].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    samples: Option<u32>,
    /// A video too: truth, traditional and space-time light field side by side.
    #[arg(long)]
    video: bool,
    /// The capture's folder [default: .captures/demo in the source folder; what is filmed with
    /// other options than the defaults has a folder of its own beside it].
    #[arg(short, long, value_name = "CAPTURE")]
    output: Option<PathBuf>,
}

/// Frames of the true slow motion that `--video` shows.
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
    /// Sets up, films, and checks the calibration.
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
        // Images that can't tell don't refute what was filmed.
        if check.verdict == CheckVerdict::Off { Err(refuted(check)) } else { Ok(capture) }
    }

    /// The capture's folder name, which differs for other options.
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
        }
    }
}
