//! All pairs together: one clock's offset, and its rate where it drifts, from redundant pairwise
//! samples.

use super::pair::PairEstimate;
use super::uncertainty::Sandwich;
use crate::capture::MAX_DRIFT_PPM;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// What is solved for: the clocks, the reference's being 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Clocks {
    /// The clock of each camera,
    pub of_camera: Vec<usize>,
    /// and the time of each camera's first frame, where its drift starts.
    pub first_s: Vec<f64>,
    /// Whether each clock drifts.
    pub drifts: Vec<bool>,
    /// A frame, seconds: errors within one go together.
    pub frame_s: f64,
}

/// An offset and its standard error, seconds; the rate and its own.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Solved {
    pub offset_s: f64,
    pub std_err_s: f64,
    pub rate: f64,
    pub rate_std_err: f64,
}

/// First the least absolute deviations, which a few wrong pairs don't move; they give the scale
/// for weights that fall with the square of the deviation.
const L1_ITERATIONS: usize = 30;
const ROBUST_ITERATIONS: usize = 10;
/// Prior standard deviation of a rate, three times the largest drift. It keeps a rate that no pair
/// shows finite, and pulls an observed one by a thousandth of its standard error at most. Larger: the
/// system of a rate without data is singular to rounding. Smaller: it pulls the rates that are there.
const PRIOR_RATE_STD: f64 = 3.0 * (1e-6 * MAX_DRIFT_PPM);

/// Solves for every clock by least squares over all samples, each pair weighted by its information
/// and, robustly, by how it agrees with the rest.
///
/// `None` for clocks that no chain of pairs connects to the reference. Pairs within one clock say
/// nothing.
pub fn solve(pairs: &[PairEstimate], clocks: &Clocks) -> Vec<Option<Solved>> {
    let count = clocks.drifts.len();
    let between = |p: &&PairEstimate| {
        let [a, b] = p.cameras.map(|c| clocks.of_camera[c]);
        a != b
    };
    let pairs: Vec<&PairEstimate> = pairs.iter().filter(between).collect();
    let connected = connected_to_reference(&pairs, clocks);
    let used: Vec<&PairEstimate> =
        pairs.into_iter().filter(|p| connected[clocks.of_camera[p.cameras[0]]]).collect();
    let mut solved = vec![None; count];
    solved[0] = Some(Solved::default());
    let unknowns = Unknowns::new(clocks, &connected);
    if used.is_empty() {
        return solved;
    }
    let systems = systems(&used, &unknowns);
    let Some(solution) = robust(&systems, &unknowns) else { return solved };
    let variances = solution.variances(&used, &systems, &unknowns);
    for (clock, solved) in solved.iter_mut().enumerate().skip(1) {
        let Some(offset) = unknowns.offset[clock] else { continue };
        let rate = unknowns.rate[clock];
        *solved = Some(Solved {
            offset_s: solution.x[offset],
            std_err_s: variances[offset].sqrt(),
            rate: rate.map_or(0.0, |r| solution.x[r]),
            rate_std_err: rate.map_or(0.0, |r| variances[r].sqrt()),
        });
    }
    solved
}

/// Which column is whose.
struct Unknowns<'a> {
    clocks: &'a Clocks,
    /// By clock.
    offset: Vec<Option<usize>>,
    rate: Vec<Option<usize>>,
    count: usize,
}

/// One equation: up to four columns and their factors.
struct Row {
    entries: [(usize, f64); 4],
    len: usize,
}

impl Row {
    fn entries(&self) -> &[(usize, f64)] {
        &self.entries[..self.len]
    }

    fn times(&self, x: &DVector<f64>) -> f64 {
        self.entries().iter().map(|&(c, f)| f * x[c]).sum()
    }
}

impl<'a> Unknowns<'a> {
    fn new(clocks: &'a Clocks, connected: &[bool]) -> Self {
        let mut count = 0;
        let mut next = |wanted: bool| {
            wanted.then(|| {
                count += 1;
                count - 1
            })
        };
        let n = clocks.drifts.len();
        let offset = (0..n).map(|c| next(c > 0 && connected[c])).collect();
        let rate = (0..n).map(|c| next(c > 0 && connected[c] && clocks.drifts[c])).collect();
        Self { clocks, offset, rate, count }
    }

