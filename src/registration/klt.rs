//! §4.1: the pyramidal Kanade–Lucas–Tomasi (KLT) tracker.
//!
//! The tracker estimates the translation of a window by Lucas and Kanade's method, as Bouguet describes it.
//! Gradients are those of the template and are computed once per level. From the coarsest level to the finest,
//! Newton steps are iterated to convergence.
//!
//! Known limits: the window only translates, and its brightness is assumed to be constant. A window across a depth
//! edge follows the side with more texture.

use super::RegistrationOptions;
use super::gradient::{SCHARR_SCALE, scharr};
use super::pyramid::{Pyramid, PyramidLevel};
use super::window::{Window, fraction_inside};
use crate::simd::{F32x8, LANES, multiversion};
use nalgebra::{Point2, Vector2};

/// Minimum of the smaller eigenvalue of a window's structure tensor, divided by the number of pixels in the window. A
/// window below this minimum has too little texture to be tracked. The unit is that of a squared gradient. Gradients
/// are in grey values (0 to 1) per pixel.
const MIN_EIGENVALUE: f64 = 2e-6;
/// Length of a Newton step below which tracking on a coarser level has converged, in pixels of the level. Only the
/// finest level determines the accuracy.
const COARSE_EPSILON_PX: f64 = 0.03;
/// Maximum ratio of a Newton step's length to the previous step's length at which the next step may be extrapolated.
/// The next step is then assumed to shrink by the same ratio, and is the last.
const MAX_RATIO: f64 = 0.5;
/// Maximum length of an extrapolated step, as a fraction of the step length below which tracking has converged
/// ([`KltParameters::epsilon_px`]).
const MAX_EXTRAPOLATED: f64 = 0.4;

/// Parameters of the KLT tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KltParameters {
    /// Half-width of the window, pixels.
    pub window_radius_px: usize,
    /// Maximum number of pyramid levels.
    pub levels: usize,
    /// Maximum number of Newton steps per level.
    pub iterations: usize,
    /// Length of a Newton step below which tracking on the finest level has converged, in pixels.
    pub epsilon_px: f64,
}

impl From<&RegistrationOptions> for KltParameters {
    fn from(options: &RegistrationOptions) -> Self {
        let &RegistrationOptions { window_radius_px, levels, .. } = options;
        Self { window_radius_px, levels, iterations: 20, epsilon_px: 0.003 }
    }
}

/// The result of tracking a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracked {
    /// Centre of the window in the target image, in pixels. It is inside the image.
    pub position: Point2<f64>,
    /// Mean absolute difference between the grey values (0 to 1) of the windows in the source and the target image.
    pub residual: f64,
}

/// The KLT tracker (§4.1), with buffers for one window. The buffers are reused from point to point.
///
/// Create one tracker per thread. Creating one per point would be slow.
pub struct Tracker {
    parameters: KltParameters,
    side: usize,
    /// Number of samples in a row of `dx` and `dy`, padded to a multiple of [`LANES`].
    row: usize,
    /// Number of samples in a row of `value`. The window in `value` is one sample wider on every side than in `dx`
    /// and `dy`.
    wide: usize,
    /// Grey values of the template, which is the window in the source image.
    value: Vec<f32>,
    /// Derivatives of the template by x. Each is weighted by the fraction of the sample that is inside the image.
    dx: Vec<f32>,
    /// Derivatives of the template by y. Each is weighted by the fraction of the sample that is inside the image.
    dy: Vec<f32>,
    /// Structure tensor of the template: xx, xy, yy.
    tensor: [f64; 3],
    /// Σ I·∇I over the window, with I the template's values. A Newton step is computed from the difference between
    /// Σ J·∇I, with J the target's values, and Σ I·∇I.
    value_gradient: [f64; 2],
}

multiversion! {
    fn track(
        tracker: &mut Tracker,
        source: &Pyramid,
        target: &Pyramid,
        from: Point2<f64>,
        guess: Point2<f64>,
    ) -> Option<Tracked> = track_by::<V>
}

