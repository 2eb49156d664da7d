//! Rotation-invariant descriptors: Lowe's SIFT (IJCV 60(2), 2004) with 4×4 cells of eight directions. Descriptors
//! are computed at a single scale, because a feature may rotate from one frame to the next but hardly changes its
//! size.

use super::polar_gradients::{DIRECTIONS, PolarGradients, TURN};
use crate::simd::{F32x8, LANES, multiversion};
use nalgebra::{Point2, Vector2};
use std::f32::consts::TAU;
use std::ops::Range;

/// Number of cells along each side of a descriptor.
const CELLS: usize = 4;
/// Number of values in a descriptor.
const SIZE: usize = CELLS * CELLS * DIRECTIONS;
/// Side of a cell, in pixels of the pyramid level.
const CELL_PX: f32 = 4.0;
/// Radius of the disc of samples, in pixels of the pyramid level: half the diagonal of the 4×4 cells, plus half a
/// cell for interpolation, rounded up.
const RADIUS_PX: isize = 14;
/// Number of bins of the histogram of gradient directions. The peak of this histogram is the main direction.
const BINS: usize = 36;
/// Standard deviation of the Gaussian weights of the samples in a descriptor, in pixels of the pyramid level.
const WINDOW_SIGMA_PX: f32 = 8.0;
/// Standard deviation of the Gaussian weights of the samples in the histogram of gradient directions, in pixels of
/// the pyramid level.
const DIRECTION_SIGMA_PX: f32 = 5.0;
/// Maximum value in a normalized descriptor. SIFT clips larger values to limit the influence of strong edges.
const MAX_ENTRY: f32 = 0.2;

/// A SIFT descriptor, and the main direction to which its gradient directions are relative.
pub(super) struct SiftDescriptor {
    /// Main direction of the gradients around the feature, in radians, from the x axis towards the y axis.
    pub angle: f32,
    entries: [f32; SIZE],
}

/// Length of the buffers that hold one value per column or per row of a [`Disc`]. The buffers are padded, so that
/// [`LANES`] values can be read from any column or row on.
const SPAN: usize = (2 * RADIUS_PX as usize + 1).next_multiple_of(LANES) + LANES;
/// Number of cells along each side of the histogram grid: the descriptor's cells, one cell before them and two
/// after them. The additional cells receive samples that are outside the descriptor.
const GRID: usize = CELLS + 3;

/// The samples of a pyramid level within [`RADIUS_PX`] of a point.
struct Disc<'a> {
    gradients: &'a PolarGradients,
    /// Position of the point, in pixels of the level, with the centre of the first pixel at (0, 0).
    center: [f32; 2],
    columns: Range<usize>,
    rows: Range<usize>,
}

impl<'a> Disc<'a> {
    #[inline(always)]
    fn new(gradients: &'a PolarGradients, center: [f32; 2]) -> Self {
        let span = |c: f32, size: usize| {
            let at = |v: isize| v.clamp(0, size as isize) as usize;
            let c = c.round() as isize;
            at(c - RADIUS_PX)..at(c + RADIUS_PX + 1)
        };
        let (columns, rows) = (span(center[0], gradients.width), span(center[1], gradients.height));
        Self { gradients, center, columns, rows }
    }

    /// Returns the columns of row `y` that are inside the disc. At any rotation, the disc contains all cells of the
    /// descriptor.
    #[inline(always)]
    fn columns_of(&self, y: usize) -> Range<usize> {
        let dy = y as f32 - self.center[1];
        let half = ((RADIUS_PX * RADIUS_PX) as f32 - dy * dy).max(0.0).sqrt();
        let first = (self.center[0] - half).ceil().max(0.0) as usize;
        let end = (self.center[0] + half).floor().max(-1.0) + 1.0;
        first.max(self.columns.start)..(end as usize).min(self.columns.end)
    }

    /// Returns the Gaussian weights, with standard deviation `sigma_px`, of the disc's columns and of its rows. The
    /// weight of a sample is the product of its column's weight and its row's weight.
    #[inline(always)]
    fn fades(&self, sigma_px: f32) -> [[f32; SPAN]; 2] {
        let mut fades = [[0.0; SPAN]; 2];
        for (axis, span) in [&self.columns, &self.rows].into_iter().enumerate() {
            for (fade, at) in fades[axis].iter_mut().zip(span.clone()) {
                let from = at as f32 - self.center[axis];
                *fade = (from * from * (-0.5 / (sigma_px * sigma_px))).exp();
            }
        }
        fades
    }

