//! Detection of lost frames: a camera that drops a frame without a trace is one frame late from
//! there on.
//!
//! One triple of frames gives a pair's offset at one instant (eq. (10)). Tracked along the recording,
//! a pair's offset jumps up by a frame where the camera of the single frame lost one, and down where
//! the other camera did. Jumps are bracketed by bisection, so that images on both sides of each are
//! observed. The observations of all pairs together then decide which frames are missing
//! ([`clock_models`](super::clock_models)).
//!
//! Known limits: a frame lost while nothing moves is attributed to the next image that shows motion;
//! one lost after the first or before the last image of a recording may be missed, and these images are
//! then a frame off. Where some images say that frames are missing, but not enough of them, the camera's
//! offset is unknown. Neighbours that lose frames within a frame or two of each other hide each other's
//! losses: where several places fit the images nearly as well, the offsets of these cameras are unknown.

use super::clock_models::{ClockModel, NominalClock, TimingObservation, fit_clock_models};
use super::mixture::Observation;
use super::pair::{InitialOffset, MIN_AGREEMENT, PairFailure};
use super::pair_fit::residual_model;
use super::recording::Recording;
use super::timeline::Timelines;
use crate::capture::CaptureError;
use crate::progress::Reporter;
use rayon::prelude::*;

/// A pair's offset observed at one triple of frames.
#[derive(Clone, Copy, Debug)]
struct TripleOffset {
    /// The earlier one of camera a's two images.
    k: usize,
    /// Camera b's image.
    m: usize,
    /// `offset_b − offset_a`, seconds.
    offset_s: f64,
    /// The MSAC score: about the number of inliers.
    score: f64,
    /// The score over the number of features that move across their epipolar lines.
    agreement: f64,
}

/// Where an offset is searched for, in frames from the one observed last, in order of preference.
/// More steps find longer gaps and take longer; fewer lose the offset after a gap of several frames.
const STEPS: [f64; 6] = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0];
/// Where it is searched for at the start of a recording, in frames from the initial offset, which is
/// that of the recording's main part and may be several losses later. More steps find more early
/// losses and take longer; fewer miss the start of a recording with several losses.
const FIRST_STEPS: [f64; 7] = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0];
/// The score that a triple needs, as a fraction of the inliers that a pair needs. Larger leaves
/// images with few moving features unobserved; smaller admits offsets by chance, which the joint fit
/// must outvote.
const MIN_SCORE_FRACTION: f64 = 0.5;
/// The score that a triple needs, as a fraction of its candidates. Larger leaves images with many
/// mismatches unobserved; smaller admits offsets by chance.
const MIN_INLIER_FRACTION: f64 = 0.3;
/// Occluded features and T-junctions agree on the time of one of the two frames, whatever the true
/// offset. This near to a frame, as a fraction of the interval, a triple needs an agreement of
/// [`MIN_AGREEMENT`]. Larger leaves true offsets near 0 unobserved; smaller admits occlusions.
const NEAR_FRAME: f64 = 0.2;
/// How far outside camera a's interval camera b's image may be, as a fraction of the interval. Larger
/// trusts extrapolated trajectories; smaller drops images that are almost inside.
const MAX_OUTSIDE: f64 = 0.25;
/// A change of the offset beyond this many frames is a jump by whole frames. Larger leaves jumps
/// unbracketed; smaller bisects mere noise.
const MIN_JUMP_FRAMES: f64 = 0.6;
/// An offset within this many frames of the expected one, with enough agreement, ends the search.
/// Larger accepts a jump's neighbour; smaller tries all steps on noisy images.
const EXPECTED_WITHIN_FRAMES: f64 = 0.4;
/// The images on either side of a lost frame that are observed again. Larger costs time; smaller
/// leaves losses an image or two off uncorrected.
const IMAGES_AROUND_LOSS: usize = 2;
/// The maximum number of rounds of observing again by the fitted clock models. Larger costs time
/// where models keep changing; smaller stops before they are consistent with the observations.
const MAX_ROUNDS: usize = 3;

/// What [`detect_lost_frames`] gives.
pub struct LostFrames {
    /// The cameras' times, with the lost frames accounted for.
    pub timelines: Timelines,
    /// By camera: whether the observations leave its lost frames undecided.
    pub ambiguous: Vec<bool>,
    /// By camera: whether other lost frames explain the observations nearly as well.
    pub undecided: Vec<bool>,
}

