//! Standard errors of weighted least-squares estimates from equations with correlated errors.
//!
//! The errors of offset candidates (the offsets that single features imply) are correlated. Candidates at the same
//! instant share the noise of their frames. Candidates at the same place in the image share texture, occlusions and the
//! tracker's bias. The two-way cluster-robust (sandwich) covariance accounts for both correlations (Cameron, Gelbach
//! and Miller 2011). It is the covariance with clusters by time, plus the covariance with clusters by place, minus the
//! covariance for independent errors, which the first two both include. A variance is at least as large as in each of
//! these three covariances.
//!
//! The features of a small body have a common error, such as occlusion at the body's outline. The scatter of these
//! features underestimates this error. Standard errors are therefore inflated if few tracker windows carry all the
//! information ([`std_err_inflation`]).
//!
//! Known limit: an error that all features share at all times does not show in the scatter, and is not included.

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// The lower bound of the degrees of freedom of Student's t-distribution in [`std_err_inflation`].
const MIN_DEGREES: f64 = 0.5;
/// The minimum fraction of a column's squared length that the other columns of the design matrix do not explain. If
/// the fraction is smaller, the normal matrix counts as singular.
const MIN_UNEXPLAINED: f64 = 1e-10;

/// Sandwich covariance of a weighted least-squares problem, accumulated equation by equation.
pub struct Sandwich {
    unknowns: usize,
    normal: DMatrix<f64>,
    independent: DMatrix<f64>,
    by_time: BTreeMap<i64, DVector<f64>>,
    by_place: BTreeMap<usize, DVector<f64>>,
    /// The prior on the unknowns, if there is one.
    prior: Option<Prior>,
}

/// Prior on the unknowns of a least-squares problem. Its error is independent of the errors of all equations.
struct Prior {
    /// The information matrix (inverse covariance) of the prior.
    information: DMatrix<f64>,
    /// The matrix that computes the unknowns of the equations from the unknowns that have the prior.
    transform: DMatrix<f64>,
}

impl Sandwich {
    /// Creates the covariance of a least-squares problem without equations, with the given number of unknowns.
    pub fn new(unknowns: usize) -> Self {
        Self {
            unknowns,
            normal: DMatrix::zeros(unknowns, unknowns),
            independent: DMatrix::zeros(unknowns, unknowns),
            by_time: BTreeMap::new(),
            by_place: BTreeMap::new(),
            prior: None,
        }
    }

    /// Expresses the unknowns x by other unknowns y, where x = `transform` · y. `information` is the information matrix
    /// (inverse covariance) of a prior on y. Variances are still those of x.
    pub fn with_prior(self, transform: &DMatrix<f64>, information: DMatrix<f64>) -> Self {
        let both = |m: DMatrix<f64>| transform.tr_mul(&(m * transform));
        Self {
            unknowns: transform.ncols(),
            normal: both(self.normal) + &information,
            independent: both(self.independent),
            by_time: self.by_time.into_iter().map(|(k, v)| (k, transform.tr_mul(&v))).collect(),
            by_place: self.by_place.into_iter().map(|(k, v)| (k, transform.tr_mul(&v))).collect(),
            prior: Some(Prior { information, transform: transform.clone() }),
        }
    }

    /// Adds one equation. `row` holds the nonzero coefficients of the unknowns as (column, coefficient). `time` and
    /// `place` are the clusters by time and by place to which the equation belongs.
    pub fn add(
        &mut self,
        row: &[(usize, f64)],
        weight: f64,
        residual: f64,
        time: i64,
        place: usize,
    ) {
        let score = weight * residual;
        let zeros = || DVector::zeros(self.unknowns);
        let time = self.by_time.entry(time).or_insert_with(zeros);
        let place = self.by_place.entry(place).or_insert_with(zeros);
        for &(i, x) in row {
            time[i] += score * x;
            place[i] += score * x;
            for &(j, y) in row {
                self.normal[(i, j)] += weight * x * y;
                self.independent[(i, j)] += score * score * x * y;
            }
        }
    }

    /// Returns the inverse of the normal matrix. `None` if the matrix is singular within rounding.
    fn inverse(&self) -> Option<DMatrix<f64>> {
        let scale = self.normal.diagonal().map(f64::sqrt);
        let scales = DMatrix::from_diagonal(&scale.map(f64::recip));
        // The scaled matrix has a unit diagonal. Each squared diagonal entry of its Cholesky factor is the fraction
        // of a column that the columns before it do not explain.
        let cholesky = (&scales * &self.normal * &scales).cholesky()?;
        let unexplained = cholesky.l_dirty().diagonal().map(|d| d * d);
        // A prior also determines unknowns that the equations leave undetermined.
        let is_determined = self.prior.is_some() || unexplained.min() > MIN_UNEXPLAINED;
        is_determined.then(|| &scales * cholesky.inverse() * &scales)
    }

    /// Returns the variance of each unknown. `None` if the equations do not determine the unknowns, or if all
    /// equations are in one cluster by time, so that there is no scatter over time.
    pub fn variances(&self) -> Option<Vec<f64>> {
        if self.by_time.len() < 2 {
            return None;
        }
        let inverse = self.inverse()?;
        let left = match &self.prior {
            Some(prior) => &prior.transform * inverse,
            None => inverse,
        };
        let sandwich = |middle: &DMatrix<f64>| (&left * middle * left.transpose()).diagonal();
        let independent = sandwich(&self.independent);
        let time = sandwich(&clustered(self.by_time.values(), self.unknowns));
        let place = sandwich(&clustered(self.by_place.values(), self.unknowns));
        let prior = self.prior.as_ref().map(|prior| sandwich(&prior.information));
        Some(
            (0..left.nrows())
                .map(|k| {
                    let both = time[k] + place[k] - independent[k];
                    let scatter = both.max(time[k]).max(place[k]).max(independent[k]);
                    scatter + prior.as_ref().map_or(0.0, |prior| prior[k])
                })
                .collect(),
        )
    }
}

