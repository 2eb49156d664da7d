//! All pairs: rounds of choosing frame triples by the estimates and estimating from them.
//!
//! The candidates of a round are computed in order of time, those of all pairs together: pairs share
//! cameras, and a frame that is read for one pair is still cached for the others. Large rigs are split
//! into groups of pairs whose frames fit the cache. Results depend on neither order nor groups.
//!
//! The first round of a longer recording is of its middle alone. It tells which frame of camera j lies
//! between two of camera i, which the nominal clocks get wrong for about every other triple.

use super::pair::{
    InitialOffset, PairEstimate, PairFailure, PairTriples, TripleFrames, choose_triples,
};
use super::pair_fit::fit_pair;
use super::recording::{MAX_CACHED_SAMPLES, Recording};
use crate::capture::CaptureError;
use crate::progress::{Reporter, Task};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The maximum number of rounds. Larger costs time where the choice alternates; smaller may end on
/// triples that the estimate no longer implies.
const MAX_ROUNDS: usize = 5;
/// The triples of either direction that the first round has. Larger costs time; smaller has no estimate
/// more often, which costs a round of all triples.
const FIRST_TRIPLES: usize = 4;
/// The frames of a camera that are in use at an instant: two of a track, and one before and one after.
const FRAMES_AT_ONCE: usize = 4;

/// One pair (i, j) between two rounds, from both directions: camera i's tracks against camera j's
/// frames, and the reverse.
pub struct PairRounds {
    cameras: [usize; 2],
    start: InitialOffset,
    initial: InitialOffset,
    with_rate: bool,
    stage: Stage,
    /// How many rounds of all triples are left.
    rounds: usize,
    /// Those of the last round.
    frames: Vec<TripleFrames>,
    estimate: Result<PairEstimate, PairFailure>,
}

/// Which triples the next round has, and the offset that they were first chosen by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The recording's middle, by the start.
    Middle,
    /// All, by the middle's estimate.
    FromMiddle,
    /// All, by the start.
    FromStart,
    Finished,
}

impl PairRounds {
    /// `start` is the offset to about a frame, or why there is none.
    pub fn new(
        cameras: [usize; 2],
        start: Result<InitialOffset, PairFailure>,
        with_rate: bool,
    ) -> Self {
        let initial = start.unwrap_or_default();
        Self {
            cameras,
            start: initial,
            initial,
            with_rate,
            stage: if start.is_ok() { Stage::Middle } else { Stage::Finished },
            rounds: MAX_ROUNDS,
            frames: Vec::new(),
            estimate: Err(start.err().unwrap_or(PairFailure::NoOverlap)),
        }
    }

    /// Chooses the triples of the next round. §7 requires camera j's frame to lie between the two of
    /// camera i; which one does depends on the offset, so triples and offset are determined in turn.
    fn choose(&mut self, recording: &Recording) {
        if self.stage == Stage::Finished {
            return;
        }
        let frames = choose_triples(recording, self.cameras, &self.initial);
        if self.stage == Stage::Middle {
            if let Some(middle) = middle(&frames, self.cameras[0]) {
                self.frames = middle;
                return;
            }
            self.stage = Stage::FromStart;
        }
        if self.rounds == 0 || frames.is_empty() || frames == self.frames {
            self.stage = Stage::Finished;
            return;
        }
        self.rounds -= 1;
        self.frames = frames;
    }

    /// Estimates from the chosen triples.
    fn fit(&mut self, recording: &Recording) -> Result<(), CaptureError> {
        if self.stage == Stage::Finished {
            return Ok(());
        }
        let triples = PairTriples::new(recording, self.cameras, self.frames.clone())?;
        if self.stage == Stage::Middle {
            let estimate = fit_pair(recording, &triples, &self.initial, false);
            self.stage = Stage::FromStart;
            if let Some(pair) = estimate.ok().filter(|pair| self.is_near_start(recording, pair)) {
                self.stage = Stage::FromMiddle;
                self.initial = InitialOffset::constant(pair.offset_s);
            }
            return Ok(());
        }
        self.estimate = fit_pair(recording, &triples, &self.initial, self.with_rate);
        match &self.estimate {
            Ok(pair) => {
                let (value_s, rate, center_s) = (pair.offset_s, pair.rate, pair.center_s);
                self.initial = InitialOffset { value_s, rate, center_s };
            }
            // The middle may have been wrong.
            Err(_) if self.stage == Stage::FromMiddle => {
                (self.stage, self.initial) = (Stage::FromStart, self.start);
                (self.rounds, self.frames) = (MAX_ROUNDS, Vec::new());
            }
            Err(_) => self.stage = Stage::Finished,
        }
        Ok(())
    }

