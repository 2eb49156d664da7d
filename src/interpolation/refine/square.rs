//! A block's square of pixels.

use nalgebra::Point2;
use std::ops::Range;

/// A square of pixels, part of which may be outside the image.
#[derive(Clone, Copy)]
pub struct Square {
    /// The top-left pixel.
    pub origin: [isize; 2],
    /// Pixels along a side.
    pub side: usize,
    /// Width and height of the image.
    pub image: [usize; 2],
}

impl Square {
    /// Its middle, to half a pixel.
    pub fn center(self) -> Point2<f64> {
        Point2::from(self.origin.map(|v| (v + self.side as isize / 2) as f64))
    }

    /// The rows inside the image: the index of the first pixel there, of the square's row by row, and the image's
    /// columns and row.
    pub fn rows(self) -> impl Iterator<Item = (usize, Range<usize>, usize)> {
        let Self { origin, side, image } = self;
        let inside = move |n: usize| {
            let bound = |at: isize| at.clamp(0, image[n] as isize) as usize;
            bound(origin[n])..bound(origin[n] + side as isize)
        };
        let columns = inside(0);
        let first = columns.start as isize - origin[0];
        let index = move |y: usize| ((y as isize - origin[1]) * side as isize + first) as usize;
        inside(1).map(move |y| (index(y), columns.clone(), y))
    }

    /// Of the image's values, row by row, those of the rows inside.
    pub fn rows_of<T>(self, values: &[T]) -> impl Iterator<Item = &[T]> {
        let width = self.image[0];
        self.rows().map(move |(_, columns, y)| &values[y * width..][columns])
    }

    /// Of the image's values, row by row, those of all its pixels; outside the image 0.
    pub fn all_of(self, values: &[f32]) -> Vec<f32> {
        let mut all = vec![0.0; self.side * self.side];
        for ((first, ..), row) in self.rows().zip(self.rows_of(values)) {
            all[first..first + row.len()].copy_from_slice(row);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outside_the_image_is_nothing() {
        let image: Vec<f32> = (1..=12).map(|v| v as f32).collect();
        let of = |x, y| Square { origin: [x, y], side: 3, image: [4, 3] };
        assert_eq!(of(-1, -2).all_of(&image), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0]);
        assert_eq!(of(1, 0).all_of(&image), [2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 10.0, 11.0, 12.0]);
        assert_eq!(of(3, 2).all_of(&image), [12.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(of(9, 9).rows_of(&image).count(), 0);
    }
}
