//! Simulated camera arrays, called rigs: the rig file from which Blender films, its checks, its JSON Schema, and the
//! generator of `stlfr rig`.
//!
//! - [`Rig::parse`] and [`Rig::read`] read a rig from JSON, and check it.
//! - [`RigOptions::generate`] generates a rig from a few numbers. [`Rig::to_json`] writes it.
//! - [`limits`] has the allowed range of every field.
//!
//! Known limit: the random jitter of exposure times is drawn in Blender when the rig is filmed, not by the generator.

mod check;
mod format;
mod generate;
pub mod limits;
mod write;

pub use check::{FieldError, RigError};
pub use format::{Rig, RigCamera, RigColor, RigDistortion, RigView};
pub use generate::{Delays, Loss, LossStamps, RigLayout, RigOptions};

/// Returns the JSON Schema of a rig file.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(Rig).into()
}

#[cfg(test)]
mod tests;