#[inline(always)]
fn track_by<V: F32x8>(
    tracker: &mut Tracker,
    source: &Pyramid,
    target: &Pyramid,
    from: Point2<f64>,
    guess: Point2<f64>,
) -> Option<Tracked> {
    let available = source.levels.len().min(target.levels.len());
    let levels = tracker.parameters.levels.clamp(1, available);
    let mut flow = (guess - from) / f64::from(1_u32 << (levels - 1));
    let mut residual = 0.0;
    for k in (0..levels).rev() {
        let scale = f64::from(1_u32 << k);
        // A pixel of a level has the same centre as every second pixel of the next finer level. Positions relative
        // to the centre of the first pixel are therefore only scaled.
        let p = (from.coords - Vector2::repeat(0.5)) / scale;
        let (level, other) = (&source.levels[k], &target.levels[k]);
        tracker.load_template::<V>(level, &p);
        let epsilon_px = if k > 0 { COARSE_EPSILON_PX } else { 0.0 };
        let epsilon_px = tracker.parameters.epsilon_px.max(epsilon_px);
        let converged = tracker.iterate::<V>(other, &p, flow, epsilon_px);
        if k > 0 {
            // On a coarse level, a window may have no texture or leave the image, although it can be tracked on the
            // finest level.
            flow = 2.0 * converged.unwrap_or(flow);
        } else {
            flow = converged?;
            residual = tracker.residual::<V>(other, &(p + flow))?;
        }
    }
    let position = from + flow;
    let inside = position.x >= 0.0
        && position.y >= 0.0
        && position.x <= target.width() as f64
        && position.y <= target.height() as f64;
    inside.then_some(Tracked { position, residual })
}

impl Tracker {
    /// Creates a tracker for square windows with sides of `2·window_radius_px + 1` pixels.
    pub fn new(parameters: impl Into<KltParameters>) -> Self {
        let parameters = parameters.into();
        let side = 2 * parameters.window_radius_px + 1;
        let (row, wide) = (side.next_multiple_of(LANES), (side + 2).next_multiple_of(LANES));
        let value = vec![0.0; wide * (side + 2) + LANES];
        let [dx, dy] = [vec![0.0; row * side], vec![0.0; row * side]];
        let (tensor, value_gradient) = ([0.0; 3], [0.0; 2]);
        Self { parameters, side, row, wide, value, dx, dy, tensor, value_gradient }
    }

    /// Tracks the window around `from` in the source image to the target image, starting at `guess`. Positions are
    /// in pixels, with the centre of the top-left pixel at (0.5, 0.5).
    ///
    /// Returns `None` if the window has too little texture or leaves the image. Both pyramids need a padding of
    /// [`RegistrationOptions::pad_px`]. [`KltParameters::levels`] is clamped between 1 and the pyramids' number of
    /// levels.
    pub fn track(
        &mut self,
        source: &Pyramid,
        target: &Pyramid,
        from: Point2<f64>,
        guess: Point2<f64>,
    ) -> Option<Tracked> {
        track(self, source, target, from, guess)
    }

    /// Reads the template around `p`, and computes its derivatives and sums. `p` is in pixels of the level, with
    /// the centre of the first pixel at (0, 0).
    #[inline(always)]
    fn load_template<V: F32x8>(&mut self, level: &PyramidLevel, p: &Vector2<f64>) {
        let (side, row, wide) = (self.side, self.row, self.wide);
        // For a window outside the image, the sums are set to 0. `iterate` treats them as too little texture.
        let radius = self.parameters.window_radius_px + 1;
        let Some(window) = Window::around(level, p, radius, [wide, side + 2]) else {
            (self.tensor, self.value_gradient) = ([0.0; 3], [0.0; 2]);
            return;
        };
        for x in (0..wide).step_by(LANES) {
            let mut columns = window.columns::<V, 1>(x);
            for y in 0..side + 2 {
                columns.row()[0].store(&mut self.value, y * wide + x);
            }
        }
        let [left, top] = [p.x, p.y].map(|v| v - self.parameters.window_radius_px as f64);
        let is_inside = |from: f64, size: usize| from >= 0.0 && from + side as f64 <= size as f64;
        let whole = is_inside(left, level.width) && is_inside(top, level.height);
        let mut sums = [V::zero(); 5];
        for x in (0..row).step_by(LANES) {
            let mut weights = [0.0; LANES];
            for (l, weight) in weights.iter_mut().enumerate().take(side - x) {
                let inside = |v: f64| fraction_inside(v, level.width);
                *weight = if whole { 1.0 } else { inside(left + (x + l) as f64) } / SCHARR_SCALE;
            }
            let weights = V::from_array(&weights);
            for y in 0..side {
                let inside = |v: f64| V::splat(fraction_inside(v, level.height));
                let used = if whole { weights } else { weights * inside(top + y as f64) };
                let at = (y + 1) * wide + x + 1;
                let [gx, gy] = scharr::<V>(&self.value, at, wide);
                let (gx, gy) = (gx * used, gy * used);
                gx.store(&mut self.dx, y * row + x);
                gy.store(&mut self.dy, y * row + x);
                let value = V::load(&self.value, at);
                sums[0] = gx.mul_add(gx, sums[0]);
                sums[1] = gx.mul_add(gy, sums[1]);
                sums[2] = gy.mul_add(gy, sums[2]);
                sums[3] = gx.mul_add(value, sums[3]);
                sums[4] = gy.mul_add(value, sums[4]);
            }
        }
        let [xx, xy, yy, x, y] = V::sums(&sums);
        (self.tensor, self.value_gradient) = ([xx, xy, yy], [x, y]);
    }

