//! Bounds of a map's tiles in a view: which part of the view the splats of a tile can cover.

use super::element::Element;
use super::geometry::{MIN_RATIO, Projection};
use super::map::TILE_PX;

/// A box in the view: for columns and rows, the smallest and the largest position, pixels.
pub type Bounds = [[f32; 2]; 2];

/// Bounds that contain every position.
pub const EVERYWHERE: Bounds = [[f32::NEG_INFINITY, f32::INFINITY]; 2];

/// Tile of a scene flow map.
pub struct Tile {
    /// Column and row of the tile's first pixel.
    pub corner: [usize; 2],
    /// Smallest and largest values of the tile's surface elements.
    pub range: [Element; 2],
    /// Shortest and longest time from its rows to the view's instant, in frame periods of the reference camera.
    pub dt: [f32; 2],
}

impl Tile {
    /// Returns the bounds of the elements' positions in the view, without its lens distortion, and the largest ratio of
    /// an element's inverse depth in the view to that in the frame. If an element may be behind the view, the bounds are
    /// [`EVERYWHERE`].
    ///
    /// A homography of a convex set has its extremes at the set's corners, as long as the denominator is positive.
    pub fn bounds(&self, projection: &Projection) -> (Bounds, f32) {
        let [min, max] = &self.range;
        let half = self.half_squares();
        let moved = |c: usize| {
            let velocity = product([min.velocity[c], max.velocity[c]], self.dt);
            let acceleration = product([min.acceleration[c], max.acceleration[c]], half);
            let first = self.corner[c] as f32 + 0.5;
            let last = first + (TILE_PX[c] - 1) as f32;
            [first + velocity[0] + acceleration[0], last + velocity[1] + acceleration[1]]
        };
        let (x, y) = (moved(0), moved(1));
        let rate = product([min.inverse_depth_rate, max.inverse_depth_rate], self.dt);
        let q = [min.inverse_depth + rate[0], max.inverse_depth + rate[1]];
        let mut bounds = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
        let mut nearing = 0.0f32;
        for corner in 0..8 {
            let (x, y, q) = (x[corner & 1], y[corner >> 1 & 1], q[corner >> 2]);
            let [u, v, w] = projection.homogeneous(x, y, q);
            if w < MIN_RATIO {
                return (EVERYWHERE, f32::INFINITY);
            }
            let inverse = 1.0 / w;
            for ([min, max], at) in bounds.iter_mut().zip([u * inverse, v * inverse]) {
                (*min, *max) = (min.min(at), max.max(at));
            }
            nearing = nearing.max(inverse);
        }
        (bounds, nearing)
    }

    /// Returns the range of half of the squared time.
    fn half_squares(&self) -> [f32; 2] {
        let [a, b] = self.dt.map(|dt| 0.5 * dt * dt);
        let is_between = self.dt[0] < 0.0 && self.dt[1] > 0.0;
        [if is_between { 0.0 } else { a.min(b) }, a.max(b)]
    }
}

/// Returns the range of the products of two numbers, each of which lies in a range.
fn product(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    let all = [a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]];
    all.into_iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[min, max], value| {
        [min.min(value), max.max(value)]
    })
}
