//! Points that are lost, or that move unlike their neighbours, are sought again from where their neighbours
//! say; and tracks are extended by a frame.

use super::flow::{Start, flow_over, is_new};
use super::{Frame, Match, MotionPrior, Neighbors, RegistrationOptions};
use nalgebra::{Point2, Vector2};
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

/// How far each match is from its guess, pixels, with its position in the source.
fn innovations(starts: &[Start], matches: &[Option<Match>]) -> Vec<(Point2<f64>, Vector2<f64>)> {
    let of = |(start, m): (&Start, &Option<Match>)| m.map(|m| (m.source, m.target - start.1));
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
        .filter_map(|(innovation, agrees)| agrees.then_some(*innovation))
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
/// changes little, or as that of their neighbours does. `starts` has each track's position in the source, and
/// in the target at constant speed.
///
/// Bodies turn round: near the end of a swing, motion changes by 20 px from frame to frame. So no
/// fixed bound alone tells a change from a mismatch.
pub(super) fn extensions(
    [source, target]: [&Frame; 2],
    starts: &[Start],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let mut matches = flow_over(source, target, starts, EXTENSION_LEVELS, options);
    seek_lost([source, target], starts, &mut matches, options);
    let matches = guided_flow([source, target], starts, matches, options);
    let changes = innovations(starts, &matches);
    let support = support(&changes, options);
    let mut judged = changes.iter().zip(support);
    let judge = |(start, m): (&Start, &Option<Match>)| {
        let matched = (*m)?;
        let (change, support) = judged.next()?;
        let motion = (start.1 - start.0).norm();
        let limit = options.max_motion_change_px + options.max_motion_change_share * motion;
        // Without the check, nobody can agree.
        let agrees = options.min_support > 0 && support == Support::Neighbors(options.min_support);
        (agrees || change.1.norm() <= limit).then_some(matched.target)
    };
    starts.iter().zip(&matches).map(judge).collect()
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
    /// How many move like it, counted up to the number that is asked for.
    Neighbors(usize),
}

/// Whether each of these positions and motions moves like [`RegistrationOptions::min_support`] of its
/// neighbours. Also true where there are fewer than that.
pub(super) fn consensus(
    motions: &[(Point2<f64>, Vector2<f64>)],
    options: &RegistrationOptions,
) -> Vec<bool> {
    let agrees = |support| match support {
        Support::Alone => true,
        Support::Neighbors(count) => count >= options.min_support,
    };
    support(motions, options).into_iter().map(agrees).collect()
}

/// What neighbours say about each of these positions and motions.
fn support(motions: &[(Point2<f64>, Vector2<f64>)], options: &RegistrationOptions) -> Vec<Support> {
    let neighbors = Neighbors::new(motions.iter().map(|(p, _)| *p));
    motions
        .par_iter()
        .enumerate()
        .map(|(k, (p, motion))| {
            let limit = options.support_px + options.support_share * motion.norm();
            let near = neighbors.unsorted_within(p, options.support_radius_px);
            if near.len().saturating_sub(1) < options.min_support {
                return Support::Alone;
            }
            let alike = |n: &&usize| **n != k && (motions[**n].1 - motion).norm() <= limit;
            Support::Neighbors(near.iter().filter(alike).take(options.min_support).count())
        })
        .collect()
}
