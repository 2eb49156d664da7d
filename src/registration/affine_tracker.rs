//! Beyond the paper: tracking of a window that deforms affinely and changes its gain and bias. The image of a
//! surface patch changes in this way when the patch rotates, tilts, comes nearer or changes its brightness.
//!
//! The method is Baker and Matthews's inverse compositional algorithm (IJCV 56(3), 2004). The template is the
//! window in the source image, at whole pixels. Its derivatives are computed once. The target is sampled by cubic
//! convolution.
//!
//! Known limit: a window across an occluding outline follows the surface with more texture.

use super::gradient::{SCHARR_SCALE, scharr};
use super::pyramid::{Pyramid, PyramidLevel};
use crate::simd::{F32x8, LANES, multiversion};
use nalgebra::{Cholesky, Const, Matrix2, Point2, SMatrix, SVector, Vector2};

/// Half-width of the window, pixels.
const RADIUS_PX: usize = 8;
/// Number of rows of the window.
const SIDE: usize = 2 * RADIUS_PX + 1;
/// Number of samples in a row of the window, padded to a multiple of [`LANES`]. The padding has weight 0.
const ROW: usize = SIDE.next_multiple_of(LANES);
/// Number of samples in the window, including the padding.
const AREA: usize = SIDE * ROW;
/// Standard deviation of the window's Gaussian weights, pixels.
const SIGMA_PX: f64 = 0.6 * RADIUS_PX as f64;
/// Maximum number of Gauss–Newton iterations.
const ITERATIONS: usize = 12;
/// Length of a step below which the tracker has converged, in pixels.
const EPSILON_PX: f64 = 0.02;
/// Standard deviation of the Gaussian prior on each entry of the deformation matrix and on the gain. The prior's mean
/// is the entry of the initial matrix ([`AffineStart::deformation`]), and 1 for the gain.
const DEFORMATION: f64 = 0.1;
/// Maximum distance of the result from the initial guess, pixels.
const MAX_SHIFT_PX: f64 = 5.0;
/// Number of parameters: the shift (2), the entries of the matrix row by row (4), the gain and the bias.
const N: usize = 8;
/// Standard deviation of the noise of grey values, which are in 0..=1. Larger: the prior on the deformation weighs
/// more.
const NOISE: f64 = 0.012;
/// Contribution of the prior to the diagonal of the normal matrix, for the parameters in [`DEFORMED`].
const PRIOR: f64 = (NOISE / DEFORMATION) * (NOISE / DEFORMATION);
/// Indices of the parameters that have a prior: the entries of the matrix, and the gain.
const DEFORMED: std::ops::Range<usize> = 2..7;
/// Maximum gain between two windows. The minimum gain is the inverse.
const MAX_GAIN: f64 = 4.0;

/// A tracker of windows that deform affinely from the source image to the target image. Its buffers are reused from
/// window to window.
#[derive(Debug)]
pub struct AffineTracker {
    /// Column of each sample of a row, relative to the middle of the window.
    column: [f32; ROW],
    gaussian: [f32; AREA],
    /// Weights of the samples: Gaussian, but 0 outside the image.
    weight: [f32; AREA],
    /// Grey values of the template, which is the window in the source image.
    value: [f32; AREA],
    /// Derivatives of the template by x, times the weights.
    weighted_dx: [f32; AREA],
    /// Derivatives of the template by y, times the weights.
    weighted_dy: [f32; AREA],
    /// Values of the template minus `center_value`, times the weights.
    weighted_value: [f32; AREA],
    /// Value of the template at its middle. It is subtracted from the other values for numerical precision.
    center_value: f32,
}

/// A window to track, and the initial guess of its position and deformation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AffineStart {
    /// Middle of the window in the source image, in pixels, with the centre of the top-left pixel at (0.5, 0.5).
    pub from: Point2<f64>,
    /// Initial guess of the middle of the window in the target image, in pixels.
    pub guess: Point2<f64>,
    /// Initial guess of the 2×2 matrix from window coordinates in the source to window coordinates in the target.
    /// Window coordinates are pixels from the window's middle. The prior draws the result towards this matrix.
    pub deformation: Matrix2<f64>,
}

