//! Estimates the offset of every pair of cameras in rounds. A round chooses frame triples (two frames of one camera,
//! one frame of the other) by the current offset, and estimates the offset from them.
//!
//! §7 requires camera j's frame to lie between two frames of camera i. Which frame of j lies there depends on the
//! offset, so triples and offset are determined in turn. The initial offset is right only to about a frame, so about
//! half of the triples that it chooses are wrong. In a longer recording, the first round therefore has only a few
//! triples, in the recording's middle.
//!
//! The offset candidates of a group of pairs are computed together. Large rigs are split into groups whose frames fit
//! the cache. Results do not depend on the groups.

use super::fit::{PairTriples, fit_pair};
use super::time_order::{FRAMES_AT_ONCE, compute_triples};
use super::{MAX_STD_ERR_FRAMES, PairEstimate, PairFailure, choose_triples};
use crate::capture::CaptureError;
use crate::offset::clock::ClockModel;
use crate::offset::recording::{MAX_CACHED_SAMPLES, Recording, TripleFrames};
use crate::progress::Reporter;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The maximum number of rounds that use all frame triples of a pair. A round chooses triples, and estimates the
/// offset from them. The count restarts with each new initial offset.
const MAX_ROUNDS: usize = 5;
/// The number of frame triples in each direction in a pair's first round. A direction is the choice of the camera
/// that has two frames.
const FIRST_TRIPLES: usize = 4;

/// State of the estimation of a pair of cameras (i, j) between two rounds. A round chooses frame triples, and estimates
/// the offset from them. There are triples of both directions: two frames of i with one frame of j, and the reverse.
pub struct PairRounds {
    cameras: [usize; 2],
    /// The pair's initial offset, right to about one frame, or the reason why it has none.
    start: Result<ClockModel, PairFailure>,
    /// The offset by which the frame triples of the next round are chosen.
    initial: ClockModel,
    with_rate: bool,
    stage: RoundStage,
    /// The number of remaining rounds that use all frame triples of the pair.
    rounds: usize,
    /// The frame triples of the last round.
    frames: Vec<TripleFrames>,
    estimate: Result<PairEstimate, PairFailure>,
}

/// Stage of a pair's estimation in rounds: which frame triples the next round uses, and by which offset the first round
/// at this stage chose its triples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RoundStage {
    /// The next round uses only a few frame triples, from the middle of the recording. They are chosen by the offset
    /// [`PairRounds::start`].
    Middle,
    /// The next round uses all frame triples. The first such round chose them by the offset estimated from the
    /// recording's middle.
    FromMiddle,
    /// The next round uses all frame triples. The first such round chose them by the offset [`PairRounds::start`].
    FromStart,
    Finished,
}

impl PairRounds {
    pub fn new(
        cameras: [usize; 2],
        start: Result<ClockModel, PairFailure>,
        with_rate: bool,
    ) -> Self {
        Self {
            cameras,
            initial: start.clone().unwrap_or_default(),
            stage: if start.is_ok() { RoundStage::Middle } else { RoundStage::Finished },
            with_rate,
            rounds: MAX_ROUNDS,
            frames: Vec::new(),
            estimate: Err(start.as_ref().err().copied().unwrap_or(PairFailure::NoOverlap)),
            start,
        }
    }

    /// Chooses the frame triples of the pair's next round. Ends the rounds if there are no triples, if they are those
    /// of the last round, or after [`MAX_ROUNDS`] rounds.
    fn choose(&mut self, recording: &Recording) {
        if self.stage == RoundStage::Finished {
            return;
        }
        let frames = choose_triples(recording, self.cameras, &self.initial);
        if self.stage == RoundStage::Middle {
            if let Some(middle) = middle(&frames, self.cameras[0]) {
                self.frames = middle;
                return;
            }
            self.stage = RoundStage::FromStart;
        }
        if self.rounds == 0 || frames.is_empty() || frames == self.frames {
            self.stage = RoundStage::Finished;
            return;
        }
        self.rounds -= 1;
        self.frames = frames;
    }

