//! The offset between two cameras, from all frames that see it.

use super::candidates::ThreeFrames;
use super::consensus::{ransac, weighted_least_squares};
use super::{OffsetOptions, OffsetRung};
use crate::capture::CaptureError;
use crate::registration::{FrameStore, Track, flow};
use serde::Serialize;
use std::collections::{HashMap, hash_map::Entry};

/// What one pair of cameras says: `offset_j − offset_i`, seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairEstimate {
    pub cameras: [usize; 2],
    pub offset_s: f64,
    pub std_err_s: f64,
    pub inliers: usize,
    pub candidates: usize,
    /// The paper's estimate of every triple of frames.
    pub frames: Vec<FrameEstimate>,
}

/// The estimate from three frames: two of `camera`, one of the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameEstimate {
    pub camera: usize,
    pub frame: usize,
    pub offset_s: f64,
    pub inliers: usize,
    pub candidates: usize,
}

/// A feature's candidate as an offset of the pair.
#[derive(Clone, Copy, Debug)]
struct Sample {
    offset_s: f64,
    across_px_s: f64,
    /// Which triple of frames it is from: errors within one are not independent.
    group: usize,
}

/// The temporal tracks of every frame of every camera that is used; `None` where none was asked.
pub type Tracks = Vec<Vec<Option<Vec<Track>>>>;

/// Offsets and speeds across of the features of one triple of frames (camera a, camera b, frame k
/// of a, frame m of b): rounds of the search share most triples.
type KnownTriples = HashMap<(usize, usize, usize, usize), Vec<(f64, f64)>>;

/// The pair (i, j) from both sides: camera i's tracks against camera j's frames, and the reverse.
///
/// `None` if too few candidates agree.
pub fn estimate_pair(
    frames: &FrameStore,
    tracks: &Tracks,
    [i, j]: [usize; 2],
    options: &OffsetOptions,
) -> Result<Option<PairEstimate>, CaptureError> {
    let mut guess_s = 0.0;
    let mut used_before = Vec::new();
    let mut estimate = None;
    let mut known = KnownTriples::new();
    // The right frame of j lies between two of i; which one that is depends on the offset itself.
    for _ in 0..4 {
        let used: Vec<_> = [[i, j, 0], [j, i, 1]]
            .into_iter()
            .flat_map(|[a, b, reversed]| {
                let sign = if reversed == 1 { -1.0 } else { 1.0 };
                triples(frames, tracks, [a, b], sign * guess_s)
                    .into_iter()
                    .map(move |(k, m)| (a, b, k, m, sign))
            })
            .collect();
        if used.is_empty() || used == used_before {
            break;
        }
        let mut samples = Vec::new();
        let mut frame_estimates = Vec::new();
        for (group, &(a, b, k, m, sign)) in used.iter().enumerate() {
            let found = match known.entry((a, b, k, m)) {
                Entry::Occupied(entry) => entry.into_mut(),
                Entry::Vacant(entry) => {
                    entry.insert(from_three_frames(frames, tracks, [a, b], [k, m], options)?)
                }
            };
            let found: Vec<Sample> = found
                .iter()
                .map(|&(offset_s, across_px_s)| Sample {
                    offset_s: sign * offset_s,
                    across_px_s,
                    group,
                })
                .collect();
            frame_estimates.extend(frame_estimate(&found, a, k, frames, options));
            samples.extend(found);
        }
        let frame_s = frames.capture().cameras[i].clock.frame_s();
        let rough = combine([i, j], &samples, frame_estimates, frame_s, options);
        let Some(found) = rough else { break };
        guess_s = found.offset_s;
        estimate = Some(found);
        used_before = used;
    }
    Ok(estimate)
}

