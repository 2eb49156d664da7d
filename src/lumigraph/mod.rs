//! View synthesis (§6 of the paper). A geometry proxy approximates the scene's surfaces. The synchronized images are
//! projected onto the proxy and blended by unstructured lumigraph rendering (Buehler et al., SIGGRAPH 2001).
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
//! | `source.rs` | the images that a view is blended from, and the options of blending |
//! | `penalties.rs` | the penalty of each camera at a pixel |
//! | `weights.rs`, `weight_grid.rs` | the weight of each camera at a pixel, from the penalties |
//! | `blend.rs`, `span.rs` | the view: weighted means of the cameras' images |
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
