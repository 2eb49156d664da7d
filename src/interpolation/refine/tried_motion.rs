//! A candidate motion of a block, and the four frames warped by it, as far as they are asked for.

use super::patch::Patch;
use crate::interpolation::local_motion::LocalMotion;
use crate::raster::Image;
use std::cell::OnceCell;

/// A motion that is tried on a block.
pub struct TriedMotion<'a> {
    /// The motion, around the block's centre.
    pub motion: LocalMotion,
    frames: [Option<&'a Image>; 4],
    /// The block's pixels.
    pixels: Patch,
    /// The frames at the points of the costs.
    at_points: [Option<Image>; 4],
    /// The frames at the block's pixels.
    at_pixels: [OnceCell<Image>; 4],
}

impl<'a> TriedMotion<'a> {
    /// Of those of the four frames that are wanted.
    pub fn new(
        motion: LocalMotion,
        frames: [Option<&'a Image>; 4],
        pixels: Patch,
        points: Patch,
    ) -> Self {
        let mut at_points = [None, None, None, None];
        for (n, (frame, out)) in frames.iter().zip(&mut at_points).enumerate() {
            *out = frame.map(|image| points.sampled(image, &motion, n));
        }
        Self { motion, frames, pixels, at_points, at_pixels: Default::default() }
    }

    /// Frame 0 to 3 at the points of the costs; `None` if it is not wanted or does not exist.
    pub fn at_points(&self, frame: usize) -> Option<&Image> {
        self.at_points[frame].as_ref()
    }

    /// Frame 0 to 3 at the block's pixels; `None` as above.
    pub fn at_pixels(&self, frame: usize) -> Option<&Image> {
        let image = self.frames[frame]?;
        let sampled = || self.pixels.sampled(image, &self.motion, frame);
        Some(self.at_pixels[frame].get_or_init(sampled))
    }
}
