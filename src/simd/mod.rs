//! Function multiversioning. A kernel, which is a function with a heavy inner loop, has one source and is compiled
//! twice: for processors with AVX2 and FMA, and for any processor.
//!
//! A kernel is an `#[inline(always)]` function. [`multiversion!`] defines the function that calls the kernel.
//! Kernels of plain loops are vectorized by the compiler and give bit-identical results in both versions. Kernels
//! that the compiler doesn't vectorize well are written with vectors of a generic type `V:` [`F32x8`]. Their
//! multiply–adds are fused with AVX2, so that the two versions agree to 1e-5 for values of order 1. Vectors of integers
//! ([`I16x16`]) give bit-identical results.

mod integers;

pub use integers::{I16x16, PIXELS, Pixel, ScalarIntegers};
use std::ops::{Add, Div, Mul, Sub};

/// Defines a function that calls the version of a kernel for the current processor.
///
/// `fn f(a: A) -> R = kernel` calls a kernel of plain loops. `fn f(a: A) -> R = kernel::<V>` calls a kernel that is
/// generic over `V:` [`F32x8`]. Further generic parameters are written in brackets: `fn f[const C: usize](…)`.
macro_rules! multiversion {
    (
        $(#[$meta:meta])*
        $visibility:vis fn $name:ident $([$($generics:tt)*])? ($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)?
            = $kernel:ident $(::<$vector:ident>)?
    ) => {
        $(#[$meta])*
        #[inline]
        $visibility fn $name $(<$($generics)*>)? ($($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,popcnt")]
            #[inline]
            fn by_avx2 $(<$($generics)*>)? ($($argument: $type),*) $(-> $result)? {
                $kernel $(::<$crate::simd::multiversion!(@avx2 $vector)>)? ($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            if $crate::simd::has_avx2_and_fma() {
                // SAFETY: the processor has these instructions.
                return unsafe { by_avx2($($argument),*) };
            }
            $kernel $(::<$crate::simd::multiversion!(@scalar $vector)>)? ($($argument),*)
        }
    };
    (@avx2 $vector:ident) => { $crate::simd::Avx2 };
    (@scalar $vector:ident) => { $crate::simd::Scalar };
}

pub(crate) use multiversion;

/// Returns whether the processor has AVX2 and FMA. All processors with AVX2 also have POPCNT.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(crate) fn has_avx2_and_fma() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// Number of values in a SIMD vector.
pub const LANES: usize = 8;

/// A SIMD vector of eight `f32` values. Operators work element by element. [`Scalar`] uses the default methods.
/// [`Avx2`] overrides the methods that the compiler doesn't vectorize, and the methods that round differently.
///
/// Closures must not use this trait: a closure is not compiled for the instruction set of the function that
/// contains it.
pub trait F32x8:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// The vector of integers for the same processors.
    type Integers: I16x16<Floats = Self>;

    /// Creates a vector from its eight values, in order.
    fn from_array(lanes: &[f32; LANES]) -> Self;

    /// Returns the eight values, in order.
    fn to_array(self) -> [f32; LANES];

    /// Creates a vector whose eight values are all `value`.
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self::from_array(&[value; LANES])
    }

    /// Creates a vector of eight zeros.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    /// Returns `self·factor + term`, element by element. [`Scalar`] rounds the product and then the sum. AVX2
    /// rounds only the sum.
    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        self * factor + term
    }

    /// Returns the square root of each element.
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::from_array(&self.to_array().map(f32::sqrt))
    }

    /// Returns the absolute value of each element.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::from_array(&self.to_array().map(f32::abs))
    }

    /// Selects element by element: `then` where `self` is below `other`, and `otherwise` elsewhere.
    #[inline(always)]
    fn if_below(self, other: Self, then: Self, otherwise: Self) -> Self {
        let [a, b, then, otherwise] = [self, other, then, otherwise].map(Self::to_array);
        let choice = |l: usize| if a[l] < b[l] { then[l] } else { otherwise[l] };
        Self::from_array(&std::array::from_fn(choice))
    }

    /// Returns the element-wise minimum. Where `self` is NaN, the result is `other`. Where `other` is NaN, the
    /// result is `self` with [`Scalar`], and NaN with AVX2.
    #[inline(always)]
    fn simd_min(self, other: Self) -> Self {
        let [a, b] = [self, other].map(Self::to_array);
        Self::from_array(&std::array::from_fn(|l| a[l].min(b[l])))
    }

    /// Returns the element-wise maximum. Where `self` is NaN, the result is `other`. Where `other` is NaN, the
    /// result is `self` with [`Scalar`], and NaN with AVX2.
    #[inline(always)]
    fn simd_max(self, other: Self) -> Self {
        let [a, b] = [self, other].map(Self::to_array);
        Self::from_array(&std::array::from_fn(|l| a[l].max(b[l])))
    }

    /// Returns the floor and the fractional part (in 0..1) of each element. Elements must be below 2²³ in
    /// magnitude. The floor of NaN is 0 with [`Scalar`], and `i32::MIN` with AVX2.
    #[inline(always)]
    fn floor_and_fraction(self) -> ([i32; LANES], Self) {
        let whole = self.to_array().map(|v| {
            let truncated = v as i32;
            truncated - i32::from(truncated as f32 > v)
        });
        (whole, self - Self::from_array(&whole.map(|v| v as f32)))
    }

    /// Returns the sum of the eight values. Values are added pairwise in `f32`.
    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.to_array();
        f64::from(((a + e) + (c + g)) + ((b + f) + (d + h)))
    }

    /// Filters eight 4×4 neighbourhoods of `plane` by separable weights. Element l of the result is
    /// `Σ_r Σ_c y[r]·x[c]·plane[first[l] + r·stride + c]`, with r and c from 0 to 3 and element l of the weights `x`
    /// and `y`.
    ///
    /// # Panics
    /// If a neighbourhood is not inside the plane.
    #[inline(always)]
    fn gather_4x4(
        plane: &[f32],
        first: &[usize; LANES],
        stride: usize,
        x: [Self; 4],
        y: [Self; 4],
    ) -> Self {
        let [x, y] = [x, y].map(|weights| weights.map(Self::to_array));
        let four = |at: usize| -> &[f32; 4] {
            plane[at..].first_chunk().expect("the border is wide enough")
        };
        Self::from_array(&std::array::from_fn(|l| {
            let row = |r: usize| four(first[l] + r * stride).map(|v| y[r][l] * v);
            let [a, b, c, d] = [row(0), row(1), row(2), row(3)];
            let column = |k: usize| ((a[k] + b[k]) + c[k]) + d[k];
            (column(0) * x[0][l] + column(1) * x[1][l])
                + (column(2) * x[2][l] + column(3) * x[3][l])
        }))
    }

    /// Transposes eight records of eight values. Element l of vector k of the result is value k of record l.
    #[inline(always)]
    fn transposed(records: &[[i16; 8]; LANES]) -> [Self; 8] {
        let mut all = [Self::zero(); 8];
        for (k, vector) in all.iter_mut().enumerate() {
            let mut lanes = [0.0; LANES];
            for (lane, record) in lanes.iter_mut().zip(records) {
                *lane = f32::from(record[k]);
            }
            *vector = Self::from_array(&lanes);
        }
        all
    }

    /// Loads the eight values of `row` that start at index `at`.
    ///
    /// # Panics
    /// If `row` has fewer than eight values from index `at` on.
    #[inline(always)]
    fn load(row: &[f32], at: usize) -> Self {
        Self::from_array(row[at..].first_chunk().expect("rows are padded to whole vectors"))
    }

    /// Loads eight values like [`Self::load`], without a bounds check.
    ///
    /// # Safety
    /// `row` has at least eight values from index `at` on.
    #[inline(always)]
    unsafe fn load_unchecked(row: &[f32], at: usize) -> Self {
        debug_assert!(at + LANES <= row.len());
        // SAFETY: the caller ensures the length.
        Self::from_array(unsafe { &*row.as_ptr().add(at).cast() })
    }

    /// Writes the eight values to `row`, starting at index `at`.
    ///
    /// # Panics
    /// If `row` has fewer than eight values from index `at` on.
    #[inline(always)]
    fn store(self, row: &mut [f32], at: usize) {
        row[at..at + LANES].copy_from_slice(&self.to_array());
    }

    /// Applies [`Self::splat`] to each value.
    #[inline(always)]
    fn splats<const N: usize>(values: [f32; N]) -> [Self; N] {
        let mut all = [Self::zero(); N];
        for (vector, value) in all.iter_mut().zip(values) {
            *vector = Self::splat(value);
        }
        all
    }

    /// Applies [`Self::sum`] to each vector.
    #[inline(always)]
    fn sums<const N: usize>(vectors: &[Self; N]) -> [f64; N] {
        let mut all = [0.0; N];
        for (sum, vector) in all.iter_mut().zip(vectors) {
            *sum = vector.sum();
        }
        all
    }
}