    /// `offset_b − offset_a` at times on their clocks.
    fn row(&self, [a, b]: [usize; 2], time_a_s: f64, time_b_s: f64) -> Row {
        let mut row = Row { entries: [(0, 0.0); 4], len: 0 };
        for (camera, sign, time_s) in [(b, 1.0, time_b_s), (a, -1.0, time_a_s)] {
            let clock = self.clocks.of_camera[camera];
            let since = time_s - self.clocks.first_s[camera];
            for (column, factor) in [(self.offset[clock], 1.0), (self.rate[clock], since)] {
                if let Some(column) = column {
                    row.entries[row.len] = (column, sign * factor);
                    row.len += 1;
                }
            }
        }
        row
    }
}

/// A pair's part of the normal equations.
struct System {
    /// By row and column, of its own unknowns: all of them, squared, for each of a large array's pairs
    /// are gigabytes.
    normal: BTreeMap<(usize, usize), f64>,
    right: DVector<f64>,
    /// The mean equation of its samples: what it says on the whole,
    mean: (DVector<f64>, f64),
    sigma_s: f64,
    /// and what its samples' information is multiplied with so that it is `1 / sigma_s²`.
    factor: f64,
}

fn systems(used: &[&PairEstimate], unknowns: &Unknowns) -> Vec<System> {
    // Errors that all pairs share keep any single one from being believed beyond this share of
    // the typical one.
    let mut errors: Vec<f64> = used.iter().map(|p| p.std_err_s).collect();
    errors.sort_by(f64::total_cmp);
    let floor = 0.3 * errors[errors.len() / 2];
    used.iter().map(|p| system(p, unknowns, floor)).collect()
}

fn system(pair: &PairEstimate, unknowns: &Unknowns, floor: f64) -> System {
    let n = unknowns.count;
    let (mut normal, mut mean_row) = (BTreeMap::new(), DVector::zeros(n));
    let (mut total, mut mean_value, mut right) = (0.0, 0.0, DVector::zeros(n));
    let mut add = |row: &Row, value: f64, sign: f64, weight: f64| {
        for &(i, x) in row.entries() {
            mean_row[i] += weight * sign * x;
            right[i] += weight * x * value;
            for &(j, y) in row.entries() {
                *normal.entry((i, j)).or_default() += weight * x * y;
            }
        }
        mean_value += weight * sign * value;
        total += weight;
    };
    // Without rates a pair says one number, however it was found.
    let one_number = pair.samples.is_empty() || unknowns.rate.iter().all(Option::is_none);
    if one_number {
        let time_j_s = pair.center_s - pair.offset_s;
        add(&unknowns.row(pair.cameras, pair.center_s, time_j_s), pair.offset_s, 1.0, 1.0);
    } else {
        for (s, weight) in pair.samples.iter() {
            let sign = if s.cameras == pair.cameras { 1.0 } else { -1.0 };
            let row = unknowns.row(s.cameras, s.time_a_s, s.time_b_s);
            add(&row, s.offset_s(), sign, weight * s.across_px_s * s.across_px_s);
        }
    }
    let sigma_s = pair.std_err_s.max(floor).max(f64::MIN_POSITIVE.sqrt());
    // Positive: an estimate without information is none.
    let factor = 1.0 / (sigma_s * sigma_s * total);
    normal.values_mut().for_each(|v: &mut f64| *v *= factor);
    System {
        normal,
        right: right * factor,
        mean: (mean_row / total, mean_value / total),
        sigma_s,
        factor,
    }
}

struct Solution {
    x: DVector<f64>,
    /// Each pair's robust weight, 0 to 1.
    weights: Vec<f64>,
    /// Pairs with independent errors would have this covariance.
    inverse: DMatrix<f64>,
    /// By how much more pairs disagree than they claim, at least 1.
    scale: f64,
}

