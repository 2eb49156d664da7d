//! Where the blocks of an image lie, and how they fade into each other.

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
        self.image[0].div_ceil(self.step()) + 1
    }

    /// All blocks.
    pub fn count(&self) -> usize {
        self.across() * (self.image[1].div_ceil(self.step()) + 1)
    }

    /// The top-left pixel of a block, which may be outside the image.
    pub fn origin(&self, block: usize) -> [isize; 2] {
        let at = |n: usize| (n * self.step()) as isize - self.overlap as isize;
        [at(block % self.across()), at(block / self.across())]
    }

    /// The blocks that a pixel is in, the pixel's index in each, and each one's weight there; the weights' sum
    /// is 1.
    pub fn covering(&self, x: usize, y: usize) -> impl Iterator<Item = (usize, usize, f32)> {
        let Self { side, .. } = *self;
        let across = self.across();
        let [in_x, in_y] = [x, y].map(|at| self.along(at));
        in_y.into_iter().flat_map(move |(by, y, of_y)| {
            in_x.into_iter()
                .map(move |(bx, x, of_x)| (by * across + bx, y * side + x, of_x * of_y))
                .filter(|(.., weight)| *weight > 0.0)
        })
    }

    /// The same along one axis: two blocks, of which the second may have no weight.
    fn along(&self, at: usize) -> [(usize, usize, f32); 2] {
        let step = self.step();
        let (block, within) = (at / step, at % step);
        // Where both overlap, the next block takes over evenly.
        let shared = (within + self.overlap).checked_sub(step);
        let next = shared.map_or(0.0, |shared| (shared as f32 + 0.5) / self.overlap as f32);
        [(block, within + self.overlap, 1.0 - next), (block + 1, shared.unwrap_or(0), next)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cover_every_pixel_with_weights_that_sum_to_one() {
        for (image, radius) in [([1, 1], 0), ([64, 47], 2), ([37, 90], 5), ([13, 400], 50)] {
            let layout = Layout::new(image, radius);
            for k in 0..image[0] * image[1] {
                let (x, y) = (k % image[0], k / image[0]);
                let mut sum = 0.0;
                for (block, within, weight) in layout.covering(x, y) {
                    let [left, top] = layout.origin(block);
                    let at = [
                        left + (within % layout.side) as isize,
                        top + (within / layout.side) as isize,
                    ];
                    assert_eq!(at, [x as isize, y as isize]);
                    assert!(block < layout.count() && within < layout.side.pow(2));
                    sum += weight;
                }
                assert!((sum - 1.0_f32).abs() < 1e-6, "({x}, {y}): {sum}");
            }
        }
    }

    #[test]
    fn a_block_fades_evenly_into_the_next() {
        let layout = Layout::new([100, 100], 4);
        let of_first = |x: usize| {
            let first = layout.covering(x, 5).filter(|(block, ..)| *block == 0);
            first.map(|(.., weight)| weight).sum::<f32>()
        };
        let weights: Vec<f32> = (7..13).map(of_first).collect();
        assert_eq!(weights, [1.0, 0.875, 0.625, 0.375, 0.125, 0.0]);
    }
}
