//! Rough alignment: recordings started by hand differ by seconds. Which whole frames belong
//! together is found from signals of activity, and the few best answers are put to the epipolar
//! test on a few frames.

use super::activity::{Activity, BANDS, Bands};
use super::film::Film;
use super::mixture::Observation;
use super::pair::{Blind, Guess, MIN_AGREEMENT, OWN_CLOCKS_FRAMES, residuals};
use crate::capture::CaptureError;
use rayon::prelude::*;

/// How well two signals agree when the second camera's clock is `offset_s` behind the first's.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shift {
    offset_s: f64,
    /// Normalized cross-correlation, −1 to 1.
    correlation: f64,
}

/// Answers of the correlation that are put to the epipolar test.
const MAX_CANDIDATES: usize = 5;
/// Frames that it is done on.
const TESTED_FRAMES: usize = 6;
/// A rival with this share of the best answer's agreement is as good.
const AS_GOOD: f64 = 0.8;

/// The activity of every camera that may have to be aligned, with the signals of its pairs by the
/// pairs' numbers. Those whose clocks are taken to be right to a frame have none, nor have those that
/// stand in one place.
pub struct Activities {
    of_camera: Vec<Activity>,
    /// Which signal of each of its cameras is a pair's.
    signals: Vec<Option<[usize; 2]>>,
}

impl Activities {
    /// Reads all frames of the cameras that need it.
    pub fn new(film: &Film, pairs: &[[usize; 2]]) -> Result<Self, CaptureError> {
        let capture = film.frames.capture();
        let bands: Vec<Option<[Bands; 2]>> = pairs
            .iter()
            .map(|&pair| {
                let [a, b] = pair.map(|c| &capture.cameras[c].camera);
                is_long(film, pair).then(|| Bands::of_pair(a, b)).flatten()
            })
            .collect();
        let mut of_cameras: Vec<Vec<&Bands>> = vec![Vec::new(); capture.cameras.len()];
        let mut signals = Vec::with_capacity(pairs.len());
        for (pair, bands) in pairs.iter().zip(&bands) {
            signals.push(bands.as_ref().map(|bands| {
                [0, 1].map(|n| {
                    let own = &mut of_cameras[pair[n]];
                    own.push(&bands[n]);
                    own.len() - 1
                })
            }));
        }
        let of_camera = of_cameras
            .par_iter()
            .enumerate()
            .map(|(c, bands)| match bands.is_empty() {
                true => Ok(Activity::default()),
                false => Activity::new(capture, c, bands),
            })
            .collect::<Result<_, CaptureError>>()?;
        Ok(Self { of_camera, signals })
    }
}

/// Whether both cameras of a pair filmed for longer than the least overlap that is searched for.
fn is_long(film: &Film, pair: [usize; 2]) -> bool {
    let options = film.options;
    let duration = |c: usize| {
        let (first, last) = film.timelines.span_s(c);
        last - first
    };
    options.search_s > 0.0 && pair.iter().all(|&c| duration(c) > options.min_overlap_s)
}

/// The offset of pair number `n` to about a frame: the clocks' own for short films.
pub fn rough(
    film: &Film,
    pairs: &[[usize; 2]],
    n: usize,
    activities: &Activities,
) -> Result<Result<Guess, Blind>, CaptureError> {
    let Some(numbers) = activities.signals[n] else { return Ok(Ok(Guess::default())) };
    let [a, b] = pairs[n];
    let frame_s = film.timelines.frame_s(a).max(film.timelines.frame_s(b));
    let [of_a, of_b] = [a, b].map(|c| &activities.of_camera[c]);
    let signals = [(of_a, numbers[0]), (of_b, numbers[1])]
        .map(|(of, n)| Signal { times_s: &of.times_s, values: &of.signals[n] });
    let mut tried = peaks(&signals, film.options.search_s, film.options.min_overlap_s, frame_s);
    if tried.is_empty() {
        return Ok(Err(Blind::Apart));
    }
    // The clocks' own word is always heard.
    if tried.iter().all(|s| s.offset_s.abs() > frame_s) {
        tried.push(Shift { offset_s: 0.0, correlation: 0.0 });
    }
    let mut agreed = Vec::new();
    for shift in &tried {
        agreed.push((shift.offset_s, agreement(film, [a, b], shift.offset_s, of_a)?));
    }
    Ok(choose(&agreed, frame_s))
}

