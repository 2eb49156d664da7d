//! Second attempts at lost points and at outliers, from initial guesses by a motion prior; and the extension
//! of tracks by a frame.

use super::consensus::{Consensus, Support, innovations};
use super::flow::{Start, flow_over, is_new};
use super::rotating_patches::affine_matches;
use super::{AffineStart, Frame, Match, MotionPrior, RegistrationOptions};
use nalgebra::{Matrix2, Point2};

/// Pyramid levels, forward and backward, where the motion prior gives the initial guess.
const PRIOR_LEVELS: [usize; 2] = [2, 2];
/// Maximum number of attempts with the motion prior, which each attempt's matches improve.
const PRIOR_ROUNDS: usize = 2;
/// Pyramid levels, forward and backward, where a track is extended by constant motion.
const EXTENSION_LEVELS: [usize; 2] = [2, 1];
/// Maximum change of a track's motion from one frame to the next, pixels, in addition to
/// [`MAX_MOTION_CHANGE_FRACTION`], where its neighbours' motion doesn't change alike.
const MAX_MOTION_CHANGE_PX: f64 = 2.0;
/// Maximum change of a track's motion as a fraction of the motion.
const MAX_MOTION_CHANGE_FRACTION: f64 = 0.5;

/// Tracks lost points and outliers again, from initial guesses that their neighbours predict. `matches` and the
/// consensus are in the order of `starts`.
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

/// New initial guesses, by index, of lost points and of outliers, as far as they have neighbours.
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

/// Extends tracks by a frame: their positions in the target, `None` if lost, or if their motion changes much
/// and unlike their neighbours'. `tracks` has initial guesses at constant motion.
///
/// Near the end of a swing, motion changes by 20 px from frame to frame, which no fixed bound tells from a
/// mismatch.
pub(super) fn extensions(
    [source, target]: [&Frame; 2],
    tracks: &[AffineStart],
    options: &RegistrationOptions,
) -> Vec<Option<Point2<f64>>> {
    let starts: Vec<Start> = tracks.iter().map(|t| (t.from, t.guess)).collect();
    let starts = &starts[..];
    let mut matches = flow_over(source, target, starts, EXTENSION_LEVELS, options);
    track_lost([source, target], starts, &mut matches, options);
    let mut consensus = Consensus::new(starts.iter().map(|start| start.0), options);
    let mut matches = guided_flow([source, target], starts, matches, &mut consensus);
    rotating_extensions([source, target], tracks, &mut matches, options);
    let support = consensus.update(innovations(starts, &matches));
    let judge = |((start, m), support): ((&Start, &Option<Match>), &Option<Support>)| {
        let (matched, support) = ((*m)?, (*support)?);
        let motion = (start.1 - start.0).norm();
        let limit = MAX_MOTION_CHANGE_PX + MAX_MOTION_CHANGE_FRACTION * motion;
        let agrees =
            options.consistency().support > 0 && support == Support::Neighbors { agree: true };
        let change = (matched.target - start.1).norm();
        (agrees || change <= limit).then_some(matched.target)
    };
    starts.iter().zip(&matches).zip(support).map(judge).collect()
}

/// Extends the tracks of rotating patches.
fn rotating_extensions(
    frames: [&Frame; 2],
    tracks: &[AffineStart],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let rotating: Vec<usize> =
        (0..tracks.len()).filter(|&k| tracks[k].deformation != Matrix2::identity()).collect();
    let starts: Vec<AffineStart> = rotating.iter().map(|&k| tracks[k]).collect();
    for (k, found) in rotating.into_iter().zip(affine_matches(frames, &starts, options)) {
        matches[k] = found;
    }
}

/// Tracks lost points again over all levels, for large changes of motion.
fn track_lost(
    [source, target]: [&Frame; 2],
    starts: &[Start],
    matches: &mut [Option<Match>],
    options: &RegistrationOptions,
) {
    let lost: Vec<usize> = (0..starts.len()).filter(|&k| matches[k].is_none()).collect();
    let again: Vec<Start> = lost.iter().map(|&k| starts[k]).collect();
    let levels = [options.levels, PRIOR_LEVELS[1]];
    let found = flow_over(source, target, &again, levels, options);
    for (k, found) in lost.into_iter().zip(found) {
        matches[k] = found;
    }
}
