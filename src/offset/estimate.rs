//! Offsets from recordings: the stages of the estimation in their order.

use super::alignment::{Activities, rough_offset};
use super::clock::{ClockEstimate, ClockModel, clocks, with_lost_frames};
use super::joint::{ClockLayout, solve_clocks};
use super::lost_frames::{LostFrames, detect_lost_frames};
use super::pair::{
    MAX_STD_ERR_FRAMES, MIN_AGREEMENT, PairEstimate, PairFailure, PairRounds, estimate_pairs, pairs,
};
use super::recording::{Recording, TrackCache};
use super::{CameraOffset, ONE_FRAME, OffsetOptions, Offsets};
use crate::capture::{Capture, CaptureError};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use rayon::prelude::*;

/// The reason of a camera of which too few observations show its lost frames.
const AMBIGUOUS_LOSSES: &str = "frames may be missing, and too few of its images show where";
/// The reason of a camera of which other lost frames explain the observations nearly as well.
const UNDECIDED_LOSSES: &str =
    "frames are missing, or may be, and the images fit several places where they could be";
/// The reason of a camera if the reference's lost frames are ambiguous.
const AMBIGUOUS_REFERENCE: &str =
    "the reference camera may miss frames, and too few of its images show where";

/// The offsets of all cameras, and the pairs that they were solved from.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    /// The pairs that were used: their estimates are certain enough and not contradicted.
    pub pairs: Vec<PairEstimate>,
}

/// Estimates the offsets of all cameras of the store's capture from its images (§7).
///
/// The stages are: rough alignment, lost frames if the capture allows for them, pairs, and all clocks
/// together. A camera of which the offset is not determined has none, and a reason. Nothing is read if
/// all cameras share one clock. The error is that of a frame that cannot be read.
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
    // The gains are computed once, before parallel threads ask for them.
    frames.gains();
    let track_cache = TrackCache::default();
    let nominal = capture.cameras.iter().map(|c| c.clock.clone()).collect();
    let mut recording = Recording::new(frames, nominal, &track_cache, options);
    let mut starts = initial_offsets(&recording, &pairs, reporter)?;
    let mut lost = vec![LostFrames::default(); capture.cameras.len()];
    if capture.cameras.iter().any(|c| c.clock.lost) {
        lost = detect_lost_frames(&recording, &pairs, &mut starts, reporter)?;
        let clock =
            |(c, lost): (usize, &LostFrames)| with_lost_frames(capture, c, &lost.lost_before);
        let clocks = lost.iter().enumerate().map(clock).collect();
        recording = Recording::new(frames, clocks, &track_cache, options);
    }
    // The rate of the reference's clock is 0 by definition.
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
    let results = PairResults { pairs: &pairs, results };
    Ok(JointSolution::new(capture, results, layout, lost).into_estimate())
}

/// Every pair's offset to about a frame, or the failure of its alignment. A camera with a single frame
/// shows no motion.
fn initial_offsets(
    recording: &Recording,
    pairs: &[[usize; 2]],
    reporter: &Reporter,
) -> Result<Vec<Result<ClockModel, PairFailure>>, CaptureError> {
    let activities = Activities::new(recording, pairs)?;
    let task = reporter.task("Rough alignment", pairs.len());
    pairs
        .par_iter()
        .enumerate()
        .map(|(n, pair)| {
            let has_motion = pair.iter().all(|&c| recording.clocks[c].times_s.len() > 1);
            let initial = if has_motion {
                rough_offset(recording, pairs, n, &activities)
            } else {
                Ok(Err(PairFailure::NoMotion))
            };
            task.advance(1);
            initial
        })
        .collect()
}

/// All pairs, and their estimates in the same order.
struct PairResults<'a> {
    pairs: &'a [[usize; 2]],
    results: Vec<Result<PairEstimate, PairFailure>>,
}

