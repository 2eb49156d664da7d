//! The offset between two cameras, from all frames that see it.

use super::consensus::{ransac, weighted_least_squares};
use super::film::{Film, Sample, Triple};
use super::mixture::{Mixture, Observation, Residuals};
use super::uncertainty::{Sandwich, doubt, effective_number};
use super::{OffsetMethod, OffsetOptions};
use crate::capture::CaptureError;
use serde::Serialize;
use std::sync::Arc;

/// What one pair of cameras says: `offset_j − offset_i`, seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairEstimate {
    pub cameras: [usize; 2],
    /// In the middle of what both filmed, where clocks drift.
    pub offset_s: f64,
    pub std_err_s: f64,
    /// Change of the offset a second; 0 where neither clock drifts.
    pub rate: f64,
    /// The time that `offset_s` is at, on camera i's clock.
    pub center_s: f64,
    pub inliers: usize,
    pub candidates: usize,
    /// The inliers' share of all features that move across their epipolar lines.
    pub agreement: f64,
    /// Standard deviation of the inliers' distances from their epipolar lines, pixels.
    pub sigma_px: f64,
    /// The paper's estimate of every triple of frames.
    pub frames: Vec<FrameEstimate>,
    /// By how much its samples' scatter is to be believed less than that of many bodies.
    #[serde(skip)]
    pub(super) doubt: f64,
    #[serde(skip)]
    pub(super) samples: Arc<[(Sample, f64)]>,
}

/// The estimates from three frames: two of `camera`, one of the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameEstimate {
    pub camera: usize,
    pub frame: usize,
    /// The paper's, RANSAC and WLS,
    pub offset_s: f64,
    /// and the best rung's, by information.
    pub by_information_s: f64,
    pub std_err_s: f64,
    pub inliers: usize,
    pub candidates: usize,
}

/// Why a pair says nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Blind {
    /// No frame of one is between two of the other.
    Apart,
    /// Too few features can be followed.
    Featureless,
    /// They can, and rest.
    Still,
    /// They move, along the epipolar lines.
    Along,
    /// Candidates don't agree with each other.
    Discordant,
    /// Many agree on an offset that the clocks don't say, but not enough of all.
    Elsewhere,
    /// Several offsets, frames apart, agree as well with what is seen.
    Repeating,
}

/// A pair's offset as far as it is known: `value_s` at `center_s` on camera i's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guess {
    pub value_s: f64,
    pub rate: f64,
    pub center_s: f64,
}

impl Guess {
    pub fn constant(value_s: f64) -> Self {
        Self { value_s, ..Self::default() }
    }

    /// `offset_j − offset_i` at a time on camera i's clock.
    pub fn at(&self, time_s: f64) -> f64 {
        self.value_s + self.rate * (time_s - self.center_s)
    }
}

/// Rounds of choosing frames by the estimate and estimating from them.
const ROUNDS: usize = 5;

/// The pair (i, j) from both sides: camera i's tracks against camera j's frames, and the reverse;
/// `start` is its offset to about a frame. The error says why too few candidates agree.
pub fn estimate_pair(
    film: &Film,
    cameras: [usize; 2],
    start: Guess,
    with_rate: bool,
) -> Result<Result<PairEstimate, Blind>, CaptureError> {
    let mut guess = start;
    let mut used_before = Vec::new();
    let mut estimate = Err(Blind::Apart);
    // The right frame of j lies between two of i; which one that is depends on the offset itself.
    for _ in 0..ROUNDS {
        let used = triples(film, cameras, &guess);
        if used.is_empty() || used == used_before {
            break;
        }
        let found = used
            .iter()
            .map(|&(pair, frames)| film.triple(pair, frames))
            .collect::<Result<Vec<_>, _>>()?;
        estimate = from_triples(film, cameras, &guess, &used, &found, with_rate);
        let Ok(pair) = &estimate else { break };
        guess = Guess { value_s: pair.offset_s, rate: pair.rate, center_s: pair.center_s };
        used_before = used;
    }
    film.forget(cameras);
    Ok(estimate)
}

