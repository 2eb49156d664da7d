//! The commands `stlfr calibrate` and `stlfr refine`, which estimate and refine the calibration of a capture.

use super::CliError;
use super::files::{CommandOutput, open_capture};
use super::import::ClockArgs;
use super::print::{Page, decimals};
use crate::capture::{CAPTURE_FILE, Capture, Opening};
use crate::exchange::{self, Draft, NewCalibration};
use crate::progress::Reporter;
use crate::toolchain::{
    Calibration, CalibrationRequest, calibrate, ensure_environment, find_ffmpeg, project_root,
};
use std::path::{Path, PathBuf};

/// Make a capture from recordings whose calibration is missing or not trusted.
///
/// The cameras must not move. Their poses and lenses are estimated from the static part of the scene, which is the
/// median of each camera's frames. The cameras therefore need not be synchronized. The static part must be textured,
/// and neighbouring cameras must see the same part of it. Images do not determine the scale: give --distance for true
/// metres. If all cameras look in one direction, images do not determine the focal length either: give --focal, or
/// depths are wrong by the error of a guessed focal length.
///
/// If a capture is given, its calibration is not read, and its ground truth, offsets and COLMAP model are not copied.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr calibrate videos -o .captures/mine\n  \
    stlfr calibrate videos --distance cam0 cam7 0.42 -o .captures/mine\n  \
    stlfr calibrate frames --rate 30 --focal 1450 --lens PINHOLE -o .captures/mine\n  \
    stlfr calibrate .captures/imported -o .captures/mine")]
pub struct CalibrateArgs {
    /// A folder with a video or a sub-folder of images for each camera, or a capture.
    recordings: PathBuf,
    /// Two cameras and the distance between their centres, in metres.
    #[arg(long, num_args = 3, value_names = ["CAMERA", "CAMERA", "METRES"])]
    distance: Option<Vec<String>>,
    /// Focal length of all cameras, in pixels [default: estimated].
    #[arg(long, value_name = "PX")]
    focal: Option<f64>,
    /// Lens model, by its name in COLMAP.
    #[arg(long, value_name = "MODEL", default_value = "SIMPLE_RADIAL",
        value_parser = ["PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"])]
    lens: String,
    #[command(flatten)]
    clocks: ClockArgs,
    /// Folder of the new capture.
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
}

/// Refine a capture's calibration by the static part of its images, and write a new capture.
///
/// Bundle adjustment refines the poses. With --focal and --principal-point, it also refines these lens parameters. The
/// given capture is not changed. The mean position, the direction and the size of the array stay the same. Parameters
/// that the images do not determine keep their given values. The covariance of the result is saved with the new
/// capture, and is included in the standard errors of its offsets. If focal lengths may be wrong, give --focal:
/// otherwise the error of a focal length becomes an error of the poses.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr refine .captures/mine -o .captures/refined\n  \
    stlfr refine .captures/mine --focal --principal-point -o .captures/refined")]
pub struct RefineArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Refine focal lengths too. The given focal lengths are assumed to have a standard error of 1 %.
    #[arg(long)]
    focal: bool,
    /// Refine principal points too. The given points are assumed to have a standard error of 0.5 % of the image's
    /// width.
    #[arg(long)]
    principal_point: bool,
    /// Folder of the new capture.
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
}

pub fn run(args: &CalibrateArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if args.focal.is_some_and(|px| !(px > 0.0 && px < 1e6)) {
        return Err(CliError::BadInput("--focal: must be positive pixels".into()));
    }
    let distance_m = args.distance.as_deref().map(distance).transpose()?;
    let clock = args.clocks.clock()?;
    CommandOutput::Capture(&args.output).check(Some(&args.recordings))?;
    exchange::require_new(&args.output)?;
    let request =
        CalibrationRequest::New { lens: args.lens.clone(), focal_px: args.focal, distance_m };
    if args.recordings.join(CAPTURE_FILE).exists() {
        if args.clocks.are_given() {
            let reason = "--rate, --first, --times, --shared and --readout are of recordings, and a capture has its clocks";
            return Err(CliError::BadInput(reason.into()));
        }
        return calibrated(&args.recordings, &request, &args.output, page, reporter);
    }
    let ffmpeg = find_ffmpeg();
    let opening = Opening { ffmpeg: ffmpeg.as_deref(), reporter };
    let times = args.clocks.times.as_deref();
    let draft = Draft::import(&args.recordings, times, clock, &args.output, &opening)?;
    for note in &draft.notes {
        reporter.note(note);
    }
    calibrated(&draft.folder, &request, &args.output, page, reporter)
}

