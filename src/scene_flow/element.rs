//! A surface element in one frame: its depth, its motion, and how both change across the image.

use super::geometry::Projection;

/// Small piece of a surface at a pixel of a frame: its inverse depth, and its path in the image of the frame's camera.
///
/// Pixels are those of the full-resolution image, times are in frame periods of the reference camera, and inverse
/// depths are in 1/m. After a time `t`, the element is at `pixel + velocity t + acceleration t²/2`, with the inverse
/// depth `inverse_depth + inverse_depth_rate t`. The path is a polynomial in image coordinates, not in space, because
/// motion is measured in images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Element {
    /// Inverse depth, 1/m.
    pub inverse_depth: f32,
    /// Velocity in the image, pixels per frame of the reference camera.
    pub velocity: [f32; 2],
    /// Acceleration in the image, pixels per squared frame of the reference camera.
    pub acceleration: [f32; 2],
    /// Rate of change of the inverse depth, 1/m per frame of the reference camera.
    pub inverse_depth_rate: f32,
    /// Change of the inverse depth, 1/m: first per pixel to the right, then per pixel down.
    pub inverse_depth_gradient: [f32; 2],
    /// Change of both velocity components, pixels per frame: first per pixel to the right, then per pixel down.
    pub velocity_gradient: [[f32; 2]; 2],
}

impl Element {
    /// Returns the element of the same surface at the pixel that is `dx` pixels to the right and `dy` pixels down.
    /// Inverse depth and velocity are extrapolated by their gradients.
    #[inline(always)]
    pub fn at(&self, dx: f32, dy: f32) -> Self {
        let [qx, qy] = self.inverse_depth_gradient;
        let [vx, vy] = self.velocity_gradient;
        Self {
            inverse_depth: self.inverse_depth + qx * dx + qy * dy,
            velocity: [
                self.velocity[0] + vx[0] * dx + vy[0] * dy,
                self.velocity[1] + vx[1] * dx + vy[1] * dy,
            ],
            ..*self
        }
    }

    /// Returns this surface element without motion: its velocity with gradient, acceleration and rate of inverse depth
    /// are 0.
    pub fn still(&self) -> Self {
        Self {
            velocity: [0.0; 2],
            acceleration: [0.0; 2],
            inverse_depth_rate: 0.0,
            velocity_gradient: [[0.0; 2]; 2],
            ..*self
        }
    }

    /// Returns the magnitude of the velocity, pixels per frame.
    #[inline(always)]
    pub fn speed(&self) -> f32 {
        // The squares of speeds in pixels don't overflow, so `hypot` isn't needed.
        (self.velocity[0] * self.velocity[0] + self.velocity[1] * self.velocity[1]).sqrt()
    }

    /// Returns the position and the inverse depth, `[x, y, q]`, to which the element at pixel `(x, y)` moves in `dt`
    /// frame periods.
    #[inline(always)]
    pub fn moved(&self, x: f32, y: f32, dt: f32) -> [f32; 3] {
        let half = 0.5 * dt * dt;
        [
            x + self.velocity[0] * dt + self.acceleration[0] * half,
            y + self.velocity[1] * dt + self.acceleration[1] * half,
            self.inverse_depth + self.inverse_depth_rate * dt,
        ]
    }

    /// Transfers the element at pixel `(x, y)` to another frame, `dt` frame periods later. Returns its position in the
    /// other frame, pixels, and the element in the other frame. Gradients and acceleration are copied, which is
    /// right if the cameras have about the same orientation and focal length.
    #[inline(always)]
    pub fn transferred(
        &self,
        x: f32,
        y: f32,
        dt: f32,
        projection: &Projection,
    ) -> ([f32; 2], Self) {
        let [mx, my, q] = self.moved(x, y, dt);
        let [u, v, q_there] = projection.project(mx, my, q);
        let [u1, v1, q1] = projection.project(
            mx + self.velocity[0] + dt * self.acceleration[0],
            my + self.velocity[1] + dt * self.acceleration[1],
            q + self.inverse_depth_rate,
        );
        let there = Self {
            inverse_depth: q_there,
            velocity: [u1 - u, v1 - v],
            inverse_depth_rate: q1 - q_there,
            ..*self
        };
        ([u, v], there)
    }
}

/// Standard errors of the surface element at one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ElementErrors {
    /// Standard error of the disparity, pixels, at a baseline of twice the distance between neighbouring cameras.
    pub disparity_px: f32,
    /// Standard error of the velocity in the direction in which it is largest, pixels per frame.
    pub velocity_px: f32,
}
