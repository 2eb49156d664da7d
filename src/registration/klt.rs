//! §4.1: the pyramidal Kanade–Lucas–Tomasi tracker.
//!
//! Lucas and Kanade's translation of a window, with the template's gradients (computed once a
//! level), iterated to convergence from the coarsest level down (Bouguet's description).
//!
//! Known limits: pure translation, no gain change; windows that straddle a depth edge follow
//! whichever side has more texture.

use super::affine::{AffineOptions, Refiner};
#[cfg(target_arch = "x86_64")]
use super::lanes::Avx2;
use super::lanes::{LANES, Plain, Vector, Window};
use super::pyramid::{Level, Pyramid};
use nalgebra::{Point2, Vector2};
use serde::{Deserialize, Serialize};

/// How windows are tracked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KltOptions {
    /// Half the side of the window, pixels. Larger: steadier, but blends the motions on both
    /// sides of an edge; smaller: noisier.
    pub radius_px: usize,
    /// Pyramid levels at most. More reach larger motion, and confuse small things with their
    /// surroundings.
    pub levels: usize,
    /// Iterations a level at most.
    pub iterations: usize,
    /// A level has converged when a step is below this, pixels.
    pub epsilon_px: f64,
    /// Least eigenvalue of the window's structure tensor, per pixel, values 0..=1. Smaller: tracks
    /// that slide along edges; larger: faint texture is lost.
    pub min_eigenvalue: f64,
    /// Largest mean absolute difference of the two windows, values 0..=1.
    pub max_residual: f64,
    /// The last step, that allows the window to deform; off unless asked for (`radius_px`). Inside
    /// turning bodies it halves the error, but its larger window crosses outlines: on the magazine
    /// film at 320×240 offsets, synchronized images and views all come out slightly worse with it.
    pub affine: AffineOptions,
}

impl Default for KltOptions {
    fn default() -> Self {
        Self {
            radius_px: 5,
            levels: 4,
            iterations: 20,
            epsilon_px: 0.003,
            min_eigenvalue: 2e-6,
            max_residual: 0.06,
            affine: AffineOptions { radius_px: 0, ..AffineOptions::default() },
        }
    }
}

impl KltOptions {
    /// The border that a pyramid needs for these windows.
    pub fn pad_px(&self) -> usize {
        (self.radius_px + LANES + 3).max(self.affine.pad_px())
    }
}

/// Where a window was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracked {
    pub position: Point2<f64>,
    /// Mean absolute difference of the two windows, values 0..=1.
    pub residual: f64,
}

/// Buffers of one window, reused from point to point.
pub struct Tracker<'a> {
    options: &'a KltOptions,
    side: usize,
    row: usize,
    value: Vec<f32>,
    dx: Vec<f32>,
    dy: Vec<f32>,
    refiner: Refiner,
}

/// What is to be tracked where.
struct Job<'a> {
    source: &'a Pyramid,
    target: &'a Pyramid,
    from: Point2<f64>,
    guess: Point2<f64>,
    levels: usize,
    refine: bool,
}

impl<'a> Tracker<'a> {
    pub fn new(options: &'a KltOptions) -> Self {
        let side = 2 * options.radius_px + 1;
        let row = side.next_multiple_of(LANES);
        let zeros = vec![0.0; row * side];
        let refiner = Refiner::new(&options.affine);
        Self { options, side, row, value: zeros.clone(), dx: zeros.clone(), dy: zeros, refiner }
    }

    /// Finds the window around `from` in another image, starting at `guess`. Pixels, both.
    ///
    /// `None` if the window has too little texture, leaves the image, or differs too much where
    /// it ends up.
    pub fn track(
        &mut self,
        source: &Pyramid,
        target: &Pyramid,
        from: Point2<f64>,
        guess: Point2<f64>,
    ) -> Option<Tracked> {
        let (levels, refine) = (self.options.levels, self.options.affine.radius_px > 0);
        self.find(&Job { source, target, from, guess, levels, refine })
    }

