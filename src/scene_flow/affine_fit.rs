//! Fits linear functions of the pixel's position to the inverse depths and velocities around a pixel, by weighted least
//! squares. The result is a surface element with gradients, which is proposed for this pixel.

use super::element::Element;
use super::map::ElementMap;
use super::matching::PatchMatcher;
use super::matching_image::{MatchingSample, UNITS, difference};
use nalgebra::{Matrix3, Vector3};
use std::sync::LazyLock;

/// Half-width of the window of the fit, pixels of the pyramid level.
const RADIUS: i32 = 3;
/// Maximum distance ([`PatchMatcher::distance`]) between the pixel's surface element and an element of the window
/// that belongs to the same surface, pixels of the pyramid level.
const MAX_DISTANCE_PX: f32 = 2.0;
/// Colour difference between a neighbour and the pixel at which the colour term of the neighbour's weight falls to
/// 1/e.
const COLOR: f32 = 0.16;
/// Number of entries of [`COLOR_TERMS`]. Most pairs of neighbours differ less.
const DIFFERENCES: usize = 8192;
/// Constant that is added to the colour term of a neighbour's weight, so that neighbours of any colour have some
/// weight.
const MIN_COLOR_WEIGHT: f32 = 0.05;
/// Weight of the ridge regularization that pulls the gradients towards 0, squared pixels of the pyramid level. The
/// gradients are 0 on a surface that is parallel to the image and translates parallel to it.
const FLATNESS: f64 = 0.3;
/// Maximum magnitude of each component of the disparity's gradient, pixels of disparity per pixel.
const MAX_DISPARITY_GRADIENT: f32 = 1.6;
/// Maximum magnitude of each component of the velocity's gradient, pixels per frame per pixel.
const MAX_MOTION_GRADIENT: f32 = 1.0;

/// Colour term of a neighbour's weight by the difference of the colours in units of 1/[`UNITS`].
static COLOR_TERMS: LazyLock<[f32; DIFFERENCES]> =
    LazyLock::new(|| std::array::from_fn(|d| color_term(d as f32)));

fn color_term(difference: f32) -> f32 {
    (-(difference * (1.0 / UNITS)) / COLOR).exp()
}

#[inline(always)]
fn color_term_by(table: &[f32; DIFFERENCES], a: &MatchingSample, b: &MatchingSample) -> f32 {
    let difference = difference(a, b);
    table.get(difference as usize).copied().unwrap_or_else(|| color_term(difference as f32))
}

impl PatchMatcher<'_> {
    /// Returns the least-squares fit to the surface elements around pixel `(x, y)` of the scene flow map. `None` if
    /// the normal equations are singular.
    pub fn affine_fit(&self, map: &ElementMap, x: usize, y: usize) -> Option<Element> {
        let (width, height) = (self.own.width as i32, self.own.height as i32);
        let own = map.elements[y * self.own.width + x];
        let center = self.own.pixel(x, y);
        let color_terms: &[f32; DIFFERENCES] = &COLOR_TERMS;
        let mut normal = Matrix3::<f64>::zeros();
        // The right-hand sides for the inverse depth and for the two components of the velocity.
        let mut right = [Vector3::<f64>::zeros(); 3];
        let (mut rate, mut acceleration, mut weights) = (0.0f32, [0.0f32; 2], 0.0f32);
        for dy in (-RADIUS).max(-(y as i32))..=RADIUS.min(height - 1 - y as i32) {
            for dx in (-RADIUS).max(-(x as i32))..=RADIUS.min(width - 1 - x as i32) {
                let (u, v) = ((x as i32 + dx) as usize, (y as i32 + dy) as usize);
                if !self.own.films_pixel(u, v) {
                    continue;
                }
                let neighbor = map.elements[v * self.own.width + u];
                let (fx, fy) = (dx as f32 * self.scale, dy as f32 * self.scale);
                let distance = self.distance(&own.at(fx, fy), &neighbor);
                if distance > MAX_DISTANCE_PX {
                    continue;
                }
                let color_term = color_term_by(color_terms, &self.own.pixel(u, v), &center);
                let weight = (color_term + MIN_COLOR_WEIGHT) / (1.0 + distance * distance);
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
        // `weights` is positive, since the pixel's own element contributes.
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