/// The lost frames of all cameras.
///
/// `starts` holds each pair's initial offset; those of pairs whose cameras are observed together are
/// replaced by the offsets of the fitted clock models. A camera that may lose frames and is never
/// observed is ambiguous.
pub fn detect_lost_frames(
    recording: &Recording,
    pairs: &[[usize; 2]],
    starts: &mut [Result<InitialOffset, PairFailure>],
    reporter: &Reporter,
) -> Result<LostFrames, CaptureError> {
    let clocks = nominal_clocks(recording);
    let models = joint_models(recording, pairs, starts, &clocks, reporter)?;
    for (pair, start) in pairs.iter().zip(starts) {
        let [Some(i), Some(j)] = pair.map(|c| models[c].as_ref()) else { continue };
        if start.is_ok() && i.component == j.component {
            *start = Ok(InitialOffset {
                value_s: j.offset_s - i.offset_s,
                rate: j.rate - i.rate,
                center_s: clocks[pair[0]].times_s[0],
            });
        }
    }
    let is_ambiguous = |(model, clock): (&Option<ClockModel>, &NominalClock)| match model {
        Some(model) => model.ambiguous,
        None => clock.may_lose_frames,
    };
    let ambiguous = models.iter().zip(&clocks).map(is_ambiguous).collect();
    let undecided = models.iter().map(|m| m.as_ref().is_some_and(|m| m.undecided)).collect();
    let lost = models.into_iter().map(|m| m.map_or_else(Vec::new, |m| m.lost_before)).collect();
    let timelines = Timelines::with_lost_frames(recording.frames.capture(), lost);
    Ok(LostFrames { timelines, ambiguous, undecided })
}

fn nominal_clocks<'a>(recording: &'a Recording) -> Vec<NominalClock<'a>> {
    let capture = recording.frames.capture();
    let nominal_clock = |(c, times_s): (usize, &'a Vec<f64>)| {
        let clock = &capture.cameras[c].clock;
        NominalClock {
            times_s,
            frame_s: recording.timelines.frame_s(c),
            may_lose_frames: clock.lost,
            drifts: clock.drift && c != capture.reference,
        }
    };
    recording.timelines.times_s.iter().enumerate().map(nominal_clock).collect()
}

/// All cameras' clock models, from the observations of every pair in both directions.
fn joint_models(
    recording: &Recording,
    pairs: &[[usize; 2]],
    starts: &[Result<InitialOffset, PairFailure>],
    clocks: &[NominalClock],
    reporter: &Reporter,
) -> Result<Vec<Option<ClockModel>>, CaptureError> {
    let directions: Vec<([usize; 2], f64)> = pairs
        .iter()
        .zip(starts)
        .filter_map(|(pair, start)| Some((pair, (*start).ok()?.value_s)))
        .flat_map(|(&[i, j], offset_s)| [([i, j], offset_s), ([j, i], -offset_s)])
        .collect();
    let task = reporter.task("Lost frames", directions.len());
    let mut offsets = directions
        .par_iter()
        .map(|&(pair, offset_s)| {
            let offsets = track_offset(recording, pair, offset_s);
            task.advance(1);
            offsets
        })
        .collect::<Result<Vec<_>, _>>()?;
    let fit = |offsets: &[Vec<TripleOffset>]| {
        let observations: Vec<TimingObservation> = directions
            .iter()
            .zip(offsets)
            .flat_map(|((pair, _), offsets)| timing_observations(recording, *pair, offsets))
            .collect();
        fit_clock_models(clocks, recording.frames.capture().reference, &observations)
    };
    let mut models = fit(&offsets);
    for _ in 0..MAX_ROUNDS {
        let changed = directions
            .par_iter()
            .zip(&mut offsets)
            .map(|((pair, _), offsets)| observe_again(recording, *pair, clocks, &models, offsets))
            .collect::<Result<Vec<bool>, _>>()?;
        if !changed.contains(&true) {
            break;
        }
        models = fit(&offsets);
    }
    Ok(models)
}

/// Tracks the offset of the pair (a, b) along the recording, from its initial offset in the main
/// part, and brackets its jumps.
fn track_offset(
    recording: &Recording,
    cameras: [usize; 2],
    initial_offset_s: f64,
) -> Result<Vec<TripleOffset>, CaptureError> {
    let scan = PairScan::new(recording, cameras);
    let mut offsets: Vec<TripleOffset> = Vec::new();
    let mut expected_s = initial_offset_s;
    for k in scan.sampled_images() {
        let steps: &[f64] = if offsets.is_empty() { &FIRST_STEPS } else { &STEPS };
        if let Some(observed) = scan.search_near(k, expected_s, steps)? {
            // An offset of low agreement is an observation, but does not move the search.
            if offsets.is_empty() || observed.agreement >= MIN_AGREEMENT {
                expected_s = observed.offset_s;
            }
            offsets.push(observed);
        }
    }
    let mut bracketing = Vec::new();
    for pair in offsets.windows(2) {
        scan.bisect_jump(pair[0], pair[1], &mut bracketing)?;
    }
    offsets.extend(bracketing);
    Ok(offsets)
}

