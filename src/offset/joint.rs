//! Solves for all clocks together: the offset of every clock, and the rate of every clock that drifts, by robust
//! weighted least squares over all pairs of cameras.
//!
//! This goes beyond the paper, which averages each camera's offset relative to the reference camera. The solution
//! starts with least absolute deviations, by iteratively reweighted least squares (IRLS). Further iterations use
//! redescending weights: a pair with a large deviation has a weight proportional to the inverse square of its
//! deviation. The variance of each unknown is the larger one of the cluster-robust variance ([`Sandwich`]) and the
//! variance that the pairs' disagreement implies.
//!
//! Known limit: a clock's rate is constant over the whole recording.

use super::clock::{ClockEstimate, ClockModel};
use super::pair::PairEstimate;
use super::recording::Sample;
use super::uncertainty::Sandwich;
use crate::capture::MAX_DRIFT_PPM;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// The clocks for which the joint solution is computed. Clock 0 is the reference camera's clock, whose offset and rate
/// are 0.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockLayout {
    /// The index of each camera's clock, by camera.
    pub of_camera: Vec<usize>,
    /// The time of each camera's first frame on the camera's own clock, seconds, by camera. The offset of a clock is
    /// defined at this time.
    pub first_s: Vec<f64>,
    /// Whether the rate of each clock is an unknown, by clock.
    pub drifts: Vec<bool>,
    /// The frame period, seconds. For the cluster-robust variance, offset candidates whose times round to the same
    /// multiple of the period form a cluster by time.
    pub frame_s: f64,
}

/// The number of IRLS iterations that minimize absolute deviations, which makes the solution robust to a few wrong
/// pairs.
const L1_ITERATIONS: usize = 30;
/// The number of IRLS iterations with redescending weights, after the iterations for absolute deviations.
const ROBUST_ITERATIONS: usize = 10;
/// The lower bound of the deviation of a pair's offset from the joint solution, in units of the pair's standard error.
/// It applies in the IRLS iterations for absolute deviations, where a pair's weight is the inverse of its deviation,
/// and so limits the weight.
const MIN_L1_DEVIATION: f64 = 0.01;
/// The deviation of a pair's offset from the joint solution up to which the pair's weight is 1 in the iterations with
/// redescending weights, in units of the pair's standard error.
const FULL_WEIGHT_DEVIATION: f64 = 2.0;
/// The lower bound of a pair's standard error, as a fraction of the median standard error of all pairs. Errors that are
/// common to all pairs limit the precision of every pair.
const MIN_STD_ERR_FRACTION: f64 = 0.3;
/// The standard deviation of the prior on every clock's rate, whose mean is 0, seconds per second: three times the
/// maximum drift.
const RATE_PRIOR: f64 = 3.0 * (1e-6 * MAX_DRIFT_PPM);
/// The ratio of a Gaussian's standard deviation to its median absolute deviation.
const SIGMA_OVER_MAD: f64 = 1.4826;

