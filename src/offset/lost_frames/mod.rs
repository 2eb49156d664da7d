//! Detects lost frames. If a camera loses a frame and its time stamps show no gap, the nominal times of all later
//! images are one frame period too early.
//!
//! A frame triple (two successive frames of camera a, one frame of camera b) gives the offset `offset_b − offset_a`
//! at one instant, eq. (10). Along the recording, this offset increases by a frame period where camera b lost a
//! frame, and decreases by a frame period where camera a lost one. Each such jump is located by bisection, so that
//! the images on both sides of it are observed. Then the clock models of all cameras are fitted to the observations
//! of all pairs ([`descent`]).
//!
//! Known limits: A frame lost while nothing moves is attributed to the next image that shows motion. The loss of a
//! frame directly after the first image or directly before the last image of a recording may be missed. The time of
//! that first or last image is then wrong by one frame. The offset of a camera is unknown if too few of its
//! observations agree, or if other sets of lost frames fit nearly as well. Other sets fit nearly as well if several
//! cameras lose frames within a frame or two of each other, since only relative times are observed.

mod descent;
mod fit;
mod jumps;
mod min_cut;

use super::clock::{ClockModel, NominalClock};
use super::pair::{MIN_AGREEMENT, MIN_INLIERS, Observation, PairFailure, consensus_value};
use super::recording::{Recording, spread};
use crate::capture::CaptureError;
use crate::progress::Reporter;
use descent::fit_clock_models;
use rayon::prelude::*;

/// Relative timing of three images: image `images[1]` of camera `cameras[1]` was taken at `fraction` of the interval
/// from image `images[0]` of camera `cameras[0]` to the next image of that camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimingObservation {
    pub cameras: [usize; 2],
    pub images: [usize; 2],
    /// The time of the image of camera `cameras[1]`, as a fraction of the interval between the two images of camera
    /// `cameras[0]`. It is from 0 to 1, or slightly outside this range if the trajectory was extrapolated.
    pub fraction: f64,
}

/// Clock model of one camera, fitted to timing observations. The model is relative to the common clock of the
/// camera's [`Self::component`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FittedClock {
    pub clock: ClockModel,
    /// Whether the model is unreliable: too large a fraction of the camera's observations are outliers, or the camera
    /// may lose frames and has no observation.
    pub ambiguous: bool,
    /// Whether other sets of lost frames, of this camera or of several cameras, explain the observations nearly as
    /// well. The times of some of this camera's images may then be wrong by whole frames.
    pub undecided: bool,
    /// The index of the camera's connected component, in the graph whose nodes are cameras and whose edges are
    /// observations. Only models of the same component share a common clock.
    pub component: usize,
}

/// Offset of a pair of cameras a and b, observed with one frame triple: two successive images of a and one image of
/// b.
#[derive(Clone, Copy, Debug)]
struct TripleOffset {
    timing: TimingObservation,
    /// `offset_b − offset_a`, seconds.
    offset_s: f64,
    /// The MSAC score of the offset, which is about the number of inliers.
    score: f64,
    /// The MSAC score divided by the number of features that move across their epipolar lines.
    agreement: f64,
}

