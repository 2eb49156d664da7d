//! Estimates a pair's offset, rate and standard error from the offset candidates of its frame triples (two frames of
//! one camera, one frame of the other).

use super::mixture::{Mixture, Observation, consensus_value};
use super::ransac::{ransac, weighted_least_squares};
use super::{
    FrameEstimate, MIN_AGREEMENT, MIN_INLIERS, NOMINAL_CLOCK_FRAMES, PairEstimate, PairFailure,
};
use crate::capture::CaptureError;
use crate::offset::OffsetMethod;
use crate::offset::clock::ClockModel;
use crate::offset::recording::{FrameTriple, Recording, Sample, TripleFrames};
use crate::offset::uncertainty::{Sandwich, effective_number, std_err_inflation};
use nalgebra::DVector;
use std::sync::Arc;

/// The RANSAC tolerance d of §7, as a fraction of the frame interval Δt.
const TOLERANCE_FRACTION: f64 = 0.05;
/// The product γ·Δt: γ is the decay rate of the weights in eq. (12), and Δt the frame interval.
const GAMMA: f64 = 70.0;
/// The minimum fraction of inliers among a pair's offset candidates. Wrong candidates are spread over a few frame
/// periods, so a small fraction of them is within the tolerance of any offset.
const MIN_INLIER_FRACTION: f64 = 0.15;
/// The minimum number of a pair's moving features, as a fraction of all its tracked features. If fewer move, they may
/// be mismatches, and the pair fails with [`PairFailure::NoMotion`] if it has too few offset candidates.
const MIN_MOVING_FRACTION: f64 = 0.01;
/// The minimum number of a pair's inliers, as a fraction of its moving features. If all motion is along the epipolar
/// lines, T-junctions and occluded features still seem to cross the lines, and agree on wrong times.
const MIN_ACROSS_FRACTION: f64 = 0.05;
/// All correspondences of a pair share an error perpendicular to the epipolar lines. This is the standard deviation of
/// the shared error, as a fraction of the standard deviation of the inliers' residuals. The shared error does not
/// average out: it biases the offset in proportion to the mean signed speed of the features. In filmed scenes, the
/// shared error is 0.001 to 0.006 px, at residuals of 0.03 px.
const COMMON_ERROR_FRACTION: f64 = 0.2;

/// Frame triples (two frames of one camera, one frame of another) of one pair of cameras, with their offset
/// candidates.
pub struct PairTriples {
    /// The indices of the pair's two cameras, i and j.
    cameras: [usize; 2],
    triples: Vec<(TripleFrames, Arc<FrameTriple>)>,
}

impl PairTriples {
    /// Computes the offset candidates of a pair's frame triples (two frames of one camera, one frame of another), or
    /// takes them from the recording's cache. Returns an error if a frame cannot be read.
    pub fn new(
        recording: &Recording,
        cameras: [usize; 2],
        frames: &[TripleFrames],
    ) -> Result<Self, CaptureError> {
        let triple = |&frames| recording.triple(frames).map(|triple| (frames, triple));
        Ok(Self { cameras, triples: frames.iter().map(triple).collect::<Result<_, _>>()? })
    }

    /// Returns the sum of `count` over all frame triples of the pair. `count` returns a number of features of a triple,
    /// such as the number of tracked features.
    fn total(&self, count: fn(&FrameTriple) -> usize) -> usize {
        self.triples.iter().map(|(_, triple)| count(triple)).sum()
    }

    /// Returns the reason why there are too few offset candidates.
    fn too_few_candidates(&self) -> PairFailure {
        let tracks = self.total(|t| t.tracks);
        let min_moving = MIN_INLIERS.max((MIN_MOVING_FRACTION * tracks as f64) as usize);
        if tracks < MIN_INLIERS {
            PairFailure::TooFewFeatures
        } else if self.total(|t| t.moving) < min_moving {
            PairFailure::NoMotion
        } else {
            PairFailure::MotionAlongEpipolarLines
        }
    }
}

impl PairTriples {
    /// Returns whether one camera of the pair is frozen: all its frames are copies of one image. Then none of the
    /// features tracked in this camera moves, while features of the other camera do. The other camera's offset
    /// candidates would all agree on the time of the copied image.
    fn is_frozen(&self) -> bool {
        let count = |camera: usize, count: fn(&FrameTriple) -> usize| -> usize {
            let own = self.triples.iter().filter(|(([a, _], _), _)| *a == camera);
            own.map(|(_, triple)| count(triple)).sum()
        };
        let [i, j] = self.cameras;
        let is_still = |of: usize, other: usize| {
            let is_tracked = count(of, |t| t.tracks) >= MIN_INLIERS;
            is_tracked && count(of, |t| t.moving) == 0 && count(other, |t| t.moving) > 0
        };
        is_still(i, j) || is_still(j, i)
    }
}