/// Returns the effective number of independent clusters (Kish 1965): (Σ I)² / Σ I², where I is the information of a
/// cluster; 0 if all information is 0. `informed` yields items (cluster, information). The information of a cluster is
/// the sum over its items.
pub fn effective_number(informed: impl Iterator<Item = (usize, f64)>) -> f64 {
    let mut by_key: BTreeMap<usize, f64> = BTreeMap::new();
    for (key, information) in informed {
        *by_key.entry(key).or_default() += information;
    }
    let sum: f64 = by_key.values().sum();
    let squares: f64 = by_key.values().map(|i| i * i).sum();
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

/// Returns the factor by which to multiply a standard error that was estimated from the scatter of `independent`
/// independent clusters. The square of the factor is a variance inflation factor.
///
/// The factor is the ratio of the quantiles of Student's t-distribution and of the Gaussian at two standard errors,
/// by a series expansion (Abramowitz and Stegun 26.7.5). It decreases to 1 for many clusters, and is constant below
/// 1.5 clusters.
pub fn std_err_inflation(independent: f64) -> f64 {
    let n = (independent - 1.0).max(MIN_DEGREES);
    let x: f64 = 2.0;
    let orders = [
        (x.powi(3) + x) / 4.0,
        (5.0 * x.powi(5) + 16.0 * x.powi(3) + 3.0 * x) / 96.0,
        (3.0 * x.powi(7) + 19.0 * x.powi(5) + 17.0 * x.powi(3) - 15.0 * x) / 384.0,
    ];
    1.0 + (orders[0] / n + orders[1] / (n * n) + orders[2] / (n * n * n)) / x
}

/// Returns the sum `Σ g gᵀ` over the score vectors g of all clusters, times n / (n − 1) for n clusters. The score
/// vector of a cluster is the sum of `weight · residual · row` over its equations ([`Sandwich::add`]). The factor
/// n / (n − 1) corrects for a small number of clusters.
fn clustered<'a>(
    scores: impl ExactSizeIterator<Item = &'a DVector<f64>>,
    unknowns: usize,
) -> DMatrix<f64> {
    let n = scores.len() as f64;
    let correction = n / (n - 1.0).max(1.0);
    let zero = DMatrix::zeros(unknowns, unknowns);
    scores.fold(zero, |sum, g| sum + g * g.transpose()) * correction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Checks samples with correlated errors. Every sample has an error that all samples of its time share, an error
    /// that all samples of its place share, and an independent error. Over 1500 problems, the variance of the samples'
    /// mean equals the estimated variance.
    #[test]
    fn correlated_errors_are_accounted_for() {
        let random = &mut Random::new(4);
        let (mut squares, mut estimated) = (0.0, 0.0);
        let problems = 1500;
        for _ in 0..problems {
            let by_time: Vec<f64> = (0..12).map(|_| 0.3 * random.gaussian()).collect();
            let by_place: Vec<f64> = (0..16).map(|_| 0.4 * random.gaussian()).collect();
            let errors: Vec<f64> = (0..12 * 16)
                .map(|k| by_time[k / 16] + by_place[k % 16] + random.gaussian())
                .collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let mut sandwich = Sandwich::new(1);
            for (k, e) in errors.iter().enumerate() {
                sandwich.add(&[(0, 1.0)], 2.0, e - mean, (k / 16) as i64, k % 16);
            }
            squares += mean * mean;
            estimated += sandwich.variances().unwrap()[0];
        }
        let ratio = estimated / squares;
        assert!((0.88..1.2).contains(&ratio), "{ratio}");
    }

    #[test]
    fn few_independent_windows_inflate_the_standard_error() {
        // Quantiles of Student's t-distribution at 97.725 %. The Gaussian quantile at 97.725 % is two standard
        // errors.
        for (independent, quantile) in [(3.0, 4.53), (4.0, 3.31), (6.0, 2.65), (11.0, 2.28)] {
            let off = 2.0 * std_err_inflation(independent) / quantile - 1.0;
            assert!(off.abs() < 0.1, "{independent}: {off}");
        }
        assert!(std_err_inflation(1e9) < 1.0 + 1e-6);
        assert!(std_err_inflation(0.0) == std_err_inflation(1.0) && std_err_inflation(1.0) > 10.0);
        assert_eq!(effective_number([(7, 2.0), (3, 2.0), (7, 0.0)].into_iter()), 2.0);
        assert!((effective_number([(0, 9.0), (1, 1.0)].into_iter()) - 100.0 / 82.0).abs() < 1e-12);
        assert_eq!(effective_number(std::iter::empty()), 0.0);
    }

    #[test]
    fn undetermined_unknowns_have_no_variance() {
        assert_eq!(Sandwich::new(1).variances(), None);
        let mut one_instant = Sandwich::new(1);
        one_instant.add(&[(0, 1.0)], 1.0, 0.1, 0, 0);
        one_instant.add(&[(0, 1.0)], 1.0, -0.1, 0, 1);
        assert_eq!(one_instant.variances(), None);
        let mut one_place = Sandwich::new(2);
        for (time, residual) in [(0, 0.1), (1, -0.1)] {
            one_place.add(&[(0, 1.0), (1, 3.0)], 1.0, residual, time, 0);
        }
        assert_eq!(one_place.variances(), None);
    }
}
