//! Finds the offsets at which the activity signals of two cameras correlate best.

use super::activity::BANDS;
use rayon::prelude::*;

/// The minimum overlap in time of two recordings, seconds. Offsets with a shorter overlap are not searched.
pub const MIN_OVERLAP_S: f64 = 2.0;
/// The maximum number of correlation peaks whose offsets are verified.
const MAX_CANDIDATES: usize = 5;

/// Activity signal of one camera ([`Activity::signals`]). For each interval between successive frames, it has the
/// interval's middle, in seconds on the camera's clock, and 2·[`BANDS`] values (channels).
pub struct Signal<'a> {
    pub times_s: &'a [f64],
    pub values: &'a [[f32; 2 * BANDS]],
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
pub fn peaks(signals: &[Signal; 2], search_s: f64, frame_s: f64) -> Vec<f64> {
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
}
