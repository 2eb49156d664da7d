//! The pixels of a view while it is blended, and how its holes are closed and filled.

use super::composite::Pixel;
use super::grid::neighbors;
use super::motion::{MotionMap, QuantizedMotion};
use rayon::prelude::*;
use std::ops::Range;

/// Minimum number, of a pixel's eight neighbours, that must show a nearer moving body for the pixel to count as a hole
/// in the body.
const CLOSING: usize = 5;
/// Maximum distance from the border of a hole in a moving body at which the hole's pixels are closed, pixels. Pixels
/// farther inside stay unchanged.
const CLOSED_PX: usize = 4;

/// Kind of content that the scene flow maps show at a pixel of the view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shown {
    /// No splat covers the pixel.
    Nothing,
    /// No splat covers the pixel. It has been filled with the values of a neighbouring pixel.
    Filled,
    Something,
    /// A surface that is known to move.
    Moving,
}

impl Shown {
    /// Returns what a blended pixel shows.
    pub fn of(pixel: &Pixel) -> Self {
        if pixel.is_moving { Self::Moving } else { Self::Something }
    }
}

/// Colours and depths of all pixels of a view, row by row.
pub struct Pixels {
    pub colors: Vec<[f32; 3]>,
    /// Inverse depth of each pixel, 1/m; 0 where the depth is unknown.
    pub inverse_depths: Vec<f32>,
    pub shown: Vec<Shown>,
    /// Motion of the surface at each pixel; `None` if the motion isn't requested.
    pub motions: Option<MotionMap>,
}

/// The pixels of some rows of a view.
pub struct Band<'a> {
    pub rows: Range<usize>,
    pub colors: &'a mut [[f32; 3]],
    inverse_depths: &'a mut [f32],
    shown: &'a mut [Shown],
    /// Motion, if it is requested, and the factor with which it is quantized ([`QuantizedMotion::new`]).
    pub motions: Option<(&'a mut [QuantizedMotion], f32)>,
}

impl Band<'_> {
    /// Sets the `k`-th pixel of the band.
    #[inline(always)]
    pub fn set(&mut self, k: usize, pixel: &Pixel) {
        self.colors[k] = pixel.color;
        self.inverse_depths[k] = pixel.inverse_depth;
        self.shown[k] = Shown::of(pixel);
    }
}

impl Pixels {
    pub fn new(count: usize, motions: Option<MotionMap>) -> Self {
        Self {
            motions,
            colors: vec![[0.0; 3]; count],
            inverse_depths: vec![0.0; count],
            shown: vec![Shown::Nothing; count],
        }
    }

