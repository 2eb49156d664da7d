//! Image derivatives by Scharr's 3×3 kernels.

use crate::simd::{F32x8, LANES};

/// Factor by which the results of [`scharr`] exceed derivatives per pixel. The kernel's weights sum to 16, and
/// differences are taken over a distance of two pixels.
pub const SCHARR_SCALE: f32 = 32.0;

/// Returns Scharr's derivatives `[∂/∂x, ∂/∂y]` at eight consecutive samples of a row, times [`SCHARR_SCALE`].
///
/// `plane` is row-major with `stride` samples per row. `at` is the index of the first of the eight samples.
///
/// # Panics
/// If the 3×3 neighbourhood of one of the eight samples is not inside the plane.
#[inline(always)]
pub fn scharr<V: F32x8>(plane: &[f32], at: usize, stride: usize) -> [V; 2] {
    assert!(at > stride && at + stride + LANES < plane.len(), "the border is wide enough");
    let [up, down] = [at - stride, at + stride];
    // SAFETY: the first read is at index at − stride − 1, and all reads end before index at + stride + 1 + LANES.
    // The assertion checks both bounds.
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
    // Both derivatives use the differences along the two diagonals.
    let (falling, rising) = (h - a, c - f);
    let dx = (falling + rising) * three + (e - d) * ten;
    let dy = (falling - rising) * three + (g - b) * ten;
    [dx, dy]
}
