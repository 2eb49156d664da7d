//! Finds the offset between two recordings that started seconds apart, to about one frame.
//!
//! Peaks of the normalized cross-correlation of the two cameras' activity signals ([`activity`]) propose a few offsets.
//! An offset candidate, eq. (10), is the offset that a single feature implies. Each proposed offset is verified by the
//! offset candidates of a few frame triples (two successive frames of camera a and one frame of camera b). The offset
//! with the largest fraction of inliers is chosen.
//!
//! Two recordings that overlap by little may have no reliable offset: an offset that is wrong by a period of the motion
//! may be the best one that can be tried. Their offset then follows from a chain of other pairs' reliable offsets
//! ([`forest`]). If these pairs don't connect all cameras, further pairs are aligned.
//!
//! Known limits: recordings shorter than 2 s are assumed to be aligned to about one frame, and periodic motion has no
//! unique alignment.

mod activity;
mod correlation;
mod forest;

use super::clock::ClockModel;
use super::pair::{
    MIN_AGREEMENT, MIN_INLIERS, NOMINAL_CLOCK_FRAMES, Observation, PairFailure, consensus_value,
    pairs,
};
use super::recording::Recording;
use super::{OffsetMethod, OffsetOptions};
use crate::capture::CaptureError;
use crate::progress::Reporter;
use activity::{Activity, Bands};
use correlation::{MIN_OVERLAP_S, Signal, peaks};
use forest::{Forest, Link, reliable_agreement};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The number of frame triples (two frames of one camera, one frame of another) by which an offset is verified.
const TESTED_FRAMES: usize = 6;
/// A proposed offset is a rival if its agreement (fraction of inliers) is at least this fraction of the largest
/// agreement among the proposed offsets. Rivals count as equally plausible.
const RIVAL_FRACTION: f64 = 0.8;
/// The number of nearest cameras with which a camera may be aligned if the given pairs don't connect all clocks, as a
/// multiple of [`OffsetOptions::neighbors`].
const FURTHER_NEIGHBORS: usize = 3;

/// Rough alignment: pairs of camera indices, each with the pair's offset to about one frame, or with the reason why the
/// pair could not be aligned.
pub type Alignment = Vec<([usize; 2], Result<ClockModel, PairFailure>)>;

/// Estimates the offsets of pairs of cameras to about one frame. `clock` holds the index of each camera's clock, and
/// `pairs` the pairs of camera indices, ascending.
///
/// If the reliable offsets of `pairs` don't connect all clocks, pairs of cameras that are farther apart are aligned
/// too. The result has all of `pairs` and those further pairs that connect clocks, ascending. If a pair has no reliable
/// offset, but a chain of pairs with reliable offsets connects its clocks, it gets the sum of the offsets along the
/// chain.
///
/// A pair fails if one of its cameras has a single frame, which shows no motion. Returns an error if a frame cannot be
/// read.
pub fn align(
    recording: &Recording,
    clock: &[usize],
    mut pairs: Vec<[usize; 2]>,
    reporter: &Reporter,
) -> Result<Alignment, CaptureError> {
    let given = pairs.len();
    pairs.extend(further_pairs(recording, clock, &pairs));
    let activities = activities(recording, &pairs)?;
    let results = vec![None; pairs.len()];
    let mut aligner = Aligner { recording, clock, pairs, activities, results };
    aligner.align((0..given).collect(), reporter)?;
    let reliable = reliable_agreement(aligner.agreements());
    let links = loop {
        let links = aligner.links(reliable);
        let bridges = aligner.bridges(&links.forest);
        if bridges.is_empty() {
            break links;
        }
        aligner.align(bridges, reporter)?;
    };
    let mut alignment: Alignment = Vec::new();
    for (n, result) in aligner.results.into_iter().enumerate() {
        let Some(result) = result.filter(|_| n < given || links.uses(n)) else { continue };
        let pair = aligner.pairs[n];
        let chain_s = links.forest.offset_s(pair.map(|c| clock[c]));
        let offset = match (result, chain_s) {
            (Ok(rough), _) if rough.agreement >= reliable => Ok(rough.clock),
            (_, Some(offset_s)) => Ok(ClockModel::constant(offset_s)),
            (result, None) => result.map(|rough| rough.clock),
        };
        alignment.push((pair, offset));
    }
    alignment.sort_unstable_by_key(|(pair, _)| *pair);
    Ok(alignment)
}

