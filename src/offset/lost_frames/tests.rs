//! Tests of clock models that are fitted to simulated timing observations.

use super::descent::fit_clock_models;
use super::fit::INLIER_BOUND_FRAMES;
use super::{FittedClock, TimingObservation};
use crate::offset::clock::{ClockModel, NominalClock};
use crate::random::Random;

const FRAME_S: f64 = 1.0 / 30.0;

/// Simulated recordings of a row of cameras, all of the same duration. Each camera is observed together with its two
/// neighbours on either side.
struct Recordings {
    times_s: Vec<Vec<f64>>,
    true_models: Vec<ClockModel>,
    drifts: bool,
}

impl Recordings {
    fn new(random: &mut Random, lost_before: Vec<Vec<usize>>, count: usize, drifts: bool) -> Self {
        let true_models: Vec<ClockModel> = lost_before
            .into_iter()
            .enumerate()
            .map(|(c, lost_before)| ClockModel {
                offset_s: if c == 0 { 0.0 } else { 0.9 * random.signed() * FRAME_S },
                rate: if c == 0 || !drifts { 0.0 } else { 3e-4 * random.gaussian() },
                lost_before,
                ..ClockModel::default()
            })
            .collect();
        let images = |m: &ClockModel| count - m.lost_before.len();
        let times = |m: &ClockModel| (0..images(m)).map(|n| n as f64 * FRAME_S).collect();
        Self { times_s: true_models.iter().map(times).collect(), true_models, drifts }
    }

    fn clocks(&self) -> Vec<NominalClock<'_>> {
        (self.times_s.iter().enumerate())
            .map(|(c, times_s)| NominalClock {
                times_s,
                frame_s: FRAME_S,
                may_lose_frames: true,
                drifts: self.drifts && c != 0,
            })
            .collect()
    }

    /// Returns all timing observations, with noise. `outlier_fraction` is the fraction of them that are outliers,
    /// wrong by up to two frames.
    fn observations(&self, random: &mut Random, outlier_fraction: f64) -> Vec<TimingObservation> {
        let clocks = self.clocks();
        let all: Vec<Vec<f64>> =
            self.true_models.iter().zip(&clocks).map(|(m, clock)| m.image_times_s(clock)).collect();
        let mut observations = Vec::new();
        for a in 0..all.len() {
            for b in (0..all.len()).filter(|b| *b != a && b.abs_diff(a) < 3) {
                for k in 0..all[a].len() - 1 {
                    let (start, end) = (all[a][k], all[a][k + 1]);
                    let Some(m) = all[b].iter().position(|t| *t >= start && *t <= end) else {
                        continue;
                    };
                    let error_frames = match random.unit() < outlier_fraction {
                        true => (4.0 * random.unit()).floor() - 2.0,
                        false => 0.0,
                    };
                    let fraction = (all[b][m] - start) / (end - start)
                        + error_frames
                        + 0.02 * random.gaussian();
                    observations.push(TimingObservation {
                        cameras: [a, b],
                        images: [k, m],
                        fraction,
                    });
                }
            }
        }
        observations
    }

    fn fit(&self, observations: &[TimingObservation]) -> Vec<Option<FittedClock>> {
        fit_clock_models(&self.clocks(), 0, observations)
    }
}

#[test]
fn no_loss_is_invented_among_hundreds_of_recordings_with_outliers() {
    let random = &mut Random::new(8);
    for n in 0..300 {
        let cameras = 2 + n % 4;
        let recordings = Recordings::new(random, vec![Vec::new(); cameras], 8 + n % 40, n % 2 == 0);
        let observations = recordings.observations(random, 0.03);
        for (model, truth) in recordings.fit(&observations).into_iter().zip(&recordings.true_models)
        {
            let model = model.unwrap();
            // With two cameras, both observations at an end of the recording may be outliers that agree with each
            // other.
            assert!(model.clock.lost_before.is_empty() || model.undecided, "{n}: {model:?}");
            let error = (model.clock.offset_s - truth.offset_s) / FRAME_S;
            assert!(error.abs() < 0.1, "{n}: {error} frame");
        }
    }
}

