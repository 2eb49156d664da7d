//! The last, sub-pixel step of a track: the window as a patch of a surface that turns, tilts, comes
//! nearer and changes its light, where Lucas and Kanade's only moves.
//!
//! Baker and Matthews's inverse compositional method (IJCV 56(3), 2004): the source's window is
//! the template, at whole pixels, and its derivatives are taken once; the target is sampled by
//! cubic convolution. The window may be larger than the translation's, whose size is limited by
//! the deformation that it ignores: that is what beats the noise.
//!
//! Known limit: a window across an outline follows the body that has more texture in it.

use super::lanes::{LANES, Vector, catmull_rom};
use super::pyramid::Level;
use super::window::scharr;
use nalgebra::{Cholesky, Const, Matrix2, Point2, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};

/// How tracks are refined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AffineOptions {
    /// Half the side of the window, pixels; 0: no refinement. Larger: less noise; smaller: less of
    /// other bodies, and of the surface's curvature.
    pub radius_px: usize,
    /// Standard deviation of the weights, as a share of the radius. Larger: less noise, smaller:
    /// nearer to the point.
    pub sigma_share: f64,
    /// Iterations at most.
    pub iterations: usize,
    /// It has converged when a step is below this, pixels.
    pub epsilon_px: f64,
    /// Deformation that is expected between the images (standard deviation of the matrix's
    /// entries, and of the gain). Larger: windows with little texture deform at random; smaller:
    /// what really turns is held back.
    pub deformation: f64,
    /// A refined point further than this from where the translation found it is a failure.
    pub max_shift_px: f64,
}

impl Default for AffineOptions {
    fn default() -> Self {
        Self {
            radius_px: 11,
            sigma_share: 0.6,
            iterations: 6,
            epsilon_px: 0.02,
            deformation: 0.1,
            max_shift_px: 1.5,
        }
    }
}

impl AffineOptions {
    /// The border that a pyramid needs: windows may grow by a half.
    pub fn pad_px(&self) -> usize {
        if self.radius_px == 0 { 0 } else { self.radius_px * 3 / 2 + LANES + 3 }
    }
}

/// Parameters: the shift (2), the deformation's entries by rows (4), gain and bias.
const N: usize = 8;
/// Noise of the values, 0..=1, against which the expected deformation is weighed: of 8 bits and a
/// few samples a pixel. Only windows with hardly any texture feel it.
const NOISE: f64 = 0.012;
/// Gains beyond this, or below its inverse, are no change of light.
const MAX_GAIN: f64 = 4.0;

/// Buffers of one window, reused from point to point. Planes of rows that are padded to whole
/// lanes; the padding has no weight.
#[derive(Debug)]
pub struct Refiner {
    radius: usize,
    row: usize,
    /// Of each sample of a row, counted from the middle.
    column: Vec<f32>,
    fall_off: Vec<f32>,
    weight: Vec<f32>,
    value: Vec<f32>,
    /// The weights times the template's derivatives, and times its value (less [`Self::mean`]).
    weighted_dx: Vec<f32>,
    weighted_dy: Vec<f32>,
    weighted_value: Vec<f32>,
    mean: f32,
}

/// From window coordinates (whole pixels from the middle) to the target's, and from the template's
/// values to the target's.
#[derive(Clone, Copy)]
struct Warp {
    middle: Vector2<f64>,
    matrix: Matrix2<f64>,
    gain: f64,
    bias: f64,
}

type Normal = (Cholesky<f64, Const<N>>, [f64; N]);

impl Refiner {
    pub fn new(options: &AffineOptions) -> Self {
        let radius = options.radius_px;
        let row = (2 * radius + 1).next_multiple_of(LANES);
        let sigma = (options.sigma_share * radius as f64).max(0.1);
        let mut fall_off = vec![0.0; row * (2 * radius + 1)];
        for (k, weight) in fall_off.iter_mut().enumerate() {
            let (x, y) = ((k % row) as f64 - radius as f64, (k / row) as f64 - radius as f64);
            if x <= radius as f64 {
                *weight = (-0.5 * (x * x + y * y) / (sigma * sigma)).exp() as f32;
            }
        }
        let zeros = || vec![0.0; fall_off.len()];
        Self {
            radius,
            row,
            column: (0..row).map(|x| x as f32 - radius as f32).collect(),
            weight: zeros(),
            value: zeros(),
            weighted_dx: zeros(),
            weighted_dy: zeros(),
            weighted_value: zeros(),
            mean: 0.0,
            fall_off,
        }
    }

