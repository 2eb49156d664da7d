//! What is left to the capture to decide.

use serde::{Deserialize, Serialize};

/// Which methods are left to the capture, and how large an error they may make.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutoOptions {
    /// Whether the capture decides the sync method, whether trajectories are curved, and whether
    /// still frame pairs are registered.
    pub sync: bool,
    /// Whether the capture decides the proxy's method.
    pub proxy: bool,
    /// Whether the capture decides the blend's method.
    pub blend: bool,
    /// How far a cheaper method may move what is seen, pixels. Larger: cheaper methods; at 0 nothing
    /// is simplified.
    pub budget_px: f64,
    /// How much views may lack that the dearer sync method could gain, decibels. Larger: cheaper
    /// methods; at 0, refinement is done for a hundredth of a decibel. Held-out cameras stand twice
    /// as far from their neighbours as views do, so that views can gain more than was estimated: up
    /// to three times as much on eleven captures. All cameras' images are taken where they make held-out
    /// frames better than refined ones do by more than this.
    pub budget_db: f64,
}

impl Default for AutoOptions {
    fn default() -> Self {
        Self { sync: false, proxy: false, blend: false, budget_px: 0.25, budget_db: 0.07 }
    }
}

impl AutoOptions {
    /// Every method is left to the capture.
    pub fn all() -> Self {
        Self { sync: true, proxy: true, blend: true, ..Self::default() }
    }

    /// Whether anything is left to the capture.
    pub fn any(&self) -> bool {
        self.sync || self.proxy || self.blend
    }
}
