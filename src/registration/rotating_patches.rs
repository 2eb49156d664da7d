//! Beyond the paper: matches features that rotate, or that move too far for the KLT tracker.
//!
//! The window of the KLT tracker only translates, and its initial guess must be close to the result. If a body
//! rotates by 30 degrees per frame, or moves by 50 pixels relative to its surroundings, all features on the body
//! are lost. Then no neighbour can predict their motion. This module matches the lost corners to corners of the
//! other frame by rotation-invariant descriptors. Matches that agree on one affine motion predict the motion of the
//! corners around them. From these predictions, the corners are tracked with affinely deforming windows.

use super::corners::MIN_DISTANCE_PX;
use super::sift::{SiftDescriptor, descriptor, squared_distance};
use super::{AffineStart, AffineTracker, Frame, Match, Neighbors, RegistrationOptions};
use nalgebra::{Point2, Rotation2};
use rayon::prelude::*;

/// Maximum motion of a matched corner between two frames, as a fraction of the image's longer side.
const MAX_MOTION: f64 = 0.1;
/// Maximum ratio of two squared descriptor distances: to the nearest descriptor and to the second nearest (Lowe's
/// ratio test).
const MAX_RATIO: f32 = 0.7;
/// Radius around a match, in pixels, within which other matches must agree with the match.
const SUPPORT_RADIUS_PX: f64 = 40.0;
/// Constant term, in pixels, of the maximum prediction error of two matches that agree. The prediction error is the
/// distance between a match's target and the target that the other match's affine motion predicts for it. The maximum
/// is this value plus [`SUPPORT_FRACTION`] times the distance between the two matches.
const SUPPORT_PX: f64 = 2.0;
const SUPPORT_FRACTION: f64 = 0.2;
/// Minimum number of other matches that must agree with a match.
const MIN_SUPPORT: usize = 3;
/// Number of rotating patches near a lost corner whose motions are tried as initial guesses for the corner.
const GUESSES: usize = 3;
/// Maximum number of rounds in which motion is propagated to lost corners. The matches of one round give the
/// initial guesses of the next round.
const ROUNDS: usize = 3;
/// Maximum ratio of a window's area in the target to its area in the source. The minimum ratio is the inverse.
const MAX_AREA_RATIO: f64 = 2.0;
/// Maximum residual of a match, relative to the contrast of its window ([`super::Deformed::unexplained`]).
const MAX_UNEXPLAINED: f64 = 0.35;

impl AffineStart {
    /// Returns the start for tracking another window, which is around `from`. The affine motion of `self` predicts the
    /// initial guess.
    fn moving_along(&self, from: &Point2<f64>) -> Self {
        let guess = self.guess + self.deformation * (from - self.from);
        Self { from: *from, guess, ..*self }
    }
}

/// Matches the corners that have no match yet, as patches that may rotate. Adds the new matches to `matches`.
/// `corners` are the corners of the source frame, in the order of `matches`.
pub(super) fn match_rotating_patches(
    frames: [&Frame; 2],
    corners: &[Point2<f64>],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let mut lost: Vec<usize> = (0..corners.len()).filter(|&k| matches[k].is_none()).collect();
    let lost_corners: Vec<Point2<f64>> = lost.iter().map(|&k| corners[k]).collect();
    let mut motions = agreeing(&seeds(frames, &lost_corners, matches, options));
    for _ in 0..ROUNDS {
        if motions.is_empty() || lost.is_empty() {
            break;
        }
        let near = Neighbors::new(motions.iter().map(|m| m.from));
        // The motions of the nearest rotating patches are tried, and the match of the smallest residual is
        // taken.
        let track = |tracker: &mut AffineTracker, k: &usize| {
            let around = near.nearest(&corners[*k], GUESSES, SUPPORT_RADIUS_PX).into_iter();
            let starts = around.map(|n| motions[n].moving_along(&corners[*k]));
            let found = starts.filter_map(|start| affine_match(frames, &start, tracker, options));
            found.min_by(|a, b| a.residual.total_cmp(&b.residual))
        };
        let found: Vec<Option<Match>> =
            lost.par_iter().map_init(AffineTracker::default, track).collect();
        motions = found.iter().flatten().map(motion_of).collect();
        for (k, found) in lost.iter().zip(found) {
            matches[*k] = found;
        }
        lost.retain(|&k| matches[k].is_none());
    }
}

fn motion_of(m: &Match) -> AffineStart {
    AffineStart { from: m.source, guess: m.target, deformation: m.deformation }
}

