//! A pair's offset, rate and standard error from the candidates of its frame triples.

use super::consensus::{ransac, weighted_least_squares};
use super::mixture::{Mixture, Observation, ResidualModel};
use super::pair::{
    FrameEstimate, InitialOffset, MIN_AGREEMENT, NOMINAL_CLOCK_FRAMES, PairEstimate, PairFailure,
    PairTriples,
};
use super::recording::{Recording, Sample, Triple};
use super::uncertainty::{Sandwich, effective_number, std_err_inflation};
use super::{OffsetMethod, OffsetOptions};
use std::sync::Arc;

/// The moving features that a pair needs, as a fraction of all tracked ones: fewer may be mismatches.
/// Larger calls scenes with a small moving body motionless; smaller estimates from mismatches.
const MIN_MOVING_FRACTION: f64 = 0.01;
/// The inliers that a pair needs, as a fraction of the moving features. Where motion runs along the
/// epipolar lines, T-junctions and occluded features seem to cross them, and agree on wrong times.
/// Larger rejects a small body that moves across the lines among many that do not; smaller accepts
/// T-junctions and occlusions.
const MIN_ACROSS_FRACTION: f64 = 0.05;
/// The standard deviation of the correspondences' common error across the epipolar lines, as a
/// fraction of the residuals': views from two places differ, and calibrations are not exact. It does
/// not average out over features, and biases the offset by the mean of the features' signed speeds:
/// those that move up and those that move down err in opposite directions. Least squares on filmed
/// scenes give 0.001 to 0.006 px where residuals have 0.03 px. Larger makes error bars too long where
/// all features move one way; smaller makes them too short.
const COMMON_ERROR_FRACTION: f64 = 0.2;
/// The smallest residual standard deviation, as a fraction of the option `residual_px`: no tracker
/// resolves less. Larger ignores good features' precision; smaller lets one perfect feature outweigh
/// all others.
const MIN_SIGMA: f64 = 0.02;
/// The largest residual standard deviation of inliers, as a fraction of `residual_px`. Larger lets
/// the mixture explain outliers as inliers; smaller rejects noisy recordings.
const MAX_SIGMA: f64 = 4.0;
/// The range of times that outliers are uniform over, frames. Larger makes outliers less likely and
/// inliers more numerous, smaller the reverse; only its order of magnitude matters.
const OUTLIER_RANGE_FRAMES: f64 = 3.0;

/// How residuals are distributed, for cameras whose frames are `frame_s` seconds apart.
pub fn residual_model(frame_s: f64, options: &OffsetOptions) -> ResidualModel {
    ResidualModel {
        start_px: options.residual_px,
        min_px: MIN_SIGMA * options.residual_px,
        max_px: MAX_SIGMA * options.residual_px,
        range_s: OUTLIER_RANGE_FRAMES * frame_s,
    }
}

/// The candidates of a pair's triples as the observations of one line: offset by time.
struct PairObservations {
    samples: Vec<Sample>,
    /// In the order of `samples`: `offset_j − offset_i` by time since `center_s` on camera i's clock.
    observations: Vec<Observation>,
    /// The middle of all candidates' times, on camera i's clock, seconds.
    center_s: f64,
    /// The longer one of the two cameras' frame periods, seconds.
    frame_s: f64,
}

impl PairObservations {
    fn new(recording: &Recording, pair: &PairTriples) -> Self {
        let [i, j] = pair.cameras;
        let sign = |s: &Sample| if s.cameras[0] == i { 1.0 } else { -1.0 };
        let samples: Vec<Sample> =
            pair.triples.iter().flat_map(|t| t.samples.iter().copied()).collect();
        let on_i = |s: &Sample| if s.cameras[0] == i { s.time_a_s } else { s.time_b_s };
        let (first, last) = samples
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), s| (f.min(on_i(s)), l.max(on_i(s))));
        let center_s = 0.5 * (first + last);
        let observations = samples
            .iter()
            .map(|s| Observation {
                value_s: sign(s) * s.offset_s(),
                at_s: on_i(s) - center_s,
                across_px_s: s.across_px_s,
            })
            .collect();
        let frame_s = recording.timelines.frame_s(i).max(recording.timelines.frame_s(j));
        Self { samples, observations, center_s, frame_s }
    }
}

