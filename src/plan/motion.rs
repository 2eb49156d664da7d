//! Measurement of the motion in the images, in a few pairs of successive frames of every camera.

use super::percentile;
use crate::capture::{CaptureError, FrameTimes};
use crate::interpolation::{changed_fraction, largest_change};
use crate::progress::Reporter;
use crate::registration::{
    FrameStore, Neighbors, Track, Trajectory, neighbor_consensus, temporal_flow,
};
use nalgebra::Vector2;
use rayon::prelude::*;

/// Number of pairs of successive frames that are examined per camera: the first, the middle and the last pair.
const PAIRS: usize = 3;

/// Number of tracked features that move at least as far as the measured largest motion, [`Motion::largest_px`]. The
/// motion of the fifth fastest feature is taken, so that a few outliers don't determine the value.
const WITNESSES: usize = 5;

/// Motion from one frame to the next below which a tracked feature counts as static, in pixels.
const STILL_PX: f64 = 0.5;

/// Largest change of an image block that noise can cause from one frame to the next, if nothing moves. The change is
/// the mean absolute difference of pixel values, which are from 0 to 1. A larger change means that the light changes or
/// that the whole image moves.
pub(super) const MAX_NOISE: f32 = 4.0 / 255.0;

/// Radius of the neighbourhood whose tracks predict a track's motion, in pixels. With a larger radius, any motion that
/// varies in space would add to [`Motion::residual_px`]. With a smaller radius, the outlines of moving objects would be
/// missed.
const NEIGHBORHOOD_PX: f64 = 40.0;
/// Number of nearest tracks whose weighted mean motion predicts a track's motion.
const PREDICTING: usize = 6;

/// The motion in a capture, measured in a few pairs of successive frames of every camera. Numbers of pairs are totals.
/// All other values are maxima over the pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Largest motion of features from one frame to the next, in pixels. For a frame pair, it is the motion of the
    /// fifth fastest feature, so that outliers are ignored; 0 with fewer features. The value is the maximum over the
    /// pairs.
    pub largest_px: f64,
    /// Curvature of trajectories, in pixels. For a feature, it is the distance between its trajectory through four
    /// frames and the straight line between its positions in the middle two frames, halfway in time between these two.
    /// The value is the 95th percentile over the moving features of a frame pair, and the maximum over the pairs.
    pub curvature_px: f64,
    /// Motion residual, in pixels: the distance between the position of a feature halfway in time between two frames
    /// and the position that the motion of neighbouring features predicts. The value is the 99th percentile over the
    /// features of a frame pair, and the maximum over the pairs. It is large at the outlines of objects with different
    /// motion.
    pub residual_px: f64,
    /// Fraction of image blocks that change by more than noise from one frame to the next, from 0 to 1.
    pub changed_fraction: f64,
    /// Number of still pairs: frame pairs in which no block changes by more than noise, and no feature moves.
    pub still_pairs: usize,
    /// Largest change of an image block in the still pairs: the mean absolute difference of its pixel values, which are
    /// from 0 to 1. In a still pair, no block changes by more than noise, and no feature moves.
    pub still_change: f32,
    /// Largest motion of features in the still pairs, in pixels. In a still pair, no image block changes by more than
    /// noise, and this motion is below 0.5 px.
    pub still_px: f64,
    /// Number of examined frame pairs; 0 if every camera took one frame.
    pub pairs: usize,
}

impl Motion {
    /// Measures the motion in a few frame pairs of every camera.
    pub fn survey(frames: &FrameStore, reporter: &Reporter) -> Result<Self, CaptureError> {
        let capture = frames.capture();
        let pairs: Vec<(usize, usize)> = (0..capture.cameras.len())
            .flat_map(|c| spread(capture.cameras[c].frames.len()).into_iter().map(move |k| (c, k)))
            .collect();
        let task = reporter.task("planning", pairs.len());
        let mut all = Self::default();
        for (camera, k) in pairs {
            let pair = Self::of_pair(frames, camera, k)?;
            all.largest_px = all.largest_px.max(pair.largest_px);
            all.curvature_px = all.curvature_px.max(pair.curvature_px);
            all.residual_px = all.residual_px.max(pair.residual_px);
            all.changed_fraction = all.changed_fraction.max(pair.changed_fraction);
            all.still_pairs += pair.still_pairs;
            all.still_change = all.still_change.max(pair.still_change);
            all.still_px = all.still_px.max(pair.still_px);
            all.pairs += pair.pairs;
            task.advance(1);
        }
        Ok(all)
    }

    fn of_pair(frames: &FrameStore, camera: usize, k: usize) -> Result<Self, CaptureError> {
        let mut tracks = temporal_flow(frames, camera, k)?;
        let mut agrees = neighbor_consensus(&tracks, frames.options()).into_iter();
        tracks.retain(|_| agrees.next() == Some(true));
        let times_s = &frames.capture().cameras[camera].clock.times_s;
        let earlier = frames.get(camera, k)?;
        let later = frames.get_exposed_at(camera, k + 1, times_s[k])?;
        let largest_px = largest(&tracks);
        let changed_fraction = changed_fraction(&earlier.image, &later.image);
        let change = largest_change(&earlier.image, &later.image);
        let is_still = changed_fraction == 0.0 && change <= MAX_NOISE && largest_px < STILL_PX;
        Ok(Self {
            largest_px,
            curvature_px: curvature(&tracks, times_s, k),
            residual_px: residual(&tracks),
            changed_fraction,
            still_pairs: usize::from(is_still),
            still_change: if is_still { change } else { 0.0 },
            still_px: if is_still { largest_px } else { 0.0 },
            pairs: 1,
        })
    }
}