    /// Divides the pixels into bands of `rows_at_once` rows; the last one may have less. `width` is the width of the view,
    /// pixels.
    pub fn bands(&mut self, width: usize, rows_at_once: usize) -> Vec<Band<'_>> {
        let count = (width * rows_at_once).max(1);
        let colors = self.colors.chunks_mut(count);
        let depths = self.inverse_depths.chunks_mut(count).zip(self.shown.chunks_mut(count));
        let mut motions = self.motions.as_mut().map(|map| {
            let (pixels, disparity_px) = map.pixels_mut();
            (pixels.chunks_mut(count), disparity_px)
        });
        let mut bands = Vec::new();
        for (k, (colors, (inverse_depths, shown))) in colors.zip(depths).enumerate() {
            let first = k * rows_at_once;
            let rows = first..first + colors.len() / width;
            let motions = motions.as_mut().and_then(|(chunks, px)| Some((chunks.next()?, *px)));
            bands.push(Band { rows, colors, inverse_depths, shown, motions });
        }
        bands
    }

    /// Closes holes in moving bodies: pixels that show a farther surface, although most of their neighbours show the
    /// body. Holes are closed from the border inwards, one ring of pixels at a time. A closed pixel gets the mean
    /// colour and inverse depth of its neighbours that show the body, and the motion of one of them. `width` is the
    /// width of the view, pixels.
    pub fn close(&mut self, width: usize) {
        let height = self.shown.len() / width;
        let is_body = |shown: &[Shown], n: usize| shown[n] == Shown::Moving;
        for _ in 0..CLOSED_PX {
            let closed = |k: usize| {
                let (x, y) = (k % width, k / width);
                if is_body(&self.shown, k) || x == 0 || y == 0 || x + 1 == width || y + 1 == height
                {
                    return None;
                }
                let around = (0..9).map(|n| k + (n / 3) * width + n % 3 - width - 1);
                let body: Vec<usize> = around.filter(|&n| is_body(&self.shown, n)).collect();
                if body.len() < CLOSING {
                    return None;
                }
                let mean = |value: &dyn Fn(usize) -> f32| {
                    body.iter().map(|&n| value(n)).sum::<f32>() / body.len() as f32
                };
                let color = [0, 1, 2].map(|c| mean(&|n| self.colors[n][c]));
                let inverse_depth = mean(&|n| self.inverse_depths[n]);
                let is_hole = inverse_depth > self.inverse_depths[k];
                is_hole.then(|| (k, body[0], color, inverse_depth))
            };
            let found: Vec<_> = (0..self.shown.len()).into_par_iter().filter_map(closed).collect();
            if found.is_empty() {
                return;
            }
            for (k, neighbor, color, inverse_depth) in found {
                (self.colors[k], self.inverse_depths[k]) = (color, inverse_depth);
                self.shown[k] = Shown::Moving;
                self.motions.iter_mut().for_each(|m| m.copy(neighbor, k));
            }
        }
    }

    /// Fills the holes of the view (pixels that no scene flow map covers) from the border inwards, one ring of pixels
    /// at a time. Holes are disoccluded background. A pixel therefore gets the values of the farthest surface beside it:
    /// the mean of those neighbours, covered or already filled, whose inverse depths differ from the smallest by less
    /// than `reach`, 1/m. `width` is the width of the view, pixels.
    pub fn fill(&mut self, width: usize, reach: f32) {
        let count = self.shown.len();
        let around = |k: u32| neighbors(k as usize, width, count);
        // Views have less than 2³² pixels.
        let is_empty = |shown: &[Shown], k: usize| shown[k] == Shown::Nothing;
        let mut ring: Vec<u32> = (0..self.shown.len() as u32)
            .into_par_iter()
            .filter(|&k| {
                is_empty(&self.shown, k as usize) && around(k).any(|n| !is_empty(&self.shown, n))
            })
            .collect();
        while !ring.is_empty() {
            let fill = |&k: &u32| {
                let known = around(k).filter(|&n| !is_empty(&self.shown, n));
                self.background(&known.collect::<Vec<_>>(), reach)
            };
            let filled: Vec<Option<(usize, [f32; 3], f32)>> = ring.iter().map(fill).collect();
            for (&k, filled) in ring.iter().zip(filled) {
                let Some((farthest, color, inverse_depth)) = filled else { continue };
                let k = k as usize;
                (self.colors[k], self.inverse_depths[k]) = (color, inverse_depth);
                self.motions.iter_mut().for_each(|m| m.copy(farthest, k));
                self.shown[k] = Shown::Filled;
            }
            let next = |&k: &u32| around(k).filter(|&n| is_empty(&self.shown, n)).map(|n| n as u32);
            ring = ring.iter().flat_map(next).collect();
            ring.sort_unstable();
            ring.dedup();
        }
    }

    /// Returns the farthest of some pixels, and the mean colour and inverse depth of those whose inverse depth differs
    /// from its by less than `reach`. `None` if there are no pixels.
    fn background(&self, pixels: &[usize], reach: f32) -> Option<(usize, [f32; 3], f32)> {
        let inverse = |n: &usize| self.inverse_depths[*n];
        let farthest = *pixels.iter().min_by(|a, b| inverse(a).total_cmp(&inverse(b)))?;
        let (mut color, mut inverse_depth, mut count) = ([0.0; 3], 0.0, 0.0);
        let is_beside = |n: &&usize| **n == farthest || inverse(n) < inverse(&farthest) + reach;
        for n in pixels.iter().filter(is_beside) {
            color = [0, 1, 2].map(|c| color[c] + self.colors[*n][c]);
            inverse_depth += inverse(n);
            count += 1.0;
        }
        // The farthest pixel is one of them, so that the count is positive.
        Some((farthest, color.map(|c| c / count), inverse_depth / count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_gets_the_mean_of_the_background_beside_it_whatever_is_nearer() {
        // A row of pixels: wall, hole, wall of another colour, a hole of three pixels, a nearer body.
        let mut pixels = Pixels::new(7, None);
        let known = [(0, 0.2, 1.0), (2, 0.4, 1.01), (6, 0.9, 3.0)];
        for (k, value, inverse_depth) in known {
            (pixels.colors[k], pixels.inverse_depths[k]) = ([value; 3], inverse_depth);
            pixels.shown[k] = Shown::Something;
        }
        pixels.fill(7, 0.1);
        let values: Vec<f32> = pixels.colors.iter().map(|[r, _, _]| *r).collect();
        assert!((values[1] - 0.3).abs() < 1e-6, "{values:?}");
        assert!((pixels.inverse_depths[1] - 1.005).abs() < 1e-6);
        // From both sides, the fill meets in the middle, where the farther surface counts.
        assert_eq!(values[3..6], [0.4, 0.4, 0.9]);
        assert!(pixels.shown.iter().all(|shown| *shown != Shown::Nothing));
    }
}
