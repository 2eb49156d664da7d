//! Estimates the temporal offsets from recordings: the stages in their order.

use super::alignment::align;
use super::calibration::CalibrationUnknowns;
use super::clock::{ClockEstimate, clocks, with_lost_frames};
use super::joint::{ClockLayout, SolvedClocks, solve_clocks};
use super::lost_frames::{FittedClock, detect_lost_frames};
use super::pair::{
    MAX_STD_ERR_FRAMES, MIN_AGREEMENT, PairEstimate, PairFailure, PairRounds, estimate_pairs,
    pairs, refit_pair,
};
use super::recording::{Recording, TrackCache};
use super::{CameraOffset, ONE_FRAME, OffsetMethod, OffsetOptions, Offsets};
use crate::capture::{Capture, CaptureError};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use rayon::prelude::*;
use std::sync::Arc;

/// The reason given for an unknown offset if too few observations show which frames the camera lost.
const AMBIGUOUS_LOSSES: &str = "frames may be missing, and too few of its images show where";
/// The reason given for an unknown offset if other sets of lost frames explain the observations nearly as well.
const UNDECIDED_LOSSES: &str =
    "frames are missing, or may be, and the images fit several places where they could be";
/// The reason given for an unknown offset if the lost frames of the reference camera are ambiguous.
const AMBIGUOUS_REFERENCE: &str =
    "the reference camera may miss frames, and too few of its images show where";

/// Temporal offsets of all cameras, and the estimates of single camera pairs from which the offsets were solved.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    /// The pair estimates that the joint solution for all clocks uses. Each has a standard error of at most a tenth of
    /// a frame, and is not contradicted by another pair.
    pub pairs: Vec<PairEstimate>,
}

