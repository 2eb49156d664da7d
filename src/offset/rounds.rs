//! All pairs: rounds of choosing frame triples by the estimates and estimating from them.
//!
//! The candidates of a round are computed in order of time, those of all pairs together: pairs share
//! cameras, and a frame that is read for one pair is still cached for the others. Large rigs are split
//! into groups of pairs whose frames fit the cache. Results depend on neither order nor groups.

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
/// The frames of a camera that are in use at an instant: two of a track, and one before and one after.
const FRAMES_AT_ONCE: usize = 4;

/// One pair (i, j) between two rounds, from both directions: camera i's tracks against camera j's
/// frames, and the reverse.
pub struct PairRounds {
    cameras: [usize; 2],
    initial: InitialOffset,
    with_rate: bool,
    /// Those of the last round.
    frames: Vec<TripleFrames>,
    estimate: Result<PairEstimate, PairFailure>,
    finished: bool,
}

impl PairRounds {
    /// `start` is the offset to about a frame, or why there is none.
    pub fn new(
        cameras: [usize; 2],
        start: Result<InitialOffset, PairFailure>,
        with_rate: bool,
    ) -> Self {
        Self {
            cameras,
            initial: start.unwrap_or_default(),
            with_rate,
            frames: Vec::new(),
            estimate: Err(start.err().unwrap_or(PairFailure::NoOverlap)),
            finished: start.is_err(),
        }
    }

    /// Chooses the triples of the next round. §7 requires camera j's frame to lie between the two of
    /// camera i; which one does depends on the offset, so triples and offset are determined in turn.
    fn choose(&mut self, recording: &Recording) {
        if self.finished {
            return;
        }
        let frames = choose_triples(recording, self.cameras, &self.initial);
        self.finished = frames.is_empty() || frames == self.frames;
        self.frames = frames;
    }

    /// Estimates from the chosen triples.
    fn fit(&mut self, recording: &Recording) -> Result<(), CaptureError> {
        if self.finished {
            return Ok(());
        }
        let triples = PairTriples::new(recording, self.cameras, self.frames.clone())?;
        self.estimate = fit_pair(recording, &triples, &self.initial, self.with_rate);
        match &self.estimate {
            Ok(pair) => {
                let (value_s, rate, center_s) = (pair.offset_s, pair.rate, pair.center_s);
                self.initial = InitialOffset { value_s, rate, center_s };
            }
            Err(_) => self.finished = true,
        }
        Ok(())
    }
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
        for _ in 0..MAX_ROUNDS {
            group.iter_mut().for_each(|pair| pair.choose(recording));
            let active = group.iter().filter(|pair| !pair.finished);
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
