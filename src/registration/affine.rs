//! Beyond the paper: an affine last step of a track, with gain and bias. The window is a patch of a
//! surface that turns, tilts, comes nearer and changes its brightness, where Lucas and Kanade's only
//! translates.
//!
//! Baker and Matthews's inverse compositional method (IJCV 56(3), 2004). The template is the source's
//! window at whole pixels, and its derivatives are computed once. The target is sampled by cubic
//! convolution. The window can be larger than the translation's, whose size is limited by the
//! deformation that a translation ignores; a larger window averages more noise.
//!
//! Known limit: a window across an outline follows the surface that has more texture in it.

use super::gradient::{SCHARR_SCALE, scharr};
use super::pyramid::Level;
use crate::simd::{F32x8, LANES};
use nalgebra::{Cholesky, Const, Matrix2, Point2, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};

/// Options of the affine last step of a track (beyond the paper).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AffineOptions {
    /// Half the side of the window, pixels; 0 switches the step off. Larger: the window crosses
    /// outlines and curved surfaces; smaller: more noise.
    pub radius_px: usize,
    /// Standard deviation of the Gaussian weights, as a fraction of the radius. Larger: the window's
    /// rim counts, with what crosses an outline there; smaller: more noise.
    pub sigma_share: f64,
    /// Maximum number of iterations. Larger: time is spent on windows that do not converge; smaller:
    /// large deformations are not reached.
    pub iterations: usize,
    /// The step has converged when it moves by less than this, pixels. Larger: the error left is of
    /// this size; smaller: more iterations.
    pub epsilon_px: f64,
    /// Standard deviation of the Gaussian prior of the deformation: of the matrix's entries minus
    /// the identity's, and of the gain minus 1. Larger: windows with little texture deform at
    /// random; smaller: real rotation is held back.
    pub deformation: f64,
    /// A result further than this from the translation's is discarded, pixels. Larger: windows that
    /// slid to another texture are accepted; smaller: real corrections of fast rotation are lost.
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
    /// The border that a pyramid needs for these windows, pixels; they may grow by a half. 0 if the
    /// step is off.
    pub fn pad_px(&self) -> usize {
        if self.radius_px == 0 { 0 } else { self.radius_px * 3 / 2 + LANES + 3 }
    }
}

/// Number of parameters: the shift (2), the matrix's entries row by row (4), gain and bias.
const N: usize = 8;
/// Standard deviation of the noise of values in 0..=1 (8 bits, a few samples per pixel), which the
/// prior of the deformation is weighted by. Larger: the deformation of windows with little texture
/// is held back; smaller: noise deforms them.
const NOISE: f64 = 0.012;
/// Largest gain between two windows; the smallest is its inverse. Larger: windows that fit nothing
/// are accepted with an extreme gain; smaller: real changes of exposure fail.
const MAX_GAIN: f64 = 4.0;

/// The affine step, with the buffers of one window, which are reused from point to point.
///
/// The planes are row-major with rows padded to whole SIMD words; the padding has weight 0.
#[derive(Debug)]
pub struct AffineRefiner {
    radius: usize,
    /// Samples of a row, the padding included.
    row: usize,
    /// The column of each sample of a row, counted from the middle.
    column: Vec<f32>,
    /// The Gaussian weights.
    gaussian: Vec<f32>,
    /// The Gaussian weights, 0 outside the image.
    weight: Vec<f32>,
    /// The template's values.
    value: Vec<f32>,
    /// The weights times the template's derivatives, and times its value minus `center_value`.
    weighted_dx: Vec<f32>,
    weighted_dy: Vec<f32>,
    weighted_value: Vec<f32>,
    /// The value at the window's middle; values are taken relative to it for their precision.
    center_value: f32,
}

/// Where the affine step found a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformed {
    /// The position in the target, pixels.
    pub position: Point2<f64>,
    /// The matrix from the window's coordinates in the source to those in the target.
    pub deformation: Matrix2<f64>,
    /// Weighted mean absolute difference of the two windows' values, 0..=1, the target's gain and bias
    /// taken out.
    pub residual: f64,
    /// The same relative to the contrast of the source's window: near 0 where the windows are alike, near
    /// 1 where they are unlike.
    pub unexplained: f64,
}