/// Cameras a and b, frame k of a, frame m of b.
pub type Frames = ([usize; 2], [usize; 2]);

/// The frames to use for a pair, in both directions.
pub fn triples(film: &Film, [i, j]: [usize; 2], guess: &Guess) -> Vec<Frames> {
    let mut used = Vec::new();
    for (a, b, sign) in [(i, j, 1.0), (j, i, -1.0)] {
        let times = &film.timelines.times_s[a];
        let offset_at = |k: usize| {
            let middle = 0.5 * (times[k] + times[k + 1]);
            // A rate this small is the same on either clock.
            sign * guess.at(if sign > 0.0 { middle } else { middle + guess.value_s })
        };
        let possible: Vec<(usize, usize)> = (0..times.len() - 1)
            .filter_map(|k| Some((k, film.between([a, b], k, offset_at(k))?)))
            .collect();
        // The same frames of a camera in all its pairs, so that its tracks are found once; where
        // recordings overlap in part, what both have.
        let common = super::spread(times.len() - 1, film.options.max_frames);
        let mut chosen: Vec<(usize, usize)> =
            possible.iter().filter(|(k, _)| common.binary_search(k).is_ok()).copied().collect();
        if chosen.len() < possible.len().min(film.options.max_frames) / 2 {
            let spread = super::spread(possible.len(), film.options.max_frames);
            chosen = spread.into_iter().map(|n| possible[n]).collect();
        }
        used.extend(chosen.into_iter().map(|(k, m)| ([a, b], [k, m])));
    }
    used
}

/// How residuals are expected to be, for a pair whose frames are `frame_s` apart.
pub fn residuals(frame_s: f64, options: &OffsetOptions) -> Residuals {
    Residuals {
        start_px: options.residual_px,
        // Less is what no tracker resolves, and one perfect feature must not outweigh all others.
        min_px: 0.02 * options.residual_px,
        max_px: 4.0 * options.residual_px,
        range_s: 3.0 * frame_s,
    }
}

fn from_triples(
    film: &Film,
    [i, j]: [usize; 2],
    guess: &Guess,
    used: &[Frames],
    found: &[Arc<Triple>],
    with_rate: bool,
) -> Result<PairEstimate, Blind> {
    let options = film.options;
    let sign = |s: &Sample| if s.cameras[0] == i { 1.0 } else { -1.0 };
    let samples: Vec<Sample> = found.iter().flat_map(|t| t.samples.iter().copied()).collect();
    let on_i = |s: &Sample| if s.cameras[0] == i { s.time_a_s } else { s.time_b_s };
    let (first, last) = samples
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), s| (f.min(on_i(s)), l.max(on_i(s))));
    let center_s = 0.5 * (first + last);
    let frame_s = film.timelines.frame_s(i).max(film.timelines.frame_s(j));
    let observations: Vec<Observation> = samples
        .iter()
        .map(|s| Observation {
            value_s: sign(s) * s.offset_s(),
            at_s: on_i(s) - center_s,
            across_px_s: s.across_px_s,
        })
        .collect();
    let moving: usize = found.iter().map(|t| t.moving).sum();
    let least = MIN_ACROSS_SHARE * moving as f64;
    if observations.len() < options.min_inliers || (observations.len() as f64) < least {
        return Err(why(found, options));
    }
    let residuals = residuals(frame_s, options);
    let frames: Vec<FrameEstimate> = used
        .iter()
        .zip(found)
        .filter_map(|(&([a, _], [k, _]), t)| frame_estimate(film, a, k, &t.samples, a == i))
        .collect();
    let fitted = fit(&observations, &residuals, guess, with_rate);
    let Some(mixture) = fitted.filter(|m| believable(m, options)) else {
        return Err(Blind::Discordant);
    };
    if mixture.inliers < least {
        return Err(Blind::Along);
    }
    let across: usize = found.iter().map(|t| t.across).sum();
    let unforeseen = mixture.value_s.abs() > OWN_CLOCKS_FRAMES * frame_s;
    if unforeseen && mixture.inliers < MIN_AGREEMENT * across as f64 {
        return Err(Blind::Elsewhere);
    }
    let mut estimate = PairEstimate {
        cameras: [i, j],
        offset_s: mixture.value_s,
        std_err_s: f64::NAN,
        rate: mixture.rate,
        center_s,
        inliers: mixture.inliers.round() as usize,
        candidates: observations.len(),
        agreement: mixture.inliers / across.max(1) as f64,
        sigma_px: mixture.sigma_px,
        frames,
        doubt: doubt(independent_windows(found, &mixture.weights)),
        samples: samples.into_iter().zip(mixture.weights.iter().copied()).collect(),
    };
    if options.method == OffsetMethod::Pairwise {
        let mean = mean_of_frames(&estimate.frames).ok_or(Blind::Discordant)?;
        (estimate.offset_s, estimate.std_err_s) = mean;
    } else {
        estimate.std_err_s =
            std_err(&estimate, &observations, frame_s, with_rate).ok_or(Blind::Discordant)?;
    }
    Ok(estimate)
}

