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
//! | `proxy.rs`, `rasterize.rs` | the proxy's depth at every pixel of a view |
//! | `penalties.rs` | the penalty of each camera at a pixel |
//! | `weights.rs`, `weight_grid.rs` | the weight of each camera, from the penalties |
//! | `blend.rs`, `span.rs` | the view, as weighted means of the cameras' images |
//! | `inpaint.rs` | colours of points that are occluded in every camera |

mod blend;
mod inpaint;
mod mesh;
mod penalties;
mod plane;
mod proxy;
mod rasterize;
mod rays;
mod span;
mod triangulate;
mod weight_grid;
mod weights;

pub use blend::{BlendOptions, Rendered, Source, blend, contributing};
pub use mesh::{DepthEdges, Mesh};
pub use plane::Plane;
pub use proxy::{DepthMap, Proxy};
pub(crate) use rays::RayRow;
pub use triangulate::{Triangulated, triangulate};
pub use weights::BlendMethod;

#[cfg(test)]
mod tests;
