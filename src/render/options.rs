//! How a view is rendered: the rung of every stage, and the stages' own options.

use super::TrailOptions;
use crate::interpolation::{InterpolationOptions, Sync};
use crate::lumigraph::{BlendOptions, MeshOptions};
use crate::offset::OffsetOptions;
use crate::plan::AutoOptions;
use crate::registration::RegistrationOptions;
use serde::{Deserialize, Serialize};

/// Everything that decides an image, besides the capture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderOptions {
    pub sync: Sync,
    pub proxy: ProxyOptions,
    pub registration: RegistrationOptions,
    pub offset: OffsetOptions,
    pub interpolation: InterpolationOptions,
    pub blend: BlendOptions,
    /// Of `render` only: what is compared with the truth is an instant.
    pub trail: TrailOptions,
    /// Rungs that the capture decides, in place of those above.
    pub auto: AutoOptions,
}

/// What stands for the scene's shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProxyOptions {
    pub rung: ProxyRung,
    /// Depth of the plane before the view, metres: what is in focus. `None`: fitted to the points
    /// that the cameras see.
    pub plane_depth_m: Option<f64>,
    pub mesh: MeshOptions,
    /// Cameras, the nearest to the view, whose features are triangulated.
    pub cameras: usize,
    /// Cameras that each of them is matched with.
    pub partners: usize,
    /// Largest distance of a match from its epipolar line at the instant, pixels.
    pub max_epipolar_px: f64,
    /// Largest reprojection error of a point (root mean square), pixels.
    pub max_error_px: f64,
}

/// The proxies, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyRung {
    /// One plane, fitted or at a set depth
    Plane,
    /// The paper's: triangulated correspondences, meshed, with a plane behind
    #[default]
    Mesh,
}

impl Default for ProxyOptions {
    fn default() -> Self {
        Self {
            rung: ProxyRung::default(),
            plane_depth_m: None,
            mesh: MeshOptions::default(),
            cameras: 3,
            partners: 4,
            max_epipolar_px: 1.0,
            max_error_px: 0.7,
        }
    }
}