/// The result of tracking a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformed {
    /// Middle of the window in the target image, in pixels.
    pub position: Point2<f64>,
    /// 2×2 matrix from window coordinates in the source to window coordinates in the target. Window coordinates are
    /// pixels from the window's middle.
    pub deformation: Matrix2<f64>,
    /// Weighted mean absolute difference between the grey values (0 to 1) of the windows in the source and the target,
    /// after correction for gain and bias.
    pub residual: f64,
    /// Residual divided by the contrast of the window in the source. The contrast is the mean absolute deviation of
    /// the grey values from their mean. The ratio is 0 for equal windows and near 1 for unrelated windows.
    pub unexplained: f64,
}

/// Two affine maps. One is from window coordinates (pixels from the window's middle) to target coordinates (pixels,
/// with the centre of the first pixel at 0). The other is from the template's grey values to the target's, by gain
/// and bias.
#[derive(Clone, Copy)]
struct AffineWarp {
    middle: Vector2<f64>,
    matrix: Matrix2<f64>,
    gain: f64,
    bias: f64,
}

multiversion! {
    fn track(
        tracker: &mut AffineTracker,
        source: &PyramidLevel,
        target: &PyramidLevel,
        start: &AffineStart,
    ) -> Option<Deformed> = track_by::<V>
}

#[inline(always)]
fn track_by<V: F32x8>(
    tracker: &mut AffineTracker,
    source: &PyramidLevel,
    target: &PyramidLevel,
    &AffineStart { from, guess, deformation }: &AffineStart,
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
    let solver = tracker.load_template::<V>(source, pixel.x as isize, pixel.y as isize)?;
    for _ in 0..ITERATIONS {
        let mut right = tracker.right_hand_side::<V>(target, &warp)?;
        // The prior draws the whole deformation, not only the step, towards the initial deformation. A step deforms
        // the template, which is the inverse of deforming the target; the gain's step is not inverted.
        let a = from_given * warp.matrix - Matrix2::identity();
        for (k, v) in DEFORMED.zip([a.m11, a.m12, a.m21, a.m22, 1.0 - warp.gain]) {
            right[k] += PRIOR * v;
        }
        let step = solver.solve(&right);
        let step_matrix = Matrix2::new(1.0 + step[2], step[3], step[4], 1.0 + step[5]);
        warp.matrix *= step_matrix.try_inverse()?;
        let moved = warp.matrix * Vector2::new(step[0], step[1]);
        warp.middle -= moved;
        warp.bias += warp.gain * (step[7] - f64::from(tracker.center_value) * step[6]);
        warp.gain *= 1.0 + step[6];
        if !(warp.gain > 1.0 / MAX_GAIN && warp.gain < MAX_GAIN) {
            return None;
        }
        if moved.norm() < EPSILON_PX {
            break;
        }
    }
    let position = Point2::from(warp.middle + warp.matrix * offset + Vector2::repeat(0.5));
    if (position - guess).norm() > MAX_SHIFT_PX {
        return None;
    }
    let [residual, unexplained] = tracker.residual::<V>(target, &warp)?;
    Some(Deformed { position, deformation: warp.matrix, residual, unexplained })
}

impl Default for AffineTracker {
    fn default() -> Self {
        let from_middle = |k: usize| k as f64 - RADIUS_PX as f64;
        let gaussian = |k: usize| {
            let (x, y) = (from_middle(k % ROW), from_middle(k / ROW));
            let inside = x <= RADIUS_PX as f64;
            if inside { (-0.5 * (x * x + y * y) / (SIGMA_PX * SIGMA_PX)).exp() as f32 } else { 0.0 }
        };
        let zeros = [0.0; AREA];
        Self {
            column: std::array::from_fn(|x| x as f32 - RADIUS_PX as f32),
            gaussian: std::array::from_fn(gaussian),
            weight: zeros,
            value: zeros,
            weighted_dx: zeros,
            weighted_dy: zeros,
            weighted_value: zeros,
            center_value: 0.0,
        }
    }
}

impl AffineTracker {
    /// Tracks the window around `start.from` in the source image to the target image, on the pyramids' full-sized
    /// levels.
    ///
    /// Returns `None` if a window is outside its image, if the texture does not determine the parameters, or if the
    /// result is implausible: a gain above 4 or below 1/4, or a position more than 5 pixels from `start.guess`.
    pub fn track(
        &mut self,
        source: &Pyramid,
        target: &Pyramid,
        start: &AffineStart,
    ) -> Option<Deformed> {
        track(self, &source.levels[0], &target.levels[0], start)
    }