/// Returns the index of the earlier frame of each pair of successive frames to examine, for a recording of `frames`
/// frames.
fn spread(frames: usize) -> Vec<usize> {
    let pairs = frames.saturating_sub(1);
    let mut found: Vec<usize> = match pairs {
        0 => Vec::new(),
        _ => (0..PAIRS).map(|n| n * (pairs - 1) / (PAIRS - 1)).collect(),
    };
    found.dedup();
    found
}

/// Returns the largest motion, in pixels, that at least [`WITNESSES`] tracks reach or exceed. Returns 0 if there are
/// fewer tracks.
fn largest(tracks: &[Track]) -> f64 {
    let mut motions: Vec<f64> = tracks.iter().map(|t| t.motion().norm()).collect();
    motions.sort_by(|a, b| b.total_cmp(a));
    motions.get(WITNESSES - 1).copied().unwrap_or(0.0)
}

fn curvature(tracks: &[Track], times_s: &[f64], k: usize) -> f64 {
    let middle_s = 0.5 * (times_s[k] + times_s[k + 1]);
    let moving = tracks.iter().filter(|t| t.motion().norm() > STILL_PX);
    let offsets_px = moving.filter(|t| t.before.is_some() && t.after.is_some()).filter_map(|t| {
        let curve: Trajectory = t.trajectory(FrameTimes::global(times_s), k)?;
        let line = t.earlier + 0.5 * t.motion();
        Some((curve.at(middle_s) - line).norm())
    });
    percentile(offsets_px.collect(), 0.95).unwrap_or(0.0)
}

/// Computes [`Motion::residual_px`] for one frame pair. The residual of a track is half of the difference between its
/// motion and the weighted mean motion of the nearest tracks: the difference halfway in time between the two frames.
/// Returns 0 if no track has enough neighbours.
fn residual(tracks: &[Track]) -> f64 {
    let neighbors = Neighbors::new(tracks.iter().map(|t| t.earlier));
    let missed: Vec<f64> = tracks
        .par_iter()
        .enumerate()
        .filter_map(|(n, track)| {
            let mut near = Vec::new();
            neighbors.each_within(&track.earlier, NEIGHBORHOOD_PX, |m| {
                near.extend((m != n).then_some(m))
            });
            let distance = |m: usize| (tracks[m].earlier - track.earlier).norm();
            near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
            near.truncate(PREDICTING);
            if near.len() < PREDICTING {
                return None;
            }
            // Adding one pixel keeps a very near track from deciding the mean alone.
            let weight = |m: usize| 1.0 / (distance(m) + 1.0);
            let sum: f64 = near.iter().map(|&m| weight(m)).sum();
            let mean: Vector2<f64> = near.iter().map(|&m| tracks[m].motion() * weight(m)).sum();
            Some(0.5 * (track.motion() - mean / sum).norm())
        })
        .collect();
    percentile(missed, 0.99).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a track with the given x coordinates in four consecutive frames.
    fn track([before, earlier, later, after]: [f64; 4]) -> Track {
        let at = |x: f64| nalgebra::Point2::new(x, 7.0);
        Track {
            direction: crate::registration::FlowDirection::Both,
            before: Some(at(before)),
            earlier: at(earlier),
            later: at(later),
            after: Some(at(after)),
            deformation: nalgebra::Matrix2::identity(),
            residual: 0.0,
            forward_backward_error_px: 0.0,
        }
    }

    /// With a second difference of 4 px, the midpoint of a trajectory is 0.5 px away from the chord.
    #[test]
    fn curvature_is_measured_on_what_moves() {
        let times_s = [0.0, 1.0, 2.0, 3.0];
        let still = track([5.0; 4]);
        let (straight, curved) = (track([0.0, 9.0, 18.0, 27.0]), track([0.0, 9.0, 22.0, 39.0]));
        let of = |moving: &Track| {
            let tracks: Vec<Track> =
                (0..40).map(|k| if k < 4 { moving.clone() } else { still.clone() }).collect();
            curvature(&tracks, &times_s, 1)
        };
        assert!((of(&curved) - 0.5).abs() < 1e-9, "{}", of(&curved));
        assert!(of(&straight) < 1e-9);
        assert_eq!(of(&still), 0.0);
    }

    #[test]
    fn pairs_are_spread_over_the_recording() {
        assert!(spread(0).is_empty() && spread(1).is_empty());
        assert_eq!(spread(2), [0]);
        assert_eq!(spread(3), [0, 1]);
        assert_eq!(spread(31), [0, 14, 29]);
    }
}
