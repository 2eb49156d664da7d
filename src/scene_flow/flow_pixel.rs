//! Quantized surface element of one pixel, as scene flow maps hold it.

use super::element::{Element, ElementErrors};

/// Quantization steps per pixel of a velocity, of an acceleration, and of a disparity's rate of change.
const STEPS: f32 = 64.0;
/// Maximum of what counts as slow, quantization steps: half a pixel. Two slow elements have about the same motion in frames
/// of similar focal lengths.
const SLOW_STEPS: u16 = 32;
/// Number of quantization steps from the minimum to the maximum of the search range of inverse depths.
const DEPTH_STEPS: f32 = u16::MAX as f32;
/// Number that is subtracted from an inverse depth in quantization steps, so that it fits in 16 bits with a sign.
const DEPTH_BIAS: i32 = 1 << 15;

/// Number of quantization steps per doubling of a standard error.
const STEPS_PER_OCTAVE: f32 = 2.0;
/// Code of the standard errors of a surface element that isn't known. It is larger than that of any error.
const UNKNOWN: u8 = u8::MAX;
/// Smallest standard error that can be stored, pixels.
const MIN_ERROR_PX: f32 = 1.0 / 256.0;

/// Quantized surface element of one pixel.
///
/// The values are, in this order: the inverse depth, two components each of velocity and acceleration, the rate of the
/// disparity, a bit mask of edges beside the code of the disparity's standard error, and the code of the velocity's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlowPixel(pub(super) [i16; 8]);

/// Factors and terms by which the values of a [`FlowPixel`] become those of a surface element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Minimum of the search range of inverse depths, 1/m, and a quantization step.
    pub inverse_depth: [f32; 2],
    /// Disparity of a point at a depth of 1 m, pixels.
    pub disparity_px: f32,
}

impl Scales {
    /// `range` is the search range of inverse depths: minimum and maximum, 1/m.
    pub fn new([min, max]: [f32; 2], disparity_px: f32) -> Self {
        Self { inverse_depth: [min, (max - min) / DEPTH_STEPS], disparity_px }
    }
}

impl FlowPixel {
    /// Number of 16-bit channels of a pixel.
    pub(super) const CHANNELS: usize = 6;
    /// Number of 8-bit channels of a pixel.
    pub(super) const BYTE_CHANNELS: usize = 3;
    /// Size of a pixel on disk before compression, bytes.
    pub(super) const BYTES: usize = 2 * Self::CHANNELS + Self::BYTE_CHANNELS;
    /// Added to the first value, this is the inverse depth in quantization steps.
    pub(super) const DEPTH_BIAS: f32 = DEPTH_BIAS as f32;
    /// Length of a quantization step of motion, pixels; a power of two.
    pub(super) const STEP_PX: f32 = 1.0 / STEPS;
    /// Maximum of each component of motion of a slow element, pixels.
    pub(super) const SLOW_PX: f32 = SLOW_STEPS as f32 / STEPS;

    /// Quantizes a surface element, all of whose standard errors are set to the smallest one. `edges` is the bit mask that
    /// [`Self::edges`] returns.
    pub fn quantized(e: &Element, edges: u8, scales: &Scales) -> Self {
        let rounded = |v: f32| (v * STEPS).round() as i16; // saturates
        let [min, step] = scales.inverse_depth;
        // If minimum and maximum are equal, all inverse depths equal the minimum.
        let depth = ((e.inverse_depth - min) / step.max(f32::MIN_POSITIVE)).round() as u16; // saturates
        let [[u, v], [a, b]] = [e.velocity, e.acceleration].map(|pair| pair.map(rounded));
        let rate = rounded(e.inverse_depth_rate * scales.disparity_px);
        Self::new([(i32::from(depth) - DEPTH_BIAS) as i16, u, v, a, b, rate], [edges, 0, 0])
    }

    pub(super) fn new(
        [depth, u, v, a, b, rate]: [i16; Self::CHANNELS],
        [edges, disparity, velocity]: [u8; Self::BYTE_CHANNELS],
    ) -> Self {
        let codes = i16::from_le_bytes([edges, disparity]);
        Self([depth, u, v, a, b, rate, codes, i16::from(velocity)])
    }