impl PairResults<'_> {
    /// Whether a pair may have locked onto the wrong period of a motion: less than [`MIN_AGREEMENT`] of
    /// the moving features agree with it, and another pair of one of its cameras contradicts the nominal
    /// clocks.
    fn contradict(&self, pair: &PairEstimate) -> bool {
        let shares_camera = |other: &[usize; 2]| other.iter().any(|c| pair.cameras.contains(c));
        let mut others =
            self.pairs.iter().zip(&self.results).filter(|(other, _)| shares_camera(other));
        pair.agreement < MIN_AGREEMENT
            && others.any(|(_, result)| matches!(result, Err(PairFailure::ContradictsClocks)))
    }

    /// Whether any pair of a camera has an estimate.
    fn has_estimate(&self, camera: usize) -> bool {
        self.results.iter().flatten().any(|p| p.cameras.contains(&camera))
    }

    /// The failure of the camera's pair that passed the most stages, as a sentence.
    fn failure_reason(&self, camera: usize) -> &'static str {
        let own = self.pairs.iter().zip(&self.results).filter(|(pair, _)| pair.contains(&camera));
        let failures = own
            .map(|(_, result)| result.as_ref().err().copied().unwrap_or(PairFailure::NoConsensus));
        match failures.max() {
            None => "no other camera stands at another place",
            Some(PairFailure::NoOverlap) => {
                "its neighbours filmed at other times, by its clock and theirs"
            }
            Some(PairFailure::TooFewFeatures) => {
                "too few features can be followed from frame to frame"
            }
            Some(PairFailure::NoMotion) => "too few features move",
            Some(PairFailure::MotionAlongEpipolarLines) => {
                "too few features move across the epipolar lines of its neighbours: the motion runs along them"
            }
            Some(PairFailure::NoConsensus | PairFailure::ContradictsClocks) => {
                "too few features agree on one offset"
            }
            Some(PairFailure::PeriodicMotion) => {
                "several offsets, frames apart, fit the motion equally well: it repeats itself"
            }
        }
    }
}

/// All clocks solved together from the usable pairs.
struct JointSolution<'a> {
    capture: &'a Capture,
    results: PairResults<'a>,
    layout: ClockLayout,
    /// By camera.
    lost: Vec<LostFrames>,
    used: Vec<PairEstimate>,
    /// By clock; `None` if it is not determined to [`MAX_STD_ERR_FRAMES`].
    solved: Vec<Option<ClockEstimate>>,
}

impl<'a> JointSolution<'a> {
    fn new(
        capture: &'a Capture,
        results: PairResults<'a>,
        layout: ClockLayout,
        lost: Vec<LostFrames>,
    ) -> Self {
        let max_std_err_s = MAX_STD_ERR_FRAMES * layout.frame_s;
        let used: Vec<PairEstimate> = results
            .results
            .iter()
            .flatten()
            .filter(|p| p.std_err_s <= max_std_err_s && !results.contradict(p))
            .filter(|p| p.cameras.iter().all(|&c| !lost[c].ambiguous))
            .cloned()
            .collect();
        let solved = solve_clocks(&used, &layout)
            .into_iter()
            .map(|clock| clock.filter(|s| s.std_err_s <= max_std_err_s))
            .collect();
        Self { capture, results, layout, lost, used, solved }
    }

    fn into_estimate(self) -> Estimate {
        let cameras = (0..self.capture.cameras.len()).map(|c| self.camera_offset(c)).collect();
        let reference = self.capture.cameras[self.capture.reference].id.clone();
        Estimate { offsets: Offsets { reference, cameras }, pairs: self.used }
    }

    fn camera_offset(&self, c: usize) -> CameraOffset {
        let camera = &self.capture.cameras[c];
        let is_reference = c == self.capture.reference;
        // The offsets of other cameras are the same whatever an undecided camera lost.
        let decided = !self.lost[c].undecided || is_reference;
        let solved = self.solved[self.layout.of_camera[c]].as_ref().filter(|_| decided);
        let drifting = solved.filter(|_| camera.clock.drift && !is_reference);
        CameraOffset {
            id: camera.id.clone(),
            offset_s: solved.map(|s| s.clock.offset_s),
            std_err_s: solved.map(|s| s.std_err_s),
            rate_ppm: drifting.map(|s| 1e6 * s.clock.rate),
            rate_std_err_ppm: drifting.map(|s| 1e6 * s.rate_std_err),
            lost_before: camera.clock.lost.then(|| self.lost[c].lost_before.clone()),
            reason: solved.is_none().then(|| self.reason(c).into()),
        }
    }

    /// Why a camera has no offset.
    fn reason(&self, camera: usize) -> &'static str {
        if self.results.has_estimate(camera) {
            if self.lost[camera].undecided {
                return UNDECIDED_LOSSES;
            }
            if self.lost[camera].ambiguous {
                return AMBIGUOUS_LOSSES;
            }
            if self.lost[self.capture.reference].ambiguous {
                return AMBIGUOUS_REFERENCE;
            }
        }
        if self.capture.cameras[camera].frames.len() == 1 {
            return ONE_FRAME;
        }
        if self.used.iter().any(|p| p.cameras.contains(&camera)) {
            return "its pairs are not connected to the reference camera, or disagree";
        }
        self.results.failure_reason(camera)
    }
}
