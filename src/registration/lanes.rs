//! Eight samples at a time: the tracker's arithmetic, for plain arrays and for registers (AVX2 and
//! FMA). Both do the same operations in the same order; only the rounding between a product and
//! its sum differs: the sums agree to 1e-5, as tests assert.

/// Rows of a window are padded to a multiple of this many samples without weight, which add
/// nothing to the sums.
pub const LANES: usize = 8;

pub type Lanes = [f32; LANES];

/// Eight numbers. The kernels are written once, over this; they use it outside of closures, which
/// are not compiled for the caller's instructions.
pub trait Vector: Copy {
    fn splat(value: f32) -> Self;
    fn from_lanes(lanes: &Lanes) -> Self;
    fn to_lanes(self) -> Lanes;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    /// `self·factor + term`.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// Absolute values.
    fn abs(self) -> Self;
    /// Whole numbers, rounded down, and what is left, in 0..1. For |v| below 2²³.
    fn split(self) -> ([i32; LANES], Self);
    /// As [`Self::load`], unchecked.
    ///
    /// # Safety
    /// `row` has eight values from `at` on.
    unsafe fn load_unchecked(row: &[f32], at: usize) -> Self;
    /// `Σ_r Σ_c y[r]·x[c]·plane[first + r·stride + c]`, lane by lane, r and c from 0 to 3.
    fn gather_4x4(
        plane: &[f32],
        first: &[usize; LANES],
        stride: usize,
        x: [Self; 4],
        y: [Self; 4],
    ) -> Self;

    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    #[inline(always)]
    fn load(row: &[f32], at: usize) -> Self {
        Self::from_lanes(row[at..].first_chunk().expect("rows are padded to whole lanes"))
    }

    #[inline(always)]
    fn store(self, row: &mut [f32], at: usize) {
        row[at..at + LANES].copy_from_slice(&self.to_lanes());
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.to_lanes();
        f64::from(((a + e) + (c + g)) + ((b + f) + (d + h)))
    }

    /// [`Self::splat`] of each.
    #[inline(always)]
    fn splats<const N: usize>(values: [f32; N]) -> [Self; N] {
        let mut all = [Self::zero(); N];
        for (vector, value) in all.iter_mut().zip(values) {
            *vector = Self::splat(value);
        }
        all
    }

    /// [`Self::sum`] of each.
    #[inline(always)]
    fn sums<const N: usize>(vectors: &[Self; N]) -> [f64; N] {
        let mut all = [0.0; N];
        for (sum, vector) in all.iter_mut().zip(vectors) {
            *sum = vector.sum();
        }
        all
    }
}

/// Catmull and Rom's weights of the four samples around a fraction in 0..1.
#[inline(always)]
pub fn catmull_rom<V: Vector>(f: V) -> [V; 4] {
    let c = V::splat;
    let half = c(0.5);
    let squared = f.mul(f);
    [
        f.mul(f.mul(c(1.0).sub(half.mul(f))).sub(half)),
        c(1.0).add(squared.mul(c(1.5).mul(f).sub(c(2.5)))),
        f.mul(half.add(f.mul(c(2.0).sub(c(1.5).mul(f))))),
        half.mul(squared.mul(f.sub(c(1.0)))),
    ]
}

/// What every processor has.
#[derive(Clone, Copy)]
pub struct Plain(Lanes);

impl Plain {
    #[inline(always)]
    fn with(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|l| f(self.0[l], other.0[l])))
    }
}

impl Vector for Plain {
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn from_lanes(lanes: &Lanes) -> Self {
        Self(*lanes)
    }

    #[inline(always)]
    unsafe fn load_unchecked(row: &[f32], at: usize) -> Self {
        // SAFETY: the caller's.
        Self(unsafe { *row.as_ptr().add(at).cast::<Lanes>() })
    }

