//! Windows of an image, between its pixels: what is cut out of a plane, and its derivatives.

use super::lanes::{LANES, Vector};
use super::pyramid::Level;
use nalgebra::Vector2;

/// The padded index of a window's top-left sample and its place within that pixel; `None` if the
/// window's middle is more than a pixel outside the image.
#[inline(always)]
pub fn corner(level: &Level, p: &Vector2<f64>, radius: usize) -> Option<(usize, [f32; 2])> {
    let inside = |v: f64, size: usize| v >= -1.0 && v <= size as f64;
    if !(inside(p.x, level.width) && inside(p.y, level.height)) {
        return None;
    }
    let (x, y) = (p.x.floor(), p.y.floor());
    let base = level.index(x as isize - radius as isize, y as isize - radius as isize);
    Some((base, [(p.x - x) as f32, (p.y - y) as f32]))
}

/// How much of a sample at `v` (0: the first pixel's centre) comes from inside the image: what is
/// outside is a copy of the border, and has no say.
#[inline(always)]
pub fn share_inside(v: f64, size: usize) -> f32 {
    (1.0 + v.min(size as f64 - 1.0 - v)).clamp(0.0, 1.0) as f32
}

/// A window of a plane between its samples, cut out row by row.
#[derive(Clone, Copy)]
pub struct Window<'a> {
    plane: &'a [f32],
    base: usize,
    stride: usize,
    row: usize,
    rows: usize,
    /// The window's place within the pixel.
    within: [f32; 2],
}

/// Some columns of a [`Window`], 8·B wide, interpolated downwards.
pub struct Columns<'a, V, const B: usize> {
    plane: &'a [f32],
    stride: usize,
    next: usize,
    end: usize,
    within: [V; 2],
    above: [V; B],
}

impl<'a> Window<'a> {
    /// `rows` rows of `row` samples, a fraction of a pixel (x, y) after `base`.
    ///
    /// # Panics
    /// If it is not inside the plane.
    #[inline(always)]
    pub fn new(
        plane: &'a [f32],
        base: usize,
        stride: usize,
        [row, rows]: [usize; 2],
        within: [f32; 2],
    ) -> Self {
        assert!(base + rows * stride + row < plane.len(), "the border is wide enough");
        Self { plane, base, stride, row, rows, within }
    }

    /// From the top, 8·B columns from `x` on.
    ///
    /// # Panics
    /// If they are not in the window.
    #[inline(always)]
    pub fn columns<V: Vector, const B: usize>(&self, x: usize) -> Columns<'a, V, B> {
        assert!(x + B * LANES <= self.row);
        let mut columns = Columns {
            plane: self.plane,
            stride: self.stride,
            next: self.base + x,
            end: self.base + self.rows * self.stride + x,
            within: V::splats(self.within),
            above: [V::zero(); B],
        };
        columns.above = columns.across();
        columns
    }
}

impl<V: Vector, const B: usize> Columns<'_, V, B> {
    /// The plane's next row, interpolated across.
    #[inline(always)]
    fn across(&mut self) -> [V; B] {
        assert!(self.next <= self.end);
        let mut row = [V::zero(); B];
        for (b, out) in row.iter_mut().enumerate() {
            let at = self.next + b * LANES;
            // SAFETY: the last is at the `end` of the rows and columns that `Window::new` found
            // inside.
            let [left, right] = unsafe {
                [V::load_unchecked(self.plane, at), V::load_unchecked(self.plane, at + 1)]
            };
            *out = right.sub(left).mul_add(self.within[0], left);
        }
        self.next += self.stride;
        row
    }

    /// The window's next row.
    ///
    /// # Panics
    /// If there is none.
    #[inline(always)]
    pub fn row(&mut self) -> [V; B] {
        let below = self.across();
        let mut row = [V::zero(); B];
        for b in 0..B {
            row[b] = below[b].sub(self.above[b]).mul_add(self.within[1], self.above[b]);
        }
        self.above = below;
        row
    }
}

/// Eight of Scharr's 3×3 derivatives across and down, times 32, from a pixel on.
///
/// # Panics
/// If the pixels around are not in the plane.
#[inline(always)]
pub fn scharr<V: Vector>(plane: &[f32], at: usize, stride: usize) -> [V; 2] {
    assert!(at > stride && at + stride + LANES < plane.len(), "the border is wide enough");
    let [up, down] = [at - stride, at + stride];
    // SAFETY: the first is at − stride − 1, the last before at + stride + 1 + LANES.
    let [a, b, c, d, e, f, g, h] = unsafe {
        [
            V::load_unchecked(plane, up - 1),
            V::load_unchecked(plane, up),
            V::load_unchecked(plane, up + 1),
            V::load_unchecked(plane, at - 1),
            V::load_unchecked(plane, at + 1),
            V::load_unchecked(plane, down - 1),
            V::load_unchecked(plane, down),
            V::load_unchecked(plane, down + 1),
        ]
    };
    let (three, ten) = (V::splat(3.0), V::splat(10.0));
    // The corners' differences are shared: along the diagonals.
    let (falling, rising) = (h.sub(a), c.sub(f));
    let dx = falling.add(rising).mul(three).add(e.sub(d).mul(ten));
    let dy = falling.sub(rising).mul(three).add(g.sub(b).mul(ten));
    [dx, dy]
}
