//! Why there is no image.

use crate::capture::CaptureError;
use std::path::PathBuf;

/// Why an image can't be rendered. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error("{camera} has no frames around {time_s:?} s: it covers {first_s} to {last_s} s")]
    CameraTime { camera: String, time_s: f64, first_s: f64, last_s: f64 },
    #[error("{camera}'s clock is unknown: {reason}")]
    CameraClock { camera: String, reason: String },
    #[error("no camera has frames around {time_s:?} s: they cover {first_s} to {last_s} s")]
    Time { time_s: f64, first_s: f64, last_s: f64 },
    #[error(
        "no frames can be around {time_s:?} s: whatever the offsets, {of} filmed within {first_s:.3} to {last_s:.3} s"
    )]
    Beyond { time_s: f64, of: String, first_s: f64, last_s: f64 },
    #[error("no camera of this capture has a known clock")]
    NoClock,
    #[error(
        "no point before this view could be triangulated; the plane proxy with proxy.plane_depth_m focuses by hand"
    )]
    NoPoints,
    #[error("no camera sees any pixel of this view")]
    NothingSeen,
    #[error("{path}: prepared frames can't be written ({source})")]
    Prepare { path: PathBuf, source: std::io::Error },
    #[error("rendering was stopped")]
    Stopped,
}

impl RenderError {
    /// Whether another instant may be better.
    pub(super) fn is_of_the_instant(&self) -> bool {
        matches!(
            self,
            Self::Time { .. }
                | Self::CameraTime { .. }
                | Self::Beyond { .. }
                | Self::NoPoints
                | Self::NothingSeen
        )
    }
}
