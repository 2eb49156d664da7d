//! Runs the Python programs: filming, the calibration check, the review, and the set-up of their
//! environment. Each is a child process, with progress on stdout and one-sentence errors on stderr.
//!
//! Known limits: Linux and macOS only. Children of a killed parent are ended on Linux only.

mod programs;
mod script;
mod setup;

pub use programs::{Check, FilmOptions, FilmedScene, build_extension, check, film, review};
pub use script::ToolchainError;
pub use setup::{Environment, ensure_environment, find_ffmpeg, project_root};