/// The offsets of a camera pair (a, b) that are tried at an image of a, in order of preference: differences from the
/// expected offset, in frame periods of b. The expected offset is the last observed offset whose agreement is at least
/// [`MIN_AGREEMENT`].
const STEPS: [f64; 6] = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0];
/// The offsets of a camera pair (a, b) that are tried until the first observation succeeds: differences from the
/// initial offset, in frame periods of b. The initial offset holds for most of the recording. Near the recording's
/// start, before several lost frames, the offset may be different.
const FIRST_STEPS: [f64; 7] = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0];
/// The minimum MSAC score (about the number of inliers) at which the offset from a frame triple (two frames of one
/// camera, one frame of another) is used, as a fraction of [`MIN_INLIERS`].
const MIN_SCORE_FRACTION: f64 = 0.5;
/// The minimum MSAC score (about the number of inliers) at which the offset from a frame triple (two frames of one
/// camera, one frame of another) is used, as a fraction of the number of the triple's offset candidates.
const MIN_INLIER_FRACTION: f64 = 0.3;
/// In a frame triple (two successive images of camera a, one image of camera b): if b's image is nearer in time than
/// this to one of a's two images, an observation requires an agreement of at least [`MIN_AGREEMENT`]. The unit is the
/// interval between a's two images. Occluded features and T-junctions falsely agree on the time of one of these two
/// images.
const NEAR_FRAME: f64 = 0.2;
/// In a frame triple (two successive images of camera a, one image of camera b), the maximum time by which b's image
/// may lie outside the interval between a's two images, as a fraction of this interval.
const MAX_OUTSIDE: f64 = 0.25;
/// The minimum change of the offset of a camera pair (a, b) between two observations that counts as a jump by whole
/// frames, in frame periods of b.
const MIN_JUMP_FRAMES: f64 = 0.6;
/// The search for the offset of a camera pair (a, b) at an image of a stops at the first observed offset that meets two
/// conditions. It is within this distance of the expected offset, in frame periods of b, and its agreement is at least
/// [`MIN_AGREEMENT`].
const EXPECTED_WITHIN_FRAMES: f64 = 0.4;
/// The number of images on either side of a lost frame at which further offsets are observed, since only these images
/// show between which of them the frame was lost.
const IMAGES_AROUND_LOSS: usize = 2;
/// The maximum number of rounds of further observations. In each round, the fitted clock models tell which frame
/// triples (two frames of one camera, one frame of another) are about simultaneous. Such triples are observed too, and
/// the models are fitted again.
const MAX_ROUNDS: usize = 3;

/// Detects the lost frames of all cameras. Returns the fitted clock of each camera.
///
/// `starts` holds the initial offset of each of `pairs`, or the reason why there is none. If both cameras of a pair
/// have clock models of the same component (connected by observations), the initial offset is replaced by the offset
/// between the models. A camera that may lose frames but has no observation is marked as ambiguous. Returns an error if
/// a frame cannot be read.
pub fn detect_lost_frames(
    recording: &Recording,
    pairs: &[[usize; 2]],
    starts: &mut [Result<ClockModel, PairFailure>],
    reporter: &Reporter,
) -> Result<Vec<FittedClock>, CaptureError> {
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
    let unobserved = |clock: &NominalClock| FittedClock {
        ambiguous: clock.may_lose_frames,
        ..FittedClock::default()
    };
    let models = models.into_iter().zip(&clocks);
    Ok(models.map(|(model, clock)| model.unwrap_or_else(|| unobserved(clock))).collect())
}

/// Fits the clock models of all cameras to the timing observations of all pairs. Each pair is observed in both
/// directions: with two images of either camera. Returns a model for each camera, `None` for a camera without
/// observations. Returns an error if a frame cannot be read.
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
    let scan = |&(cameras, offset_s): &([usize; 2], f64)| {
        let mut scan = PairScan::new(recording, cameras);
        scan.track_offset(offset_s)?;
        task.advance(1);
        Ok(scan)
    };
    let mut scans = directions.par_iter().map(scan).collect::<Result<Vec<_>, CaptureError>>()?;
    let fit = |scans: &[PairScan]| {
        let offsets = scans.iter().flat_map(|scan| &scan.offsets);
        let observations: Vec<TimingObservation> = offsets.map(|o| o.timing).collect();
        fit_clock_models(clocks, recording.frames.capture().reference, &observations)
    };
    let mut models = fit(&scans);
    for _ in 0..MAX_ROUNDS {
        let changed = scans
            .par_iter_mut()
            .map(|scan| scan.observe_again(clocks, &models))
            .collect::<Result<Vec<bool>, _>>()?;
        if !changed.contains(&true) {
            break;
        }
        models = fit(&scans);
    }
    Ok(models)
}

/// Observed offsets `offset_b − offset_a` of an ordered pair of cameras (a, b) along their recordings.
struct PairScan<'a, 'b> {
    recording: &'a Recording<'b>,
    cameras: [usize; 2],
    /// The frame period of camera b, seconds.
    frame_s: f64,
    offsets: Vec<TripleOffset>,
}

