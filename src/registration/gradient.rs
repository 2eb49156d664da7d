//! Derivatives of a plane of samples by Scharr's 3×3 kernels.

use crate::simd::{F32x8, LANES};

/// Divisor that turns the sums of [`scharr`] into a change of value per pixel: the weights of
/// Scharr's kernel, 3 + 10 + 3, over a baseline of two pixels.
pub const SCHARR_SCALE: f32 = 32.0;

/// Scharr's derivatives at eight neighbouring samples, `[∂/∂x, ∂/∂y]`, times [`SCHARR_SCALE`].
///
/// `plane` is row-major with `stride` samples a row; the first of the eight samples has index
/// `at`.
///
/// # Panics
/// If the 3×3 neighbourhoods of all eight samples are not inside the plane.
#[inline(always)]
pub fn scharr<V: F32x8>(plane: &[f32], at: usize, stride: usize) -> [V; 2] {
    assert!(at > stride && at + stride + LANES < plane.len(), "the border is wide enough");
    let [up, down] = [at - stride, at + stride];
    // SAFETY: the first index is − stride − 1, the last before at + stride + 1 + LANES.
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