    pub(super) fn channels(&self) -> [i16; Self::CHANNELS] {
        let [depth, u, v, a, b, rate, ..] = self.0;
        [depth, u, v, a, b, rate]
    }

    pub(super) fn byte_channels(&self) -> [u8; Self::BYTE_CHANNELS] {
        let [edges, disparity] = self.0[6].to_le_bytes();
        [edges, disparity, self.0[7].to_le_bytes()[0]]
    }

    #[inline(always)]
    pub fn element(&self, scales: &Scales) -> Element {
        let [depth, u, v, a, b, rate, ..] = self.0.map(f32::from);
        let [min, step] = scales.inverse_depth;
        Element {
            inverse_depth: min + (depth + Self::DEPTH_BIAS) * step,
            velocity: [u * Self::STEP_PX, v * Self::STEP_PX],
            acceleration: [a * Self::STEP_PX, b * Self::STEP_PX],
            inverse_depth_rate: rate * Self::STEP_PX / scales.disparity_px,
            ..Element::default()
        }
    }

    /// Returns whether velocity, acceleration and the disparity's rate are each at most half a pixel.
    pub(super) fn is_slow(&self) -> bool {
        self.0[1..Self::CHANNELS].iter().all(|value| value.unsigned_abs() <= SLOW_STEPS)
    }

    /// Returns two pixels between which the depths and motions of some pixels lie, value by value: one has the smallest
    /// values, the other the largest. `None` if there are no pixels.
    pub(super) fn range<'a>(pixels: impl Iterator<Item = &'a Self>) -> Option<[Self; 2]> {
        let mut range: Option<[[i16; 8]; 2]> = None;
        for Self(values) in pixels {
            let [min, max] = range.get_or_insert([*values; 2]);
            for ((min, max), value) in min.iter_mut().zip(max).zip(values) {
                (*min, *max) = ((*min).min(*value), (*max).max(*value));
            }
        }
        range.map(|both| {
            both.map(|[depth, u, v, a, b, rate, ..]| Self([depth, u, v, a, b, rate, 0, 0]))
        })
    }

    pub(super) fn with_errors(self, errors: &ElementErrors) -> Self {
        let codes = [errors.disparity_px, errors.velocity_px].map(code_from_error);
        self.with_codes(codes)
    }

    /// Returns the pixel marked as one whose surface element is unknown.
    pub(super) fn unknown(self) -> Self {
        self.with_codes([UNKNOWN; 2])
    }

    fn with_codes(self, [disparity, velocity]: [u8; 2]) -> Self {
        Self::new(self.channels(), [self.edges(), disparity, velocity])
    }

    /// Returns the standard errors of the pixel's surface element at the time of the map's frame.
    #[inline(always)]
    pub fn errors(&self) -> ElementErrors {
        let [_, disparity, velocity] = self.byte_channels();
        let [disparity_px, velocity_px] = [disparity, velocity].map(error_from_code);
        ElementErrors { disparity_px, velocity_px }
    }

    /// Returns whether the pixel's surface element is known.
    pub fn is_known(&self) -> bool {
        let [_, disparity, velocity] = self.byte_channels();
        [disparity, velocity] != [UNKNOWN; 2]
    }

    /// Returns a bit mask of the sides on which the neighbouring pixel belongs to another surface: bit 0 for left, 1 for
    /// right, 2 for above, 3 for below.
    #[inline(always)]
    pub fn edges(&self) -> u8 {
        self.0[6].to_le_bytes()[0]
    }
}

fn code_from_error(error_px: f32) -> u8 {
    // Casts saturate, and turn NaN into 0. The lower bound of 1 keeps the logarithm finite.
    (STEPS_PER_OCTAVE * (error_px / MIN_ERROR_PX).max(1.0).log2()).round() as u8
}

#[inline(always)]
fn error_from_code(code: u8) -> f32 {
    MIN_ERROR_PX * (f32::from(code) / STEPS_PER_OCTAVE).exp2()
}
