//! Finds the offset between two recordings that started seconds apart, to about one frame.
//!
//! Peaks of the normalized cross-correlation of the two cameras' activity signals ([`activity`]) propose a few offsets.
//! An offset candidate, eq. (10), is the offset that a single feature implies. Each proposed offset is verified by the
//! offset candidates of a few frame triples (two successive frames of camera a and one frame of camera b). The offset
//! with the largest fraction of inliers is chosen.
//!
//! Known limits: recordings shorter than 2 s are assumed to be aligned to about one frame, and periodic motion has no
//! unique alignment.

mod activity;

use super::clock::ClockModel;
use super::pair::{
    MIN_AGREEMENT, MIN_INLIERS, NOMINAL_CLOCK_FRAMES, Observation, PairFailure, consensus_value,
};
use super::recording::Recording;
use crate::capture::CaptureError;
use activity::{Activity, BANDS, Bands};
use rayon::prelude::*;

/// The minimum overlap in time of two recordings, seconds. Offsets with a shorter overlap are not searched.
const MIN_OVERLAP_S: f64 = 2.0;
/// The maximum number of correlation peaks whose offsets are verified.
const MAX_CANDIDATES: usize = 5;
/// The number of frame triples (two frames of one camera, one frame of another) by which an offset is verified.
const TESTED_FRAMES: usize = 6;
/// The minimum agreement (fraction of inliers) of a rival, relative to the largest agreement among the proposed
/// offsets. A rival is an offset that counts as equally plausible.
const RIVAL_FRACTION: f64 = 0.8;

/// Computes the activity of each camera from all its frames: how much its image changes in each frame interval. The
/// result has an entry for each camera.
///
/// `pairs` are pairs of camera indices. An activity has a signal for each pair that contains the camera. A pair has
/// no signals if one of its recordings is too short, if the search is disabled, or if its cameras have a common
/// centre. Returns an error if a frame cannot be read.
pub fn activities(
    recording: &Recording,
    pairs: &[[usize; 2]],
) -> Result<Vec<Activity>, CaptureError> {
    let capture = recording.frames.capture();
    let bands: Vec<Option<[Bands; 2]>> = pairs
        .iter()
        .map(|&pair| {
            let [a, b] = pair.map(|c| &capture.cameras[c].camera);
            is_long(recording, pair).then(|| Bands::of_pair(a, b)).flatten()
        })
        .collect();
    let activity = |camera: usize| {
        let own = (0..pairs.len()).filter_map(|n| {
            let side = pairs[n].iter().position(|&c| c == camera)?;
            Some((n, &bands[n].as_ref()?[side]))
        });
        let own: Vec<(usize, &Bands)> = own.collect();
        match own.is_empty() {
            true => Ok(Activity::default()),
            false => Activity::new(recording.frames, camera, &own),
        }
    };
    (0..capture.cameras.len()).into_par_iter().map(activity).collect()
}

/// Returns whether the offset of a pair can be searched for: the search range is above 0, and both recordings are
/// longer than [`MIN_OVERLAP_S`].
fn is_long(recording: &Recording, pair: [usize; 2]) -> bool {
    let duration_s = |c: usize| {
        let times = &recording.clocks[c].times_s;
        times[times.len() - 1] - times[0]
    };
    recording.options.search_s > 0.0 && pair.iter().all(|&c| duration_s(c) > MIN_OVERLAP_S)
}

/// Returns the offset of a pair of cameras [a, b], seconds, to about one frame. A pair without signals, such as a pair
/// with a short recording, gets the offset 0, which trusts the nominal clocks.
///
/// `activities` are the activities of a and b, which hold the pair's signals under `n`, the index of the pair. The
/// inner error is the reason why no offset is chosen. The outer error is a frame that cannot be read.
pub fn rough_offset(
    recording: &Recording,
    [a, b]: [usize; 2],
    activities: [&Activity; 2],
    n: usize,
) -> Result<Result<ClockModel, PairFailure>, CaptureError> {
    let signals =
        activities.map(|of| Some(Signal { times_s: &of.times_s, values: of.signals.get(&n)? }));
    let [Some(of_a), Some(of_b)] = signals else { return Ok(Ok(ClockModel::default())) };
    let frame_s = recording.clocks[a].frame_s().max(recording.clocks[b].frame_s());
    let mut offsets_s = peaks(&[of_a, of_b], recording.options.search_s, frame_s);
    if offsets_s.is_empty() {
        return Ok(Err(PairFailure::NoOverlap));
    }
    // The offset 0, which the nominal clocks imply, is always verified.
    if offsets_s.iter().all(|offset_s| offset_s.abs() > frame_s) {
        offsets_s.push(0.0);
    }
    let mut agreements = Vec::new();
    for offset_s in offsets_s {
        agreements.push((offset_s, agreement(recording, [a, b], offset_s, activities[0])?));
    }
    Ok(choose(&agreements, frame_s))
}

