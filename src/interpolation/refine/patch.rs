//! Squares of points. A motion leads each point to a place in a frame.

use crate::interpolation::local_motion::LocalMotion;
use crate::raster::{Image, sample_all};
use nalgebra::{Point2, Vector2};

/// A square of points in the centres of pixels, part of which may be outside the image.
#[derive(Clone, Copy)]
pub struct Patch {
    /// The top-left corner of the first point's pixel.
    pub corner: Point2<f64>,
    /// The centre of the motions.
    pub center: Point2<f64>,
    /// Points along a side.
    pub side: usize,
    /// From a point to the next, pixels.
    pub step: usize,
}

impl Patch {
    /// Where the points of a row are in a frame, 0 to 3, by a motion.
    fn row(
        &self,
        motion: &LocalMotion,
        frame: usize,
        row: usize,
    ) -> impl Iterator<Item = [f32; 2]> {
        let y = (row * self.step) as f64 + 0.5;
        let from_center = |x: f64| self.corner - self.center + Vector2::new(x, y);
        let place = |x: f64| self.center + from_center(x) + motion.at(frame, from_center(x));
        // A motion is affine, and so are the places along a row.
        let (first, per_px) = (place(0.5), place(1.5) - place(0.5));
        (0..self.side).map(move |k| {
            let place = first + per_px * (k * self.step) as f64;
            [place.x as f32, place.y as f32]
        })
    }

    /// Where all points are, row by row.
    pub fn places(&self, motion: &LocalMotion, frame: usize) -> Vec<[f32; 2]> {
        let mut places = Vec::with_capacity(self.side * self.side);
        for row in 0..self.side {
            places.extend(self.row(motion, frame, row));
        }
        places
    }

    /// What a frame, 0 to 3, shows there: a pixel for a point.
    pub fn sampled(&self, image: &Image, motion: &LocalMotion, frame: usize) -> Image {
        let channels = image.channels();
        let mut patch = vec![0.0; self.side * self.side * channels];
        for (row, out) in patch.chunks_exact_mut(self.side * channels).enumerate() {
            sample_all(image, self.row(motion, frame, row), out);
        }
        Image::from_data(self.side, self.side, channels, patch)
    }
}