    #[inline(always)]
    fn to_lanes(self) -> Lanes {
        self.0
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(other, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(other, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(other, |a, b| a * b)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self.mul(factor).add(term)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }

    #[inline(always)]
    fn split(self) -> ([i32; LANES], Self) {
        let whole = self.0.map(|v| {
            let cut = v as i32;
            cut - i32::from(cut as f32 > v)
        });
        (whole, Self(std::array::from_fn(|l| self.0[l] - whole[l] as f32)))
    }

    #[inline(always)]
    fn gather_4x4(
        plane: &[f32],
        first: &[usize; LANES],
        stride: usize,
        x: [Self; 4],
        y: [Self; 4],
    ) -> Self {
        let mut out = [0.0; LANES];
        for (l, out) in out.iter_mut().enumerate() {
            let row = |r: usize| four(plane, first[l] + r * stride).map(|v| y[r].0[l] * v);
            let [a, b, c, d] = [row(0), row(1), row(2), row(3)];
            let column = |k: usize| ((a[k] + b[k]) + c[k]) + d[k];
            *out = (column(0) * x[0].0[l] + column(1) * x[1].0[l])
                + (column(2) * x[2].0[l] + column(3) * x[3].0[l]);
        }
        Self(out)
    }
}

#[inline(always)]
fn four(plane: &[f32], at: usize) -> &[f32; 4] {
    plane[at..].first_chunk().expect("the border is wide enough")
}

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{LANES, Lanes, Vector};
    use std::arch::x86_64::*;

    /// A register. To be used only where the processor is known to have AVX2 and FMA: every method
    /// here rests on that, and is inlined into a caller that is compiled for it.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    // SAFETY of all blocks below: the processor has both, as the type demands; loads and stores
    // are of arrays that have the values.
    impl Vector for Avx2 {
        #[inline(always)]
        fn splat(value: f32) -> Self {
            unsafe { Self(_mm256_set1_ps(value)) }
        }

        #[inline(always)]
        fn from_lanes(lanes: &Lanes) -> Self {
            unsafe { Self(_mm256_loadu_ps(lanes.as_ptr())) }
        }

        #[inline(always)]
        unsafe fn load_unchecked(row: &[f32], at: usize) -> Self {
            debug_assert!(at + LANES <= row.len());
            unsafe { Self(_mm256_loadu_ps(row.as_ptr().add(at))) }
        }

        #[inline(always)]
        fn to_lanes(self) -> Lanes {
            let mut lanes = [0.0; LANES];
            unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), self.0) };
            lanes
        }

        #[inline(always)]
        fn add(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            unsafe { Self(_mm256_sub_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, other.0)) }
        }

        #[inline(always)]
        fn mul_add(self, factor: Self, term: Self) -> Self {
            unsafe { Self(_mm256_fmadd_ps(self.0, factor.0, term.0)) }
        }

        #[inline(always)]
        fn sum(self) -> f64 {
            unsafe {
                let fours =
                    _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let twos = _mm_add_ps(fours, _mm_movehl_ps(fours, fours));
                let one = _mm_add_ss(twos, _mm_shuffle_ps::<1>(twos, twos));
                f64::from(_mm_cvtss_f32(one))
            }
        }

        #[inline(always)]
        fn abs(self) -> Self {
            unsafe { Self(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)) }
        }

        #[inline(always)]
        fn split(self) -> ([i32; LANES], Self) {
            let mut whole = [0; LANES];
            unsafe {
                let floor = _mm256_floor_ps(self.0);
                _mm256_storeu_si256(whole.as_mut_ptr().cast(), _mm256_cvttps_epi32(floor));
                (whole, Self(_mm256_sub_ps(self.0, floor)))
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
            // One check for all loads below: of the last row of each lane.
            let mut farthest = 0;
            for &first in first {
                farthest = farthest.max(first);
            }
            assert!(farthest + 3 * stride + 4 <= plane.len(), "the border is wide enough");
            // Lanes k and k + 4 share a register: a row of four samples each.
            macro_rules! summed {
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
            let (a, b, c, d) = (summed!(0), summed!(1), summed!(2), summed!(3));
            // Transposed: one register a column, lanes in order.
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
}

#[cfg(test)]
mod tests {
    use super::super::window::{Window, scharr};
    use super::*;

    #[test]
    fn the_weights_are_catmull_and_roms() {
        let fractions: Lanes = std::array::from_fn(|l| l as f32 / 8.0);
        let found = catmull_rom(Plain(fractions));
        for (l, &f) in fractions.iter().enumerate() {
            for (found, expected) in found.iter().zip(crate::raster::catmull_rom(f)) {
                assert!((found.0[l] - expected).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn splits_are_floors() {
        let v = Plain([-1.5, -1.0, -0.25, 0.0, 0.25, 1.0, 2.75, 100.0]);
        let (whole, rest) = v.split();
        assert_eq!(whole, [-2, -1, -1, 0, 0, 1, 2, 100]);
        assert_eq!(rest.0, [0.5, 0.0, 0.75, 0.0, 0.25, 0.0, 0.75, 0.0]);
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn registers_give_what_arrays_do() {
        if !super::super::klt::has_registers() {
            return;
        }
        let plane: Vec<f32> = (0..400).map(|k| (k as f32 * 0.77).sin()).collect();
        let values: Lanes = std::array::from_fn(|l| (l as f32 * 1.7).cos() * 3.0);
        let first: [usize; LANES] = std::array::from_fn(|l| 17 * l + l * l);
        fn all<V: Vector>(plane: &[f32], values: &Lanes, first: &[usize; LANES]) -> Vec<Lanes> {
            let v = V::from_lanes(values);
            let (whole, rest) = v.split();
            let weights = catmull_rom(rest);
            let window = Window::new(plane, 5, 30, [2 * LANES, 3], [0.3, 0.8]);
            let mut columns = window.columns::<V, 2>(0);
            let [first_row, _] = columns.row();
            let [_, second_row] = columns.row();
            let cubic = V::gather_4x4(plane, first, 20, weights, catmull_rom(rest.mul(rest)));
            let mut out = vec![rest.to_lanes(), whole.map(|w| w as f32), v.abs().to_lanes()];
            out.extend([first_row, second_row, cubic, v.sub(rest)].map(V::to_lanes));
            out.extend(scharr::<V>(plane, 40, 20).map(V::to_lanes));
            out.push([v.sum() as f32; LANES]);
            out
        }
        let (plain, registers) =
            (all::<Plain>(&plane, &values, &first), all::<Avx2>(&plane, &values, &first));
        for (a, b) in plain.iter().flatten().zip(registers.iter().flatten()) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }
}
