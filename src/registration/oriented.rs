//! Descriptors of features that turn: gradients around a point, relative to their own main direction.
//!
//! As in Lowe's SIFT (IJCV 60(2), 2004), at one scale: 4×4 cells of eight directions each. A camera's next
//! frame shows a feature turned, and hardly larger.

use super::pyramid::Level;
use nalgebra::Point2;
use std::f32::consts::TAU;

/// Cells of a descriptor along a side, and directions of a cell. More: it tells more features apart, and
/// tolerates less deformation.
const CELLS: usize = 4;
const DIRECTIONS: usize = 8;
/// Numbers of a descriptor.
const SIZE: usize = CELLS * CELLS * DIRECTIONS;
/// A cell's side, pixels of the level. Larger: descriptors cross outlines; smaller: they tell fewer features
/// apart.
const CELL_PX: f32 = 4.0;
/// Half the side of the window, pixels: the cells' half diagonal, with half a cell around for the interpolation.
const RADIUS_PX: isize = 14;
/// Bins of the histogram whose largest is the main direction. More: noise moves it; fewer: it is less accurate.
const BINS: usize = 36;
/// Standard deviation of the main direction's window, pixels of the level. Larger: outlines decide it; smaller:
/// noise.
const DIRECTION_SIGMA_PX: f32 = 5.0;
/// Largest entry of a normalized descriptor. Larger: one strong edge decides; smaller: contrast is lost.
const MAX_ENTRY: f32 = 0.2;

/// A feature with its main direction and its descriptor.
pub(super) struct Oriented {
    /// The main direction of its gradients, radians, from x towards y.
    pub angle: f32,
    entries: [f32; SIZE],
}

/// The gradient at an offset from a feature: the offset in pixels, the strength, and the direction in radians.
type Sample = ([f32; 2], f32, f32);

impl Oriented {
    /// The descriptor of a point, pixels of the level with the first pixel's centre at (0, 0). `None` where
    /// there is no gradient.
    pub fn new(level: &Level, at: &Point2<f64>) -> Option<Self> {
        let samples = gradients(level, at);
        let angle = main_direction(&samples)?;
        let (sin, cos) = angle.sin_cos();
        let mut entries = [0.0; SIZE];
        let half = 0.5 * CELLS as f32;
        for &([x, y], strength, direction) in &samples {
            // In cells, in the feature's own frame.
            let [u, v] = [(cos * x + sin * y) / CELL_PX, (cos * y - sin * x) / CELL_PX];
            let weight = strength * (-(u * u + v * v) / (2.0 * half * half)).exp();
            let turn = (direction - angle).rem_euclid(TAU) / TAU * DIRECTIONS as f32;
            add(&mut entries, [u + half - 0.5, v + half - 0.5], turn, weight);
        }
        normalize(&mut entries)?;
        entries.iter_mut().for_each(|e| *e = e.min(MAX_ENTRY));
        normalize(&mut entries)?;
        Some(Self { angle, entries })
    }

    /// The squared distance of two descriptors, 0 to 2.
    pub fn distance(&self, other: &Self) -> f32 {
        self.entries.iter().zip(&other.entries).map(|(a, b)| (a - b) * (a - b)).sum()
    }
}

/// The gradients around a point, by central differences.
fn gradients(level: &Level, at: &Point2<f64>) -> Vec<Sample> {
    let [cx, cy] = [at.x.round() as isize, at.y.round() as isize];
    // The border is repeated as far as the padding reaches.
    let inside = |v: isize, size: usize| {
        let reach = level.pad as isize - 2;
        v.clamp(-reach, size as isize - 1 + reach)
    };
    let mut samples = Vec::with_capacity((2 * RADIUS_PX as usize + 1).pow(2));
    for y in cy - RADIUS_PX..=cy + RADIUS_PX {
        for x in cx - RADIUS_PX..=cx + RADIUS_PX {
            let k = level.index(inside(x, level.width), inside(y, level.height));
            let gx = level.value[k + 1] - level.value[k - 1];
            let gy = level.value[k + level.stride] - level.value[k - level.stride];
            let from = [x as f32 - at.x as f32, y as f32 - at.y as f32];
            samples.push((from, gx.hypot(gy), gy.atan2(gx)));
        }
    }
    samples
}