    /// Estimates the pair's offset from the chosen frame triples. Returns an error if a frame cannot be read.
    fn fit(&mut self, recording: &Recording) -> Result<(), CaptureError> {
        let Ok(start) = self.start.clone() else { return Ok(()) };
        if self.stage == RoundStage::Finished {
            return Ok(());
        }
        let triples = PairTriples::new(recording, self.cameras, &self.frames)?;
        if self.stage == RoundStage::Middle {
            let estimate = fit_pair(recording, &triples, &self.initial, false);
            self.stage = RoundStage::FromStart;
            if let Some(pair) = estimate.ok().filter(|pair| is_near(recording, &start, pair)) {
                self.stage = RoundStage::FromMiddle;
                self.initial = ClockModel { rate: start.rate, ..pair.clock };
            }
            return Ok(());
        }
        self.estimate = fit_pair(recording, &triples, &self.initial, self.with_rate);
        match &self.estimate {
            Ok(pair) => self.initial = pair.clock.clone(),
            // The initial offset, estimated from the recording's middle, may have been wrong.
            Err(_) if self.stage == RoundStage::FromMiddle => {
                (self.stage, self.initial) = (RoundStage::FromStart, start);
                (self.rounds, self.frames) = (MAX_ROUNDS, Vec::new());
            }
            Err(_) => self.stage = RoundStage::Finished,
        }
        Ok(())
    }

    /// Returns the expected number of frame triples (two frames of one camera, one frame of another) in a round that
    /// uses all triples of the pair; 0 for a pair without an initial offset.
    fn expected_triples(&self, recording: &Recording) -> usize {
        let max_frames = recording.options.max_frames;
        let count = |c: usize| (recording.clocks[c].times_s.len() - 1).min(max_frames);
        if self.start.is_ok() { self.cameras.map(count).iter().sum() } else { 0 }
    }
}

/// Returns whether an estimate has a standard error of at most [`MAX_STD_ERR_FRAMES`], and differs from the initial
/// offset `start` by at most one frame period, the possible error of `start`.
fn is_near(recording: &Recording, start: &ClockModel, pair: &PairEstimate) -> bool {
    let [i, j] = pair.cameras.map(|c| recording.clocks[c].frame_s());
    pair.std_err_s <= MAX_STD_ERR_FRAMES * i.min(j)
        && (pair.clock.offset_s - start.offset_at(pair.clock.reference_s)).abs() <= i.max(j)
}

/// Returns [`FIRST_TRIPLES`] frame triples of each direction, from the middle of the recording. `frames` holds all
/// triples: first those with two frames of camera `i`, then those with two frames of the other camera. `None` if one of
/// the two directions has at most 2·[`FIRST_TRIPLES`] triples.
fn middle(frames: &[TripleFrames], i: usize) -> Option<Vec<TripleFrames>> {
    let (forward, backward) = frames.split_at(frames.partition_point(|([a, _], _)| *a == i));
    let mut chosen = Vec::new();
    for direction in [forward, backward] {
        if direction.len() <= 2 * FIRST_TRIPLES {
            return None;
        }
        let first = (direction.len() - FIRST_TRIPLES) / 2;
        chosen.extend_from_slice(&direction[first..first + FIRST_TRIPLES]);
    }
    Some(chosen)
}

/// Estimates the offset of every pair. The results are in the order of `pairs`. Returns an error if a frame cannot be
/// read.
pub fn estimate_pairs(
    recording: &Recording,
    mut pairs: Vec<PairRounds>,
    reporter: &Reporter,
) -> Result<Vec<Result<PairEstimate, PairFailure>>, CaptureError> {
    let expected = |pairs: &[PairRounds]| -> usize {
        pairs.iter().map(|pair| pair.expected_triples(recording)).sum()
    };
    // Progress counts triples, since all pairs of a group end at about the same time.
    let task = reporter.task("Offsets", expected(&pairs));
    let mut done = 0;
    let mut rest = &mut pairs[..];
    while !rest.is_empty() {
        let (group, others) = rest.split_at_mut(group_size(recording, rest));
        rest = others;
        let in_group = expected(group);
        let count = AtomicUsize::new(0);
        let computed = || {
            if count.fetch_add(1, Ordering::Relaxed) < in_group {
                task.advance(1);
            }
        };
        loop {
            group.iter_mut().for_each(|pair| pair.choose(recording));
            let active = group.iter().filter(|pair| pair.stage != RoundStage::Finished);
            let triples: Vec<_> = active.flat_map(|pair| pair.frames.iter().copied()).collect();
            if triples.is_empty() {
                break;
            }
            let clocks_s = clocks_s(recording.clocks.len(), group);
            compute_triples(recording, triples, &clocks_s, &computed)?;
            group.par_iter_mut().try_for_each(|pair| pair.fit(recording))?;
        }
        group.iter().for_each(|pair| recording.release_pair(pair.cameras));
        done += in_group;
        task.set(done);
    }
    Ok(pairs.into_iter().map(|pair| pair.estimate).collect())
}