/// Solves for all clocks by robust weighted least squares over the offset candidates of all pairs.
///
/// Each pair is weighted by its information, and by a robust weight that depends on the pair's deviation from the
/// solution. The result has an estimate for each clock, `None` for a clock that no chain of pairs connects to the
/// reference camera's clock. Pairs of cameras that share a clock are ignored. A clock's offset is defined at the
/// first frame of its first camera.
///
/// If `factor` is given, calibration errors are unknowns too. `factor` is the matrix L, where L Lᵀ is the covariance of
/// these errors.
pub fn solve_clocks(
    pairs: &[PairEstimate],
    clocks: &ClockLayout,
    factor: Option<&DMatrix<f64>>,
) -> SolvedClocks {
    let mut pairs: Vec<&PairEstimate> = pairs.iter().collect();
    pairs.retain(|p| clocks.of_camera[p.cameras[0]] != clocks.of_camera[p.cameras[1]]);
    let connected = connected_to_reference(&pairs, clocks);
    let mut used = pairs;
    used.retain(|p| connected[clocks.of_camera[p.cameras[0]]]);
    let mut by_clock = vec![None; clocks.drifts.len()];
    by_clock[0] = Some(ClockEstimate::default());
    let errors = DVector::zeros(factor.map_or(0, DMatrix::nrows));
    let of_prior = |k, _| factor.map_or(0.0, |f| f.row(k).norm());
    let error_std_errs = DVector::from_fn(errors.len(), of_prior);
    let mut solved = SolvedClocks { by_clock, errors, error_std_errs };
    let unknowns = Unknowns::new(clocks, &connected, factor);
    if used.is_empty() {
        return solved;
    }
    let mut std_errs: Vec<f64> = used.iter().map(|p| p.std_err_s).collect();
    std_errs.sort_by(f64::total_cmp);
    let min_sigma_s = MIN_STD_ERR_FRACTION * std_errs[std_errs.len() / 2];
    let systems: Vec<PairSystem> =
        used.iter().map(|p| PairSystem::new(p, &unknowns, min_sigma_s)).collect();
    let Some(solution) = solve_robustly(&systems, &unknowns) else { return solved };
    let variances = solution.variances(&used, &systems, &unknowns);
    solved.errors = solution.x.rows_range(unknowns.clock_count..).into_owned();
    let of_errors = variances[unknowns.clock_count..].iter().map(|v| v.sqrt());
    solved.error_std_errs = DVector::from_iterator(solved.errors.len(), of_errors);
    for (clock, solved) in solved.by_clock.iter_mut().enumerate().skip(1) {
        let Some(offset) = unknowns.offset[clock] else { continue };
        let rate = unknowns.rate[clock];
        let camera = clocks.of_camera.iter().position(|c| *c == clock);
        let model = ClockModel {
            offset_s: solution.x[offset],
            rate: rate.map_or(0.0, |r| solution.x[r]),
            reference_s: camera.map_or(0.0, |c| clocks.first_s[c]),
            ..ClockModel::default()
        };
        *solved = Some(ClockEstimate {
            clock: model,
            std_err_s: variances[offset].sqrt(),
            rate_std_err: rate.map_or(0.0, |r| variances[r].sqrt()),
        });
    }
    solved
}

/// Joint solution for all clocks and for the calibration errors.
pub struct SolvedClocks {
    /// The estimate of each clock, by clock. `None` for a clock that no chain of pairs connects to the reference
    /// camera's clock.
    pub by_clock: Vec<Option<ClockEstimate>>,
    /// The estimated errors of the calibration and of readout times, in the order of the rows of their covariance; empty
    /// if they are not among the unknowns.
    pub errors: DVector<f64>,
    /// The standard error of each of `errors`; that of its prior if no pair is used.
    pub error_std_errs: DVector<f64>,
}

/// Columns of the unknowns in the normal matrix of the joint solution: first the offsets and rates of the clocks, then
/// the calibration errors.
struct Unknowns<'a> {
    clocks: &'a ClockLayout,
    /// The column of each clock's offset, by clock. `None` for the reference camera's clock, and for a clock that no
    /// chain of pairs connects to it.
    offset: Vec<Option<usize>>,
    /// The column of each clock's rate, by clock. `None` for the reference camera's clock, for a clock that no chain
    /// of pairs connects to it, and for a clock that does not drift.
    rate: Vec<Option<usize>>,
    /// The number of unknown offsets and rates of the clocks.
    clock_count: usize,
    count: usize,
    /// The matrix that computes all unknowns from independent unknowns. It leaves the clocks' offsets and rates as they
    /// are. It combines the correlated calibration errors from independent unknowns of variance 1. `None` if the
    /// calibration is assumed to be exact.
    from_independent: Option<DMatrix<f64>>,
}

/// One equation's row of the design matrix: the nonzero entries as (column, coefficient).
type EquationRow = Vec<(usize, f64)>;

fn dot(row: &EquationRow, x: &DVector<f64>) -> f64 {
    row.iter().map(|&(c, f)| f * x[c]).sum()
}

impl<'a> Unknowns<'a> {
    fn new(clocks: &'a ClockLayout, connected: &[bool], factor: Option<&DMatrix<f64>>) -> Self {
        let mut count = 0;
        let mut next = |is_unknown: bool| {
            is_unknown.then(|| {
                count += 1;
                count - 1
            })
        };
        let n = clocks.drifts.len();
        let offset = (0..n).map(|c| next(c > 0 && connected[c])).collect();
        let rate = (0..n).map(|c| next(c > 0 && connected[c] && clocks.drifts[c])).collect();
        let from_independent = factor.map(|factor| {
            let (rows, columns) = factor.shape();
            let mut whole = DMatrix::identity(count + rows, count + columns);
            whole.view_mut((count, count), (rows, columns)).copy_from(factor);
            whole
        });
        let clock_count = count;
        let count = clock_count + factor.map_or(0, DMatrix::nrows);
        Self { clocks, offset, rate, clock_count, count, from_independent }
    }