    /// As [`Self::track`], on so many of the finest levels only, for a guess that is near, and
    /// without the refinement.
    pub fn track_levels(
        &mut self,
        source: &Pyramid,
        target: &Pyramid,
        from: Point2<f64>,
        guess: Point2<f64>,
        levels: usize,
    ) -> Option<Tracked> {
        self.find(&Job { source, target, from, guess, levels, refine: false })
    }

    fn find(&mut self, job: &Job) -> Option<Tracked> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the feature.
            return unsafe { self.find_avx2(job) };
        }
        self.find_by::<Plain>(job)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn find_avx2(&mut self, job: &Job) -> Option<Tracked> {
        self.find_by::<Avx2>(job)
    }

    #[inline(always)]
    fn find_by<V: Vector>(&mut self, job: &Job) -> Option<Tracked> {
        let &Job { source, target, from, guess, .. } = job;
        let levels = job.levels.min(source.levels().len()).min(target.levels().len()).max(1);
        let mut flow = (guess - from) / f64::from(1_u32 << (levels - 1));
        let mut residual = 0.0;
        for k in (0..levels).rev() {
            let scale = f64::from(1_u32 << k);
            // Levels are centred on even pixels, so positions relative to pixel centres scale.
            let p = (from.coords - Vector2::repeat(0.5)) / scale;
            let (level, other) = (&source.levels()[k], &target.levels()[k]);
            let tensor = self.take_template::<V>(level, &p);
            match self.iterate::<V>(other, &p, &mut flow, tensor) {
                Outcome::Converged => {}
                // A coarse window may be blank or half outside where the fine one is good.
                Outcome::Flat | Outcome::Outside if k > 0 => {}
                Outcome::Flat | Outcome::Outside => return None,
            }
            if k > 0 {
                flow *= 2.0;
            } else {
                residual = self.residual::<V>(other, &(p + flow))?;
            }
        }
        let mut position = from + flow;
        if job.refine && residual <= self.options.max_residual {
            let (level, other) = (&source.levels()[0], &target.levels()[0]);
            let refined =
                self.refiner.refine::<V>(level, other, from, position, &self.options.affine);
            position = refined.unwrap_or(position);
        }
        let inside = position.x >= 0.0
            && position.y >= 0.0
            && position.x <= target.width() as f64
            && position.y <= target.height() as f64;
        (inside && residual <= self.options.max_residual).then_some(Tracked { position, residual })
    }

    /// Cuts the template and its gradients out around `p` (relative to pixel centres); returns
    /// the structure tensor xx, xy, yy, summed.
    #[inline(always)]
    fn take_template<V: Vector>(&mut self, level: &Level, p: &Vector2<f64>) -> [f64; 3] {
        // Outside the padded border there is nothing to cut; the caller's points are in the image.
        let Some((base, weights)) = corner(level, p, self.options.radius_px) else {
            return [0.0; 3];
        };
        let weights = V::splats(weights);
        let mut sums = [V::zero(); 3];
        let windows = [
            Window::new(&level.value, base, level.stride, self.row, self.side),
            Window::new(&level.dx, base, level.stride, self.row, self.side),
            Window::new(&level.dy, base, level.stride, self.row, self.side),
        ];
        for y in 0..self.side {
            let out = y * self.row;
            let buffers = [&mut self.value, &mut self.dx, &mut self.dy];
            for (window, buffer) in windows.iter().zip(buffers) {
                for x in (0..self.row).step_by(LANES) {
                    window.bilinear(x, y, &weights).store(buffer, out + x);
                }
            }
            self.dx[out + self.side..out + self.row].fill(0.0);
            self.dy[out + self.side..out + self.row].fill(0.0);
            for x in (0..self.row).step_by(LANES) {
                let (gx, gy) = (V::load(&self.dx, out + x), V::load(&self.dy, out + x));
                sums[0] = sums[0].add(gx.mul(gx));
                sums[1] = sums[1].add(gx.mul(gy));
                sums[2] = sums[2].add(gy.mul(gy));
            }
        }
        V::sums(&sums)
    }

    /// Newton steps on one level.
    #[inline(always)]
    fn iterate<V: Vector>(
        &mut self,
        target: &Level,
        p: &Vector2<f64>,
        flow: &mut Vector2<f64>,
        [xx, xy, yy]: [f64; 3],
    ) -> Outcome {
        let area = (self.side * self.side) as f64;
        let smaller = 0.5 * ((xx + yy) - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt());
        let determinant = xx * yy - xy * xy;
        // λ_min bounds the determinant from below, so the division is safe.
        if !(smaller >= self.options.min_eigenvalue * area && determinant > 0.0) {
            return Outcome::Flat;
        }
        let start = *flow;
        let mut previous = Vector2::zeros();
        for step in 0..self.options.iterations {
            let Some((bx, by)) = self.mismatch::<V>(target, &(p + *flow)) else {
                *flow = start;
                return Outcome::Outside;
            };
            let delta = Vector2::new(xy * by - yy * bx, xy * bx - xx * by) / determinant;
            *flow += delta;
            if delta.norm() < self.options.epsilon_px {
                break;
            }
            // Swinging between two sides of the solution: it is in the middle.
            if step > 0 && (delta + previous).norm() < self.options.epsilon_px {
                *flow -= 0.5 * delta;
                break;
            }
            previous = delta;
        }
        Outcome::Converged
    }

    /// Σ (J − I)·∇I over the window, J cut out of the target around `q`.
    #[inline(always)]
    fn mismatch<V: Vector>(&self, target: &Level, q: &Vector2<f64>) -> Option<(f64, f64)> {
        let (base, weights) = corner(target, q, self.options.radius_px)?;
        let weights = V::splats(weights);
        let (mut sum_x, mut sum_y) = (V::zero(), V::zero());
        let window = Window::new(&target.value, base, target.stride, self.row, self.side);
        let size = self.row * self.side;
        assert!([&self.value, &self.dx, &self.dy].iter().all(|plane| plane.len() == size));
        for y in 0..self.side {
            let from = y * self.row;
            for x in (0..self.row).step_by(LANES) {
                // SAFETY: rows are whole lanes, and the planes have `side` of them.
                let [value, gx, gy] = unsafe {
                    [
                        V::load_unchecked(&self.value, from + x),
                        V::load_unchecked(&self.dx, from + x),
                        V::load_unchecked(&self.dy, from + x),
                    ]
                };
                let mismatch = window.bilinear(x, y, &weights).sub(value);
                sum_x = sum_x.add(mismatch.mul(gx));
                sum_y = sum_y.add(mismatch.mul(gy));
            }
        }
        Some((sum_x.sum(), sum_y.sum()))
    }

    /// Mean absolute difference of the windows.
    #[inline(always)]
    fn residual<V: Vector>(&self, target: &Level, q: &Vector2<f64>) -> Option<f64> {
        let (base, weights) = corner(target, q, self.options.radius_px)?;
        let weights = V::splats(weights);
        let window = Window::new(&target.value, base, target.stride, self.row, self.side);
        let mut sum = 0.0;
        for y in 0..self.side {
            for x in (0..self.row).step_by(LANES) {
                let found: V = window.bilinear(x, y, &weights);
                let differences = found.sub(V::load(&self.value, y * self.row + x)).abs();
                let used = (self.side - x).min(LANES);
                sum += differences.to_lanes()[..used].iter().sum::<f32>();
            }
        }
        Some(f64::from(sum) / (self.side * self.side) as f64)
    }
}

