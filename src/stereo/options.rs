//! Options of depth per pixel.

use serde::{Deserialize, Serialize};

/// Options of depth per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StereoOptions {
    /// How many cameras' depths are estimated and fused: those nearest to the view. Fewer: holes behind
    /// outlines, and outlines less certain; more cost time.
    pub cameras: usize,
    /// How many further cameras' images these are compared with. Fewer: the outer ones of the cameras see
    /// their neighbours on one side only; more cost time.
    pub further_cameras: usize,
    /// Largest number of neighbours that a camera is compared with. Fewer: what one of them doesn't see is
    /// mismatched; more cost time.
    pub partners: usize,
    /// The distance between two tried depths, in pixels of disparity to the farthest of the neighbours.
    /// Larger: steps on slanted surfaces; smaller: time and memory.
    pub step_px: f64,
    /// How often images are halved before depths are tried. Each halving takes an eighth of the time, and loses
    /// what is thinner than two pixels.
    pub halvings: usize,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self { cameras: 6, further_cameras: 2, partners: 4, step_px: 1.0, halvings: 0 }
    }
}
