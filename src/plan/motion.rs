//! How things move in the images, from a few frame pairs of every camera.

use super::percentile;
use crate::capture::CaptureError;
use crate::interpolation::largest_change;
use crate::progress::Reporter;
use crate::raster::Image;
use crate::registration::{
    FrameStore, Neighbors, Path, RegistrationOptions, Track, agreeing, temporal_flow,
};
use nalgebra::Vector2;
use rayon::prelude::*;

/// Frame pairs a camera that are looked at: the first, the last, and between.
const PAIRS: usize = 3;

/// A motion counts as seen if so many tracks of one pair move at least as far: fewer are mismatches
/// that agree by chance.
const WITNESSES: usize = 5;

/// Side of the blocks that are looked at for change, pixels. Larger hides small bodies, smaller
/// mistakes noise for change.
const BLOCK: usize = 8;

/// Features that move by less from one frame to the next stand still, pixels: most of most scenes,
/// which would hide how the rest moves.
const STILL_PX: f64 = 0.5;

/// A block changes if its mean difference is over so many times the quietest quarter's: noise
/// differs between light and dark, flat and textured parts, by 2 to 4 times.
const OVER_NOISE: f32 = 6.0;

/// Nor does one change by less than this, values 0..=1: rounding to 8 bits.
const LEAST_CHANGE: f32 = 1.5 / 255.0;

/// The light of a pair whose blocks change by more than this may have changed, values 0..=1, or all of
/// the image moves. Larger: low contrast that moves in such a light is dissolved; smaller: noisy films
/// are registered where they stand still.
pub(super) const MOST_NOISE: f32 = 4.0 / 255.0;

/// How far around a track others foretell its motion, pixels, and how many of them.
const AROUND_PX: f64 = 40.0;
const FORETELLING: usize = 6;

/// What the pairs show; each the largest of all pairs of all cameras. Pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// How far features move from one frame to the next.
    pub largest_px: f64,
    /// How far paths through four frames bend from the line through the middle two, halfway: the
    /// 95th percentile of what moves.
    pub bend_px: f64,
    /// How far a feature, halfway, is from where its neighbours say: the 99th percentile. Outlines
    /// of bodies that move apart show in it.
    pub unevenness_px: f64,
    /// The share of blocks that change by more than noise.
    pub changed_share: f64,
    /// Frame pairs in which no block changes by more than noise, nor any feature moves,
    pub still_pairs: usize,
    /// how much their blocks change all the same, mean of values 0..=1,
    pub still_change: f32,
    /// and how far their features are found to move.
    pub still_px: f64,
    /// Frame pairs that were looked at; 0 where every camera took one frame.
    pub pairs: usize,
}

impl Motion {
    /// Looks at the store's capture.
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
            all.bend_px = all.bend_px.max(pair.bend_px);
            all.unevenness_px = all.unevenness_px.max(pair.unevenness_px);
            all.changed_share = all.changed_share.max(pair.changed_share);
            all.still_pairs += pair.still_pairs;
            all.still_change = all.still_change.max(pair.still_change);
            all.still_px = all.still_px.max(pair.still_px);
            all.pairs += pair.pairs;
            task.advance(1);
        }
        Ok(all)
    }

    fn of_pair(frames: &FrameStore, camera: usize, k: usize) -> Result<Self, CaptureError> {
        let options = frames.options();
        let tracks = temporal_flow(frames, camera, k)?;
        let kept = agreeing(&tracks, options);
        let mut kept = kept.into_iter();
        let tracks: Vec<Track> =
            tracks.into_iter().filter(|_| kept.next().unwrap_or(false)).collect();
        let times_s = &frames.capture().cameras[camera].clock.times_s;
        let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
        let largest_px = largest(&tracks);
        let changed_share = changed_share(&earlier.image, &later.image);
        let change = largest_change(&earlier.image, &later.image);
        let is_still = changed_share == 0.0 && change <= MOST_NOISE && largest_px < STILL_PX;
        Ok(Self {
            largest_px,
            bend_px: bend(&tracks, times_s, k),
            unevenness_px: unevenness(&tracks, options),
            changed_share,
            still_pairs: usize::from(is_still),
            still_change: if is_still { change } else { 0.0 },
            still_px: if is_still { largest_px } else { 0.0 },
            pairs: 1,
        })
    }
}

/// The earlier frames of pairs spread over a film.
fn spread(frames: usize) -> Vec<usize> {
    let pairs = frames.saturating_sub(1);
    let mut found: Vec<usize> = match pairs {
        0 => Vec::new(),
        _ => (0..PAIRS).map(|n| n * (pairs - 1) / (PAIRS - 1)).collect(),
    };
    found.dedup();
    found
}

/// The motion that [`WITNESSES`] tracks have at least; 0 if there are fewer.
fn largest(tracks: &[Track]) -> f64 {
    let mut motions: Vec<f64> = tracks.iter().map(|t| t.motion().norm()).collect();
    motions.sort_by(|a, b| b.total_cmp(a));
    motions.get(WITNESSES - 1).copied().unwrap_or(0.0)
}

fn bend(tracks: &[Track], times_s: &[f64], k: usize) -> f64 {
    let middle_s = 0.5 * (times_s[k] + times_s[k + 1]);
    let moving = tracks.iter().filter(|t| t.motion().norm() > STILL_PX);
    let bends = moving.filter(|t| t.before.is_some() && t.after.is_some()).filter_map(|t| {
        let curve: Path = t.path(times_s, k)?;
        let line = t.earlier + 0.5 * t.motion();
        Some((curve.at(middle_s) - line).norm())
    });
    percentile(bends.collect(), 0.95).unwrap_or(0.0)
}

