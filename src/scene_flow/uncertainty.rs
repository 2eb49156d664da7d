//! Standard errors of the disparity and velocity of surface elements. They come from the covariance of the Gauss–Newton
//! estimate, as in bundle adjustment: from the image gradients and the residuals of an element's patch.

use super::element::ElementErrors;
use super::map::ElementMap;
use super::matching::PatchMatcher;
use super::observing_frame::ObservingFrame;
use super::patch::Patch;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Standard deviation of a brightness residual per unit of matching cost.
const RESIDUAL_BY_COST: f64 = 1.0;
/// Standard deviation of a brightness residual if images match exactly, due to 8-bit rounding and interpolation.
const MIN_RESIDUAL: f64 = 0.004;
/// Assumed fraction of the observing frames that see a surface element.
const VISIBLE_FRACTION: f64 = 0.55;
/// Maximum time to a frame whose gradients count, in frame periods of the reference camera. An element's motion is constant for
/// a few frames only: one that is seen at rest minutes later isn't known to have stood still. Larger: standard errors of
/// velocities are too small if a camera has few frames. Smaller: those of cameras with low rates are too large.
const MAX_INFORMING_DT: f32 = 3.0;
/// Standard errors of a surface element without any image gradient: of the disparity, pixels, and of each component
/// of the velocity, pixels per frame.
const PRIOR_PX: [f64; 2] = [4.0, 8.0];
/// Factors by which the standard errors of disparity and velocity from the covariance are multiplied. They correct for
/// the correlation between residuals of neighbouring pixels, and for the information that smoothness adds. Those of
/// finished maps are then scaled by how much the maps differ (`variance_factor.rs`).
const SCALE: [f64; 2] = [0.6, 0.4];
/// Standard errors of a surface element without any image gradient.
pub const PRIOR_ERRORS: ElementErrors = ElementErrors {
    disparity_px: (SCALE[0] * PRIOR_PX[0]) as f32,
    velocity_px: (SCALE[1] * PRIOR_PX[1]) as f32,
};
/// Standard error of the velocity due to acceleration, as a multiple of the acceleration; in frame periods. It is
/// needed since real paths are not parabolas.
const BY_ACCELERATION: f32 = 0.05;

