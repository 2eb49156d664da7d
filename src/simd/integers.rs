//! SIMD vectors of sixteen 16-bit integers: four pixels of four channels each. All results are bit-identical on all
//! processors.

use super::{F32x8, LANES, Scalar};

/// Number of pixels in a vector.
pub const PIXELS: usize = LANES / 2;

/// A pixel of four channels. Values of images are at most 16,383 in magnitude, so that differences don't overflow.
pub type Pixel = [i16; 4];

/// A SIMD vector of four [`Pixel`]s. [`Scalar`] and `Avx2` select its implementation ([`F32x8::Integers`]).
///
/// Closures must not use this trait, as with [`F32x8`].
pub trait I16x16: Copy {
    /// The vector of floats that belongs to the same instruction set.
    type Floats: F32x8;
    /// Eight fractions in 0..1, in units of 2⁻¹⁵.
    type Fractions: Copy;
    /// Partial sums in 32 bits.
    type Sums: Copy;

    /// Creates a vector from the first four of these pixels.
    ///
    /// # Panics
    /// If there are fewer than four.
    fn load(pixels: &[Pixel]) -> Self;

    /// Returns the four pixels, in order.
    fn to_pixels(self) -> [Pixel; PIXELS];

    /// Rounds eight values in 0..1 down to multiples of 2⁻¹⁵.
    fn fractions(values: Self::Floats) -> Self::Fractions;

    /// Interpolates an image bilinearly at four positions. Element `FIRST + k` of `corners` is the index of the top-left
    /// of the 2×2 pixels around position k, and that of `right` and `down` is the position within these pixels. `FIRST`
    /// is 0 or 4, and `width` the width of the image.
    ///
    /// # Safety
    /// `corners + width + 1` are indices of `image`.
    unsafe fn bilinear<const FIRST: usize>(
        image: &[Pixel],
        width: usize,
        corners: &[u32; LANES],
        right: Self::Fractions,
        down: Self::Fractions,
    ) -> Self;

    /// Returns sums of zero.
    fn no_sums() -> Self::Sums;

    /// Adds `min(|self − other|, most)·weights` of all values to the sums. `weights` are not negative.
    fn add_difference(self, other: Self, most: Self, weights: Self, sums: Self::Sums)
    -> Self::Sums;

    /// Returns the sum of all partial sums, which must fit in 32 bits.
    fn total(sums: Self::Sums) -> i32;
}

/// Implementation of [`I16x16`] as an array, for any processor.
#[derive(Clone, Copy)]
pub struct ScalarIntegers([Pixel; PIXELS]);

/// Returns the value at a fraction, in units of 2⁻¹⁵, of the way from one value to another.
#[inline(always)]
fn between(from: i16, to: i16, fraction: i16) -> i16 {
    let change = i32::from(to.saturating_sub(from)) * i32::from(fraction);
    from.wrapping_add(((change + 0x4000) >> 15) as i16)
}

impl I16x16 for ScalarIntegers {
    type Floats = Scalar;
    type Fractions = [i16; LANES];
    type Sums = i32;

    #[inline(always)]
    fn load(pixels: &[Pixel]) -> Self {
        Self(*pixels.first_chunk().expect("patches are padded to whole vectors"))
    }

    #[inline(always)]
    fn to_pixels(self) -> [Pixel; PIXELS] {
        self.0
    }

    #[inline(always)]
    fn fractions(values: Scalar) -> [i16; LANES] {
        values.to_array().map(|v| (v * 32768.0) as i16)
    }

    #[inline(always)]
    unsafe fn bilinear<const FIRST: usize>(
        image: &[Pixel],
        width: usize,
        corners: &[u32; LANES],
        right: [i16; LANES],
        down: [i16; LANES],
    ) -> Self {
        let mut pixels = [[0; 4]; PIXELS];
        for (k, pixel) in pixels.iter_mut().enumerate() {
            let at = corners[FIRST + k] as usize;
            let (upper, lower) = (&image[at..at + 2], &image[at + width..at + width + 2]);
            for (c, value) in pixel.iter_mut().enumerate() {
                let [a, b] = [0, 1].map(|x| between(upper[x][c], lower[x][c], down[FIRST + k]));
                *value = between(a, b, right[FIRST + k]);
            }
        }
        Self(pixels)
    }