/// The mixture from the start that most agree with, the guess's rate taken out: with it in, no
/// single value would be that of many.
fn fit(
    observations: &[Observation],
    residuals: &Residuals,
    guess: &Guess,
    with_rate: bool,
) -> Option<Mixture> {
    if !with_rate {
        return residuals.fit(observations, residuals.start(observations)?.0, false);
    }
    let along_guess: Vec<Observation> = observations
        .iter()
        .map(|o| Observation { value_s: o.value_s - guess.rate * o.at_s, ..*o })
        .collect();
    let start_s = residuals.start(&along_guess)?.0;
    let relative = residuals.fit(&along_guess, start_s, true)?;
    Some(Mixture { rate: relative.rate + guess.rate, ..relative })
}

/// Clocks that are off by no more frames than this are as right as they claim.
pub const OWN_CLOCKS_FRAMES: f64 = 1.5;
/// An offset that the clocks don't say needs the agreement of this share of all features that move
/// across their epipolar lines: a part of the scene that swings agrees with itself a period later.
/// Larger: not where many are hidden from one of the cameras; smaller: one swing of two is enough.
pub const MIN_AGREEMENT: f64 = 0.5;
/// Fewer moving features than this share of all that were followed are mismatches.
const MIN_MOVING_SHARE: f64 = 0.01;
/// What moves across the epipolar lines must be this share of all that moves: where motion runs
/// along them, what seems to cross them are edges that slide over each other and features that are
/// lost behind others, and they agree on wrong times. Larger calls a small thing that moves across
/// among many that don't unseen.
const MIN_ACROSS_SHARE: f64 = 0.05;

fn believable(mixture: &Mixture, options: &OffsetOptions) -> bool {
    mixture.inliers >= options.min_inliers as f64
        && mixture.inlier_share >= options.min_inlier_share
}

fn why(found: &[Arc<Triple>], options: &OffsetOptions) -> Blind {
    let most = |count: fn(&Triple) -> usize| found.iter().map(|t| count(t)).sum::<usize>();
    let (few, tracks) = (options.min_inliers, most(|t| t.tracks));
    if tracks < few {
        Blind::Featureless
    } else if most(|t| t.moving) < few.max((MIN_MOVING_SHARE * tracks as f64) as usize) {
        Blind::Still
    } else {
        Blind::Along
    }
}

/// The paper's RANSAC and WLS on one triple of frames, and the best rung's estimate beside it.
fn frame_estimate(
    film: &Film,
    camera: usize,
    frame: usize,
    samples: &[Sample],
    forward: bool,
) -> Option<FrameEstimate> {
    let options = film.options;
    let times = &film.timelines.times_s[camera];
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
    let residuals = residuals(interval, options);
    let mixture = residuals.fit(&observations, residuals.start(&observations)?.0, false)?;
    let information: f64 =
        observations.iter().zip(&mixture.weights).map(|(o, w)| w * o.across_px_s.powi(2)).sum();
    enough.then_some(FrameEstimate {
        camera,
        frame,
        offset_s,
        by_information_s: mixture.value_s,
        // Positive: the fit divided by it.
        std_err_s: information.sqrt().recip(),
        inliers: inliers.len(),
        candidates: values.len(),
    })
}

