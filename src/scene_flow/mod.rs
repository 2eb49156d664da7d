//! Beyond the paper: depth and motion of every frame, found together, from the frames of all cameras, each at its own
//! time. A view moves the points of the frames nearest to its instant, and blends them.
//!
//! ```text
//! frames ── pyramids ── PatchMatch, coarse to fine ── FlowMap of each frame ── splat ── blend(view)
//! ```
//!
//! Nothing is synchronized first: cameras that film at different times make motion visible, and short. Ancestors: Klose,
//! Lipski, Magnor, *Reconstructing Shape and Motion from Asynchronous Cameras* (VMV 2010); Bleyer, Rhemann, Rother,
//! *PatchMatch Stereo* (BMVC 2011); Taniai et al., *Fast Multi-frame Stereo Scene Flow* (CVPR 2017).
//!
//! Known limits: outlines are off by one or two pixels. Depths of edges along the line of cameras are found from motion
//! alone.
//!
//! | file | step |
//! |---|---|
//! | `frame.rs` | a frame without distortion, and the pyramid that is matched |
//! | `geometry.rs` | from a pixel and inverse depth of one camera to those of another |
//! | `element.rs` | a surface element: depth, path, slant |
//! | `matching.rs` | how well all frames agree on an element |
//! | `gauss_newton.rs`, `affine_fit.rs` | an element made better by gradients, and by its neighbours |
//! | `sweep.rs` | a pass of PatchMatch over a map |
//! | `transfer.rs`, `consistency.rs` | what other frames' maps propose, and what they contradict |
//! | `estimate.rs` | these steps in order, for several frames together |
//! | `map.rs`, `packed.rs` | a frame's depth and motion, and how they are stored |
//! | `confidence.rs` | whether the maps of a view's frames agree |
//! | `splat.rs`, `blend.rs` | the view of several maps |

mod affine_fit;
mod blend;
mod confidence;
mod consistency;
mod element;
mod estimate;
mod frame;
mod gauss_newton;
mod geometry;
mod map;
mod matching;
mod packed;
mod splat;
mod sweep;
mod transfer;

#[cfg(test)]
mod tests;

pub use blend::{FlowView, blend};
pub use confidence::confidences;
pub use element::Element;
pub use estimate::Estimation;
pub use frame::{FlowFrame, MatchingImage, PyramidFrame};
pub use map::{ElementMap, FlowMap, MappedFrame};
pub use sweep::Limits;
