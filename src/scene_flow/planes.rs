//! Planes of static surfaces in a map of disparities, by RANSAC (Fischler, Bolles 1981) in tiles of the image. The
//! disparity of a plane is a linear function of the pixel's position.

use crate::random::Random;
use nalgebra::{Matrix3, Vector3};

/// Side of a tile, pixels of the full-resolution image. The samples of a tile are those of the 3×3 tiles around it.
const TILE_PX: f64 = 64.0;
/// Number of samples along a side of the 3×3 tiles.
const SAMPLES: usize = 32;
/// Maximum number of planes of a tile.
const MAX_PLANES: usize = 3;
/// Number of planes, each through three random samples, of which the one with most inliers is chosen.
const TRIALS: usize = 60;
/// Number of weighted least-squares fits that refine a chosen plane.
const REFINEMENTS: usize = 3;
/// Minimum number of inliers of a plane.
const MIN_INLIERS: usize = 24;
/// Maximum magnitude of each component of a plane's gradient, pixels of disparity per pixel.
const MAX_GRADIENT: f64 = 1.6;
/// Minimum determinant of the normal equations of a fit, px⁴. It is the product of the variances of the samples'
/// positions along two axes. If it is smaller, the samples lie on a line.
const MIN_DETERMINANT: f64 = 1.0;

/// Standard error that is added to that of each sample when the covariance of a plane is computed, pixels, since surfaces
/// aren't exactly plane. If it is 0, a plane through the outline of a body seems accurate far from the body.
const UNEVENNESS: f64 = 0.05;
/// Number of samples that tell as much as one independent sample. Patches from which disparities are found are wider than the
/// distance between samples, so that neighbouring samples have errors in common.
const SAMPLES_PER_INDEPENDENT: f64 = 4.0;

/// A plane in space, as the disparities of its points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    center: [f64; 2],
    disparity: f64,
    /// Change of the disparity, pixels: per pixel to the right, and per pixel down.
    pub gradient: [f64; 2],
    /// Covariance of the disparity at the centre and of the gradient's components; 0 until a plane is chosen.
    covariance: Matrix3<f64>,
}

impl Plane {
    /// Returns the disparity at a position, both in pixels.
    pub fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let [gx, gy] = self.gradient;
        self.disparity + gx * (x - self.center[0]) + gy * (y - self.center[1])
    }

    /// Returns the standard error of the disparity at a position, pixels. It grows with the distance from the samples.
    pub fn error_at(&self, position: [f64; 2]) -> f64 {
        let place = place(position, self.center);
        place.dot(&(self.covariance * place)).max(0.0).sqrt() // not negative but for rounding errors
    }

    /// Returns the plane with the covariance that follows from the standard errors of samples. `None` if these lie on a line.
    fn with_covariance(mut self, samples: &[DisparitySample], tolerance: f64) -> Option<Self> {
        let mut information = Matrix3::<f64>::zeros();
        for s in samples {
            let variance = s.error.powi(2) + UNEVENNESS.powi(2); // positive
            let place = place(s.position, self.center);
            information += closeness(&self, s, tolerance) / variance * place * place.transpose();
        }
        self.covariance = information.try_inverse()? * SAMPLES_PER_INDEPENDENT;
        Some(self)
    }
}

/// Returns the derivatives of a plane's disparity at a position by its disparity at the centre and its gradient.
fn place([x, y]: [f64; 2], center: [f64; 2]) -> Vector3<f64> {
    Vector3::new(1.0, x - center[0], y - center[1])
}

/// Disparity at a position of the image, with its standard error; all in pixels of the full-resolution image.
#[derive(Clone, Copy, Debug)]
pub struct DisparitySample {
    pub position: [f64; 2],
    pub disparity: f64,
    /// Standard error of the disparity. It must be positive.
    pub error: f64,
}

/// Planes in the tiles of an image.
pub struct TilePlanes {
    columns: usize,
    rows: usize,
    /// The planes of each tile, row by row.
    planes: Vec<Vec<Plane>>,
}

