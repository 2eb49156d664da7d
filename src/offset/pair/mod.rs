//! Pairs of cameras: the choice of pairs, the choice of frame triples (two frames of one camera, one frame of the
//! other) for each pair, and the estimate of each pair's offset from its own images alone.

mod fit;
mod mixture;
mod ransac;
mod rounds;
mod time_order;

pub use fit::refit_pair;
pub use mixture::{Mixture, Observation, consensus_value};
pub use ransac::{ransac, weighted_least_squares};
pub use rounds::{PairRounds, estimate_pairs};

use super::calibration::SampleSlopes;
use super::clock::ClockModel;
use super::recording::{Recording, Sample, TripleFrames, spread};
use super::{OffsetMethod, OffsetOptions};
use crate::capture::Capture;
use nalgebra::DMatrix;
use std::sync::Arc;

/// Offset between two cameras i and j, estimated from their two recordings alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PairEstimate {
    /// The indices of the pair's two cameras, i and j.
    pub cameras: [usize; 2],
    /// `offset_j − offset_i` as a function of time on camera i's clock. The model's reference time is the middle of
    /// the time span of all offset candidates. The rate is 0 if neither clock drifts.
    pub clock: ClockModel,
    /// The standard error of the pair's offset, seconds.
    pub std_err_s: f64,
    /// The expected number of inliers among the offset candidates, rounded.
    pub inliers: usize,
    /// The number of offset candidates, including outliers.
    pub candidates: usize,
    /// The number of inliers as a fraction of all features that move across their epipolar lines, 0 to 1.
    pub agreement: f64,
    /// The standard deviation of the inliers' distances from their epipolar lines, pixels. It is that of the narrowest
    /// inlier component of the mixture model.
    pub sigma_px: f64,
    /// The estimates from single frame triples: two successive frames of one of the two cameras and a frame of the
    /// other camera. Triples with too few inliers are left out.
    pub frames: Vec<FrameEstimate>,
    /// The factor, at least 1, by which standard errors are multiplied because the offset candidates are correlated:
    /// their features lie in few independent windows of the tracker. The square of the factor is a variance inflation
    /// factor.
    pub(super) std_err_inflation: f64,
    /// All offset candidates, each with its weight in the mixture model, 1 / px².
    pub(super) samples: Arc<[(Sample, f64)]>,
    /// The derivatives of the offset candidates by the errors of the calibration and of readout times; empty if the
    /// capture states no such errors.
    pub(super) slopes: Arc<SampleSlopes>,
}

impl PairEstimate {
    /// Adds the effect of the calibration errors to the standard error of the pair's offset. The covariance of the
    /// errors is `factor · factorᵀ`. The weights of the offset candidates stay the same.
    pub(super) fn add_calibration(&mut self, factor: &DMatrix<f64>) {
        let signed = self.samples.iter().map(|(s, weight)| {
            let sign = if s.cameras == self.cameras { 1.0 } else { -1.0 };
            sign * weight * s.across_px_s * s.across_px_s
        });
        let signed: Vec<f64> = signed.collect();
        self.std_err_s = self.std_err_s.hypot(self.slopes.std_err_s(&signed, factor));
    }
}

/// Estimates of a pair's offset from one frame triple: two successive frames of `camera`, and one frame of the pair's
/// other camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameEstimate {
    /// The index of the camera with two frames in the triple.
    pub camera: usize,
    /// The index of the earlier one of the two frames of `camera`.
    pub frame: usize,
    /// `offset_j − offset_i` of the pair's cameras i and j by RANSAC and weighted least squares, eqs. (11) to (13),
    /// seconds.
    pub offset_s: f64,
    /// `offset_j − offset_i` of the pair's cameras i and j by a mixture model of inliers and outliers, seconds. Every
    /// offset candidate is weighted by its information: the squared speed across the epipolar line, divided by the
    /// residual's variance.
    pub by_information_s: f64,
}

/// Reason why a pair has no estimate; the variants are in the order of the stages of the estimation. If all pairs of a
/// camera fail, the failure at the latest stage is given as the reason why the camera's offset is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum PairFailure {
    /// According to the clocks, no frame of one camera lies between two frames of the other camera.
    #[error("its neighbours filmed at other times, by its clock and theirs")]
    NoOverlap,
    /// Too few features can be tracked.
    #[error("too few features can be followed from frame to frame")]
    TooFewFeatures,
    /// Too few of the tracked features move.
    #[error("too few features move")]
    NoMotion,
    /// Too few of the moving features move across their epipolar lines.
    #[error(
        "too few features move across the epipolar lines of its neighbours: the motion runs along them"
    )]
    MotionAlongEpipolarLines,
    /// Too few offset candidates agree on one offset.
    #[error("too few features agree on one offset")]
    NoConsensus,
    /// The estimated offset contradicts the nominal clocks, and too few offset candidates agree on it to overrule the
    /// clocks.
    #[error("too few features agree on one offset")]
    ContradictsClocks,
    /// Several offsets that are frames apart have about equally many inliers, because the motion is periodic.
    #[error("several offsets, frames apart, fit the motion equally well: it repeats itself")]
    PeriodicMotion,
}

