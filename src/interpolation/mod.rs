//! §5: temporal interpolation. A camera's image at an instant between two of its frames.
//!
//! | paper | here |
//! |---|---|
//! | 5.1 real edges, eq. (6) | [`real_edges`] |
//! | 5.2 the edge set | [`edge_set`] |
//! | 5.3 the morph, eqs. (7), (8) | [`morph_warp`] |
//! | 5.3 cross dissolve, eq. (9) | [`cross_dissolve`] |
//! | beyond: motion and visibility at outlines | [`refined`] |
//! | Fig. 10 (b), direct triangulation | [`triangulation_warp`] |
//! | all of them, by [`SyncMethod`] | [`FramePair`] |
//!
//! The methods of [`SyncMethod`] share their code. `crossfade` has no warp. `triangulation` and the morphs
//! differ in the warp. `morph` is `edge-morph` without the boost of real edges. `refined` starts from
//! `triangulation`; from `edge-morph` it takes longer, with the same result to 0.02 dB on
//! ten recordings and a worse one on a scene without texture. `all-cameras` starts from `refined`; it is made by
//! [`crate::light_field`], which knows the other cameras.
//!
//! Known limits: in the paper's methods, a surface that only one frame shows is cross-faded. Motion blur
//! stays as it was filmed.

mod block_change;
mod edge_set;
mod edges;
mod frame_pair;
mod local_motion;
mod morph;
mod options;
mod refine;
mod segment_cells;
mod sync_method;
mod triangulation;
mod warp;
mod windows;

pub use block_change::largest_change;
pub(crate) use block_change::{changed_fraction, changed_pixels};
pub use edge_set::{Edge, edge_set};
pub use edges::{Feature, RealEdge, real_edges};
pub use frame_pair::{FramePair, Synchronized, Triangles};
pub use local_motion::Motion;
pub use morph::morph_warp;
pub use options::{EdgeOptions, InterpolationOptions, MorphOptions, RefineOptions};
pub use refine::{FourFrames, PairCosts, PixelMotion, refined};
pub use sync_method::SyncMethod;
pub use triangulation::{delaunay, triangulation_warp};
pub use warp::{Warp, cross_dissolve};