    /// Where the point `from` of the source is in the target, which the translation found at
    /// `found`; pixels. `None` where the refinement does not converge near there.
    #[inline(always)]
    pub fn refine<V: Vector>(
        &mut self,
        source: &Level,
        target: &Level,
        from: Point2<f64>,
        found: Point2<f64>,
        options: &AffineOptions,
    ) -> Option<Point2<f64>> {
        let pixel = from.coords.map(f64::floor);
        let offset = from.coords - pixel - Vector2::repeat(0.5);
        let inside = |v: f64, size: usize| v >= 0.0 && v < size as f64;
        if !(inside(pixel.x, source.width) && inside(pixel.y, source.height)) {
            return None;
        }
        let mut warp = Warp {
            middle: found.coords - Vector2::repeat(0.5) - offset,
            matrix: Matrix2::identity(),
            gain: 1.0,
            bias: 0.0,
        };
        let (normal, prior) =
            self.take_template::<V>(source, pixel.x as usize, pixel.y as usize, options)?;
        for _ in 0..options.iterations {
            let mut right = self.mismatch::<V>(target, &warp)?;
            // The prior pulls the whole deformation back to none. A step is taken in the template,
            // so it is the inverse of the target's, but for the gain.
            let a = warp.matrix - Matrix2::identity();
            for (k, v) in [(2, a.m11), (3, a.m12), (4, a.m21), (5, a.m22), (6, 1.0 - warp.gain)] {
                right[k] += prior[k] * v;
            }
            let step = normal.solve(&right);
            let shrunk = Matrix2::new(1.0 + step[2], step[3], step[4], 1.0 + step[5]);
            warp.matrix *= shrunk.try_inverse()?;
            let moved = warp.matrix * Vector2::new(step[0], step[1]);
            warp.middle -= moved;
            warp.bias += warp.gain * (step[7] - f64::from(self.mean) * step[6]);
            warp.gain *= 1.0 + step[6];
            if !(warp.gain > 1.0 / MAX_GAIN && warp.gain < MAX_GAIN) {
                return None;
            }
            if moved.norm() < options.epsilon_px {
                break;
            }
        }
        let position = Point2::from(warp.middle + warp.matrix * offset + Vector2::repeat(0.5));
        ((position - found).norm() <= options.max_shift_px).then_some(position)
    }

    /// Cuts the template out around a pixel; the normal equations, factorized, and what the prior
    /// added to their diagonal. `None` where the texture can't tell the shift.
    #[inline(always)]
    fn take_template<V: Vector>(
        &mut self,
        source: &Level,
        cx: usize,
        cy: usize,
        options: &AffineOptions,
    ) -> Option<Normal> {
        let r = self.radius as isize;
        let (cx, cy) = (cx as isize, cy as isize);
        // What is outside the image is a copy of its border, and has no say.
        let columns = (r - cx).max(0)..(source.width as isize - cx + r).min(2 * r + 1);
        let rows = (r - cy).max(0)..(source.height as isize - cy + r).min(2 * r + 1);
        self.mean = source.value[source.index(cx, cy)];
        let (mean, scale) = (V::splat(self.mean), V::splat(1.0 / 32.0));
        let mut moments = Moments::<V>::new();
        for y in 0..2 * r + 1 {
            let out = y as usize * self.row;
            let all = out..out + self.row;
            self.weight[all.clone()].fill(0.0);
            if rows.contains(&y) {
                let used = out + columns.start as usize..out + columns.end as usize;
                self.weight[used.clone()].copy_from_slice(&self.fall_off[used]);
            }
            let at = source.index(cx - r, cy + y - r);
            self.value[all].copy_from_slice(&source.value[at..at + self.row]);
            let mut of_row = RowMoments::new();
            for x in (0..self.row).step_by(LANES) {
                let [gx, gy] = scharr::<V>(&source.value, at + x, source.stride);
                let (gx, gy) = (gx.mul(scale), gy.mul(scale));
                let w = V::load(&self.weight, out + x);
                let v = V::load(&self.value, out + x).sub(mean);
                let (wx, wy, wv) = (w.mul(gx), w.mul(gy), w.mul(v));
                of_row.add([gx, gy, v], [wx, wy, wv, w], V::load(&self.column, x));
                wx.store(&mut self.weighted_dx, out + x);
                wy.store(&mut self.weighted_dy, out + x);
                wv.store(&mut self.weighted_value, out + x);
            }
            moments.add(&of_row, V::splat((y - r) as f32));
        }
        let mut matrix = moments.matrix();
        let d = (NOISE / options.deformation).powi(2);
        let prior = [0.0, 0.0, d, d, d, d, d, 0.0];
        for (k, p) in prior.iter().enumerate() {
            matrix[(k, k)] += p;
        }
        Some((Cholesky::new(matrix)?, prior))
    }