    /// Returns the displacement, in pixels of the level, of the window whose template is centred at `p`. Newton steps
    /// start at the displacement `flow` and end when a step is shorter than `epsilon_px`, or after
    /// [`KltParameters::iterations`] steps. Returns `None` if the template has too little texture, or if the window
    /// leaves the image.
    #[inline(always)]
    fn iterate<V: F32x8>(
        &self,
        target: &PyramidLevel,
        p: &Vector2<f64>,
        mut flow: Vector2<f64>,
        epsilon_px: f64,
    ) -> Option<Vector2<f64>> {
        let [xx, xy, yy] = self.tensor;
        let area = (self.side * self.side) as f64;
        let smaller = 0.5 * ((xx + yy) - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt());
        let determinant = xx * yy - xy * xy;
        // The determinant is a divisor below. It is positive if the smaller eigenvalue is, up to rounding.
        if !(smaller >= MIN_EIGENVALUE * area && determinant > 0.0) {
            return None;
        }
        let [ixx, ixy, iyy] = [yy, -xy, xx].map(|v| v / determinant);
        let mut previous = Vector2::zeros();
        for step in 0..self.parameters.iterations {
            let [x, y] = self.correlate::<V>(target, &(p + flow))?;
            let (bx, by) = (self.value_gradient[0] - x, self.value_gradient[1] - y);
            let delta = Vector2::new(ixx * bx + ixy * by, ixy * bx + iyy * by);
            flow += delta;
            let length_px = delta.norm();
            if length_px < epsilon_px {
                break;
            }
            if step > 0 {
                // Successive steps cross the solution in opposite directions. The solution is in the middle between
                // them.
                if (delta + previous).norm() < epsilon_px {
                    flow -= 0.5 * delta;
                    break;
                }
                // If steps shrink by a constant ratio, the remaining steps are a geometric series. Its first term
                // is added.
                let ratio = length_px / previous.norm();
                if ratio < MAX_RATIO && length_px * ratio < MAX_EXTRAPOLATED * epsilon_px {
                    flow += delta * (delta.dot(&previous).signum() * ratio);
                    break;
                }
            }
            previous = delta;
        }
        Some(flow)
    }

    /// Returns the two components of Σ J·∇I over the window. J are the target's values around `q`, and ∇I is the
    /// template's gradient. Returns `None` if `q` is more than a pixel outside the image.
    #[inline(always)]
    fn correlate<V: F32x8>(&self, target: &PyramidLevel, q: &Vector2<f64>) -> Option<[f64; 2]> {
        let size = [self.row, self.side];
        let window = Window::around(target, q, self.parameters.window_radius_px, size)?;
        let mut sums = [V::zero(); 2];
        let mut x = 0;
        // Where possible, sixteen columns are processed at once, so that two sums are computed in parallel.
        while x + 2 * LANES <= self.row {
            self.correlate_columns::<V, 2>(&window, x, &mut sums);
            x += 2 * LANES;
        }
        if x < self.row {
            self.correlate_columns::<V, 1>(&window, x, &mut sums);
        }
        Some(V::sums(&sums))
    }