impl TilePlanes {
    /// Finds the planes in an image of `[width, height]` pixels. `sample` returns the sample at a position; `None` if the
    /// disparity is unknown there. `tolerance` is the maximum distance between a plane and its inliers, pixels of
    /// disparity.
    pub fn new(
        [width, height]: [f64; 2],
        tolerance: f64,
        sample: impl Fn([f64; 2]) -> Option<DisparitySample>,
    ) -> Self {
        let tiles = |side: f64| ((side / TILE_PX).ceil() as usize).max(1);
        let (columns, rows) = (tiles(width), tiles(height));
        let step = 3.0 * TILE_PX / SAMPLES as f64;
        let in_tile = |tile: usize| {
            let [left, top] = [tile % columns, tile / columns].map(|n| (n as f64 - 1.0) * TILE_PX);
            let at = |n: usize, first: f64| first + (n as f64 + 0.5) * step;
            let position = |k: usize| [at(k % SAMPLES, left), at(k / SAMPLES, top)];
            let samples = (0..SAMPLES * SAMPLES).filter_map(|k| sample(position(k))).collect();
            planes(samples, tolerance, &mut Random::new(tile as u64))
        };
        Self { columns, rows, planes: (0..columns * rows).map(in_tile).collect() }
    }

    /// Returns the planes of the tile that contains a position, pixels.
    pub fn around(&self, [x, y]: [f64; 2]) -> &[Plane] {
        let tile = |v: f64, count: usize| ((v / TILE_PX) as usize).min(count - 1); // saturates
        &self.planes[tile(y, self.rows) * self.columns + tile(x, self.columns)]
    }
}

/// Returns planes through samples, one after the other. The inliers of a plane are left out for the next one.
fn planes(mut samples: Vec<DisparitySample>, tolerance: f64, random: &mut Random) -> Vec<Plane> {
    let mut planes = Vec::new();
    while planes.len() < MAX_PLANES && samples.len() >= MIN_INLIERS {
        let Some(mut plane) = best_trial(&samples, tolerance, random) else { break };
        for _ in 0..REFINEMENTS {
            let weight = |s: &DisparitySample| closeness(&plane, s, tolerance) / s.error.powi(2);
            plane = fitted(samples.iter().map(|s| (s, weight(s)))).unwrap_or(plane);
        }
        let Some(plane) = plane.with_covariance(&samples, tolerance) else { break };
        let before = samples.len();
        samples.retain(|s| closeness(&plane, s, tolerance) == 0.0);
        if before - samples.len() < MIN_INLIERS {
            break;
        }
        planes.push(plane);
    }
    planes
}

/// Returns the plane through three random samples to which most samples are close. `None` if no trial gives a plane.
fn best_trial(samples: &[DisparitySample], tolerance: f64, random: &mut Random) -> Option<Plane> {
    let mut any =
        || samples[((random.unit() * samples.len() as f64) as usize).min(samples.len() - 1)];
    let trials = (0..TRIALS).filter_map(|_| {
        let three = [any(), any(), any()];
        fitted(three.iter().map(|s| (s, 1.0)))
    });
    let support = |p: &Plane| samples.iter().map(|s| closeness(p, s, tolerance)).sum::<f64>();
    let scored = trials.map(|p| (support(&p), p));
    scored.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, plane)| plane)
}

/// Returns how close a sample is to a plane: 1 if it lies on the plane, 0 at the tolerance and beyond.
fn closeness(plane: &Plane, sample: &DisparitySample, tolerance: f64) -> f64 {
    let distance = (plane.at(sample.position) - sample.disparity) / tolerance;
    (1.0 - distance * distance).max(0.0)
}