/// Observes the triples that the fitted clock models predict. At the recordings' ends and on either side of
/// lost frames, it observes each image of camera a with every plausible image of camera b, and keeps all of these.
/// Returns whether any observation changed.
fn observe_again(
    recording: &Recording,
    cameras: [usize; 2],
    clocks: &[NominalClock],
    models: &[Option<ClockModel>],
    offsets: &mut Vec<TripleOffset>,
) -> Result<bool, CaptureError> {
    let [Some(model_a), Some(model_b)] = cameras.map(|c| models[c].as_ref()) else {
        return Ok(false);
    };
    let scan = PairScan::new(recording, cameras);
    let times_a = model_a.times_s(&clocks[cameras[0]]);
    let times_b = model_b.times_s(&clocks[cameras[1]]);
    // A loss next to a recording's end is seen by few images: all of them are observed.
    let decisive_times: Vec<f64> = [(model_a, &times_a), (model_b, &times_b)]
        .into_iter()
        .flat_map(|(model, times)| model.lost_before.iter().chain([&0]).map(|n| times[*n]))
        .chain([times_a[times_a.len() - 1], times_b[times_b.len() - 1]])
        .collect();
    let reach_s = (IMAGES_AROUND_LOSS as f64 + 0.5) * scan.frame_s;
    let is_near_decisive =
        |k: usize| decisive_times.iter().any(|t| (times_a[k] - t).abs() < reach_s);
    let mut changed = false;
    let sampled = scan.sampled_images();
    for k in 0..times_a.len() - 1 {
        let near_decisive = is_near_decisive(k);
        if !near_decisive && sampled.binary_search(&k).is_err() {
            continue;
        }
        let middle_s = 0.5 * (times_a[k] + times_a[k + 1]);
        let m = times_b.partition_point(|t| *t < middle_s - 0.5 * scan.frame_s);
        let images = if near_decisive { m.saturating_sub(1)..m + 2 } else { m..m + 1 };
        for m in images.filter(|m| *m < times_b.len()) {
            if offsets.iter().any(|o| (o.k, o.m) == (k, m)) {
                continue;
            }
            if let Some(observed) = scan.observe(k, m)? {
                offsets.push(observed);
                changed = true;
            }
        }
    }
    Ok(changed)
}

/// Offsets as fractions of camera a's intervals.
fn timing_observations(
    recording: &Recording,
    cameras: [usize; 2],
    offsets: &[TripleOffset],
) -> Vec<TimingObservation> {
    let [a, b] = cameras.map(|c| &recording.timelines.times_s[c]);
    let fraction = |o: &TripleOffset| {
        let (start_s, end_s) = (a[o.k], a[o.k + 1]);
        // Times ascend strictly, so the interval is positive.
        (b[o.m] + o.offset_s - start_s) / (end_s - start_s)
    };
    offsets
        .iter()
        .map(|o| TimingObservation { cameras, images: [o.k, o.m], fraction: fraction(o) })
        .collect()
}

/// Observes the offset of an ordered pair (a, b) at chosen triples: two images of a, one of b.
struct PairScan<'a, 'b> {
    recording: &'a Recording<'b>,
    cameras: [usize; 2],
    /// The frame period of camera b, seconds.
    frame_s: f64,
}

impl<'a, 'b> PairScan<'a, 'b> {
    fn new(recording: &'a Recording<'b>, cameras: [usize; 2]) -> Self {
        Self { recording, cameras, frame_s: recording.timelines.frame_s(cameras[1]) }
    }

    /// The images of camera a that are observed, evenly spread.
    fn sampled_images(&self) -> Vec<usize> {
        let count = self.recording.timelines.times_s[self.cameras[0]].len() - 1;
        super::spread(count, self.recording.options.max_frames)
    }

