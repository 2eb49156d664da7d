//! Depth maps: the scene's geometry as seen in one view.

use crate::raster::Image;
use std::ops::Deref;

/// Depth map of a view: the depth along the camera's +z axis at each pixel centre, metres. A depth is positive,
/// infinite for the sky, and NaN where no surface is known.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap(Image);

/// Gives access to the depths as an image with one channel.
impl Deref for DepthMap {
    type Target = Image;

    fn deref(&self) -> &Image {
        &self.0
    }
}

impl DepthMap {
    /// Creates a map from the depths `data`, metres, row by row. Depths that are not positive become NaN.
    ///
    /// # Panics
    /// If a dimension is 0, or the number of depths is not `width * height`.
    pub fn from_data(width: usize, height: usize, mut data: Vec<f32>) -> Self {
        for z in &mut data {
            if !(*z > 0.0) {
                *z = f32::NAN;
            }
        }
        Self(Image::from_data(width, height, 1, data))
    }

    /// Creates a map from the depths `data`, metres, row by row. All depths must be positive or NaN.
    pub(super) fn from_depths(width: usize, height: usize, data: Vec<f32>) -> Self {
        debug_assert!(data.iter().all(|z| !(*z <= 0.0)));
        Self(Image::from_data(width, height, 1, data))
    }

    /// Creates a map in which every depth is NaN.
    pub fn empty(width: usize, height: usize) -> Self {
        Self::from_data(width, height, vec![f32::NAN; width * height])
    }

    /// Returns the smallest depth, metres, of the 3×3 pixels around the position (x, y), pixels. The position is
    /// clamped to the image. NaN if none of these pixels has a depth.
    pub(super) fn nearest_around(&self, x: f32, y: f32) -> f32 {
        let span = |v: f32, size: usize| {
            let at = v.max(0.0).min((size - 1) as f32) as usize;
            at.saturating_sub(1)..(at + 2).min(size)
        };
        let mut nearest = f32::NAN;
        for row in span(y, self.height()) {
            for column in span(x, self.width()) {
                // `min` ignores NaN.
                nearest = nearest.min(self.data()[row * self.width() + column]);
            }
        }
        nearest
    }

    /// Returns the largest depth, metres, of the 2×2 pixels around the position (x, y), pixels. The position is clamped
    /// to the image. NaN if any of these pixels has no depth.
    pub(super) fn farthest_around(&self, x: f32, y: f32) -> f32 {
        let cell = |v: f32, size: usize| {
            let floor = (v - 0.5).max(0.0).min((size - 1) as f32) as usize;
            (floor, (floor + 1).min(size - 1))
        };
        let (x0, x1) = cell(x, self.width());
        let (y0, y1) = cell(y, self.height());
        let at = |x: usize, y: usize| self.data()[y * self.width() + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        // All depths are positive or NaN, so the sum is NaN exactly if one of the four depths is NaN.
        if (a + b + c + d).is_nan() { f32::NAN } else { a.max(b).max(c).max(d) }
    }
}
