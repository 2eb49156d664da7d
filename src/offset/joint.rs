//! All pairs together: one offset a clock from redundant pairwise differences.

use super::PairEstimate;
use nalgebra::{DMatrix, DVector};

/// An offset and its standard error, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    pub offset_s: f64,
    pub std_err_s: f64,
}

/// First the least absolute deviations, which a few wrong pairs don't move; they give the scale
/// for weights that fall with the square of the deviation.
const L1_ITERATIONS: usize = 30;
const ROBUST_ITERATIONS: usize = 10;

/// Solves for one offset a clock, the reference's being 0, by least squares with each pair
/// weighted by its information and, robustly, by how it agrees with the rest.
///
/// `clock[c]` is the clock of camera c, 0 the reference's; `None` for clocks that no chain of
/// pairs connects to it. Pairs within one clock say nothing.
pub fn solve(pairs: &[PairEstimate], clock: &[usize], clocks: usize) -> Vec<Option<Solved>> {
    let pairs: Vec<_> = pairs
        .iter()
        .map(|p| (clock[p.cameras[0]], clock[p.cameras[1]], p.offset_s, p.std_err_s))
        .filter(|(a, b, ..)| a != b)
        .collect();
    let connected = connected_to_reference(&pairs, clocks);
    // Row of each connected clock's unknown; the reference has none.
    let mut row = vec![None; clocks];
    let mut unknowns = 0;
    for c in (1..clocks).filter(|&c| connected[c]) {
        row[c] = Some(unknowns);
        unknowns += 1;
    }
    let mut solved = vec![None; clocks];
    solved[0] = Some(Solved { offset_s: 0.0, std_err_s: 0.0 });
    let used: Vec<_> = pairs.into_iter().filter(|(a, ..)| connected[*a]).collect();
    if unknowns == 0 {
        return solved;
    }
    // Errors that all pairs share keep any single one from being believed beyond this share of
    // the typical one.
    let mut errors: Vec<f64> = used.iter().map(|p| p.3).collect();
    errors.sort_by(f64::total_cmp);
    let floor = 0.3 * errors[errors.len() / 2];
    let sigma = |s: f64| s.max(floor).max(f64::MIN_POSITIVE.sqrt());

    let mut x = DVector::zeros(unknowns);
    let mut inverse = DMatrix::zeros(unknowns, unknowns);
    let mut scale: f64 = 1.0;
    for iteration in 0..L1_ITERATIONS + ROBUST_ITERATIONS {
        let mut normal = DMatrix::zeros(unknowns, unknowns);
        let mut right = DVector::zeros(unknowns);
        let value = |c: usize, x: &DVector<f64>| row[c].map_or(0.0, |r| x[r]);
        for &(a, b, offset, std_err) in &used {
            let s = sigma(std_err);
            let z = (offset - (value(b, &x) - value(a, &x))) / (s * scale);
            let robust = if iteration == 0 {
                1.0
            } else if iteration < L1_ITERATIONS {
                1.0 / z.abs().max(0.01)
            } else if z.abs() <= 2.0 {
                1.0
            } else {
                (2.0 / z).powi(2)
            };
            let w = robust / (s * s);
            for (c, sign) in [(b, 1.0), (a, -1.0)] {
                let Some(r) = row[c] else { continue };
                right[r] += sign * w * offset;
                normal[(r, r)] += w;
                if let Some(other) = row[if c == b { a } else { b }] {
                    normal[(r, other)] -= w;
                }
            }
        }
        // Connected to the reference, so positive definite.
        let Some(cholesky) = normal.cholesky() else { return solved };
        let next = cholesky.solve(&right);
        inverse = cholesky.inverse();
        x = next;
        let mut z: Vec<f64> = used
            .iter()
            .map(|&(a, b, o, s)| ((o - (value(b, &x) - value(a, &x))) / sigma(s)).abs())
            .collect();
        z.sort_by(f64::total_cmp);
        // With redundancy, pairs that disagree by more than they claim are all believed less.
        let redundancy = (used.len() as f64 / (used.len() - unknowns).max(1) as f64).sqrt();
        if used.len() > unknowns && iteration + 1 >= L1_ITERATIONS {
            scale = (1.4826 * z[z.len() / 2] * redundancy).max(1.0);
        }
    }
    for c in 1..clocks {
        solved[c] = row[c]
            .map(|r| Solved { offset_s: x[r], std_err_s: scale * inverse[(r, r)].max(0.0).sqrt() });
    }
    solved
}

fn connected_to_reference(pairs: &[(usize, usize, f64, f64)], clocks: usize) -> Vec<bool> {
    let mut connected = vec![false; clocks];
    connected[0] = true;
    loop {
        let before = connected.iter().filter(|c| **c).count();
        for &(a, b, ..) in pairs {
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

    fn pair(a: usize, b: usize, offset_s: f64) -> PairEstimate {
        PairEstimate {
            cameras: [a, b],
            offset_s,
            std_err_s: 1e-4,
            inliers: 100,
            candidates: 200,
            frames: Vec::new(),
        }
    }

    #[test]
    fn consistent_pairs_give_the_offsets_back() {
        let truth = [0.0, 0.01, -0.005, 0.02];
        let pairs: Vec<_> =
            (0..4).flat_map(|a| (a + 1..4).map(move |b| pair(a, b, truth[b] - truth[a]))).collect();
        for (c, s) in solve(&pairs, &[0, 1, 2, 3], 4).into_iter().enumerate() {
            assert!((s.unwrap().offset_s - truth[c]).abs() < 1e-12);
        }
    }

    #[test]
    fn one_wrong_pair_is_outvoted() {
        let truth = [0.0, 0.01, -0.005, 0.02, 0.015];
        let mut pairs: Vec<_> =
            (0..5).flat_map(|a| (a + 1..5).map(move |b| pair(a, b, truth[b] - truth[a]))).collect();
        pairs[2].offset_s += 0.01;
        for (c, s) in solve(&pairs, &[0, 1, 2, 3, 4], 5).into_iter().enumerate() {
            assert!((s.unwrap().offset_s - truth[c]).abs() < 5e-4, "{c} {s:?}");
        }
    }

    #[test]
    fn what_is_not_connected_is_unknown_and_shared_clocks_are_one() {
        let pairs = [pair(0, 1, 0.01), pair(2, 3, 0.02)];
        let solved = solve(&pairs, &[0, 1, 2, 3], 4);
        assert!(solved[1].is_some() && solved[2].is_none() && solved[3].is_none());
        // Cameras 1 and 2 share a clock: camera 3 is reached through it.
        let solved = solve(&pairs, &[0, 1, 1, 2], 3);
        assert!((solved[2].unwrap().offset_s - 0.03).abs() < 1e-12);
        assert_eq!(solve(&[], &[0], 1).len(), 1);
    }
}
