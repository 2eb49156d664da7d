//! §6, view synthesis: a proxy of the scene's geometry, and the synchronized images blended over it
//! by unstructured lumigraph rendering (Buehler et al., SIGGRAPH 2001).
//!
//! - [`triangulate`]: 3D points from correspondences at one instant.
//! - [`Plane`], [`Mesh`]: the paper's two proxies; [`Proxy`] turns either into a [`DepthMap`] of
//!   the view to render.
//! - [`blend`]: the view, from the images and the depth map.
//!
//! ```text
//! points ── Plane::fit ──┐
//!        └─ Mesh::build ─┴─ Proxy::depth_map(target) ── blend(sources, depth, target)
//! ```

mod depth_map;
mod hidden;
mod inverse_depth;
mod mesh;
mod nodes;
mod part;
mod plane;
mod proxy;
mod rasterize;
mod rays;
mod reproject;
mod source;
mod triangulate;
mod ulr;
mod weights;

pub use depth_map::DepthMap;
pub use mesh::{DepthEdges, Mesh};
pub use plane::Plane;
pub use proxy::Proxy;
pub(crate) use rays::RayRow;
pub use source::{BlendOptions, Rendered, Source};
pub use triangulate::{Triangulated, triangulate};
pub use ulr::{blend, contributing};
pub use weights::BlendMethod;

#[cfg(test)]
mod tests;
