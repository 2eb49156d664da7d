//! Beyond the paper: features that turn, or that jump too far for the tracker.
//!
//! A tracker's window only translates, and it looks near its guess. What spins by 30 degrees from frame to frame,
//! or moves past its surroundings by 50 pixels, is lost as a whole, so that no neighbour can tell where to look.
//! Here lost corners are matched to the other frame's corners by descriptors that don't depend on their
//! direction. Matches count that agree with each other on one motion. They and the corners
//! around them are then tracked by windows that are turned alike.

use super::affine::{AffineRefiner, Deformed};
use super::oriented::Oriented;
use super::pyramid::Level;
use super::{AffineOptions, Frame, Match, Neighbors, RegistrationOptions};
use crate::simd::{F32x8, multiversion};
use nalgebra::{Matrix2, Point2, Rotation2};
use rayon::prelude::*;

/// Maximum motion, as a fraction of the image's longer side. Larger: time, and wrong matches; smaller: fast
/// things stay lost.
const MAX_MOTION: f64 = 0.1;
/// Largest ratio of the squared distances of the best and the second best descriptor. Larger: repeated patterns
/// match at random; smaller: fewer matches.
const MAX_RATIO: f32 = 0.7;
/// Matches within this distance, pixels, tell about each other. Larger: other surfaces do; smaller: too few.
const SUPPORT_RADIUS_PX: f64 = 40.0;
/// How far two matches of one motion may differ, pixels, and in addition as a fraction of their distance.
/// Larger: wrong matches agree by chance; smaller: tilting surfaces don't.
const SUPPORT_PX: f64 = 2.0;
const SUPPORT_SHARE: f64 = 0.2;
/// Number of matches that must agree with one. Larger: small things stay lost; smaller: chance decides.
const MIN_SUPPORT: usize = 3;
/// Number of nearest turned features whose motion is tried for a lost corner. Larger: time; smaller: the one
/// motion tried may be another surface's.
const GUESSES: usize = 3;
/// Number of times that what was found tells about what is still lost. Larger: time for few more.
const ROUNDS: usize = 3;
/// Bounds on a window's change of area. Larger: windows collapse to a line; smaller: real foreshortening fails.
const MAX_AREA_RATIO: f64 = 2.0;
/// Largest difference of the two windows relative to their contrast. Larger: plain windows match anything; smaller:
/// noise loses tracks.
const MAX_UNEXPLAINED: f64 = 0.35;

/// The window of the tracking: smaller than where it refines a translation, because bodies that turn are small.
fn window() -> AffineOptions {
    AffineOptions { radius_px: 8, iterations: 12, max_shift_px: 5.0, ..AffineOptions::default() }
}

/// A track's end, and the guess of it in the next frame; pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Onward {
    pub from: Point2<f64>,
    pub guess: Point2<f64>,
    /// The linear part of the motion: the identity where the window only translated.
    pub deformation: Matrix2<f64>,
}

/// A local motion: a point, where it goes, and how its surroundings are deformed.
#[derive(Clone, Copy)]
struct Turn {
    source: Point2<f64>,
    target: Point2<f64>,
    deformation: Matrix2<f64>,
}

impl Turn {
    /// Where the motion takes another point.
    fn of(&self, p: &Point2<f64>) -> Point2<f64> {
        self.target + self.deformation * (p - self.source)
    }
}

/// Seeks the corners that have no match again, as features that may turn. `corners` are the source's, in the order
/// of `matches`.
pub(super) fn turned_flow(
    [source, target]: [&Frame; 2],
    corners: &[Point2<f64>],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let mut lost: Vec<usize> = (0..corners.len()).filter(|&k| matches[k].is_none()).collect();
    let mut turns = agreeing(&seeds([source, target], corners, &lost, matches, options));
    for _ in 0..ROUNDS {
        if turns.is_empty() || lost.is_empty() {
            break;
        }
        let near = Neighbors::new(turns.iter().map(|t| t.source));
        let found: Vec<Option<Match>> = lost
            .par_iter()
            .map_init(
                || AffineRefiner::new(&window()),
                |refiner, &k| {
                    tracked([source, target], &corners[k], (&turns, &near), refiner, options)
                },
            )
            .collect();
        turns = found.iter().flatten().map(turn_of).collect();
        for (k, found) in lost.iter().zip(found) {
            matches[*k] = found;
        }
        lost.retain(|&k| matches[k].is_none());
    }
}

fn turn_of(m: &Match) -> Turn {
    Turn { source: m.source, target: m.target, deformation: m.deformation }
}

