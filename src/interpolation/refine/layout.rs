//! Where the blocks of an image lie, and how they fade into each other.

use std::ops::Range;

/// Minimum side of a block, pixels; it is at least four times a window's radius, and so grows with images beyond
/// 640 pixels. Larger: one motion for pixels that move differently; smaller: more blocks, which costs time.
const MIN_SIDE: usize = 16;

/// A block's side over its overlap with a neighbour. (With 2, images of the six scenes that
/// parameters are chosen on are 0.03 dB better in the mean, and take twice as long to refine.) Larger: borders of
/// blocks show; smaller: time.
const SIDES_PER_OVERLAP: usize = 4;

/// Blocks of one size that overlap, over all of an image.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Width and height of the image.
    pub image: [usize; 2],
    /// Of a block, pixels.
    pub side: usize,
    /// The pixels that two neighbours share.
    pub overlap: usize,
}

impl Layout {
    /// For windows of this radius.
    pub fn new(image: [usize; 2], window_radius_px: usize) -> Self {
        let side = MIN_SIDE.max(4 * window_radius_px);
        Self { image, side, overlap: side / SIDES_PER_OVERLAP }
    }

    /// From a block to the next, pixels.
    fn step(&self) -> usize {
        self.side - self.overlap
    }

    /// Blocks in a row.
    fn across(&self) -> usize {
        self.along_side(0)
    }

    /// Blocks along the image's width or height.
    fn along_side(&self, n: usize) -> usize {
        (self.image[n] + self.overlap).div_ceil(self.step())
    }

    /// All blocks.
    pub fn count(&self) -> usize {
        self.across() * self.along_side(1)
    }

    /// The top-left pixel of a block, which may be outside the image.
    pub fn origin(&self, block: usize) -> [isize; 2] {
        let at = |n: usize| (n * self.step()) as isize - self.overlap as isize;
        [at(block % self.across()), at(block / self.across())]
    }

    /// The blocks' parts in row `y` of the image. Where parts overlap, their weights sum to 1.
    pub fn parts(&self, y: usize) -> impl Iterator<Item = RowPart> {
        let Self { image: [width, _], side, overlap } = *self;
        let (across, step) = (self.across(), self.step());
        let rows = self.along(y).into_iter().filter(|(.., weight)| *weight > 0.0);
        rows.flat_map(move |(block_row, row, weight)| {
            (0..across).map(move |k| {
                let first = if k == 0 { overlap } else { 0 };
                let start = (k * step + first - overlap).min(width);
                let end = (k * step + side - overlap).min(width);
                RowPart { block: block_row * across + k, row, first, columns: start..end, weight }
            })
        })
    }

    /// The weights of a block's pixels along a row or a column. (The product of both is a pixel's.)
    pub fn weights(&self) -> Vec<f32> {
        let share = |shared: usize| (shared as f32 + 0.5) / self.overlap as f32;
        let weight = |k: usize| match k.checked_sub(self.step()) {
            // Where both overlap, the next block takes over evenly.
            Some(shared) => 1.0 - share(shared),
            None if k < self.overlap => share(k),
            None => 1.0,
        };
        (0..self.side).map(weight).collect()
    }

    /// Of a row or a column of pixels: two blocks, the pixel's place in each, and its weight there, which may be 0
    /// for the second.
    fn along(&self, at: usize) -> [(usize, usize, f32); 2] {
        let step = self.step();
        let (block, within) = (at / step, at % step);
        let shared = (within + self.overlap).checked_sub(step);
        let next = shared.map_or(0.0, |shared| (shared as f32 + 0.5) / self.overlap as f32);
        [(block, within + self.overlap, 1.0 - next), (block + 1, shared.unwrap_or(0), next)]
    }
}

/// What a block has of a row of the image.
pub struct RowPart {
    /// The block.
    pub block: usize,
    /// Its own row.
    pub row: usize,
    /// Its own first column inside the image.
    pub first: usize,
    /// The image's columns; they may be none.
    pub columns: Range<usize>,
    /// The row's weight.
    pub weight: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_every_pixel_with_weights_that_sum_to_one() {
        for (image, radius) in [([1, 1], 0), ([64, 47], 2), ([37, 90], 5), ([13, 400], 50)] {
            let layout = Layout::new(image, radius);
            let weights = layout.weights();
            for y in 0..image[1] {
                let mut sums = vec![0.0_f32; image[0]];
                for RowPart { block, row, first, columns, weight } in layout.parts(y) {
                    for (k, x) in columns.enumerate() {
                        let [left, top] = layout.origin(block);
                        let at = [left + (first + k) as isize, top + row as isize];
                        assert_eq!(at, [x as isize, y as isize]);
                        assert!(block < layout.count() && row < layout.side);
                        sums[x] += weight * weights[first + k];
                    }
                }
                assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{y}: {sums:?}");
            }
        }
    }

    #[test]
    fn a_block_fades_evenly_into_the_next() {
        let layout = Layout::new([100, 100], 4);
        let weights = layout.weights();
        assert_eq!(weights[..5], [0.125, 0.375, 0.625, 0.875, 1.0]);
        assert_eq!(weights[11..], [1.0, 0.875, 0.625, 0.375, 0.125]);
    }
}