/// State of the rough alignment of a list of camera pairs, some of which are aligned already.
struct Aligner<'a> {
    recording: &'a Recording<'a>,
    /// The index of each camera's clock, by camera.
    clock: &'a [usize],
    /// The pairs of camera indices.
    pairs: Vec<[usize; 2]>,
    /// The activity of each camera (how much its image changes in each frame interval), by camera.
    activities: Vec<Activity>,
    /// For each pair, its rough offset or the reason why it has none; `None` if the pair is not aligned yet.
    results: Vec<Option<Result<RoughOffset, PairFailure>>>,
}

impl Aligner<'_> {
    /// Aligns the pairs with the given indices to about one frame, and stores the results. Returns an error if a frame
    /// cannot be read.
    fn align(&mut self, indices: Vec<usize>, reporter: &Reporter) -> Result<(), CaptureError> {
        let task = reporter.task("Rough alignment", indices.len());
        let align = |&n: &usize| {
            let pair = self.pairs[n];
            let has_motion = pair.iter().all(|&c| self.recording.clocks[c].times_s.len() > 1);
            let result = match has_motion {
                true => rough_offset(self.recording, pair, pair.map(|c| &self.activities[c]), n)?,
                false => Err(PairFailure::NoMotion),
            };
            task.advance(1);
            Ok(result)
        };
        let results: Vec<_> = indices.par_iter().map(align).collect::<Result<_, CaptureError>>()?;
        for (n, result) in indices.into_iter().zip(results) {
            self.results[n] = Some(result);
        }
        Ok(())
    }

    /// Returns the agreement (fraction of inliers) of each aligned pair; 0 for pairs whose alignment failed.
    fn agreements(&self) -> Vec<f64> {
        let results = self.results.iter().flatten();
        results.map(|result| result.as_ref().map_or(0.0, |rough| rough.agreement)).collect()
    }

    /// Returns the rough offsets whose agreement (fraction of inliers) is at least `reliable`, and the forest that they
    /// form.
    fn links(&self, reliable: f64) -> Links {
        let link = |(n, result): (usize, &Option<Result<RoughOffset, PairFailure>>)| {
            let rough = result.as_ref()?.as_ref().ok()?;
            let (offset_s, agreement) = (rough.clock.offset_s, rough.agreement);
            let clocks = self.pairs[n].map(|c| self.clock[c]);
            (agreement >= reliable).then_some((n, Link { clocks, offset_s, agreement }))
        };
        let (pairs, links): (_, Vec<Link>) =
            self.results.iter().enumerate().filter_map(link).unzip();
        let count = self.clock.iter().max().map_or(0, |last| last + 1);
        Links { pairs, forest: Forest::new(count, &links) }
    }

    /// Returns the indices of pairs that may connect the components of `forest`: for any two components, the first pair
    /// between them that is not aligned yet.
    fn bridges(&self, forest: &Forest) -> Vec<usize> {
        let mut bridged = BTreeSet::new();
        let is_bridge = |n: &usize| {
            let [i, j] = self.pairs[*n].map(|c| forest.component(self.clock[c]));
            self.results[*n].is_none() && i != j && bridged.insert([i.min(j), i.max(j)])
        };
        (0..self.pairs.len()).filter(is_bridge).collect()
    }
}

/// The reliable rough offsets between clocks, and the spanning forest of the clocks by these offsets.
struct Links {
    /// For each reliable rough offset, the index of its pair of cameras, ascending.
    pairs: Vec<usize>,
    forest: Forest,
}

impl Links {
    /// Returns whether the forest contains the rough offset of the pair with the index `n`.
    fn uses(&self, n: usize) -> bool {
        self.pairs.binary_search(&n).is_ok_and(|link| self.forest.uses[link])
    }
}

