//! A coarse mask of an image, in tiles of 16×16 pixels. It marks the parts of the image that must be computed.

/// Side length of a tile, pixels.
const SIDE: usize = 16;

/// A mask of an image's square tiles of 16×16 pixels. Marked tiles must be computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tiles {
    across: usize,
    down: usize,
    marked: Vec<bool>,
}

impl Tiles {
    /// Makes a mask without marked tiles, for an image of the given width and height, pixels.
    ///
    /// # Panics
    /// If a dimension is 0.
    pub fn none(width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "an image has no empty dimension");
        let (across, down) = (width.div_ceil(SIDE), height.div_ceil(SIDE));
        Self { across, down, marked: vec![false; across * down] }
    }

    /// Returns whether any tile is marked.
    pub fn any(&self) -> bool {
        self.marked.contains(&true)
    }

    /// Marks the tiles whose pixels are read when the image is interpolated at the position (x, y), pixels, by any
    /// method of [`Sampling`](super::Sampling). A position outside of the image marks border tiles, and NaN marks the
    /// first tile.
    pub fn mark_sample(&mut self, x: f32, y: f32) {
        self.mark_samples([x, y], [x, y]);
    }

    /// Marks the tiles whose pixels are read when the image is interpolated at any position in a rectangle. `low` and
    /// `high` are the rectangle's top left and bottom right corner, pixels.
    pub fn mark_samples(&mut self, low: [f32; 2], high: [f32; 2]) {
        // The support of the cubic filter is two pixels on each side. Positions beyond the range of integers saturate
        // in the cast.
        let span = |axis: usize, tiles: usize| {
            let tile = |v: f32| (v.max(0.0) as usize / SIDE).min(tiles - 1);
            tile(low[axis] - 2.0)..=tile(high[axis] + 2.0)
        };
        for row in span(1, self.down) {
            self.marked[row * self.across..][..self.across][span(0, self.across)].fill(true);
        }
    }

    /// Returns whether a square overlaps a marked tile. `corner` is the square's top left corner, pixels, which may lie
    /// outside of the image. `side` is the square's side length, pixels.
    pub fn touches(&self, corner: [isize; 2], side: usize) -> bool {
        let span = |from: isize, tiles: usize| {
            let end = from.saturating_add_unsigned(side).max(0) as usize;
            from.max(0) as usize / SIDE..end.div_ceil(SIDE).min(tiles)
        };
        span(corner[1], self.down).any(|row| {
            span(corner[0], self.across).any(|column| self.marked[row * self.across + column])
        })
    }

    /// Returns the ranges of columns in which the pixels of row `y` lie in marked tiles. Each range is `[start, end]`,
    /// where `end` is exclusive and may lie beyond the image.
    pub fn spans(&self, y: usize) -> impl Iterator<Item = [usize; 2]> {
        let row = &self.marked[y / SIDE * self.across..][..self.across];
        let runs = row.chunk_by(|a, b| a == b);
        let placed = runs.scan(0, |at, run| {
            let first = *at;
            *at += run.len();
            Some((run[0], [first * SIDE, *at * SIDE]))
        });
        placed.filter_map(|(is_marked, span)| is_marked.then_some(span))
    }

    /// Returns the mask dilated by `px` pixels, rounded up to whole tiles.
    pub fn grown(&self, px: usize) -> Self {
        let reach = px.div_ceil(SIDE);
        let mut grown = Self { marked: vec![false; self.marked.len()], ..*self };
        for k in (0..self.marked.len()).filter(|k| self.marked[*k]) {
            let (column, row) = (k % self.across, k / self.across);
            let span =
                |at: usize, tiles: usize| at.saturating_sub(reach)..(at + reach + 1).min(tiles);
            for row in span(row, self.down) {
                grown.marked[row * self.across..][span(column, self.across)].fill(true);
            }
        }
        grown
    }

    /// Marks, in addition, all tiles that are marked in the mask `other`. Its image must have the same size.
    pub fn add(&mut self, other: &Self) {
        self.marked.iter_mut().zip(&other.marked).for_each(|(own, other)| *own |= other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_mark_all_tiles_within_reach() {
        let (w, h) = (70, 33);
        let all = |tiles: &Tiles| {
            let pixels = (0..w * h).map(|k| [(k % w) as isize, (k / w) as isize]);
            pixels.filter(|at| tiles.touches(*at, 1)).count()
        };
        assert_eq!(all(&Tiles::none(w, h)), 0);
        for (x, y, pixels) in [
            (8.0, 8.0, 16 * 16),
            (15.0, 8.0, 2 * 16 * 16),
            (17.5, 14.5, 4 * 16 * 16),
            (69.5, 32.5, 6 * (1 + 16)),
            (1e30, f32::INFINITY, 6),
            (f32::NEG_INFINITY, f32::NAN, 16 * 16),
        ] {
            let mut tiles = Tiles::none(w, h);
            tiles.mark_sample(x, y);
            assert!(tiles.any());
            assert_eq!(all(&tiles), pixels, "{x} {y}");
        }
    }

    #[test]
    fn squares_touch_tiles_that_they_share_a_pixel_with() {
        let mut tiles = Tiles::none(64, 64);
        tiles.mark_sample(24.0, 24.0);
        for (corner, side, touches) in [
            ([0, 0], 16, false),
            ([0, 0], 17, true),
            ([-8, -8], 16, false),
            ([-8, -8], 25, true),
            ([31, 31], 16, true),
            ([32, 16], 16, false),
            ([900, 900], 16, false),
        ] {
            assert_eq!(tiles.touches(corner, side), touches, "{corner:?} {side}");
        }
        let mut other = Tiles::none(64, 64);
        other.add(&tiles);
        assert_eq!(other, tiles);
    }

    #[test]
    fn spans_and_grown_tiles_are_those_near_marked_ones() {
        let mut tiles = Tiles::none(100, 70);
        tiles.mark_sample(24.0, 24.0);
        tiles.mark_sample(72.0, 24.0);
        assert_eq!(tiles.spans(20).collect::<Vec<_>>(), [[16, 32], [64, 80]]);
        assert_eq!(tiles.spans(40).count(), 0);
        assert_eq!(tiles.grown(0), tiles);
        let grown = tiles.grown(16);
        assert_eq!(grown.spans(20).collect::<Vec<_>>(), [[0, 96]]);
        assert_eq!(grown.spans(47).count(), 1);
        assert_eq!(grown.spans(48).count(), 0);
        assert_eq!(tiles.grown(17).spans(63).collect::<Vec<_>>(), [[0, 112]]);
    }
}