/// Chooses the offset with the largest agreement (fraction of inliers). `agreements` holds (offset in seconds,
/// agreement). If a rival ([`RIVAL_FRACTION`]) lies within [`NOMINAL_CLOCK_FRAMES`] of 0, the nominal clocks' offset,
/// the rival is chosen instead. Fails if `agreements` is empty, if the largest agreement is above 0 but below
/// [`MIN_AGREEMENT`], or if rivals lie more than [`NOMINAL_CLOCK_FRAMES`] from the chosen offset.
///
/// `frame_s` is the longer frame period of the two cameras, seconds.
fn choose(agreements: &[(f64, f64)], frame_s: f64) -> Result<ClockModel, PairFailure> {
    let max = agreements.iter().map(|a| a.1).fold(0.0, f64::max);
    let rivals: Vec<f64> = agreements
        .iter()
        .filter(|a| a.1 > 0.0 && a.1 >= RIVAL_FRACTION * max)
        .map(|a| a.0)
        .collect();
    let near = |x: f64, y: f64| (x - y).abs() <= NOMINAL_CLOCK_FRAMES * frame_s;
    if let Some(nominal) = rivals.iter().find(|&&offset| near(offset, 0.0)) {
        return Ok(ClockModel::constant(*nominal));
    }
    let Some(best) = agreements.iter().find(|a| a.1 == max) else {
        return Err(PairFailure::NoOverlap);
    };
    if max > 0.0 && max < MIN_AGREEMENT {
        return Err(PairFailure::NoConsensus);
    }
    if max == 0.0 {
        // No offset has inliers. The estimation of the pair determines the reason later.
        return Ok(ClockModel::default());
    }
    let is_unique = rivals.iter().all(|&other| near(other, best.0));
    if is_unique { Ok(ClockModel::constant(best.0)) } else { Err(PairFailure::PeriodicMotion) }
}

/// Returns the agreement of the images with a proposed offset `offset_b − offset_a`, seconds: the number of inliers
/// divided by the number of features that move across their epipolar lines. The agreement is 0 if there are fewer
/// than [`MIN_INLIERS`] inliers.
///
/// The overlap of the recordings is divided into [`TESTED_FRAMES`] parts. Each part contributes the frame triple (two
/// frames of one camera, one frame of another) at camera a's most active frame in this part.
fn agreement(
    recording: &Recording,
    [a, b]: [usize; 2],
    offset_s: f64,
    activity: &Activity,
) -> Result<f64, CaptureError> {
    let times = &recording.clocks[a].times_s;
    let possible: Vec<(usize, usize)> = (0..times.len() - 1)
        .filter_map(|k| Some((k, recording.image_between([a, b], k, offset_s)?)))
        .collect();
    let mut observations = Vec::new();
    let mut across = 0;
    for part in possible.chunks(possible.len().div_ceil(TESTED_FRAMES).max(1)) {
        let most_active = part.iter().max_by(|x, y| {
            activity.energies[x.0].total_cmp(&activity.energies[y.0]).then(y.0.cmp(&x.0))
        });
        let Some(&(k, m)) = most_active else { continue };
        let triple = recording.triple(([a, b], [k, m]))?;
        across += triple.across;
        observations.extend(triple.samples.iter().map(Observation::from));
    }
    let score = consensus_value(&observations).map_or(0.0, |(_, score)| score);
    let enough = score >= MIN_INLIERS as f64;
    Ok(if enough { score / across.max(1) as f64 } else { 0.0 })
}

