//! The four frames around an instant.

use crate::interpolation::RefineOptions;
use crate::raster::{Image, Tiles};

/// The frames around an instant, and where it lies between the middle two. All images have the same size
/// and channels.
pub struct FourFrames<'a> {
    /// The frame before the earlier one, if it exists.
    pub before: Option<&'a Image>,
    /// The frame at t.
    pub earlier: &'a Image,
    /// The frame at t + Δt.
    pub later: &'a Image,
    /// The frame after the later one, if it exists.
    pub after: Option<&'a Image>,
    /// (t' − t)/Δt of the instant t': 0 at the earlier frame, 1 at the later.
    pub fraction: f32,
    /// The tiles of the image that are needed, `None` for all. What is far from them is black.
    pub parts: Option<&'a Tiles>,
    /// Whether each pixel's [`PixelMotion`](super::PixelMotion) is wanted.
    pub with_motions: bool,
}

impl FourFrames<'_> {
    /// The maximum weight of the outer frames relative to the middle ones: 0 at a frame, largest halfway
    /// between two.
    pub(super) fn outer_weight(&self, options: &RefineOptions) -> f32 {
        options.outer_share * 4.0 * self.fraction * (1.0 - self.fraction)
    }
}
