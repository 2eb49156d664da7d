//! Eight samples at a time: the inner loops of the tracker, plain and spelled out for AVX2, with
//! the same operations in the same order, so that both give the same bits.

/// Rows of a window are padded to a multiple of this many samples with zero gradients, which add
/// nothing to the sums: fixed lanes make the sums the same on every machine, and let the compiler
/// use its vectors.
pub const LANES: usize = 8;

#[inline(always)]
pub fn bilinear(top: &[f32], bottom: &[f32], k: usize, w: [f32; 4]) -> Lanes {
    let upper = blend(lanes(top, k), w[0], lanes(top, k + 1), w[1]);
    let lower = blend(lanes(bottom, k), w[2], lanes(bottom, k + 1), w[3]);
    add(&upper, &lower)
}

/// The same operations in the same order as below, spelled out as vectors.
#[cfg(target_arch = "x86_64")]
pub mod avx2 {
    use super::{LANES, Lanes, lanes};
    use std::arch::x86_64::{
        __m256, _mm256_add_ps, _mm256_loadu_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_storeu_ps,
    };

    #[inline]
    #[target_feature(enable = "avx2")]
    pub fn load(row: &[f32], at: usize) -> __m256 {
        // SAFETY: the array has the eight values that are read.
        unsafe { _mm256_loadu_ps(lanes(row, at).as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub fn store(v: __m256) -> Lanes {
        let mut out = [0.0; LANES];
        // SAFETY: the array has room for the eight values that are written.
        unsafe { _mm256_storeu_ps(out.as_mut_ptr(), v) };
        out
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub fn bilinear(top: &[f32], bottom: &[f32], k: usize, w: [f32; 4]) -> __m256 {
        let part = |row: &[f32], at: usize, w: f32| _mm256_mul_ps(_mm256_set1_ps(w), load(row, at));
        let upper = _mm256_add_ps(part(top, k, w[0]), part(top, k + 1, w[1]));
        let lower = _mm256_add_ps(part(bottom, k, w[2]), part(bottom, k + 1, w[3]));
        _mm256_add_ps(upper, lower)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub fn interpolate(plane: &[f32], at: usize, stride: usize, w: [f32; 4], out: &mut [f32]) {
        let top = &plane[at..at + out.len() + 1];
        let bottom = &plane[at + stride..at + stride + out.len() + 1];
        for k in (0..out.len()).step_by(LANES) {
            out[k..k + LANES].copy_from_slice(&store(bilinear(top, bottom, k, w)));
        }
    }
}

#[inline(always)]
pub fn interpolate(plane: &[f32], at: usize, stride: usize, w: [f32; 4], out: &mut [f32]) {
    let top = &plane[at..at + out.len() + 1];
    let bottom = &plane[at + stride..at + stride + out.len() + 1];
    let whole = out.len() - out.len() % LANES;
    for k in (0..whole).step_by(LANES) {
        out[k..k + LANES].copy_from_slice(&bilinear(top, bottom, k, w));
    }
    for k in whole..out.len() {
        out[k] = (w[0] * top[k] + w[1] * top[k + 1]) + (w[2] * bottom[k] + w[3] * bottom[k + 1]);
    }
}

#[inline(always)]
pub fn lanes(row: &[f32], at: usize) -> &[f32; LANES] {
    row[at..].first_chunk().expect("rows are padded to whole lanes")
}

pub type Lanes = [f32; LANES];

#[inline(always)]
pub fn add(a: &Lanes, b: &Lanes) -> Lanes {
    std::array::from_fn(|l| a[l] + b[l])
}

#[inline(always)]
pub fn subtract(a: &Lanes, b: &Lanes) -> Lanes {
    std::array::from_fn(|l| a[l] - b[l])
}

#[inline(always)]
pub fn multiply(a: &Lanes, b: &Lanes) -> Lanes {
    std::array::from_fn(|l| a[l] * b[l])
}

#[inline(always)]
fn blend(a: &Lanes, weight_a: f32, b: &Lanes, weight_b: f32) -> Lanes {
    std::array::from_fn(|l| weight_a * a[l] + weight_b * b[l])
}

pub fn sum_lanes(v: [f32; LANES]) -> f64 {
    v.into_iter().map(f64::from).sum()
}