fn robust(systems: &[System], unknowns: &Unknowns) -> Option<Solution> {
    let n = unknowns.count;
    let mut found: Option<Solution> = None;
    for iteration in 0..L1_ITERATIONS + ROBUST_ITERATIONS {
        let weight = |z: f64| match iteration {
            0 => 1.0,
            k if k < L1_ITERATIONS => 1.0 / z.max(0.01),
            _ if z <= 2.0 => 1.0,
            _ => (2.0 / z).powi(2),
        };
        let weights: Vec<f64> = match &found {
            Some(s) => systems.iter().map(|p| weight(p.deviation(&s.x) / s.scale)).collect(),
            None => vec![1.0; systems.len()],
        };
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for rate in unknowns.rate.iter().flatten() {
            normal[(*rate, *rate)] += 1.0 / (PRIOR_RATE_STD * PRIOR_RATE_STD);
        }
        for (system, w) in systems.iter().zip(&weights) {
            for (place, v) in &system.normal {
                normal[*place] += v * w;
            }
            right += &system.right * *w;
        }
        // Connected to the reference, so positive definite.
        let cholesky = normal.cholesky()?;
        let x = cholesky.solve(&right);
        let mut z: Vec<f64> = systems.iter().map(|p| p.deviation(&x)).collect();
        z.sort_by(f64::total_cmp);
        // With redundancy, pairs that disagree by more than they claim are all believed less.
        let of_each = if unknowns.rate.iter().any(Option::is_some) { 2 } else { 1 };
        let spare = (of_each * systems.len()).saturating_sub(n);
        let scale = if spare > 0 && iteration + 1 >= L1_ITERATIONS {
            let redundancy = ((of_each * systems.len()) as f64 / spare as f64).sqrt();
            (1.4826 * z[z.len() / 2] * redundancy).max(1.0)
        } else {
            1.0
        };
        found = Some(Solution { x, weights, inverse: cholesky.inverse(), scale });
    }
    found
}

impl System {
    /// How far the pair is from a solution, in its standard errors.
    fn deviation(&self, x: &DVector<f64>) -> f64 {
        (self.mean.1 - self.mean.0.dot(x)).abs() / self.sigma_s
    }
}

impl Solution {
    /// Each unknown's variance: what the scatter of all samples says, errors of one instant and of
    /// one place going together in all pairs, or what the pairs' disagreement does, if that is more.
    fn variances(
        &self,
        used: &[&PairEstimate],
        systems: &[System],
        unknowns: &Unknowns,
    ) -> Vec<f64> {
        let n = unknowns.count;
        let mut sandwich = Sandwich::new(n);
        let frame_s = unknowns.clocks.frame_s;
        for (k, pair) in used.iter().enumerate() {
            // What the pair weighs in the solution, shared out among its samples.
            let factor = systems[k].factor * self.weights[k];
            let one_number = unknowns.rate.iter().all(Option::is_none);
            let information = |(s, w): &(super::film::Sample, f64)| w * s.across_px_s.powi(2);
            let total: f64 = pair.samples.iter().map(information).sum();
            let share = if one_number { factor / total } else { factor };
            for sample in pair.samples.iter() {
                let s = &sample.0;
                let row = unknowns.row(s.cameras, s.time_a_s, s.time_b_s);
                let clock = unknowns.clocks.of_camera[s.cameras[0]];
                let common_s = s.time_a_s + unknowns.offset[clock].map_or(0.0, |c| self.x[c]);
                let bin = (common_s / frame_s).round() as i64;
                let residual = pair.doubt * (s.offset_s() - row.times(&self.x));
                sandwich.add(row.entries(), share * information(sample), residual, bin, s.cell);
            }
        }
        let clustered = sandwich.variances();
        (0..n)
            .map(|c| {
                let claimed = self.inverse[(c, c)].max(0.0) * self.scale * self.scale;
                clustered.as_ref().map_or(claimed, |v| v[c].max(claimed))
            })
            .collect()
    }
}