/// The offset that most agree with; of several as good, the clocks' own, if it is one of them.
fn choose(agreed: &[(f64, f64)], frame_s: f64) -> Result<Guess, Blind> {
    let most = agreed.iter().map(|a| a.1).fold(0.0, f64::max);
    let good: Vec<f64> =
        agreed.iter().filter(|a| a.1 > 0.0 && a.1 >= AS_GOOD * most).map(|a| a.0).collect();
    let near = |x: f64, y: f64| (x - y).abs() <= OWN_CLOCKS_FRAMES * frame_s;
    if let Some(own) = good.iter().find(|&&offset| near(offset, 0.0)) {
        return Ok(Guess::constant(*own));
    }
    let Some(best) = agreed.iter().find(|a| a.1 == most) else { return Err(Blind::Apart) };
    if most > 0.0 && most < MIN_AGREEMENT {
        return Err(Blind::Discordant);
    }
    if most == 0.0 {
        // Nothing is seen at any offset; the pair itself says why.
        return Ok(Guess::default());
    }
    let alone = good.iter().all(|&other| near(other, best.0));
    if alone { Ok(Guess::constant(best.0)) } else { Err(Blind::Repeating) }
}

/// The share of features that move across their epipolar lines whose epipolar lines cross their paths at one offset near the
/// given one, on frames of camera a with much activity, spread over what both filmed.
fn agreement(
    film: &Film,
    [a, b]: [usize; 2],
    offset_s: f64,
    activity: &Activity,
) -> Result<f64, CaptureError> {
    let times = &film.timelines.times_s[a];
    let possible: Vec<(usize, usize)> = (0..times.len() - 1)
        .filter_map(|k| Some((k, film.between([a, b], k, offset_s)?)))
        .collect();
    let mut observations = Vec::new();
    let mut across = 0;
    for part in possible.chunks(possible.len().div_ceil(TESTED_FRAMES).max(1)) {
        let most = part.iter().max_by(|x, y| {
            activity.energies[x.0].total_cmp(&activity.energies[y.0]).then(y.0.cmp(&x.0))
        });
        let Some(&(k, m)) = most else { continue };
        let triple = film.triple([a, b], [k, m])?;
        across += triple.across;
        observations.extend(triple.samples.iter().map(|s| Observation {
            value_s: s.offset_s(),
            at_s: 0.0,
            across_px_s: s.across_px_s,
        }));
    }
    let residuals = residuals(film.timelines.frame_s(a), film.options);
    let score = residuals.start(&observations).map_or(0.0, |(_, score)| score);
    let enough = score >= film.options.min_inliers as f64;
    Ok(if enough { score / across.max(1) as f64 } else { 0.0 })
}

struct Signal<'a> {
    times_s: &'a [f64],
    values: &'a [[f32; 2 * BANDS]],
}

impl Signal<'_> {
    /// Linearly between samples; `None` outside.
    fn at(&self, time_s: f64) -> Option<[f32; 2 * BANDS]> {
        let after = self.times_s.partition_point(|&t| t < time_s);
        if after == self.times_s.len() || (after == 0 && self.times_s.first() != Some(&time_s)) {
            return None;
        }
        let before = after.saturating_sub(1);
        let gap = self.times_s[after] - self.times_s[before];
        let share = if gap > 0.0 { (time_s - self.times_s[before]) / gap } else { 1.0 };
        Some(std::array::from_fn(|c| {
            let (x, y) = (self.values[before][c], self.values[after][c]);
            x + share as f32 * (y - x)
        }))
    }
}

/// The highest peaks of the correlation over all shifts within the search, best first.
fn peaks(signals: &[Signal; 2], search_s: f64, min_overlap_s: f64, frame_s: f64) -> Vec<Shift> {
    // Half a frame: a peak is as wide as a frame's change of motion.
    let step = 0.5 * frame_s;
    let reach = (search_s / step).ceil();
    // Beyond these the recordings have nothing in common, and there may be billions of steps.
    let ends = |s: &Signal| Some((*s.times_s.first()?, *s.times_s.last()?));
    let [Some(a), Some(b)] = signals.each_ref().map(ends) else { return Vec::new() };
    let first = ((a.0 - b.1) / step).floor().max(-reach) as i64;
    let last = ((a.1 - b.0) / step).ceil().min(reach) as i64;
    let all: Vec<Option<Shift>> = (first..=last)
        .into_par_iter()
        .map(|k| {
            let offset_s = k as f64 * step;
            let correlation = correlation(signals, offset_s, min_overlap_s)?;
            Some(Shift { offset_s, correlation })
        })
        .collect();
    let at = |k: usize| all[k].map_or(f64::NEG_INFINITY, |s| s.correlation);
    let mut peaks: Vec<Shift> = (0..all.len())
        .filter(|&k| (k == 0 || at(k) >= at(k - 1)) && (k + 1 == all.len() || at(k) > at(k + 1)))
        .filter_map(|k| all[k])
        .collect();
    peaks.sort_by(|x, y| y.correlation.total_cmp(&x.correlation));
    peaks.truncate(MAX_CANDIDATES);
    peaks
}

