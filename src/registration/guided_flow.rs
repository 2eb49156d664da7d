//! Tracks lost points and outliers a second time, from initial guesses that the motion of their neighbours
//! predicts. Also extends tracks to the frame before and the frame after a frame pair.

use super::consensus::{Support, consensus, innovations};
use super::flow::{Start, flow_over};
use super::rotating_patches::affine_matches;
use super::{AffineStart, Frame, Match, Neighbors, RegistrationOptions};
use nalgebra::{Matrix2, Point2, Vector2};

/// Numbers of pyramid levels for tracking forward and backward, in this order, if the motion prior predicts a point's
/// position. The finest levels are used.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Number of attempts with the motion prior. The matches of each attempt improve the prior for the next.
const PRIOR_ROUNDS: usize = 2;
/// Number of nearest neighbours whose median displacement predicts a point's displacement. Up to two of five neighbours
/// may be wrong.
const MEDIAN_OF: usize = 5;
/// Radius around a point, in pixels, within which features predict the point's displacement.
const PRIOR_RADIUS_PX: f64 = 40.0;
/// Maximum distance between two initial guesses, in pixels, that are expected to lead to the same result. The second
/// guess is then not tried.
const SAME_GUESS_PX: f64 = 1.0;
/// Numbers of pyramid levels for tracking forward and backward, in this order, when a track is extended to a further
/// frame. The finest levels are used. The track's last motion gives a close initial guess, so that coarse levels aren't
/// needed.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];
/// Constant term, in pixels, of the maximum change of a track's motion from one frame interval to the next. The maximum
/// is this value plus [`MAX_MOTION_CHANGE_FRACTION`] times the length of the motion. A track whose motion changes by
/// more is not extended, unless the motion of its neighbours changes in the same way.
const MAX_MOTION_CHANGE_PX: f64 = 2.0;
/// Proportional term of the maximum change of a track's motion from one frame interval to the next, as a fraction
/// of the length of the motion. [`MAX_MOTION_CHANGE_PX`] is added.
const MAX_MOTION_CHANGE_FRACTION: f64 = 0.5;

/// Displacements (motion or disparity, in pixels) of tracked features, which predict the displacements of nearby
/// features.
pub(super) struct MotionPrior {
    neighbors: Neighbors,
    displacements: Vec<(Point2<f64>, Vector2<f64>)>,
}

impl MotionPrior {
    /// Creates a prior from (position, displacement) pairs, in pixels. Without pairs, the prior predicts nothing.
    pub fn new(displacements: impl Iterator<Item = (Point2<f64>, Vector2<f64>)>) -> Self {
        let displacements: Vec<_> = displacements.collect();
        Self { neighbors: Neighbors::new(displacements.iter().map(|(p, _)| *p)), displacements }
    }

    /// Predicts the displacement at `p`, in pixels. The prediction is the component-wise median of the
    /// displacements of the nearest features within [`PRIOR_RADIUS_PX`], at most five. Returns `None` if there is
    /// no feature within this radius.
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

/// A frame pair with the points that are tracked again from other initial guesses.
pub(super) struct Retries<'a> {
    pub frames: [&'a Frame; 2],
    /// The points, each with its original initial guess.
    pub starts: &'a [Start],
    /// Numbers of pyramid levels for tracking forward and backward. The finest levels are used.
    pub levels: [usize; 2],
    pub options: &'a RegistrationOptions,
    /// The last initial guess, in pixels, that [`Self::track`] was given for each point; `None` before the first.
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

    /// Tracks points again from new initial guesses, given as (index into `starts`, position in pixels). A guess within
    /// [`SAME_GUESS_PX`] of the point's last guess is skipped. If the new match has a smaller residual, or if the point
    /// had no match, the new match is written to `matches`.
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

/// Tracks lost points and outliers again, from initial guesses that the motion of their neighbours predicts.
/// Updates `matches`, which are in the order of `starts`.
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

/// Extends tracks from the first of `frames` to the second, one frame further. The initial guesses in `tracks` assume
/// constant motion. Returns each track's position in the second frame, in pixels. Returns `None` for a track that is
/// lost, or whose motion changes by more than the maximum ([`MAX_MOTION_CHANGE_PX`]) and differently from the motion of
/// its neighbours.
///
/// Where a swinging body reverses, its motion may change by 20 px from one frame interval to the next. Only the
/// comparison with neighbours distinguishes such a change from a mismatch.
pub(super) fn extensions(
    frames: [&Frame; 2],
    tracks: &[AffineStart],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let starts: Vec<Start> = tracks.iter().map(|t| (t.from, t.guess)).collect();
    let mut matches = flow_over(frames, &starts, EXTENSION_LEVELS, options);
    // Lost points are tracked again on all levels, since changes of motion may be large.
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