impl<'a, 'b> PairScan<'a, 'b> {
    fn new(recording: &'a Recording<'b>, cameras: [usize; 2]) -> Self {
        let frame_s = recording.clocks[cameras[1]].frame_s();
        Self { recording, cameras, frame_s, offsets: Vec::new() }
    }

    /// Observes the pair's offset at evenly spread images in order of time, then locates its jumps by bisection.
    /// `initial_offset_s` is `offset_b − offset_a` in most of the recording, seconds.
    fn track_offset(&mut self, initial_offset_s: f64) -> Result<(), CaptureError> {
        let mut expected_s = initial_offset_s;
        for k in self.sampled_images() {
            let steps: &[f64] = if self.offsets.is_empty() { &FIRST_STEPS } else { &STEPS };
            let tried_s = steps.iter().map(|frames| expected_s + frames * self.frame_s);
            let is_expected = |o: &TripleOffset| {
                o.agreement >= MIN_AGREEMENT
                    && (o.offset_s - expected_s).abs() < EXPECTED_WITHIN_FRAMES * self.frame_s
            };
            if let Some(observed) = self.best_observation(k, tried_s, is_expected)? {
                // An offset with a low agreement is stored as an observation, but does not change the expected
                // offset.
                if self.offsets.is_empty() || observed.agreement >= MIN_AGREEMENT {
                    expected_s = observed.offset_s;
                }
                self.offsets.push(observed);
            }
        }
        for n in 1..self.offsets.len() {
            self.bisect_jump(self.offsets[n - 1], self.offsets[n])?;
        }
        Ok(())
    }

    /// Observes further frame triples (two frames of one camera, one frame of another) that are about simultaneous
    /// according to the fitted clock models. Near the recordings' ends and near lost frames, every image of camera a is
    /// observed with up to three successive images of camera b. Returns whether any observation is new. `clocks` and
    /// `models` have an entry for each camera.
    fn observe_again(
        &mut self,
        clocks: &[NominalClock],
        models: &[Option<FittedClock>],
    ) -> Result<bool, CaptureError> {
        let [Some(model_a), Some(model_b)] = self.cameras.map(|c| models[c].as_ref()) else {
            return Ok(false);
        };
        let times_a = model_a.clock.image_times_s(&clocks[self.cameras[0]]);
        let times_b = model_b.clock.image_times_s(&clocks[self.cameras[1]]);
        // Near the ends of a recording and near lost frames, only few images give evidence of a loss. All of these
        // images are observed.
        let mut decisive_times = Vec::new();
        for (model, times) in [(model_a, &times_a), (model_b, &times_b)] {
            decisive_times.extend([times[0], times[times.len() - 1]]);
            decisive_times.extend(model.clock.lost_before.iter().map(|n| times[*n]));
        }
        let reach_s = (IMAGES_AROUND_LOSS as f64 + 0.5) * self.frame_s;
        let count_before = self.offsets.len();
        let sampled = self.sampled_images();
        for k in 0..times_a.len() - 1 {
            let near_decisive = decisive_times.iter().any(|t| (times_a[k] - t).abs() < reach_s);
            if !near_decisive && sampled.binary_search(&k).is_err() {
                continue;
            }
            let middle_s = 0.5 * (times_a[k] + times_a[k + 1]);
            let m = times_b.partition_point(|t| *t < middle_s - 0.5 * self.frame_s);
            let images = if near_decisive { m.saturating_sub(1)..m + 2 } else { m..m + 1 };
            for m in images.filter(|m| *m < times_b.len()) {
                if !self.offsets.iter().any(|o| o.timing.images == [k, m]) {
                    self.offsets.extend(self.observe(k, m)?);
                }
            }
        }
        Ok(self.offsets.len() > count_before)
    }

    /// Returns the indices of the evenly spread images of camera a at which the offset is observed first. More
    /// images near lost frames are observed later ([`Self::observe_again`]).
    fn sampled_images(&self) -> Vec<usize> {
        let count = self.recording.clocks[self.cameras[0]].times_s.len() - 1;
        spread(count, self.recording.options.max_frames)
    }

