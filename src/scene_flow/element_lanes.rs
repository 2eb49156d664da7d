//! Eight surface elements side by side, for SIMD. Results are bit-identical to those of single elements.

use super::flow_pixel::{FlowPixel, Scales};
use super::geometry::{BEHIND_PX, MIN_RATIO, Projection};
use crate::simd::{F32x8, LANES};

/// Positions of the centres of eight successive pixels of a row, from its first on, pixels.
pub const COLUMNS: [f32; LANES] = [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5];

/// Returns the eight values from index `first` on. Those after the last value equal it.
///
/// # Panics
/// If there are no values.
#[inline(always)]
pub fn eight<T: Copy>(values: &[T], first: usize) -> [T; LANES] {
    if let Some(all) = values.get(first..first + LANES).and_then(<[T]>::first_chunk) {
        return *all;
    }
    let mut all = [values[values.len() - 1]; LANES];
    let last = values.get(first..).unwrap_or_default();
    for (value, last) in all.iter_mut().zip(last) {
        *value = *last;
    }
    all
}

/// Eight surface elements without their gradients; see [`Element`](super::Element).
pub struct ElementLanes<V: F32x8> {
    pub inverse_depth: V,
    pub velocity: [V; 2],
    pub acceleration: [V; 2],
    pub inverse_depth_rate: V,
    /// Largest component of velocity, acceleration and the disparity's rate, pixels.
    pub fastest_px: V,
}

impl<V: F32x8> ElementLanes<V> {
    #[inline(always)]
    pub fn new(pixels: &[FlowPixel; LANES], scales: &Scales) -> Self {
        let mut values = [[0; 8]; LANES];
        for (values, pixel) in values.iter_mut().zip(pixels) {
            *values = pixel.0;
        }
        let [depth, u, v, a, b, rate, ..] = V::transposed(&values);
        let [min, step] = V::splats(scales.inverse_depth);
        let pixel = V::splat(FlowPixel::STEP_PX);
        let (velocity, acceleration) = ([u * pixel, v * pixel], [a * pixel, b * pixel]);
        let rate_px = rate * pixel;
        let mut fastest_px = rate_px.abs();
        for component in [velocity[0], velocity[1], acceleration[0], acceleration[1]] {
            fastest_px = fastest_px.simd_max(component.abs());
        }
        Self {
            inverse_depth: min + (depth + V::splat(FlowPixel::DEPTH_BIAS)) * step,
            velocity,
            acceleration,
            inverse_depth_rate: rate_px / V::splat(scales.disparity_px),
            fastest_px,
        }
    }

    /// Like [`Element::moved`](super::Element::moved).
    #[inline(always)]
    pub fn moved(&self, [x, y]: [V; 2], dt: V) -> [V; 3] {
        let half = V::splat(0.5) * dt * dt;
        [
            x + self.velocity[0] * dt + self.acceleration[0] * half,
            y + self.velocity[1] * dt + self.acceleration[1] * half,
            self.inverse_depth + self.inverse_depth_rate * dt,
        ]
    }

    /// Like [`Element::speed`](super::Element::speed).
    #[inline(always)]
    pub fn speed(&self) -> V {
        length(self.velocity)
    }
}

/// Returns the lengths of eight vectors.
#[inline(always)]
pub fn length<V: F32x8>([x, y]: [V; 2]) -> V {
    (x * x + y * y).sqrt()
}

impl Projection {
    /// Like [`Self::project_and_near`].
    #[inline(always)]
    pub fn project_lanes<V: F32x8>(&self, [x, y, q]: [V; 3]) -> [V; 4] {
        let [u, v, w] = self.homogeneous_lanes([x, y, q]);
        // Where the ratio is too small for a division, the quotients aren't used.
        let inverse = V::splat(1.0) / w;
        let (min, behind, zero) = (V::splat(MIN_RATIO), V::splat(BEHIND_PX), V::zero());
        [
            w.if_below(min, behind, u * inverse),
            w.if_below(min, behind, v * inverse),
            w.if_below(min, zero, q * inverse),
            w.if_below(min, zero, inverse),
        ]
    }

    /// Like [`Self::homogeneous`].
    #[inline(always)]
    pub fn homogeneous_lanes<V: F32x8>(&self, [x, y, q]: [V; 3]) -> [V; 3] {
        let mut rows = [V::zero(); 3];
        for (row, (a, b)) in rows.iter_mut().zip(self.a.iter().zip(self.b)) {
            let [a, b, c, d] = V::splats([a[0], a[1], a[2], b]);
            *row = a * x + b * y + c + q * d;
        }
        rows
    }
}