/// A pair's offset candidates as observations of a line, which is the pair's offset as a function of time.
struct PairObservations {
    samples: Vec<Sample>,
    /// The observations of `offset_j − offset_i`, in the order of `samples`. Their times are times on camera i's clock
    /// minus `center_s`, seconds.
    observations: Vec<Observation>,
    /// The middle of the time span of all offset candidates, seconds on camera i's clock.
    center_s: f64,
    /// The longer one of the two cameras' frame periods, seconds.
    frame_s: f64,
}

impl PairObservations {
    fn new(recording: &Recording, pair: &PairTriples) -> Self {
        let [i, j] = pair.cameras;
        let on_i = |s: &Sample| if s.cameras[0] == i { s.time_a_s } else { s.time_b_s };
        let samples: Vec<Sample> =
            pair.triples.iter().flat_map(|(_, t)| t.samples.iter().copied()).collect();
        let (first, last) = samples
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), s| (f.min(on_i(s)), l.max(on_i(s))));
        let center_s = 0.5 * (first + last);
        let observations = samples
            .iter()
            .map(|s| Observation {
                value_s: if s.cameras[0] == i { s.offset_s() } else { -s.offset_s() },
                at_s: on_i(s) - center_s,
                across_px_s: s.across_px_s,
            })
            .collect();
        let frame_s = recording.clocks[i].frame_s().max(recording.clocks[j].frame_s());
        Self { samples, observations, center_s, frame_s }
    }
}

/// Estimates a pair's offset from the offset candidates of its triples, and also its rate if `with_rate` is true.
/// `initial` is the approximate clock model with which the triples were chosen.
///
/// Fails if there are too few features, too little motion or too few inliers, or if the offset contradicts the nominal
/// clocks ([`PairFailure`]). The error is the first of these reasons that applies.
pub fn fit_pair(
    recording: &Recording,
    pair: &PairTriples,
    initial: &ClockModel,
    with_rate: bool,
) -> Result<PairEstimate, PairFailure> {
    if pair.is_frozen() {
        return Err(PairFailure::NoMotion);
    }
    let data = PairObservations::new(recording, pair);
    let mixture = checked_mixture(pair, &data, initial, with_rate)?;
    let windows = independent_windows(pair, &mixture.weights);
    let PairObservations { samples, observations, center_s, frame_s } = data;
    let clock = ClockModel {
        offset_s: mixture.value_s,
        rate: mixture.rate,
        reference_s: center_s,
        ..ClockModel::default()
    };
    let frames = pair
        .triples
        .iter()
        .filter_map(|(frames, triple)| frame_estimate(recording, pair, *frames, &triple.samples));
    let mut estimate = PairEstimate {
        cameras: pair.cameras,
        clock,
        std_err_s: f64::NAN,
        inliers: mixture.inliers.round() as usize,
        candidates: observations.len(),
        agreement: mixture.inliers / pair.total(|t| t.across).max(1) as f64,
        sigma_px: mixture.sigma_px,
        frames: frames.collect(),
        std_err_inflation: std_err_inflation(windows),
        samples: samples.into_iter().zip(mixture.weights.iter().copied()).collect(),
        slopes: Arc::default(),
    };
    if recording.options.method == OffsetMethod::Pairwise {
        let mean = mean_of_frames(&estimate.frames).ok_or(PairFailure::NoConsensus)?;
        (estimate.clock.offset_s, estimate.std_err_s) = mean;
    } else {
        estimate.std_err_s = std_err(&estimate, &observations, frame_s, with_rate)
            .ok_or(PairFailure::NoConsensus)?;
    }
    Ok(estimate)
}