    /// Σ w·(what the target shows, in the template's light, less the template)·derivatives.
    #[inline(always)]
    fn mismatch<V: Vector>(&self, target: &Level, warp: &Warp) -> Option<SVector<f64, N>> {
        let (gain, bias) = (V::splat(1.0 / warp.gain as f32), V::splat(warp.bias as f32));
        let sampler = Sampler::new(target, warp, self.radius, self.row)?;
        let mut sums = [V::zero(); N];
        for y in 0..2 * self.radius + 1 {
            let at = y * self.row;
            let down = y as f32 - self.radius as f32;
            // Shift x, y; their moments along the row; value; one.
            let mut of_row = [V::zero(); 6];
            for x in (0..self.row).step_by(LANES) {
                let column = V::load(&self.column, x);
                let found = sampler.sample(column, down);
                let e = found.sub(bias).mul(gain).sub(V::load(&self.value, at + x));
                let ex = e.mul(V::load(&self.weighted_dx, at + x));
                let ey = e.mul(V::load(&self.weighted_dy, at + x));
                let ev = e.mul(V::load(&self.weighted_value, at + x));
                let ew = e.mul(V::load(&self.weight, at + x));
                accumulate(&mut of_row, [ex, ey, ex.mul(column), ey.mul(column), ev, ew]);
            }
            let [ex, ey, ex_x, ey_x, ev, ew] = of_row;
            let y = V::splat(down);
            accumulate(&mut sums, [ex, ey, ex_x, ex.mul(y), ey_x, ey.mul(y), ev, ew]);
        }
        Some(SVector::from(V::sums(&sums)))
    }
}

/// Sums over a row of the products of two derivatives (with their moments along the row).
struct RowMoments<V> {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, x².
    tensor: [[V; 3]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x.
    mixed: [[V; 2]; 4],
    /// v·v, v, 1.
    light: [V; 3],
}

impl<V: Vector> RowMoments<V> {
    #[inline(always)]
    fn new() -> Self {
        let zero = V::zero();
        Self { tensor: [[zero; 3]; 3], mixed: [[zero; 2]; 4], light: [zero; 3] }
    }

    /// Derivatives by the position and the gain, and the same weighted, with the weights.
    #[inline(always)]
    fn add(&mut self, [gx, gy, v]: [V; 3], [wx, wy, wv, w]: [V; 4], x: V) {
        let products = [wx.mul(gx), wx.mul(gy), wy.mul(gy)];
        for (sums, p) in self.tensor.iter_mut().zip(products) {
            let px = p.mul(x);
            accumulate(sums, [p, px, px.mul(x)]);
        }
        let products = [wx.mul(v), wy.mul(v), wx, wy];
        for (sums, p) in self.mixed.iter_mut().zip(products) {
            accumulate(sums, [p, p.mul(x)]);
        }
        accumulate(&mut self.light, [wv.mul(v), wv, w]);
    }
}

#[inline(always)]
fn accumulate<V: Vector, const M: usize>(sums: &mut [V; M], terms: [V; M]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum = sum.add(term);
    }
}

/// The same over the window: each times x^i y^j.
struct Moments<V> {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, y, x², xy, y².
    tensor: [[V; 6]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x, y.
    mixed: [[V; 3]; 4],
    light: [V; 3],
}

impl<V: Vector> Moments<V> {
    #[inline(always)]
    fn new() -> Self {
        let zero = V::zero();
        Self { tensor: [[zero; 6]; 3], mixed: [[zero; 3]; 4], light: [zero; 3] }
    }