/// Activity signal of one camera ([`Activity::signals`]). For each interval between successive frames, it has the
/// interval's middle, in seconds on the camera's clock, and 2·[`BANDS`] values (channels).
struct Signal<'a> {
    times_s: &'a [f64],
    values: &'a [[f32; 2 * BANDS]],
}

impl Signal<'_> {
    /// Interpolates the signal linearly at a time on the camera's clock, seconds. `None` outside the signal's time
    /// span.
    fn at(&self, time_s: f64) -> Option<[f32; 2 * BANDS]> {
        let after = self.times_s.partition_point(|&t| t < time_s);
        if after == self.times_s.len() || (after == 0 && self.times_s.first() != Some(&time_s)) {
            return None;
        }
        let before = after.saturating_sub(1);
        let gap = self.times_s[after] - self.times_s[before];
        let fraction = if gap > 0.0 { (time_s - self.times_s[before]) / gap } else { 1.0 };
        Some(std::array::from_fn(|c| {
            let (x, y) = (self.values[before][c], self.values[after][c]);
            x + fraction as f32 * (y - x)
        }))
    }
}

/// Returns the offsets `offset_b − offset_a`, seconds, at the highest local maxima of the correlation of two signals,
/// highest maximum first. Offsets from −`search_s` to `search_s` are tried, in steps of half of `frame_s`. `frame_s` is
/// the longer frame period of the two cameras, seconds.
fn peaks(signals: &[Signal; 2], search_s: f64, frame_s: f64) -> Vec<f64> {
    // A peak of the correlation is about one frame period wide.
    let step = 0.5 * frame_s;
    let max_steps = (search_s / step).ceil();
    // Only shifts at which the recordings overlap are tried, since the search range may have billions of
    // steps.
    let ends = |s: &Signal| Some((*s.times_s.first()?, *s.times_s.last()?));
    let [Some(a), Some(b)] = signals.each_ref().map(ends) else { return Vec::new() };
    let first = ((a.0 - b.1) / step).floor().max(-max_steps) as i64;
    let last = ((a.1 - b.0) / step).ceil().min(max_steps) as i64;
    let correlations: Vec<Option<f64>> =
        (first..=last).into_par_iter().map(|k| correlation(signals, k as f64 * step)).collect();
    let at = |k: usize| correlations.get(k).copied().flatten().unwrap_or(f64::NEG_INFINITY);
    let mut peaks: Vec<(f64, i64)> = (first..=last)
        .zip(0..)
        .filter(|&(_, n)| at(n) >= at(n.wrapping_sub(1)) && at(n) > at(n + 1))
        .filter_map(|(k, n)| Some((correlations[n]?, k)))
        .collect();
    peaks.sort_by(|x, y| y.0.total_cmp(&x.0));
    peaks.into_iter().take(MAX_CANDIDATES).map(|(_, k)| k as f64 * step).collect()
}

