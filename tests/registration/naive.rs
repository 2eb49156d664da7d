//! Pyramidal Lucas–Kanade as simply as possible: f64, positions clamped into the image, sums over
//! all pixels of the window.

use nalgebra::{Matrix2, Point2, SMatrix, SVector, Vector2};
use stlfr::raster::Image;
use stlfr::registration::KltParameters;

/// A grey image in f64.
pub struct Plane {
    w: usize,
    h: usize,
    v: Vec<f64>,
}

impl Plane {
    pub fn new(image: &Image) -> Self {
        let gray = image.to_gray();
        let v = gray.data().iter().map(|v| f64::from(*v)).collect();
        Self { w: gray.width(), h: gray.height(), v }
    }

    fn at(&self, x: i64, y: i64) -> f64 {
        let x = x.clamp(0, self.w as i64 - 1) as usize;
        self.v[y.clamp(0, self.h as i64 - 1) as usize * self.w + x]
    }

    fn scharr(&self, x: i64, y: i64) -> Vector2<f64> {
        let mut g = Vector2::zeros();
        for (k, weight) in [(-1, 3.0), (0, 10.0), (1, 3.0)] {
            g.x += weight * (self.at(x + 1, y + k) - self.at(x - 1, y + k)) / 32.0;
            g.y += weight * (self.at(x + k, y + 1) - self.at(x + k, y - 1)) / 32.0;
        }
        g
    }

    /// By Catmull and Rom's cubic convolution.
    fn cubic(&self, p: &Vector2<f64>) -> f64 {
        let kernel = |d: f64| match d.abs() {
            d if d < 1.0 => (1.5 * d - 2.5) * d * d + 1.0,
            d if d < 2.0 => ((2.5 - 0.5 * d) * d - 4.0) * d + 2.0,
            _ => 0.0,
        };
        let (x, y) = (p.x.floor() as i64, p.y.floor() as i64);
        (y - 1..=y + 2)
            .flat_map(|y| (x - 1..=x + 2).map(move |x| (x, y)))
            .map(|(x, y)| kernel(p.x - x as f64) * kernel(p.y - y as f64) * self.at(x, y))
            .sum()
    }

    /// The fraction of a sample that is inside the image.
    fn fraction_inside(&self, p: &Vector2<f64>) -> f64 {
        let along = |v: f64, n: usize| (v + 1.0).min(n as f64 - v).clamp(0.0, 1.0);
        along(p.x, self.w) * along(p.y, self.h)
    }

    fn half(&self) -> Self {
        let mirror = |v: i64, n: usize| {
            let v = v.abs();
            if v < n as i64 { v } else { (2 * (n as i64 - 1) - v).max(0) }
        };
        let (w, h) = (self.w.div_ceil(2), self.h.div_ceil(2));
        let taps = [1.0, 4.0, 6.0, 4.0, 1.0];
        let mut v = Vec::new();
        for y in 0..h as i64 {
            for x in 0..w as i64 {
                let mut sum = 0.0;
                for j in 0..5 {
                    for i in 0..5 {
                        let from = self.at(
                            mirror(2 * x + i as i64 - 2, self.w),
                            mirror(2 * y + j as i64 - 2, self.h),
                        );
                        sum += taps[i] * taps[j] / 256.0 * from;
                    }
                }
                v.push(sum);
            }
        }
        Self { w, h, v }
    }
}

/// Interpolates linearly between whole pixels.
fn between<T>(p: &Vector2<f64>, at: impl Fn(i64, i64) -> T) -> T
where
    T: std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>,
{
    let (x, y) = (p.x.floor(), p.y.floor());
    let (fx, fy) = (p.x - x, p.y - y);
    let (x, y) = (x as i64, y as i64);
    (at(x, y) * (1.0 - fx) + at(x + 1, y) * fx) * (1.0 - fy)
        + (at(x, y + 1) * (1.0 - fx) + at(x + 1, y + 1) * fx) * fy
}