/// The affine map from window coordinates (pixels from the window's middle) to the target's (pixels,
/// the first pixel's centre at 0), and from the template's values to the target's.
#[derive(Clone, Copy)]
struct AffineWarp {
    middle: Vector2<f64>,
    matrix: Matrix2<f64>,
    gain: f64,
    bias: f64,
}

/// The normal equations of the template, factorized.
struct NormalEquations {
    solver: Cholesky<f64, Const<N>>,
    /// What the prior added to the diagonal.
    prior: [f64; N],
}

impl AffineRefiner {
    /// A refiner for windows of `2·radius_px + 1` pixels a side.
    pub fn new(options: &AffineOptions) -> Self {
        let radius = options.radius_px;
        let row = (2 * radius + 1).next_multiple_of(LANES);
        let sigma = (options.sigma_share * radius as f64).max(0.1);
        let mut gaussian = vec![0.0; row * (2 * radius + 1)];
        for (k, weight) in gaussian.iter_mut().enumerate() {
            let (x, y) = ((k % row) as f64 - radius as f64, (k / row) as f64 - radius as f64);
            if x <= radius as f64 {
                *weight = (-0.5 * (x * x + y * y) / (sigma * sigma)).exp() as f32;
            }
        }
        let zeros = || vec![0.0; gaussian.len()];
        Self {
            radius,
            row,
            column: (0..row).map(|x| x as f32 - radius as f32).collect(),
            weight: zeros(),
            value: zeros(),
            weighted_dx: zeros(),
            weighted_dy: zeros(),
            weighted_value: zeros(),
            center_value: 0.0,
            gaussian,
        }
    }

    /// The position in the target of the point `from` of the source, and the window's deformation;
    /// `guess` is the position that the search starts at, and `deformation` the matrix, which the
    /// prior pulls to. Pixels, the top-left pixel's centre at (0.5, 0.5).
    ///
    /// `None` if `from` or the warped window is outside, if the texture does not determine the
    /// parameters, if the gain is not between 1/4 and 4, or if the result is further than
    /// [`AffineOptions::max_shift_px`] from `guess`.
    #[inline(always)]
    pub fn refine<V: F32x8>(
        &mut self,
        [source, target]: [&Level; 2],
        from: Point2<f64>,
        guess: Point2<f64>,
        deformation: Matrix2<f64>,
        options: &AffineOptions,
    ) -> Option<Deformed> {
        let pixel = from.coords.map(f64::floor);
        let offset = from.coords - pixel - Vector2::repeat(0.5);
        let inside = |v: f64, size: usize| v >= 0.0 && v < size as f64;
        if !(inside(pixel.x, source.width) && inside(pixel.y, source.height)) {
            return None;
        }
        let mut warp = AffineWarp {
            middle: guess.coords - Vector2::repeat(0.5) - deformation * offset,
            matrix: deformation,
            gain: 1.0,
            bias: 0.0,
        };
        let from_given = deformation.try_inverse()?;
        let NormalEquations { solver, prior } =
            self.load_template::<V>(source, pixel.x as usize, pixel.y as usize, options)?;
        for _ in 0..options.iterations {
            let mut right = self.right_hand_side::<V>(target, &warp)?;
            // The prior pulls the whole deformation, not the step, to the given one. A step deforms
            // the template, which is the inverse of deforming the target; the gain's is not inverted.
            let a = from_given * warp.matrix - Matrix2::identity();
            for (k, v) in [(2, a.m11), (3, a.m12), (4, a.m21), (5, a.m22), (6, 1.0 - warp.gain)] {
                right[k] += prior[k] * v;
            }
            let step = solver.solve(&right);
            let step_matrix = Matrix2::new(1.0 + step[2], step[3], step[4], 1.0 + step[5]);
            warp.matrix *= step_matrix.try_inverse()?;
            let moved = warp.matrix * Vector2::new(step[0], step[1]);
            warp.middle -= moved;
            warp.bias += warp.gain * (step[7] - f64::from(self.center_value) * step[6]);
            warp.gain *= 1.0 + step[6];
            if !(warp.gain > 1.0 / MAX_GAIN && warp.gain < MAX_GAIN) {
                return None;
            }
            if moved.norm() < options.epsilon_px {
                break;
            }
        }
        let position = Point2::from(warp.middle + warp.matrix * offset + Vector2::repeat(0.5));
        if (position - guess).norm() > options.max_shift_px {
            return None;
        }
        let [residual, unexplained] = self.residual::<V>(target, &warp)?;
        Some(Deformed { position, deformation: warp.matrix, residual, unexplained })
    }