/// Estimates the temporal offsets of all cameras of the frame store's capture from its images (§7).
///
/// The stages are: rough alignment of each pair of cameras, detection of lost frames if the capture allows for them,
/// precise estimation of each pair's offset, and joint solution for all clocks. If a camera's offset can't be
/// determined, the result has the reason instead. If all cameras share one clock, all offsets are 0, and no frame is
/// read. Returns an error if a frame cannot be read.
pub fn estimate(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Estimate, CaptureError> {
    let capture = frames.capture();
    let (clock, count) = clocks(capture);
    if count == 1 {
        return Ok(Estimate { offsets: Offsets::known(capture), pairs: Vec::new() });
    }
    let pairs = pairs(capture, &clock, options);
    // The cameras' exposure gains are computed once, before parallel threads need them.
    frames.gains();
    let track_cache = TrackCache::default();
    let nominal = capture.cameras.iter().map(|c| c.clock.clone()).collect();
    let mut recording = Recording::new(frames, nominal, &track_cache, options);
    let (pairs, mut starts): (Vec<_>, Vec<_>) =
        align(&recording, &clock, pairs, reporter)?.into_iter().unzip();
    let mut lost = vec![FittedClock::default(); capture.cameras.len()];
    if capture.cameras.iter().any(|c| c.clock.lost) {
        lost = detect_lost_frames(&recording, &pairs, &mut starts, reporter)?;
        let clock = |(c, lost): (usize, &FittedClock)| {
            with_lost_frames(capture, c, &lost.clock.lost_before)
        };
        let clocks = lost.iter().enumerate().map(clock).collect();
        recording = Recording::new(frames, clocks, &track_cache, options);
    }
    // The rate of the reference camera's clock is 0 by definition.
    let mut drifts = vec![false; count];
    for (camera, &clock) in capture.cameras.iter().zip(&clock) {
        drifts[clock] |= camera.clock.drift && clock != 0;
    }
    let rounds = pairs.iter().zip(starts).map(|(&pair, start)| {
        let with_rate = pair.iter().any(|&c| drifts[clock[c]]);
        PairRounds::new(pair, start, with_rate)
    });
    let results = estimate_pairs(&recording, rounds.collect(), reporter)?;
    let first_s = recording.clocks.iter().map(|c| c.times_s[0]).collect();
    let layout = ClockLayout { of_camera: clock, first_s, drifts, frame_s: capture.frame_s() };
    let results = pairs.into_iter().zip(results).collect();
    let solution = JointSolution::new(capture, results, layout, lost, options.method);
    Ok(solution.into_estimate())
}

/// The number of times that the pairs are fitted again, each time after the estimated calibration errors are
/// subtracted from their offset candidates.
const CALIBRATION_ROUNDS: usize = 3;

/// Solves for all clocks together with the calibration errors and the errors of readout times. Adds the effect of these
/// errors to the standard errors of `pairs`.
///
/// For [`OffsetMethod::Pairwise`], the errors are not unknowns. They only increase the standard errors of the pairs,
/// from which the standard errors of the clocks follow.
fn solve_with_calibration(
    capture: &Capture,
    unknowns: &CalibrationUnknowns,
    pairs: &mut [PairEstimate],
    layout: &ClockLayout,
    method: OffsetMethod,
) -> SolvedClocks {
    pairs.par_iter_mut().for_each(|pair| {
        pair.slopes = Arc::new(unknowns.slopes(pair.cameras, &pair.samples));
    });
    let mut refitted = pairs.to_vec();
    pairs.iter_mut().for_each(|pair| pair.add_calibration(&unknowns.factor));
    if method == OffsetMethod::Pairwise {
        return solve_clocks(pairs, layout, None);
    }
    let mut solution = solve_clocks(&refitted, layout, Some(&unknowns.factor));
    for _ in 0..CALIBRATION_ROUNDS {
        refitted.par_iter_mut().for_each(|pair| {
            let frames_s = pair.cameras.map(|c| capture.cameras[c].clock.frame_s());
            let with_rate = pair.cameras.iter().any(|&c| layout.drifts[layout.of_camera[c]]);
            let longer_s = frames_s[0].max(frames_s[1]);
            if let Some(again) = refit_pair(pair, &solution.errors, longer_s, with_rate) {
                *pair = again;
            }
        });
        solution = solve_clocks(&refitted, layout, Some(&unknowns.factor));
    }
    solution
}

/// Readout time of a rolling shutter that was estimated together with the offsets, seconds.
#[derive(Clone, Copy, Debug)]
struct Readout {
    readout_s: f64,
    std_err_s: f64,
}

impl Readout {
    /// Returns the readout time of a camera, from 0 to the time between frames; `None` if the camera's readout time is
    /// exact, if it isn't among the unknowns, or if the camera has one frame.
    ///
    /// Known limit: a readout time that is moved into this range no longer fits the offsets exactly, which were solved
    /// with the one outside.
    fn of(
        capture: &Capture,
        camera: usize,
        unknowns: &CalibrationUnknowns,
        solved: &SolvedClocks,
    ) -> Option<Self> {
        let index = unknowns.readout(camera)?;
        let clock = &capture.cameras[camera].clock;
        let longest_s = clock.longest_readout_s()?;
        let estimated_s = clock.readout_s + solved.errors.get(index)?;
        let std_err_s = *solved.error_std_errs.get(index)?;
        Some(Self { readout_s: estimated_s.clamp(0.0, longest_s), std_err_s })
    }
}

/// Result of one pair: the indices of its two cameras, with the pair's estimate or the reason why there is none.
type PairResult = ([usize; 2], Result<PairEstimate, PairFailure>);

/// The joint solution for all clocks, with the results of all pairs and the lost frames of all cameras. Together they
/// determine each camera's reported offset. The solution uses only the pairs whose standard errors are small and whose
/// offsets no other pair contradicts.
struct JointSolution<'a> {
    capture: &'a Capture,
    results: Vec<PairResult>,
    /// The index of each camera's clock, by camera.
    clock: Vec<usize>,
    /// The clock model that the detection of lost frames fitted for each camera, by camera.
    lost: Vec<FittedClock>,
    used: Vec<PairEstimate>,
    /// The estimate of each clock, by clock. `None` if no chain of pairs connects the clock to the reference camera's
    /// clock, or if the standard error of its offset exceeds [`MAX_STD_ERR_FRAMES`].
    solved: Vec<Option<ClockEstimate>>,
    /// The estimated readout time of each camera, by camera.
    readouts: Vec<Option<Readout>>,
}

