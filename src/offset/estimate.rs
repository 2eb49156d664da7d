//! Offsets from recordings: the stages of the estimation in their order.

use super::lost_frames::{LostFrames, detect_lost_frames};
use super::pair::{InitialOffset, MIN_AGREEMENT, PairEstimate, PairFailure};
use super::pairing::{clocks, pairs};
use super::recording::{Recording, TrackCache};
use super::rounds::{PairRounds, estimate_pairs};
use super::timeline::Timelines;
use super::{
    CameraOffset, ClockEstimate, Clocks, ONE_FRAME, OffsetOptions, Offsets, align, solve_clocks,
};
use crate::capture::{Capture, CaptureError};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use rayon::prelude::*;

/// The offsets of all cameras, with the pairs that they were solved from.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    /// The pairs that were used: those with an estimate, certain enough and not contradicted.
    pub pairs: Vec<PairEstimate>,
}

/// Estimates the offsets of all cameras of the store's capture from its images (§7).
///
/// The stages: rough alignment, lost frames where the capture allows for them, pairs with their tracks
/// and candidates, and all clocks together. A camera whose offset is not determined has none, and a reason. Nothing is
/// read if all cameras share one clock. The error is that of a frame that cannot be read.
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
    // Before threads ask for them at once, and each estimates them.
    frames.gains();
    let track_cache = TrackCache::default();
    let mut recording = Recording::new(frames, Timelines::nominal(capture), &track_cache, options);
    let mut starts = initial_offsets(&recording, &pairs, reporter)?;
    let mut ambiguous = vec![false; capture.cameras.len()];
    let mut undecided = ambiguous.clone();
    if capture.cameras.iter().any(|c| c.clock.lost) {
        let lost: LostFrames = detect_lost_frames(&recording, &pairs, &mut starts, reporter)?;
        (ambiguous, undecided) = (lost.ambiguous, lost.undecided);
        recording = Recording::new(frames, lost.timelines, &track_cache, options);
    }
    let drifts = drifts(capture, &clock, count);
    let rounds = pairs.iter().zip(&starts).map(|(&pair, &start)| {
        let with_rate = pair.iter().any(|&c| drifts[clock[c]]);
        PairRounds::new(pair, start, with_rate)
    });
    let results = estimate_pairs(&recording, rounds.collect(), reporter)?;
    let solution = Solution::new(
        &recording,
        PairResults { pairs: &pairs, results },
        Cameras { clock, drifts, ambiguous, undecided },
    );
    Ok(solution.into_estimate())
}

/// Every pair's offset to about a frame. A camera with a single frame shows no motion.
fn initial_offsets(
    recording: &Recording,
    pairs: &[[usize; 2]],
    reporter: &Reporter,
) -> Result<Vec<Result<InitialOffset, PairFailure>>, CaptureError> {
    let activities = align::Activities::new(recording, pairs)?;
    let task = reporter.task("Rough alignment", pairs.len());
    pairs
        .par_iter()
        .enumerate()
        .map(|(n, pair)| {
            let has_motion = pair.iter().all(|&c| recording.timelines.times_s[c].len() > 1);
            let initial = if has_motion {
                align::rough_offset(recording, pairs, n, &activities)
            } else {
                Ok(Err(PairFailure::NoMotion))
            };
            task.advance(1);
            initial
        })
        .collect()
}

/// By clock: whether its rate may be off. That of the reference's clock is 0 by definition.
fn drifts(capture: &Capture, clock: &[usize], count: usize) -> Vec<bool> {
    let mut drifts = vec![false; count];
    for (c, camera) in capture.cameras.iter().enumerate() {
        drifts[clock[c]] |= camera.clock.drift && clock[c] != 0;
    }
    drifts
}

/// The pairs and, in their order, their estimates.
struct PairResults<'a> {
    pairs: &'a [[usize; 2]],
    results: Vec<Result<PairEstimate, PairFailure>>,
}

impl PairResults<'_> {
    /// Whether less than [`MIN_AGREEMENT`] of the moving features agree with a pair, while another
    /// pair of one of its cameras points to a time that the nominal clocks contradict: a periodic
    /// motion agrees with both.
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

    /// The failure of the camera's pair that came furthest, as a sentence.
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

