//! Depth per pixel, with its uncertainty, from the images of several cameras at one instant (beyond the
//! paper).
//!
//! ```text
//! images ── Matcher::depths(camera) ── a Surface a camera ── fuse(view) ── the view's depths
//! ```
//!
//! Known limits: surfaces swell over their outlines by one to two pixels where the texture behind is
//! faint. Where synchronization failed, the images show no common shape, and depths are wrong. Nothing
//! holds depths alike from one instant to the next.
//!
//! | file | what |
//! |---|---|
//! | `levels.rs` | the inverse depths that are tried |
//! | `census.rs` | descriptors of pixels, which survive changes of brightness |
//! | `matching.rs` | how well each camera's neighbours agree with it, at every depth |
//! | `semi_global.rs` | smoothness, but for jumps at image edges (Hirschmüller 2008) |
//! | `refine.rs` | depths between the levels, and their standard errors |
//! | `estimate.rs` | a camera's depths, from the four before |
//! | `fusion.rs` | the one surface that all cameras agree on (Merrell et al. 2007), in any view |

mod camera_image;
mod census;
mod estimate;
mod fusion;
mod levels;
mod matching;
mod options;
mod refine;
mod relative;
mod semi_global;

pub use camera_image::CameraImage;
pub use estimate::{InverseDepths, Matcher};
pub use fusion::{Surface, fuse};
pub use levels::Levels;
pub use options::StereoOptions;

#[cfg(test)]
mod tests;
