//! Points that are lost, or that move unlike their neighbours, are sought again from where their neighbours
//! say; and tracks are extended by a frame.

use super::flow::{Start, flow_over, is_new};
use super::turned_flow::{Onward, turned_matches};
use super::{Frame, Match, MotionPrior, Neighbors, RegistrationOptions};
use nalgebra::{Matrix2, Point2, Vector2};
use rayon::prelude::*;

/// Pyramid levels, forward and backward, where the motion prior gives the guess. Larger: small objects in
/// fast motion are pulled away by their background; smaller: the prior must be more accurate.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Maximum number of times that lost features are sought again with the motion prior, which gains
/// features each time. Larger: time for few more; smaller: large motion is followed near slow motion
/// only.
const PRIOR_ROUNDS: usize = 2;
/// Pyramid levels, forward and backward, of extending a track by a frame, where its motion gives the
/// guess. Larger: as of [`PRIOR_LEVELS`]; smaller: changes of motion are lost.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];

/// Improves the `matches` of a flow from `source` to `target`: points that were lost, or that differ from
/// their guess unlike their neighbours, are sought again from where their neighbours' differences predict
/// them. All are in the order of `starts`.
pub(super) fn guided_flow(
    [source, target]: [&Frame; 2],
    starts: &[Start],
    mut matches: Vec<Option<Match>>,
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    let mut tried = vec![None; starts.len()];
    for _ in 0..PRIOR_ROUNDS {
        let mut again = predicted_by_neighbors(starts, &matches, options);
        again.retain(|(k, start)| is_new(&mut tried[*k], start.1));
        if again.is_empty() {
            break;
        }
        let starts: Vec<_> = again.iter().map(|(_, start)| *start).collect();
        let retried = flow_over(source, target, &starts, PRIOR_LEVELS, options);
        for ((k, _), retried) in again.iter().zip(retried) {
            let Some(retried) = retried else { continue };
            if matches[*k].is_none_or(|first| retried.residual < first.residual) {
                matches[*k] = Some(retried);
            }
        }
    }
    matches
}

/// How a point and its surroundings move.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub at: Point2<f64>,
    /// The point's motion, pixels.
    pub motion: Vector2<f64>,
    /// The motion's linear part: the identity where its surroundings move alike.
    pub deformation: Matrix2<f64>,
}

impl Moved {
    /// How far two motions are from being one, pixels: by the deformation of either.
    fn distance(&self, other: &Self) -> f64 {
        let (apart, change) = (other.at - self.at, other.motion - self.motion);
        let by = |deformation: &Matrix2<f64>| (change - (deformation * apart - apart)).norm();
        by(&self.deformation).min(by(&other.deformation))
    }
}

/// How far each match is from its guess, with its position in the source. Guesses turn with their surroundings,
/// so that what is left does not.
fn innovations(starts: &[Start], matches: &[Option<Match>]) -> Vec<Moved> {
    let of = |(start, m): (&Start, &Option<Match>)| {
        let deformation = Matrix2::identity();
        m.map(|m| Moved { at: m.source, motion: m.target - start.1, deformation })
    };
    starts.iter().zip(matches).filter_map(of).collect()
}

/// Initial guesses, by index, of the points that were lost or that differ from their first guess unlike
/// their neighbours. Points without neighbours have none.
fn predicted_by_neighbors(
    starts: &[Start],
    matches: &[Option<Match>],
    options: &RegistrationOptions,
) -> Vec<(usize, Start)> {
    let innovations = innovations(starts, matches);
    let agrees = consensus(&innovations, options);
    let trusted: Vec<_> = innovations
        .iter()
        .zip(&agrees)
        .filter_map(|(innovation, agrees)| agrees.then_some((innovation.at, innovation.motion)))
        .collect();
    let prior = MotionPrior::new(&trusted);
    let mut agrees = agrees.into_iter();
    (0..starts.len())
        .filter(|&k| matches[k].is_none() || !agrees.next().unwrap_or(true))
        .filter_map(|k| {
            let (from, guess) = starts[k];
            Some((k, (from, guess + prior.predict(&from, MotionPrior::RADIUS_PX)?)))
        })
        .collect()
}

