//! Frames in which the surface elements of a matched frame are observed.

use super::frame::PyramidFrame;
use super::geometry::Projection;
use super::matching_image::{MatchingImage, MatchingSample, quantized};
use super::timing::TimeBetween;

/// Maximum absolute difference in each channel between two [`MatchingSample`]s of which white is 1. Larger differences,
/// which occlusions cause, are truncated.
const TRUNCATION: [f32; 4] = [0.12, 0.084, 0.084, 0.084];

/// Time between two frames from which on they are not of the same time, frame periods of the reference camera. Larger: frames
/// that show fast motion count as not showing it. Smaller: synchronized cameras with jitter count as not synchronized.
pub const SIMULTANEOUS: f64 = 0.1;

/// Another frame, in which surface elements of the matched frame are observed.
pub struct ObservingFrame<'a> {
    /// Time from a pixel of the matched frame to a pixel of this frame.
    pub time: TimeBetween,
    pub projection: Projection,
    pub levels: &'a [MatchingImage],
    /// Largest difference of two samples that counts in full.
    pub truncation: MatchingSample,
}

impl<'a> ObservingFrame<'a> {
    /// Creates the observing frame `by` for the matched frame `of`. `None` if the intrinsic matrix of `of` is
    /// singular.
    pub fn new(of: PyramidFrame, by: PyramidFrame<'a>) -> Option<Self> {
        let mut truncation = quantized(TRUNCATION);
        if !(of.frame.is_color && by.frame.is_color) {
            truncation[1] = 0;
        }
        Some(Self {
            time: TimeBetween::new(of.frame, by.frame),
            projection: Projection::new(&of.frame.view, &by.frame.view)?,
            levels: by.levels,
            truncation,
        })
    }

    /// Returns whether the two frames are of about the same time, so that they say nothing of motion.
    pub fn is_simultaneous(&self) -> bool {
        f64::from(self.time.frames().abs()) < SIMULTANEOUS
    }
}