/// Checks that all simulated losses are found or reported as undecided, also those of the reference camera. Losses are
/// five frames apart, since two cameras that lose a frame at the same time leave no trace.
#[test]
fn all_losses_of_hundreds_of_recordings_are_found() {
    let random = &mut Random::new(9);
    let (mut lost_frames, mut ambiguous) = (0, 0);
    for n in 0..300 {
        let (cameras, count) = (2 + n % 4, 16 + n % 30);
        let mut lost = vec![Vec::new(); cameras];
        for frame in (3..count - 4).step_by(5) {
            let c = (1.5 * cameras as f64 * random.unit()) as usize;
            if c < cameras {
                let before = frame - lost[c].len();
                lost[c].push(before);
            }
        }
        let recordings = Recordings::new(random, lost, count, n % 2 == 0);
        let observations = recordings.observations(random, 0.03);
        for (model, truth) in recordings.fit(&observations).into_iter().zip(&recordings.true_models)
        {
            let model = model.unwrap();
            lost_frames += truth.lost_before.len();
            ambiguous += usize::from(model.undecided);
            let correct = model.clock.lost_before == truth.lost_before;
            assert!(correct || model.undecided, "{n}: {model:?}, {truth:?}");
        }
    }
    assert!(lost_frames > 500 && ambiguous < 30, "{lost_frames} {ambiguous}");
}

#[test]
fn two_losses_at_one_image_and_a_camera_without_observations() {
    let random = &mut Random::new(10);
    let recordings = Recordings::new(random, vec![vec![7, 7], vec![], vec![4]], 20, false);
    let mut observations = recordings.observations(random, 0.0);
    let lost = |models: &[Option<FittedClock>]| -> Vec<Option<Vec<usize>>> {
        models.iter().map(|m| m.as_ref().map(|m| m.clock.lost_before.clone())).collect()
    };
    let all = recordings.fit(&observations);
    assert_eq!(lost(&all), [Some(vec![7, 7]), Some(vec![]), Some(vec![4])]);
    observations.retain(|o| o.cameras.iter().all(|c| *c < 2));
    assert_eq!(lost(&recordings.fit(&observations)), [Some(vec![7, 7]), Some(vec![]), None]);
    assert_eq!(recordings.fit(&[]), [None, None, None]);
}

/// Checks that two groups of cameras without a common observation are fitted independently of each other.
#[test]
fn components_do_not_touch_each_other() {
    let random = &mut Random::new(11);
    for _ in 0..20 {
        let lost = || vec![vec![5], vec![9, 14], vec![]];
        let halves = [0, 1].map(|_| Recordings::new(random, lost(), 22, false));
        let observations = halves.each_ref().map(|h| h.observations(random, 0.02));
        let mut both = observations[0].clone();
        let moved =
            |o: &TimingObservation| TimingObservation { cameras: o.cameras.map(|c| c + 3), ..*o };
        both.extend(observations[1].iter().map(moved));
        let clocks: Vec<NominalClock> = halves.iter().flat_map(Recordings::clocks).collect();
        let fitted = fit_clock_models(&clocks, 0, &both);
        for (n, (half, observations)) in halves.iter().zip(&observations).enumerate() {
            for (model, alone) in fitted[3 * n..].iter().zip(half.fit(observations)) {
                let model = model.clone().map(|m| FittedClock { component: 0, ..m });
                assert_eq!(model, alone, "half {n}");
            }
        }
    }
}

/// Checks that one observation is too few to decide on a lost frame, and two are sufficient. If one of two observations
/// deviates by 0.6 times the inlier bound, they neither prove a loss nor exclude it.
#[test]
fn weak_evidence_of_a_loss_makes_a_model_ambiguous() {
    let times_s: Vec<f64> = (0..20).map(|n| f64::from(n) * FRAME_S).collect();
    let fit = |late: &[f64]| {
        let count = 10 + late.len();
        let [times_a, times_b] = [&times_s[..count + 1], &times_s[..count]];
        let (frame_s, drifts) = (FRAME_S, false);
        let clock =
            |times_s, may_lose_frames| NominalClock { times_s, frame_s, may_lose_frames, drifts };
        let clocks = [clock(times_a, false), clock(times_b, true)];
        let in_time = (0..10).map(|n| (n, 0.0));
        let late = (0..).zip(late).map(|(n, late)| (10 + n, *late));
        let observations = in_time.chain(late).map(|(n, late)| TimingObservation {
            cameras: [0, 1],
            images: [n, n],
            fraction: 0.3 + late,
        });
        fit_clock_models(&clocks, 0, &observations.collect::<Vec<_>>())[1].clone().unwrap()
    };
    let no_loss = |model: &FittedClock| model.clock.lost_before.is_empty() && !model.undecided;
    assert!(no_loss(&fit(&[])) && fit(&[1.0]).undecided);
    assert!(fit(&[1.0, 1.0 + 0.6 * INLIER_BOUND_FRAMES]).undecided);
    let certain = fit(&[1.0, 1.0]);
    assert!(certain.clock.lost_before == [10] && !certain.undecided, "{certain:?}");
}
