//! Reads windows of a pyramid level at sub-pixel positions, by bilinear interpolation.

use super::pyramid::PyramidLevel;
use crate::simd::{F32x8, LANES};
use nalgebra::Vector2;

/// Returns the fraction, 0..=1, of a linearly interpolated sample's weight that is on pixels inside the image,
/// along one axis. The rest of the weight is on padding, which carries no information. `v` is the sample's position
/// in pixels, with the centre of the first pixel at 0. `size` is the size of the image in pixels.
#[inline(always)]
pub fn fraction_inside(v: f64, size: usize) -> f32 {
    (1.0 + v.min(size as f64 - 1.0 - v)).clamp(0.0, 1.0) as f32
}

/// A window of a row-major plane at a sub-pixel position. It is read row by row through [`Columns`].
#[derive(Clone, Copy)]
pub struct Window<'a> {
    plane: &'a [f32],
    base: usize,
    stride: usize,
    /// Number of samples in each row of the window.
    row: usize,
    rows: usize,
    /// Fractional part (x, y) of the window's position, each in 0..1.
    within: [f32; 2],
}

/// Reader of a strip of a [`Window`]. The strip is 8·B columns wide and is read row by row.
pub struct Columns<'a, V, const B: usize> {
    plane: &'a [f32],
    stride: usize,
    /// Index in the plane of the first sample of the next row to read.
    next: usize,
    /// Index in the plane of the first sample of the last row that may be read.
    end: usize,
    within: [V; 2],
    /// The plane's row that was read last, interpolated horizontally.
    above: [V; B],
}

impl<'a> Window<'a> {
    /// Returns the window around `p` in a level. The window has `rows` rows of `row` samples. Its top-left sample
    /// is `radius` pixels to the left of `p` and `radius` pixels above. `p` is in pixels, with the centre of the
    /// first pixel at (0, 0). Returns `None` if `p` is more than a pixel outside the image.
    ///
    /// # Panics
    /// If the window and its bilinear neighbours are not inside the padded level.
    #[inline(always)]
    pub fn around(
        level: &'a PyramidLevel,
        p: &Vector2<f64>,
        radius: usize,
        [row, rows]: [usize; 2],
    ) -> Option<Self> {
        let inside = |v: f64, size: usize| v >= -1.0 && v <= size as f64;
        if !(inside(p.x, level.width) && inside(p.y, level.height)) {
            return None;
        }
        let (x, y) = (p.x.floor(), p.y.floor());
        let base = level.index(x as isize - radius as isize, y as isize - radius as isize);
        let (plane, stride) = (&level.value[..], level.stride);
        assert!(base + rows * stride + row < plane.len(), "the border is wide enough");
        Some(Self { plane, base, stride, row, rows, within: [(p.x - x) as f32, (p.y - y) as f32] })
    }

    /// Returns a reader of the strip of 8·B columns that starts at column `x`. The reader starts at the top row.
    ///
    /// # Panics
    /// If the strip is not inside the window.
    #[inline(always)]
    pub fn columns<V: F32x8, const B: usize>(&self, x: usize) -> Columns<'a, V, B> {
        assert!(x + B * LANES <= self.row);
        let mut columns = Columns {
            plane: self.plane,
            stride: self.stride,
            next: self.base + x,
            end: self.base + self.rows * self.stride + x,
            within: V::splats(self.within),
            above: [V::zero(); B],
        };
        columns.above = columns.next_plane_row();
        columns
    }
}

impl<V: F32x8, const B: usize> Columns<'_, V, B> {
    /// Reads the next row of the plane, interpolated horizontally.
    #[inline(always)]
    fn next_plane_row(&mut self) -> [V; B] {
        assert!(self.next <= self.end);
        let mut row = [V::zero(); B];
        for (b, out) in row.iter_mut().enumerate() {
            let at = self.next + b * LANES;
            // SAFETY: the assertion checks that the row is not after `end`. `Window::around` and `Window::columns`
            // checked that row `end` and the strip's columns are inside the plane.
            let [left, right] = unsafe {
                [V::load_unchecked(self.plane, at), V::load_unchecked(self.plane, at + 1)]
            };
            *out = (right - left).mul_add(self.within[0], left);
        }
        self.next += self.stride;
        row
    }

    /// Reads the next row of the strip, interpolated horizontally and vertically.
    ///
    /// # Panics
    /// If all rows have been read.
    #[inline(always)]
    pub fn row(&mut self) -> [V; B] {
        let below = self.next_plane_row();
        let mut row = [V::zero(); B];
        for b in 0..B {
            row[b] = (below[b] - self.above[b]).mul_add(self.within[1], self.above[b]);
        }
        self.above = below;
        row
    }
}

#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests {
    use super::super::affine_tracker::catmull_rom;
    use super::super::gradient::scharr;
    use super::*;
    use crate::simd::{Avx2, Scalar, has_avx2_and_fma};

    #[test]
    fn avx2_equals_scalar_to_1e_5() {
        if !has_avx2_and_fma() {
            return;
        }
        let plane: Vec<f32> = (0..400).map(|k| (k as f32 * 0.77).sin()).collect();
        let values: [f32; LANES] = std::array::from_fn(|l| (l as f32 * 1.7).cos() * 3.0);
        let first: [usize; LANES] = std::array::from_fn(|l| 17 * l + l * l);
        fn all<V: F32x8>(
            plane: &[f32],
            values: &[f32; LANES],
            first: &[usize; LANES],
        ) -> Vec<[f32; LANES]> {
            let v = V::from_array(values);
            let (floor, fraction) = v.floor_and_fraction();
            let weights = catmull_rom(fraction);
            let (row, rows, within) = (2 * LANES, 3, [0.3, 0.8]);
            let window = Window { plane, base: 5, stride: 30, row, rows, within };
            let mut columns = window.columns::<V, 2>(0);
            let [first_row, _] = columns.row();
            let [_, second_row] = columns.row();
            let cubic = V::gather_4x4(plane, first, 20, weights, catmull_rom(fraction * fraction));
            let mut out = vec![fraction.to_array(), floor.map(|w| w as f32), v.abs().to_array()];
            out.extend([first_row, second_row, cubic, v - fraction].map(V::to_array));
            out.extend(scharr::<V>(plane, 40, 20).map(V::to_array));
            out.push([v.sum() as f32; LANES]);
            out
        }
        let (scalar, avx2) =
            (all::<Scalar>(&plane, &values, &first), all::<Avx2>(&plane, &values, &first));
        for (a, b) in scalar.iter().flatten().zip(avx2.iter().flatten()) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }
}
