//! Simulated camera arrays: the rig file that Blender films with, its checks, its JSON Schema, and
//! the generator of `stlfr rig`.
//!
//! Filming itself, and with it the shutter times, is in `blender/stlfr/rig.py`, which has rig files
//! read and checked here.

mod check;
mod format;
mod generate;
mod limits;
mod write;

pub use check::{FieldError, RigError};
pub use format::{Distortion, Rig, RigCamera, RigColor, RigView};
pub use generate::{Delays, GenerateError, Layout, Loss, LossStamps, RigOptions};

/// The JSON Schema of a rig file.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(Rig).into()
}

#[cfg(test)]
mod tests;