    /// Whether an estimate is certain, and within the frame that the start may be off by.
    fn is_near_start(&self, recording: &Recording, pair: &PairEstimate) -> bool {
        let [i, j] = self.cameras.map(|c| recording.timelines.frame_s(c));
        pair.std_err_s <= recording.options.max_std_err_frames * i.min(j)
            && (pair.offset_s - self.start.value_s).abs() <= i.max(j)
    }
}

/// Those in the middle of each direction's triples; `None` where that would be most of them.
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

/// Every pair's estimate, or why it has none, in the order of `pairs`. The error is that of a frame
/// that cannot be read.
pub fn estimate_pairs(
    recording: &Recording,
    mut pairs: Vec<PairRounds>,
    reporter: &Reporter,
) -> Result<Vec<Result<PairEstimate, PairFailure>>, CaptureError> {
    let mut rest = &mut pairs[..];
    while !rest.is_empty() {
        let (group, others) = rest.split_at_mut(group_size(recording, rest));
        rest = others;
        loop {
            group.iter_mut().for_each(|pair| pair.choose(recording));
            let active = group.iter().filter(|pair| pair.stage != Stage::Finished);
            let triples: Vec<_> = active.flat_map(|pair| pair.frames.iter().copied()).collect();
            if triples.is_empty() {
                break;
            }
            let task = reporter.task("Offsets", triples.len());
            compute_triples(recording, triples, &clocks_s(recording, group), &task)?;
            group.par_iter_mut().try_for_each(|pair| pair.fit(recording))?;
        }
        group.iter().for_each(|pair| recording.release_pair(pair.cameras));
    }
    Ok(pairs.into_iter().map(|pair| pair.estimate).collect())
}

/// The number of the first pairs whose frames at an instant fit the frames' cache, and whose candidates
/// of two rounds that of the candidates; at least one.
fn group_size(recording: &Recording, pairs: &[PairRounds]) -> usize {
    let options = recording.options;
    let samples = 4 * options.max_frames.saturating_mul(options.max_features);
    let max_pairs = (MAX_CACHED_SAMPLES / samples.max(1)).clamp(1, pairs.len());
    let mut cameras = BTreeSet::new();
    let fits = |pair: &&PairRounds| {
        cameras.extend(pair.cameras);
        recording.frames.holds(cameras.iter().copied(), FRAMES_AT_ONCE)
    };
    pairs[..max_pairs].iter().take_while(fits).count().max(1)
}

/// Each camera's clock relative to one of the group's, as far as pairs connect them, seconds.
fn clocks_s(recording: &Recording, group: &[PairRounds]) -> Vec<f64> {
    let mut clocks_s: Vec<Option<f64>> = vec![None; recording.timelines.times_s.len()];
    clocks_s[group[0].cameras[0]] = Some(0.0);
    for _ in 0..group.len() {
        for pair in group {
            let ([i, j], offset_s) = (pair.cameras, pair.initial.value_s);
            match [i, j].map(|c| clocks_s[c]) {
                [Some(known), None] => clocks_s[j] = Some(known + offset_s),
                [None, Some(known)] => clocks_s[i] = Some(known - offset_s),
                _ => {}
            }
        }
    }
    clocks_s.into_iter().map(Option::unwrap_or_default).collect()
}

/// Computes the candidates of these triples, which the recording caches, in order of time by the
/// cameras' clocks.
fn compute_triples(
    recording: &Recording,
    mut triples: Vec<TripleFrames>,
    clocks_s: &[f64],
    task: &Task,
) -> Result<(), CaptureError> {
    let frame_s = recording.frames.capture().frame_s();
    let instant = |&([a, _], [k, _]): &TripleFrames| {
        let frames = (recording.timelines.times_s[a][k] + clocks_s[a]) / frame_s;
        // Off the multiples of half a frame, near which rounding would split an instant.
        if frames.is_finite() { (frames + 0.25).floor() as i64 } else { 0 }
    };
    triples.sort_by_cached_key(|triple| (instant(triple), *triple));
    let tracks = |triples: &[TripleFrames]| {
        let needed: BTreeSet<_> = triples.iter().map(|([a, _], [k, _])| (*a, *k)).collect();
        needed.into_par_iter().try_for_each(|(a, k)| recording.tracks(a, k).map(drop))
    };
    let candidates = |triples: &[TripleFrames]| {
        triples.par_iter().try_for_each(|&(cameras, frames)| {
            recording.triple(cameras, frames)?;
            task.advance(1);
            Ok(())
        })
    };
    // The tracks of one instant beside the candidates of the one before, so that no thread waits.
    let mut before: &[TripleFrames] = &[];
    for now in triples.chunk_by(|x, y| instant(x) == instant(y)) {
        let (candidates, tracks) = rayon::join(|| candidates(before), || tracks(now));
        candidates.and(tracks)?;
        before = now;
    }
    candidates(before)
}