/// The lost corners whose descriptor has one counterpart, among the target's corners that nothing was tracked to.
fn seeds(
    [source, target]: [&Frame; 2],
    corners: &[Point2<f64>],
    lost: &[usize],
    matches: &[Option<Match>],
    options: &RegistrationOptions,
) -> Vec<Turn> {
    let size = source.pyramid.width().max(source.pyramid.height());
    let reach = MAX_MOTION * size as f64;
    let taken = Neighbors::new(matches.iter().flatten().map(|m| m.target));
    let lost_at = Neighbors::new(lost.iter().map(|&k| corners[k]));
    let free: Vec<Point2<f64>> = (target.corners(options).iter())
        .filter(|p| !taken.any_within(p, options.corners.min_distance_px))
        .filter(|p| lost_at.any_within(p, reach))
        .copied()
        .collect();
    let lost: Vec<Point2<f64>> = lost.iter().map(|&k| corners[k]).collect();
    let [from, to] =
        [(source, &lost), (target, &free)].map(|(frame, points)| described(frame, points));
    let near = Neighbors::new(free.iter().copied());
    // The best of each lost corner, and the best of those for each free corner.
    let best: Vec<Option<(usize, f32)>> = lost
        .par_iter()
        .zip(&from)
        .map(|(p, d)| best_of(p, d.as_ref()?, (&to, &near), reach))
        .collect();
    let mut best_of_free = vec![(f32::INFINITY, 0); free.len()];
    for (k, best) in best.iter().enumerate() {
        if let Some((n, distance)) = *best
            && distance < best_of_free[n].0
        {
            best_of_free[n] = (distance, k);
        }
    }
    let mutual = |(k, best): (usize, &Option<(usize, f32)>)| {
        let (n, _) = (*best)?;
        let angle = to[n].as_ref()?.angle - from[k].as_ref()?.angle;
        let deformation = *Rotation2::new(f64::from(angle)).matrix();
        (best_of_free[n].1 == k).then(|| Turn { source: lost[k], target: free[n], deformation })
    };
    best.iter().enumerate().filter_map(mutual).collect()
}

/// The descriptors of points of a frame.
fn described(frame: &Frame, points: &[Point2<f64>]) -> Vec<Option<Oriented>> {
    if points.is_empty() {
        return Vec::new();
    }
    let gradients = frame.gradients();
    points.par_iter().map(|p| Oriented::new(gradients, p)).collect()
}

/// The candidate that is like a corner, if no other is nearly as like it.
fn best_of(
    p: &Point2<f64>,
    own: &Oriented,
    (described, near): (&[Option<Oriented>], &Neighbors),
    reach: f64,
) -> Option<(usize, f32)> {
    let [mut best, mut second] = [(usize::MAX, f32::INFINITY); 2];
    near.each_within(p, reach, |n| {
        let Some(other) = &described[n] else { return };
        let distance = own.distance(other);
        if distance < best.1 {
            [best, second] = [(n, distance), best];
        } else if distance < second.1 {
            second = (n, distance);
        }
    });
    (best.1 < MAX_RATIO * second.1).then_some(best)
}

/// Those that agree with enough others on one motion.
fn agreeing(turns: &[Turn]) -> Vec<Turn> {
    let near = Neighbors::new(turns.iter().map(|t| t.source));
    let agrees = |a: &Turn, b: &Turn| {
        let apart = (b.source - a.source).norm();
        (a.of(&b.source) - b.target).norm() <= SUPPORT_PX + SUPPORT_SHARE * apart
    };
    let supported = |k: &usize| {
        let own = &turns[*k];
        let alike = |n: usize| n != *k && agrees(own, &turns[n]);
        near.at_least_within(&own.source, SUPPORT_RADIUS_PX, MIN_SUPPORT, alike)
    };
    (0..turns.len()).filter(supported).map(|k| turns[k]).collect()
}

/// A lost corner tracked as the nearest turned features move; the best of them.
fn tracked(
    frames: [&Frame; 2],
    corner: &Point2<f64>,
    (turns, near): (&[Turn], &Neighbors),
    refiner: &mut AffineRefiner,
    options: &RegistrationOptions,
) -> Option<Match> {
    let around = near.nearest(corner, GUESSES, SUPPORT_RADIUS_PX);
    let guesses = around.iter().map(|&k| (turns[k].of(corner), turns[k].deformation));
    guesses
        .filter_map(|(guess, deformation)| {
            turned_match(frames, corner, (guess, deformation), refiner, options)
        })
        .min_by(|a, b| a.residual.total_cmp(&b.residual))
}