    /// Returns two values. The first is the weighted mean absolute difference of the grey values (0 to 1) of the
    /// warped target and the template. The second is the first value divided by the template's contrast, which is
    /// the mean absolute deviation of its values from their mean. Returns `None` if the warped window leaves the
    /// padded image.
    #[inline(always)]
    fn residual<V: F32x8>(&self, target: &PyramidLevel, warp: &AffineWarp) -> Option<[f64; 2]> {
        let sampler = Sampler::new(target, warp)?;
        let mut mean = [V::zero(); 2];
        for at in (0..AREA).step_by(LANES) {
            let w = V::load(&self.weight, at);
            accumulate(&mut mean, [V::load(&self.value, at) * w, w]);
        }
        let [sum, weight] = V::sums(&mean);
        if weight <= 0.0 {
            return None;
        }
        let mean = V::splat((sum / weight) as f32);
        let mut sums = [V::zero(); 2];
        for at in (0..AREA).step_by(LANES) {
            let row_from_middle = (at / ROW) as f32 - RADIUS_PX as f32;
            let sampled = sampler.sample(V::load(&self.column, at % ROW), row_from_middle);
            let (value, w) = (V::load(&self.value, at), V::load(&self.weight, at));
            let e = sampled - value;
            accumulate(&mut sums, [e.abs() * w, (value - mean).abs() * w]);
        }
        let [difference, contrast] = V::sums(&sums);
        // The template's contrast is positive, since its texture determined the shift.
        Some([difference / weight, difference / contrast.max(f64::MIN_POSITIVE)])
    }

    /// Reads the template around pixel (`cx`, `cy`), and returns the Cholesky decomposition of its normal matrix.
    /// Returns `None` if the texture does not determine the shift.
    #[inline(always)]
    fn load_template<V: F32x8>(
        &mut self,
        source: &PyramidLevel,
        cx: isize,
        cy: isize,
    ) -> Option<Cholesky<f64, Const<N>>> {
        let r = RADIUS_PX as isize;
        // Samples outside the image are copies of its border, and have weight 0.
        let columns = (r - cx).max(0)..(source.width as isize - cx + r).min(2 * r + 1);
        let rows = (r - cy).max(0)..(source.height as isize - cy + r).min(2 * r + 1);
        self.center_value = source.value[source.index(cx, cy)];
        let (center, scale) = (V::splat(self.center_value), V::splat(1.0 / SCHARR_SCALE));
        let mut moments = Moments::<V, 6, 3>::new();
        for y in 0..2 * r + 1 {
            let out = y as usize * ROW;
            let all = out..out + ROW;
            self.weight[all.clone()].fill(0.0);
            if rows.contains(&y) {
                let inside = out + columns.start as usize..out + columns.end as usize;
                self.weight[inside.clone()].copy_from_slice(&self.gaussian[inside]);
            }
            let at = source.index(cx - r, cy + y - r);
            self.value[all].copy_from_slice(&source.value[at..at + ROW]);
            let mut of_row = Moments::<V, 3, 2>::new();
            for x in (0..ROW).step_by(LANES) {
                let [gx, gy] = scharr::<V>(&source.value, at + x, source.stride);
                let (gx, gy) = (gx * scale, gy * scale);
                let w = V::load(&self.weight, out + x);
                let v = V::load(&self.value, out + x) - center;
                let (wx, wy, wv) = (w * gx, w * gy, w * v);
                of_row.add([gx, gy, v], [wx, wy, wv, w], V::load(&self.column, x));
                wx.store(&mut self.weighted_dx, out + x);
                wy.store(&mut self.weighted_dy, out + x);
                wv.store(&mut self.weighted_value, out + x);
            }
            moments.add_row(&of_row, V::splat((y - r) as f32));
        }
        let mut matrix = moments.matrix();
        for k in DEFORMED {
            matrix[(k, k)] += PRIOR;
        }
        Cholesky::new(matrix)
    }