/// Frames (k of a, m of b) with m between k and k + 1, for an offset of b against a.
fn triples(
    frames: &FrameStore,
    tracks: &Tracks,
    [a, b]: [usize; 2],
    offset_s: f64,
) -> Vec<(usize, usize)> {
    let (clock_a, clock_b) =
        (&frames.capture().cameras[a].clock, &frames.capture().cameras[b].clock);
    (0..tracks[a].len())
        .filter(|&k| tracks[a][k].is_some())
        .filter_map(|k| {
            let middle = 0.5 * (clock_a.times_s[k] + clock_a.times_s[k + 1]);
            let m = clock_b.nearest(middle - offset_s);
            let time_s = clock_b.times_s[m] + offset_s;
            // Beyond by less than the path can be followed, for a guess that is still rough.
            let slack = 0.5 * (clock_a.times_s[k + 1] - clock_a.times_s[k]);
            (time_s >= clock_a.times_s[k] - slack && time_s <= clock_a.times_s[k + 1] + slack)
                .then_some((k, m))
        })
        .collect()
}

/// The offsets `offset_b − offset_a` of all features of a at frame k, with their speeds across.
fn from_three_frames(
    frames: &FrameStore,
    tracks: &Tracks,
    [a, b]: [usize; 2],
    [k, m]: [usize; 2],
    options: &OffsetOptions,
) -> Result<Vec<(f64, f64)>, CaptureError> {
    let cameras = &frames.capture().cameras;
    let (source, target) = (frames.get(a, k)?, frames.get(b, m)?);
    let Some(all) = &tracks[a][k] else { return Ok(Vec::new()) };
    // §7 starts from the features selected on I_i(t) itself.
    let chosen: Vec<&Track> = all.iter().filter(|t| t.in_forward_set()).collect();
    let between = cameras[b].clock.times_s[m] - cameras[a].clock.times_s[k];
    let interval = cameras[a].clock.times_s[k + 1] - cameras[a].clock.times_s[k];
    let share = (between / interval).clamp(0.0, 1.0);
    let starts: Vec<_> =
        chosen.iter().map(|t| (t.earlier, t.earlier + t.motion() * share)).collect();
    let in_b: Vec<_> = flow(&source, &target, &starts, frames.options())
        .into_iter()
        .map(|found| found.map(|f| f.target))
        .collect();
    let three = ThreeFrames {
        camera_i: &cameras[a].camera,
        camera_j: &cameras[b].camera,
        times_i: &cameras[a].clock.times_s,
        index_i: k,
        curved: options.rung == OffsetRung::JointCurved,
        min_across_px: options.min_across_px,
    };
    // offset_b − offset_a = t̃ − (clock_b(t') − clock_a(t))
    Ok(three
        .candidates(&chosen, &in_b)
        .into_iter()
        .map(|c| (c.time_s - between, c.across_px_s))
        .collect())
}

/// RANSAC and WLS on one triple of frames.
fn frame_estimate(
    samples: &[Sample],
    camera: usize,
    frame: usize,
    frames: &FrameStore,
    options: &OffsetOptions,
) -> Option<FrameEstimate> {
    let times = &frames.capture().cameras[camera].clock.times_s;
    let interval = times[frame + 1] - times[frame];
    let mut values: Vec<f64> = samples.iter().map(|s| s.offset_s).collect();
    values.sort_by(f64::total_cmp);
    let inliers = ransac(&values, options.tolerance_share * interval);
    let enough = inliers.len() >= options.min_inliers
        && inliers.len() as f64 >= options.min_inlier_share * values.len() as f64;
    let offset_s = weighted_least_squares(&values[inliers.clone()], options.gamma / interval)?;
    enough.then_some(FrameEstimate {
        camera,
        frame,
        offset_s,
        inliers: inliers.len(),
        candidates: values.len(),
    })
}