/// Returns how many pairs, counted from the start of `pairs`, form the next group; at least 1. The group's frames at
/// one instant fit the frame cache. The group's offset candidates of two rounds fit the cache of candidates.
fn group_size(recording: &Recording, pairs: &[PairRounds]) -> usize {
    let options = recording.options;
    // The factor 4 is for two directions and two rounds.
    let samples = options.max_frames.saturating_mul(options.max_features).saturating_mul(4);
    let max_pairs = (MAX_CACHED_SAMPLES / samples.max(1)).clamp(1, pairs.len());
    let mut cameras = BTreeSet::new();
    let fits = |pair: &&PairRounds| {
        cameras.extend(pair.cameras);
        recording.frames.fits(cameras.iter().copied(), FRAMES_AT_ONCE)
    };
    pairs[..max_pairs].iter().take_while(fits).count().max(1)
}

/// Returns the approximate offset of each camera's clock, seconds, by the pairs' current offsets. Cameras that are
/// connected by pairs with an initial offset have offsets relative to one of these cameras. The offset is 0 for a
/// camera without such a pair.
fn clocks_s(cameras: usize, group: &[PairRounds]) -> Vec<f64> {
    let connected: Vec<_> = group.iter().filter(|pair| pair.start.is_ok()).collect();
    let mut clocks_s: Vec<Option<f64>> = vec![None; cameras];
    for root in connected.iter().map(|pair| pair.cameras[0]) {
        clocks_s[root].get_or_insert(0.0);
        let mut changed = true;
        while changed {
            changed = false;
            for pair in &connected {
                let ([i, j], offset_s) = (pair.cameras, pair.initial.offset_s);
                match [i, j].map(|c| clocks_s[c]) {
                    [Some(known), None] => clocks_s[j] = Some(known + offset_s),
                    [None, Some(known)] => clocks_s[i] = Some(known - offset_s),
                    _ => continue,
                }
                changed = true;
            }
        }
    }
    clocks_s.into_iter().map(Option::unwrap_or_default).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Capture, Clock};
    use crate::host::Memo;
    use crate::offset::OffsetOptions;
    use crate::offset::recording::TrackCache;
    use crate::offset::tests::PlaneRecording;
    use crate::registration::{FrameStore, RegistrationOptions};
    use std::collections::BTreeMap;
    use std::path::Path;
    use std::sync::Arc;

    fn nominal_clocks(capture: &Capture) -> Vec<Clock> {
        capture.cameras.iter().map(|c| c.clock.clone()).collect()
    }

    const DELAYS_FRAMES: [f64; 3] = [0.3, 0.0, -0.2];

    /// Writes a capture of three cameras in a row, in front of a plane that moves upwards and decelerates. `rates`
    /// are the rates of the cameras' clocks.
    fn write_capture(folder: &Path, rates: [f64; 3]) -> Arc<Capture> {
        let recording = PlaneRecording { cameras: 3, frames: 24, rate_hz: 30.0 };
        recording.write(folder, |c, n| {
            let t = n as f64 * (1.0 + rates[c]) + DELAYS_FRAMES[c];
            3.0 * t - 0.03 * t * t
        })
    }

    /// Reference implementation: estimates the offset of one pair alone, from all its frame triples in every round.
    fn naive(recording: &Recording, cameras: [usize; 2]) -> Result<PairEstimate, PairFailure> {
        let mut initial = ClockModel::default();
        let mut estimate = Err(PairFailure::NoOverlap);
        let mut before = Vec::new();
        for _ in 0..MAX_ROUNDS {
            let frames = choose_triples(recording, cameras, &initial);
            if frames == before {
                break;
            }
            let triples = PairTriples::new(recording, cameras, &frames).unwrap();
            let pair = fit_pair(recording, &triples, &initial, false)?;
            initial = ClockModel::constant(pair.clock.offset_s);
            (estimate, before) = (Ok(pair), frames);
        }
        estimate
    }

    #[test]
    fn estimates_are_those_of_a_naive_reference() {
        let folder = tempfile::tempdir().unwrap();
        let capture = write_capture(folder.path(), [0.0; 3]);
        let options = OffsetOptions::default();
        let (pairs, frame_s) = ([[0, 1], [0, 2], [1, 2]], capture.frame_s());
        // All pairs are in one group in the first run, and each pair is in its own group in the second.
        for max_bytes in [192 << 20, 0] {
            let registration = RegistrationOptions::default();
            let frames = FrameStore::with_memo(
                capture.clone(),
                &registration,
                Arc::new(Memo::new(max_bytes)),
            );
            let tracks = TrackCache::default();
            let recording = Recording::new(&frames, nominal_clocks(&capture), &tracks, &options);
            let rounds = |cameras| PairRounds::new(cameras, Ok(ClockModel::default()), false);
            let all: Vec<_> = pairs.map(rounds).into();
            assert_eq!(group_size(&recording, &all), if max_bytes > 0 { 3 } else { 1 });
            let estimates = estimate_pairs(&recording, all, &Reporter::silent()).unwrap();
            for (cameras, estimate) in pairs.into_iter().zip(estimates) {
                let truth = DELAYS_FRAMES[cameras[1]] - DELAYS_FRAMES[cameras[0]];
                let error = estimate.as_ref().unwrap().clock.offset_s / frame_s - truth;
                assert!(error.abs() < 0.01, "{cameras:?}: {error} frame");
                assert_eq!(estimate, naive(&recording, cameras), "{cameras:?}");
            }
        }
    }

    /// Calls `test` with the recording of a capture whose cameras' clocks have the rates `rates`.
    fn with_recording(rates: [f64; 3], test: impl FnOnce(&Recording)) {
        let folder = tempfile::tempdir().unwrap();
        let capture = write_capture(folder.path(), rates);
        let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
        let (tracks, options) = (TrackCache::default(), OffsetOptions::default());
        test(&Recording::new(&frames, nominal_clocks(&capture), &tracks, &options));
    }

    #[test]
    fn the_middle_has_the_rate_of_the_start() {
        let clock_rate = 0.05;
        with_recording([0.0, clock_rate, 0.0], |recording| {
            let frame_s = recording.frames.capture().frame_s();
            let rate = clock_rate / (1.0 + clock_rate);
            let value_s = (rate - 1.0) * DELAYS_FRAMES[0] * frame_s;
            let truth = ClockModel { offset_s: value_s, rate, ..ClockModel::default() };
            let start = ClockModel { offset_s: value_s + 0.4 * frame_s, ..truth.clone() };
            let mut pair = PairRounds::new([0, 1], Ok(start), true);
            pair.choose(recording);
            pair.fit(recording).unwrap();
            assert_eq!((pair.stage, pair.initial.rate), (RoundStage::FromMiddle, rate));
            for time_s in [0.0, 23.0 * frame_s] {
                let error = (pair.initial.offset_at(time_s) - truth.offset_at(time_s)) / frame_s;
                assert!(error.abs() < 0.1, "{error} frame");
            }
            let estimates = estimate_pairs(recording, vec![pair], &Reporter::silent()).unwrap();
            let estimate = estimates[0].as_ref().unwrap();
            let clock = &estimate.clock;
            let error = (clock.offset_s - truth.offset_at(clock.reference_s)) / frame_s;
            assert!(error.abs() < 0.01 && (clock.rate - rate).abs() < 1e-3, "{error} frame");
        });
    }

    #[test]
    fn a_wrong_middle_falls_back_to_the_start() {
        with_recording([0.0; 3], |recording| {
            let frame_s = recording.frames.capture().frame_s();
            let mut pair = PairRounds::new([0, 1], Ok(ClockModel::default()), false);
            (pair.stage, pair.initial) =
                (RoundStage::FromMiddle, ClockModel::constant(5.0 * frame_s));
            pair.choose(recording);
            pair.fit(recording).unwrap();
            assert_eq!((pair.stage, pair.rounds), (RoundStage::FromStart, MAX_ROUNDS));
            assert_eq!(pair.initial, ClockModel::default());
            let estimates = estimate_pairs(recording, vec![pair], &Reporter::silent()).unwrap();
            assert_eq!(estimates[0], naive(recording, [0, 1]));
            assert!(estimates[0].is_ok());
        });
    }

    #[test]
    fn an_estimate_is_near_within_a_frame_of_the_start_at_its_time() {
        with_recording([0.0; 3], |recording| {
            let frame_s = recording.frames.capture().frame_s();
            let clock = |offset_s, reference_s| ClockModel {
                offset_s,
                rate: 0.01,
                reference_s,
                ..ClockModel::default()
            };
            let start = clock(0.2, 5.0);
            let max_std_err_s = MAX_STD_ERR_FRAMES * frame_s;
            let is_near = |center_s: f64, away_frames: f64, std_err_s: f64| {
                let offset_s = 0.2 + 0.01 * (center_s - 5.0) + away_frames * frame_s;
                let (cameras, clock) = ([0, 1], clock(offset_s, center_s));
                let estimate = PairEstimate { cameras, clock, std_err_s, ..Default::default() };
                is_near(recording, &start, &estimate)
            };
            for center_s in [0.0, 5.0, 60.0] {
                assert!(is_near(center_s, 0.9, 0.9 * max_std_err_s));
                assert!(is_near(center_s, -0.9, 0.9 * max_std_err_s));
                assert!(!is_near(center_s, 1.1, 0.9 * max_std_err_s));
                assert!(!is_near(center_s, -1.1, 0.9 * max_std_err_s));
                assert!(!is_near(center_s, 0.0, 1.1 * max_std_err_s));
                assert!(!is_near(center_s, 0.0, f64::NAN));
            }
        });
    }

    #[test]
    fn clocks_follow_pairs_that_have_a_start() {
        let start =
            |cameras, offset_s| PairRounds::new(cameras, Ok(ClockModel::constant(offset_s)), false);
        let group = [
            PairRounds::new([4, 0], Err(PairFailure::NoMotion), false),
            start([0, 1], 0.5),
            start([3, 2], 0.25),
            start([2, 1], -1.0),
            start([5, 4], 2.0),
            PairRounds::new([1, 6], Err(PairFailure::NoOverlap), false),
        ];
        assert_eq!(clocks_s(7, &group), [0.0, 0.5, 1.5, 1.25, 2.0, 0.0, 0.0]);
    }

    #[test]
    fn a_cache_of_an_instant_decodes_frames_at_most_twice() {
        let folder = tempfile::tempdir().unwrap();
        let capture = write_capture(folder.path(), [0.0; 3]);
        let registration = RegistrationOptions::default();
        let bounded = |max_bytes| {
            FrameStore::with_memo(capture.clone(), &registration, Arc::new(Memo::new(max_bytes)))
        };
        let mut stores = (1..).map(|n| bounded(n << 16));
        let frames = stores.find(|store| store.fits(0..3, FRAMES_AT_ONCE)).unwrap();
        let (tracks, options) = (TrackCache::default(), OffsetOptions::default());
        let recording = Recording::new(&frames, nominal_clocks(&capture), &tracks, &options);
        let clocks_s = DELAYS_FRAMES.map(|delay| delay * capture.frame_s());
        let pairs = [[0, 1], [0, 2], [1, 2]];
        let triples = pairs.into_iter().flat_map(|[i, j]| {
            let initial = ClockModel::constant(clocks_s[j] - clocks_s[i]);
            choose_triples(&recording, [i, j], &initial)
        });
        let triples: Vec<_> = triples.collect();
        let count = AtomicUsize::new(0);
        let computed = || {
            count.fetch_add(1, Ordering::Relaxed);
        };
        // With more threads, two of them could decode the same frame at once.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        for _ in 0..2 {
            pool.install(|| compute_triples(&recording, triples.clone(), &clocks_s, &computed))
                .unwrap();
            assert_eq!(count.load(Ordering::Relaxed), triples.len());
        }
        let mut decoded = BTreeMap::new();
        for frame in frames.decoded.lock().unwrap().iter() {
            *decoded.entry(*frame).or_insert(0) += 1;
        }
        assert_eq!(decoded.len(), 3 * 24);
        assert!(decoded.values().all(|&n| n <= 2), "{decoded:?}");
    }

    #[test]
    fn no_start_has_no_estimate_and_few_triples_have_no_middle() {
        let none = PairRounds::new([0, 1], Err(PairFailure::PeriodicMotion), false);
        assert!(
            none.stage == RoundStage::Finished && none.estimate == Err(PairFailure::PeriodicMotion)
        );
        let frames = |n: usize| -> Vec<TripleFrames> {
            (0..n).map(|k| ([0, 1], [k, k])).chain((0..n).map(|k| ([1, 0], [k, k]))).collect()
        };
        assert_eq!(middle(&frames(2 * FIRST_TRIPLES), 0), None);
        let chosen = middle(&frames(20), 0).unwrap();
        let expected = [[0, 1], [1, 0]].into_iter().flat_map(|c| (8..12).map(move |k| (c, [k, k])));
        assert_eq!(chosen, expected.collect::<Vec<_>>());
        assert_eq!(middle(&frames(20)[..21], 0), None);
    }
}
