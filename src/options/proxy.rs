//! The geometry proxy (§6).

use crate::lumigraph::DepthEdges;
use crate::method::methods;
use crate::option::options;
use crate::stereo::StereoOptions;
use serde::{Deserialize, Serialize};

/// The proxies, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyMethod {
    /// One plane, fitted to the scene's points or at a set depth.
    Plane,
    /// The paper's: triangulated correspondences, meshed, with a plane behind.
    #[default]
    Mesh,
    /// Depth per pixel from the images of several cameras, with occlusion.
    Depth,
    /// Depth and motion of every frame, from all cameras at their own times: the points of the frames nearest to the
    /// instant are moved there. Needs no synchronized images.
    SceneFlow,
}

methods!(ProxyMethod {
    Plane = "plane": "One plane, fitted or at a set depth",
    Mesh = "mesh": "The paper's: triangulated correspondences, meshed, with a plane behind",
    Depth = "depth": "Depth per pixel that all cameras agree on, and what hides what",
    SceneFlow = "scene-flow": "Depth and motion of every frame, from all cameras at their own times; ignores --sync",
});

options! {
    /// The geometry proxy (§6): an estimate of the scene's shape.
    pub struct ProxyOptions {
        /// The kind of proxy.
        method: ProxyMethod = ProxyMethod::Mesh,
        /// Depth of the plane in the view: what is in focus; null: fitted to the scene's points.
        plane_depth_m: Option<f64> [1e-9..=1e12, "m"] = None,
        /// How the mesh treats triangles between two surfaces.
        depth_edges: DepthEdges = DepthEdges::Front,
        /// Options of depth per pixel.
        depth: StereoOptions,
        /// Cameras nearest to the view whose features are triangulated.
        cameras: usize [1..=1_000_000, "cameras"] = 3,
        /// Nearest cameras with which each of these is matched.
        partners: usize [1..=1_000_000, "cameras"] = 4,
    }
}
