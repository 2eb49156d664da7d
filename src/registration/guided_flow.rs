//! Second attempts at lost points and at outliers, from initial guesses by their neighbours' motion; and the
//! extension of tracks by a frame.

use super::consensus::{Support, consensus, innovations};
use super::flow::{Start, flow_over};
use super::rotating_patches::affine_matches;
use super::{AffineStart, Frame, Match, Neighbors, RegistrationOptions};
use nalgebra::{Matrix2, Point2, Vector2};

/// Numbers of finest pyramid levels, forward and backward, where the motion prior gives the initial guess.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Number of attempts with the motion prior, which each attempt's matches improve.
const PRIOR_ROUNDS: usize = 2;
/// Number of nearest neighbours whose median is the motion prior. Up to two of five may be wrong.
const MEDIAN_OF: usize = 5;
/// Radius within which the motion prior has neighbours, pixels.
const PRIOR_RADIUS_PX: f64 = 40.0;
/// Two initial guesses nearer than this, pixels, lead to the same result.
const SAME_GUESS_PX: f64 = 1.0;
/// Numbers of pyramid levels, from the finest, that are searched forward and backward when a track is extended: its last
/// motion is a near initial guess, which needs no coarse levels.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];
/// Maximum change of a track's motion from one frame to the next, pixels, plus [`MAX_MOTION_CHANGE_FRACTION`] of the
/// motion. No bound applies where the neighbours' motion changes alike.
const MAX_MOTION_CHANGE_PX: f64 = 2.0;
/// Maximum change of a track's motion as a fraction of the motion.
const MAX_MOTION_CHANGE_FRACTION: f64 = 0.5;

/// Displacements (motion or disparity, pixels) of tracked features, which predict those of features nearby.
pub(super) struct MotionPrior {
    neighbors: Neighbors,
    displacements: Vec<(Point2<f64>, Vector2<f64>)>,
}

impl MotionPrior {
    /// The prior from `(position, displacement)` pairs, pixels. Without pairs, it predicts nothing.
    pub fn new(displacements: impl Iterator<Item = (Point2<f64>, Vector2<f64>)>) -> Self {
        let displacements: Vec<_> = displacements.collect();
        Self { neighbors: Neighbors::new(displacements.iter().map(|(p, _)| *p)), displacements }
    }

    /// The component-wise median displacement, pixels, of the five nearest positions within
    /// [`PRIOR_RADIUS_PX`], fewer where there are fewer. `None` if there is none.
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
    /// The points with their first guesses.
    pub starts: &'a [Start],
    /// Numbers of finest pyramid levels, forward and backward.
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

    /// Tracks points, given by index, again from new guesses. A match of a smaller residual replaces the point's match
    /// in `matches`.
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

/// Tracks lost points and outliers again, from initial guesses that their neighbours predict. `matches` are in
/// the order of `starts`.
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

/// Extends tracks by a frame: their positions in the target, `None` if lost, or if their motion changes much
/// and unlike their neighbours'. `tracks` has initial guesses at constant motion.
///
/// Where a swinging body turns, its motion changes by 20 px from frame to frame, which no fixed bound tells from a
/// mismatch.
pub(super) fn extensions(
    frames: [&Frame; 2],
    tracks: &[AffineStart],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let starts: Vec<Start> = tracks.iter().map(|t| (t.from, t.guess)).collect();
    let mut matches = flow_over(frames, &starts, EXTENSION_LEVELS, options);
    // Over all levels, for large changes of motion.
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
