//! Motion of the surfaces that a view shows.

/// Quantization steps per pixel of motion. Larger: bodies faster than 512 pixels a frame
/// saturate. Smaller: motion is off by more than 1/128 pixel.
const STEPS: f32 = 64.0;

/// Motion of a surface in a view, per frame of the reference camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceMotion {
    /// Pixels of the view without its lens distortion.
    pub velocity: [f32; 2],
    /// 1/m.
    pub inverse_depth_rate: f32,
}

/// Quantization steps per pixel of change of disparity per frame: rates beyond 16 pixels saturate.
const RATE_STEPS: f32 = 8.0;

/// The quantized motion of a pixel: two numbers of 16 bits and one of 8, as bytes, so that no memory is padded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuantizedMotion([u8; 5]);

/// The motion of the surface at every pixel of a view at an instant, quantized to 5 bytes per pixel, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionMap {
    /// Disparity of an inverse depth of 1/m, pixels: the unit in which rates are quantized.
    disparity_px: f32,
    pixels: Vec<QuantizedMotion>,
}

impl MotionMap {
    /// A map without pixels, to be extended by up to `count`.
    pub fn empty(disparity_px: f32, count: usize) -> Self {
        let disparity_px = disparity_px.max(f32::MIN_POSITIVE);
        Self { disparity_px, pixels: Vec::with_capacity(count) }
    }

    pub fn extend(&mut self, more: impl IntoIterator<Item = QuantizedMotion>) {
        self.pixels.extend(more);
    }

    /// Copies the motion of pixel `from` to pixel `to`.
    pub fn copy(&mut self, from: usize, to: usize) {
        self.pixels[to] = self.pixels[from];
    }

    pub fn quantized(&self, motion: SurfaceMotion) -> QuantizedMotion {
        // Casts saturate.
        let [[a, b], [c, d]] = motion.velocity.map(|v| ((STEPS * v).round() as i16).to_le_bytes());
        let rate = (RATE_STEPS * self.disparity_px * motion.inverse_depth_rate).round() as i8;
        QuantizedMotion([a, b, c, d, rate as u8])
    }

    /// The motion of pixel `k`.
    pub fn motion(&self, k: usize) -> SurfaceMotion {
        let QuantizedMotion([a, b, c, d, rate]) = self.pixels[k];
        let velocity = [[a, b], [c, d]].map(|v| f32::from(i16::from_le_bytes(v)) / STEPS);
        let rate = f32::from(rate as i8) / RATE_STEPS;
        SurfaceMotion { velocity, inverse_depth_rate: rate / self.disparity_px }
    }
}