/// Estimates a pair's offset, and its rate if `with_rate`, from the candidates of its triples.
///
/// The failure says which condition on features, motion and inliers the triples miss first.
pub fn fit_pair(
    recording: &Recording,
    pair: &PairTriples,
    initial: &InitialOffset,
    with_rate: bool,
) -> Result<PairEstimate, PairFailure> {
    let options = recording.options;
    let data = PairObservations::new(recording, pair);
    let mixture = checked_mixture(pair, &data, initial, with_rate, options)?;
    let frames = frame_estimates(recording, pair);
    let across: usize = pair.triples.iter().map(|t| t.across).sum();
    let windows = independent_windows(&pair.triples, &mixture.weights);
    let PairObservations { samples, observations, center_s, frame_s } = data;
    let mut estimate = PairEstimate {
        cameras: pair.cameras,
        offset_s: mixture.value_s,
        std_err_s: f64::NAN,
        rate: mixture.rate,
        center_s,
        inliers: mixture.inliers.round() as usize,
        candidates: observations.len(),
        agreement: mixture.inliers / across.max(1) as f64,
        sigma_px: mixture.sigma_px,
        frames,
        std_err_inflation: std_err_inflation(windows),
        samples: samples.into_iter().zip(mixture.weights.iter().copied()).collect(),
    };
    if options.method == OffsetMethod::Pairwise {
        let mean = mean_of_frames(&estimate.frames).ok_or(PairFailure::NoConsensus)?;
        (estimate.offset_s, estimate.std_err_s) = mean;
    } else {
        estimate.std_err_s = std_err(&estimate, &observations, frame_s, with_rate)
            .ok_or(PairFailure::NoConsensus)?;
    }
    Ok(estimate)
}

/// The mixture fitted to a pair's observations, if there are enough features, enough motion across
/// the epipolar lines and enough inliers for it.
fn checked_mixture(
    pair: &PairTriples,
    data: &PairObservations,
    initial: &InitialOffset,
    with_rate: bool,
    options: &OffsetOptions,
) -> Result<Mixture, PairFailure> {
    let moving: usize = pair.triples.iter().map(|t| t.moving).sum();
    let min_across = MIN_ACROSS_FRACTION * moving as f64;
    let count = data.observations.len();
    if count < options.min_inliers || (count as f64) < min_across {
        return Err(too_few_candidates(&pair.triples, options));
    }
    let model = residual_model(data.frame_s, options);
    let fitted = fit_line(&data.observations, &model, initial, with_rate);
    let Some(mixture) = fitted.filter(|m| has_consensus(m, options)) else {
        return Err(PairFailure::NoConsensus);
    };
    if mixture.inliers < min_across {
        return Err(PairFailure::MotionAlongEpipolarLines);
    }
    let across: usize = pair.triples.iter().map(|t| t.across).sum();
    let contradicts_clocks = mixture.value_s.abs() > NOMINAL_CLOCK_FRAMES * data.frame_s;
    if contradicts_clocks && mixture.inliers < MIN_AGREEMENT * across as f64 {
        return Err(PairFailure::ContradictsClocks);
    }
    Ok(mixture)
}

/// The mixture fitted from the value of highest consensus. With a rate, the initial rate is first
/// subtracted: no single value has a consensus while the offset changes.
fn fit_line(
    observations: &[Observation],
    model: &ResidualModel,
    initial: &InitialOffset,
    with_rate: bool,
) -> Option<Mixture> {
    if !with_rate {
        return model.fit(observations, model.consensus_value(observations)?.0, false);
    }
    let relative: Vec<Observation> = observations
        .iter()
        .map(|o| Observation { value_s: o.value_s - initial.rate * o.at_s, ..*o })
        .collect();
    let start_s = model.consensus_value(&relative)?.0;
    let mixture = model.fit(&relative, start_s, true)?;
    Some(Mixture { rate: mixture.rate + initial.rate, ..mixture })
}

fn has_consensus(mixture: &Mixture, options: &OffsetOptions) -> bool {
    mixture.inliers >= options.min_inliers as f64
        && mixture.inlier_fraction >= options.min_inlier_share
}

/// Why there are too few candidates.
fn too_few_candidates(triples: &[Arc<Triple>], options: &OffsetOptions) -> PairFailure {
    let total = |count: fn(&Triple) -> usize| triples.iter().map(|t| count(t)).sum::<usize>();
    let (min, tracks) = (options.min_inliers, total(|t| t.tracks));
    if tracks < min {
        PairFailure::TooFewFeatures
    } else if total(|t| t.moving) < min.max((MIN_MOVING_FRACTION * tracks as f64) as usize) {
        PairFailure::NoMotion
    } else {
        PairFailure::MotionAlongEpipolarLines
    }
}

/// The estimates of all single triples that have enough inliers.
fn frame_estimates(recording: &Recording, pair: &PairTriples) -> Vec<FrameEstimate> {
    pair.frames
        .iter()
        .zip(&pair.triples)
        .filter_map(|(&([a, _], [k, _]), triple)| {
            frame_estimate(recording, [a, k], &triple.samples, a == pair.cameras[0])
        })
        .collect()
}