/// One estimate from all triples: the paper's mean of the frames' estimates, or all inliers
/// together, each weighted by what it knows.
fn combine(
    cameras: [usize; 2],
    samples: &[Sample],
    frames: Vec<FrameEstimate>,
    frame_s: f64,
    options: &OffsetOptions,
) -> Option<PairEstimate> {
    let mut values: Vec<f64> = samples.iter().map(|s| s.offset_s).collect();
    values.sort_by(f64::total_cmp);
    let consensus = ransac(&values, options.tolerance_share * frame_s);
    if consensus.len() < options.min_inliers
        || (consensus.len() as f64) < options.min_inlier_share * values.len() as f64
    {
        return None;
    }
    let center = weighted_least_squares(&values[consensus.clone()], options.gamma / frame_s)?;
    let (offset_s, std_err_s) = if options.rung == OffsetRung::Pairwise {
        mean_of_frames(&frames)?
    } else {
        weighted_mean(samples, center, 3.0 * options.tolerance_share * frame_s)?
    };
    Some(PairEstimate {
        cameras,
        offset_s,
        std_err_s,
        inliers: consensus.len(),
        candidates: values.len(),
        frames,
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

/// The robust mean of samples around `center`, each weighted by its information, the squared
/// speed across the line; residuals in pixels, Tukey's weights on top. The standard error is the
/// sandwich over groups, whose errors share their frames' errors.
fn weighted_mean(samples: &[Sample], center: f64, reach_s: f64) -> Option<(f64, f64)> {
    let near: Vec<&Sample> =
        samples.iter().filter(|s| (s.offset_s - center).abs() <= reach_s).collect();
    let mut mean = center;
    let mut scale_px = 0.0;
    let weight = |s: &Sample, mean: f64, scale_px: f64| {
        let r = (s.offset_s - mean) * s.across_px_s / (4.685 * scale_px);
        let robust = if r.abs() < 1.0 { (1.0 - r * r).powi(2) } else { 0.0 };
        robust * s.across_px_s * s.across_px_s
    };
    for _ in 0..30 {
        let mut residuals: Vec<f64> =
            near.iter().map(|s| ((s.offset_s - mean) * s.across_px_s).abs()).collect();
        residuals.sort_by(f64::total_cmp);
        // 1.4826: the standard deviation of a Gaussian over its median absolute deviation. The
        // floor is what a track can't resolve.
        scale_px = (1.4826 * residuals.get(residuals.len() / 2)?).max(1e-3);
        let (mut sum, mut total) = (0.0, 0.0);
        for s in &near {
            let w = weight(s, mean, scale_px);
            sum += w * s.offset_s;
            total += w;
        }
        if !(total > 0.0) {
            return None;
        }
        let next = sum / total;
        let rests = (next - mean).abs() < 1e-9 * reach_s;
        mean = next;
        if rests {
            break;
        }
    }
    let groups = near.iter().map(|s| s.group).max()? + 1;
    let mut scores = vec![0.0; groups];
    let mut seen = vec![false; groups];
    let (mut total, mut independent) = (0.0, 0.0);
    for s in &near {
        let w = weight(s, mean, scale_px);
        let score = w * (s.offset_s - mean);
        scores[s.group] += score;
        seen[s.group] = true;
        independent += score * score;
        total += w;
    }
    let n = seen.iter().filter(|&&s| s).count() as f64;
    if n < 2.0 || !(total > 0.0) {
        return None;
    }
    let clustered = scores.iter().map(|s| s * s).sum::<f64>() * n / (n - 1.0);
    Some((mean, clustered.max(independent).sqrt() / total))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(noise: f64) -> Vec<Sample> {
        (0..400)
            .map(|k| {
                let x = f64::from(k);
                let across_px_s = 100.0 + 300.0 * (x * 0.37).sin().abs();
                let error_px = noise * (x * 78.233).sin();
                let outlier = k % 5 == 0;
                Sample {
                    offset_s: if outlier {
                        0.03 * (x * 3.3).sin()
                    } else {
                        0.01 + error_px / across_px_s
                    },
                    across_px_s,
                    group: (k / 40) as usize,
                }
            })
            .collect()
    }

    #[test]
    fn the_weighted_mean_ignores_outliers_and_knows_its_error() {
        let (mean, std_err) = weighted_mean(&samples(0.1), 0.0101, 0.005).unwrap();
        assert!((mean - 0.01).abs() < 3.0 * std_err, "{mean} {std_err}");
        assert!(std_err < 1e-4);
    }

    #[test]
    fn nothing_near_is_no_estimate() {
        assert_eq!(weighted_mean(&[], 0.0, 1.0), None);
        assert_eq!(weighted_mean(&samples(0.1), 9.0, 0.005), None);
        let one_group: Vec<Sample> =
            samples(0.1).into_iter().map(|s| Sample { group: 0, ..s }).collect();
        assert_eq!(weighted_mean(&one_group, 0.01, 0.005), None);
    }
}
