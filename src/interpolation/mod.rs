//! §5: temporal interpolation, which synthesizes a camera's image at an instant between two of its frames.
//!
//! | paper | here |
//! |---|---|
//! | 5.1 real edges, eq. (6) | [`real_edges`] |
//! | 5.2 the edge set | [`edge_set`] |
//! | 5.3 the morph, eqs. (7), (8) | [`morph_warp`] |
//! | 5.3 cross dissolve, eq. (9) | [`cross_dissolve`] |
//! | Fig. 10 (b), direct triangulation | [`triangulation_warp`] |
//! | beyond the paper: motion and visibility at moving outlines | [`PairMethod::Refined`] |
//! | every method | [`FramePair::interpolate`] |
//!
//! [`SyncMethod`] lists the methods. `crossfade` has no warp. `triangulation`, `morph` and `edge-morph` differ only
//! in the warp. `morph` is `edge-morph` with equal weights of all edges. `refined` starts from the warps of
//! `triangulation`. (To start from the warps of `edge-morph` takes longer, and changes the result by 0.02 dB on ten
//! recordings.) `all-cameras` starts from `refined`. It is in [`crate::light_field`], because it needs the images of
//! other cameras.
//!
//! Known limits: in the paper's methods, a surface that is visible in only one of the two frames is cross-faded
//! with the content of the other frame. Motion blur of the frames remains.
//!
//! With a rolling shutter, every tracked position has the time at which its row was exposed. The interpolated image
//! therefore shows all rows at the same instant. The distortion by the rolling shutter remains where no feature is
//! tracked, and with the methods `nearest` and `crossfade`. The instant lies between the exposures of the two frames'
//! middle rows. Near the first and the last row, motion is therefore extrapolated by up to half the readout time.

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