/// What is known of the cameras' clocks beside their offsets.
struct Cameras {
    /// The clock of each camera; 0 is the reference's.
    clock: Vec<usize>,
    /// By clock.
    drifts: Vec<bool>,
    /// By camera: whether too few of its images show its lost frames.
    ambiguous: Vec<bool>,
    /// By camera: whether other lost frames fit nearly as well. Its offset is withheld; the offsets of
    /// others are known through it, since they are the same under any of these losses.
    undecided: Vec<bool>,
}

/// All clocks solved together from the usable pairs.
struct Solution<'a> {
    recording: &'a Recording<'a>,
    results: PairResults<'a>,
    cameras: Cameras,
    used: Vec<PairEstimate>,
    /// By clock; `None` where it is not determined to `max_std_err_frames`.
    solved: Vec<Option<ClockEstimate>>,
}

impl<'a> Solution<'a> {
    fn new(recording: &'a Recording<'a>, results: PairResults<'a>, cameras: Cameras) -> Self {
        let frame_s = recording.frames.capture().frame_s();
        let max_std_err_s = recording.options.max_std_err_frames * frame_s;
        let used: Vec<PairEstimate> = results
            .results
            .iter()
            .flatten()
            .filter(|p| p.std_err_s <= max_std_err_s && !results.contradict(p))
            .filter(|p| p.cameras.iter().all(|&c| !cameras.ambiguous[c]))
            .cloned()
            .collect();
        let first_s = recording.timelines.times_s.iter().map(|t| t[0]).collect();
        let clocks = Clocks {
            of_camera: cameras.clock.clone(),
            first_s,
            drifts: cameras.drifts.clone(),
            frame_s,
        };
        let solved = solve_clocks(&used, &clocks)
            .into_iter()
            .map(|clock| clock.filter(|s| s.std_err_s <= max_std_err_s))
            .collect();
        Self { recording, results, cameras, used, solved }
    }

    fn into_estimate(self) -> Estimate {
        let capture = self.recording.frames.capture();
        let cameras = (0..capture.cameras.len()).map(|c| self.camera_offset(c)).collect();
        let reference = capture.cameras[capture.reference].id.clone();
        Estimate { offsets: Offsets { reference, cameras }, pairs: self.used }
    }

    fn camera_offset(&self, c: usize) -> CameraOffset {
        let capture = self.recording.frames.capture();
        let camera = &capture.cameras[c];
        let decided = !self.cameras.undecided[c] || c == capture.reference;
        let solved = self.solved[self.cameras.clock[c]].filter(|_| decided);
        let drifts = camera.clock.drift && c != capture.reference;
        let lost_before = &self.recording.timelines.lost_before[c];
        CameraOffset {
            id: camera.id.clone(),
            offset_s: solved.map(|s| s.offset_s),
            std_err_s: solved.map(|s| s.std_err_s),
            rate_ppm: solved.filter(|_| drifts).map(|s| 1e6 * s.rate),
            rate_std_err_ppm: solved.filter(|_| drifts).map(|s| 1e6 * s.rate_std_err),
            lost_before: camera.clock.lost.then(|| lost_before.clone()),
            reason: solved.is_none().then(|| self.reason(c).into()),
        }
    }

    /// Why a camera has no offset.
    fn reason(&self, camera: usize) -> &'static str {
        let capture = self.recording.frames.capture();
        if self.results.has_estimate(camera) {
            if self.cameras.undecided[camera] {
                return UNDECIDED_LOSSES;
            }
            if self.cameras.ambiguous[camera] {
                return AMBIGUOUS_LOSSES;
            }
            if self.cameras.ambiguous[capture.reference] {
                return AMBIGUOUS_REFERENCE;
            }
        }
        if capture.cameras[camera].frames.len() == 1 {
            return ONE_FRAME;
        }
        if self.used.iter().any(|p| p.cameras.contains(&camera)) {
            return "its pairs are not connected to the reference camera, or disagree";
        }
        self.results.failure_reason(camera)
    }
}

/// The reason of a camera whose own lost frames are undecided.
const AMBIGUOUS_LOSSES: &str = "frames may be missing, and too few of its images show where";
/// The reason of a camera whose lost frames can't be told from others.
const UNDECIDED_LOSSES: &str =
    "frames are missing, or may be, and the images fit several places where they could be";
/// The reason of a camera whose reference's lost frames are undecided.
const AMBIGUOUS_REFERENCE: &str =
    "the reference camera may miss frames, and too few of its images show where";
