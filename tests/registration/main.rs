//! Registration against what is known: a naive reference, real images with stored tracks, filmed
//! bodies whose every point is a formula.

#[path = "../common/mod.rs"]
mod common;
mod flow;
mod naive;
mod pictures;
mod tracker;