/// The mean of the frames' estimates and its standard error, from their scatter.
fn mean_of_frames(frames: &[FrameEstimate]) -> Option<(f64, f64)> {
    let n = frames.len() as f64;
    if frames.len() < 2 {
        return None;
    }
    let mean = frames.iter().map(|f| f.offset_s).sum::<f64>() / n;
    let variance = frames.iter().map(|f| (f.offset_s - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some((mean, (variance / n).sqrt()))
}

fn std_err(
    estimate: &PairEstimate,
    observations: &[Observation],
    frame_s: f64,
    with_rate: bool,
) -> Option<f64> {
    let unknowns = if with_rate { 2 } else { 1 };
    let mut sandwich = Sandwich::new(unknowns);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        let residual = estimate.doubt * (o.value_s - estimate.offset_s - estimate.rate * o.at_s);
        let row = [(0, 1.0), (1, o.at_s)];
        let bin = (o.at_s / frame_s).round() as i64;
        let information = weight * o.across_px_s * o.across_px_s;
        sandwich.add(&row[..unknowns], information, residual, bin, sample.cell);
    }
    let variance = sandwich.variances()?[0];
    (variance > 0.0).then(|| variance.sqrt().hypot(shared_error_s(observations, estimate)))
}

/// How many windows' worth of pixels tell the offset at one instant, in the mean over instants by
/// their information: the weights are those of all triples' samples, in their order.
fn independent_windows(found: &[Arc<Triple>], weights: &[f64]) -> f64 {
    let (mut sum, mut total, mut first) = (0.0, 0.0, 0);
    for triple in found {
        let of_triple = &weights[first..first + triple.samples.len()];
        first += triple.samples.len();
        let informed: Vec<(usize, f64)> = triple
            .samples
            .iter()
            .zip(of_triple)
            .map(|(s, w)| (s.window, w * s.across_px_s * s.across_px_s))
            .collect();
        let information: f64 = informed.iter().map(|i| i.1).sum();
        sum += information * effective_number(informed.into_iter());
        total += information;
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

/// What matches between two cameras are off by across the epipolar lines, all alike, as a share of
/// what single ones are: views from two places differ, and lenses are not known perfectly. It does
/// not average out over features, and what it does to the offset goes by their speeds: those that
/// move up and those that move down are early and late. On filmed scenes, least squares of both give
/// 0.001 to 0.006 px where single ones are off by 0.03. Larger makes error bars too long where all
/// move one way; smaller, too short.
const SHARED_ERROR_SHARE: f64 = 0.2;

fn shared_error_s(observations: &[Observation], estimate: &PairEstimate) -> f64 {
    let (mut signed, mut squared) = (0.0, 0.0);
    for (o, (sample, weight)) in observations.iter().zip(estimate.samples.iter()) {
        // Each camera's tracks run against lines whose positive sides are opposite.
        let sign = if sample.cameras == estimate.cameras { 1.0 } else { -1.0 };
        signed += sign * weight * o.across_px_s;
        squared += weight * o.across_px_s * o.across_px_s;
    }
    let shared_px = SHARED_ERROR_SHARE * estimate.sigma_px;
    if squared > 0.0 { shared_px * signed.abs() / squared } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guess_changes_with_time() {
        let guess = Guess { value_s: 0.01, rate: 1e-4, center_s: 5.0 };
        assert!((guess.at(15.0) - 0.011).abs() < 1e-15);
        assert_eq!(Guess::constant(0.2).at(99.0), 0.2);
    }

    #[test]
    fn too_few_candidates_have_a_reason() {
        let options = OffsetOptions::default();
        let of = |tracks, moving| {
            why(&[Arc::new(Triple { tracks, moving, ..Triple::default() })], &options)
        };
        assert_eq!(of(3, 3), Blind::Featureless);
        assert_eq!(of(300, 3), Blind::Still);
        assert_eq!(of(300, 300), Blind::Along);
    }

    #[test]
    fn one_frame_has_no_scatter() {
        assert_eq!(mean_of_frames(&[]), None);
    }
}