/// Levels of two images, full-sized first, halved together while their shorter side is at least 32 pixels.
fn levels(a: &Image, b: &Image, max_levels: usize) -> Vec<[Plane; 2]> {
    let mut levels = vec![[Plane::new(a), Plane::new(b)]];
    while levels.len() < max_levels {
        let [a, b] = &levels[levels.len() - 1];
        if a.w.min(a.h) < 32 {
            break;
        }
        let halves = [a.half(), b.half()];
        levels.push(halves);
    }
    levels
}

/// The position in `b` of the window around `from` in `a`, pixels; `None` where the full-sized window has too
/// little texture or leaves the image.
pub fn track(a: &Image, b: &Image, from: Point2<f64>, o: &KltParameters) -> Option<Point2<f64>> {
    let levels = levels(a, b, o.levels);
    let mut flow = Vector2::zeros();
    for (k, planes) in levels.iter().enumerate().rev() {
        flow *= 2.0;
        let p = (from.coords - Vector2::repeat(0.5)) / f64::from(1 << k);
        match track_level(planes, &p, flow, o) {
            Some(found) => flow = found,
            None if k == 0 => return None,
            None => {}
        }
    }
    let position = from + flow;
    let [a, _] = &levels[0];
    let inside = position.x >= 0.0
        && position.y >= 0.0
        && position.x <= a.w as f64
        && position.y <= a.h as f64;
    inside.then_some(position)
}

/// The flow at `p` (the first pixel's centre at 0) on one level, from an initial one; `None` where the window has
/// too little texture or leaves the image.
fn track_level(
    [a, b]: &[Plane; 2],
    p: &Vector2<f64>,
    mut flow: Vector2<f64>,
    o: &KltParameters,
) -> Option<Vector2<f64>> {
    let r = o.window_radius_px as i64;
    let area = ((2 * r + 1) * (2 * r + 1)) as f64;
    let window = || (-r..=r).flat_map(|y| (-r..=r).map(move |x| (x, y)));
    let place = |(x, y): (i64, i64)| Vector2::new(x as f64, y as f64);
    let template: Vec<_> = window()
        .map(|o| {
            let at = p + place(o);
            let inside = a.fraction_inside(&at);
            (between(&at, |x, y| a.at(x, y)), between(&at, |x, y| a.scharr(x, y)) * inside)
        })
        .collect();
    let tensor: Matrix2<f64> = template.iter().map(|(_, g)| g * g.transpose()).sum();
    if !(tensor.symmetric_eigenvalues().min() >= MIN_EIGENVALUE * area) {
        return None;
    }
    let inverse = tensor.try_inverse()?;
    let mut previous = Vector2::zeros();
    for step in 0..o.iterations {
        let q = p + flow;
        if q.x < -1.0 || q.y < -1.0 || q.x > b.w as f64 || q.y > b.h as f64 {
            return None;
        }
        let right: Vector2<f64> = window()
            .zip(&template)
            .map(|(o, (v, g))| g * (v - between(&(q + place(o)), |x, y| b.at(x, y))))
            .sum();
        let delta = inverse * right;
        flow += delta;
        if delta.norm() < o.epsilon_px {
            break;
        }
        if step > 0 && (delta + previous).norm() < o.epsilon_px {
            flow -= 0.5 * delta;
            break;
        }
        previous = delta;
    }
    Some(flow)
}

/// The tracker's smallest eigenvalue of a window with texture, per pixel.
const MIN_EIGENVALUE: f64 = 2e-6;
/// Of deforming windows: half their side, iterations, the step that ends them, the deformation that is expected, and
/// the distance to the translation that is allowed.
const RADIUS_PX: i64 = 8;
const ITERATIONS: usize = 12;
const EPSILON_PX: f64 = 0.02;
const DEFORMATION: f64 = 0.1;
const MAX_SHIFT_PX: f64 = 5.0;

