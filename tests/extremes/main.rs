//! What must hold at the ends of every scale, case by case.

#[path = "../common/mod.rs"]
mod common;

mod data;
mod geometry;
mod invariance;
mod naive;
mod precision;
mod random;
mod size;
