//! A surface element as one frame sees it: depth, motion, and how both change across the image.

use super::geometry::Projection;

/// A small piece of a surface at a pixel of a frame: its inverse depth, and its path through the frame's
/// camera.
///
/// Pixels are those of the full image, times are frames of the reference camera, inverse depths are 1/m.
/// After a time `t` the element is at `pixel + velocity t + acceleration t²/2`, with the inverse depth
/// `inverse_depth + inverse_depth_rate t`. These paths are polynomials in the image, where motion is
/// measured, rather than in space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Element {
    pub inverse_depth: f32,
    /// Pixels per frame.
    pub velocity: [f32; 2],
    /// Pixels per frame squared.
    pub acceleration: [f32; 2],
    /// 1/m per frame.
    pub inverse_depth_rate: f32,
    /// Change of the inverse depth per pixel to the right, and per pixel down.
    pub inverse_depth_gradient: [f32; 2],
    /// Change of the velocity per pixel to the right, and per pixel down.
    pub velocity_gradient: [[f32; 2]; 2],
}

impl Element {
    /// The element of the same surface at a pixel `dx` to the right and `dy` down: inverse depth and velocity
    /// extrapolated by their gradients.
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

    /// The same element without motion.
    pub fn still(&self) -> Self {
        Self {
            velocity: [0.0; 2],
            acceleration: [0.0; 2],
            inverse_depth_rate: 0.0,
            velocity_gradient: [[0.0; 2]; 2],
            ..*self
        }
    }

    /// Magnitude of the velocity, pixels per frame.
    #[inline(always)]
    pub fn speed(&self) -> f32 {
        // Squares of pixels don't overflow, so that `hypot` isn't needed.
        (self.velocity[0] * self.velocity[0] + self.velocity[1] * self.velocity[1]).sqrt()
    }

    /// The position `[x, y]` and the inverse depth, after `dt` frames, of the element at pixel `(x, y)`.
    #[inline(always)]
    pub fn moved(&self, x: f32, y: f32, dt: f32) -> [f32; 3] {
        let half = 0.5 * dt * dt;
        [
            x + self.velocity[0] * dt + self.acceleration[0] * half,
            y + self.velocity[1] * dt + self.acceleration[1] * half,
            self.inverse_depth + self.inverse_depth_rate * dt,
        ]
    }

    /// The element at pixel `(x, y)` as another frame, `dt` frames later, sees it: its pixel there, and the
    /// element there. Gradients and acceleration are copied, since the cameras stand close together.
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

/// Standard errors of one pixel's element.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ElementErrors {
    /// Pixels of disparity, at the baseline of the map.
    pub disparity_px: f32,
    /// Of the velocity's larger principal component, pixels per frame.
    pub velocity_px: f32,
}