    /// Returns the right-hand side of the normal equations: for each parameter Σ w·e·(derivative by the parameter).
    /// w is the sample's weight. e is the target's value, corrected for gain and bias, minus the template's value.
    /// Returns `None` if the warped window leaves the padded image.
    #[inline(always)]
    fn right_hand_side<V: F32x8>(
        &self,
        target: &PyramidLevel,
        warp: &AffineWarp,
    ) -> Option<SVector<f64, N>> {
        let sampler = Sampler::new(target, warp)?;
        let mut sums = [V::zero(); N];
        for y in 0..SIDE {
            let at = y * ROW;
            let row_from_middle = y as f32 - RADIUS_PX as f32;
            // Sums over the row of e·w times these factors: the derivative by x; the derivative by y; both
            // derivatives times the column; the derivative by gain; the derivative by bias.
            let mut of_row = [V::zero(); 6];
            for x in (0..ROW).step_by(LANES) {
                let column = V::load(&self.column, x);
                let sampled = sampler.sample(column, row_from_middle);
                let e = sampled - V::load(&self.value, at + x);
                let ex = e * V::load(&self.weighted_dx, at + x);
                let ey = e * V::load(&self.weighted_dy, at + x);
                let ev = e * V::load(&self.weighted_value, at + x);
                let ew = e * V::load(&self.weight, at + x);
                accumulate(&mut of_row, [ex, ey, ex * column, ey * column, ev, ew]);
            }
            let [ex, ey, ex_x, ey_x, ev, ew] = of_row;
            let y = V::splat(row_from_middle);
            accumulate(&mut sums, [ex, ey, ex_x, ex * y, ey_x, ey * y, ev, ew]);
        }
        Some(SVector::from(V::sums(&sums)))
    }
}

#[inline(always)]
fn accumulate<V: F32x8, const M: usize>(sums: &mut [V; M], terms: [V; M]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum = *sum + term;
    }
}

/// Sums over a row or a window from which the normal matrix is built. Each term is the product of a sample's weight,
/// two derivatives, and powers of the sample's coordinates. In the fields, dx and dy are the template's derivatives by
/// x and y. v is the template's value, which is its derivative by gain.
struct Moments<V, const T: usize, const S: usize> {
    /// Sums of dx·dx, dx·dy and dy·dy, each times T powers of the coordinates: 1, x, x² for a row (T = 3); 1, x, y,
    /// x², xy, y² for a window (T = 6).
    tensor: [[V; T]; 3],
    /// Sums of dx·v, dy·v, dx and dy, each times S powers of the coordinates: 1, x for a row (S = 2); 1, x, y for a
    /// window (S = 3).
    shift_light: [[V; S]; 4],
    /// Weighted sums of v², v and 1 over the window.
    light: [V; 3],
}

impl<V: F32x8, const T: usize, const S: usize> Moments<V, T, S> {
    #[inline(always)]
    fn new() -> Self {
        let zero = V::zero();
        Self { tensor: [[zero; T]; 3], shift_light: [[zero; S]; 4], light: [zero; 3] }
    }
}

impl<V: F32x8> Moments<V, 3, 2> {
    /// Adds eight samples of a row, which are at columns `x`. The first argument holds the derivatives by x, y and
    /// gain. The second holds the same derivatives times the weights, and then the weights.
    #[inline(always)]
    fn add(&mut self, [gx, gy, v]: [V; 3], [wx, wy, wv, w]: [V; 4], x: V) {
        for (sums, p) in self.tensor.iter_mut().zip([wx * gx, wx * gy, wy * gy]) {
            let px = p * x;
            accumulate(sums, [p, px, px * x]);
        }
        for (sums, p) in self.shift_light.iter_mut().zip([wx * v, wy * v, wx, wy]) {
            accumulate(sums, [p, p * x]);
        }
        accumulate(&mut self.light, [wv * v, wv, w]);
    }
}

impl<V: F32x8> Moments<V, 6, 3> {
    #[inline(always)]
    fn add_row(&mut self, row: &Moments<V, 3, 2>, y: V) {
        for (sums, &[p, px, pxx]) in self.tensor.iter_mut().zip(&row.tensor) {
            let py = p * y;
            accumulate(sums, [p, px, py, pxx, px * y, py * y]);
        }
        for (sums, &[p, px]) in self.shift_light.iter_mut().zip(&row.shift_light) {
            accumulate(sums, [p, px, p * y]);
        }
        accumulate(&mut self.light, row.light);
    }

