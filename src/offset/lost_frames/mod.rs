//! Lost frames: a camera that drops a frame without a trace is one frame late from there on.
//!
//! One triple of frames gives a pair's offset at one instant (eq. (10)). Tracked along the recording,
//! a pair's offset jumps up by a frame where the camera of the single frame lost one, and down where
//! the other camera did. Jumps are bracketed by bisection, so that images on both sides of each are
//! observed. The clock models of all cameras are then fitted to the observations of all pairs
//! ([`descent`]).
//!
//! Known limits: a frame lost while nothing moves is attributed to the next image that shows motion.
//! A frame lost after the first or before the last image of a recording may be missed; these images
//! are then a frame off. The offset of a camera is unknown if too few of its observations agree, or if
//! other losses fit nearly as well: cameras that lose frames within a frame or two of each other hide
//! each other's losses.

mod descent;
mod fit;
mod jumps;
mod min_cut;

use super::clock::{ClockModel, NominalClock};
use super::pair::{MIN_AGREEMENT, MIN_INLIERS, Observation, PairFailure, ResidualModel};
use super::recording::{Recording, spread};
use crate::capture::CaptureError;
use crate::progress::Reporter;
use descent::fit_clock_models;
use rayon::prelude::*;

/// The relative timing of three images: image `images[1]` of camera `cameras[1]` was taken at
/// `fraction` of the interval from image `images[0]` of camera `cameras[0]` to its next image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimingObservation {
    pub cameras: [usize; 2],
    pub images: [usize; 2],
    /// A fraction of 0 to 1, or slightly outside for an extrapolated trajectory.
    pub fraction: f64,
}

/// A camera's clock model on the common clock of its component, fitted to timing observations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FittedClock {
    pub clock: ClockModel,
    /// Whether too many of the observations contradict the model.
    pub ambiguous: bool,
    /// Whether other lost frames, of this camera and of others, explain the observations nearly as well:
    /// times of some of its images are then off by a frame.
    pub undecided: bool,
    /// The connected component of the observation graph that the camera belongs to. Only models of
    /// the same component share a common clock.
    pub component: usize,
}

impl FittedClock {
    fn new(clock: ClockModel, component: usize) -> Self {
        Self { clock, ambiguous: false, undecided: false, component }
    }
}

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

/// The offsets that are tried, in frames from the offset observed last, in order of preference.
const STEPS: [f64; 6] = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0];
/// The offsets that are tried at the start of a recording, in frames from the initial offset. That is
/// the offset of the recording's main part, which may be several losses later.
const FIRST_STEPS: [f64; 7] = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0];
/// The minimum score of a triple, as a fraction of the minimum inliers of a pair.
const MIN_SCORE_FRACTION: f64 = 0.5;
/// The minimum score of a triple, as a fraction of its candidates.
const MIN_INLIER_FRACTION: f64 = 0.3;
/// The distance of a time from a frame, as a fraction of the interval, within which a triple requires
/// [`MIN_AGREEMENT`]: occluded features and T-junctions agree on the time of one of the two frames.
const NEAR_FRAME: f64 = 0.2;
/// The maximum distance of camera b's image from camera a's interval, as a fraction of the interval.
const MAX_OUTSIDE: f64 = 0.25;
/// The change of the offset, frames, beyond which it is a jump by whole frames.
const MIN_JUMP_FRAMES: f64 = 0.6;
/// The difference from the expected offset, frames, within which an offset of enough agreement ends the
/// search.
const EXPECTED_WITHIN_FRAMES: f64 = 0.4;
/// The number of images on either side of a lost frame that are observed again.
const IMAGES_AROUND_LOSS: usize = 2;
/// The maximum number of rounds of observing again by the fitted clock models.
const MAX_ROUNDS: usize = 3;

/// The lost frames of a camera, and whether the observations determine them.
#[derive(Clone, Debug, Default)]
pub struct LostFrames {
    /// The images before which a frame is missing, ascending, one entry for each frame.
    pub lost_before: Vec<usize>,
    /// Whether too few observations agree on the lost frames.
    pub ambiguous: bool,
    /// Whether other lost frames explain the observations nearly as well.
    pub undecided: bool,
}

/// Detects the lost frames of all cameras; the result is by camera.
///
/// `starts` holds each pair's initial offset. Offsets of pairs with fitted clock models are replaced by
/// those of the models. A camera that may lose frames and is never observed is ambiguous.
pub fn detect_lost_frames(
    recording: &Recording,
    pairs: &[[usize; 2]],
    starts: &mut [Result<ClockModel, PairFailure>],
    reporter: &Reporter,
) -> Result<Vec<LostFrames>, CaptureError> {
    let capture = recording.frames.capture();
    let count = capture.cameras.len();
    let clocks: Vec<_> = (0..count).map(|c| NominalClock::of_camera(capture, c)).collect();
    let models = joint_models(recording, pairs, starts, &clocks, reporter)?;
    for (pair, start) in pairs.iter().zip(starts) {
        let [Some(i), Some(j)] = pair.map(|c| models[c].as_ref()) else { continue };
        if start.is_ok() && i.component == j.component {
            *start = Ok(j.clock.relative_to(&i.clock));
        }
    }
    let lost_frames = |(model, nominal): (Option<FittedClock>, &NominalClock)| match model {
        Some(FittedClock { clock, ambiguous, undecided, .. }) => {
            LostFrames { lost_before: clock.lost_before, ambiguous, undecided }
        }
        None => LostFrames { ambiguous: nominal.may_lose_frames, ..LostFrames::default() },
    };
    Ok(models.into_iter().zip(&clocks).map(lost_frames).collect())
}

