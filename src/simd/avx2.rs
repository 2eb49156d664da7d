//! The implementation of [`F32x8`] for processors with AVX2 and FMA.

use super::integers::Avx2Integers;
use super::{F32x8, LANES};
use std::arch::x86_64::*;

/// Implementation of [`F32x8`] as a 256-bit register, for processors with AVX2 and FMA. Only
/// [`multiversion!`](super::multiversion) uses this type. Its methods are therefore inlined into functions that
/// are compiled for these instructions.
#[derive(Clone, Copy)]
pub struct Avx2(pub(super) __m256);

// SAFETY of all blocks below: this type is used only on processors with AVX2 and FMA, and all loads and stores
// are within their arrays.
operator!(Avx2, Add add, |a, b| unsafe { Avx2(_mm256_add_ps(a.0, b.0)) });
operator!(Avx2, Sub sub, |a, b| unsafe { Avx2(_mm256_sub_ps(a.0, b.0)) });
operator!(Avx2, Mul mul, |a, b| unsafe { Avx2(_mm256_mul_ps(a.0, b.0)) });
operator!(Avx2, Div div, |a, b| unsafe { Avx2(_mm256_div_ps(a.0, b.0)) });

impl F32x8 for Avx2 {
    type Integers = Avx2Integers;

    #[inline(always)]
    fn from_array(lanes: &[f32; LANES]) -> Self {
        unsafe { Self(_mm256_loadu_ps(lanes.as_ptr())) }
    }

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), self.0) };
        lanes
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        unsafe { Self(_mm256_fmadd_ps(self.0, factor.0, term.0)) }
    }

    #[inline(always)]
    fn if_below(self, other: Self, then: Self, otherwise: Self) -> Self {
        unsafe {
            let below = _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0);
            Self(_mm256_blendv_ps(otherwise.0, then.0, below))
        }
    }

    #[inline(always)]
    fn simd_min(self, other: Self) -> Self {
        unsafe { Self(_mm256_min_ps(self.0, other.0)) }
    }

    #[inline(always)]
    fn simd_max(self, other: Self) -> Self {
        unsafe { Self(_mm256_max_ps(self.0, other.0)) }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        unsafe { Self(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)) }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        unsafe { Self(_mm256_sqrt_ps(self.0)) }
    }

    #[inline(always)]
    fn floor_and_fraction(self) -> ([i32; LANES], Self) {
        let mut whole = [0; LANES];
        unsafe {
            let floor = _mm256_floor_ps(self.0);
            _mm256_storeu_si256(whole.as_mut_ptr().cast(), _mm256_cvttps_epi32(floor));
            (whole, Self(_mm256_sub_ps(self.0, floor)))
        }
    }

    #[inline(always)]
    fn transposed(records: &[[i16; 8]; LANES]) -> [Self; 8] {
        unsafe {
            let mut rows = [_mm_setzero_si128(); LANES];
            for (row, record) in rows.iter_mut().zip(records) {
                *row = _mm_loadu_si128(record.as_ptr().cast());
            }
            let [a, b, c, d, e, f, g, h] = rows;
            // Pairs of records, then fours, then all eight, beside each other.
            let (ab, ab_high) = (_mm_unpacklo_epi16(a, b), _mm_unpackhi_epi16(a, b));
            let (cd, cd_high) = (_mm_unpacklo_epi16(c, d), _mm_unpackhi_epi16(c, d));
            let (ef, ef_high) = (_mm_unpacklo_epi16(e, f), _mm_unpackhi_epi16(e, f));
            let (gh, gh_high) = (_mm_unpacklo_epi16(g, h), _mm_unpackhi_epi16(g, h));
            let (first, first_high) = (_mm_unpacklo_epi32(ab, cd), _mm_unpackhi_epi32(ab, cd));
            let (last, last_high) = (_mm_unpacklo_epi32(ef, gh), _mm_unpackhi_epi32(ef, gh));
            let (third, third_high) =
                (_mm_unpacklo_epi32(ab_high, cd_high), _mm_unpackhi_epi32(ab_high, cd_high));
            let (fourth, fourth_high) =
                (_mm_unpacklo_epi32(ef_high, gh_high), _mm_unpackhi_epi32(ef_high, gh_high));
            let columns = [
                _mm_unpacklo_epi64(first, last),
                _mm_unpackhi_epi64(first, last),
                _mm_unpacklo_epi64(first_high, last_high),
                _mm_unpackhi_epi64(first_high, last_high),
                _mm_unpacklo_epi64(third, fourth),
                _mm_unpackhi_epi64(third, fourth),
                _mm_unpacklo_epi64(third_high, fourth_high),
                _mm_unpackhi_epi64(third_high, fourth_high),
            ];
            let mut all = [Self(_mm256_setzero_ps()); 8];
            for (vector, column) in all.iter_mut().zip(columns) {
                vector.0 = _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(column));
            }
            all
        }
    }

    #[inline(always)]
    fn gather_4x4(
        plane: &[f32],
        first: &[usize; LANES],
        stride: usize,
        x: [Self; 4],
        y: [Self; 4],
    ) -> Self {
        // A single check for all loads below: the last row of each neighbourhood must be inside the
        // plane.
        let mut last = 0;
        for &first in first {
            last = last.max(first);
        }
        assert!(last + 3 * stride + 4 <= plane.len(), "the border is wide enough");
        // Neighbourhoods k and k + 4 share a register, which holds a row of four samples of each.
        macro_rules! column_sums {
            ($k:literal) => {{
                const ALL: i32 = $k * 0b01_01_01_01;
                let mut terms = [y[0].0; 4];
                for (r, term) in terms.iter_mut().enumerate() {
                    *term = unsafe {
                        let low = plane.as_ptr().add(first[$k] + r * stride);
                        let high = plane.as_ptr().add(first[$k + 4] + r * stride);
                        let row = _mm256_set_m128(_mm_loadu_ps(high), _mm_loadu_ps(low));
                        _mm256_mul_ps(_mm256_permute_ps::<ALL>(y[r].0), row)
                    };
                }
                let [a, b, c, d] = terms;
                unsafe { _mm256_add_ps(_mm256_add_ps(_mm256_add_ps(a, b), c), d) }
            }};
        }
        let (a, b, c, d) = (column_sums!(0), column_sums!(1), column_sums!(2), column_sums!(3));
        // Transposes the registers, so that each holds one column of all neighbourhoods, in order.
        unsafe {
            let (ab_low, ab_high) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
            let (cd_low, cd_high) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
            let first = _mm256_shuffle_ps::<0b01_00_01_00>(ab_low, cd_low);
            let second = _mm256_shuffle_ps::<0b11_10_11_10>(ab_low, cd_low);
            let third = _mm256_shuffle_ps::<0b01_00_01_00>(ab_high, cd_high);
            let fourth = _mm256_shuffle_ps::<0b11_10_11_10>(ab_high, cd_high);
            Self(_mm256_add_ps(
                _mm256_add_ps(_mm256_mul_ps(first, x[0].0), _mm256_mul_ps(second, x[1].0)),
                _mm256_add_ps(_mm256_mul_ps(third, x[2].0), _mm256_mul_ps(fourth, x[3].0)),
            ))
        }
    }
}
