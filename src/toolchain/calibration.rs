//! Calls the Python programs that check, estimate and refine calibrations.

use super::setup::Environment;
use super::{ToolchainError, script};
use crate::camera::{CameraFormat, PoseFormat};
use crate::capture::CalibrationCovarianceFormat;
use crate::progress::Reporter;
use serde::Deserialize;
use serde_json::Value;
use std::ffi::OsString;
use std::path::Path;

/// Result of checking a capture's calibration against its images.
#[derive(Clone, Debug)]
pub struct Check {
    /// Measured values: the JSON object that `blender/check.py` prints.
    pub values: Value,
    /// Verdict that follows from the measured values.
    pub verdict: CheckVerdict,
    /// Lines of a table of the measured values. The last line is a sentence with the verdict.
    pub table: Vec<String>,
}

/// Verdict of a calibration check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckVerdict {
    /// The images confirm the calibration.
    Right,
    /// The images contradict the calibration.
    Off,
    /// The images do not suffice for a verdict.
    Unknown,
    /// The program's own projections differ from those of pycolmap or Blender, so that no verdict is possible.
    Inconsistent,
}

impl CheckVerdict {
    /// Returns whether the check failed, because the calibration or the program itself is wrong. [`Self::Unknown`] is
    /// no failure.
    pub fn is_failure(self) -> bool {
        matches!(self, Self::Off | Self::Inconsistent)
    }
}

/// Checks a capture's calibration against its images. If the calibration is wrong, the verdict of the returned
/// [`Check`] says so; this is not an error.
pub fn check(
    environment: &Environment,
    capture: &Path,
    reporter: &Reporter,
) -> Result<Check, ToolchainError> {
    let mut command = script::command(environment, "check.py");
    command.arg(capture);
    let phase = reporter.phase("checking the calibration");
    let mut stdout = String::new();
    let ended = script::ended(&mut command, |line| {
        stdout.push_str(line);
        stdout.push('\n');
    });
    drop(phase);
    let ended = ended.map_err(|e| ToolchainError::Failure(format!("check.py: {e}")))?;
    let values = serde_json::from_str::<Value>(&stdout);
    let decided = values
        .ok()
        .and_then(|values| Some((CheckVerdict::deserialize(&values["verdict"]).ok()?, values)));
    let Some((verdict, values)) = decided else {
        script::verdict("check.py", &ended)?;
        return Err(ToolchainError::Failure("check.py: printed no result".into()));
    };
    let table = ended.stderr.lines().map(str::to_owned).collect();
    Ok(Check { values, verdict, table })
}

/// A request to estimate or refine a calibration, with the parameters to estimate.
#[derive(Clone, Debug)]
pub enum CalibrationRequest {
    /// All lenses and poses are estimated from the images alone. The lenses and poses of the capture are not read.
    New {
        /// Name of the lens model of all cameras, as in COLMAP.
        lens: String,
        /// Focal length of all cameras, pixels. `None` if it is unknown.
        focal_px: Option<f64>,
        /// Ids of two cameras, and the distance between the two in metres. `None` if no distance is known.
        distance_m: Option<([String; 2], f64)>,
    },
    /// The poses of the capture are refined. The fields select which lens parameters are refined too.
    Refinement {
        /// Whether focal lengths are refined.
        focal: bool,
        /// Whether principal points are refined.
        principal_point: bool,
    },
}

impl CalibrationRequest {
    /// Returns the arguments of the script `blender/calibrate.py`. A flag and its value are one argument, so that a
    /// negative value isn't read as a flag.
    fn arguments(&self) -> Vec<OsString> {
        match self {
            Self::New { lens, focal_px, distance_m } => {
                let mut arguments = vec!["new".into(), format!("--lens={lens}").into()];
                arguments.extend(focal_px.map(|px| format!("--focal={px}").into()));
                if let Some(([first, second], metres)) = distance_m {
                    arguments.push(format!("--between={first}").into());
                    arguments.push(format!("--and={second}").into());
                    arguments.push(format!("--metres={metres}").into());
                }
                arguments
            }
            Self::Refinement { focal, principal_point } => {
                let mut arguments = vec!["refine".into()];
                arguments.extend(focal.then(|| "--focal".into()));
                arguments.extend(principal_point.then(|| "--principal-point".into()));
                arguments
            }
        }
    }
}

/// A calibration that was estimated from images.
#[derive(Clone, Debug, Deserialize)]
pub struct Calibration {
    /// Lens, pose and errors of each camera, in the capture's order.
    pub cameras: Vec<CameraEstimate>,
    /// Number of scene points from which the calibration was estimated.
    pub points: usize,
    /// Covariance of all cameras' poses and of the estimated lens parameters. `None` if it is unknown.
    pub covariance: Option<CalibrationCovarianceFormat>,
    /// Sentences about the calibration that are shown to the user.
    pub notes: Vec<String>,
}

/// A camera of an estimated calibration. The standard errors of its pose are those about and along the least certain
/// axis. They exclude the common position, rotation and scale of all cameras, which images don't determine.
#[derive(Clone, Debug, Deserialize)]
pub struct CameraEstimate {
    pub id: String,
    width: u32,
    height: u32,
    model: String,
    /// Parameters of the lens model, in COLMAP's order.
    params: Vec<f64>,
    cam_from_world: PoseFormat,
    /// Number of scene points that the camera sees.
    pub points: usize,
    /// Root mean square of the camera's reprojection errors, pixels.
    pub error_px: f64,
    /// Standard error of the camera's orientation: of the rotation about the least certain axis, degrees.
    pub rotation_std_err_deg: f64,
    /// Standard error of the camera's centre, along the least certain axis, metres.
    pub position_std_err_m: f64,
    /// Standard error of the focal length, as a fraction of the focal length. 0 if the focal length was given.
    pub focal_std_err_fraction: f64,
    /// Angle between the orientation in the capture's calibration and the estimated orientation, degrees. `None` if the
    /// capture's calibration was not used.
    pub turned_deg: Option<f64>,
    /// Distance between the camera centre in the capture's calibration and the estimated centre, metres. `None` if the
    /// capture's calibration was not used.
    pub moved_m: Option<f64>,
}

impl CameraEstimate {
    /// Returns the camera's lens and pose in the format of `capture.json`.
    pub fn format(&self) -> CameraFormat {
        CameraFormat {
            width: self.width,
            height: self.height,
            model: self.model.clone(),
            params: self.params.clone(),
            cam_from_world: self.cam_from_world.clone(),
        }
    }

    /// Returns the focal length in pixels, which is the horizontal one if the lens model has two.
    pub fn focal_px(&self) -> f64 {
        self.params.first().copied().unwrap_or(f64::NAN)
    }
}

/// Estimates or refines the calibration of a capture's cameras from the static part of its frames. The capture isn't
/// changed.
pub fn calibrate(
    environment: &Environment,
    capture: &Path,
    request: &CalibrationRequest,
    reporter: &Reporter,
) -> Result<Calibration, ToolchainError> {
    let mut command = script::command(environment, "calibrate.py");
    command.args(request.arguments()).arg(capture);
    let mut result = String::new();
    script::run(&mut command, "calibrating", reporter, |line| line.clone_into(&mut result))?;
    serde_json::from_str(&result).map_err(|error| {
        ToolchainError::Failure(format!("calibrate.py: printed no result ({error})"))
    })
}