/// Fits the clock models of all cameras to the observations of every pair in both directions.
fn joint_models(
    recording: &Recording,
    pairs: &[[usize; 2]],
    starts: &[Result<ClockModel, PairFailure>],
    clocks: &[NominalClock],
    reporter: &Reporter,
) -> Result<Vec<Option<FittedClock>>, CaptureError> {
    let directions: Vec<([usize; 2], f64)> = pairs
        .iter()
        .zip(starts)
        .filter_map(|(pair, start)| Some((pair, start.as_ref().ok()?.offset_s)))
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

/// Tracks the offset of the pair (a, b) along the recording, from the initial offset of its main part,
/// and brackets its jumps.
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

/// Adds observations of the triples that the fitted clock models predict, and returns whether there are
/// any new ones. At the recordings' ends and on either side of lost frames, each image of camera a is
/// observed with every plausible image of camera b.
fn observe_again(
    recording: &Recording,
    cameras: [usize; 2],
    clocks: &[NominalClock],
    models: &[Option<FittedClock>],
    offsets: &mut Vec<TripleOffset>,
) -> Result<bool, CaptureError> {
    let [Some(model_a), Some(model_b)] = cameras.map(|c| models[c].as_ref()) else {
        return Ok(false);
    };
    let scan = PairScan::new(recording, cameras);
    let times_a = model_a.clock.image_times_s(&clocks[cameras[0]]);
    let times_b = model_b.clock.image_times_s(&clocks[cameras[1]]);
    // Few images show a loss next to a recording's end: all of them are observed.
    let decisive_times: Vec<f64> = [(model_a, &times_a), (model_b, &times_b)]
        .into_iter()
        .flat_map(|(model, times)| model.clock.lost_before.iter().chain([&0]).map(|n| times[*n]))
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

/// Converts offsets to fractions of camera a's intervals.
fn timing_observations(
    recording: &Recording,
    cameras: [usize; 2],
    offsets: &[TripleOffset],
) -> Vec<TimingObservation> {
    let [a, b] = cameras.map(|c| &recording.clocks[c].times_s);
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

/// Observations of the offset of an ordered pair (a, b) at chosen triples: two images of a, one of b.
struct PairScan<'a, 'b> {
    recording: &'a Recording<'b>,
    cameras: [usize; 2],
    /// The frame period of camera b, seconds.
    frame_s: f64,
}

impl<'a, 'b> PairScan<'a, 'b> {
    fn new(recording: &'a Recording<'b>, cameras: [usize; 2]) -> Self {
        Self { recording, cameras, frame_s: recording.clocks[cameras[1]].frame_s() }
    }

    /// The images of camera a that are observed first, evenly spread.
    fn sampled_images(&self) -> Vec<usize> {
        let count = self.recording.clocks[self.cameras[0]].times_s.len() - 1;
        spread(count, self.recording.options.max_frames)
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
        let [times, times_b] = self.cameras.map(|c| &self.recording.clocks[c].times_s);
        let triple = self.recording.triple((self.cameras, [k, m]))?;
        let (start, end) = (times[k], times[k + 1]);
        let slack = MAX_OUTSIDE * (end - start);
        let observations: Vec<Observation> = triple.samples.iter().map(Observation::from).collect();
        let model = ResidualModel::new(end - start);
        let Some((offset_s, score)) = model.consensus_value(&observations) else {
            return Ok(None);
        };
        let time_s = times_b[m] + offset_s;
        let inside = time_s >= start - slack && time_s <= end + slack;
        let enough = score >= MIN_SCORE_FRACTION * MIN_INLIERS as f64
            && score >= MIN_INLIER_FRACTION * observations.len() as f64;
        let agreement = score / triple.across.max(1) as f64;
        let fraction = (time_s - start) / (end - start);
        let certain =
            agreement >= MIN_AGREEMENT || (fraction - fraction.round()).abs() > NEAR_FRAME;
        let valid = inside && enough && certain;
        Ok(valid.then_some(TripleOffset { k, m, offset_s, score, agreement }))
    }

    /// Bisects the images between two observations that are a jump apart, until the observations on both
    /// sides of the jump are neighbours.
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

    /// An observation of an image between two others, as near to their middle as possible.
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

/// The observation of the higher score; the first of two with equal scores.
fn higher_score(one: Option<TripleOffset>, other: Option<TripleOffset>) -> Option<TripleOffset> {
    match (one, other) {
        (Some(x), Some(y)) if y.score > x.score => Some(y),
        (Some(x), _) => Some(x),
        (None, y) => y,
    }
}

#[cfg(test)]
mod tests;