#[cfg(test)]
mod tests {
    use super::super::OffsetOptions;
    use super::super::recording::TrackCache;
    use super::super::timeline::Timelines;
    use super::*;
    use crate::capture::Capture;
    use crate::raster::{BitDepth, Image, write_image};
    use crate::registration::{FrameStore, RegistrationOptions};
    use std::path::Path;

    const DELAYS_FRAMES: [f64; 3] = [0.3, 0.0, -0.2];

    /// Three cameras of a row before a plane that moves upwards, slower and slower.
    fn write_capture(folder: &Path) {
        let (w, h, rate_hz) = (128, 96, 30.0);
        let mut cameras = Vec::new();
        for (c, delay) in DELAYS_FRAMES.into_iter().enumerate() {
            for n in 0..20 {
                let t = f64::from(n) + delay;
                let value = |k: usize| {
                    let x = (k % w) as f64 + 4.0 * c as f64;
                    let y = (k / w) as f64 + 3.0 * t - 0.03 * t * t;
                    let waves = (0.71 * x + 0.2 * y).sin() * (0.63 * y - 0.11 * x).cos()
                        + (0.23 * x).cos() * (0.31 * y + 1.0).sin();
                    (0.5 + 0.2 * waves) as f32
                };
                let image = Image::from_data(w, h, 1, (0..w * h).map(value).collect());
                let path = folder.join(format!("cam{c}/{n:04}.png"));
                write_image(&path, &image, None, BitDepth::Sixteen).unwrap();
            }
            cameras.push(serde_json::json!({
                "id": format!("cam{c}"), "frames": format!("cam{c}/%04d.png"),
                "width": w, "height": h, "model": "PINHOLE", "params": [100, 100, 64, 48],
                "cam_from_world": {
                    "rotation_wxyz": [1, 0, 0, 0], "translation": [-0.08 * c as f64, 0, 0]
                },
                "color": "gray",
                "clock": {"rate_hz": rate_hz, "first_s": 0.0, "shared": false}
            }));
        }
        let capture = serde_json::json!({
            "format": "stlfr-capture", "version": 1, "name": "plane", "cameras": cameras
        });
        std::fs::write(folder.join("capture.json"), capture.to_string()).unwrap();
    }

    /// Pair by pair, all triples in every round.
    fn naive(recording: &Recording, cameras: [usize; 2]) -> Result<PairEstimate, PairFailure> {
        let mut initial = InitialOffset::default();
        let mut estimate = Err(PairFailure::NoOverlap);
        let mut before = Vec::new();
        for _ in 0..MAX_ROUNDS {
            let frames = choose_triples(recording, cameras, &initial);
            if frames == before {
                break;
            }
            let triples = PairTriples::new(recording, cameras, frames.clone()).unwrap();
            let pair = fit_pair(recording, &triples, &initial, false)?;
            initial = InitialOffset::constant(pair.offset_s);
            (estimate, before) = (Ok(pair), frames);
        }
        estimate
    }

    #[test]
    fn estimates_are_those_of_a_naive_reference() {
        let folder = tempfile::tempdir().unwrap();
        write_capture(folder.path());
        let capture = std::sync::Arc::new(Capture::open(folder.path()).unwrap());
        let options = OffsetOptions::default();
        let (pairs, frame_s) = ([[0, 1], [0, 2], [1, 2]], capture.frame_s());
        // All pairs in one group, and each in its own.
        for max_bytes in [192 << 20, 0] {
            let registration = RegistrationOptions::default();
            let frames = FrameStore::with_bound(capture.clone(), &registration, max_bytes);
            let tracks = TrackCache::default();
            let timelines = Timelines::nominal(&capture);
            let recording = Recording::new(&frames, timelines, &tracks, &options);
            let rounds = |cameras| PairRounds::new(cameras, Ok(InitialOffset::default()), false);
            let all: Vec<_> = pairs.map(rounds).into();
            assert_eq!(group_size(&recording, &all), if max_bytes > 0 { 3 } else { 1 });
            let estimates = estimate_pairs(&recording, all, &Reporter::silent()).unwrap();
            for (cameras, estimate) in pairs.into_iter().zip(estimates) {
                let truth = DELAYS_FRAMES[cameras[1]] - DELAYS_FRAMES[cameras[0]];
                let error = estimate.as_ref().unwrap().offset_s / frame_s - truth;
                assert!(error.abs() < 0.01, "{cameras:?}: {error} frame");
                assert_eq!(estimate, naive(&recording, cameras), "{cameras:?}");
            }
        }
    }

    #[test]
    fn no_start_has_no_estimate_and_few_triples_have_no_middle() {
        let none = PairRounds::new([0, 1], Err(PairFailure::PeriodicMotion), false);
        assert!(none.stage == Stage::Finished && none.estimate == Err(PairFailure::PeriodicMotion));
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
