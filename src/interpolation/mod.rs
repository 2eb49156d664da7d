//! §5: temporal interpolation. A camera's image at an instant between two of its frames.
//!
//! | paper | here |
//! |---|---|
//! | 5.1 real edges, eq. (6) | [`real_edges`] |
//! | 5.2 the edge set | [`edge_set`] |
//! | 5.3 the morph, eqs. (7), (8) | [`morph_warp`] |
//! | 5.3 cross dissolve, eq. (9) | [`cross_dissolve`] |
//! | Fig. 10 (b), direct triangulation | [`triangulation_warp`] |
//! | beyond: motion and visibility at outlines | [`PairMethod::Refined`] |
//! | every method | [`FramePair::interpolate`] |
//!
//! The methods are those of [`SyncMethod`]. `crossfade` has no warp. `triangulation`, `morph` and
//! `edge-morph` differ only in the warp; `morph` is `edge-morph` with equal weights of all edges. `refined`
//! starts from the warps of `triangulation` (starting from `edge-morph` is slower and differs by 0.02 dB on
//! ten recordings). `all-cameras` starts from `refined` and is in [`crate::light_field`], where the other
//! cameras are known.
//!
//! Known limits: in the paper's methods, a surface that only one frame shows is cross-faded with what the
//! other frame shows there. Motion blur stays as filmed.
//!
//! With a rolling shutter, every tracked position has the time of its row, so that the image at an instant shows all
//! rows at that instant. Where nothing is tracked, and for `nearest` and `crossfade`, the frames stay as filmed. The two
//! frames are those around the instant in the middle row; near the first and the last row, motion is extrapolated by
//! up to half the readout.

mod block_change;
mod edge_set;
mod edges;
mod frame_pair;
mod morph;
mod options;
mod refine;
mod tracked_pair;
mod triangulation;
mod warp;

pub use block_change::largest_change;
pub(crate) use block_change::{changed_fraction, changed_pixels};
pub use edge_set::{Edge, edge_set};
pub use edges::{EdgeFeature, RealEdge, real_edges};
pub use frame_pair::{FramePair, PairMethod, Synchronized};
pub use morph::{EDGE_BOOST, morph_warp};
pub use options::{InterpolationOptions, SyncMethod};
pub use refine::PairCosts;
pub use tracked_pair::{RowFractions, TrackedPair};
pub use triangulation::{Triangles, triangulated, triangulation_warp};
pub use warp::{Warp, cross_dissolve};
