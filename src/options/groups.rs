//! Three groups of options: the automatic choice of methods ([`crate::plan`]), the geometry proxy (§6), and temporal
//! integration (Fig. 1). Temporal integration overlays several instants in one image.

use crate::lumigraph::DepthEdges;
use crate::method::methods;
use crate::option::options;
use crate::stereo::StereoOptions;
use serde::{Deserialize, Serialize};

options! {
    /// Options of the automatic choice of methods ([`crate::plan`]): the stages whose methods are chosen, and the error
    /// budgets within which a cheaper method is preferred.
    pub struct AutoOptions {
        /// Choose the sync method by measurements of the capture. Also choose whether trajectories are curved, and
        /// whether still frame pairs are registered.
        sync: bool = false,
        /// Choose the proxy method by measurements of the capture.
        proxy: bool = false,
        /// Choose the blending method by measurements of the capture.
        blend: bool = false,
        /// Automatic choice: the largest displacement of a surface in the image, in pixels, that a cheaper method may
        /// cause.
        budget_px: f64 [0.0..=1000.0, "px"] = 0.25,
        /// Automatic choice: the gain in PSNR that a dearer method must exceed to be chosen.
        budget_db: f64 [0.0..=100.0, "dB"] = 0.07,
    }
}

impl AutoOptions {
    /// Returns options that choose the methods of all stages automatically, with the default error budgets.
    pub fn all() -> Self {
        Self { sync: true, proxy: true, blend: true, ..Self::default() }
    }

    /// Returns the names of the stages whose methods are chosen automatically, as in [`crate::plan::Decision::stage`].
    pub fn stages(&self) -> Vec<&'static str> {
        let all = [(self.sync, "sync"), (self.proxy, "proxy"), (self.blend, "blend")];
        all.into_iter().filter(|(is_left, _)| *is_left).map(|(_, stage)| stage).collect()
    }
}

/// The kinds of geometry proxy, which is an estimate of the scene's shape, from the cheapest to the most expensive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyMethod {
    /// One plane, either fitted to the scene's points or at a given depth.
    Plane,
    /// The paper's mesh. Its vertices are triangulated correspondences, and a plane forms the background.
    #[default]
    Mesh,
    /// Depth per pixel, estimated from the images of several cameras with occlusion reasoning.
    Depth,
    /// Depth and motion per pixel of every frame, estimated from all cameras at their own capture times. For a view,
    /// the surface points of the frames nearest in time are moved to the view's instant. This proxy needs no
    /// synchronized images.
    SceneFlow,
}

methods!(ProxyMethod {
    Plane = "plane": "One plane, fitted or at a set depth",
    Mesh = "mesh": "The paper's: triangulated correspondences, meshed, with a plane behind",
    Depth = "depth": "Depth per pixel that all cameras agree on, and what hides what",
    SceneFlow = "scene-flow": "Depth and motion of every frame, from all cameras at their own times; ignores --sync",
});

options! {
    /// Options of the geometry proxy (§6), which is an estimate of the scene's shape.
    pub struct ProxyOptions {
        /// The kind of geometry proxy, if auto.proxy is false.
        method: ProxyMethod = ProxyMethod::Mesh,
        /// Depth of the proxy plane in the view, at which surfaces are in focus; null: fitted to the scene's points.
        plane_depth_m: Option<f64> [1e-9..=1e12, "m"] = None,
        /// How the mesh treats triangles that join two surfaces of different depth.
        depth_edges: DepthEdges = DepthEdges::Front,
        /// Options of the proxy with depth per pixel.
        depth: StereoOptions,
        /// Number of cameras whose features are triangulated; the cameras nearest to the view are used.
        cameras: usize [1..=1_000_000, "cameras"] = 3,
        /// Number of neighbouring cameras with which a camera is matched to triangulate its features.
        partners: usize [1..=1_000_000, "cameras"] = 4,
    }
}

/// Ways to combine the images of several instants into one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrailMode {
    /// The mean of the linear light over all instants, as in a long exposure.
    #[default]
    Mean,
    /// The maximum of each pixel's value over all instants, so that highlights leave streaks at full brightness.
    Lighten,
}

methods!(TrailMode {
    Mean = "mean": "The mean of the light, as a long exposure has it",
    Lighten = "lighten": "The brightest value: highlights leave full streaks",
});

options! {
    /// Options of temporal integration. A view overlays the images of several instants, and the last of these instants
    /// is the view's own.
    pub struct TrailOptions {
        /// Length of the trail before the view's instant; 0: no trail.
        duration_s: f64 [0.0..=1e6, "s"] = 0.0,
        /// Number of evenly spaced instants that are overlaid, including the first and the last.
        instants: usize [1..=10_000, "instants"] = 16,
        /// How the images of the instants are combined into one.
        mode: TrailMode = TrailMode::Mean,
    }
}

impl TrailOptions {
    /// Returns the instants, in seconds, whose images a view at `time_s` overlays, latest first. Without a trail,
    /// `time_s` is the only instant.
    pub(crate) fn instants_s(&self, time_s: f64) -> Vec<f64> {
        if self.duration_s <= 0.0 || self.instants < 2 {
            return vec![time_s];
        }
        let step_s = self.duration_s / (self.instants - 1) as f64;
        (0..self.instants).map(|k| time_s - step_s * k as f64).collect()
    }

    /// Returns the number of instants whose images a view overlays. 1 without a trail.
    pub fn count(&self) -> usize {
        self.instants_s(0.0).len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_reach_back_from_the_last() {
        let trail = TrailOptions { duration_s: 0.3, instants: 4, mode: TrailMode::Mean };
        let instants = trail.instants_s(1.0);
        assert_eq!(instants[0], 1.0);
        for (found, expected) in instants.iter().zip([1.0, 0.9, 0.8, 0.7]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!(TrailOptions { duration_s: 0.0, ..trail.clone() }.instants_s(1.0), [1.0]);
        assert_eq!(TrailOptions { instants: 1, ..trail.clone() }.instants_s(1.0), [1.0]);
        assert_eq!(TrailOptions { instants: 0, ..trail }.count(), 1);
    }
}
