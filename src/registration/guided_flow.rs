//! Second attempts to track lost points and outliers, with initial guesses from their neighbours' motion; and
//! the extension of tracks to the frames before and after.

use super::consensus::{Support, consensus, innovations};
use super::flow::{Start, flow_over};
use super::rotating_patches::affine_matches;
use super::{AffineStart, Frame, Match, Neighbors, RegistrationOptions};
use nalgebra::{Matrix2, Point2, Vector2};

/// Numbers of pyramid levels, counted from the finest, on which a point is tracked forward and backward if the
/// motion prior gives its initial position.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Number of attempts with the motion prior. The matches of each attempt improve the prior for the next.
const PRIOR_ROUNDS: usize = 2;
/// Number of nearest neighbours whose median displacement is predicted. Up to two of five may be wrong.
const MEDIAN_OF: usize = 5;
/// Radius around a point in which neighbours are used, pixels.
const PRIOR_RADIUS_PX: f64 = 40.0;
/// Distance of two initial guesses below which they are expected to lead to the same result, pixels.
const SAME_GUESS_PX: f64 = 1.0;
/// Numbers of pyramid levels, the finest ones, for tracking forward and backward, when a track is extended to
/// a further frame. The track's last motion gives a close initial guess, so that coarse levels aren't needed.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];
/// Constant part of the maximum change of a track's motion from one frame to the next, pixels.
/// [`MAX_MOTION_CHANGE_FRACTION`] of the motion is added. If the neighbours' motion changes in the same way,
/// there is no maximum.
const MAX_MOTION_CHANGE_PX: f64 = 2.0;
/// Part of the maximum change of a track's motion that is proportional to the motion, as a fraction.
const MAX_MOTION_CHANGE_FRACTION: f64 = 0.5;

/// Displacements (motion or disparity, pixels) of tracked features, from which those of nearby features are
/// predicted.
pub(super) struct MotionPrior {
    neighbors: Neighbors,
    displacements: Vec<(Point2<f64>, Vector2<f64>)>,
}

impl MotionPrior {
    /// A prior from (position, displacement) pairs, pixels. Without pairs, it predicts nothing.
    pub fn new(displacements: impl Iterator<Item = (Point2<f64>, Vector2<f64>)>) -> Self {
        let displacements: Vec<_> = displacements.collect();
        Self { neighbors: Neighbors::new(displacements.iter().map(|(p, _)| *p)), displacements }
    }