    /// Returns the main direction, 0 to [`TURN`]: the peak of the histogram of gradient directions. Returns `None`
    /// if all gradients are 0.
    #[inline(always)]
    fn main_direction<V: F32x8>(&self) -> Option<f32> {
        const BINS_PER_DIRECTION: f32 = BINS as f32 / TURN;
        let [fade_x, fade_y] = self.fades(DIRECTION_SIGMA_PX);
        // One histogram for even and one for odd columns, so that their sums are computed in parallel. The last bin
        // receives directions that are rounded up to a full turn.
        let mut sums = [[0.0; BINS + 1]; 2];
        for y in self.rows.clone() {
            let fade_y = V::splat(fade_y[y - self.rows.start]);
            let columns = self.columns_of(y);
            for x in columns.clone().step_by(LANES) {
                let at = y * self.gradients.width + x;
                let direction = V::load(&self.gradients.direction, at);
                let bins = direction * V::splat(BINS_PER_DIRECTION);
                // The direction of a gradient that is not finite is NaN; `simd_max` turns it into 0.
                let (bins, _) =
                    bins.simd_max(V::zero()).simd_min(V::splat(BINS as f32)).floor_and_fraction();
                let fade = V::load(&fade_x, x - self.columns.start) * fade_y;
                let weights = (V::load(&self.gradients.strength, at) * fade).to_array();
                for l in 0..LANES.min(columns.end - x) {
                    sums[l % 2][bins[l] as usize] += weights[l];
                }
            }
        }
        let mut histogram = [0.0; BINS];
        for (k, (even, odd)) in sums[0].iter().zip(&sums[1]).enumerate() {
            histogram[k % BINS] += even + odd;
        }
        peak(histogram).map(|bin| bin / BINS_PER_DIRECTION)
    }

    /// Returns the histograms of gradient directions of the 4×4 cells. The cells and the directions are rotated by
    /// the main direction `angle`, which is in units of direction bins.
    #[inline(always)]
    fn cells<V: F32x8>(&self, angle: f32) -> [V; CELLS * CELLS] {
        let (sin, cos) = (angle / TURN * TAU).sin_cos();
        let [fade_x, fade_y] = self.fades(WINDOW_SIGMA_PX);
        // Position of the descriptor's centre in the histogram grid, in cells.
        const CENTER: f32 = 0.5 * CELLS as f32 + 0.5;
        // One histogram grid for even and one for odd columns, so that their sums are computed in parallel.
        let mut grids = [[V::zero(); GRID * GRID]; 2];
        let columns = V::from_array(&std::array::from_fn(|lane| lane as f32));
        // One-hot vectors, one for each direction.
        let one_hot = |d: usize| std::array::from_fn(|k| f32::from(u8::from(k == d)));
        let directions: [[f32; LANES]; DIRECTIONS] = std::array::from_fn(one_hot);
        let (lowest, highest) = (V::zero(), V::splat((CELLS + 1) as f32));
        for y in self.rows.clone() {
            let dy = y as f32 - self.center[1];
            let fade_y = V::splat(fade_y[y - self.rows.start]);
            let row_columns = self.columns_of(y);
            for x in row_columns.clone().step_by(LANES) {
                let at = y * self.gradients.width + x;
                // The position of each sample in the histogram grid, in cells, rotated by the main direction.
                // Positions outside the grid are clamped to its border.
                let dx = columns + V::splat(x as f32 - self.center[0]);
                let u = dx.mul_add(V::splat(cos / CELL_PX), V::splat(sin * dy / CELL_PX + CENTER));
                let v = dx.mul_add(V::splat(-sin / CELL_PX), V::splat(cos * dy / CELL_PX + CENTER));
                let (column, fu) = u.simd_max(lowest).simd_min(highest).floor_and_fraction();
                let (row, fv) = v.simd_max(lowest).simd_min(highest).floor_and_fraction();
                let turn = V::load(&self.gradients.direction, at) - V::splat(angle);
                let (direction, fd) = turn.floor_and_fraction();
                let fade = V::load(&fade_x, x - self.columns.start) * fade_y;
                let weights = V::load(&self.gradients.strength, at) * fade;
                let [upper, lower] = [weights - weights * fv, weights * fv];
                let corners = [
                    (upper - upper * fu).to_array(),
                    (upper * fu).to_array(),
                    (lower - lower * fu).to_array(),
                    (lower * fu).to_array(),
                ];
                let fd = fd.to_array();
                for l in 0..LANES.min(row_columns.end - x) {
                    // The remainder is also correct for negative directions, since DIRECTIONS is a power of two and
                    // divides the range of usize.
                    let d = direction[l] as usize % DIRECTIONS;
                    let own = V::from_array(&directions[d]);
                    let next = V::from_array(&directions[(d + 1) % DIRECTIONS]);
                    let direction_weights = (next - own).mul_add(V::splat(fd[l]), own);
                    let cell = row[l] as usize * GRID + column[l] as usize;
                    // A single bounds check for all four cells.
                    let grid = &mut grids[l % 2][cell..cell + GRID + 2];
                    for (k, to) in [0, 1, GRID, GRID + 1].into_iter().enumerate() {
                        grid[to] = direction_weights.mul_add(V::splat(corners[k][l]), grid[to]);
                    }
                }
            }
        }
        let mut cells = [V::zero(); CELLS * CELLS];
        for (k, cell) in cells.iter_mut().enumerate() {
            let at = (k / CELLS + 1) * GRID + k % CELLS + 1;
            *cell = grids[0][at] + grids[1][at];
        }
        cells
    }
}