    /// Returns whether each pair has a single observation equation, for its estimated offset. If rates or calibration
    /// errors are unknown, each offset candidate has its own equation instead.
    fn is_one_equation(&self) -> bool {
        self.rate.iter().all(Option::is_none) && self.from_independent.is_none()
    }

    /// Returns the information matrix (inverse covariance) of the prior on the independent unknowns. Its diagonal is
    /// 0 for the clocks' unknowns, and 1 for the unknowns of variance 1 from which the calibration errors are
    /// combined. `independent` is the number of independent unknowns.
    fn prior(&self, independent: usize) -> DMatrix<f64> {
        let is_calibration = |k| if k < self.clock_count { 0.0 } else { 1.0 };
        DMatrix::from_diagonal(&DVector::from_fn(independent, |k, _| is_calibration(k)))
    }

    /// Returns the design matrix's row for the offset candidate with index `sample` of a pair.
    fn sample_row(&self, pair: &PairEstimate, sample: usize) -> EquationRow {
        let s = &pair.samples[sample].0;
        let mut row = self.row(s.cameras, s.time_a_s, s.time_b_s);
        if self.from_independent.is_some() {
            let slopes = pair.slopes.of(sample);
            row.extend(slopes.map(|(error, slope)| (self.clock_count + error, slope)));
        }
        row
    }

    /// Solves the normal equations. Returns the solution and the inverse of the normal matrix. `None` if the matrix
    /// is singular.
    fn solve(
        &self,
        normal: DMatrix<f64>,
        right: &DVector<f64>,
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let Some(transform) = &self.from_independent else {
            let cholesky = normal.cholesky()?;
            return Some((cholesky.solve(right), cholesky.inverse()));
        };
        let normal = transform.tr_mul(&(normal * transform)) + self.prior(transform.ncols());
        let cholesky = normal.cholesky()?;
        let x = transform * cholesky.solve(&transform.tr_mul(right));
        Some((x, transform * cholesky.inverse() * transform.transpose()))
    }

    /// Returns the design matrix's row for an observation of `offset_b − offset_a`. `time_a_s` and `time_b_s` are the
    /// times at which the offsets of a and b are taken, seconds, each on the camera's own clock.
    fn row(&self, [a, b]: [usize; 2], time_a_s: f64, time_b_s: f64) -> EquationRow {
        let mut row = Vec::with_capacity(4);
        for (camera, sign, time_s) in [(b, 1.0, time_b_s), (a, -1.0, time_a_s)] {
            let clock = self.clocks.of_camera[camera];
            let elapsed_s = time_s - self.clocks.first_s[camera];
            row.extend(self.offset[clock].map(|column| (column, sign)));
            row.extend(self.rate[clock].map(|column| (column, sign * elapsed_s)));
        }
        row
    }
}

/// One pair's contribution to the normal equations, summed over its observation equations. There is one equation for
/// each offset candidate, or a single one for the pair's estimated offset.
struct PairSystem {
    /// The entries of the pair's normal matrix by (row, column). The matrix is sparse, since dense matrices for all
    /// pairs of a large array would take gigabytes.
    normal: BTreeMap<(usize, usize), f64>,
    right: DVector<f64>,
    /// The weighted mean of the pair's observation equations: the coefficients of the unknowns, and the observed mean
    /// of `offset_j − offset_i`, seconds, where i and j are the pair's cameras.
    mean: (DVector<f64>, f64),
    /// The standard error of the observed mean offset, seconds.
    sigma_s: f64,
    /// The factor that scales the total information of the pair's offset candidates to `1 / sigma_s²`.
    factor: f64,
}

/// Solution of the normal equations after all IRLS iterations.
struct RobustSolution {
    x: DVector<f64>,
    /// The robust weight of each pair of cameras.
    weights: Vec<f64>,
    /// The inverse of the normal matrix. If the errors of the pairs were independent, and their standard errors
    /// correct, it would be the covariance of the unknowns.
    inverse: DMatrix<f64>,
    /// The robust standard deviation of the pairs' deviations from the solution, in units of the pairs' standard
    /// errors; at least 1.
    scale: f64,
}

