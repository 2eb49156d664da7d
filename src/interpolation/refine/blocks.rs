//! Overlapping blocks of pixels, and the weights with which the blocks are blended.

use nalgebra::Point2;
use std::ops::Range;

/// Minimum side of a block, pixels. The side is also at least four times the radius of the windows over which costs are
/// averaged.
const MIN_SIDE_PX: usize = 16;
/// Ratio of a block's side to its overlap with a neighbouring block. (With a ratio of 2, images of six scenes are
/// 0.03 dB better on average, and refinement takes twice as long.)
const SIDES_PER_OVERLAP: usize = 4;

/// A grid of overlapping square blocks of one size that cover an image.
#[derive(Clone, Copy, Debug)]
pub struct BlockGrid {
    /// Width and height of the image, pixels.
    pub image: [usize; 2],
    /// Side of a block, pixels.
    pub side: usize,
    /// Overlap of two neighbouring blocks, pixels.
    overlap: usize,
}

impl BlockGrid {
    /// Creates the grid for an image of this width and height. `window_radius_px` is the radius of the windows over
    /// which costs are averaged.
    pub fn new(image: [usize; 2], window_radius_px: usize) -> Self {
        let side = MIN_SIDE_PX.max(4 * window_radius_px);
        Self { image, side, overlap: side / SIDES_PER_OVERLAP }
    }

    /// Returns the distance between the origins of neighbouring blocks, pixels.
    fn step(&self) -> usize {
        self.side - self.overlap
    }

    /// Returns the number of blocks along an axis (0: x, 1: y).
    fn along_axis(&self, axis: usize) -> usize {
        (self.image[axis] + self.overlap).div_ceil(self.step())
    }

    /// Returns the number of blocks.
    pub fn count(&self) -> usize {
        self.along_axis(0) * self.along_axis(1)
    }

    /// Returns the square of pixels of block number `block`. Blocks are numbered row by row.
    pub fn area(&self, block: usize) -> BlockArea {
        let across = self.along_axis(0);
        let at = |n: usize| (n * self.step()) as isize - self.overlap as isize;
        let origin = [at(block % across), at(block / across)];
        BlockArea { origin, side: self.side, image: self.image }
    }

    /// Returns the weights of a block's columns. They are also the weights of its rows. The weight of a pixel is the
    /// product of the weights of its column and of its row. At each pixel of the image, the weights of the overlapping
    /// blocks sum to 1.
    pub fn weights(&self) -> Vec<f32> {
        let ramp = |k: usize| (k as f32 + 0.5) / self.overlap as f32;
        let weight = |k: usize| match k.checked_sub(self.step()) {
            Some(shared) => 1.0 - ramp(shared),
            None if k < self.overlap => ramp(k),
            None => 1.0,
        };
        (0..self.side).map(weight).collect()
    }
}

/// The square of pixels of a block. Part of the square may be outside the image.
#[derive(Clone, Copy)]
pub struct BlockArea {
    /// Column and row of the square's top-left pixel in the image. Negative to the left of the image and above it.
    pub origin: [isize; 2],
    /// Side of the square, pixels.
    pub side: usize,
    /// Width and height of the image, pixels.
    pub image: [usize; 2],
}

impl BlockArea {
    /// Returns the centre of the square in pixels. For an odd side, each coordinate is half a pixel smaller than the
    /// true centre's.
    pub fn center(self) -> Point2<f64> {
        Point2::from(self.origin.map(|v| (v + self.side as isize / 2) as f64))
    }

    /// Returns the parts of the block's rows that are inside the image. Each part is given by three values: the index
    /// of its first pixel in the block, the range of its columns in the image, and its row in the image.
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

    /// Returns the values at the block's pixels, row by row, without pixels outside the image. `values` holds one
    /// value for each pixel of the image.
    pub fn rows_of<T>(self, values: &[T]) -> impl Iterator<Item = &[T]> {
        let width = self.image[0];
        self.rows().map(move |(_, columns, y)| &values[y * width..][columns])
    }

    /// Returns the values at the block's pixels, row by row, with interleaved channels. Values outside the image
    /// are 0. `values` holds the values of the whole image.
    pub fn crop(self, values: &[f32], channels: usize) -> Vec<f32> {
        let mut all = vec![0.0; self.side * self.side * channels];
        for (first, columns, y) in self.rows() {
            let at = (y * self.image[0] + columns.start) * channels;
            let row = &values[at..][..columns.len() * channels];
            all[first * channels..][..row.len()].copy_from_slice(row);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_every_pixel_with_weights_that_sum_to_one() {
        for (image, radius) in [([1, 1], 0), ([64, 47], 2), ([37, 90], 5), ([13, 400], 50)] {
            let grid = BlockGrid::new(image, radius);
            let weights = grid.weights();
            let mut sums = vec![0.0_f32; image[0] * image[1]];
            for area in (0..grid.count()).map(|block| grid.area(block)) {
                for (first, columns, y) in area.rows() {
                    for (k, x) in columns.enumerate() {
                        let [column, row] = [first % grid.side + k, first / grid.side];
                        let at = [area.origin[0] + column as isize, area.origin[1] + row as isize];
                        assert_eq!(at, [x as isize, y as isize]);
                        sums[y * image[0] + x] += weights[column] * weights[row];
                    }
                }
            }
            assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{sums:?}");
        }
    }

    #[test]
    fn a_block_fades_evenly_into_the_next() {
        let grid = BlockGrid::new([100, 100], 4);
        let weights = grid.weights();
        assert_eq!(weights[..5], [0.125, 0.375, 0.625, 0.875, 1.0]);
        assert_eq!(weights[11..], [1.0, 0.875, 0.625, 0.375, 0.125]);
    }

    #[test]
    fn outside_the_image_is_nothing() {
        let image: Vec<f32> = (1..=12).map(|v| v as f32).collect();
        let of = |x, y| BlockArea { origin: [x, y], side: 3, image: [4, 3] };
        assert_eq!(of(-1, -2).crop(&image, 1), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0]);
        assert_eq!(of(1, 0).crop(&image, 1), [2.0, 3.0, 4.0, 6.0, 7.0, 8.0, 10.0, 11.0, 12.0]);
        assert_eq!(of(3, 2).crop(&image, 1), [12.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(of(9, 9).rows_of(&image).count(), 0);
    }
}
