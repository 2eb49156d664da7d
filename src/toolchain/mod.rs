//! Runs the Python programs: filming, the calibration check, the review, and the set-up of their
//! environment. Each is a child process, with progress on stdout and one-sentence errors on stderr.
//!
//! Known limits: Linux and macOS only. Children of a killed parent are ended on Linux only.

mod calibration;
mod programs;
mod script;
mod setup;

pub use calibration::{
    Calibration, CalibrationRequest, CameraEstimate, Check, CheckVerdict, calibrate, check,
};
pub use programs::{FilmOptions, FilmedScene, blend_path, build_extension, film, review};
pub use setup::{Environment, ensure_environment, find_ffmpeg, project_root};

/// Why a script or the set-up failed: one sentence, with the command that helps if there is one.
#[derive(Debug, thiserror::Error)]
pub enum ToolchainError {
    /// An input is wrong.
    #[error("{0}")]
    BadInput(String),
    /// The work failed.
    #[error("{0}")]
    Failure(String),
}