/// Solves the normal equations by iteratively reweighted least squares (IRLS). `None` if the normal matrix is
/// singular.
fn solve_robustly(systems: &[PairSystem], unknowns: &Unknowns) -> Option<RobustSolution> {
    let n = unknowns.count;
    let mut solution: Option<RobustSolution> = None;
    for iteration in 0..L1_ITERATIONS + ROBUST_ITERATIONS {
        let weight = |z: f64| match iteration {
            0 => 1.0,
            k if k < L1_ITERATIONS => 1.0 / z.max(MIN_L1_DEVIATION),
            _ if z <= FULL_WEIGHT_DEVIATION => 1.0,
            _ => (FULL_WEIGHT_DEVIATION / z).powi(2),
        };
        let weights: Vec<f64> = match &solution {
            Some(s) => systems.iter().map(|p| weight(p.deviation(&s.x) / s.scale)).collect(),
            None => vec![1.0; systems.len()],
        };
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for rate in unknowns.rate.iter().flatten() {
            normal[(*rate, *rate)] += 1.0 / (RATE_PRIOR * RATE_PRIOR);
        }
        for (system, w) in systems.iter().zip(&weights) {
            for (entry, v) in &system.normal {
                normal[*entry] += v * w;
            }
            right += &system.right * *w;
        }
        // The matrix is positive definite, since all clocks are connected to the reference.
        let (x, inverse) = unknowns.solve(normal, &right)?;
        let mut z: Vec<f64> = systems.iter().map(|p| p.deviation(&x)).collect();
        z.sort_by(f64::total_cmp);
        // If the pairs deviate by more than their standard errors, and there are more equations than unknowns, all
        // standard errors are scaled up.
        let equations_per_pair = if unknowns.rate.iter().any(Option::is_some) { 2 } else { 1 };
        let degrees_of_freedom =
            (equations_per_pair * systems.len()).saturating_sub(unknowns.clock_count);
        let scale = if degrees_of_freedom > 0 && iteration + 1 >= L1_ITERATIONS {
            let redundancy =
                ((equations_per_pair * systems.len()) as f64 / degrees_of_freedom as f64).sqrt();
            (SIGMA_OVER_MAD * z[z.len() / 2] * redundancy).max(1.0)
        } else {
            1.0
        };
        solution = Some(RobustSolution { x, weights, inverse, scale });
    }
    solution
}

/// Normal matrix of one pair while equations are added to it: a dense matrix over the few unknowns of the pair's two
/// cameras.
#[derive(Default)]
struct PairNormal {
    /// The columns of the pair's unknowns in the joint normal matrix, in the order of their first occurrence.
    columns: Vec<usize>,
    /// The rows of the pair's normal matrix. Rows and columns are in the order of `columns`.
    entries: Vec<Vec<f64>>,
}

impl PairNormal {
    /// Adds an equation to the normal matrix. The equation has the given row of the design matrix and the given weight.
    fn add(&mut self, row: &EquationRow, weight: f64) {
        let own: Vec<(usize, f64)> = row.iter().map(|&(c, x)| (self.local(c), x)).collect();
        for &(i, x) in &own {
            for &(j, y) in &own {
                self.entries[i][j] += weight * x * y;
            }
        }
    }

    /// Returns the index in `columns` of the unknown with the given column of the joint normal matrix. Appends the
    /// unknown if it is not there yet.
    fn local(&mut self, column: usize) -> usize {
        if let Some(place) = self.columns.iter().position(|c| *c == column) {
            return place;
        }
        self.columns.push(column);
        let count = self.columns.len();
        self.entries.push(Vec::new());
        self.entries.iter_mut().for_each(|row| row.resize(count, 0.0));
        count - 1
    }

    /// Returns the entries of the matrix, multiplied by `factor`, by (row, column) of the joint normal matrix.
    fn scaled(&self, factor: f64) -> BTreeMap<(usize, usize), f64> {
        let entries = self.entries.iter().zip(&self.columns).flat_map(|(row, &i)| {
            row.iter().zip(&self.columns).map(move |(value, &j)| ((i, j), value * factor))
        });
        entries.collect()
    }
}