/// Points tracked from guesses of their places and deformations, and back.
pub(super) fn turned_matches(
    frames: [&Frame; 2],
    starts: &[Onward],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    let of = |refiner: &mut AffineRefiner, start: &Onward| {
        turned_match(frames, &start.from, (start.guess, start.deformation), refiner, options)
    };
    starts.par_iter().map_init(|| AffineRefiner::new(&window()), of).collect()
}

/// A point tracked from a guess of its place and deformation, and back.
fn turned_match(
    [source, target]: [&Frame; 2],
    corner: &Point2<f64>,
    (guess, deformation): (Point2<f64>, Matrix2<f64>),
    refiner: &mut AffineRefiner,
    options: &RegistrationOptions,
) -> Option<Match> {
    let levels = [&source.pyramid.levels()[0], &target.pyramid.levels()[0]];
    let there = refine(refiner, levels, (*corner, guess), deformation)?;
    let area = there.deformation.determinant();
    let is_inside = |v: f64, size: usize| v >= 0.0 && v <= size as f64;
    let inside = is_inside(there.position.x, levels[1].width)
        && is_inside(there.position.y, levels[1].height);
    if !inside || !(1.0 / MAX_AREA_RATIO..MAX_AREA_RATIO).contains(&area) {
        return None;
    }
    if there.residual > options.klt.max_residual || there.unexplained > MAX_UNEXPLAINED {
        return None;
    }
    let inverse = there.deformation.try_inverse()?;
    let back = refine(refiner, [levels[1], levels[0]], (there.position, *corner), inverse)?;
    let forward_backward_error_px = (back.position - corner).norm();
    (forward_backward_error_px <= options.max_back_error_px).then_some(Match {
        source: *corner,
        target: there.position,
        deformation: there.deformation,
        residual: there.residual,
        forward_backward_error_px,
    })
}

multiversion! {
    fn refine(
        refiner: &mut AffineRefiner,
        levels: [&Level; 2],
        ends: (Point2<f64>, Point2<f64>),
        deformation: Matrix2<f64>,
    ) -> Option<Deformed> = refine_by::<V>
}

#[inline(always)]
fn refine_by<V: F32x8>(
    refiner: &mut AffineRefiner,
    levels: [&Level; 2],
    (from, guess): (Point2<f64>, Point2<f64>),
    deformation: Matrix2<f64>,
) -> Option<Deformed> {
    refiner.refine::<V>(levels, from, guess, deformation, &window())
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

    /// A disc of radius 45 px before a still wall, turned by an angle and shifted.
    fn frame(angle: f64, shift: Vector2<f64>, options: &RegistrationOptions) -> Frame {
        let value = |k: usize| {
            let p = Vector2::new((k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5);
            let own = Rotation2::new(-angle) * (p - Vector2::repeat(MIDDLE) - shift);
            let seen = if own.norm() < 45.0 { texture(own, 7) } else { 0.7 * texture(p, 3) };
            seen as f32
        };
        Frame::new(Image::from_data(SIDE, SIDE, 1, (0..SIDE * SIDE).map(value).collect()), options)
    }

    /// Of the disc's corners that all are lost: how many are found, and the median error in pixels.
    fn found(angle: f64, shift: Vector2<f64>) -> (usize, usize, f64) {
        let options = RegistrationOptions::default();
        let frames = [frame(0.0, Vector2::zeros(), &options), frame(angle, shift, &options)];
        let middle = Point2::new(MIDDLE, MIDDLE);
        let corners: Vec<Point2<f64>> = (frames[0].corners(&options).iter())
            .filter(|p| (*p - middle).norm() < 38.0)
            .copied()
            .collect();
        let mut matches = vec![None; corners.len()];
        turned_flow([&frames[0], &frames[1]], &corners, &mut matches, &options);
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
        turned_flow([&still, &still], &[], &mut [], &options);
        // Another disc before another wall.
        let other: Vec<f32> = (0..SIDE * SIDE)
            .map(|k| texture(Vector2::new((k % SIDE) as f64, (k / SIDE) as f64), 99) as f32)
            .collect();
        let other = Frame::new(Image::from_data(SIDE, SIDE, 1, other), &options);
        let corners = still.corners(&options).to_vec();
        let mut matches = vec![None; corners.len()];
        turned_flow([&still, &other], &corners, &mut matches, &options);
        let found = matches.iter().flatten().count();
        assert!(100 * found < corners.len(), "{found} of {}", corners.len());
    }
}
