//! An element's slant: an affine fit to the elements around it that lie on its surface.

use super::element::Element;
use super::map::ElementMap;
use super::matching::{PatchMatcher, color_difference};
use nalgebra::{Matrix3, Vector3};

/// Half-width of the fit, pixels of the level.
const RADIUS: i32 = 3;
/// Distance above which a neighbour is of another surface, pixels of the level.
const MAX_DISTANCE_PX: f32 = 2.0;
/// Difference of colours at which a neighbour's weight falls to 1/e.
const COLOR: f32 = 0.16;
/// Part of a neighbour's weight that no difference of colour takes away.
const MIN_COLOR_WEIGHT: f32 = 0.05;
/// Weight of the prior that all gradients are 0, as of a surface that is parallel to the image and moves as a whole.
/// Squared pixels of the pyramid level.
const FLATNESS: f64 = 0.3;
/// Largest gradient of the disparity, pixels a pixel.
const MAX_DISPARITY_GRADIENT: f32 = 1.6;
/// Largest gradient of the velocity, pixels a frame a pixel.
const MAX_MOTION_GRADIENT: f32 = 1.0;

impl PatchMatcher<'_> {
    /// The fit at a pixel of the map; `None` if it has no solution.
    pub fn affine_fit(&self, map: &ElementMap, x: usize, y: usize) -> Option<Element> {
        let (width, height) = (self.own.width as i32, self.own.height as i32);
        let own = map.elements[y * self.own.width + x];
        let center = self.own.pixel(x, y);
        let mut normal = Matrix3::<f64>::zeros();
        // Inverse depth, and both components of the velocity.
        let mut right = [Vector3::<f64>::zeros(); 3];
        let (mut rate, mut acceleration, mut weights) = (0.0f32, [0.0f32; 2], 0.0f32);
        for dy in (-RADIUS).max(-(y as i32))..=RADIUS.min(height - 1 - y as i32) {
            for dx in (-RADIUS).max(-(x as i32))..=RADIUS.min(width - 1 - x as i32) {
                let (u, v) = ((x as i32 + dx) as usize, (y as i32 + dy) as usize);
                let neighbor = map.elements[v * self.own.width + u];
                let (fx, fy) = (dx as f32 * self.scale, dy as f32 * self.scale);
                let distance = self.distance(&own.at(fx, fy), &neighbor);
                if distance > MAX_DISTANCE_PX {
                    continue;
                }
                let difference = color_difference(&self.own.pixel(u, v), &center);
                let weight =
                    ((-difference / COLOR).exp() + MIN_COLOR_WEIGHT) / (1.0 + distance * distance);
                let place = Vector3::new(1.0, f64::from(fx), f64::from(fy));
                let weighted = f64::from(weight) * place;
                normal += weighted * place.transpose();
                let values = [neighbor.inverse_depth, neighbor.velocity[0], neighbor.velocity[1]];
                for (right, value) in right.iter_mut().zip(values) {
                    *right += f64::from(value) * weighted;
                }
                rate += weight * neighbor.inverse_depth_rate;
                acceleration[0] += weight * neighbor.acceleration[0];
                acceleration[1] += weight * neighbor.acceleration[1];
                weights += weight;
            }
        }
        let flatness = FLATNESS * f64::from(self.scale).powi(2);
        normal[(1, 1)] += flatness;
        normal[(2, 2)] += flatness;
        let inverse = normal.try_inverse()?;
        let [q, u, v] = right.map(|right| (inverse * right).map(|v| v as f32));
        // The element itself has a positive weight.
        let max_depth_gradient = MAX_DISPARITY_GRADIENT / self.disparity_px;
        let clamped = |v: f32, max: f32| v.clamp(-max, max);
        Some(Element {
            inverse_depth: q[0],
            velocity: [u[0], v[0]],
            acceleration: acceleration.map(|a| a / weights),
            inverse_depth_rate: rate / weights,
            inverse_depth_gradient: [q[1], q[2]].map(|g| clamped(g, max_depth_gradient)),
            velocity_gradient: [[u[1], v[1]], [u[2], v[2]]]
                .map(|g| g.map(|g| clamped(g, MAX_MOTION_GRADIENT))),
        })
    }
}