impl PairSystem {
    fn new(pair: &PairEstimate, unknowns: &Unknowns, min_sigma_s: f64) -> Self {
        let n = unknowns.count;
        let (mut normal, mut mean_row) = (PairNormal::default(), DVector::zeros(n));
        let (mut total, mut mean_value, mut right) = (0.0, 0.0, DVector::zeros(n));
        let mut add = |row: &EquationRow, value: f64, sign: f64, weight: f64| {
            for &(i, x) in row {
                mean_row[i] += weight * sign * x;
                right[i] += weight * x * value;
            }
            normal.add(row, weight);
            mean_value += weight * sign * value;
            total += weight;
        };
        if pair.samples.is_empty() || unknowns.is_one_equation() {
            let (time_i_s, offset_s) = (pair.clock.reference_s, pair.clock.offset_s);
            add(&unknowns.row(pair.cameras, time_i_s, time_i_s - offset_s), offset_s, 1.0, 1.0);
        } else {
            for (k, (s, weight)) in pair.samples.iter().enumerate() {
                let sign = if s.cameras == pair.cameras { 1.0 } else { -1.0 };
                let row = unknowns.sample_row(pair, k);
                add(&row, s.offset_s(), sign, weight * s.across_px_s * s.across_px_s);
            }
        }
        let sigma_s = pair.std_err_s.max(min_sigma_s).max(f64::MIN_POSITIVE.sqrt());
        // The total is positive, since a pair without information has no estimate.
        let factor = 1.0 / (sigma_s * sigma_s * total);
        Self {
            normal: normal.scaled(factor),
            right: right * factor,
            mean: (mean_row / total, mean_value / total),
            sigma_s,
            factor,
        }
    }

    /// Returns the absolute difference between the pair's observed mean offset and the mean offset that the unknowns
    /// `x` imply, in units of the pair's standard error.
    fn deviation(&self, x: &DVector<f64>) -> f64 {
        (self.mean.1 - self.mean.0.dot(x)).abs() / self.sigma_s
    }
}

impl RobustSolution {
    /// Returns the variance of each unknown. It is the larger one of two variances: the cluster-robust
    /// variance, with clusters by time and by place over all pairs, and the variance that the pairs' disagreement
    /// implies. The variance of an unknown with a prior is at most the prior's.
    fn variances(
        &self,
        used: &[&PairEstimate],
        systems: &[PairSystem],
        unknowns: &Unknowns,
    ) -> Vec<f64> {
        let n = unknowns.count;
        let mut sandwich = Sandwich::new(n);
        let frame_s = unknowns.clocks.frame_s;
        for (k, pair) in used.iter().enumerate() {
            // The pair's weight in the solution is divided among its candidates.
            let factor = systems[k].factor * self.weights[k];
            let information = |(s, w): &(Sample, f64)| w * s.across_px_s.powi(2);
            let total: f64 = pair.samples.iter().map(information).sum();
            let scale = if unknowns.is_one_equation() { factor / total } else { factor };
            for (index, sample) in pair.samples.iter().enumerate() {
                let s = &sample.0;
                let row = unknowns.sample_row(pair, index);
                let clock = unknowns.clocks.of_camera[s.cameras[0]];
                let common_s = s.time_a_s + unknowns.offset[clock].map_or(0.0, |c| self.x[c]);
                let bin = (common_s / frame_s).round() as i64;
                let residual = pair.std_err_inflation * (s.offset_s() - dot(&row, &self.x));
                sandwich.add(&row, scale * information(sample), residual, bin, s.cell);
            }
        }
        if let Some(transform) = &unknowns.from_independent {
            sandwich = sandwich.with_prior(transform, unknowns.prior(transform.ncols()));
        }
        let clustered = sandwich.variances();
        let of_prior = |c: usize| match &unknowns.from_independent {
            Some(transform) if c >= unknowns.clock_count => transform.row(c).norm_squared(),
            _ => f64::INFINITY,
        };
        (0..n)
            .map(|c| {
                let independent = self.inverse[(c, c)].max(0.0) * self.scale * self.scale;
                clustered.as_ref().map_or(independent, |v| v[c].max(independent)).min(of_prior(c))
            })
            .collect()
    }
}

/// Returns, for each clock, whether a chain of pairs connects it to the reference camera's clock.
fn connected_to_reference(pairs: &[&PairEstimate], clocks: &ClockLayout) -> Vec<bool> {
    let mut connected = vec![false; clocks.drifts.len()];
    connected[0] = true;
    let mut changed = true;
    while changed {
        changed = false;
        for pair in pairs {
            let [a, b] = pair.cameras.map(|c| clocks.of_camera[c]);
            changed |= connected[a] != connected[b];
            connected[a] |= connected[b];
            connected[b] = connected[a];
        }
    }
    connected
}

#[cfg(test)]
mod tests;
