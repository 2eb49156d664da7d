//! The Python side, run from here: the environment that it needs, filming, and the check of the
//! calibration. Each is a process of its own that reports progress on stdout and says what is
//! wrong in one sentence on stderr.
//!
//! Known limit: Linux and macOS; a child that outlives a killed parent is ended on Linux only.

mod check;
mod extension;
mod film;

mod review;
mod script;
mod setup;

pub use check::{
    Check, CheckValues, CheckedCamera, CheckedFormat, CheckedLens, CheckedModel, check,
};
pub use extension::{ExtensionError, build_extension};
pub use film::{FilmOptions, FilmedScene, film};
pub use review::review;
pub use script::ScriptError;
pub use setup::{Environment, SetupError, ensure_environment, find_ffmpeg, project_root};