    /// Adds the contribution of 8·B columns, starting at column `x`, to the two components of Σ J·∇I in `sums`.
    #[inline(always)]
    fn correlate_columns<V: F32x8, const B: usize>(
        &self,
        window: &Window,
        x: usize,
        sums: &mut [V; 2],
    ) {
        let size = self.row * self.side;
        assert!(self.dx.len() == size && self.dy.len() == size && x + B * LANES <= self.row);
        let mut columns = window.columns::<V, B>(x);
        let mut of_block = [[V::zero(); 2]; B];
        for y in 0..self.side {
            let values = columns.row();
            for b in 0..B {
                let at = y * self.row + x + b * LANES;
                // SAFETY: the length of a row is a multiple of LANES, and both planes have `side` rows.
                let [gx, gy] =
                    unsafe { [V::load_unchecked(&self.dx, at), V::load_unchecked(&self.dy, at)] };
                of_block[b][0] = values[b].mul_add(gx, of_block[b][0]);
                of_block[b][1] = values[b].mul_add(gy, of_block[b][1]);
            }
        }
        for [x, y] in of_block {
            *sums = [sums[0] + x, sums[1] + y];
        }
    }

    /// Returns the mean absolute difference between the template and the target's window around `q`. Returns `None`
    /// if `q` is more than a pixel outside the image.
    #[inline(always)]
    fn residual<V: F32x8>(&self, target: &PyramidLevel, q: &Vector2<f64>) -> Option<f64> {
        let size = [self.row, self.side];
        let window = Window::around(target, q, self.parameters.window_radius_px, size)?;
        let mut sum = V::zero();
        for x in (0..self.row).step_by(LANES) {
            let mut weights = [0.0; LANES];
            weights[..(self.side - x).min(LANES)].fill(1.0);
            let weights = V::from_array(&weights);
            let mut columns = window.columns::<V, 1>(x);
            for y in 0..self.side {
                let own = V::load(&self.value, (y + 1) * self.wide + x + 1);
                sum = (columns.row()[0] - own).abs().mul_add(weights, sum);
            }
        }
        Some(sum.sum() / (self.side * self.side) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;
    use crate::simd::Scalar;

    /// Renders a smooth texture, shifted by (`dx`, `dy`) pixels.
    fn texture(w: usize, h: usize, dx: f64, dy: f64) -> Image {
        let data = (0..w * h)
            .map(|k| {
                let (x, y) = ((k % w) as f64 - dx, (k / w) as f64 - dy);
                let v = (x * 0.31 + (y * 0.17).sin()).sin() * (y * 0.27 + (x * 0.11).cos()).cos()
                    + 0.5 * (x * 0.07 - y * 0.09).sin();
                (0.5 + 0.3 * v) as f32
            })
            .collect();
        Image::from_data(w, h, 1, data)
    }

    fn pyramids(options: &RegistrationOptions, dx: f64, dy: f64) -> (Pyramid, Pyramid) {
        let make = |i: &Image| Pyramid::new(i, options.levels, options.pad_px());
        (make(&texture(160, 120, 0.0, 0.0)), make(&texture(160, 120, dx, dy)))
    }

    #[test]
    fn known_shifts_are_found() {
        let options = RegistrationOptions::default();
        for (dx, dy) in [(0.0, 0.0), (0.25, -0.4), (3.3, 1.7), (-9.6, 7.2)] {
            let (a, b) = pyramids(&options, dx, dy);
            let mut tracker = Tracker::new(&options);
            for (x, y) in [(50.0, 50.0), (80.25, 60.75), (110.0, 70.0)] {
                let from = Point2::new(x, y);
                let found = tracker.track(&a, &b, from, from).unwrap();
                let error = (found.position - from - Vector2::new(dx, dy)).norm();
                assert!(error < 0.02, "{dx} {dy}: {error}");
            }
        }
    }

    #[test]
    fn a_guess_reaches_what_the_pyramid_cannot() {
        let options = RegistrationOptions { levels: 1, ..Default::default() };
        let (a, b) = pyramids(&options, 30.0, 0.0);
        let mut tracker = Tracker::new(&options);
        let from = Point2::new(60.0, 60.0);
        let found = tracker.track(&a, &b, from, Point2::new(88.5, 60.5)).unwrap();
        assert!((found.position - Point2::new(90.0, 60.0)).norm() < 0.02);
    }

    #[test]
    fn windows_that_leave_the_image_or_have_no_texture_are_lost() {
        let options = RegistrationOptions::default();
        let (a, b) = pyramids(&options, -20.0, 0.0);
        let mut tracker = Tracker::new(&options);
        let from = Point2::new(3.0, 60.0);
        assert_eq!(tracker.track(&a, &b, from, from - Vector2::new(20.0, 0.0)), None);
        let flat = Pyramid::new(&Image::filled(160, 120, 1, 0.5), 4, options.pad_px());
        assert_eq!(tracker.track(&flat, &flat, Point2::new(80.0, 60.0), from), None);
    }

    #[test]
    fn tiny_images_do_not_panic() {
        let options = RegistrationOptions::default();
        for (w, h) in [(1, 1), (2, 9), (9, 2)] {
            let p = Pyramid::new(&texture(w, h, 0.0, 0.0), 4, options.pad_px());
            let mut tracker = Tracker::new(&options);
            for at in [Point2::new(0.0, 0.0), Point2::new(w as f64, h as f64)] {
                let _ = tracker.track(&p, &p, at, at);
            }
        }
    }

    /// Compares the tracker's sums over a window with those of a simple implementation in f64.
    #[test]
    fn sums_agree_with_a_naive_reference() {
        let options = RegistrationOptions::default();
        let (a, b) = pyramids(&options, 0.4, -0.3);
        let (level, other) = (&a.levels[0], &b.levels[0]);
        let at =
            |l: &PyramidLevel, x: f64, y: f64| f64::from(l.value[l.index(x as isize, y as isize)]);
        let sample = |l: &PyramidLevel, x: f64, y: f64| {
            let (x0, y0) = (x.floor(), y.floor());
            let (fx, fy) = (x - x0, y - y0);
            (1.0 - fy) * ((1.0 - fx) * at(l, x0, y0) + fx * at(l, x0 + 1.0, y0))
                + fy * ((1.0 - fx) * at(l, x0, y0 + 1.0) + fx * at(l, x0 + 1.0, y0 + 1.0))
        };
        let slope = |x: f64, y: f64, (ax, ay): (f64, f64)| -> f64 {
            let side = |k: f64| {
                let (x, y) = (x + k * ay, y + k * ax);
                sample(level, x + ax, y + ay) - sample(level, x - ax, y - ay)
            };
            (3.0 * side(-1.0) + 10.0 * side(0.0) + 3.0 * side(1.0)) / 32.0
        };
        let mut tracker = Tracker::new(&options);
        for (px, py) in [(70.3, 40.8), (0.1, 0.2), (159.4, 119.3)] {
            let (p, q) = (Vector2::new(px, py), Vector2::new(px - 0.3, py + 0.2));
            tracker.load_template::<Scalar>(level, &p);
            let sums = tracker.correlate::<Scalar>(other, &q).unwrap();
            let b = [0, 1].map(|k| sums[k] - tracker.value_gradient[k]);
            let mut expected = [0.0; 5];
            let r = options.window_radius_px as i32;
            for y in -r..=r {
                for x in -r..=r {
                    let (x, y) = (f64::from(x), f64::from(y));
                    let inside = |v: f64, size: f64| {
                        if v < 0.0 { v + 1.0 } else { size - v }.clamp(0.0, 1.0)
                    };
                    let inside = inside(p.x + x, 160.0) * inside(p.y + y, 120.0);
                    let gx = inside * slope(p.x + x, p.y + y, (1.0, 0.0));
                    let gy = inside * slope(p.x + x, p.y + y, (0.0, 1.0));
                    let d = sample(other, q.x + x, q.y + y) - sample(level, p.x + x, p.y + y);
                    for (sum, v) in
                        expected.iter_mut().zip([gx * gx, gx * gy, gy * gy, d * gx, d * gy])
                    {
                        *sum += v;
                    }
                }
            }
            for (got, want) in tracker.tensor.iter().chain(&b).zip(expected) {
                assert!((got - want).abs() < 1e-5 * (1.0 + want.abs()), "{got} {want}");
            }
        }
    }
}
