//! Methods that the capture decides ([`crate::plan`]).

use crate::option::options;

options! {
    /// Which methods are left to the capture, and how large an error they may make.
    pub struct AutoOptions {
        /// Whether the capture decides the sync method, whether trajectories are curved, and
        /// whether still frame pairs are registered.
        sync: bool = false,
        /// Whether the capture decides the proxy's method.
        proxy: bool = false,
        /// Whether the capture decides the blend's method.
        blend: bool = false,
        /// How far a cheaper method may displace a surface in the image.
        budget_px: f64 [0.0..=1000.0, "px"] = 0.25,
        /// How much PSNR views may lose that a dearer sync method would gain.
        budget_db: f64 [0.0..=100.0, "dB"] = 0.07,
    }
}

impl AutoOptions {
    /// Every method is left to the capture.
    pub fn all() -> Self {
        Self { sync: true, proxy: true, blend: true, ..Self::default() }
    }

    /// The stages whose methods are left to the capture, as plans name them.
    pub fn stages(&self) -> Vec<&'static str> {
        let all = [(self.sync, "sync"), (self.proxy, "proxy"), (self.blend, "blend")];
        all.into_iter().filter(|(is_left, _)| *is_left).map(|(_, stage)| stage).collect()
    }
}
