//! Motion of the surfaces that a rendered view shows.

/// Quantization steps per pixel of velocity. With this number, speeds of up to 512 pixels per frame can be stored, with
/// errors of at most 1/128 pixel.
const STEPS: f32 = 64.0;

/// Motion of a surface point in a view, per frame of the reference camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceMotion {
    /// Velocity in pixels of the view without its lens distortion, per frame of the reference camera.
    pub velocity: [f32; 2],
    /// Rate of change of the inverse depth, 1/m per frame of the reference camera.
    pub inverse_depth_rate: f32,
}

/// Quantization steps per unit of a disparity's rate of change, which is in pixels per frame. Rates beyond 16 pixels
/// per frame saturate.
const RATE_STEPS: f32 = 8.0;

/// Quantized [`SurfaceMotion`] of one pixel: two 16-bit numbers for the velocity and an 8-bit number for the inverse
/// depth's rate of change. They are stored as bytes, so that no memory is lost to padding.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuantizedMotion([u8; 5]);

/// The motion of the surface at every pixel of a view at an instant, quantized to 5 bytes per pixel, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionMap {
    /// Disparity of a point at a depth of 1 m, pixels, at a baseline of twice the distance between neighbouring
    /// cameras. It is the factor from an inverse depth, 1/m, to a disparity. Rates of inverse depth are quantized as
    /// rates of disparity.
    disparity_px: f32,
    pixels: Vec<QuantizedMotion>,
}

impl QuantizedMotion {
    /// `disparity_px` is [`MotionMap::disparity_px`].
    pub fn new(motion: SurfaceMotion, disparity_px: f32) -> Self {
        // Casts saturate.
        let [[a, b], [c, d]] = motion.velocity.map(|v| ((STEPS * v).round() as i16).to_le_bytes());
        let rate = (RATE_STEPS * disparity_px * motion.inverse_depth_rate).round() as i8;
        Self([a, b, c, d, rate as u8])
    }
}

impl MotionMap {
    /// Creates a map of `count` pixels without motion. `disparity_px` is the disparity, in pixels, of a point at a depth
    /// of 1 m, at a baseline of twice the distance between neighbouring cameras.
    pub fn still(disparity_px: f32, count: usize) -> Self {
        let disparity_px = disparity_px.max(f32::MIN_POSITIVE);
        Self { disparity_px, pixels: vec![QuantizedMotion::default(); count] }
    }

    /// Returns the map's pixels, row by row, and the factor with which their motion is quantized
    /// ([`QuantizedMotion::new`]).
    pub(super) fn pixels_mut(&mut self) -> (&mut [QuantizedMotion], f32) {
        (&mut self.pixels, self.disparity_px)
    }

    /// Copies the motion of pixel `from` to pixel `to`.
    pub fn copy(&mut self, from: usize, to: usize) {
        self.pixels[to] = self.pixels[from];
    }

    /// Returns the motion of pixel `k`.
    pub fn motion(&self, k: usize) -> SurfaceMotion {
        let QuantizedMotion([a, b, c, d, rate]) = self.pixels[k];
        let velocity = [[a, b], [c, d]].map(|v| f32::from(i16::from_le_bytes(v)) / STEPS);
        let rate = f32::from(rate as i8) / RATE_STEPS;
        SurfaceMotion { velocity, inverse_depth_rate: rate / self.disparity_px }
    }
}