pub fn run_refine(args: &RefineArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    CommandOutput::Capture(&args.output).check(Some(&args.capture))?;
    exchange::require_new(&args.output)?;
    let (focal, principal_point) = (args.focal, args.principal_point);
    let request = CalibrationRequest::Refinement { focal, principal_point };
    calibrated(&args.capture, &request, &args.output, page, reporter)
}

/// Estimates or refines a calibration from the frames of the capture in `folder`. Writes these frames with the new
/// calibration as the capture `output`.
fn calibrated(
    folder: &Path,
    request: &CalibrationRequest,
    output: &Path,
    page: &mut Page,
    reporter: &Reporter,
) -> Result<(), CliError> {
    // An invalid capture is reported before the set-up of the Python environment, which may take minutes.
    let capture = open_capture(folder, None, reporter)?;
    require_distance(&capture, request)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    let calibration = calibrate(&environment, folder, request, reporter)?;
    let new = NewCalibration {
        cameras: calibration.cameras.iter().map(|c| c.format()).collect(),
        covariance: calibration.covariance.clone(),
    };
    let ffmpeg = find_ffmpeg();
    let opening = Opening { ffmpeg: ffmpeg.as_deref(), reporter };
    exchange::recalibrate(&capture, new, output, &opening)?;
    print_table(&calibration, page);
    for note in &calibration.notes {
        reporter.note(note);
    }
    Ok(())
}

/// Parses the values of `--distance`: the ids of two cameras, and the distance between their centres in metres.
fn distance(values: &[String]) -> Result<([String; 2], f64), CliError> {
    let wrong = |reason: &str| CliError::BadInput(format!("--distance: {reason}"));
    let [first, second, metres] = values else { return Err(wrong("needs three values")) };
    let metres = metres.parse::<f64>().ok().filter(|m| *m > 0.0 && *m < 1e6);
    let metres = metres.ok_or_else(|| wrong("the third value must be positive metres"))?;
    if first == second {
        return Err(wrong("needs two cameras"));
    }
    Ok(([first.clone(), second.clone()], metres))
}

/// Returns an error if `--distance` names a camera that the capture doesn't have.
fn require_distance(capture: &Capture, request: &CalibrationRequest) -> Result<(), CliError> {
    let CalibrationRequest::New { distance_m: Some((ids, _)), .. } = request else {
        return Ok(());
    };
    match ids.iter().find(|id| capture.cameras.iter().all(|c| c.id != **id)) {
        Some(id) => Err(CliError::BadInput(format!("--distance: there is no camera '{id}'"))),
        None => Ok(()),
    }
}

fn print_table(calibration: &Calibration, page: &mut Page) {
    let is_refined = calibration.cameras.iter().any(|c| c.turned_deg.is_some());
    let mut header = format!(
        "{:<12} {:>20} {:>12} {:>12} {:>7} {:>9}",
        "camera", "focal length", "rotation ±", "position ±", "points", "error"
    );
    if is_refined {
        header += &format!(" {:>11} {:>11}", "turned by", "moved by");
    }
    page.line(header);
    for camera in &calibration.cameras {
        let focal_px = camera.focal_px();
        let std_err_px = focal_px * camera.focal_std_err_fraction;
        let focal = if std_err_px > 0.0 {
            let digits = decimals(Some(std_err_px)).min(2);
            format!("{focal_px:.digits$} ± {std_err_px:.digits$} px")
        } else {
            format!("{focal_px:.2} px")
        };
        let mut line = format!(
            "{:<12} {focal:>20} {:>8.4} deg {:>9.2} mm {:>7} {:>6.2} px",
            camera.id,
            camera.rotation_std_err_deg,
            1e3 * camera.position_std_err_m,
            camera.points,
            camera.error_px,
        );
        if let (Some(deg), Some(m)) = (camera.turned_deg, camera.moved_m) {
            line += &format!(" {deg:>7.3} deg {:>8.2} mm", 1e3 * m);
        }
        page.line(line);
    }
    page.line(format_args!("{} points that stand still", calibration.points));
}