impl PatchMatcher<'_> {
    /// Returns the standard errors of all surface elements of a scene flow map of this pyramid level, row by row; 0 for
    /// elements that are given.
    pub fn errors(&self, map: &ElementMap) -> Vec<ElementErrors> {
        self.errors_by_block(map, 1, &|_| true)
    }

    /// Returns [`Self::errors`] from the image gradients at `used` pixels alone, which are given by their indices. Each
    /// block of `side`×`side` pixels has the standard errors of its top-left pixel.
    pub fn errors_by_block(
        &self,
        map: &ElementMap,
        side: usize,
        used: &(dyn Fn(usize) -> bool + Sync),
    ) -> Vec<ElementErrors> {
        let width = map.width;
        let rows = |v: usize| {
            let mut patch = Patch::empty();
            let columns = (0..width).step_by(side);
            let row: Vec<ElementErrors> =
                columns.map(|x| self.errors_at(map, (x, v * side), &mut patch, used)).collect();
            let height = side.min(map.height - v * side);
            (0..width * height).map(move |k| row[k % width / side])
        };
        (0..map.height.div_ceil(side)).into_par_iter().flat_map_iter(rows).collect()
    }

    /// Returns the information matrix (inverse covariance) of a surface element's disparity and velocity at a pixel of
    /// the pyramid level, from image gradients and residuals. Units are pixels of the full-resolution image. `patch` is
    /// a reusable buffer.
    pub fn information(
        &self,
        map: &ElementMap,
        (x, y): (usize, usize),
        patch: &mut Patch,
    ) -> Matrix3<f64> {
        self.information_of(map, (x, y), patch, &|_| true)
    }

    /// Returns the [`Self::information`] from the gradients of `used` pixels alone.
    fn information_of(
        &self,
        map: &ElementMap,
        (x, y): (usize, usize),
        patch: &mut Patch,
        used: &dyn Fn(usize) -> bool,
    ) -> Matrix3<f64> {
        self.fill_patch(x, y, patch);
        let index = |dx: f32, dy: f32| {
            let (u, v) = (x as isize + dx as isize, y as isize + dy as isize);
            v as usize * map.width + u as usize
        };
        let [xx, xy, yy] = patch.structure(|dx, dy| used(index(dx, dy))).map(f64::from);
        let k = y * map.width + x;
        let (element, center) = (&map.elements[k], map.center(k));
        let scale = f64::from(self.scale);
        let by_depth = scale * f64::from(self.disparity_px);
        let mut information = Matrix3::<f64>::zeros();
        let is_near = |o: &&ObservingFrame| o.time.frames().abs() <= MAX_INFORMING_DT;
        for o in self.observations.frames.iter().filter(is_near) {
            let [x, y] = center;
            let dt = o.time.of_element(element, (x, y), &o.projection);
            let [mx, my, q] = element.moved(x, y, dt);
            let [u, v, _] = o.projection.project(mx, my, q);
            let image = &o.levels[self.level];
            let [width, height] = [image.width, image.height].map(|s| s as f32 * self.scale);
            let is_inside = u > 0.0 && v > 0.0 && u < width && v < height;
            let pixel = [u, v].map(|at| (at / self.scale) as usize);
            if !is_inside || !image.films_pixel(pixel[0], pixel[1]) {
                continue;
            }
            let [a, b] = self.by_inverse_depth(element, center, o).map(|d| f64::from(d) / by_depth);
            let dt = f64::from(dt) / scale;
            // The derivatives of the position in the observing frame by the disparity and by the two components of
            // the velocity.
            let columns = [[a, b], [dt, 0.0], [0.0, dt]];
            for (i, [a, b]) in columns.into_iter().enumerate() {
                for (j, [c, d]) in columns.into_iter().enumerate() {
                    information[(i, j)] += a * c * xx + (a * d + b * c) * xy + b * d * yy;
                }
            }
        }
        let residual = MIN_RESIDUAL + RESIDUAL_BY_COST * f64::from(map.costs[k]);
        information * (VISIBLE_FRACTION / (residual * residual))
    }

    fn errors_at(
        &self,
        map: &ElementMap,
        (x, y): (usize, usize),
        patch: &mut Patch,
        used: &dyn Fn(usize) -> bool,
    ) -> ElementErrors {
        let k = y * map.width + x;
        let element = &map.elements[k];
        if map.is_given(k) {
            return ElementErrors::default();
        }
        let mut information = self.information_of(map, (x, y), patch, used);
        let [disparity, velocity] = PRIOR_PX.map(|e| 1.0 / (e * e));
        // The prior makes the matrix positive definite.
        information += Matrix3::from_diagonal(&Vector3::new(disparity, velocity, velocity));
        let Some(covariance) = information.try_inverse() else { return PRIOR_ERRORS };
        let [u, v, uv] = [covariance[(1, 1)], covariance[(2, 2)], covariance[(1, 2)]];
        let larger = 0.5 * (u + v) + (0.25 * (u - v) * (u - v) + uv * uv).sqrt();
        // Variances are positive except for rounding errors.
        let [disparity_px, velocity_px] = [(SCALE[0], covariance[(0, 0)]), (SCALE[1], larger)]
            .map(|(scale, variance)| (scale * variance.max(0.0).sqrt()) as f32);
        let [a, b] = element.acceleration.map(|a| BY_ACCELERATION * a);
        // Accelerations are bounded, so their squares don't overflow.
        let velocity_px = (velocity_px * velocity_px + a * a + b * b).sqrt();
        ElementErrors { disparity_px, velocity_px }
    }
}