/// A sample of a deforming window's template.
struct Sample {
    /// From the window's middle, pixels.
    place: Vector2<f64>,
    weight: f64,
    value: f64,
    /// Derivatives by shift, deformation by rows, gain and bias.
    slopes: SVector<f64, 8>,
}

/// The template around a pixel, of the samples inside the image.
fn deforming_template(a: &Plane, (cx, cy): (i64, i64)) -> Vec<Sample> {
    let r = RADIUS_PX;
    let sigma = 0.6 * r as f64;
    let mean = a.at(cx, cy);
    let inside = |v: i64, n: usize| v >= 0 && v < n as i64;
    (-r..=r)
        .flat_map(|y| (-r..=r).map(move |x| (x, y)))
        .filter(|(x, y)| inside(cx + x, a.w) && inside(cy + y, a.h))
        .map(|(x, y)| {
            let place = Vector2::new(x as f64, y as f64);
            let weight = (-0.5 * place.norm_squared() / (sigma * sigma)).exp();
            let (value, g) = (a.at(cx + x, cy + y), a.scharr(cx + x, cy + y));
            let slopes = SVector::from([
                g.x,
                g.y,
                place.x * g.x,
                place.y * g.x,
                place.x * g.y,
                place.y * g.y,
                value - mean,
                1.0,
            ]);
            Sample { place, weight, value, slopes }
        })
        .collect()
}

/// Baker and Matthews's inverse compositional step for a deforming window with gain and bias, as
/// simply as possible: where the point `from` of `a` is in `b`, which the translation translated at
/// `translated`; `None` where it does not converge near there. The image's border is repeated outwards.
pub fn deformed(
    a: &Image,
    b: &Image,
    from: Point2<f64>,
    translated: Point2<f64>,
) -> Option<Point2<f64>> {
    /// Noise of 8-bit values, against which a deformation of `DEFORMATION` is expected.
    const NOISE: f64 = 0.012;
    let (a, b) = (Plane::new(a), Plane::new(b));
    let pixel = from.coords.map(f64::floor);
    if !(pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < a.w as f64 && pixel.y < a.h as f64) {
        return None;
    }
    let offset = from.coords - pixel - Vector2::repeat(0.5);
    let (cx, cy) = (pixel.x as i64, pixel.y as i64);
    let mean = a.at(cx, cy);
    let template = deforming_template(&a, (cx, cy));
    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    for sample in &template {
        normal += sample.weight * sample.slopes * sample.slopes.transpose();
    }
    let prior = (NOISE / DEFORMATION).powi(2);
    for k in 2..7 {
        normal[(k, k)] += prior;
    }
    let solver = normal.cholesky()?;
    let (mut matrix, mut middle) =
        (Matrix2::identity(), translated.coords - Vector2::repeat(0.5) - offset);
    let (mut gain, mut bias) = (1.0, 0.0);
    for _ in 0..ITERATIONS {
        let mut right = SVector::<f64, 8>::zeros();
        for sample in &template {
            let sampled = b.cubic(&(middle + matrix * sample.place));
            right += sample.slopes * (sample.weight * ((sampled - bias) / gain - sample.value));
        }
        let a = matrix - Matrix2::identity();
        for (k, v) in [(2, a.m11), (3, a.m12), (4, a.m21), (5, a.m22), (6, 1.0 - gain)] {
            right[k] += prior * v;
        }
        let step = solver.solve(&right);
        matrix *= Matrix2::new(1.0 + step[2], step[3], step[4], 1.0 + step[5]).try_inverse()?;
        let moved = matrix * Vector2::new(step[0], step[1]);
        middle -= moved;
        bias += gain * (step[7] - mean * step[6]);
        gain *= 1.0 + step[6];
        if !(gain > 0.25 && gain < 4.0) {
            return None;
        }
        if moved.norm() < EPSILON_PX {
            break;
        }
    }
    let position = Point2::from(middle + matrix * offset + Vector2::repeat(0.5));
    ((position - translated).norm() <= MAX_SHIFT_PX).then_some(position)
}