/// The normalized cross-correlation of all bands together, each about its own mean; `None` where
/// the recordings overlap too little, or one of them shows no change.
fn correlation([a, b]: &[Signal; 2], offset_s: f64, min_overlap_s: f64) -> Option<f64> {
    let mut overlap: Vec<([f32; 2 * BANDS], [f32; 2 * BANDS])> = Vec::new();
    let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
    for (time_s, value) in a.times_s.iter().zip(a.values) {
        if let Some(other) = b.at(time_s - offset_s) {
            overlap.push((*value, other));
            (first_s, last_s) = (first_s.min(*time_s), last_s.max(*time_s));
        }
    }
    // The first and the last interval count too; rounding must not exclude the bound itself.
    let interval = (last_s - first_s) / (overlap.len().max(2) - 1) as f64;
    if !(last_s - first_s + 2.0 * interval >= min_overlap_s) {
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
    // Energy and motion have units of their own; each counts as much.
    let parts = sums.map(|[both, x, y]| both / (x * y).sqrt());
    let finite: Vec<f64> = parts.into_iter().filter(|p| p.is_finite()).collect();
    (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// A smooth random signal, sampled by two cameras at rates of their own.
    fn filmed(
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
    fn hundreds_of_recordings_are_aligned_to_a_frame() {
        let random = &mut Random::new(6);
        for seed in 0..100 {
            // Started up to 5 s apart, overlapping by 2 s or more.
            let late_s = 10.0 * random.unit() - 5.0;
            let rates = [30.0, 15.0 + 15.0 * random.unit()];
            let duration_s = late_s.abs() + 2.2 + 3.0 * random.unit();
            let signals = [(rates[0], 20.0), (rates[1], 20.0 + late_s)]
                .map(|(rate, start)| filmed(seed, rate, start, duration_s));
            let signals = signals.each_ref().map(|(times_s, values)| Signal { times_s, values });
            let frame_s = 1.0 / rates[1];
            let best = peaks(&signals, 5.0, 2.0, frame_s)[0];
            assert!((best.offset_s - late_s).abs() <= frame_s, "{seed}: {best:?} {late_s}");
        }
    }

    #[test]
    fn recordings_without_change_or_overlap_have_no_peak() {
        let (times_s, values) = filmed(1, 30.0, 0.0, 4.0);
        let still = vec![[1.0; 2 * BANDS]; times_s.len()];
        let moving = Signal { times_s: &times_s, values: &values };
        let flat = Signal { times_s: &times_s, values: &still };
        assert_eq!(correlation(&[moving, flat], 0.0, 2.0), None);
        let later: Vec<f64> = times_s.iter().map(|t| t + 100.0).collect();
        let (_, values) = filmed(1, 30.0, 0.0, 4.0);
        let apart = [
            Signal { times_s: &times_s, values: &values },
            Signal { times_s: &later, values: &values },
        ];
        assert!(peaks(&apart, 5.0, 2.0, 1.0 / 30.0).is_empty());
    }

    #[test]
    fn the_clocks_own_word_decides_between_equals() {
        let frame_s = 0.04;
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.45)], frame_s), Ok(Guess::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (0.02, 0.1)], frame_s), Ok(Guess::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.4), (0.02, 0.1)], frame_s), Err(Blind::Discordant));
        assert_eq!(choose(&[(1.0, 0.1), (0.02, 0.4)], frame_s), Ok(Guess::constant(0.02)));
        assert_eq!(choose(&[(1.0, 0.5), (2.0, 0.45)], frame_s), Err(Blind::Repeating));
        assert_eq!(choose(&[(1.0, 0.5), (1.02, 0.45)], frame_s), Ok(Guess::constant(1.0)));
        assert_eq!(choose(&[(1.0, 0.0)], frame_s), Ok(Guess::default()));
        assert_eq!(choose(&[], frame_s), Err(Blind::Apart));
    }
}
