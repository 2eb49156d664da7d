//! Image gradients in polar form (magnitude and direction). The SIFT descriptors are histograms of these gradients.

use super::Pyramid;
use crate::simd::{F32x8, LANES, multiversion};
use std::f32::consts::TAU;

/// Number of direction bins in each cell of a SIFT descriptor.
pub const DIRECTIONS: usize = 8;
/// A full turn (360°) in the unit that gradients and descriptors use for angles. The unit is one direction bin
/// (45°).
pub const TURN: f32 = DIRECTIONS as f32;
/// Index of the pyramid level whose gradients the descriptors use; 0 is the full-sized level. If the pyramid is
/// shorter, its last level is used.
const LEVEL: usize = 1;

/// Gradients of one pyramid level of a frame, by central differences.
#[derive(Debug)]
pub(super) struct PolarGradients {
    pub width: usize,
    pub height: usize,
    /// Ratio of the level's size to the frame's.
    pub scale: f64,
    /// Magnitudes of the gradients, in grey values (0 to 1) per two pixels, row by row. They are followed by
    /// [`LANES`] values of padding.
    pub strength: Vec<f32>,
    /// Directions of the gradients, row by row: angles from the x axis towards the y axis, 0 to [`TURN`]. They are
    /// followed by [`LANES`] values of padding.
    pub direction: Vec<f32>,
}

multiversion! {
    /// Computes the gradients for SIFT descriptors from a frame's pyramid, on level [`LEVEL`].
    pub(super) fn polar_gradients(pyramid: &Pyramid) -> PolarGradients = gradients_by::<V>
}

#[inline(always)]
fn gradients_by<V: F32x8>(pyramid: &Pyramid) -> PolarGradients {
    let levels = &pyramid.levels;
    let n = LEVEL.min(levels.len() - 1);
    let level = &levels[n];
    let size = level.width * level.height;
    let [mut strength, mut direction] = [vec![0.0; size + LANES], vec![0.0; size + LANES]];
    for y in 0..level.height {
        // The last vector of a row extends into the next row, which is written later, or into the final padding.
        for x in (0..level.width).step_by(LANES) {
            let k = level.index(x as isize, y as isize);
            let gx = V::load(&level.value, k + 1) - V::load(&level.value, k - 1);
            let [above, below] = [k - level.stride, k + level.stride];
            let gy = V::load(&level.value, below) - V::load(&level.value, above);
            let at = y * level.width + x;
            gx.mul_add(gx, gy * gy).sqrt().store(&mut strength, at);
            directions(gx, gy).store(&mut direction, at);
        }
    }
    let scale = 1.0 / f64::from(1_u32 << n);
    PolarGradients { width: level.width, height: level.height, scale, strength, direction }
}

impl PolarGradients {
    #[cfg(test)]
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * (self.strength.len() + self.direction.len())
    }

    /// Returns the size of the gradients in memory, in bytes. `sizes` holds the width and height of each level of
    /// the pyramid, full-sized level first.
    pub fn bytes_of(sizes: &[[usize; 2]]) -> usize {
        let [width, height] = sizes[LEVEL.min(sizes.len() - 1)];
        2 * (width * height + LANES) * size_of::<f32>()
    }
}

/// Coefficients of x, x³, x⁵ and so on, of a polynomial. On 0..=1, the polynomial approximates the arctangent of x with
/// an error of at most 2e-8 (Abramowitz and Stegun 4.4.49).
const ARCTANGENT: [f32; 9] = [
    1.0,
    -0.333_331_45,
    0.199_935_5,
    -0.142_089,
    0.106_562_64,
    -0.075_289_64,
    0.042_909_615,
    -0.016_165_737,
    0.002_866_225_7,
];

/// Returns the directions of the vectors (`x`, `y`): angles from the x axis towards the y axis, 0 to [`TURN`]. The
/// direction of the zero vector is 0.
#[inline(always)]
fn directions<V: F32x8>(x: V, y: V) -> V {
    let (along, across) = (x.abs(), y.abs());
    let longer = along.simd_max(across).simd_max(V::splat(f32::MIN_POSITIVE));
    let slope = along.simd_min(across) / longer;
    let squared = slope * slope;
    let mut sum = V::zero();
    for coefficient in ARCTANGENT.into_iter().rev() {
        sum = sum.mul_add(squared, V::splat(coefficient));
    }
    let octant = sum * slope * V::splat(TURN / TAU);
    let quadrant = along.if_below(across, V::splat(0.25 * TURN) - octant, octant);
    let half = x.if_below(V::zero(), V::splat(0.5 * TURN) - quadrant, quadrant);
    y.if_below(V::zero(), V::splat(TURN) - half, half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::raster::Image;
    use crate::simd::Scalar;

    #[test]
    fn gradients_agree_with_a_naive_reference() {
        let mut random = Random::new(6);
        for (w, h) in [(64, 41), (9, 5), (1, 1)] {
            // The grey values have few distinct levels, so that some gradients are 0 and others are along an axis.
            let data = (0..w * h).map(|_| (4.0 * random.unit()).floor() as f32 / 4.0).collect();
            let pyramid = Pyramid::new(&Image::from_data(w, h, 1, data), 1, 16);
            let level = &pyramid.levels[0];
            for gradients in [polar_gradients(&pyramid), gradients_by::<Scalar>(&pyramid)] {
                for k in 0..w * h {
                    let at = |dx: isize, dy: isize| {
                        let at = level.index((k % w) as isize + dx, (k / w) as isize + dy);
                        f64::from(level.value[at])
                    };
                    let (x, y) = (at(1, 0) - at(-1, 0), at(0, 1) - at(0, -1));
                    let turn = f64::from(TURN);
                    let direction = (y.atan2(x) / std::f64::consts::TAU * turn).rem_euclid(turn);
                    assert!((f64::from(gradients.strength[k]) - x.hypot(y)).abs() < 1e-6);
                    assert!((f64::from(gradients.direction[k]) - direction).abs() < 1e-5);
                }
            }
        }
    }
}