/// Returns starts for the affine tracker. Each is a pair of a lost corner of the source and an unmatched corner of
/// the target whose descriptors are mutual nearest neighbours.
fn seeds(
    [source, target]: [&Frame; 2],
    lost: &[Point2<f64>],
    matches: &[Option<Match>],
    options: &RegistrationOptions,
) -> Vec<AffineStart> {
    let size = source.pyramid.width().max(source.pyramid.height());
    let reach = MAX_MOTION * size as f64;
    let taken = Neighbors::new(matches.iter().flatten().map(|m| m.target));
    let lost_at = Neighbors::new(lost.iter().copied());
    let free: Vec<Point2<f64>> = (target.corners(options).iter())
        .filter(|p| !taken.any_within(p, MIN_DISTANCE_PX))
        .filter(|p| lost_at.any_within(p, reach))
        .copied()
        .collect();
    let describe = |frame: &Frame, points: &[Point2<f64>]| -> Vec<Option<SiftDescriptor>> {
        points.par_iter().map(|p| descriptor(frame.gradients(), p)).collect()
    };
    let (from, to) = (describe(source, lost), describe(target, &free));
    let near = Neighbors::new(free.iter().copied());
    // Returns the index of the unmatched target corner with the nearest descriptor, and the squared distance of the
    // two descriptors. `None` if the corner has no descriptor or fails the ratio test.
    let best_of = |(p, own): (&Point2<f64>, &Option<SiftDescriptor>)| {
        let own = own.as_ref()?;
        let [mut best, mut second] = [(usize::MAX, f32::INFINITY); 2];
        near.each_within(p, reach, |n| {
            let Some(other) = &to[n] else { return };
            let distance = squared_distance(own, other);
            if distance < best.1 {
                [best, second] = [(n, distance), best];
            } else if distance < second.1 {
                second = (n, distance);
            }
        });
        (best.1 < MAX_RATIO * second.1).then_some(best)
    };
    let best: Vec<Option<(usize, f32)>> = lost.par_iter().zip(&from).map(best_of).collect();
    // For each unmatched target corner: the smallest squared descriptor distance to a lost corner, and the index of
    // that lost corner.
    let mut best_of_free = vec![(f32::INFINITY, 0); free.len()];
    for (k, best) in best.iter().enumerate() {
        if let Some((n, distance)) = *best
            && distance < best_of_free[n].0
        {
            best_of_free[n] = (distance, k);
        }
    }
    let mutual = |k: usize| {
        let (n, _) = best[k]?;
        let angle = to[n].as_ref()?.angle - from[k].as_ref()?.angle;
        let deformation = *Rotation2::new(f64::from(angle)).matrix();
        let motion = AffineStart { from: lost[k], guess: free[n], deformation };
        (best_of_free[n].1 == k).then_some(motion)
    };
    (0..lost.len()).filter_map(mutual).collect()
}

/// Returns the motions that agree with at least [`MIN_SUPPORT`] other motions within [`SUPPORT_RADIUS_PX`]. A motion
/// agrees with another if it predicts the target of the other to within the limit of [`SUPPORT_PX`].
fn agreeing(motions: &[AffineStart]) -> Vec<AffineStart> {
    let near = Neighbors::new(motions.iter().map(|m| m.from));
    let supported = |k: &usize| {
        let own = &motions[*k];
        let is_alike = |n: usize| {
            let (other, apart) = (&motions[n], (motions[n].from - own.from).norm());
            let difference = (own.moving_along(&other.from).guess - other.guess).norm();
            n != *k && difference <= SUPPORT_PX + SUPPORT_FRACTION * apart
        };
        near.at_least_within(&own.from, SUPPORT_RADIUS_PX, MIN_SUPPORT, is_alike)
    };
    (0..motions.len()).filter(supported).map(|k| motions[k]).collect()
}

/// Tracks affinely deforming windows forward and backward, each from its initial guess. Returns one entry per
/// start, which is `None` under the conditions of [`affine_match`].
pub(super) fn affine_matches(
    frames: [&Frame; 2],
    starts: &[AffineStart],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    let tracked = |tracker: &mut AffineTracker, start: &AffineStart| {
        affine_match(frames, start, tracker, options)
    };
    starts.par_iter().map_init(AffineTracker::default, tracked).collect()
}