    /// The weighted mean of the absolute difference of the warped target and the template, values 0..=1, and
    /// its ratio to that of the template and its mean. `None` if the warped window leaves the padded image.
    #[inline(always)]
    fn residual<V: F32x8>(&self, target: &Level, warp: &AffineWarp) -> Option<[f64; 2]> {
        let (gain, bias) = (V::splat(1.0 / warp.gain as f32), V::splat(warp.bias as f32));
        let sampler = Sampler::new(target, warp, self.radius, self.row)?;
        let mut mean = [V::zero(); 2];
        for at in (0..self.value.len()).step_by(LANES) {
            let w = V::load(&self.weight, at);
            accumulate(&mut mean, [V::load(&self.value, at).mul(w), w]);
        }
        let [sum, weight] = V::sums(&mean);
        if weight <= 0.0 {
            return None;
        }
        let mean = V::splat((sum / weight) as f32);
        let mut sums = [V::zero(); 2];
        for y in 0..2 * self.radius + 1 {
            let at = y * self.row;
            for x in (0..self.row).step_by(LANES) {
                let sampled =
                    sampler.sample(V::load(&self.column, x), y as f32 - self.radius as f32);
                let value = V::load(&self.value, at + x);
                let e = sampled.sub(bias).mul(gain).sub(value);
                let w = V::load(&self.weight, at + x);
                accumulate(&mut sums, [e.abs().mul(w), value.sub(mean).abs().mul(w)]);
            }
        }
        let [difference, contrast] = V::sums(&sums);
        // A template that determined the shift has contrast.
        Some([difference / weight, difference / contrast.max(f64::MIN_POSITIVE)])
    }