multiversion! {
    /// Computes the SIFT descriptor at a point of the frame, in pixels. Returns `None` if all gradients around the
    /// point are 0, or if one of them is not finite.
    pub(super) fn descriptor(
        gradients: &PolarGradients,
        at: &Point2<f64>,
    ) -> Option<SiftDescriptor> = descriptor_by::<V>
}

#[inline(always)]
fn descriptor_by<V: F32x8>(gradients: &PolarGradients, at: &Point2<f64>) -> Option<SiftDescriptor> {
    // A pixel of a level has the same centre as every second pixel of the next finer level. Positions relative to
    // the centre of the first pixel are therefore only scaled.
    let at = (at.coords - Vector2::repeat(0.5)) * gradients.scale;
    let disc = Disc::new(gradients, [at.x as f32, at.y as f32]);
    let angle = disc.main_direction::<V>()?;
    let mut cells = disc.cells::<V>(angle);
    normalize(&mut cells)?;
    for cell in &mut cells {
        *cell = cell.simd_min(V::splat(MAX_ENTRY));
    }
    normalize(&mut cells)?;
    let mut entries = [0.0; SIZE];
    for (k, cell) in cells.into_iter().enumerate() {
        cell.store(&mut entries, k * DIRECTIONS);
    }
    Some(SiftDescriptor { angle: angle / TURN * TAU, entries })
}

multiversion! {
    /// Returns the squared Euclidean distance between two descriptors, 0 to 2.
    pub(super) fn squared_distance(a: &SiftDescriptor, b: &SiftDescriptor) -> f32 = squared_distance_by::<V>
}

#[inline(always)]
fn squared_distance_by<V: F32x8>(a: &SiftDescriptor, b: &SiftDescriptor) -> f32 {
    let mut sums = [V::zero(); 2];
    for at in (0..SIZE).step_by(2 * LANES) {
        for (k, sum) in sums.iter_mut().enumerate() {
            let at = at + k * LANES;
            let apart = V::load(&a.entries, at) - V::load(&b.entries, at);
            *sum = apart.mul_add(apart, *sum);
        }
    }
    (sums[0] + sums[1]).sum() as f32
}

