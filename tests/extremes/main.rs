//! Properties that must hold at the ends of every scale, case by case: the right answer or a reason,
//! never only "no panic".
//!
//! | scale | where | beside the code |
//! |---|---|---|
//! | invariance: units, places, clocks, orders, turned images | [`invariance`] | `lumigraph::triangulate`, `lumigraph::tests` (orders, threads) |
//! | immutability: views in any order, with any options, from any thread | [`immutable`] | `light_field` |
//! | geometry: coincident cameras, epipoles, infinity, planes through centres, lenses | [`geometry`] | `tests/robustness.rs` (motion along the epipolar lines, odd views) |
//! | data: none to two features, lines, duplicates, outliers, flat images, eqs. (6) to (8) | [`data`] | `interpolation::{edges, edge_set, morph, refine}`, `offset::{consensus, mixture}`, `lumigraph::mesh` |
//! | size: pixels, cameras, frames, edges | [`size`] | `tests/bench/growth.rs` (the largest, and how cost grows) |
//! | precision: f32 against f64 with bounds, no NaN | [`precision`] | `registration::{klt, simd, corners}`, `lumigraph::{tests, weights, sample}`, `interpolation::warp` |
//! | random captures and options | [`random`] | `tests/robustness.rs` (captures of anything), `tests/fuzz` (every parser) |
//!
//! [`naive`] holds the formulas that fast code is compared with.

#[path = "../common/mod.rs"]
mod common;

mod data;
mod geometry;
mod immutable;
mod invariance;
mod naive;
mod precision;
mod random;
mod size;