/// RANSAC and WLS, eqs. (11) to (13), on one frame triple, with the mixture's estimate beside it.
/// `forward` says whether the camera with two frames is camera i.
fn frame_estimate(
    recording: &Recording,
    [camera, frame]: [usize; 2],
    samples: &[Sample],
    forward: bool,
) -> Option<FrameEstimate> {
    let options = recording.options;
    let times = &recording.timelines.times_s[camera];
    let interval = times[frame + 1] - times[frame];
    let sign = if forward { 1.0 } else { -1.0 };
    let mut values: Vec<f64> = samples.iter().map(|s| sign * s.offset_s()).collect();
    values.sort_by(f64::total_cmp);
    let inliers = ransac(&values, options.tolerance_share * interval);
    let enough = inliers.len() >= options.min_inliers
        && inliers.len() as f64 >= options.min_inlier_share * values.len() as f64;
    let offset_s = weighted_least_squares(&values[inliers.clone()], options.gamma / interval)?;
    let observations: Vec<Observation> = samples
        .iter()
        .map(|s| Observation {
            value_s: sign * s.offset_s(),
            at_s: 0.0,
            across_px_s: s.across_px_s,
        })
        .collect();
    let model = residual_model(interval, options);
    let mixture = model.fit(&observations, model.consensus_value(&observations)?.0, false)?;
    let information: f64 =
        observations.iter().zip(&mixture.weights).map(|(o, w)| w * o.across_px_s.powi(2)).sum();
    enough.then_some(FrameEstimate {
        camera,
        frame,
        offset_s,
        by_information_s: mixture.value_s,
        // The information is positive: the fit divides by it.
        std_err_s: information.sqrt().recip(),
        inliers: inliers.len(),
        candidates: values.len(),
    })
}

/// The mean of the frames' offsets and its standard error from their scatter, seconds. `None` for
/// fewer than two frames.
fn mean_of_frames(frames: &[FrameEstimate]) -> Option<(f64, f64)> {
    let n = frames.len() as f64;
    if frames.len() < 2 {
        return None;
    }
    let mean = frames.iter().map(|f| f.offset_s).sum::<f64>() / n;
    let variance = frames.iter().map(|f| (f.offset_s - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some((mean, (variance / n).sqrt()))
}

/// The cluster-robust standard error of a pair's offset, plus the correspondences' common error.
/// `None` where it is not determined.
fn std_err(
    estimate: &PairEstimate,
    observations: &[Observation],
    frame_s: f64,
    with_rate: bool,
) -> Option<f64> {
    let unknowns = if with_rate { 2 } else { 1 };
    let mut sandwich = Sandwich::new(unknowns);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        let residual =
            estimate.std_err_inflation * (o.value_s - estimate.offset_s - estimate.rate * o.at_s);
        let row = [(0, 1.0), (1, o.at_s)];
        let bin = (o.at_s / frame_s).round() as i64;
        let information = weight * o.across_px_s * o.across_px_s;
        sandwich.add(&row[..unknowns], information, residual, bin, sample.cell);
    }
    let variance = sandwich.variances()?[0];
    (variance > 0.0).then(|| variance.sqrt().hypot(common_error_s(observations, estimate)))
}

/// The effective number of windows that determine the offset at one instant, averaged over instants
/// by their information. The weights are those of all triples' samples, in their order.
fn independent_windows(triples: &[Arc<Triple>], weights: &[f64]) -> f64 {
    let (mut sum, mut total, mut first) = (0.0, 0.0, 0);
    for triple in triples {
        let triple_weights = &weights[first..first + triple.samples.len()];
        first += triple.samples.len();
        let informed: Vec<(usize, f64)> = triple
            .samples
            .iter()
            .zip(triple_weights)
            .map(|(s, w)| (s.window, w * s.across_px_s * s.across_px_s))
            .collect();
        let information: f64 = informed.iter().map(|i| i.1).sum();
        sum += information * effective_number(informed.into_iter());
        total += information;
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

/// The standard error that the correspondences' common error across the epipolar lines causes,
/// seconds ([`COMMON_ERROR_FRACTION`]); 0 without information.
fn common_error_s(observations: &[Observation], estimate: &PairEstimate) -> f64 {
    let (mut signed, mut squared) = (0.0, 0.0);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        // The positive sides of the epipolar lines are opposite in the two directions.
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
        let options = OffsetOptions::default();
        let cause = |tracks, moving| {
            let triple = Arc::new(Triple { tracks, moving, ..Triple::default() });
            too_few_candidates(&[triple], &options)
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