/// Returns pairs of cameras that are farther apart than those of `given`, nearest first. Empty if the offset of no pair
/// can be searched for ([`is_long`]), or for [`OffsetMethod::Pairwise`].
fn further_pairs(recording: &Recording, clock: &[usize], given: &[[usize; 2]]) -> Vec<[usize; 2]> {
    let is_searched = given.iter().any(|&pair| is_long(recording, pair));
    if !is_searched || recording.options.method == OffsetMethod::Pairwise {
        return Vec::new();
    }
    let capture = recording.frames.capture();
    let neighbors = recording.options.neighbors.saturating_mul(FURTHER_NEIGHBORS);
    let mut further = pairs(capture, clock, &OffsetOptions { neighbors, ..*recording.options });
    further.retain(|pair| given.binary_search(pair).is_err() && is_long(recording, *pair));
    let distance = |pair: &[usize; 2]| {
        let [a, b] = pair.map(|c| capture.cameras[c].camera.center());
        (a - b).norm()
    };
    further.sort_by(|x, y| distance(x).total_cmp(&distance(y)).then(x.cmp(y)));
    further
}

/// Computes the activity of each camera from all its frames: how much its image changes in each frame interval. The
/// result has an entry for each camera.
///
/// `pairs` are pairs of camera indices. An activity has a signal for each pair that contains the camera. A pair has
/// no signals if one of its recordings is too short, if the search is disabled, or if its cameras have a common
/// centre. Returns an error if a frame cannot be read.
fn activities(recording: &Recording, pairs: &[[usize; 2]]) -> Result<Vec<Activity>, CaptureError> {
    let capture = recording.frames.capture();
    let bands: Vec<Option<[Bands; 2]>> = pairs
        .iter()
        .map(|&pair| {
            let [a, b] = pair.map(|c| &capture.cameras[c].camera);
            is_long(recording, pair).then(|| Bands::of_pair(a, b)).flatten()
        })
        .collect();
    let activity = |camera: usize| {
        let own = (0..pairs.len()).filter_map(|n| {
            let side = pairs[n].iter().position(|&c| c == camera)?;
            Some((n, &bands[n].as_ref()?[side]))
        });
        let own: Vec<(usize, &Bands)> = own.collect();
        match own.is_empty() {
            true => Ok(Activity::default()),
            false => Activity::new(recording.frames, camera, &own),
        }
    };
    (0..capture.cameras.len()).into_par_iter().map(activity).collect()
}

/// Returns whether the offset of a pair can be searched for: the search range is above 0, and both recordings are
/// longer than [`MIN_OVERLAP_S`].
fn is_long(recording: &Recording, pair: [usize; 2]) -> bool {
    let duration_s = |c: usize| {
        let times = &recording.clocks[c].times_s;
        times[times.len() - 1] - times[0]
    };
    recording.options.search_s > 0.0 && pair.iter().all(|&c| duration_s(c) > MIN_OVERLAP_S)
}

/// Offset of a pair of cameras to about one frame.
#[derive(Clone, Debug, PartialEq)]
struct RoughOffset {
    clock: ClockModel,
    /// The agreement of the images with the offset (fraction of inliers), 0 to 1; 1 for nominal clocks that are
    /// trusted.
    agreement: f64,
}

impl RoughOffset {
    fn new(offset_s: f64, agreement: f64) -> Self {
        Self { clock: ClockModel::constant(offset_s), agreement }
    }
}