    #[inline(always)]
    fn add(&mut self, row: &RowMoments<V>, y: V) {
        for (sums, &[p, px, pxx]) in self.tensor.iter_mut().zip(&row.tensor) {
            let py = p.mul(y);
            accumulate(sums, [p, px, py, pxx, px.mul(y), py.mul(y)]);
        }
        for (sums, &[p, px]) in self.mixed.iter_mut().zip(&row.mixed) {
            accumulate(sums, [p, px, p.mul(y)]);
        }
        accumulate(&mut self.light, row.light);
    }

    /// Derivatives in the order of the parameters: dx, dy, x·dx, y·dx, x·dy, y·dy, v, 1.
    #[inline(always)]
    fn matrix(&self) -> SMatrix<f64, N, N> {
        let [a, b, c] = &self.tensor;
        let tensor = [V::sums(a), V::sums(b), V::sums(c)];
        let [a, b, c, d] = &self.mixed;
        let mixed = [V::sums(a), V::sums(b), V::sums(c), V::sums(d)];
        let light = V::sums(&self.light);
        // Which derivative of the image, and which moment: 1, x, y.
        const SHIFTS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1), (1, 2)];
        // The product of two moments among 1, x, y, x², xy, y².
        const PRODUCT: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        SMatrix::from_fn(|i, j| {
            let (i, j) = (i.min(j), i.max(j));
            match (SHIFTS.get(i), SHIFTS.get(j)) {
                (Some(&(a, m)), Some(&(b, n))) => tensor[a + b][PRODUCT[m][n]],
                (Some(&(a, m)), None) => mixed[if j == 6 { a } else { 2 + a }][m],
                _ => light[i + j - 12],
            }
        })
    }
}

/// A level, sampled at window coordinates.
struct Sampler<'a> {
    target: &'a Level,
    /// Index of the top left of the 4×4 samples around the middle's pixel.
    corner: isize,
    /// Target from window: the columns of the matrix, and the middle within its pixel.
    across: [f32; 2],
    down: [f32; 2],
    middle: [f32; 2],
}

impl<'a> Sampler<'a> {
    /// `None` if the window leaves the padded image.
    fn new(target: &'a Level, warp: &Warp, radius: usize, row: usize) -> Option<Self> {
        let reach = (row - radius).max(radius) as f64;
        let m = &warp.matrix;
        let pad = target.pad as f64;
        let fits = |middle: f64, a: f64, b: f64, size: usize| {
            // Two more for the kernel, one for the middle's decimals.
            let extent = reach * (a.abs() + b.abs()) + 3.0;
            middle - extent >= -pad && middle + extent <= size as f64 + pad - 1.0
        };
        if !(fits(warp.middle.x, m.m11, m.m12, target.width)
            && fits(warp.middle.y, m.m21, m.m22, target.height))
        {
            return None;
        }
        let whole = warp.middle.map(f64::floor);
        let within = warp.middle - whole;
        Some(Self {
            target,
            corner: target.index(whole.x as isize - 1, whole.y as isize - 1) as isize,
            across: [m.m11 as f32, m.m21 as f32],
            down: [m.m12 as f32, m.m22 as f32],
            middle: [within.x as f32, within.y as f32],
        })
    }

    /// Where the samples are, along one axis.
    #[inline(always)]
    fn split<V: Vector>(&self, axis: usize, column: V, down: f32) -> ([i32; LANES], V) {
        let start = self.middle[axis] + self.down[axis] * down;
        V::splat(start).add(V::splat(self.across[axis]).mul(column)).split()
    }

    /// Eight samples by cubic convolution.
    #[inline(always)]
    fn sample<V: Vector>(&self, column: V, down: f32) -> V {
        let [(ix, fx), (iy, fy)] = [self.split(0, column, down), self.split(1, column, down)];
        let stride = self.target.stride as isize;
        let mut first = [0; LANES];
        for (l, first) in first.iter_mut().enumerate() {
            *first = (self.corner + iy[l] as isize * stride + ix[l] as isize) as usize;
        }
        let (x, y) = (catmull_rom(fx), catmull_rom(fy));
        V::gather_4x4(&self.target.value, &first, self.target.stride, x, y)
    }
}