/// Smooths a circular histogram and returns the position of its peak, in bins from 0 to [`BINS`]. A parabola through
/// the largest bin and its two neighbours gives the position between bins. Returns `None` if all bins are 0.
fn peak(mut histogram: [f32; BINS]) -> Option<f32> {
    for _ in 0..2 {
        let raw = histogram;
        for (k, smooth) in histogram.iter_mut().enumerate() {
            *smooth = (raw[(k + BINS - 1) % BINS] + raw[k] + raw[(k + 1) % BINS]) / 3.0;
        }
    }
    let largest = (0..BINS).max_by(|&a, &b| histogram[a].total_cmp(&histogram[b]))?;
    let [before, at, after] = [BINS - 1, 0, 1].map(|k| histogram[(largest + k) % BINS]);
    let curvature = before - 2.0 * at + after;
    // The curvature at the largest bin is negative unless all three bins are equal.
    let shift = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    (at > 0.0).then_some(largest as f32 + 0.5 + shift)
}

/// Normalizes a descriptor to Euclidean length 1. Returns `None` if all values are 0.
#[inline(always)]
fn normalize<V: F32x8>(cells: &mut [V; CELLS * CELLS]) -> Option<()> {
    let mut squares = V::zero();
    for cell in cells.iter() {
        squares = cell.mul_add(*cell, squares);
    }
    let length = squares.sum().sqrt();
    let scale = V::splat((1.0 / length.max(f64::from(f32::MIN_POSITIVE))) as f32);
    for cell in cells.iter_mut() {
        *cell = *cell * scale;
    }
    (length > 0.0).then_some(())
}

#[cfg(test)]
mod tests {
    use super::super::polar_gradients::polar_gradients;
    use super::*;
    use crate::random::Random;
    use crate::raster::Image;
    use crate::registration::Pyramid;
    use crate::simd::Scalar;

    /// Builds the pyramid of a pattern that is rotated by `angle` (radians) around the image's middle.
    fn turned(angle: f32) -> Pyramid {
        let (sin, cos) = angle.sin_cos();
        let value = |k: usize| {
            let [x, y] = [(k % 64) as f32 - 32.0, (k / 64) as f32 - 32.0];
            let [u, v] = [cos * x + sin * y, cos * y - sin * x];
            0.5 + 0.2 * (0.31 * u + 0.4).sin() * (0.23 * v).cos()
                + 0.2 * (0.17 * u - 0.29 * v).sin()
        };
        Pyramid::new(&Image::from_data(64, 64, 1, (0..64 * 64).map(value).collect()), 1, 16)
    }

    /// Reference implementation of the descriptor, as simple as possible: sample by sample, value by value. Returns
    /// the main direction in radians, and the values.
    fn naive(pyramid: &Pyramid, at: &Point2<f64>) -> Option<(f32, Vec<f32>)> {
        let gradients = polar_gradients(pyramid);
        let at = (at.coords - Vector2::repeat(0.5)) * gradients.scale;
        let (cx, cy) = (at.x as f32, at.y as f32);
        let mut samples = Vec::new();
        for k in 0..gradients.width * gradients.height {
            let from = [(k % gradients.width) as f32 - cx, (k / gradients.width) as f32 - cy];
            let square = from[0] * from[0] + from[1] * from[1];
            if square <= (RADIUS_PX * RADIUS_PX) as f32 {
                samples.push((from, square, gradients.strength[k], gradients.direction[k]));
            }
        }
        let mut histogram = [0.0; BINS];
        for (_, square, strength, direction) in &samples {
            let fade = (square * (-0.5 / DIRECTION_SIGMA_PX.powi(2))).exp();
            histogram[(direction / TURN * BINS as f32) as usize % BINS] += strength * fade;
        }
        let angle = peak(histogram)? / BINS as f32 * TURN;
        let (sin, cos) = (angle / TURN * TAU).sin_cos();
        let near = |a: f32, b: f32| (1.0 - (a - b).abs()).max(0.0);
        let middle = 0.5 * (CELLS - 1) as f32;
        let entry = |k: usize| {
            let of = |(from, square, strength, direction): &([f32; 2], f32, f32, f32)| {
                let [x, y] = *from;
                let [u, v] = [(cos * x + sin * y) / CELL_PX, (cos * y - sin * x) / CELL_PX];
                let turn = (direction - angle).rem_euclid(TURN);
                let own = (k % DIRECTIONS) as f32;
                let along = near(turn, own) + near(turn, own + TURN);
                let [column, row] = [k / DIRECTIONS % CELLS, k / DIRECTIONS / CELLS];
                let across = near(u + middle, column as f32) * near(v + middle, row as f32);
                strength * (square * (-0.5 / WINDOW_SIGMA_PX.powi(2))).exp() * along * across
            };
            samples.iter().map(of).sum()
        };
        let normalized = |entries: Vec<f32>| -> Vec<f32> {
            let length = entries.iter().map(|e| e * e).sum::<f32>().sqrt();
            entries.into_iter().map(|e| e / length).collect()
        };
        let entries = normalized((0..SIZE).map(entry).collect());
        let clipped = entries.into_iter().map(|e| e.min(MAX_ENTRY)).collect();
        Some((angle / TURN * TAU, normalized(clipped)))
    }

