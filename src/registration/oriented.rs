//! Descriptors of features that turn: gradients around a point, relative to their own main direction.
//!
//! As in Lowe's SIFT (IJCV 60(2), 2004), at one scale: 4×4 cells of eight directions each. A camera's next
//! frame shows a feature turned, and hardly larger.

use super::Pyramid;
use nalgebra::{Point2, Vector2};
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
/// Radius of the window, pixels: the cells' half diagonal, with half a cell around for the interpolation.
const RADIUS_PX: isize = 14;
/// Bins of the histogram whose largest is the main direction. More: noise moves it; fewer: it is less accurate.
const BINS: usize = 36;
/// Standard deviation of the descriptor's window, pixels of the level. Larger: outlines count; smaller: fewer
/// gradients tell features apart.
const WINDOW_SIGMA_PX: f32 = 8.0;
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

/// The level whose gradients describe a feature. Coarser: small things lose their descriptors; finer: noise.
const LEVEL: usize = 1;

/// The gradients of a frame's level, by central differences.
#[derive(Debug)]
pub(super) struct Gradients {
    width: usize,
    height: usize,
    /// Pixels of the level over those of the frame.
    scale: f64,
    /// The strength, and the direction in radians from x towards y, 0 to 2π; row by row.
    polar: Vec<[f32; 2]>,
}

impl Gradients {
    pub fn new(pyramid: &Pyramid) -> Self {
        let levels = pyramid.levels();
        let n = LEVEL.min(levels.len() - 1);
        let level = &levels[n];
        let polar = |k: usize| {
            let [x, y] = [k % level.width, k / level.width].map(|v| v as isize);
            let k = level.index(x, y);
            let gx = level.value[k + 1] - level.value[k - 1];
            let gy = level.value[k + level.stride] - level.value[k - level.stride];
            [(gx * gx + gy * gy).sqrt(), around_once(gy.atan2(gx))]
        };
        Self {
            width: level.width,
            height: level.height,
            scale: 1.0 / f64::from(1_u32 << n),
            polar: (0..level.width * level.height).map(polar).collect(),
        }
    }

    /// The bytes of those of a pyramid.
    pub fn bytes_of(pyramid: &Pyramid) -> usize {
        let levels = pyramid.levels();
        let level = &levels[LEVEL.min(levels.len() - 1)];
        level.width * level.height * size_of::<[f32; 2]>()
    }

    /// Those around a point of the level, the first pixel's centre at (0, 0), inside the image.
    fn around(&self, [cx, cy]: [f32; 2]) -> Vec<Sample> {
        let span = |c: f32, size: usize| {
            let at = |v: isize| v.clamp(0, size as isize) as usize;
            let c = c.round() as isize;
            at(c - RADIUS_PX)..at(c + RADIUS_PX + 1)
        };
        let mut samples = Vec::with_capacity((2 * RADIUS_PX as usize + 1).pow(2));
        for y in span(cy, self.height) {
            for x in span(cx, self.width) {
                let from = [x as f32 - cx, y as f32 - cy];
                let square = from[0] * from[0] + from[1] * from[1];
                // Beyond the circle no cell is reached, however they are turned.
                if square <= (RADIUS_PX * RADIUS_PX) as f32 {
                    let [strength, direction] = self.polar[y * self.width + x];
                    let fade = (square * (-0.5 / WINDOW_SIGMA_PX.powi(2))).exp();
                    samples.push(Sample { from, fade, strength, direction });
                }
            }
        }
        samples
    }
}

/// A gradient near a feature.
struct Sample {
    /// The offset from the feature, pixels.
    from: [f32; 2],
    /// The descriptor's window there.
    fade: f32,
    strength: f32,
    direction: f32,
}

impl Oriented {
    /// The descriptor of a point of the frame, pixels. `None` where there is no gradient.
    pub fn new(gradients: &Gradients, at: &Point2<f64>) -> Option<Self> {
        // Levels are centred on even pixels, so positions relative to pixel centres scale.
        let at = (at.coords - Vector2::repeat(0.5)) * gradients.scale;
        let samples = gradients.around([at.x as f32, at.y as f32]);
        let angle = main_direction(&samples)?;
        let (sin, cos) = angle.sin_cos();
        let mut entries = [0.0; SIZE];
        let half = 0.5 * CELLS as f32;
        for sample in &samples {
            let [x, y] = sample.from;
            // In cells, in the feature's own frame.
            let [u, v] = [(cos * x + sin * y) / CELL_PX, (cos * y - sin * x) / CELL_PX];
            let turn = around_once(sample.direction - angle) / TAU * DIRECTIONS as f32;
            let cell = [u + half - 0.5, v + half - 0.5];
            add(&mut entries, cell, turn, sample.strength * sample.fade);
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

/// An angle between −2π and 2π, radians, as one between 0 and 2π.
fn around_once(angle: f32) -> f32 {
    if angle < 0.0 { (angle + TAU).max(0.0) } else { angle }
}

/// The largest bin of the histogram of directions, between bins by a parabola.
fn main_direction(samples: &[Sample]) -> Option<f32> {
    let mut histogram = [0.0; BINS];
    let scale = -0.5 / DIRECTION_SIGMA_PX.powi(2);
    for Sample { from: [x, y], strength, direction, .. } in samples {
        let square = x * x + y * y;
        // Beyond three standard deviations nothing counts.
        if square < (3.0 * DIRECTION_SIGMA_PX).powi(2) {
            let bin = (direction / TAU * BINS as f32) as usize;
            histogram[bin % BINS] += strength * (scale * square).exp();
        }
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
    // Positive, so that truncation is the floor; a cell is added, and taken away by the test below.
    let [x, y] = [cell[0] + 1.0, cell[1] + 1.0];
    if !(x >= 0.0 && y >= 0.0) {
        return;
    }
    let (column, row, d) = (x as usize, y as usize, direction as usize);
    let [fx, fy, fd] = [x - column as f32, y - row as f32, direction - d as f32];
    for (row, wy) in [(row, 1.0 - fy), (row + 1, fy)] {
        for (column, wx) in [(column, 1.0 - fx), (column + 1, fx)] {
            let is_cell = |v: usize| (1..=CELLS).contains(&v);
            if !(is_cell(row) && is_cell(column)) {
                continue;
            }
            let at = ((row - 1) * CELLS + column - 1) * DIRECTIONS;
            for (k, wd) in [(d, 1.0 - fd), (d + 1, fd)] {
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
        let middle = Point2::new(32.5, 32.5);
        let of = |pyramid: &Pyramid, p: &Point2<f64>| {
            Oriented::new(&Gradients::new(pyramid), p).unwrap()
        };
        let upright = of(&turned(0.0), &middle);
        let other = of(&turned(0.0), &Point2::new(24.5, 38.5));
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
        assert!(Oriented::new(&Gradients::new(&flat), &Point2::new(3.0, 38.0)).is_none());
    }
}
