//! Tiles of a map, and bounds of their surface elements in a view or in another frame.

use super::element_lanes::{ElementLanes, eight};
use super::flow_pixel::{FlowPixel, Scales};
use super::geometry::{MIN_RATIO, Projection};
use crate::simd::{F32x8, LANES, multiversion};
use std::ops::Range;

/// Width and height of a map's tiles, pixels. Tiles at the right and lower borders may be smaller.
pub const TILE_PX: [usize; 2] = [16, 4];

/// A box in the view: for columns and rows, the smallest and the largest position, pixels.
pub type Bounds = [[f32; 2]; 2];

/// Rounding errors of a position in a view, pixels, are below this, unless an element is a hundred times nearer to the view
/// than to the frame.
pub const ROUNDING_PX: f32 = 0.1;
/// Bounds that contain every position.
pub const EVERYWHERE: Bounds = [[f32::NEG_INFINITY, f32::INFINITY]; 2];

/// Returns the columns of some tiles of a row as ranges, in order. `width` is that of the map, pixels, and `counts` returns whether
/// the tile with a number in the row is one of them.
pub fn columns_of(width: usize, counts: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for tile in (0..width.div_ceil(TILE_PX[0])).filter(|tile| counts(*tile)) {
        let left = tile * TILE_PX[0];
        let end = (left + TILE_PX[0]).min(width);
        match runs.last_mut() {
            Some(run) if run.end == left => run.end = end,
            _ => runs.push(left..end),
        }
    }
    runs
}

/// A row of a scene flow map's tiles.
pub struct TileRow<'a> {
    /// For each tile, the smallest and the largest values of its surface elements.
    pub ranges: &'a [[FlowPixel; 2]],
    pub scales: Scales,
    /// The first row of pixels.
    pub top: usize,
    /// Shortest and longest time from the rows of pixels to the view's instant, in frame periods of the reference camera.
    pub dt: [f32; 2],
}

/// What bounds the surface elements of a tile in a view.
#[derive(Clone, Copy)]
pub struct TileBounds {
    /// Bounds of their positions, without the view's lens distortion. They are [`EVERYWHERE`] if an element may be behind
    /// the view.
    pub place: Bounds,
    /// Smallest and largest inverse depth in the view, 1/m.
    pub inverse_depth: [f32; 2],
    /// Largest ratio of an element's inverse depth in the view to that in the frame.
    pub nearing: f32,
}

/// Bounds of a tile that has elements that may be behind the view.
const UNBOUNDED: TileBounds =
    TileBounds { place: EVERYWHERE, inverse_depth: EVERYWHERE[0], nearing: f32::INFINITY };

impl TileRow<'_> {
    /// Returns the bounds of each tile's elements in a view.
    pub fn bounds(&self, projection: &Projection) -> Vec<TileBounds> {
        let mut all = vec![UNBOUNDED; self.ranges.len()];
        bounds_of_tiles(&mut all, self, projection);
        all
    }

    /// Returns the range of half of the squared time.
    fn half_squares(&self) -> [f32; 2] {
        let [a, b] = self.dt.map(|dt| 0.5 * dt * dt);
        let is_between = self.dt[0] < 0.0 && self.dt[1] > 0.0;
        [if is_between { 0.0 } else { a.min(b) }, a.max(b)]
    }
}

/// Ranges of eight numbers.
type Ranges<V> = [V; 2];

/// Returns the ranges of the products of two numbers, each of which lies in a range.
#[inline(always)]
fn products<V: F32x8>([a, b]: Ranges<V>, [c, d]: Ranges<V>) -> Ranges<V> {
    let (ac, ad, bc, bd) = (a * c, a * d, b * c, b * d);
    [ac.simd_min(ad).simd_min(bc.simd_min(bd)), ac.simd_max(ad).simd_max(bc.simd_max(bd))]
}

