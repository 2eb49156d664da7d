//! Simulated camera arrays: the rig file that Blender films with, its checks, its JSON Schema, and
//! the generator of `stlfr rig`.
//!
//! - [`Rig::parse`] and [`Rig::read`]: a checked rig from JSON.
//! - [`RigOptions::generate`]: a rig from a few numbers; [`Rig::to_json`] writes it.
//! - [`limits`]: the range of every field.
//!
//! Known limit: jitter is drawn in Blender, when a rig films.

mod check;
mod format;
mod generate;
pub mod limits;
mod write;

pub use check::{FieldError, RigError};
pub use format::{Rig, RigCamera, RigColor, RigDistortion, RigView};
pub use generate::{Delays, Loss, LossStamps, RigLayout, RigOptions};

/// The JSON Schema of a rig file.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(Rig).into()
}

#[cfg(test)]
mod tests;