    /// Tries several offsets at images k and k + 1 of camera a. Returns the observation with the highest score, the
    /// first one if scores are equal. `None` if no offset gives an observation.
    ///
    /// `offsets_s` are hypotheses of `offset_b − offset_a`, seconds. Each selects the image of camera b that is
    /// nearest to the middle between the two images. No further hypotheses are tried once `is_enough` is true for the
    /// best observation.
    fn best_observation(
        &self,
        k: usize,
        offsets_s: impl IntoIterator<Item = f64>,
        is_enough: impl Fn(&TripleOffset) -> bool,
    ) -> Result<Option<TripleOffset>, CaptureError> {
        let mut best: Option<TripleOffset> = None;
        for offset_s in offsets_s {
            if best.as_ref().is_some_and(&is_enough) {
                break;
            }
            let Some(m) = self.recording.image_between(self.cameras, k, offset_s) else { continue };
            let Some(observed) = self.observe(k, m)? else { continue };
            if best.is_none_or(|best| observed.score > best.score) {
                best = Some(observed);
            }
        }
        Ok(best)
    }

    /// Observes the offset at images k and k + 1 of camera a and image m of camera b. `None` if too few offset
    /// candidates agree, or if they agree on a time too far outside the interval between a's two images. Also `None` if
    /// this time is near one of these two images and the agreement is below [`MIN_AGREEMENT`].
    fn observe(&self, k: usize, m: usize) -> Result<Option<TripleOffset>, CaptureError> {
        let [times, times_b] = self.cameras.map(|c| &self.recording.clocks[c].times_s);
        let triple = self.recording.triple((self.cameras, [k, m]))?;
        let (start, end) = (times[k], times[k + 1]);
        let slack = MAX_OUTSIDE * (end - start);
        let observations: Vec<Observation> = triple.samples.iter().map(Observation::from).collect();
        let Some((offset_s, score)) = consensus_value(&observations) else { return Ok(None) };
        let time_s = times_b[m] + offset_s;
        let inside = time_s >= start - slack && time_s <= end + slack;
        let enough = score >= MIN_SCORE_FRACTION * MIN_INLIERS as f64
            && score >= MIN_INLIER_FRACTION * observations.len() as f64;
        let agreement = score / triple.across.max(1) as f64;
        // Frame times ascend strictly, so the interval is positive.
        let fraction = (time_s - start) / (end - start);
        let certain =
            agreement >= MIN_AGREEMENT || (fraction - fraction.round()).abs() > NEAR_FRAME;
        let timing = TimingObservation { cameras: self.cameras, images: [k, m], fraction };
        let valid = inside && enough && certain;
        Ok(valid.then_some(TripleOffset { timing, offset_s, score, agreement }))
    }

    /// If the offsets of two observations differ by a jump, observes images between them by bisection. The bisection
    /// ends when no image between the two sides of the jump can be observed.
    fn bisect_jump(&mut self, from: TripleOffset, to: TripleOffset) -> Result<(), CaptureError> {
        let jump = (to.offset_s - from.offset_s) / self.frame_s;
        if jump.abs() < MIN_JUMP_FRAMES || to.timing.images[1] <= from.timing.images[1] {
            return Ok(());
        }
        let Some(between) = self.observe_between(from, to)? else { return Ok(()) };
        self.offsets.push(between);
        self.bisect_jump(from, between)?;
        self.bisect_jump(between, to)
    }

    /// Returns an observation at an image between the images of two given observations, as near to the middle as
    /// possible. `None` if no image between them can be observed.
    fn observe_between(
        &self,
        from: TripleOffset,
        to: TripleOffset,
    ) -> Result<Option<TripleOffset>, CaptureError> {
        let ([first, m_from], [last, m_to]) = (from.timing.images, to.timing.images);
        let middle = usize::midpoint(first, last);
        for away in 0..(last - first) {
            let candidates = [middle.checked_sub(away), Some(middle + away)];
            for k in candidates.into_iter().flatten().filter(|k| (first + 1..last).contains(k)) {
                let tried_s = [from.offset_s, to.offset_s, from.offset_s + self.frame_s];
                let best = self.best_observation(k, tried_s, |_| false)?;
                if best.is_some_and(|o| (m_from + 1..m_to).contains(&o.timing.images[1])) {
                    return Ok(best);
                }
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests;
