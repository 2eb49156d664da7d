//! Motion of the surfaces that a view shows.

/// Quantization steps per pixel of motion, and of change of disparity. Larger: bodies faster than 512 pixels a frame
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

/// The quantized motion of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuantizedMotion {
    velocity: [i16; 2],
    rate: i16,
}

/// The motion of the surface at every pixel of a view at an instant, quantized to 6 bytes per pixel, row by row.
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
        let rounded = |v: f32| (STEPS * v).round() as i16; // saturates
        QuantizedMotion {
            velocity: motion.velocity.map(rounded),
            rate: rounded(self.disparity_px * motion.inverse_depth_rate),
        }
    }

    /// The motion of pixel `k`.
    pub fn motion(&self, k: usize) -> SurfaceMotion {
        let QuantizedMotion { velocity, rate } = self.pixels[k];
        let value = |v: i16| f32::from(v) / STEPS;
        SurfaceMotion {
            velocity: velocity.map(value),
            inverse_depth_rate: value(rate) / self.disparity_px,
        }
    }
}