/// Implements an arithmetic operator of a vector type.
macro_rules! operator {
    ($vector:ident, $operator:ident $method:ident, |$a:ident, $b:ident| $value:expr) => {
        impl std::ops::$operator for $vector {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                let ($a, $b) = (self, other);
                $value
            }
        }
    };
}

/// Implementation of [`F32x8`] as an array, for any processor.
#[derive(Clone, Copy)]
pub struct Scalar([f32; LANES]);

impl Scalar {
    #[inline(always)]
    fn zip_map(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|l| f(self.0[l], other.0[l])))
    }
}

operator!(Scalar, Add add, |a, b| a.zip_map(b, |a, b| a + b));
operator!(Scalar, Sub sub, |a, b| a.zip_map(b, |a, b| a - b));
operator!(Scalar, Mul mul, |a, b| a.zip_map(b, |a, b| a * b));
operator!(Scalar, Div div, |a, b| a.zip_map(b, |a, b| a / b));

impl F32x8 for Scalar {
    type Integers = ScalarIntegers;

    #[inline(always)]
    fn from_array(lanes: &[f32; LANES]) -> Self {
        Self(*lanes)
    }

    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        self.0
    }
}

// After `operator!`, which it uses.
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floors_and_fractions_of_negative_and_whole_values() {
        let v = Scalar([-1.5, -1.0, -0.25, 0.0, 0.25, 1.0, 2.75, 100.0]);
        let (floor, fraction) = v.floor_and_fraction();
        assert_eq!(floor, [-2, -1, -1, 0, 0, 1, 2, 100]);
        assert_eq!(fraction.0, [0.5, 0.0, 0.75, 0.0, 0.25, 0.0, 0.75, 0.0]);
    }

    /// Applies operations whose results are bit-identical in both implementations.
    #[inline(always)]
    fn exact_by<V: F32x8>(a: &[f32; LANES], b: &[f32; LANES]) -> [[f32; LANES]; 5] {
        let (a, b) = (V::from_array(a), V::from_array(b));
        let choice = a.if_below(b, V::splat(1.0), V::splat(2.0));
        [a / b, a.abs().sqrt(), choice, a.simd_min(b), a.simd_max(b)].map(V::to_array)
    }

    multiversion! {
        fn exact(a: &[f32; LANES], b: &[f32; LANES]) -> [[f32; LANES]; 5] = exact_by::<V>
    }

    #[inline(always)]
    fn transposed_by<V: F32x8>(records: &[[i16; 8]; LANES]) -> [[f32; LANES]; 8] {
        V::transposed(records).map(V::to_array)
    }

    multiversion! {
        fn transposed(records: &[[i16; 8]; LANES]) -> [[f32; LANES]; 8] = transposed_by::<V>
    }

    #[test]
    fn records_are_transposed() {
        let records: [[i16; 8]; LANES] =
            std::array::from_fn(|l| std::array::from_fn(|k| (4000 * l + k) as i16 - 16000));
        for all in [transposed_by::<Scalar>(&records), transposed(&records)] {
            for (k, lanes) in all.iter().enumerate() {
                assert_eq!(*lanes, std::array::from_fn(|l| f32::from(records[l][k])));
            }
        }
    }

    #[test]
    fn min_and_max_of_nan_are_the_other() {
        let (nan, b) = ([f32::NAN; LANES], [3.0; LANES]);
        for [_, _, choice, min, max] in [exact_by::<Scalar>(&nan, &b), exact(&nan, &b)] {
            assert_eq!([choice, min, max], [[2.0; LANES], b, b]);
        }
    }

    #[test]
    fn avx2_gives_what_scalar_gives() {
        let mut random = crate::random::Random::new(8);
        for _ in 0..100 {
            let mut word = || std::array::from_fn(|_| (8.0 * random.unit() - 4.0) as f32);
            let (a, mut b): ([f32; LANES], [f32; LANES]) = (word(), word());
            b[2] = a[2];
            assert_eq!(exact(&a, &b), exact_by::<Scalar>(&a, &b));
        }
    }
}
