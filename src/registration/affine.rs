//! The last, sub-pixel step of a track: the window as a patch of a surface that turns, tilts, comes
//! nearer and changes its light, where Lucas and Kanade's only moves.
//!
//! Baker and Matthews's inverse compositional method (IJCV 56(3), 2004): the source's window is
//! the template, at whole pixels, and its derivatives are taken once; the target is sampled by
//! cubic convolution. The window may be larger than the translation's, whose size is limited by
//! the deformation that it ignores: that is what beats the noise.
//!
//! Known limit: a window across an outline follows the body that has more texture in it.

use super::lanes::{LANES, Lanes, add, lanes, multiply, sum_lanes};
use super::pyramid::Level;
use crate::raster::catmull_rom;
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
    pub fn refine(
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
            self.take_template(source, pixel.x as usize, pixel.y as usize, options)?;
        for _ in 0..options.iterations {
            let mut right = self.mismatch(target, &warp)?;
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
    fn take_template(
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
        let mut moments = Moments::default();
        for y in 0..2 * r + 1 {
            let out = y as usize * self.row;
            let all = out..out + self.row;
            self.weight[all.clone()].fill(0.0);
            if rows.contains(&y) {
                let used = out + columns.start as usize..out + columns.end as usize;
                self.weight[used.clone()].copy_from_slice(&self.fall_off[used]);
            }
            let at = source.index(cx - r, cy + y - r);
            self.value[all.clone()].copy_from_slice(&source.value[at..at + self.row]);
            let mut of_row = RowMoments::default();
            for x in (0..self.row).step_by(LANES) {
                let (gx, gy) = (lanes(&source.dx, at + x), lanes(&source.dy, at + x));
                let w = lanes(&self.weight, out + x);
                let v: Lanes = std::array::from_fn(|l| self.value[out + x + l] - self.mean);
                let (wx, wy, wv) = (multiply(w, gx), multiply(w, gy), multiply(w, &v));
                let column = from_middle(x, self.radius);
                of_row.add(&[gx, gy, &v], [&wx, &wy, &wv, w], &column);
                self.weighted_dx[out + x..out + x + LANES].copy_from_slice(&wx);
                self.weighted_dy[out + x..out + x + LANES].copy_from_slice(&wy);
                self.weighted_value[out + x..out + x + LANES].copy_from_slice(&wv);
            }
            moments.add(&of_row, (y - r) as f32);
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
    fn mismatch(&self, target: &Level, warp: &Warp) -> Option<SVector<f64, N>> {
        let (gain, bias) = (1.0 / warp.gain as f32, warp.bias as f32);
        let sampler = Sampler::new(target, warp, self.radius, self.row)?;
        let mut sums = [[0.0_f32; LANES]; N];
        for y in 0..2 * self.radius + 1 {
            let at = y * self.row;
            let down = y as f32 - self.radius as f32;
            // Shift x, y; their moments along the row; value; one.
            let mut of_row = [[0.0_f32; LANES]; 6];
            for x in (0..self.row).step_by(LANES) {
                let column = from_middle(x, self.radius);
                let found = sampler.sample(&column, down);
                let value = lanes(&self.value, at + x);
                let e: Lanes = std::array::from_fn(|l| (found[l] - bias) * gain - value[l]);
                let ex = multiply(&e, lanes(&self.weighted_dx, at + x));
                let ey = multiply(&e, lanes(&self.weighted_dy, at + x));
                let ev = multiply(&e, lanes(&self.weighted_value, at + x));
                let ew = multiply(&e, lanes(&self.weight, at + x));
                let terms = [ex, ey, multiply(&ex, &column), multiply(&ey, &column), ev, ew];
                for (sum, term) in of_row.iter_mut().zip(terms) {
                    *sum = add(sum, &term);
                }
            }
            let [ex, ey, ex_x, ey_x, ev, ew] = of_row;
            let terms = [ex, ey, ex_x, scaled(&ex, down), ey_x, scaled(&ey, down), ev, ew];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum = add(sum, &term);
            }
        }
        Some(SVector::from(sums.map(sum_lanes)))
    }
}

#[inline(always)]
fn scaled(a: &Lanes, factor: f32) -> Lanes {
    a.map(|v| v * factor)
}

/// Columns of eight samples, counted from the window's middle.
#[inline(always)]
fn from_middle(x: usize, radius: usize) -> Lanes {
    std::array::from_fn(|l| (x + l) as f32 - radius as f32)
}

/// Sums over a row of the products of two derivatives (with their moments along the row).
#[derive(Default)]
struct RowMoments {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, x².
    tensor: [[Lanes; 3]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x.
    mixed: [[Lanes; 2]; 4],
    /// v·v, v, 1.
    light: [Lanes; 3],
}

impl RowMoments {
    /// Derivatives by the position and the gain, and the same weighted, with the weights.
    #[inline(always)]
    fn add(&mut self, [gx, gy, v]: &[&Lanes; 3], [wx, wy, wv, w]: [&Lanes; 4], x: &Lanes) {
        let pairs = [(wx, *gx), (wx, *gy), (wy, *gy)];
        for (sums, (a, b)) in self.tensor.iter_mut().zip(pairs) {
            let p = multiply(a, b);
            let px = multiply(&p, x);
            let pxx = multiply(&px, x);
            for (sum, term) in sums.iter_mut().zip([p, px, pxx]) {
                *sum = add(sum, &term);
            }
        }
        let products = [multiply(wx, v), multiply(wy, v), *wx, *wy];
        for (sums, p) in self.mixed.iter_mut().zip(products) {
            sums[0] = add(&sums[0], &p);
            sums[1] = add(&sums[1], &multiply(&p, x));
        }
        for (sum, term) in self.light.iter_mut().zip([multiply(wv, v), *wv, *w]) {
            *sum = add(sum, &term);
        }
    }
}

/// The same over the window: each times x^i y^j.
#[derive(Default)]
struct Moments {
    /// dx·dx, dx·dy, dy·dy, each times 1, x, y, x², xy, y².
    tensor: [[Lanes; 6]; 3],
    /// dx·v, dy·v, dx, dy, each times 1, x, y.
    mixed: [[Lanes; 3]; 4],
    light: [Lanes; 3],
}

impl Moments {
    #[inline(always)]
    fn add(&mut self, row: &RowMoments, y: f32) {
        for (sums, [p, px, pxx]) in self.tensor.iter_mut().zip(&row.tensor) {
            let py = scaled(p, y);
            let terms = [*p, *px, py, *pxx, scaled(px, y), scaled(&py, y)];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum = add(sum, &term);
            }
        }
        for (sums, [p, px]) in self.mixed.iter_mut().zip(&row.mixed) {
            for (sum, term) in sums.iter_mut().zip([*p, *px, scaled(p, y)]) {
                *sum = add(sum, &term);
            }
        }
        for (sum, term) in self.light.iter_mut().zip(row.light) {
            *sum = add(sum, &term);
        }
    }

    /// Derivatives in the order of the parameters: dx, dy, x·dx, y·dx, x·dy, y·dy, v, 1.
    fn matrix(&self) -> SMatrix<f64, N, N> {
        let tensor = self.tensor.map(|t| t.map(sum_lanes));
        let mixed = self.mixed.map(|t| t.map(sum_lanes));
        let light = self.light.map(sum_lanes);
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
    base: isize,
    /// Target from window: the columns of the matrix, and the middle within its pixel.
    across: [f32; 2],
    down: [f32; 2],
    middle: [f32; 2],
}

/// Window coordinates and their images stay above the negative of this, so that cutting off
/// decimals is rounding down.
const ABOVE: f32 = 128.0;

impl<'a> Sampler<'a> {
    /// `None` if the window leaves the padded image.
    fn new(target: &'a Level, warp: &Warp, radius: usize, row: usize) -> Option<Self> {
        let reach = (row - radius).max(radius) as f64;
        let m = &warp.matrix;
        let pad = target.pad as f64;
        let fits = |middle: f64, a: f64, b: f64, size: usize| {
            // Two more for the kernel, one for the middle's decimals.
            let extent = reach * (a.abs() + b.abs()) + 3.0;
            extent < f64::from(ABOVE)
                && middle - extent >= -pad
                && middle + extent <= size as f64 + pad - 1.0
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
            base: target.index(whole.x as isize, whole.y as isize) as isize,
            across: [m.m11 as f32, m.m21 as f32],
            down: [m.m12 as f32, m.m22 as f32],
            middle: [within.x as f32, within.y as f32],
        })
    }

    /// Eight samples by cubic convolution.
    #[inline(always)]
    fn sample(&self, column: &Lanes, down: f32) -> Lanes {
        let place = |axis: usize| -> ([i32; LANES], Lanes) {
            let start = self.middle[axis] + self.down[axis] * down;
            let at: Lanes = std::array::from_fn(|l| start + self.across[axis] * column[l]);
            let whole = at.map(|v| (v + ABOVE) as i32 - ABOVE as i32);
            (whole, std::array::from_fn(|l| at[l] - whole[l] as f32))
        };
        let ((ix, fx), (iy, fy)) = (place(0), place(1));
        std::array::from_fn(|l| {
            let (wx, wy) = (catmull_rom(fx[l]), catmull_rom(fy[l]));
            let stride = self.target.stride;
            let first =
                (self.base + (iy[l] as isize - 1) * stride as isize + ix[l] as isize - 1) as usize;
            let mut columns = [0.0_f32; 4];
            for (row, w) in wy.into_iter().enumerate() {
                let from = first + row * stride;
                let values: &[f32; 4] =
                    self.target.value[from..].first_chunk().expect("the border is wide enough");
                columns = std::array::from_fn(|c| columns[c] + w * values[c]);
            }
            (columns[0] * wx[0] + columns[1] * wx[1]) + (columns[2] * wx[2] + columns[3] * wx[3])
        })
    }
}
