//! Points that are lost, or that move unlike their neighbours, are sought again from where their neighbours
//! say; and tracks are extended by a frame.

use super::consensus::{Consensus, Support, innovations};
use super::flow::{Start, flow_over, is_new};
use super::turned_flow::{Onward, turned_matches};
use super::{Frame, Match, MotionPrior, RegistrationOptions};
use nalgebra::{Matrix2, Point2};

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
/// them. All are in the order of `starts`, of whose positions the consensus is.
pub(super) fn guided_flow(
    [source, target]: [&Frame; 2],
    starts: &[Start],
    mut matches: Vec<Option<Match>>,
    consensus: &mut Consensus,
) -> Vec<Option<Match>> {
    let mut tried = vec![None; starts.len()];
    for _ in 0..PRIOR_ROUNDS {
        let mut again = predicted_by_neighbors(starts, &matches, consensus);
        again.retain(|(k, start)| is_new(&mut tried[*k], start.1));
        if again.is_empty() {
            break;
        }
        let starts: Vec<_> = again.iter().map(|(_, start)| *start).collect();
        let retried = flow_over(source, target, &starts, PRIOR_LEVELS, consensus.options());
        for ((k, _), retried) in again.iter().zip(retried) {
            let Some(retried) = retried else { continue };
            if matches[*k].is_none_or(|first| retried.residual < first.residual) {
                matches[*k] = Some(retried);
            }
        }
    }
    matches
}

/// Initial guesses, by index, of the points that were lost or that differ from their first guess unlike
/// their neighbours. Points without neighbours have none.
fn predicted_by_neighbors(
    starts: &[Start],
    matches: &[Option<Match>],
    consensus: &mut Consensus,
) -> Vec<(usize, Start)> {
    let innovations = innovations(starts, matches);
    let support = consensus.update(innovations.clone());
    let is_consistent = |support: &Option<Support>| support.is_some_and(Support::is_consistent);
    let trusted: Vec<_> = innovations
        .iter()
        .zip(support)
        .filter(|(_, support)| is_consistent(support))
        .filter_map(|(moved, _)| moved.map(|moved| (moved.at, moved.motion)))
        .collect();
    let prior = MotionPrior::new(&trusted);
    let unlike = starts.iter().zip(support).enumerate().filter(|(_, (_, s))| !is_consistent(s));
    unlike
        .filter_map(|(k, (&(from, guess), _))| {
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
    let mut consensus = Consensus::new(starts.iter().map(|start| start.0), options);
    let mut matches = guided_flow([source, target], starts, matches, &mut consensus);
    turned_extensions([source, target], tracks, &mut matches, options);
    let support = consensus.update(innovations(starts, &matches));
    let judge = |((start, m), support): ((&Start, &Option<Match>), &Option<Support>)| {
        let (matched, support) = ((*m)?, (*support)?);
        let motion = (start.1 - start.0).norm();
        let limit = options.max_motion_change_px + options.max_motion_change_share * motion;
        // Without the check, nobody can agree.
        let agrees = options.min_support > 0 && support == Support::Neighbors { agree: true };
        let change = (matched.target - start.1).norm();
        (agrees || change <= limit).then_some(matched.target)
    };
    starts.iter().zip(&matches).zip(support).map(judge).collect()
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