/// The largest bin of the histogram of directions, between bins by a parabola.
fn main_direction(samples: &[Sample]) -> Option<f32> {
    let mut histogram = [0.0; BINS];
    let scale = -0.5 / DIRECTION_SIGMA_PX.powi(2);
    for ([x, y], strength, direction) in samples {
        let bin = (direction.rem_euclid(TAU) / TAU * BINS as f32) as usize;
        histogram[bin % BINS] += strength * (scale * (x * x + y * y)).exp();
    }
    for _ in 0..2 {
        let raw = histogram;
        for (k, smooth) in histogram.iter_mut().enumerate() {
            *smooth = (raw[(k + BINS - 1) % BINS] + raw[k] + raw[(k + 1) % BINS]) / 3.0;
        }
    }
    let largest = (0..BINS).max_by(|&a, &b| histogram[a].total_cmp(&histogram[b]))?;
    let [before, at, after] = [BINS - 1, 0, 1].map(|k| histogram[(largest + k) % BINS]);
    let curvature = before - 2.0 * at + after;
    // Not negative only where all three are equal.
    let shift = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    (at > 0.0).then(|| (largest as f32 + 0.5 + shift) / BINS as f32 * TAU)
}

/// Adds a gradient to the cells and directions around it, by linear interpolation.
fn add(entries: &mut [f32; SIZE], cell: [f32; 2], direction: f32, weight: f32) {
    let [x, y, d] = [cell[0], cell[1], direction].map(f32::floor);
    let [fx, fy, fd] = [cell[0] - x, cell[1] - y, direction - d];
    for (row, wy) in [(y as isize, 1.0 - fy), (y as isize + 1, fy)] {
        for (column, wx) in [(x as isize, 1.0 - fx), (x as isize + 1, fx)] {
            let is_cell = |v: isize| (0..CELLS as isize).contains(&v);
            if !(is_cell(row) && is_cell(column)) {
                continue;
            }
            let at = (row as usize * CELLS + column as usize) * DIRECTIONS;
            for (k, wd) in [(d as usize, 1.0 - fd), (d as usize + 1, fd)] {
                entries[at + k % DIRECTIONS] += weight * wx * wy * wd;
            }
        }
    }
}

/// Scales to length 1; `None` if all entries are 0.
fn normalize(entries: &mut [f32; SIZE]) -> Option<()> {
    let length = entries.iter().map(|e| e * e).sum::<f32>().sqrt();
    entries.iter_mut().for_each(|e| *e /= length.max(f32::MIN_POSITIVE));
    (length > 0.0).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;
    use crate::registration::Pyramid;

    /// A pattern that is turned by `angle` around the image's middle.
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

    #[test]
    fn a_turned_feature_has_the_same_descriptor_and_its_angle_turns() {
        let middle = Point2::new(32.0, 32.0);
        let of =
            |pyramid: &Pyramid, p: &Point2<f64>| Oriented::new(&pyramid.levels()[0], p).unwrap();
        let upright = of(&turned(0.0), &middle);
        let other = of(&turned(0.0), &Point2::new(24.0, 38.0));
        for angle in [0.3, 0.9, 2.0, -1.4] {
            let found = of(&turned(angle), &middle);
            let turn =
                (found.angle - upright.angle - angle + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            assert!(turn.abs() < 0.06, "{angle}: {turn}");
            let (same, differs) = (found.distance(&upright), found.distance(&other));
            assert!(same < 0.05 && same < 0.2 * differs, "{angle}: {same} {differs}");
        }
    }

    #[test]
    fn a_flat_image_has_no_direction() {
        let flat = Pyramid::new(&Image::filled(40, 40, 1, 0.5), 1, 16);
        assert!(Oriented::new(&flat.levels()[0], &Point2::new(3.0, 38.0)).is_none());
    }
}