    /// The offset at image k of camera a with the highest score, searched for at `steps` frames from
    /// the expected one. `None` if none has enough inliers.
    fn search_near(
        &self,
        k: usize,
        expected_s: f64,
        steps: &[f64],
    ) -> Result<Option<TripleOffset>, CaptureError> {
        let mut best: Option<TripleOffset> = None;
        for &frames in steps {
            let is_expected = |o: &TripleOffset| {
                o.agreement >= MIN_AGREEMENT
                    && (o.offset_s - expected_s).abs() < EXPECTED_WITHIN_FRAMES * self.frame_s
            };
            if frames != 0.0 && best.as_ref().is_some_and(is_expected) {
                break;
            }
            let observed = self.observe_at_offset(k, expected_s + frames * self.frame_s)?;
            best = higher_score(best, observed);
        }
        Ok(best)
    }

    /// The offset observed from images k and k + 1 of camera a and the image of camera b that lies
    /// between them if the offset is about `offset_s`.
    fn observe_at_offset(
        &self,
        k: usize,
        offset_s: f64,
    ) -> Result<Option<TripleOffset>, CaptureError> {
        match self.recording.image_between(self.cameras, k, offset_s) {
            Some(m) => self.observe(k, m),
            None => Ok(None),
        }
    }

    /// The offset observed from images k and k + 1 of camera a and image m of camera b. `None` if
    /// too few candidates agree, or on a time outside camera a's interval.
    fn observe(&self, k: usize, m: usize) -> Result<Option<TripleOffset>, CaptureError> {
        let options = self.recording.options;
        let times = &self.recording.timelines.times_s[self.cameras[0]];
        let triple = self.recording.triple(self.cameras, [k, m])?;
        // Outside the interval trajectories are extrapolated: another image of b is inside.
        let (start, end) = (times[k], times[k + 1]);
        let slack = MAX_OUTSIDE * (end - start);
        let observations: Vec<Observation> = triple
            .samples
            .iter()
            .map(|s| Observation { value_s: s.offset_s(), at_s: 0.0, across_px_s: s.across_px_s })
            .collect();
        let model = residual_model(end - start, options);
        let Some((offset_s, score)) = model.consensus_value(&observations) else {
            return Ok(None);
        };
        let time_s = self.recording.timelines.times_s[self.cameras[1]][m] + offset_s;
        let inside = time_s >= start - slack && time_s <= end + slack;
        let enough = score >= MIN_SCORE_FRACTION * options.min_inliers as f64
            && score >= MIN_INLIER_FRACTION * observations.len() as f64;
        let agreement = score / triple.across.max(1) as f64;
        let fraction = (time_s - start) / (end - start);
        let certain =
            agreement >= MIN_AGREEMENT || (fraction - fraction.round()).abs() > NEAR_FRAME;
        let valid = inside && enough && certain;
        Ok(valid.then_some(TripleOffset { k, m, offset_s, score, agreement }))
    }

    /// Observes the offset between two observations that are a jump apart, until those on both sides
    /// of the jump are neighbours.
    fn bisect_jump(
        &self,
        from: TripleOffset,
        to: TripleOffset,
        bracketing: &mut Vec<TripleOffset>,
    ) -> Result<(), CaptureError> {
        let jump = (to.offset_s - from.offset_s) / self.frame_s;
        if jump.abs() < MIN_JUMP_FRAMES || to.m <= from.m {
            return Ok(());
        }
        let Some(between) = self.observe_between(from, to)? else { return Ok(()) };
        bracketing.push(between);
        self.bisect_jump(from, between, bracketing)?;
        self.bisect_jump(between, to, bracketing)
    }

    /// An observation between two others: in the middle, or as near to it as possible.
    fn observe_between(
        &self,
        from: TripleOffset,
        to: TripleOffset,
    ) -> Result<Option<TripleOffset>, CaptureError> {
        let middle = usize::midpoint(from.k, to.k);
        for away in 0..(to.k - from.k) {
            let candidates = [middle.checked_sub(away), Some(middle + away)];
            for k in candidates.into_iter().flatten().filter(|k| (from.k + 1..to.k).contains(k)) {
                let mut best = None;
                for offset_s in [from.offset_s, to.offset_s, from.offset_s + self.frame_s] {
                    best = higher_score(best, self.observe_at_offset(k, offset_s)?);
                }
                if let Some(best) = best.filter(|o: &TripleOffset| o.m > from.m && o.m < to.m) {
                    return Ok(Some(best));
                }
            }
        }
        Ok(None)
    }
}

/// Of two observations, that of the higher score; the first of equals.
fn higher_score(one: Option<TripleOffset>, other: Option<TripleOffset>) -> Option<TripleOffset> {
    match (one, other) {
        (Some(x), Some(y)) if y.score > x.score => Some(y),
        (Some(x), _) => Some(x),
        (None, y) => y,
    }
}