enum Outcome {
    Converged,
    Flat,
    Outside,
}

/// The padded index of a window's top-left sample and its four bilinear weights; `None` if the
/// window's middle is more than a pixel outside the image.
fn corner(level: &Level, p: &Vector2<f64>, radius: usize) -> Option<(usize, [f32; 4])> {
    let inside = |v: f64, size: usize| v >= -1.0 && v <= size as f64;
    if !(inside(p.x, level.width) && inside(p.y, level.height)) {
        return None;
    }
    let (x, y) = (p.x.floor(), p.y.floor());
    let (fx, fy) = ((p.x - x) as f32, (p.y - y) as f32);
    let base = level.index(x as isize - radius as isize, y as isize - radius as isize);
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    Some((base, weights))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;

    /// A smooth texture, shifted.
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

    fn pyramids(options: &KltOptions, dx: f64, dy: f64) -> (Pyramid, Pyramid) {
        let make = |i: &Image| Pyramid::new(i, options.levels, options.pad_px());
        (make(&texture(160, 120, 0.0, 0.0)), make(&texture(160, 120, dx, dy)))
    }

    #[test]
    fn known_shifts_are_found() {
        let options = KltOptions::default();
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
        let options = KltOptions { levels: 1, ..Default::default() };
        let (a, b) = pyramids(&options, 30.0, 0.0);
        let mut tracker = Tracker::new(&options);
        let from = Point2::new(60.0, 60.0);
        let found = tracker.track(&a, &b, from, Point2::new(88.5, 60.5)).unwrap();
        assert!((found.position - Point2::new(90.0, 60.0)).norm() < 0.02);
    }

    #[test]
    fn what_leaves_the_image_or_has_no_texture_is_lost() {
        let options = KltOptions::default();
        let (a, b) = pyramids(&options, -20.0, 0.0);
        let mut tracker = Tracker::new(&options);
        let from = Point2::new(3.0, 60.0);
        assert_eq!(tracker.track(&a, &b, from, from - Vector2::new(20.0, 0.0)), None);
        let flat = Pyramid::new(&Image::filled(160, 120, 1, 0.5), 4, options.pad_px());
        assert_eq!(tracker.track(&flat, &flat, Point2::new(80.0, 60.0), from), None);
    }

    #[test]
    fn tiny_images_are_no_trouble() {
        let options = KltOptions::default();
        for (w, h) in [(1, 1), (2, 9), (9, 2)] {
            let p = Pyramid::new(&texture(w, h, 0.0, 0.0), 4, options.pad_px());
            let mut tracker = Tracker::new(&options);
            for at in [Point2::new(0.0, 0.0), Point2::new(w as f64, h as f64)] {
                let _ = tracker.track(&p, &p, at, at);
            }
        }
    }

    /// The same sums written as simply as possible, in f64.
    #[test]
    fn sums_agree_with_a_naive_reference() {
        let options = KltOptions::default();
        let (a, b) = pyramids(&options, 0.4, -0.3);
        let (level, other) = (&a.levels()[0], &b.levels()[0]);
        let sample = |l: &Level, plane: &[f32], x: f64, y: f64| {
            let (x0, y0) = (x.floor(), y.floor());
            let at = |dx: isize, dy: isize| {
                f64::from(plane[l.index(x0 as isize + dx, y0 as isize + dy)])
            };
            let (fx, fy) = (x - x0, y - y0);
            (1.0 - fy) * ((1.0 - fx) * at(0, 0) + fx * at(1, 0))
                + fy * ((1.0 - fx) * at(0, 1) + fx * at(1, 1))
        };
        let mut tracker = Tracker::new(&options);
        for (px, py) in [(70.3, 40.8), (0.1, 0.2), (159.4, 119.3)] {
            let (p, q) = (Vector2::new(px, py), Vector2::new(px - 0.3, py + 0.2));
            let hessian = tracker.take_template::<Plain>(level, &p);
            let (bx, by) = tracker.mismatch::<Plain>(other, &q).unwrap();
            let mut expected = [0.0; 5];
            let r = options.radius_px as i32;
            for y in -r..=r {
                for x in -r..=r {
                    let (x, y) = (f64::from(x), f64::from(y));
                    let gx = sample(level, &level.dx, p.x + x, p.y + y);
                    let gy = sample(level, &level.dy, p.x + x, p.y + y);
                    let d = sample(other, &other.value, q.x + x, q.y + y)
                        - sample(level, &level.value, p.x + x, p.y + y);
                    for (sum, v) in
                        expected.iter_mut().zip([gx * gx, gx * gy, gy * gy, d * gx, d * gy])
                    {
                        *sum += v;
                    }
                }
            }
            for (got, want) in [hessian[0], hessian[1], hessian[2], bx, by].iter().zip(expected) {
                assert!((got - want).abs() < 1e-5 * (1.0 + want.abs()), "{got} {want}");
            }
        }
    }
}