/// Estimates a pair again from the same offset candidates, after subtracting the effect of the given calibration
/// errors from them. The clock's rate is fitted again if `with_rate` is true. `frame_s` is the longer one of the two
/// cameras' frame periods, seconds.
///
/// `None` if the corrected candidates don't determine the offset.
pub fn refit_pair(
    pair: &PairEstimate,
    errors: &DVector<f64>,
    frame_s: f64,
    with_rate: bool,
) -> Option<PairEstimate> {
    let observation = |(k, (s, _)): (usize, &(Sample, f64))| {
        let (sign, on_i_s) =
            if s.cameras == pair.cameras { (1.0, s.time_a_s) } else { (-1.0, s.time_b_s) };
        Observation {
            value_s: sign * (s.offset_s() - pair.slopes.change_s(k, errors)),
            at_s: on_i_s - pair.clock.reference_s,
            across_px_s: s.across_px_s,
        }
    };
    let observations: Vec<Observation> = pair.samples.iter().enumerate().map(observation).collect();
    let center_s = pair.clock.reference_s;
    let data = PairObservations { samples: Vec::new(), observations, center_s, frame_s };
    let mixture = fit_line(&data, &pair.clock, with_rate)?;
    let weights = mixture.weights.iter();
    let mut refitted = PairEstimate {
        clock: ClockModel { offset_s: mixture.value_s, rate: mixture.rate, ..pair.clock.clone() },
        inliers: mixture.inliers.round() as usize,
        sigma_px: mixture.sigma_px,
        samples: pair.samples.iter().zip(weights).map(|((s, _), w)| (*s, *w)).collect(),
        ..pair.clone()
    };
    refitted.std_err_s = std_err(&refitted, &data.observations, frame_s, with_rate)?;
    Some(refitted)
}

/// Fits a mixture model of inliers and outliers ([`Mixture`]) to a pair's observations. Fails if there are too few
/// features, too few features that move across the epipolar lines, or too few inliers. Also fails if the offset
/// contradicts the nominal clocks and too few features agree on it.
fn checked_mixture(
    pair: &PairTriples,
    data: &PairObservations,
    initial: &ClockModel,
    with_rate: bool,
) -> Result<Mixture, PairFailure> {
    let min_across = MIN_ACROSS_FRACTION * pair.total(|t| t.moving) as f64;
    let count = data.observations.len();
    if count < MIN_INLIERS || (count as f64) < min_across {
        return Err(pair.too_few_candidates());
    }
    let mixture = fit_line(data, initial, with_rate)
        .filter(|m| m.inliers >= MIN_INLIERS as f64 && m.inlier_fraction >= MIN_INLIER_FRACTION)
        .ok_or(PairFailure::NoConsensus)?;
    if mixture.inliers < min_across {
        return Err(PairFailure::MotionAlongEpipolarLines);
    }
    let contradicts_clocks = mixture.value_s.abs() > NOMINAL_CLOCK_FRAMES * data.frame_s;
    let min_agreeing = MIN_AGREEMENT * pair.total(|t| t.across) as f64;
    if contradicts_clocks && mixture.inliers < min_agreeing {
        return Err(PairFailure::ContradictsClocks);
    }
    Ok(mixture)
}

/// Fits a mixture model ([`Mixture`]) with a line through the inliers, starting at the offset with the highest
/// consensus. `None` if the observations do not determine the line.
///
/// If `with_rate` is true, the offset changes with time, and no constant offset is near most observations. The change
/// at the rate of `initial` is therefore subtracted from the observations before the start is chosen.
fn fit_line(data: &PairObservations, initial: &ClockModel, with_rate: bool) -> Option<Mixture> {
    let rate = if with_rate { initial.rate } else { 0.0 };
    let relative = |o: &Observation| Observation { value_s: o.value_s - rate * o.at_s, ..*o };
    let observations: Vec<Observation> = data.observations.iter().map(relative).collect();
    let (start_s, _) = consensus_value(&observations)?;
    let mixture = Mixture::fit(&observations, data.frame_s, start_s, with_rate)?;
    Some(Mixture { rate: mixture.rate + rate, ..mixture })
}

/// Returns two estimates from one frame triple (two frames of one camera, one frame of another): by RANSAC and WLS,
/// eqs. (11) to (13), and by a mixture model ([`Mixture`]). `None` if the triple has too few inliers.
fn frame_estimate(
    recording: &Recording,
    pair: &PairTriples,
    ([camera, other], [frame, _]): TripleFrames,
    samples: &[Sample],
) -> Option<FrameEstimate> {
    let times = &recording.clocks[camera].times_s;
    let interval = times[frame + 1] - times[frame];
    let sign = if [camera, other] == pair.cameras { 1.0 } else { -1.0 };
    let observations: Vec<Observation> = samples
        .iter()
        .map(|s| Observation { value_s: sign * s.offset_s(), ..Observation::from(s) })
        .collect();
    let mut values: Vec<f64> = observations.iter().map(|o| o.value_s).collect();
    values.sort_by(f64::total_cmp);
    let inliers = ransac(&values, TOLERANCE_FRACTION * interval);
    let enough = inliers.len() >= MIN_INLIERS
        && inliers.len() as f64 >= MIN_INLIER_FRACTION * values.len() as f64;
    if !enough {
        return None;
    }
    let offset_s = weighted_least_squares(&values[inliers], GAMMA / interval)?;
    let (start_s, _) = consensus_value(&observations)?;
    let mixture = Mixture::fit(&observations, interval, start_s, false)?;
    Some(FrameEstimate { camera, frame, offset_s, by_information_s: mixture.value_s })
}