/// Returns the plane that fits weighted samples best. `None` if all weights are 0, the samples lie on a line, or the plane
/// is too steep.
fn fitted<'a>(samples: impl Iterator<Item = (&'a DisparitySample, f64)> + Clone) -> Option<Plane> {
    let sum: f64 = samples.clone().map(|(_, weight)| weight).sum();
    if sum <= 0.0 {
        return None;
    }
    let mean = |axis: usize| samples.clone().map(|(s, w)| w * s.position[axis]).sum::<f64>() / sum;
    let center = [mean(0), mean(1)];
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for (s, weight) in samples {
        let place = place(s.position, center);
        normal += weight / sum * place * place.transpose();
        right += weight / sum * s.disparity * place;
    }
    if normal.determinant() < MIN_DETERMINANT {
        return None;
    }
    let solution = normal.try_inverse()? * right;
    let gradient = [solution.y, solution.z];
    let is_steep = gradient.iter().any(|g| g.abs() > MAX_GRADIENT);
    let covariance = Matrix3::zeros();
    (!is_steep).then_some(Plane { center, disparity: solution.x, gradient, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample([x, y]: [f64; 2], disparity: f64) -> DisparitySample {
        DisparitySample { position: [x, y], disparity, error: 0.02 }
    }

    #[test]
    fn a_wall_and_a_floor_are_two_planes_whatever_moves_before_them() {
        let floor = |y: f64| 8.0 + 0.2 * (y - 70.0);
        let known = |at @ [x, y]: [f64; 2]| {
            let is_inside = (0.0..128.0).contains(&x) && (0.0..128.0).contains(&y);
            let is_body = (40.0..60.0).contains(&x) && (30.0..90.0).contains(&y);
            let static_px = if y < 70.0 { 8.0 } else { floor(y) };
            is_inside.then(|| sample(at, if is_body { 20.0 + 0.9 * x } else { static_px }))
        };
        let tiles = TilePlanes::new([128.0, 128.0], 0.15, known);
        for (at, expected) in [([100.0, 20.0], 8.0), ([100.0, 120.0], floor(120.0))] {
            let nearest = tiles.around(at).iter().map(|p| (p.at(at) - expected).abs());
            assert!(nearest.fold(f64::INFINITY, f64::min) < 1e-6, "{at:?}");
        }
    }

    #[test]
    fn a_few_samples_or_those_on_a_line_give_no_plane() {
        let line = |[x, y]: [f64; 2]| (y as usize == 35).then(|| sample([x, 35.0], 5.0));
        let few = |at @ [x, y]: [f64; 2]| (x.min(y) > 0.0 && x + y < 20.0).then(|| sample(at, 5.0));
        assert!(TilePlanes::new([64.0, 64.0], 0.15, line).around([32.0, 32.0]).is_empty());
        assert!(TilePlanes::new([64.0, 64.0], 0.15, few).around([32.0, 32.0]).is_empty());
    }

    #[test]
    fn a_plane_through_a_narrow_strip_is_uncertain_beside_it() {
        let strip = |at @ [x, _]: [f64; 2]| (x < 14.0).then(|| sample(at, 5.0));
        let all = |at: [f64; 2]| Some(sample(at, 5.0));
        let errors = |known: &dyn Fn([f64; 2]) -> Option<DisparitySample>| {
            let tiles = TilePlanes::new([64.0, 64.0], 0.15, known);
            [[5.0, 32.0], [250.0, 32.0]].map(|at| tiles.around([32.0; 2])[0].error_at(at))
        };
        let is_strip = |at: [f64; 2]| if at[0] > 0.0 && at[1] > 0.0 { strip(at) } else { None };
        let [narrow, wide] = [errors(&is_strip), errors(&all)];
        assert!(narrow[0] < 0.05 && narrow[1] > 0.5, "{narrow:?}");
        assert!(wide[0] < 0.02 && wide[1] < 0.1, "{wide:?}");
    }

    #[test]
    fn outside_of_the_image_the_nearest_tile_counts() {
        let tiles = TilePlanes::new([10.0, 10.0], 0.15, |at| Some(sample(at, 5.0)));
        assert_eq!(tiles.around([-3.0, 500.0]), tiles.around([5.0, 5.0]));
    }
}
