//! `stlfr import` and `stlfr export`

use super::CliError;
use super::files::{CommandOutput, open_capture};
use std::path::{Path, PathBuf};
use stlfr::exchange::{self, ExchangeError, ImportClock, NamedCamera};
use stlfr::progress::Reporter;

/// Make a capture from another program's calibration and from image sequences.
///
/// The calibration is a folder with a COLMAP model, or a file `transforms.json` or
/// `poses_bounds.npy`, which has no names: its rows are the folders in the order of the numbers in their
/// names. Images are copied.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr import sparse/0 --images frames --rate 30 -o .captures/mine\n  \
    stlfr import transforms.json --images frames --rate 29.97 -o .captures/mine")]
pub struct ImportArgs {
    /// The calibration's folder or file.
    calibration: PathBuf,
    /// The folder with a sub-folder of images for each camera.
    #[arg(long, value_name = "FOLDER")]
    images: PathBuf,
    /// Frames a second.
    #[arg(long, value_name = "HZ")]
    rate: f64,
    /// The first frame's time on each camera's own clock, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    first: f64,
    /// All cameras share one clock: there is nothing to estimate.
    #[arg(long)]
    shared: bool,
    /// The capture to make: a new folder.
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
}

/// Write a capture's calibration for another program. Frames are not copied.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr export .captures/demo --format colmap -o sparse/0\n  \
    stlfr export .captures/demo --format llff --near 1 --far 6 -o poses_bounds.npy")]
pub struct ExportArgs {
    /// The capture's folder.
    capture: PathBuf,
    #[arg(long)]
    format: Format,
    /// The nearest depth, metres (llff).
    #[arg(long, value_name = "METRES", required_if_eq("format", "llff"))]
    near: Option<f64>,
    /// The farthest depth, metres (llff).
    #[arg(long, value_name = "METRES", required_if_eq("format", "llff"))]
    far: Option<f64>,
    /// The folder for COLMAP's files, or the file of another format.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Format {
    /// COLMAP's model in binary files.
    Colmap,
    /// COLMAP's model in text files.
    ColmapText,
    /// LLFF's poses_bounds.npy, in the order of the numbers in the cameras' ids.
    Llff,
    /// NeRF's transforms.json.
    Nerf,
}

pub fn run_import(args: &ImportArgs, reporter: &Reporter) -> Result<(), CliError> {
    if !(args.rate.is_finite() && args.rate > 0.0 && args.first.is_finite()) {
        return Err(CliError::BadInput("--rate must be positive and --first finite".into()));
    }
    CommandOutput::Capture(&args.output).check(None)?;
    let cameras = read(&args.calibration)?;
    let clock = ImportClock { rate_hz: args.rate, first_s: args.first, shared: args.shared };
    if let Some(note) = exchange::import(&cameras, &args.images, clock, &args.output)? {
        reporter.note(&note);
    }
    Ok(())
}

fn read(calibration: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    match calibration.extension().and_then(|e| e.to_str()) {
        Some("npy") => exchange::read_llff(calibration),
        Some("json") => exchange::read_nerf(calibration),
        _ => exchange::read_colmap(calibration),
    }
}

pub fn run_export(args: &ExportArgs, reporter: &Reporter) -> Result<(), CliError> {
    let bounds_m = (args.near.unwrap_or(0.0), args.far.unwrap_or(0.0));
    if matches!(args.format, Format::Llff)
        && !(bounds_m.0 > 0.0 && bounds_m.1 > bounds_m.0 && bounds_m.1.is_finite())
    {
        return Err(CliError::BadInput("--near must be positive and --far larger".into()));
    }
    let output = &args.output;
    let written = match args.format {
        Format::Colmap => CommandOutput::Folder(output, &exchange::COLMAP_BINARY_FILES),
        Format::ColmapText => CommandOutput::Folder(output, &exchange::COLMAP_TEXT_FILES),
        Format::Llff | Format::Nerf => CommandOutput::File(output),
    };
    let capture = open_capture(&args.capture, Some(written), reporter)?;
    let cameras: Vec<NamedCamera> = capture
        .cameras
        .iter()
        .map(|c| NamedCamera { name: format!("{}/0000.png", c.id), camera: c.camera.clone() })
        .collect();
    match args.format {
        Format::Colmap => exchange::write_colmap_binary(output, &cameras)?,
        Format::ColmapText => exchange::write_colmap_text(output, &cameras)?,
        Format::Llff => exchange::write_llff(output, &cameras, bounds_m)?,
        Format::Nerf => exchange::write_nerf(output, &cameras)?,
    }
    Ok(())
}