/// Returns the offset of a pair of cameras [a, b] to about one frame. A pair without activity signals, such as a pair
/// with a short recording, gets the offset 0, which trusts the nominal clocks.
///
/// `activities` are the activities of a and b, which hold the pair's signals under `n`, the index of the pair. The
/// inner error is the reason why no offset is chosen. The outer error is a frame that cannot be read.
fn rough_offset(
    recording: &Recording,
    [a, b]: [usize; 2],
    activities: [&Activity; 2],
    n: usize,
) -> Result<Result<RoughOffset, PairFailure>, CaptureError> {
    let signals =
        activities.map(|of| Some(Signal { times_s: &of.times_s, values: of.signals.get(&n)? }));
    let [Some(of_a), Some(of_b)] = signals else { return Ok(Ok(RoughOffset::new(0.0, 1.0))) };
    let frame_s = recording.clocks[a].frame_s().max(recording.clocks[b].frame_s());
    let mut offsets_s = peaks(&[of_a, of_b], recording.options.search_s, frame_s);
    if offsets_s.is_empty() {
        return Ok(Err(PairFailure::NoOverlap));
    }
    // The offset 0, which the nominal clocks imply, is always verified.
    if offsets_s.iter().all(|offset_s| offset_s.abs() > frame_s) {
        offsets_s.push(0.0);
    }
    let mut agreements = Vec::new();
    for offset_s in offsets_s {
        agreements.push((offset_s, agreement(recording, [a, b], offset_s, activities[0])?));
    }
    Ok(choose(&agreements, frame_s))
}

/// Chooses the offset with the largest agreement (fraction of inliers). `agreements` holds (offset in seconds,
/// agreement). If a rival ([`RIVAL_FRACTION`]) lies within [`NOMINAL_CLOCK_FRAMES`] of 0, the nominal clocks' offset,
/// the rival is chosen instead. Fails if `agreements` is empty, if the largest agreement is above 0 but below
/// [`MIN_AGREEMENT`], or if rivals lie more than [`NOMINAL_CLOCK_FRAMES`] from the chosen offset.
///
/// `frame_s` is the longer frame period of the two cameras, seconds.
fn choose(agreements: &[(f64, f64)], frame_s: f64) -> Result<RoughOffset, PairFailure> {
    let max = agreements.iter().map(|a| a.1).fold(0.0, f64::max);
    let rivals: Vec<(f64, f64)> =
        agreements.iter().filter(|a| a.1 > 0.0 && a.1 >= RIVAL_FRACTION * max).copied().collect();
    let near = |x: f64, y: f64| (x - y).abs() <= NOMINAL_CLOCK_FRAMES * frame_s;
    if let Some(&(offset_s, agreement)) = rivals.iter().find(|rival| near(rival.0, 0.0)) {
        return Ok(RoughOffset::new(offset_s, agreement));
    }
    let Some(best) = agreements.iter().find(|a| a.1 == max) else {
        return Err(PairFailure::NoOverlap);
    };
    if max > 0.0 && max < MIN_AGREEMENT {
        return Err(PairFailure::NoConsensus);
    }
    if max == 0.0 {
        // No offset has inliers. The estimation of the pair determines the reason later.
        return Ok(RoughOffset::new(0.0, 0.0));
    }
    let is_unique = rivals.iter().all(|other| near(other.0, best.0));
    if is_unique { Ok(RoughOffset::new(best.0, max)) } else { Err(PairFailure::PeriodicMotion) }
}

