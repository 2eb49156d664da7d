//! One Gauss–Newton step on the depth and motion of a surface element, from the image gradients of all frames that see
//! the element.

use super::element::Element;
use super::matching::{MatchedElement, PatchMatcher};
use super::observing_frame::ObservingFrame;
use nalgebra::{Matrix6, Vector6};

/// Weight of the prior of a Gauss–Newton step. It is a fraction of the weight that a patch has in the normal equations
/// if its brightness gradients are all 1 per pixel. The prior damps the step, and pulls the acceleration and the
/// inverse depth's rate of change towards 0.
const PRIOR: f64 = 1e-6;
/// Weight with which a Gauss–Newton step damps the inverse depth's rate of change, as a multiple of the weight with
/// which it damps the inverse depth.
const RATE_STIFFNESS: f64 = 16.0;
/// Weight with which the inverse depth's rate of change is pulled towards 0, as a multiple of the weight with which
/// this rate is damped. For the acceleration, this multiple is 1.
const RATE_PULL: f64 = 10.0;
/// Maximum change of the disparity, pixels, and of the velocity, pixels per frame, in one Gauss–Newton step. A larger
/// step is scaled down. Pixels are those of the pyramid level.
const MAX_STEP_PX: f32 = 3.0;
/// Maximum magnitude of each component of the acceleration, pixels per squared frame.
const MAX_ACCELERATION: f32 = 40.0;
/// Maximum magnitude of the inverse depth's rate of change, pixels of disparity per frame.
const MAX_RATE_PX: f32 = 12.0;
/// Step of the finite difference that gives the derivative of a position by the inverse depth, pixels of disparity.
const DISPARITY_STEP_PX: f32 = 1.0;

impl PatchMatcher<'_> {
    /// Returns the surface element after one Gauss–Newton step. `None` if the normal equations have no finite
    /// solution.
    pub fn step(&self, matched: &MatchedElement) -> Option<Element> {
        let &MatchedElement { element: e, pixel: (x, y), patch, cost, .. } = matched;
        let mut normal = Matrix6::<f64>::zeros();
        let mut gradient = Vector6::<f64>::zeros();
        let s = self.scale;
        let (px, py) = ((x as f32 + 0.5) * s, (y as f32 + 0.5) * s);
        // Frames with a much larger cost see another surface. They are left out.
        let max_cost = 2.0 * cost + 0.02;
        self.for_each_gradient(matched, max_cost, |o, [xx, xy, yy], [rx, ry]| {
            // With rolling shutters, a change of the unknowns also changes the row, and so the time. This effect is
            // neglected.
            let dt = o.time.of_element(e, (px, py), &o.projection);
            let by_depth = self.by_inverse_depth(e, [px, py], o).map(|d| d / s);
            let (by_velocity, by_acceleration) = (dt / s, 0.5 * dt * dt / s);
            // The Jacobian: the derivatives of the position in the observing frame, pixels of the level, by each
            // unknown.
            let columns = [
                by_depth,
                [by_velocity, 0.0],
                [0.0, by_velocity],
                by_depth.map(|d| d * dt),
                [by_acceleration, 0.0],
                [0.0, by_acceleration],
            ];
            for (i, [a, b]) in columns.into_iter().enumerate() {
                gradient[i] += f64::from(a * rx + b * ry);
                for (j, [c, d]) in columns.into_iter().enumerate().take(i + 1) {
                    normal[(i, j)] += f64::from(a * c * xx + (a * d + b * c) * xy + b * d * yy);
                }
            }
        });
        self.add_prior(e, patch.weight(), &mut normal, &mut gradient);
        // The prior makes the matrix positive definite. Cholesky reads only its lower half.
        let step = normal.cholesky()?.solve(&-gradient);
        let step: [f32; 6] = std::array::from_fn(|i| step[i] as f32);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        let length = step[1].hypot(step[2]).max(step[0].abs() * self.disparity_px);
        let k = (MAX_STEP_PX * s / length.max(f32::MIN_POSITIVE)).min(1.0);
        let max_rate = MAX_RATE_PX / self.disparity_px;
        let clamped = |v: f32, max: f32| v.clamp(-max, max);
        Some(Element {
            inverse_depth: e.inverse_depth + k * step[0],
            velocity: [e.velocity[0] + k * step[1], e.velocity[1] + k * step[2]],
            inverse_depth_rate: clamped(e.inverse_depth_rate + k * step[3], max_rate),
            acceleration: [
                clamped(e.acceleration[0] + k * step[4], MAX_ACCELERATION),
                clamped(e.acceleration[1] + k * step[5], MAX_ACCELERATION),
            ],
            ..*e
        })
    }

    /// Returns the derivative of a surface element's position in an observing frame, pixels, by the element's inverse
    /// depth, 1/m. `[x, y]` is the element's pixel in the full-resolution image.
    #[inline(always)]
    pub fn by_inverse_depth(&self, e: &Element, [x, y]: [f32; 2], o: &ObservingFrame) -> [f32; 2] {
        let [mx, my, q] = e.moved(x, y, o.time.of_element(e, (x, y), &o.projection));
        let step = DISPARITY_STEP_PX / self.disparity_px;
        let [u, v, _] = o.projection.project(mx, my, q);
        let [u1, v1, _] = o.projection.project(mx, my, q + step);
        [(u1 - u) / step, (v1 - v) / step]
    }

    /// Adds the prior to the normal equations: damping of all unknowns, and terms that pull the inverse depth's rate of
    /// change and the acceleration towards 0.
    fn add_prior(
        &self,
        e: &Element,
        patch_weight: f32,
        normal: &mut Matrix6<f64>,
        gradient: &mut Vector6<f64>,
    ) {
        let s = self.scale;
        let weight = PRIOR * f64::from(patch_weight);
        let depth = (f64::from(self.disparity_px / s)).powi(2);
        let motion = f64::from(1.0 / s).powi(2);
        let prior = [depth, motion, motion, RATE_STIFFNESS * depth, motion, motion];
        for (i, p) in prior.into_iter().enumerate() {
            normal[(i, i)] += weight * p;
        }
        let pulled = [
            (3, RATE_PULL, e.inverse_depth_rate),
            (4, 1.0, e.acceleration[0]),
            (5, 1.0, e.acceleration[1]),
        ];
        for (i, pull, value) in pulled {
            normal[(i, i)] += pull * weight * prior[i];
            gradient[i] += pull * weight * prior[i] * f64::from(value);
        }
    }
}