/// Returns the ranges of positions, pixels, at which eight tiles' elements are after a time. `from` is where they were.
#[inline(always)]
fn moved<V: F32x8>(
    from: Ranges<V>,
    (velocity, dt): (Ranges<V>, Ranges<V>),
    (acceleration, half_squares): (Ranges<V>, Ranges<V>),
) -> Ranges<V> {
    let (by_velocity, by_acceleration) =
        (products(velocity, dt), products(acceleration, half_squares));
    [from[0] + by_velocity[0] + by_acceleration[0], from[1] + by_velocity[1] + by_acceleration[1]]
}

/// A homography of a convex set has its extremes at the set's corners, as long as the denominator is positive.
#[inline(always)]
fn bounds<V: F32x8>(all: &mut [TileBounds], row: &TileRow, projection: &Projection) {
    let (dt, half_squares) = (V::splats(row.dt), V::splats(row.half_squares()));
    let [width, height] = TILE_PX.map(|side| side as f32);
    let top = row.top as f32;
    for first in (0..row.ranges.len()).step_by(LANES) {
        let ranges = eight(row.ranges, first);
        let mut ends = [[FlowPixel::default(); LANES]; 2];
        for (l, [min, max]) in ranges.into_iter().enumerate() {
            (ends[0][l], ends[1][l]) = (min, max);
        }
        let min = ElementLanes::<V>::new(&ends[0], &row.scales);
        let max = ElementLanes::<V>::new(&ends[1], &row.scales);
        let mut left = [0.0; LANES];
        for (l, left) in left.iter_mut().enumerate() {
            *left = (first + l) as f32 * width + 0.5;
        }
        let left = V::from_array(&left);
        let columns = [left, left + V::splat(width - 1.0)];
        let rows = V::splats([top + 0.5, top + height - 0.5]);
        let mut places = [columns, rows];
        for (c, place) in places.iter_mut().enumerate() {
            let velocity = [min.velocity[c], max.velocity[c]];
            let acceleration = [min.acceleration[c], max.acceleration[c]];
            *place = moved(*place, (velocity, dt), (acceleration, half_squares));
        }
        let [x, y] = places;
        let rate = products([min.inverse_depth_rate, max.inverse_depth_rate], dt);
        let q = [min.inverse_depth + rate[0], max.inverse_depth + rate[1]];
        let (mut least, mut most) =
            ([V::splat(f32::INFINITY); 4], [V::splat(f32::NEG_INFINITY); 3]);
        let mut nearing = V::zero();
        for corner in 0..8 {
            let q = q[corner >> 2];
            let [u, v, w] = projection.homogeneous_lanes([x[corner & 1], y[corner >> 1 & 1], q]);
            let inverse = V::splat(1.0) / w;
            let places = [u * inverse, v * inverse, q * inverse];
            for (k, at) in places.into_iter().enumerate() {
                (least[k], most[k]) = (at.simd_min(least[k]), at.simd_max(most[k]));
            }
            least[3] = w.simd_min(least[3]);
            nearing = inverse.simd_max(nearing);
        }
        let (mut mins, mut maxes) = ([[0.0; LANES]; 4], [[0.0; LANES]; 3]);
        for (min, least) in mins.iter_mut().zip(least) {
            *min = least.to_array();
        }
        for (max, most) in maxes.iter_mut().zip(most) {
            *max = most.to_array();
        }
        let ([min_u, min_v, min_q, min_w], [max_u, max_v, max_q]) = (mins, maxes);
        let nearing = nearing.to_array();
        for (l, bounds) in all[first..].iter_mut().take(LANES).enumerate() {
            if min_w[l] >= MIN_RATIO {
                *bounds = TileBounds {
                    place: [[min_u[l], max_u[l]], [min_v[l], max_v[l]]],
                    inverse_depth: [min_q[l], max_q[l]],
                    nearing: nearing[l],
                };
            }
        }
    }
}

multiversion! {
    fn bounds_of_tiles(all: &mut [TileBounds], row: &TileRow, projection: &Projection) = bounds::<V>
}