/// Returns the mean of the offsets from single frame triples (two frames of one camera, one frame of another), and
/// its standard error from their scatter; both in seconds. `None` for fewer than two triples.
fn mean_of_frames(frames: &[FrameEstimate]) -> Option<(f64, f64)> {
    let n = frames.len() as f64;
    if frames.len() < 2 {
        return None;
    }
    let mean = frames.iter().map(|f| f.offset_s).sum::<f64>() / n;
    let variance = frames.iter().map(|f| (f.offset_s - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some((mean, (variance / n).sqrt()))
}

/// Returns the standard error of a pair's offset, seconds. It combines the cluster-robust standard error with the
/// standard error due to the correspondences' common error ([`common_error_s`]). `None` if it can't be determined.
fn std_err(
    estimate: &PairEstimate,
    observations: &[Observation],
    frame_s: f64,
    with_rate: bool,
) -> Option<f64> {
    let unknowns = if with_rate { 2 } else { 1 };
    let mut sandwich = Sandwich::new(unknowns);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        let residual = estimate.std_err_inflation
            * (o.value_s - estimate.clock.offset_s - estimate.clock.rate * o.at_s);
        let row = [(0, 1.0), (1, o.at_s)];
        let bin = (o.at_s / frame_s).round() as i64;
        let information = weight * o.across_px_s * o.across_px_s;
        sandwich.add(&row[..unknowns], information, residual, bin, sample.cell);
    }
    let variance = sandwich.variances()?[0];
    (variance > 0.0).then(|| variance.sqrt().hypot(common_error_s(observations, estimate)))
}

/// Returns the effective number of independent tracker windows that determine the offset at one instant. It is the mean
/// over all frame triples, weighted by their information. `weights` has the weight of each sample, triple by triple.
fn independent_windows(pair: &PairTriples, weights: &[f64]) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    let mut weights = weights.iter();
    for (_, triple) in &pair.triples {
        let windows: Vec<(usize, f64)> = triple
            .samples
            .iter()
            .zip(&mut weights)
            .map(|(s, w)| (s.window, w * s.across_px_s * s.across_px_s))
            .collect();
        let information: f64 = windows.iter().map(|i| i.1).sum();
        sum += information * effective_number(windows.into_iter());
        total += information;
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

/// Returns the standard error of the offset that results from the shared error of all correspondences across the
/// epipolar lines ([`COMMON_ERROR_FRACTION`]), seconds; 0 if no observation has any weight.
fn common_error_s(observations: &[Observation], estimate: &PairEstimate) -> f64 {
    let (mut signed, mut squared) = (0.0, 0.0);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        // The positive side of the epipolar lines is reversed for triples of the other direction.
        let sign = if sample.cameras == estimate.cameras { 1.0 } else { -1.0 };
        signed += sign * weight * o.across_px_s;
        squared += weight * o.across_px_s * o.across_px_s;
    }
    let common_px = COMMON_ERROR_FRACTION * estimate.sigma_px;
    if squared > 0.0 { common_px * signed.abs() / squared } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_candidates_have_a_cause() {
        let cause = |tracks, moving| {
            let triple = FrameTriple { tracks, moving, ..FrameTriple::default() };
            let triples = vec![(([0, 1], [0, 0]), Arc::new(triple))];
            PairTriples { cameras: [0, 1], triples }.too_few_candidates()
        };
        assert_eq!(cause(3, 3), PairFailure::TooFewFeatures);
        assert_eq!(cause(300, 3), PairFailure::NoMotion);
        assert_eq!(cause(300, 300), PairFailure::MotionAlongEpipolarLines);
    }

    #[test]
    fn a_single_frame_has_no_scatter() {
        assert_eq!(mean_of_frames(&[]), None);
    }
}