/// The maximum absolute offset that is consistent with the nominal clocks, in frames.
pub const NOMINAL_CLOCK_FRAMES: f64 = 1.5;
/// The minimum agreement (fraction of inliers, [`PairEstimate::agreement`]) at which an offset larger than
/// [`NOMINAL_CLOCK_FRAMES`] is accepted. The features of a swinging object also agree on offsets that are wrong by the
/// period of the swing.
pub const MIN_AGREEMENT: f64 = 0.5;
/// The minimum number of inliers of a pair's estimate.
pub const MIN_INLIERS: usize = 12;
/// The maximum standard error of a usable offset, in frames. The joint solution ignores pairs with larger standard
/// errors. A camera's offset with a larger standard error is reported as unknown.
pub const MAX_STD_ERR_FRAMES: f64 = 0.1;
/// The absolute cosine of the angle between two baselines above which their epipolar lines count as parallel.
const MAX_ALIGNMENT: f64 = 0.9;
/// The maximum number of cameras with which each camera is paired besides its nearest cameras. Their directions differ
/// from the directions of the cameras already chosen. On a grid, they are a camera of the same column and a camera of a
/// diagonal.
const OTHER_DIRECTIONS: usize = 2;

/// Returns the pairs of cameras whose offsets are estimated, as pairs of camera indices [i, j] with i < j. The pairs
/// are sorted. `clock` holds the index of each camera's clock.
///
/// Every camera is paired with its `neighbors` nearest cameras, including all at equal distances, and with the nearest
/// cameras in other directions. On a grid of cameras, motion along the epipolar lines of a pair in a row crosses the
/// epipolar lines of pairs in columns and diagonals. For [`OffsetMethod::Pairwise`], every camera is paired only with
/// the reference camera (§7). Cameras that share a clock or a centre form no pair.
pub fn pairs(capture: &Capture, clock: &[usize], options: &OffsetOptions) -> Vec<[usize; 2]> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for a in 0..centers.len() {
        let to = |b: usize| centers[b] - centers[a];
        let mut others: Vec<usize> =
            (0..centers.len()).filter(|&b| clock[a] != clock[b] && to(b).norm() > 0.0).collect();
        if options.method == OffsetMethod::Pairwise {
            others.retain(|&b| b == capture.reference);
        }
        others.sort_by(|&x, &y| to(x).norm().total_cmp(&to(y).norm()).then(x.cmp(&y)));
        // All cameras at the same distance as the last neighbour are included, such as both sides of a line or all
        // diagonals of a grid.
        let reach = others
            .get(options.neighbors.saturating_sub(1).min(others.len().wrapping_sub(1)))
            .map_or(0.0, |&b| to(b).norm());
        let near = others.partition_point(|&b| to(b).norm() <= reach * (1.0 + 1e-6));
        let mut chosen = others[..near].to_vec();
        for &b in &others[near..] {
            let is_other_direction =
                |n: &usize| to(b).normalize().dot(&to(*n).normalize()).abs() < MAX_ALIGNMENT;
            if chosen.len() < near + OTHER_DIRECTIONS && chosen.iter().all(is_other_direction) {
                chosen.push(b);
            }
        }
        pairs.extend(chosen.into_iter().map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Chooses the frame triples of a pair of cameras [i, j] by its approximate offset `initial`. A triple has two frames
/// of i and one frame of j, or the reverse. Each of these two directions has at most `max_frames` triples.
pub fn choose_triples(
    recording: &Recording,
    [i, j]: [usize; 2],
    initial: &ClockModel,
) -> Vec<TripleFrames> {
    let max_frames = recording.options.max_frames;
    let mut triples = Vec::new();
    for (a, b, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let times = &recording.clocks[a].times_s;
        let offset_at = |k: usize| {
            let middle = 0.5 * (times[k] + times[k + 1]);
            // The rate is so small that it is the same on either clock.
            sign * initial.offset_at(if sign > 0.0 { middle } else { middle + initial.offset_s })
        };
        let possible: Vec<(usize, usize)> = (0..times.len() - 1)
            .filter_map(|k| Some((k, recording.image_between([a, b], k, offset_at(k))?)))
            .collect();
        // All pairs of a camera use the same frames, so that each frame is tracked once. If too few of these frames
        // are in the overlap of the two recordings, the pair uses frames of its own.
        let common = spread(times.len() - 1, max_frames);
        let mut chosen: Vec<(usize, usize)> =
            possible.iter().filter(|(k, _)| common.binary_search(k).is_ok()).copied().collect();
        if chosen.len() < possible.len().min(max_frames) / 2 {
            let spread = spread(possible.len(), max_frames);
            chosen = spread.into_iter().map(|n| possible[n]).collect();
        }
        triples.extend(chosen.into_iter().map(|(k, m)| ([a, b], [k, m])));
    }
    triples
}