    /// Reads the template around pixel (`cx`, `cy`) and sets up its normal equations. `None` if the
    /// texture does not determine the shift.
    #[inline(always)]
    fn load_template<V: F32x8>(
        &mut self,
        source: &Level,
        cx: usize,
        cy: usize,
        options: &AffineOptions,
    ) -> Option<NormalEquations> {
        let r = self.radius as isize;
        let (cx, cy) = (cx as isize, cy as isize);
        // Samples outside the image are copies of its border, and have weight 0.
        let columns = (r - cx).max(0)..(source.width as isize - cx + r).min(2 * r + 1);
        let rows = (r - cy).max(0)..(source.height as isize - cy + r).min(2 * r + 1);
        self.center_value = source.value[source.index(cx, cy)];
        let (center, scale) = (V::splat(self.center_value), V::splat(1.0 / SCHARR_SCALE));
        let mut moments = Moments::<V>::new();
        for y in 0..2 * r + 1 {
            let out = y as usize * self.row;
            let all = out..out + self.row;
            self.weight[all.clone()].fill(0.0);
            if rows.contains(&y) {
                let inside = out + columns.start as usize..out + columns.end as usize;
                self.weight[inside.clone()].copy_from_slice(&self.gaussian[inside]);
            }
            let at = source.index(cx - r, cy + y - r);
            self.value[all].copy_from_slice(&source.value[at..at + self.row]);
            let mut of_row = RowMoments::new();
            for x in (0..self.row).step_by(LANES) {
                let [gx, gy] = scharr::<V>(&source.value, at + x, source.stride);
                let (gx, gy) = (gx.mul(scale), gy.mul(scale));
                let w = V::load(&self.weight, out + x);
                let v = V::load(&self.value, out + x).sub(center);
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
        Some(NormalEquations { solver: Cholesky::new(matrix)?, prior })
    }

    /// The right-hand side of the normal equations: Σ w·e·(derivatives by the parameters), with e
    /// the target's value at the template's gain and bias minus the template's. `None` if the
    /// warped window leaves the padded image.
    #[inline(always)]
    fn right_hand_side<V: F32x8>(
        &self,
        target: &Level,
        warp: &AffineWarp,
    ) -> Option<SVector<f64, N>> {
        let (gain, bias) = (V::splat(1.0 / warp.gain as f32), V::splat(warp.bias as f32));
        let sampler = Sampler::new(target, warp, self.radius, self.row)?;
        let mut sums = [V::zero(); N];
        for y in 0..2 * self.radius + 1 {
            let at = y * self.row;
            let row_from_middle = y as f32 - self.radius as f32;
            // By shift x, y; their moments along the row; by gain; by bias.
            let mut of_row = [V::zero(); 6];
            for x in (0..self.row).step_by(LANES) {
                let column = V::load(&self.column, x);
                let sampled = sampler.sample(column, row_from_middle);
                let e = sampled.sub(bias).mul(gain).sub(V::load(&self.value, at + x));
                let ex = e.mul(V::load(&self.weighted_dx, at + x));
                let ey = e.mul(V::load(&self.weighted_dy, at + x));
                let ev = e.mul(V::load(&self.weighted_value, at + x));
                let ew = e.mul(V::load(&self.weight, at + x));
                accumulate(&mut of_row, [ex, ey, ex.mul(column), ey.mul(column), ev, ew]);
            }
            let [ex, ey, ex_x, ey_x, ev, ew] = of_row;
            let y = V::splat(row_from_middle);
            accumulate(&mut sums, [ex, ey, ex_x, ex.mul(y), ey_x, ey.mul(y), ev, ew]);
        }
        Some(SVector::from(V::sums(&sums)))
    }
}

/// Sums, over a row, of the weighted products of two derivatives, and their moments along the row.
struct RowMoments<V> {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, x².
    tensor: [[V; 3]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x.
    shift_light: [[V; 2]; 4],
    /// v·v, v, 1.
    light: [V; 3],
}

impl<V: F32x8> RowMoments<V> {
    #[inline(always)]
    fn new() -> Self {
        let zero = V::zero();
        Self { tensor: [[zero; 3]; 3], shift_light: [[zero; 2]; 4], light: [zero; 3] }
    }

    /// Adds a word of samples at columns `x`: the derivatives by position and gain; the same times
    /// the weights, and the weights.
    #[inline(always)]
    fn add(&mut self, [gx, gy, v]: [V; 3], [wx, wy, wv, w]: [V; 4], x: V) {
        let products = [wx.mul(gx), wx.mul(gy), wy.mul(gy)];
        for (sums, p) in self.tensor.iter_mut().zip(products) {
            let px = p.mul(x);
            accumulate(sums, [p, px, px.mul(x)]);
        }
        let products = [wx.mul(v), wy.mul(v), wx, wy];
        for (sums, p) in self.shift_light.iter_mut().zip(products) {
            accumulate(sums, [p, p.mul(x)]);
        }
        accumulate(&mut self.light, [wv.mul(v), wv, w]);
    }
}

#[inline(always)]
fn accumulate<V: F32x8, const M: usize>(sums: &mut [V; M], terms: [V; M]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum = sum.add(term);
    }
}

/// Sums, over the window, of the weighted products of two derivatives times x^i·y^j.
struct Moments<V> {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, y, x², xy, y².
    tensor: [[V; 6]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x, y.
    shift_light: [[V; 3]; 4],
    light: [V; 3],
}

impl<V: F32x8> Moments<V> {
    #[inline(always)]
    fn new() -> Self {
        let zero = V::zero();
        Self { tensor: [[zero; 6]; 3], shift_light: [[zero; 3]; 4], light: [zero; 3] }
    }

    #[inline(always)]
    fn add(&mut self, row: &RowMoments<V>, y: V) {
        for (sums, &[p, px, pxx]) in self.tensor.iter_mut().zip(&row.tensor) {
            let py = p.mul(y);
            accumulate(sums, [p, px, py, pxx, px.mul(y), py.mul(y)]);
        }
        for (sums, &[p, px]) in self.shift_light.iter_mut().zip(&row.shift_light) {
            accumulate(sums, [p, px, p.mul(y)]);
        }
        accumulate(&mut self.light, row.light);
    }

    /// The normal matrix. The derivatives in the order of the parameters are dx, dy, x·dx, y·dx,
    /// x·dy, y·dy, v, 1.
    #[inline(always)]
    fn matrix(&self) -> SMatrix<f64, N, N> {
        let [a, b, c] = &self.tensor;
        let tensor = [V::sums(a), V::sums(b), V::sums(c)];
        let [a, b, c, d] = &self.shift_light;
        let shift_light = [V::sums(a), V::sums(b), V::sums(c), V::sums(d)];
        let light = V::sums(&self.light);
        // For each of the first six parameters: the derivative (dx, dy) and the moment (1, x, y).
        const SHIFTS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1), (1, 2)];
        // The index, among 1, x, y, x², xy, y², of the product of two moments.
        const PRODUCT: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        SMatrix::from_fn(|i, j| {
            let (i, j) = (i.min(j), i.max(j));
            match (SHIFTS.get(i), SHIFTS.get(j)) {
                (Some(&(a, m)), Some(&(b, n))) => tensor[a + b][PRODUCT[m][n]],
                (Some(&(a, m)), None) => shift_light[if j == 6 { a } else { 2 + a }][m],
                _ => light[i + j - 12],
            }
        })
    }
}

/// The weights of Catmull and Rom's cubic convolution for the samples at −1, 0, 1 and 2, at a
/// position `f` in 0..1.
///
/// This is the SIMD kernel, in Horner form. Its scalar reference is `raster::catmull_rom`, in
/// expanded form. The two round differently, so neither can replace the other without changing
/// results; a test holds them equal to 1e-6.
#[inline(always)]
pub fn catmull_rom<V: F32x8>(f: V) -> [V; 4] {
    let c = V::splat;
    let half = c(0.5);
    let squared = f.mul(f);
    [
        f.mul(f.mul(c(1.0).sub(half.mul(f))).sub(half)),
        c(1.0).add(squared.mul(c(1.5).mul(f).sub(c(2.5)))),
        f.mul(half.add(f.mul(c(2.0).sub(c(1.5).mul(f))))),
        half.mul(squared.mul(f.sub(c(1.0)))),
    ]
}

/// Samples a level at window coordinates through an [`AffineWarp`].
struct Sampler<'a> {
    target: &'a Level,
    /// Index of the top-left of the 4×4 samples around the middle's pixel.
    corner: isize,
    /// The first column of the matrix: the step in the target per column of the window.
    per_column: [f32; 2],
    /// The second column of the matrix: the step in the target per row of the window.
    per_row: [f32; 2],
    /// The middle's fractional position within its pixel.
    middle: [f32; 2],
}