impl<'a> JointSolution<'a> {
    fn new(
        capture: &'a Capture,
        results: Vec<PairResult>,
        layout: ClockLayout,
        lost: Vec<FittedClock>,
        method: OffsetMethod,
    ) -> Self {
        // A pair is contradicted if its offset may be wrong by a period of a periodic motion: its agreement is below
        // MIN_AGREEMENT, and another pair with one of its cameras has failed because that other pair's offset
        // contradicts the nominal clocks.
        let is_contradicted = |pair: &PairEstimate| {
            let contradicts = |(other, result): &PairResult| {
                other.iter().any(|c| pair.cameras.contains(c))
                    && matches!(result, Err(PairFailure::ContradictsClocks))
            };
            pair.agreement < MIN_AGREEMENT && results.iter().any(contradicts)
        };
        let max_std_err_s = MAX_STD_ERR_FRAMES * layout.frame_s;
        let mut used: Vec<PairEstimate> = results
            .iter()
            .filter_map(|(_, result)| result.as_ref().ok())
            .filter(|p| p.std_err_s <= max_std_err_s && !is_contradicted(p))
            .filter(|p| p.cameras.iter().all(|&c| !lost[c].ambiguous))
            .cloned()
            .collect();
        let errors = capture.calibration_errors.as_deref().filter(|e| !e.parameters.is_empty());
        let readout_std_s: Vec<f64> =
            capture.cameras.iter().map(|c| c.clock.readout_std_s).collect();
        let cameras = capture.cameras.iter().map(|c| &c.camera).collect();
        let unknowns = CalibrationUnknowns::new(errors, cameras, &readout_std_s);
        let solution = if unknowns.factor.is_empty() {
            solve_clocks(&used, &layout, None)
        } else {
            solve_with_calibration(capture, &unknowns, &mut used, &layout, method)
        };
        let readout = |c| Readout::of(capture, c, &unknowns, &solution);
        let readouts = (0..capture.cameras.len()).map(readout).collect();
        let is_known = |s: &ClockEstimate| s.std_err_s <= max_std_err_s;
        let solved = solution.by_clock.into_iter().map(|clock| clock.filter(is_known)).collect();
        Self { capture, results, clock: layout.of_camera, lost, used, solved, readouts }
    }

    fn into_estimate(self) -> Estimate {
        let cameras = (0..self.capture.cameras.len()).map(|c| self.camera_offset(c)).collect();
        let reference = self.capture.cameras[self.capture.reference].id.clone();
        Estimate { offsets: Offsets { reference, cameras }, pairs: self.used }
    }

    fn camera_offset(&self, c: usize) -> CameraOffset {
        let camera = &self.capture.cameras[c];
        let is_reference = c == self.capture.reference;
        // A camera whose lost frames are undecided gets no offset; the offsets of other cameras do not depend on
        // this. The reference camera always gets an offset.
        let decided = !self.lost[c].undecided || is_reference;
        let solved = self.solved[self.clock[c]].as_ref().filter(|_| decided);
        let drifting = solved.filter(|_| camera.clock.drift && !is_reference);
        CameraOffset {
            id: camera.id.clone(),
            offset_s: solved.map(|s| s.clock.offset_s),
            std_err_s: solved.map(|s| s.std_err_s),
            rate_ppm: drifting.map(|s| 1e6 * s.clock.rate),
            rate_std_err_ppm: drifting.map(|s| 1e6 * s.rate_std_err),
            readout_s: self.readouts[c].map(|r| r.readout_s),
            readout_std_err_s: self.readouts[c].map(|r| r.std_err_s),
            lost_before: camera.clock.lost.then(|| self.lost[c].clock.lost_before.clone()),
            reason: solved.is_none().then(|| self.reason(c)),
        }
    }

    /// Returns the reason why a camera has no offset.
    fn reason(&self, camera: usize) -> String {
        let results = || self.results.iter().filter(|(pair, _)| pair.contains(&camera));
        let has_estimate = results().any(|(_, result)| result.is_ok());
        let reason = if has_estimate && self.lost[camera].undecided {
            UNDECIDED_LOSSES
        } else if has_estimate && self.lost[camera].ambiguous {
            AMBIGUOUS_LOSSES
        } else if has_estimate && self.lost[self.capture.reference].ambiguous {
            AMBIGUOUS_REFERENCE
        } else if self.capture.cameras[camera].frames.len() == 1 {
            ONE_FRAME
        } else if self.used.iter().any(|p| p.cameras.contains(&camera)) {
            "its pairs are not connected to the reference camera, or disagree"
        } else {
            // Of the failures of the camera's pairs, the one at the latest stage is the reason.
            let failure = |(_, result): &PairResult| {
                result.as_ref().err().copied().unwrap_or(PairFailure::NoConsensus)
            };
            let furthest = results().map(failure).max();
            let alone = || "no other camera stands at another place".into();
            return furthest.map_or_else(alone, |failure| failure.to_string());
        };
        reason.into()
    }
}
