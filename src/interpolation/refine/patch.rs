//! Squares of pixels. A motion leads each pixel to a place in a frame.

use crate::interpolation::local_motion::LocalMotion;
use crate::raster::{Image, sample_all};
use nalgebra::{Point2, Vector2};

/// A square of pixels, part of which may be outside the image.
#[derive(Clone, Copy)]
pub struct Patch {
    /// The top-left corner.
    pub corner: Point2<f64>,
    /// The centre of the motions.
    pub center: Point2<f64>,
    /// Pixels along a side.
    pub side: usize,
}

impl Patch {
    /// Where the pixels of a row are in a frame, 0 to 3, by a motion.
    fn row(
        &self,
        motion: &LocalMotion,
        frame: usize,
        row: usize,
    ) -> impl Iterator<Item = [f32; 2]> {
        let from_center = |x: f64| self.corner - self.center + Vector2::new(x, row as f64 + 0.5);
        let place = |x: f64| self.center + from_center(x) + motion.at(frame, from_center(x));
        // A motion is affine, and so are the places along a row.
        let (first, step) = (place(0.5), place(1.5) - place(0.5));
        (0..self.side).map(move |x| {
            let place = first + step * x as f64;
            [place.x as f32, place.y as f32]
        })
    }

    /// Where all pixels are, row by row.
    pub fn places(&self, motion: &LocalMotion, frame: usize) -> Vec<[f32; 2]> {
        let mut places = Vec::with_capacity(self.side * self.side);
        for row in 0..self.side {
            places.extend(self.row(motion, frame, row));
        }
        places
    }

    /// What a frame, 0 to 3, shows there.
    pub fn sampled(&self, image: &Image, motion: &LocalMotion, frame: usize) -> Image {
        let channels = image.channels();
        let mut patch = vec![0.0; self.side * self.side * channels];
        for (row, out) in patch.chunks_exact_mut(self.side * channels).enumerate() {
            sample_all(image, self.row(motion, frame, row), out);
        }
        Image::from_data(self.side, self.side, channels, patch)
    }
}