    /// The component-wise median of the displacements, pixels, at the nearest positions within
    /// [`PRIOR_RADIUS_PX`], at most five. `None` if there is no position within it.
    pub fn predict(&self, p: &Point2<f64>) -> Option<Vector2<f64>> {
        let near = self.neighbors.nearest(p, MEDIAN_OF, PRIOR_RADIUS_PX);
        let median = |axis: usize| {
            let mut values: Vec<f64> =
                near.iter().map(|&k| self.displacements[k].1[axis]).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Some(Vector2::new(median(0)?, median(1)?))
    }
}

/// Points that are tracked again from other initial guesses.
pub(super) struct Retries<'a> {
    pub frames: [&'a Frame; 2],
    /// The points with their original initial guesses.
    pub starts: &'a [Start],
    /// Numbers of pyramid levels, the finest ones, for tracking forward and backward.
    pub levels: [usize; 2],
    pub options: &'a RegistrationOptions,
    /// The last guess tried for each point.
    tried: Vec<Option<Point2<f64>>>,
}

impl<'a> Retries<'a> {
    pub fn new(
        frames: [&'a Frame; 2],
        starts: &'a [Start],
        levels: [usize; 2],
        options: &'a RegistrationOptions,
    ) -> Self {
        Self { frames, starts, levels, options, tried: vec![None; starts.len()] }
    }

    /// Tracks points again from new guesses, given as (index, guess). If the new match has a smaller
    /// residual, it replaces the point's match in `matches`.
    pub fn track(
        &mut self,
        guesses: impl Iterator<Item = (usize, Point2<f64>)>,
        matches: &mut [Option<Match>],
    ) {
        let is_new = |(k, guess): &(usize, Point2<f64>)| {
            let before = self.tried[*k].replace(*guess);
            before.is_none_or(|before| (guess - before).norm() > SAME_GUESS_PX)
        };
        let guesses: Vec<(usize, Point2<f64>)> = guesses.filter(is_new).collect();
        let starts: Vec<Start> = guesses.iter().map(|&(k, p)| (self.starts[k].0, p)).collect();
        let found = flow_over(self.frames, &starts, self.levels, self.options);
        for ((k, _), found) in guesses.into_iter().zip(found) {
            if let Some(found) = found
                && matches[k].is_none_or(|first| found.residual < first.residual)
            {
                matches[k] = Some(found);
            }
        }
    }
}

/// Tracks lost points and outliers again, from initial guesses that are predicted by their neighbours.
/// `matches` are in the order of `starts` and are updated.
pub(super) fn guided_flow(
    frames: [&Frame; 2],
    starts: &[Start],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let mut retries = Retries::new(frames, starts, PRIOR_LEVELS, options);
    for _ in 0..PRIOR_ROUNDS {
        let innovations = innovations(starts, matches);
        let support = consensus(&innovations, options);
        let is_consistent = |k: &usize| support[*k].is_some_and(|s| s != Support::Differs);
        let (trusted, others): (Vec<_>, Vec<_>) = (0..starts.len()).partition(is_consistent);
        let trusted = trusted.into_iter().filter_map(|k| innovations[k]);
        let prior = MotionPrior::new(trusted.map(|moved| (moved.at, moved.motion)));
        let predicted = |k: usize| {
            let (from, guess) = starts[k];
            Some((k, guess + prior.predict(&from)?))
        };
        retries.track(others.into_iter().filter_map(predicted), matches);
    }
}

/// Extends tracks to one more frame. Returns each track's position in the target; `None` if it is lost, or if
/// its motion changes much and differently from its neighbours'. `tracks` has initial guesses at constant
/// motion.
///
/// Where a swinging body reverses, its motion may change by 20 px from frame to frame. Only the comparison
/// with neighbours distinguishes this from a mismatch.
pub(super) fn extensions(
    frames: [&Frame; 2],
    tracks: &[AffineStart],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let starts: Vec<Start> = tracks.iter().map(|t| (t.from, t.guess)).collect();
    let mut matches = flow_over(frames, &starts, EXTENSION_LEVELS, options);
    // All levels are searched, since changes of motion may be large.
    let levels = [options.levels, PRIOR_LEVELS[1]];
    let lost: Vec<usize> = (0..starts.len()).filter(|&k| matches[k].is_none()).collect();
    let guesses = lost.into_iter().map(|k| (k, starts[k].1));
    Retries::new(frames, &starts, levels, options).track(guesses, &mut matches);
    guided_flow(frames, &starts, &mut matches, options);
    let is_rotating = |k: &usize| tracks[*k].deformation != Matrix2::identity();
    let rotating: Vec<usize> = (0..tracks.len()).filter(is_rotating).collect();
    let rotating_tracks: Vec<AffineStart> = rotating.iter().map(|&k| tracks[k]).collect();
    for (k, found) in rotating.into_iter().zip(affine_matches(frames, &rotating_tracks, options)) {
        matches[k] = found;
    }
    let support = consensus(&innovations(&starts, &matches), options);
    let is_checked = options.consistency().support > 0;
    let position = |k: usize| {
        let ((from, guess), matched) = (starts[k], matches[k]?);
        let limit = MAX_MOTION_CHANGE_PX + MAX_MOTION_CHANGE_FRACTION * (guess - from).norm();
        let agrees = is_checked && support[k] == Some(Support::Agrees);
        (agrees || (matched.target - guess).norm() <= limit).then_some(matched.target)
    };
    (0..starts.len()).map(position).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_the_nearest_is_not_moved_by_a_wrong_one() {
        let mut displacements: Vec<_> = (0..6)
            .map(|k| (Point2::new(f64::from(k), 0.0), Vector2::new(7.0, f64::from(k))))
            .collect();
        displacements[1].1 = Vector2::new(-90.0, 400.0);
        let prior = MotionPrior::new(displacements.into_iter());
        assert_eq!(prior.predict(&Point2::new(0.4, 0.0)), Some(Vector2::new(7.0, 3.0)));
        assert_eq!(prior.predict(&Point2::new(0.0, 50.0)), None);
        assert_eq!(MotionPrior::new(std::iter::empty()).predict(&Point2::origin()), None);
    }
}
