//! Standard errors that hold where errors are not independent.
//!
//! Candidates share errors: those of one instant share frames and their noise, those of one place
//! share texture, occlusions and the tracker's bias over time. The covariance of a weighted
//! least-squares estimate is the sandwich of scores summed over such clusters, here over both
//! kinds (Cameron, Gelbach and Miller 2011: by time, plus by place, minus what both counted).
//!
//! A small body errs as one: what is wrong with it (its outline before what rests, the few corners
//! that all its features sit on) scatters less than it is off by. So scores count more where few
//! windows' worth of pixels tell all ([`doubt`]).

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Rows of a least-squares problem, accumulated.
pub struct Sandwich {
    unknowns: usize,
    normal: DMatrix<f64>,
    independent: DMatrix<f64>,
    by_time: BTreeMap<i64, DVector<f64>>,
    by_place: BTreeMap<usize, DVector<f64>>,
}

impl Sandwich {
    pub fn new(unknowns: usize) -> Self {
        Self {
            unknowns,
            normal: DMatrix::zeros(unknowns, unknowns),
            independent: DMatrix::zeros(unknowns, unknowns),
            by_time: BTreeMap::new(),
            by_place: BTreeMap::new(),
        }
    }

    /// One row: its entries that aren't 0, weight, residual, and its clusters.
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

    /// The normal matrix's inverse; `None` where columns depend on each other, to rounding.
    fn inverse(&self) -> Option<DMatrix<f64>> {
        let scale = self.normal.diagonal().map(f64::sqrt);
        let scales = DMatrix::from_diagonal(&scale.map(f64::recip));
        // Ones on its diagonal: what is left of each after the others is its own share.
        let cholesky = (&scales * &self.normal * &scales).cholesky()?;
        let own = cholesky.l_dirty().diagonal().map(|d| d * d);
        (own.min() > 1e-10).then(|| &scales * cholesky.inverse() * &scales)
    }

    /// Each unknown's variance. `None` if they are not determined, or one instant alone saw them:
    /// then there is nothing to tell their errors from.
    pub fn variances(&self) -> Option<Vec<f64>> {
        if self.by_time.len() < 2 {
            return None;
        }
        let inverse = self.inverse()?;
        let around = |middle: &DMatrix<f64>| (&inverse * middle * &inverse).diagonal();
        let independent = around(&self.independent);
        let time = around(&summed(self.by_time.values(), self.unknowns));
        let place = around(&summed(self.by_place.values(), self.unknowns));
        Some(
            (0..self.unknowns)
                .map(|k| {
                    let both = time[k] + place[k] - independent[k];
                    both.max(time[k]).max(place[k]).max(independent[k])
                })
                .collect(),
        )
    }
}

/// How many equally informed ones tell as much as these, each known by its key and its information
/// (Kish 1965); 0 if none tells anything.
pub fn effective_number(informed: impl Iterator<Item = (usize, f64)>) -> f64 {
    let mut by_key: BTreeMap<usize, f64> = BTreeMap::new();
    for (key, information) in informed {
        *by_key.entry(key).or_default() += information;
    }
    let sum: f64 = by_key.values().sum();
    let squares: f64 = by_key.values().map(|i| i * i).sum();
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

/// By how much longer error bars must be that are told from the scatter of this many independent
/// things: Student's quantile, over that of certain ones, where two standard errors are (its
/// expansion, Abramowitz and Stegun 26.7.5).
pub fn doubt(independent: f64) -> f64 {
    let n = (independent - 1.0).max(MIN_DEGREES);
    let x: f64 = 2.0;
    let orders = [
        (x.powi(3) + x) / 4.0,
        (5.0 * x.powi(5) + 16.0 * x.powi(3) + 3.0 * x) / 96.0,
        (3.0 * x.powi(7) + 19.0 * x.powi(5) + 17.0 * x.powi(3) - 15.0 * x) / 384.0,
    ];
    1.0 + (orders[0] / n + orders[1] / (n * n) + orders[2] / (n * n * n)) / x
}

/// Degrees of freedom: with fewer, bars would have no end.
const MIN_DEGREES: f64 = 0.5;

/// `Σ g gᵀ` over the clusters, corrected for their number. (Student's wider tails for few clusters,
/// tried too, made the error bars of filmed scenes a third too long.)
fn summed<'a>(
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

    /// A mean whose samples share an error by time and one by place: its scatter over thousands of
    /// problems is the variance that it is given.
    #[test]
    fn shared_errors_are_counted() {
        let random = &mut Random::new(4);
        let (mut squares, mut claimed) = (0.0, 0.0);
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
            claimed += sandwich.variances().unwrap()[0];
        }
        let ratio = claimed / squares;
        assert!((0.88..1.2).contains(&ratio), "{ratio}");
    }

    #[test]
    fn few_independent_windows_are_doubted() {
        // Student's quantiles at 97.725 %, over two.
        for (independent, quantile) in [(3.0, 4.53), (4.0, 3.31), (6.0, 2.65), (11.0, 2.28)] {
            let off = 2.0 * doubt(independent) / quantile - 1.0;
            assert!(off.abs() < 0.1, "{independent}: {off}");
        }
        assert!(doubt(1e9) < 1.0 + 1e-6 && doubt(0.0) == doubt(1.0) && doubt(1.0) > 10.0);
        assert_eq!(effective_number([(7, 2.0), (3, 2.0), (7, 0.0)].into_iter()), 2.0);
        assert!((effective_number([(0, 9.0), (1, 1.0)].into_iter()) - 100.0 / 82.0).abs() < 1e-12);
        assert_eq!(effective_number(std::iter::empty()), 0.0);
    }

    #[test]
    fn what_is_not_determined_has_no_variance() {
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
