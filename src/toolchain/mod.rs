//! Runs the Python programs: filming, the calibration check, the review, and the set-up of their
//! environment. Each is a child process, with progress on stdout and one-sentence errors on stderr.
//!
//! Known limits: Linux and macOS only. Children of a killed parent are ended on Linux only.

mod check;
mod extension;
mod film;

mod review;
mod script;
mod setup;

pub use check::{Check, check};
pub use extension::{ExtensionError, build_extension};
pub use film::{FilmOptions, FilmedScene, film};
pub use review::review;
pub use script::ScriptError;
pub use setup::{Environment, SetupError, ensure_environment, find_ffmpeg, project_root};