/// Half of the motion that a track's neighbours don't foretell.
fn unevenness(tracks: &[Track], options: &RegistrationOptions) -> f64 {
    let neighbors = Neighbors::new(tracks.iter().map(|t| t.earlier));
    let radius = AROUND_PX.max(options.support_radius_px);
    let missed: Vec<f64> = tracks
        .par_iter()
        .enumerate()
        .filter_map(|(n, track)| {
            let mut near = neighbors.within(&track.earlier, radius);
            near.retain(|&m| m != n);
            let distance = |m: usize| (tracks[m].earlier - track.earlier).norm();
            near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
            near.truncate(FORETELLING);
            if near.len() < FORETELLING {
                return None;
            }
            // Features stand apart, so no distance is 0; the pixel keeps one from deciding alone.
            let weight = |m: usize| 1.0 / (distance(m) + 1.0);
            let sum: f64 = near.iter().map(|&m| weight(m)).sum();
            let mean: Vector2<f64> = near.iter().map(|&m| tracks[m].motion() * weight(m)).sum();
            Some(0.5 * (track.motion() - mean / sum).norm())
        })
        .collect();
    percentile(missed, 0.99).unwrap_or(0.0)
}

fn changed_share(a: &Image, b: &Image) -> f64 {
    let (_, changed) = changed_blocks(a, b);
    let count = changed.iter().filter(|c| **c).count();
    if count == 0 { 0.0 } else { count as f64 / changed.len() as f64 }
}

/// The pixels of the blocks that change by more than noise, row by row.
pub(crate) fn changed_pixels(a: &Image, b: &Image) -> Vec<bool> {
    let (across, changed) = changed_blocks(a, b);
    let (w, h) = (a.width(), a.height());
    let of = |k: usize| {
        let (column, row) = (k % w / BLOCK, k / w / BLOCK);
        column < across && changed.get(row * across + column).is_some_and(|c| *c)
    };
    (0..w * h).map(of).collect()
}

/// The number of blocks a row, and whether each changes by more than noise.
fn changed_blocks(a: &Image, b: &Image) -> (usize, Vec<bool>) {
    let (a, b) = (a.to_gray(), b.to_gray());
    let (across, down) = (a.width() / BLOCK, a.height() / BLOCK);
    let mut blocks = vec![0.0_f32; across * down];
    for y in 0..down * BLOCK {
        let rows = a.row(y).iter().zip(b.row(y));
        for (x, (a, b)) in rows.enumerate().take(across * BLOCK) {
            blocks[y / BLOCK * across + x / BLOCK] += (a - b).abs() / (BLOCK * BLOCK) as f32;
        }
    }
    let mut sorted = blocks.clone();
    sorted.sort_by(f32::total_cmp);
    let Some(quiet) = sorted.get(sorted.len() / 4) else { return (across, Vec::new()) };
    let limit = (OVER_NOISE * quiet).max(LEAST_CHANGE);
    (across, blocks.iter().map(|d| *d > limit).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// A feature in frames 0 to 3, and where it is in each.
    fn track([before, earlier, later, after]: [f64; 4]) -> Track {
        let at = |x: f64| nalgebra::Point2::new(x, 7.0);
        Track {
            run: crate::registration::Run::Both,
            before: Some(at(before)),
            earlier: at(earlier),
            later: at(later),
            after: Some(at(after)),
            residual: 0.0,
            back_error_px: 0.0,
        }
    }

    /// Halfway, a path of a second difference of 4 px is half a pixel off the line.
    #[test]
    fn bends_are_told_from_what_moves() {
        let times_s = [0.0, 1.0, 2.0, 3.0];
        let still = track([5.0; 4]);
        let (straight, bent) = (track([0.0, 9.0, 18.0, 27.0]), track([0.0, 9.0, 22.0, 39.0]));
        let of = |moving: &Track| {
            let tracks: Vec<Track> =
                (0..40).map(|k| if k < 4 { moving.clone() } else { still.clone() }).collect();
            bend(&tracks, &times_s, 1)
        };
        assert!((of(&bent) - 0.5).abs() < 1e-9, "{}", of(&bent));
        assert!(of(&straight) < 1e-9);
        assert_eq!(of(&still), 0.0);
    }

    #[test]
    fn pairs_are_spread_over_the_film() {
        assert!(spread(0).is_empty() && spread(1).is_empty());
        assert_eq!(spread(2), [0]);
        assert_eq!(spread(3), [0, 1]);
        assert_eq!(spread(31), [0, 14, 29]);
    }

    #[test]
    fn noise_is_no_change_and_a_small_body_is() {
        let mut random = Random::new(7);
        let mut still = || {
            let data = (0..160 * 120).map(|k| {
                let edge = if (k % 160) / 20 % 2 == 0 { 0.3 } else { 0.7 };
                edge + 0.05 * random.signed() as f32
            });
            Image::from_data(160, 120, 1, data.collect())
        };
        let (a, mut b) = (still(), still());
        assert_eq!(changed_share(&a, &b), 0.0);
        for y in 40..56 {
            for x in 64..80 {
                b.data_mut()[y * 160 + x] = 1.0;
            }
        }
        assert!(changed_share(&a, &b) > 0.0);
        let tiny = Image::filled(3, 3, 3, 0.5);
        assert_eq!(changed_share(&tiny, &tiny), 0.0);
    }
}
