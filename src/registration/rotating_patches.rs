//! Beyond the paper: features that rotate, or that move too far for the tracker.
//!
//! The tracker's window only translates, and its initial guess must be close. If a body rotates by 30 degrees
//! per frame, or moves by 50 pixels relative to its surroundings, all its features are lost, so that no
//! neighbour predicts its motion. Here its corners are matched to the other frame's corners by
//! rotation-invariant descriptors. Matches that agree on one motion give the initial guesses from which the
//! corners around them are tracked with affinely deforming windows.

use super::corners::MIN_DISTANCE_PX;
use super::sift::{SiftDescriptor, descriptor, squared_distance};
use super::{AffineStart, AffineTracker, Frame, Match, Neighbors, RegistrationOptions};
use nalgebra::{Point2, Rotation2};
use rayon::prelude::*;

/// Maximum motion between two frames, as a fraction of the image's longer side.
const MAX_MOTION: f64 = 0.1;
/// Maximum ratio of the squared distances to the best and to the second best descriptor.
const MAX_RATIO: f32 = 0.7;
/// Radius around a match within which others must agree with it, pixels.
const SUPPORT_RADIUS_PX: f64 = 40.0;
/// Constant part of the maximum difference between a match's target and the prediction by another match, at
/// which the two agree, pixels. [`SUPPORT_FRACTION`] of the distance of the two is added.
const SUPPORT_PX: f64 = 2.0;
const SUPPORT_FRACTION: f64 = 0.2;
/// Minimum number of other matches that must agree with a match.
const MIN_SUPPORT: usize = 3;
/// Number of nearest rotating patches whose motion is tried for a lost corner.
const GUESSES: usize = 3;
/// Number of propagation rounds: new matches give initial guesses for the next round.
const ROUNDS: usize = 3;
/// Maximum change of a window's area; the minimum is its inverse.
const MAX_AREA_RATIO: f64 = 2.0;
/// Maximum residual of a match relative to its contrast, the field `unexplained` of the tracker's result.
const MAX_UNEXPLAINED: f64 = 0.35;

impl AffineStart {
    /// The start of tracking another window, around `from`. Its initial guess is predicted by this window's
    /// affine motion.
    fn moving_along(&self, from: &Point2<f64>) -> Self {
        let guess = self.guess + self.deformation * (from - self.from);
        Self { from: *from, guess, ..*self }
    }
}

/// Matches the corners without a match as patches that may rotate, and adds the results to `matches`.
/// `corners` are the source's, in the order of `matches`.
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

/// Starts from the descriptors: mutual best matches between the lost corners and the target's corners without
/// a match.
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
    // The free corner with the nearest descriptor, and the squared distance, if it passes the ratio test.
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
    // For each free corner, the best of the lost corners.
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

/// Those of the motions with which at least [`MIN_SUPPORT`] others agree.
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

/// Tracks affinely deforming windows from initial guesses, forward and backward. `None` under the conditions
/// of [`affine_match`].
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

/// Tracks an affinely deforming window forward and backward. `None` if it is lost or exceeds a threshold.
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

    /// Smooth noise with cells of 6 px.
    fn texture(p: Vector2<f64>, seed: u64) -> f64 {
        let q = p / 6.0;
        let (x, y) = (q.x.floor(), q.y.floor());
        let fade = |t: f64| t * t * (3.0 - 2.0 * t);
        let (u, v) = (fade(q.x - x), fade(q.y - y));
        let n = |dx: i64, dy: i64| noise(x as i64 + dx, y as i64 + dy, seed);
        let top = n(0, 0) * (1.0 - u) + n(1, 0) * u;
        top * (1.0 - v) + (n(0, 1) * (1.0 - u) + n(1, 1) * u) * v
    }

    /// A disc of radius 45 px, rotated by `angle` and shifted, in front of a static wall.
    fn frame(angle: f64, shift: Vector2<f64>, options: &RegistrationOptions) -> Frame {
        let value = |k: usize| {
            let p = Vector2::new((k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5);
            let own = Rotation2::new(-angle) * (p - Vector2::repeat(MIDDLE) - shift);
            let seen = if own.norm() < 45.0 { texture(own, 7) } else { 0.7 * texture(p, 3) };
            seen as f32
        };
        Frame::new(Image::from_data(SIDE, SIDE, 1, (0..SIDE * SIDE).map(value).collect()), options)
    }

    /// Matches the disc's corners as if all were lost. Returns their number, the number that is found, and
    /// the median error in pixels.
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
        // The other image shows another disc in front of another wall.
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
