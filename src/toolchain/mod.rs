//! Runs the Python programs: filming, the calibration check, the review in Blender, and the set-up of their
//! environment. Each is a child process that reports progress on stdout, and errors as one sentence on
//! stderr.
//!
//! Known limits: Linux and macOS only. If the parent process is killed, its children are ended only on Linux.

mod programs;
mod script;
mod setup;

pub use programs::{
    Check, CheckVerdict, FilmOptions, FilmedScene, blend_path, build_extension, check, film, review,
};
pub use setup::{Environment, ensure_environment, find_ffmpeg, project_root};

/// Why a script or the set-up failed: one sentence, including the command that repairs it if there is one.
#[derive(Debug, thiserror::Error)]
pub enum ToolchainError {
    /// An input is invalid.
    #[error("{0}")]
    BadInput(String),
    /// The work failed.
    #[error("{0}")]
    Failure(String),
}