    /// Some points are at the image's border, and some levels are smaller than the disc of samples.
    #[test]
    fn descriptors_agree_with_a_naive_reference() {
        let mut random = Random::new(5);
        for (w, h) in [(64, 64), (71, 40), (23, 37), (9, 5)] {
            let data = (0..w * h).map(|_| random.unit() as f32).collect();
            let pyramid = Pyramid::new(&Image::from_data(w, h, 1, data), 2, 16);
            let gradients = polar_gradients(&pyramid);
            let mut described = Vec::new();
            for k in 0..60 {
                let mut along = |size: usize| random.unit() * size as f64;
                let at = Point2::new(along(w), along(h));
                let at = if k % 3 == 0 { at.map(f64::round) } else { at };
                let (angle, entries) = naive(&pyramid, &at).unwrap();
                let mut all = vec![descriptor_by::<Scalar>(&gradients, &at).unwrap()];
                all.push(descriptor(&gradients, &at).unwrap());
                for own in &all {
                    assert!((own.angle - angle).abs() < 1e-4, "{at}: {} {angle}", own.angle);
                    for (a, b) in own.entries.iter().zip(&entries) {
                        assert!((a - b).abs() < 1e-4, "{at}: {a} {b}");
                    }
                }
                described.append(&mut all);
            }
            for (a, b) in described.iter().zip(&described[1..]) {
                let pairs = a.entries.iter().zip(&b.entries);
                let expected: f32 = pairs.map(|(a, b)| (a - b) * (a - b)).sum();
                assert!((squared_distance(a, b) - expected).abs() < 1e-5);
                assert!(
                    (squared_distance_by::<Scalar>(a, b) - squared_distance(a, b)).abs() < 1e-6
                );
            }
        }
    }

    #[test]
    fn a_turned_feature_has_the_same_descriptor_and_its_angle_turns() {
        let middle = Point2::new(32.5, 32.5);
        let of =
            |pyramid: &Pyramid, p: &Point2<f64>| descriptor(&polar_gradients(pyramid), p).unwrap();
        let upright = of(&turned(0.0), &middle);
        let other = of(&turned(0.0), &Point2::new(24.5, 38.5));
        for angle in [0.3, 0.9, 2.0, -1.4] {
            let found = of(&turned(angle), &middle);
            let turn =
                (found.angle - upright.angle - angle + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            assert!(turn.abs() < 0.06, "{angle}: {turn}");
            let (same, differs) =
                (squared_distance(&found, &upright), squared_distance(&found, &other));
            assert!(same < 0.05 && same < 0.2 * differs, "{angle}: {same} {differs}");
        }
    }

    #[test]
    fn a_flat_image_has_no_direction() {
        let flat = Pyramid::new(&Image::filled(40, 40, 1, 0.5), 1, 16);
        assert!(descriptor(&polar_gradients(&flat), &Point2::new(3.0, 38.0)).is_none());
    }
    #[test]
    fn values_that_are_not_finite_have_no_descriptor() {
        let mut random = Random::new(7);
        for bad in [f32::NAN, f32::INFINITY] {
            let mut data: Vec<_> = (0..64 * 64).map(|_| random.unit() as f32).collect();
            (data[32 * 64 + 32], data[33 * 64 + 32]) = (bad, bad);
            let pyramid = Pyramid::new(&Image::from_data(64, 64, 1, data), 1, 16);
            let gradients = polar_gradients(&pyramid);
            for at in [Point2::new(32.5, 32.5), Point2::new(36.0, 30.0)] {
                assert!(descriptor(&gradients, &at).is_none());
                assert!(descriptor_by::<Scalar>(&gradients, &at).is_none());
            }
        }
    }
}