impl<'a> Sampler<'a> {
    /// `None` if the window leaves the padded image.
    fn new(target: &'a Level, warp: &AffineWarp, radius: usize, row: usize) -> Option<Self> {
        let reach = (row - radius).max(radius) as f64;
        let m = &warp.matrix;
        let pad = target.pad as f64;
        let fits = |middle: f64, a: f64, b: f64, size: usize| {
            // Two more for the kernel, one for the middle's fractional position.
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
            per_column: [m.m11 as f32, m.m21 as f32],
            per_row: [m.m12 as f32, m.m22 as f32],
            middle: [within.x as f32, within.y as f32],
        })
    }

    /// The target coordinates of eight samples along one axis, relative to the middle's pixel: whole
    /// and fractional parts.
    #[inline(always)]
    fn coordinates<V: F32x8>(&self, axis: usize, column: V, row: f32) -> ([i32; LANES], V) {
        let start = self.middle[axis] + self.per_row[axis] * row;
        V::splat(start).add(V::splat(self.per_column[axis]).mul(column)).floor_and_fraction()
    }

    /// Eight samples of a row of the window, by cubic convolution.
    #[inline(always)]
    fn sample<V: F32x8>(&self, column: V, row: f32) -> V {
        let [(ix, fx), (iy, fy)] =
            [self.coordinates(0, column, row), self.coordinates(1, column, row)];
        let stride = self.target.stride as isize;
        let mut first = [0; LANES];
        for (l, first) in first.iter_mut().enumerate() {
            *first = (self.corner + iy[l] as isize * stride + ix[l] as isize) as usize;
        }
        let (x, y) = (catmull_rom(fx), catmull_rom(fy));
        V::gather_4x4(&self.target.value, &first, self.target.stride, x, y)
    }
}