/// Tracks extended by a frame: the positions in the target of those that were found and whose motion
/// changes little, or as that of their neighbours does. `tracks` has each track's position in the source, and
/// in the target at constant speed.
///
/// Bodies turn round: near the end of a swing, motion changes by 20 px from frame to frame. So no
/// fixed bound alone tells a change from a mismatch.
pub(super) fn extensions(
    [source, target]: [&Frame; 2],
    tracks: &[Onward],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let starts: Vec<Start> = tracks.iter().map(|t| (t.from, t.guess)).collect();
    let starts = &starts[..];
    let mut matches = flow_over(source, target, starts, EXTENSION_LEVELS, options);
    seek_lost([source, target], starts, &mut matches, options);
    let mut matches = guided_flow([source, target], starts, matches, options);
    turned_extensions([source, target], tracks, &mut matches, options);
    let changes = innovations(starts, &matches);
    let support = support(&changes, options);
    let mut judged = changes.iter().zip(support);
    let judge = |(start, m): (&Start, &Option<Match>)| {
        let matched = (*m)?;
        let (change, support) = judged.next()?;
        let motion = (start.1 - start.0).norm();
        let limit = options.max_motion_change_px + options.max_motion_change_share * motion;
        // Without the check, nobody can agree.
        let agrees = options.min_support > 0 && support == Support::Neighbors { agree: true };
        (agrees || change.motion.norm() <= limit).then_some(matched.target)
    };
    starts.iter().zip(&matches).map(judge).collect()
}

/// Tracks what turned and is turning on.
fn turned_extensions(
    frames: [&Frame; 2],
    tracks: &[Onward],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let turned: Vec<usize> =
        (0..tracks.len()).filter(|&k| tracks[k].deformation != Matrix2::identity()).collect();
    let starts: Vec<Onward> = turned.iter().map(|&k| tracks[k]).collect();
    for (k, found) in turned.into_iter().zip(turned_matches(frames, &starts, options)) {
        matches[k] = found;
    }
}

/// Seeks lost points over all levels: a change of motion may be larger than the finest levels reach.
fn seek_lost(
    [source, target]: [&Frame; 2],
    starts: &[Start],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let lost: Vec<usize> = (0..starts.len()).filter(|&k| matches[k].is_none()).collect();
    let again: Vec<Start> = lost.iter().map(|&k| starts[k]).collect();
    let levels = [options.klt.levels, PRIOR_LEVELS[1]];
    let found = flow_over(source, target, &again, levels, options);
    for (k, found) in lost.into_iter().zip(found) {
        matches[k] = found;
    }
}

/// What the tracks around one say about it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Support {
    /// It has too few neighbours to judge by.
    Alone,
    /// Enough move like it, or too few do.
    Neighbors { agree: bool },
}

/// Whether each of these positions and motions moves like [`RegistrationOptions::min_support`] of its
/// neighbours. Also true where there are fewer than that.
pub(super) fn consensus(motions: &[Moved], options: &RegistrationOptions) -> Vec<bool> {
    let agrees = |s| matches!(s, Support::Alone | Support::Neighbors { agree: true });
    support(motions, options).into_iter().map(agrees).collect()
}

/// What neighbours say about each of these positions and motions.
fn support(motions: &[Moved], options: &RegistrationOptions) -> Vec<Support> {
    let neighbors = Neighbors::new(motions.iter().map(|m| m.at));
    motions
        .par_iter()
        .enumerate()
        .map(|(k, own)| {
            let (wanted, radius_px) = (options.min_support, options.support_radius_px);
            let limit = options.support_px + options.support_share * own.motion.norm();
            let alike = |n: usize| n != k && own.distance(&motions[n]) <= limit;
            if neighbors.at_least_within(&own.at, radius_px, wanted, alike) {
                return Support::Neighbors { agree: true };
            }
            // The point itself is one of them.
            match neighbors.at_least_within(&own.at, radius_px, wanted + 1, |_| true) {
                true => Support::Neighbors { agree: false },
                false => Support::Alone,
            }
        })
        .collect()
}