    #[inline(always)]
    fn no_sums() -> i32 {
        0
    }

    #[inline(always)]
    fn add_difference(self, other: Self, most: Self, weights: Self, mut sums: i32) -> i32 {
        for k in 0..PIXELS {
            for c in 0..4 {
                let difference = self.0[k][c].saturating_sub(other.0[k][c]).wrapping_abs();
                sums += i32::from(difference.min(most.0[k][c])) * i32::from(weights.0[k][c]);
            }
        }
        sums
    }

    #[inline(always)]
    fn total(sums: i32) -> i32 {
        sums
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2Integers;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::super::{Avx2, LANES};
    use super::{I16x16, PIXELS, Pixel};
    use std::arch::x86_64::*;

    /// Implementation of [`I16x16`] as a 256-bit register, for processors with AVX2 and FMA. Only
    /// [`multiversion!`](crate::simd::multiversion) uses this type.
    #[derive(Clone, Copy)]
    pub struct Avx2Integers(__m256i);

    /// Returns a byte shuffle that repeats the 16-bit value at a byte four times.
    const fn repeated(byte: usize) -> i64 {
        (byte | (byte + 1) << 8) as i64 * 0x0001_0001_0001_0001
    }

    // SAFETY of all blocks below: this type is used only on processors with AVX2 and FMA, and all loads and stores
    // are within their arrays.
    impl I16x16 for Avx2Integers {
        type Floats = Avx2;
        /// A fraction in each 32 bits; the order of elements is 0, 1, 4, 5, 2, 3, 6, 7.
        type Fractions = __m256i;
        type Sums = __m256i;

        #[inline(always)]
        fn load(pixels: &[Pixel]) -> Self {
            let pixels: &[Pixel; PIXELS] =
                pixels.first_chunk().expect("patches are padded to whole vectors");
            unsafe { Self(_mm256_loadu_si256(pixels.as_ptr().cast())) }
        }

        #[inline(always)]
        fn to_pixels(self) -> [Pixel; PIXELS] {
            let mut pixels = [[0; 4]; PIXELS];
            unsafe { _mm256_storeu_si256(pixels.as_mut_ptr().cast(), self.0) };
            pixels
        }

        #[inline(always)]
        fn fractions(values: Avx2) -> __m256i {
            unsafe {
                let scaled = _mm256_mul_ps(values.0, _mm256_set1_ps(32768.0));
                let order = _mm256_setr_epi32(0, 1, 4, 5, 2, 3, 6, 7);
                _mm256_permutevar8x32_epi32(_mm256_cvttps_epi32(scaled), order)
            }
        }

        #[inline(always)]
        unsafe fn bilinear<const FIRST: usize>(
            image: &[Pixel],
            width: usize,
            corners: &[u32; LANES],
            right: __m256i,
            down: __m256i,
        ) -> Self {
            // A register holds two neighbouring pixels of each of the positions k and k + 2.
            macro_rules! row {
                ($k:expr, $offset:expr) => {{
                    let [low, high] = [corners[FIRST + $k], corners[FIRST + $k + 2]];
                    let low = image.as_ptr().add(low as usize + $offset).cast();
                    let high = image.as_ptr().add(high as usize + $offset).cast();
                    _mm256_set_m128i(_mm_loadu_si128(high), _mm_loadu_si128(low))
                }};
            }
            macro_rules! between {
                ($from:expr, $to:expr, $fraction:expr) => {{
                    let (from, to) = ($from, $to);
                    let change = _mm256_mulhrs_epi16(_mm256_subs_epi16(to, from), $fraction);
                    _mm256_add_epi16(from, change)
                }};
            }
            unsafe {
                let [a, b] = const { [repeated(2 * FIRST), repeated(2 * FIRST + 4)] };
                let down_a = _mm256_shuffle_epi8(down, _mm256_set1_epi64x(a));
                let down_b = _mm256_shuffle_epi8(down, _mm256_set1_epi64x(b));
                let right = _mm256_shuffle_epi8(right, _mm256_set_epi64x(b, a, b, a));
                let columns_a = between!(row!(0, 0), row!(0, width), down_a);
                let columns_b = between!(row!(1, 0), row!(1, width), down_b);
                let left_column = _mm256_unpacklo_epi64(columns_a, columns_b);
                let right_column = _mm256_unpackhi_epi64(columns_a, columns_b);
                Self(between!(left_column, right_column, right))
            }
        }

        #[inline(always)]
        fn no_sums() -> __m256i {
            unsafe { _mm256_setzero_si256() }
        }

        #[inline(always)]
        fn add_difference(self, other: Self, most: Self, weights: Self, sums: __m256i) -> __m256i {
            unsafe {
                let difference = _mm256_abs_epi16(_mm256_subs_epi16(self.0, other.0));
                let difference = _mm256_min_epi16(difference, most.0);
                _mm256_add_epi32(sums, _mm256_madd_epi16(difference, weights.0))
            }
        }

        #[inline(always)]
        fn total(sums: __m256i) -> i32 {
            unsafe {
                let four = _mm_add_epi32(
                    _mm256_castsi256_si128(sums),
                    _mm256_extracti128_si256::<1>(sums),
                );
                let two = _mm_add_epi32(four, _mm_unpackhi_epi64(four, four));
                _mm_cvtsi128_si32(_mm_add_epi32(two, _mm_shuffle_epi32::<1>(two)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::multiversion;
    use super::*;
    use crate::random::Random;

    /// Samples of an image at eight positions, and the sum of their weighted differences from `own`.
    #[inline(always)]
    fn sampled_by<V: F32x8>(
        image: &[Pixel],
        corners: &[u32; LANES],
        at: &[[f32; LANES]; 2],
        own: &[[Pixel; PIXELS]; 3],
    ) -> ([[Pixel; PIXELS]; 2], i32) {
        let [right, down] =
            [V::from_array(&at[0]), V::from_array(&at[1])].map(<V::Integers as I16x16>::fractions);
        let width = 5;
        // SAFETY: the corners are at most 13 of 20 pixels.
        let first = unsafe { V::Integers::bilinear::<0>(image, width, corners, right, down) };
        let second = unsafe { V::Integers::bilinear::<4>(image, width, corners, right, down) };
        let (most, weights) = (V::Integers::load(&own[1]), V::Integers::load(&own[2]));
        let own = V::Integers::load(&own[0]);
        let sums = first.add_difference(own, most, weights, V::Integers::no_sums());
        let sums = second.add_difference(own, most, weights, sums);
        ([first.to_pixels(), second.to_pixels()], V::Integers::total(sums))
    }

    multiversion! {
        fn sampled(
            image: &[Pixel], corners: &[u32; LANES], at: &[[f32; LANES]; 2], own: &[[Pixel; PIXELS]; 3],
        ) -> ([[Pixel; PIXELS]; 2], i32) = sampled_by::<V>
    }

    #[test]
    fn samples_and_sums_are_the_same_on_all_processors() {
        let mut random = Random::new(3);
        for _ in 0..200 {
            let mut upto = |n: f64| (n * random.unit()) as i32;
            let image: Vec<Pixel> =
                (0..20).map(|_| std::array::from_fn(|_| (upto(32767.0) - 16383) as i16)).collect();
            let corners = std::array::from_fn(|_| (5 * upto(3.0) + upto(4.0)) as u32);
            let own = [16383.0, 2000.0, 16384.0]
                .map(|n| std::array::from_fn(|_| std::array::from_fn(|_| upto(n) as i16)));
            let at = std::array::from_fn(|_| std::array::from_fn(|_| random.unit() as f32));
            let expected = sampled_by::<Scalar>(&image, &corners, &at, &own);
            assert_eq!(sampled(&image, &corners, &at, &own), expected);
            for (k, (&corner, pixel)) in corners.iter().zip(expected.0.as_flattened()).enumerate() {
                let four = [0, 1, 5, 6].map(|step| f64::from(image[corner as usize + step][k % 4]));
                let [x, y] = [0, 1].map(|axis: usize| f64::from(at[axis][k]));
                let [a, b] = [0, 1].map(|n| four[n] + (four[n + 2] - four[n]) * y);
                let exact = a + (b - a) * x;
                assert!((exact - f64::from(pixel[k % 4])).abs() < 3.1, "{exact} {pixel:?}");
            }
        }
    }
}