fn connected_to_reference(pairs: &[&PairEstimate], clocks: &Clocks) -> Vec<bool> {
    let mut connected = vec![false; clocks.drifts.len()];
    connected[0] = true;
    loop {
        let before = connected.iter().filter(|c| **c).count();
        for pair in pairs {
            let [a, b] = pair.cameras.map(|c| clocks.of_camera[c]);
            let either = connected[a] || connected[b];
            connected[a] = either;
            connected[b] = either;
        }
        if connected.iter().filter(|c| **c).count() == before {
            return connected;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offset::film::Sample;
    use crate::random::Random;

    fn pair(a: usize, b: usize, offset_s: f64) -> PairEstimate {
        PairEstimate { cameras: [a, b], offset_s, std_err_s: 1e-4, ..PairEstimate::default() }
    }

    fn clocks(of_camera: &[usize], count: usize) -> Clocks {
        Clocks {
            of_camera: of_camera.into(),
            first_s: vec![0.0; of_camera.len()],
            drifts: vec![false; count],
            frame_s: 0.04,
        }
    }

    fn all_pairs(truth: &[f64]) -> Vec<PairEstimate> {
        let n = truth.len();
        (0..n).flat_map(|a| (a + 1..n).map(move |b| pair(a, b, truth[b] - truth[a]))).collect()
    }

    #[test]
    fn consistent_pairs_give_the_offsets_back() {
        let truth = [0.0, 0.01, -0.005, 0.02];
        let solved = solve(&all_pairs(&truth), &clocks(&[0, 1, 2, 3], 4));
        for (c, s) in solved.into_iter().enumerate() {
            assert!((s.unwrap().offset_s - truth[c]).abs() < 1e-12);
        }
    }

    #[test]
    fn one_wrong_pair_is_outvoted() {
        let truth = [0.0, 0.01, -0.005, 0.02, 0.015];
        let mut pairs = all_pairs(&truth);
        pairs[2].offset_s += 0.01;
        for (c, s) in solve(&pairs, &clocks(&[0, 1, 2, 3, 4], 5)).into_iter().enumerate() {
            assert!((s.unwrap().offset_s - truth[c]).abs() < 5e-4, "{c} {s:?}");
        }
    }

    #[test]
    fn what_is_not_connected_is_unknown_and_shared_clocks_are_one() {
        let pairs = [pair(0, 1, 0.01), pair(2, 3, 0.02)];
        let solved = solve(&pairs, &clocks(&[0, 1, 2, 3], 4));
        assert!(solved[1].is_some() && solved[2].is_none() && solved[3].is_none());
        // Cameras 1 and 2 share a clock: camera 3 is reached through it.
        let solved = solve(&pairs, &clocks(&[0, 1, 1, 2], 3));
        assert!((solved[2].unwrap().offset_s - 0.03).abs() < 1e-12);
        assert_eq!(solve(&[], &clocks(&[0], 1)).len(), 1);
    }

    /// Hundreds of random drifting triples of cameras: offset and rate come back within their
    /// standard errors, which are those that the noise gives.
    #[test]
    fn rates_are_found_with_their_errors() {
        let random = &mut Random::new(5);
        let (mut squares, mut n) = ([0.0; 2], 0.0);
        for _ in 0..300 {
            let mut clocks = clocks(&[0, 1, 2], 3);
            clocks.drifts = vec![false, true, true];
            clocks.first_s = vec![0.0, 0.3, -0.2];
            let truth: Vec<(f64, f64)> = (0..3)
                .map(|c| {
                    if c == 0 {
                        (0.0, 0.0)
                    } else {
                        (0.02 * random.gaussian(), 1e-4 * random.gaussian())
                    }
                })
                .collect();
            let ahead = |c: usize, t: f64| truth[c].0 + truth[c].1 * (t - clocks.first_s[c]);
            let pairs: Vec<PairEstimate> = [[0, 1], [1, 2], [0, 2]]
                .iter()
                .map(|&[a, b]| PairEstimate {
                    samples: (0..400)
                        .map(|k| {
                            let time_b_s = 0.5 + 0.04 * f64::from(k / 4);
                            // Rates are small: one step finds the time on a's clock.
                            let guess = time_b_s + ahead(b, time_b_s);
                            let noise = 0.2 * random.gaussian() / 150.0;
                            let time_a_s = guess - ahead(a, guess - ahead(a, guess)) + noise;
                            let cameras = [a, b];
                            let cell = (random.unit() * 40.0) as usize;
                            let sample = Sample {
                                cameras,
                                time_a_s,
                                time_b_s,
                                across_px_s: 150.0,
                                cell,
                                window: cell,
                            };
                            (sample, 25.0)
                        })
                        .collect(),
                    center_s: 2.5,
                    std_err_s: 0.2 / 150.0 / 20.0,
                    doubt: 1.0,
                    ..pair(a, b, 0.0)
                })
                .collect();
            let solved = solve(&pairs, &clocks);
            for c in [1, 2] {
                let s = solved[c].unwrap();
                squares[0] += ((s.offset_s - truth[c].0) / s.std_err_s).powi(2);
                squares[1] += ((s.rate - truth[c].1) / s.rate_std_err).powi(2);
                n += 1.0;
                assert!(s.rate_std_err < 5e-4 && s.std_err_s < 1e-3, "{s:?}");
            }
        }
        for z in squares.map(|s| (s / n).sqrt()) {
            assert!((0.6..1.15).contains(&z), "{z}");
        }
    }
}
