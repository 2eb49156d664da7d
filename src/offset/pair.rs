//! The offset between two cameras, from all frame triples of both directions.

use super::recording::{Recording, Sample};
use crate::capture::CaptureError;
use serde::Serialize;
use std::sync::Arc;

/// The estimate from one pair of cameras, (i, j), alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairEstimate {
    /// The indices of cameras i and j.
    pub cameras: [usize; 2],
    /// `offset_j − offset_i` at `center_s`, seconds.
    pub offset_s: f64,
    /// The standard error of `offset_s`, seconds.
    pub std_err_s: f64,
    /// The change of the offset, seconds a second; 0 where neither clock drifts.
    pub rate: f64,
    /// The middle of the times of all candidates, on camera i's clock, seconds.
    pub center_s: f64,
    /// The expected number of inliers, rounded.
    pub inliers: usize,
    /// The number of candidates, outliers included.
    pub candidates: usize,
    /// The inliers over all features that move across their epipolar lines, 0 to 1.
    pub agreement: f64,
    /// The standard deviation of the inliers' distances from their epipolar lines, pixels.
    pub sigma_px: f64,
    /// The estimates of single frame triples.
    pub frames: Vec<FrameEstimate>,
    /// The factor on standard errors that accounts for the few independent windows that the
    /// candidates come from; its square is a variance inflation factor. At least 1 where estimated.
    #[serde(skip)]
    pub(super) std_err_inflation: f64,
    /// All candidates, each with its weight in the mixture, 1 / px².
    #[serde(skip)]
    pub(super) samples: Arc<[(Sample, f64)]>,
}

/// The estimates from one frame triple: two successive frames of `camera`, one frame of the pair's
/// other camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameEstimate {
    /// The index of the camera with two frames.
    pub camera: usize,
    /// The index of the earlier one of them.
    pub frame: usize,
    /// `offset_j − offset_i` by RANSAC and WLS, eqs. (11) to (13), seconds.
    pub offset_s: f64,
    /// `offset_j − offset_i` by the information-weighted mixture, seconds.
    pub by_information_s: f64,
    /// The standard error of `by_information_s`, if candidates err independently, seconds.
    pub std_err_s: f64,
    /// The number of RANSAC's inliers.
    pub inliers: usize,
    /// The number of candidates.
    pub candidates: usize,
}

/// Why a pair has no estimate, in the order of the stages that fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PairFailure {
    /// By the clocks, no frame of one camera lies between two frames of the other.
    NoOverlap,
    /// Too few features can be tracked.
    TooFewFeatures,
    /// Too few of the tracked features move.
    NoMotion,
    /// Too few of the moving features move across their epipolar lines.
    MotionAlongEpipolarLines,
    /// Too few candidates agree on one offset.
    NoConsensus,
    /// Candidates agree on an offset that the nominal clocks contradict, and too few of them do for
    /// that.
    ContradictsClocks,
    /// Several offsets, frames apart, have equally many inliers: the motion is periodic.
    PeriodicMotion,
}

/// A pair's offset before it is estimated: a linear function of time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InitialOffset {
    /// `offset_j − offset_i` at `center_s`, seconds.
    pub value_s: f64,
    /// Its change, seconds a second.
    pub rate: f64,
    /// The time of `value_s` on camera i's clock, seconds.
    pub center_s: f64,
}

impl InitialOffset {
    /// An offset that does not change.
    pub fn constant(value_s: f64) -> Self {
        Self { value_s, ..Self::default() }
    }

    /// `offset_j − offset_i` at a time on camera i's clock, seconds.
    pub fn at(&self, time_s: f64) -> f64 {
        self.value_s + self.rate * (time_s - self.center_s)
    }
}

/// Nominal clocks that are off by at most this many frames are taken to be right. Larger prefers a
/// periodic motion's offset near 0 to the true one; smaller rejects offsets within the tolerance that
/// clocks without synchronization have.
pub const NOMINAL_CLOCK_FRAMES: f64 = 1.5;
/// The inliers that an offset beyond [`NOMINAL_CLOCK_FRAMES`] needs, as a fraction of all features
/// that move across their epipolar lines: a swinging part of the scene has inliers a period away from
/// the true offset. Larger rejects pairs in which many features are occluded in one camera; smaller
/// accepts the wrong period of one of two swings.
pub const MIN_AGREEMENT: f64 = 0.5;
/// Cameras a and b; frame k of a, whose successor is the triple's second frame, and frame m of b.
pub type TripleFrames = ([usize; 2], [usize; 2]);

/// A pair's frame triples, with their candidates.
pub struct PairTriples {
    /// The indices of cameras i and j.
    pub cameras: [usize; 2],
    pub frames: Vec<TripleFrames>,
    /// In the order of `frames`.
    pub triples: Vec<Arc<super::recording::Triple>>,
}

impl PairTriples {
    pub fn new(
        recording: &Recording,
        cameras: [usize; 2],
        frames: Vec<TripleFrames>,
    ) -> Result<Self, CaptureError> {
        let triples = frames
            .iter()
            .map(|&(pair, frames)| recording.triple(pair, frames))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { cameras, frames, triples })
    }
}

/// The frame triples of a pair, in both directions, at most `max_frames` in each.
pub fn choose_triples(
    recording: &Recording,
    [i, j]: [usize; 2],
    initial: &InitialOffset,
) -> Vec<TripleFrames> {
    let max_frames = recording.options.max_frames;
    let mut frames = Vec::new();
    for (a, b, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let times = &recording.timelines.times_s[a];
        let offset_at = |k: usize| {
            let middle = 0.5 * (times[k] + times[k + 1]);
            // Rates are so small that they are the same on either clock.
            sign * initial.at(if sign > 0.0 { middle } else { middle + initial.value_s })
        };
        let possible: Vec<(usize, usize)> = (0..times.len() - 1)
            .filter_map(|k| Some((k, recording.image_between([a, b], k, offset_at(k))?)))
            .collect();
        // The same frames of a camera in all its pairs, so that each is tracked once; where
        // recordings overlap only in part, frames of the overlap.
        let common = super::spread(times.len() - 1, max_frames);
        let mut chosen: Vec<(usize, usize)> =
            possible.iter().filter(|(k, _)| common.binary_search(k).is_ok()).copied().collect();
        if chosen.len() < possible.len().min(max_frames) / 2 {
            let spread = super::spread(possible.len(), max_frames);
            chosen = spread.into_iter().map(|n| possible[n]).collect();
        }
        frames.extend(chosen.into_iter().map(|(k, m)| ([a, b], [k, m])));
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_initial_offset_is_linear_in_time() {
        let initial = InitialOffset { value_s: 0.01, rate: 1e-4, center_s: 5.0 };
        assert!((initial.at(15.0) - 0.011).abs() < 1e-15);
        assert_eq!(InitialOffset::constant(0.2).at(99.0), 0.2);
    }
}
