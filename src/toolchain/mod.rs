//! Runs the Python programs: for filming, the calibration check, new and refined calibrations, the review in Blender,
//! and the set-up of the Python environment. Each program is a child process that reports its progress on stdout, and
//! an error as one sentence on stderr.
//!
//! Known limits: Linux and macOS only. If this process is killed, its child processes are ended only on Linux.

mod calibration;
mod programs;
mod script;
mod setup;

pub use calibration::{
    Calibration, CalibrationRequest, CameraEstimate, Check, CheckVerdict, calibrate, check,
};
pub use programs::{FilmOptions, FilmedScene, blend_path, build_extension, film, review};
pub use setup::{Environment, ensure_environment, find_ffmpeg, project_root};

/// Reason why a Python script or the set-up of the Python environment failed: one sentence. It includes the command
/// that solves the problem, if there is such a command.
#[derive(Debug, thiserror::Error)]
pub enum ToolchainError {
    /// An input is invalid.
    #[error("{0}")]
    BadInput(String),
    /// The script or the set-up failed, although its input was valid.
    #[error("{0}")]
    Failure(String),
}