    /// Returns the normal matrix of the derivatives dx, dy, x·dx, y·dx, x·dy, y·dy, v, 1.
    #[inline(always)]
    fn matrix(&self) -> SMatrix<f64, N, N> {
        let [a, b, c] = &self.tensor;
        let tensor = [V::sums(a), V::sums(b), V::sums(c)];
        let [a, b, c, d] = &self.shift_light;
        let shift_light = [V::sums(a), V::sums(b), V::sums(c), V::sums(d)];
        let light = V::sums(&self.light);
        // For each of the first six parameters: the index of its derivative among (dx, dy), and the index of its
        // coordinate among (1, x, y).
        const SHIFTS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1), (1, 2)];
        // The index, among 1, x, y, x², xy, y², of the product of two coordinates.
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

/// Returns the Catmull–Rom weights of the samples at −1, 0, 1 and 2 for a position `f` in 0..1. The polynomials are
/// in Horner form. The weights agree with `raster::catmull_rom` to 1e-6.
#[inline(always)]
pub fn catmull_rom<V: F32x8>(f: V) -> [V; 4] {
    let c = V::splat;
    let half = c(0.5);
    let squared = f * f;
    [
        f * (f * (c(1.0) - half * f) - half),
        c(1.0) + squared * (c(1.5) * f - c(2.5)),
        f * (half + f * (c(2.0) - c(1.5) * f)),
        half * (squared * (f - c(1.0))),
    ]
}

/// Sampler of a pyramid level. An [`AffineWarp`] maps window coordinates to the level.
struct Sampler<'a> {
    target: &'a PyramidLevel,
    /// Index of the top-left sample of the 4×4 samples around the pixel that contains the window's middle.
    corner: isize,
    /// Step in the target per column of the window, in pixels: the first column of the matrix.
    per_column: [f32; 2],
    /// Step in the target per row of the window, in pixels: the second column of the matrix.
    per_row: [f32; 2],
    /// Fractional position of the window's middle within its pixel.
    middle: [f32; 2],
    inverse_gain: f32,
    bias: f32,
}

impl<'a> Sampler<'a> {
    /// Creates a sampler of the level. Returns `None` if the warped window leaves the padded image.
    fn new(target: &'a PyramidLevel, warp: &AffineWarp) -> Option<Self> {
        let reach = (ROW - RADIUS_PX) as f64;
        let m = &warp.matrix;
        let pad = target.pad as f64;
        let fits = |middle: f64, a: f64, b: f64, size: usize| {
            // The 3 is 2 for the kernel and 1 for the fractional position of the middle.
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
            inverse_gain: 1.0 / warp.gain as f32,
            bias: warp.bias as f32,
        })
    }

    /// Returns eight samples of a row of the window by cubic convolution, corrected for gain and bias. `row` and
    /// the columns `column` are relative to the window's middle.
    #[inline(always)]
    fn sample<V: F32x8>(&self, column: V, row: f32) -> V {
        // Target coordinates relative to the pixel of the window's middle, as integer and fractional parts.
        let [x0, y0] = [0, 1].map(|axis| self.middle[axis] + self.per_row[axis] * row);
        let [x_step, y_step] = self.per_column;
        let (ix, fx) = (V::splat(x0) + V::splat(x_step) * column).floor_and_fraction();
        let (iy, fy) = (V::splat(y0) + V::splat(y_step) * column).floor_and_fraction();
        let stride = self.target.stride as isize;
        let mut first = [0; LANES];
        for (l, first) in first.iter_mut().enumerate() {
            *first = (self.corner + iy[l] as isize * stride + ix[l] as isize) as usize;
        }
        let (x, y) = (catmull_rom(fx), catmull_rom(fy));
        let value = V::gather_4x4(&self.target.value, &first, self.target.stride, x, y);
        (value - V::splat(self.bias)) * V::splat(self.inverse_gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Scalar;

    #[test]
    fn the_cubic_weights_equal_their_scalar_reference_to_1e_6() {
        let fractions: [f32; LANES] = std::array::from_fn(|l| l as f32 / 8.0);
        let weights = catmull_rom(Scalar::from_array(&fractions)).map(Scalar::to_array);
        for (l, &f) in fractions.iter().enumerate() {
            for (weight, expected) in weights.iter().zip(crate::raster::catmull_rom(f)) {
                assert!((weight[l] - expected).abs() < 1e-6);
            }
        }
    }
}
