//! §6, view synthesis: a proxy of the scene's geometry, and unstructured lumigraph rendering of the synchronized
//! images over it (Buehler et al., SIGGRAPH 2001).
//!
//! ```text
//! points ── Plane::fit ──┐
//!        └─ Mesh::build ─┴─ Proxy::depth_map(target) ── blend(sources, depth, target)
//! ```
//!
//! | file | step |
//! |---|---|
//! | `triangulate.rs` | 3D points from correspondences at one instant |
//! | `plane.rs`, `mesh.rs` | the paper's two proxies |
//! | `proxy.rs`, `rasterize.rs`, `depth_map.rs` | the proxy's depth at every pixel of a view |
//! | `source.rs` | the images that a view is blended from, and the options |
//! | `penalties.rs` | the penalty of each camera at a pixel |
//! | `weights.rs`, `weight_grid.rs` | the weight of each camera, from the penalties |
//! | `blend.rs`, `span.rs` | the view, as weighted means of the cameras' images |
//! | `inpaint.rs` | colours of points that are occluded in every camera |

mod blend;
mod depth_map;
mod inpaint;
mod mesh;
mod penalties;
mod plane;
mod proxy;
mod rasterize;
mod rays;
mod source;
mod span;
mod triangulate;
mod weight_grid;
mod weights;

pub use blend::{blend, contributing};
pub use depth_map::DepthMap;
pub use mesh::{DepthEdges, Mesh};
pub use plane::Plane;
pub use proxy::Proxy;
pub(crate) use rays::RayRow;
pub use source::{BlendOptions, Rendered, Source};
pub use triangulate::{Triangulated, triangulate};
pub use weights::BlendMethod;

#[cfg(test)]
mod tests;