/// Returns the correlation of the signals of cameras a and b if `offset_b − offset_a` is `offset_s`, seconds. It is
/// the mean of two normalized cross-correlations: one of the energy channels, and one of the motion channels. The
/// mean of each channel over the overlap is subtracted first. `None` if the recordings overlap by less than
/// [`MIN_OVERLAP_S`], or if one signal is constant.
fn correlation([a, b]: &[Signal; 2], offset_s: f64) -> Option<f64> {
    let mut overlap: Vec<([f32; 2 * BANDS], [f32; 2 * BANDS])> = Vec::new();
    let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
    for (time_s, value) in a.times_s.iter().zip(a.values) {
        if let Some(other) = b.at(time_s - offset_s) {
            overlap.push((*value, other));
            (first_s, last_s) = (first_s.min(*time_s), last_s.max(*time_s));
        }
    }
    // Samples are at the middles of intervals, so that half an interval at either end belongs to the overlap.
    // One more interval is added, so that rounding does not exclude the bound itself.
    let interval = (last_s - first_s) / (overlap.len().max(2) - 1) as f64;
    if !(last_s - first_s + 2.0 * interval >= MIN_OVERLAP_S) {
        return None;
    }
    let n = overlap.len() as f64;
    let mut sums = [[0.0_f64; 3]; 2];
    for channel in 0..2 * BANDS {
        let (mut x, mut y) = (0.0, 0.0);
        for (p, q) in &overlap {
            x += f64::from(p[channel]);
            y += f64::from(q[channel]);
        }
        let (x, y) = (x / n, y / n);
        let sums = &mut sums[channel / BANDS];
        for (p, q) in &overlap {
            let (p, q) = (f64::from(p[channel]) - x, f64::from(q[channel]) - y);
            sums[0] += p * q;
            sums[1] += p * p;
            sums[2] += q * q;
        }
    }
    // Energy and motion have different units, so each of them is normalized separately.
    let parts = sums.map(|[both, x, y]| both / (x * y).sqrt());
    let finite: Vec<f64> = parts.into_iter().filter(|p| p.is_finite()).collect();
    (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Returns a smooth random signal, sampled at a camera's rate: the sample times, seconds, and the values.
    fn sampled_signal(
        seed: u64,
        rate_hz: f64,
        start_s: f64,
        duration_s: f64,
    ) -> (Vec<f64>, Vec<[f32; 2 * BANDS]>) {
        let random = &mut Random::new(seed);
        let waves: Vec<[f64; 4]> = (0..12).map(|_| [0; 4].map(|_| random.unit())).collect();
        let times: Vec<f64> =
            (0..(duration_s * rate_hz) as usize).map(|k| k as f64 / rate_hz).collect();
        let values = times
            .iter()
            .map(|t| {
                std::array::from_fn(|c| {
                    let at = |w: &[f64; 4]| {
                        let phase = w[1] + w[3] * c as f64;
                        (std::f64::consts::TAU * ((0.2 + 1.5 * w[0]) * (t + start_s) + phase)).sin()
                    };
                    waves.iter().map(at).sum::<f64>() as f32
                })
            })
            .collect();
        (times, values)
    }

    #[test]
    fn a_hundred_recordings_are_aligned_to_a_frame() {
        let random = &mut Random::new(6);
        for seed in 0..100 {
            // Recordings that start up to 5 s apart and overlap by at least 2 s.
            let offset_s = 10.0 * random.unit() - 5.0;
            let rates = [30.0, 15.0 + 15.0 * random.unit()];
            let duration_s = offset_s.abs() + 2.2 + 3.0 * random.unit();
            let signals = [(rates[0], 20.0), (rates[1], 20.0 + offset_s)]
                .map(|(rate, start)| sampled_signal(seed, rate, start, duration_s));
            let signals = signals.each_ref().map(|(times_s, values)| Signal { times_s, values });
            let frame_s = 1.0 / rates[1];
            let best = peaks(&signals, 5.0, frame_s)[0];
            assert!((best - offset_s).abs() <= frame_s, "{seed}: {best} {offset_s}");
        }
    }

    #[test]
    fn recordings_without_change_or_overlap_have_no_peak() {
        let (times_s, values) = sampled_signal(1, 30.0, 0.0, 4.0);
        let constant = vec![[1.0; 2 * BANDS]; times_s.len()];
        let varying = Signal { times_s: &times_s, values: &values };
        let flat = Signal { times_s: &times_s, values: &constant };
        assert_eq!(correlation(&[varying, flat], 0.0), None);
        let later: Vec<f64> = times_s.iter().map(|t| t + 100.0).collect();
        let (_, values) = sampled_signal(1, 30.0, 0.0, 4.0);
        let apart = [
            Signal { times_s: &times_s, values: &values },
            Signal { times_s: &later, values: &values },
        ];
        assert!(peaks(&apart, 5.0, 1.0 / 30.0).is_empty());
    }

    #[test]
    fn nominal_clocks_decide_between_rivals() {
        let frame_s = 0.04;
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.45)], frame_s), Ok(ClockModel::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.1)], frame_s), Ok(ClockModel::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.4), (0.02, 0.1)], frame_s), Err(PairFailure::NoConsensus));
        assert_eq!(choose(&[(1.0, 0.1), (0.02, 0.4)], frame_s), Ok(ClockModel::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (2.0, 0.45)], frame_s), Err(PairFailure::PeriodicMotion));
        assert_eq!(choose(&[(1.0, 0.5), (1.02, 0.45)], frame_s), Ok(ClockModel::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.0)], frame_s), Ok(ClockModel::default()));
        assert_eq!(choose(&[], frame_s), Err(PairFailure::NoOverlap));
    }
}