/// Returns the agreement of the images with a proposed offset `offset_b − offset_a`, seconds: the number of inliers
/// divided by the number of features that move across their epipolar lines. The agreement is 0 if there are fewer
/// than [`MIN_INLIERS`] inliers.
///
/// The overlap of the recordings is divided into [`TESTED_FRAMES`] parts. Each part contributes the frame triple (two
/// frames of one camera, one frame of another) at camera a's most active frame in this part.
fn agreement(
    recording: &Recording,
    [a, b]: [usize; 2],
    offset_s: f64,
    activity: &Activity,
) -> Result<f64, CaptureError> {
    let times = &recording.clocks[a].times_s;
    let possible: Vec<(usize, usize)> = (0..times.len() - 1)
        .filter_map(|k| Some((k, recording.image_between([a, b], k, offset_s)?)))
        .collect();
    let mut observations = Vec::new();
    let mut across = 0;
    for part in possible.chunks(possible.len().div_ceil(TESTED_FRAMES).max(1)) {
        let most_active = part.iter().max_by(|x, y| {
            activity.energies[x.0].total_cmp(&activity.energies[y.0]).then(y.0.cmp(&x.0))
        });
        let Some(&(k, m)) = most_active else { continue };
        let triple = recording.triple(([a, b], [k, m]))?;
        across += triple.across;
        observations.extend(triple.samples.iter().map(Observation::from));
    }
    let score = consensus_value(&observations).map_or(0.0, |(_, score)| score);
    let enough = score >= MIN_INLIERS as f64;
    Ok(if enough { score / across.max(1) as f64 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Capture;
    use crate::offset::recording::TrackCache;
    use crate::offset::tests::PlaneRecording;
    use crate::registration::{FrameStore, RegistrationOptions};
    use std::path::Path;
    use std::sync::Arc;

    const RATE_HZ: f64 = 15.0;
    /// The start of each camera's recording, seconds. The recordings of the second and the third camera overlap by less
    /// than [`MIN_OVERLAP_S`].
    const STARTS_S: [f64; 4] = [0.0, 0.5, 3.6, 1.6];

    /// Writes a capture of four cameras in a row, in front of a plane that moves up and down about once a second. Each
    /// recording lasts 5 s.
    fn write_capture(folder: &Path) -> Arc<Capture> {
        let recording = PlaneRecording { cameras: 4, frames: 75, rate_hz: RATE_HZ };
        recording.write(folder, |c, n| {
            let t = STARTS_S[c] + n as f64 / RATE_HZ;
            6.0 * (6.2 * t).sin() + 2.5 * (2.3 * t).sin() + (9.1 * t).cos()
        })
    }

    #[test]
    fn a_chain_of_reliable_pairs_replaces_an_offset_that_is_wrong_by_a_period() {
        let folder = tempfile::tempdir().unwrap();
        let capture = write_capture(folder.path());
        let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
        let nominal = capture.cameras.iter().map(|c| c.clock.clone()).collect();
        let cache = TrackCache::default();
        let options = OffsetOptions { neighbors: 1, ..OffsetOptions::default() };
        let recording = Recording::new(&frames, nominal, &cache, &options);
        let is_right = |[i, j]: [usize; 2], clock: &ClockModel| {
            (clock.offset_s - (STARTS_S[j] - STARTS_S[i])).abs() <= 1.0 / RATE_HZ
        };
        let reporter = Reporter::new(false);
        // Two cameras alone have no other pair that shows the error.
        let alone = align(&recording, &[0, 1, 2, 3], vec![[1, 2]], &reporter).unwrap();
        let is_alone_right = alone[0].1.as_ref().is_ok_and(|clock| is_right([1, 2], clock));
        assert!(!is_alone_right, "{alone:?}");
        let neighbors = vec![[0, 1], [1, 2], [2, 3]];
        let aligned = align(&recording, &[0, 1, 2, 3], neighbors, &reporter).unwrap();
        let pairs: Vec<[usize; 2]> = aligned.iter().map(|(pair, _)| *pair).collect();
        assert_eq!(pairs, [[0, 1], [1, 2], [1, 3], [2, 3]]);
        for (pair, clock) in aligned {
            assert!(is_right(pair, &clock.unwrap()), "{pair:?}");
        }
    }

    #[test]
    fn nominal_clocks_decide_between_rivals() {
        let frame_s = 0.04;
        let choose = |agreements: &[(f64, f64)], frame_s| {
            choose(agreements, frame_s).map(|rough| rough.clock)
        };
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.45)], frame_s), Ok(ClockModel::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.1)], frame_s), Ok(ClockModel::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.4), (0.02, 0.1)], frame_s), Err(PairFailure::NoConsensus));
        assert_eq!(choose(&[(1.0, 0.1), (0.02, 0.4)], frame_s), Ok(ClockModel::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (2.0, 0.45)], frame_s), Err(PairFailure::PeriodicMotion));
        assert_eq!(choose(&[(1.0, 0.5), (1.02, 0.45)], frame_s), Ok(ClockModel::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.0)], frame_s), Ok(ClockModel::default()));
        assert_eq!(choose(&[], frame_s), Err(PairFailure::NoOverlap));
    }
}