/// Tracks an affinely deforming window forward and backward. Returns `None` if the window is lost or leaves the
/// target image, or if its change of area, its residual or its forward–backward error exceeds a threshold.
fn affine_match(
    [source, target]: [&Frame; 2],
    start: &AffineStart,
    tracker: &mut AffineTracker,
    options: &RegistrationOptions,
) -> Option<Match> {
    let [a, b] = [&source.pyramid, &target.pyramid];
    let there = tracker.track(a, b, start)?;
    let area = there.deformation.determinant();
    let is_inside = |v: f64, size: usize| v >= 0.0 && v <= size as f64;
    let inside = is_inside(there.position.x, b.width()) && is_inside(there.position.y, b.height());
    if !inside || !(1.0 / MAX_AREA_RATIO..MAX_AREA_RATIO).contains(&area) {
        return None;
    }
    let thresholds = options.consistency();
    if there.residual > thresholds.residual || there.unexplained > MAX_UNEXPLAINED {
        return None;
    }
    let deformation = there.deformation.try_inverse()?;
    let back = AffineStart { from: there.position, guess: start.from, deformation };
    let back = tracker.track(b, a, &back)?;
    let forward_backward_error_px = (back.position - start.from).norm();
    (forward_backward_error_px <= thresholds.forward_backward_error_px).then_some(Match {
        source: start.from,
        target: there.position,
        deformation: there.deformation,
        residual: there.residual,
        forward_backward_error_px,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;
    use nalgebra::Vector2;

    const SIDE: usize = 160;
    const MIDDLE: f64 = 80.0;

    fn noise(x: i64, y: i64, seed: u64) -> f64 {
        let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
            ^ seed;
        h = (h ^ (h >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        ((h ^ (h >> 29)) % 1000) as f64 / 1000.0
    }

    /// Returns the value at `p` of smooth noise with cells of 6 px.
    fn texture(p: Vector2<f64>, seed: u64) -> f64 {
        let q = p / 6.0;
        let (x, y) = (q.x.floor(), q.y.floor());
        let fade = |t: f64| t * t * (3.0 - 2.0 * t);
        let (u, v) = (fade(q.x - x), fade(q.y - y));
        let n = |dx: i64, dy: i64| noise(x as i64 + dx, y as i64 + dy, seed);
        let top = n(0, 0) * (1.0 - u) + n(1, 0) * u;
        top * (1.0 - v) + (n(0, 1) * (1.0 - u) + n(1, 1) * u) * v
    }

    /// Renders a textured disc of radius 45 px in front of a static wall. The disc is rotated by `angle` (radians)
    /// and shifted by `shift` (pixels).
    fn frame(angle: f64, shift: Vector2<f64>, options: &RegistrationOptions) -> Frame {
        let value = |k: usize| {
            let p = Vector2::new((k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5);
            let own = Rotation2::new(-angle) * (p - Vector2::repeat(MIDDLE) - shift);
            let seen = if own.norm() < 45.0 { texture(own, 7) } else { 0.7 * texture(p, 3) };
            seen as f32
        };
        Frame::new(Image::from_data(SIDE, SIDE, 1, (0..SIDE * SIDE).map(value).collect()), options)
    }

    /// Matches the disc's corners, all of which start without a match. Returns the number of corners, the number of
    /// matches, and the median error of the matches in pixels.
    fn found(angle: f64, shift: Vector2<f64>) -> (usize, usize, f64) {
        let options = RegistrationOptions::default();
        let frames = [frame(0.0, Vector2::zeros(), &options), frame(angle, shift, &options)];
        let middle = Point2::new(MIDDLE, MIDDLE);
        let corners: Vec<Point2<f64>> = (frames[0].corners(&options).iter())
            .filter(|p| (*p - middle).norm() < 38.0)
            .copied()
            .collect();
        let mut matches = vec![None; corners.len()];
        match_rotating_patches([&frames[0], &frames[1]], &corners, &mut matches, &options);
        let turn = Rotation2::new(angle);
        let error = |m: &Match| (m.target - (middle + shift + turn * (m.source - middle))).norm();
        let mut errors: Vec<f64> = matches.iter().flatten().map(error).collect();
        errors.sort_by(f64::total_cmp);
        (corners.len(), errors.len(), errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN))
    }

    #[test]
    fn what_spins_or_jumps_is_found() {
        for (angle, shift) in [(0.6, [0.0, 0.0]), (-0.9, [4.0, 2.0]), (0.2, [13.0, -8.0])] {
            let (corners, found, median_px) = found(angle, shift.into());
            assert!(corners > 40 && 3 * found > 2 * corners, "{angle}: {found} of {corners}");
            assert!(median_px < 0.1, "{angle}: {median_px}");
        }
    }

    #[test]
    fn nothing_lost_nothing_sought_and_noise_has_no_counterpart() {
        let options = RegistrationOptions::default();
        let still = frame(0.0, Vector2::zeros(), &options);
        match_rotating_patches([&still, &still], &[], &mut [], &options);
        // The other image shows a different texture.
        let other: Vec<f32> = (0..SIDE * SIDE)
            .map(|k| texture(Vector2::new((k % SIDE) as f64, (k / SIDE) as f64), 99) as f32)
            .collect();
        let other = Frame::new(Image::from_data(SIDE, SIDE, 1, other), &options);
        let corners = still.corners(&options).to_vec();
        let mut matches = vec![None; corners.len()];
        match_rotating_patches([&still, &other], &corners, &mut matches, &options);
        let found = matches.iter().flatten().count();
        assert!(100 * found < corners.len(), "{found} of {}", corners.len());
    }
}
