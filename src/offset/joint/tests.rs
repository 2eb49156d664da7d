//! Tests of joint solutions for pairs with known offsets.

use super::*;
use crate::offset::recording::Sight;
use crate::random::Random;

fn pair(a: usize, b: usize, offset_s: f64) -> PairEstimate {
    let clock = ClockModel::constant(offset_s);
    PairEstimate { cameras: [a, b], clock, std_err_s: 1e-4, ..PairEstimate::default() }
}

fn clocks(of_camera: &[usize], count: usize) -> ClockLayout {
    ClockLayout {
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

fn by_clock(pairs: &[PairEstimate], clocks: &ClockLayout) -> Vec<Option<ClockEstimate>> {
    solve_clocks(pairs, clocks, None).by_clock
}

#[test]
fn consistent_pairs_give_the_offsets_back() {
    let truth = [0.0, 0.01, -0.005, 0.02];
    let solved = by_clock(&all_pairs(&truth), &clocks(&[0, 1, 2, 3], 4));
    for (c, s) in solved.into_iter().enumerate() {
        assert!((s.unwrap().clock.offset_s - truth[c]).abs() < 1e-12);
    }
}

#[test]
fn one_wrong_pair_has_no_influence() {
    let truth = [0.0, 0.01, -0.005, 0.02, 0.015];
    let mut pairs = all_pairs(&truth);
    pairs[2].clock.offset_s += 0.01;
    for (c, s) in by_clock(&pairs, &clocks(&[0, 1, 2, 3, 4], 5)).into_iter().enumerate() {
        assert!((s.as_ref().unwrap().clock.offset_s - truth[c]).abs() < 5e-4, "{c} {s:?}");
    }
}

#[test]
fn unconnected_clocks_are_unknown_and_shared_clocks_are_one() {
    let pairs = [pair(0, 1, 0.01), pair(2, 3, 0.02)];
    let solved = by_clock(&pairs, &clocks(&[0, 1, 2, 3], 4));
    assert!(solved[1].is_some() && solved[2].is_none() && solved[3].is_none());
    // Cameras 1 and 2 share a clock, through which camera 3 is connected.
    let solved = by_clock(&pairs, &clocks(&[0, 1, 1, 2], 3));
    assert!((solved[2].as_ref().unwrap().clock.offset_s - 0.03).abs() < 1e-12);
    assert_eq!(by_clock(&[], &clocks(&[0], 1)).len(), 1);
}

/// Checks that the errors of offsets and rates agree with their standard errors, in 300 random triples of cameras with
/// drift.
#[test]
fn rates_and_their_standard_errors_are_estimated() {
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
        let offset_at = |c: usize, t: f64| truth[c].0 + truth[c].1 * (t - clocks.first_s[c]);
        let pairs: Vec<PairEstimate> = [[0, 1], [1, 2], [0, 2]]
            .iter()
            .map(|&[a, b]| PairEstimate {
                samples: (0..400)
                    .map(|k| {
                        let time_b_s = 0.5 + 0.04 * f64::from(k / 4);
                        // Rates are so small that one fixed-point iteration gives the time on a's clock.
                        let common_s = time_b_s + offset_at(b, time_b_s);
                        let noise = 0.2 * random.gaussian() / 150.0;
                        let time_a_s =
                            common_s - offset_at(a, common_s - offset_at(a, common_s)) + noise;
                        let cameras = [a, b];
                        let cell = (random.unit() * 40.0) as usize;
                        let sample = Sample {
                            cameras,
                            time_a_s,
                            time_b_s,
                            across_px_s: 150.0,
                            cell,
                            window: cell,
                            sight: Sight::default(),
                        };
                        (sample, 25.0)
                    })
                    .collect(),
                clock: ClockModel { reference_s: 2.5, ..ClockModel::default() },
                std_err_s: 0.2 / 150.0 / 20.0,
                std_err_inflation: 1.0,
                ..pair(a, b, 0.0)
            })
            .collect();
        let solved = by_clock(&pairs, &clocks);
        for c in [1, 2] {
            let s = solved[c].clone().unwrap();
            squares[0] += ((s.clock.offset_s - truth[c].0) / s.std_err_s).powi(2);
            squares[1] += ((s.clock.rate - truth[c].1) / s.rate_std_err).powi(2);
            n += 1.0;
            assert!(s.rate_std_err < 5e-4 && s.std_err_s < 1e-3, "{s:?}");
        }
    }
    for z in squares.map(|s| (s / n).sqrt()) {
        assert!((0.6..1.15).contains(&z), "{z}");
    }
}
