//! The command `stlfr import`, which makes a capture from recordings and a calibration of another program.

use super::CliError;
use super::files::CommandOutput;
use crate::capture::Opening;
use crate::exchange::{self, ImportClock, ImportRequest};
use crate::progress::Reporter;
use crate::toolchain::find_ffmpeg;
use std::path::PathBuf;

/// Make a capture from another program's calibration and from videos or image sequences.
///
/// The calibration is a folder with a COLMAP model, or a file: transforms.json, poses_bounds.npy, Calib.toml of Anipose
/// or Pose2Sim, camera_array.toml of caliscope, Qualisys' .qca.txt, or another capture's capture.json. The recording of
/// a camera is the video or the folder of images that has the camera's name, or else its number. Images are copied, and
/// videos are linked. Of a damaged video, the intact frames are stored as images, and the others are left out. Notes
/// say which recording each camera has, where the times come from, how many frames are damaged, and which lenses are
/// scaled.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr import sparse/0 --images frames --rate 30 -o .captures/mine\n  \
    stlfr import Calib.toml --images videos -o .captures/mine\n  \
    stlfr import camera_array.toml --images recording_1 --times recording_1/timestamps.csv -o .captures/mine\n  \
    stlfr import transforms.json -o .captures/mine\n\n\
    A table of --table has the columns camera and frames, one of --times camera and time_s (or time_ms, time_us, time_ns).")]
pub struct ImportArgs {
    /// The calibration's folder or file.
    calibration: PathBuf,
    /// Folder with a video or a sub-folder of images for each camera [default for a .json: the folder of the .json].
    #[arg(long, value_name = "FOLDER")]
    images: Option<PathBuf>,
    /// A CSV table of cameras and their recordings.
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    #[command(flatten)]
    clocks: ClockArgs,
    /// Treat images that are smaller than the calibrated image as its top left part.
    #[arg(long)]
    crop: bool,
    /// Unit of the calibration's lengths; Qualisys files are always in millimetres.
    #[arg(long, value_enum, default_value = "m")]
    unit: Unit,
    /// The folder of the new capture.
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
}

/// Arguments for the clocks of imported cameras.
#[derive(Debug, clap::Args)]
pub struct ClockArgs {
    /// Frame rate, in hertz [default: the times of the videos, of timestamps.csv or of the calibration].
    #[arg(long, value_name = "HZ", conflicts_with = "times")]
    pub rate: Option<f64>,
    /// Time of the first frame on each camera's own clock, in seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    pub first: f64,
    /// A CSV table with the time of every frame.
    #[arg(long, value_name = "FILE")]
    pub times: Option<PathBuf>,
    /// All cameras share one clock, and offsets are not estimated.
    #[arg(long)]
    pub shared: bool,
    /// Readout time of the cameras' rolling shutters, from the first row to the last, in seconds. The time of a frame
    /// is the time of its middle row.
    #[arg(long, value_name = "SECONDS")]
    pub readout: Option<f64>,
    /// Standard error of the readout time, in seconds. If it is given, each camera's readout time is estimated together
    /// with the offsets, as far as the images show it. Cameras that share one clock have no offsets to estimate.
    #[arg(long, value_name = "SECONDS", requires = "readout")]
    pub readout_std: Option<f64>,
}

impl ClockArgs {
    /// Returns whether any of these arguments is given.
    pub fn are_given(&self) -> bool {
        let is_any = self.rate.is_some() || self.times.is_some() || self.readout.is_some();
        is_any || self.shared || self.first != 0.0
    }

    /// Checks the arguments, and returns the clock that they describe for every camera.
    pub fn clock(&self) -> Result<ImportClock, CliError> {
        let is_rate = |rate: f64| rate.is_finite() && rate > 0.0;
        if !(self.rate.is_none_or(is_rate) && self.first.is_finite()) {
            return Err(CliError::BadInput("--rate must be positive and --first finite".into()));
        }
        let is_readout = |readout_s: f64| readout_s.is_finite() && readout_s >= 0.0;
        for (flag, value_s) in [("--readout", self.readout), ("--readout-std", self.readout_std)] {
            if !value_s.is_none_or(is_readout) {
                let reason = format!("{flag} must be a number of seconds from 0 on");
                return Err(CliError::BadInput(reason));
            }
        }
        Ok(ImportClock {
            rate_hz: self.rate,
            first_s: self.first,
            shared: self.shared,
            readout_s: self.readout,
            readout_std_s: self.readout_std,
        })
    }
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Unit {
    M,
    Cm,
    Mm,
}

pub fn run(args: &ImportArgs, reporter: &Reporter) -> Result<(), CliError> {
    let clock = args.clocks.clock()?;
    CommandOutput::Capture(&args.output).check(None)?;
    let unit_m = match args.unit {
        Unit::M => 1.0,
        Unit::Cm => 0.01,
        Unit::Mm => 0.001,
    };
    let cameras = exchange::read_calibration(&args.calibration, unit_m)?;
    let is_json = args.calibration.extension().is_some_and(|e| e == "json");
    let own = args.calibration.parent().filter(|_| is_json);
    let images = args.images.as_deref().or(own).ok_or_else(|| {
        CliError::BadInput("--images must name the folder of the cameras' recordings".into())
    })?;
    let (table, times) = (args.table.as_deref(), args.clocks.times.as_deref());
    let request = ImportRequest {
        images,
        table,
        times,
        clock,
        is_cropped: args.crop,
        is_uncalibrated: false,
    };
    let ffmpeg = find_ffmpeg();
    let opening = Opening { ffmpeg: ffmpeg.as_deref(), reporter };
    for note in exchange::import(&cameras, &request, &args.output, &opening)? {
        reporter.note(&note);
    }
    Ok(())
}
