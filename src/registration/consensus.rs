//! Consensus of neighbours: a surface has more than one feature, so that a motion unlike its neighbours' is a
//! mismatch.

use super::{Match, Neighbors, RegistrationOptions, Start};
use nalgebra::{Matrix2, Point2, Vector2};
use rayon::prelude::*;

/// Radius within which a point's neighbours are compared with it, pixels.
const SUPPORT_RADIUS_PX: f64 = 20.0;
/// A neighbour supports a point if their motions differ by at most this, pixels, plus [`SUPPORT_FRACTION`] of
/// the point's motion.
const SUPPORT_PX: f64 = 1.5;
const SUPPORT_FRACTION: f64 = 0.2;
/// All points are compared again if more than 1 in this many motions changes, in place of the affected ones.
const MIN_UNCHANGED: usize = 8;

/// The motion of a point and of its surroundings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moved {
    pub at: Point2<f64>,
    /// The point's motion, pixels.
    pub motion: Vector2<f64>,
    /// The motion's linear part: the identity where its surroundings move alike.
    pub deformation: Matrix2<f64>,
}

impl Moved {
    /// How far two motions are from one affine motion, pixels: the smaller value of both deformations.
    fn distance(&self, other: &Self) -> f64 {
        let (apart, change) = (other.at - self.at, other.motion - self.motion);
        let by = |deformation: &Matrix2<f64>| (change - (deformation * apart - apart)).norm();
        by(&self.deformation).min(by(&other.deformation))
    }
}

/// The differences of matches from their initial guesses; `None` without a match. The guesses contain the
/// deformation.
pub(super) fn innovations(starts: &[Start], matches: &[Option<Match>]) -> Vec<Option<Moved>> {
    let of = |(start, m): (&Start, &Option<Match>)| {
        let deformation = Matrix2::identity();
        m.map(|m| Moved { at: start.0, motion: m.target - start.1, deformation })
    };
    starts.iter().zip(matches).map(of).collect()
}

/// The consensus about a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Support {
    /// The point has too few neighbours.
    Alone,
    /// Whether enough of the point's neighbours move like it.
    Neighbors { agree: bool },
}

impl Support {
    /// Whether the point is no outlier: enough neighbours move like it, or it has too few.
    pub fn is_consistent(self) -> bool {
        self != Self::Neighbors { agree: false }
    }
}

/// The consensus about points whose motions change from one attempt to the next.
pub(super) struct Consensus<'a> {
    options: &'a RegistrationOptions,
    positions: Vec<Point2<f64>>,
    neighbors: Neighbors,
    motions: Vec<Option<Moved>>,
    support: Vec<Option<Support>>,
}

impl<'a> Consensus<'a> {
    /// The consensus about points at these positions, pixels, without motions yet.
    pub fn new(
        positions: impl Iterator<Item = Point2<f64>>,
        options: &'a RegistrationOptions,
    ) -> Self {
        let positions: Vec<Point2<f64>> = positions.collect();
        let neighbors = Neighbors::new(positions.iter().copied());
        let (motions, support) = (vec![None; positions.len()], vec![None; positions.len()]);
        Self { options, positions, neighbors, motions, support }
    }

    /// The options with the thresholds.
    pub fn options(&self) -> &'a RegistrationOptions {
        self.options
    }

    /// Whether each of these points moves like enough of its neighbours, or has too few.
    pub fn of(motions: &[Moved], options: &'a RegistrationOptions) -> Vec<bool> {
        let mut consensus = Self::new(motions.iter().map(|m| m.at), options);
        let support = consensus.update(motions.iter().copied().map(Some).collect());
        support.iter().map(|s| s.is_some_and(Support::is_consistent)).collect()
    }

    /// Sets the motions, in the order of the positions, and returns the consensus about each point, `None` without
    /// a motion. Only points near changed motions are compared again.
    pub fn update(&mut self, motions: Vec<Option<Moved>>) -> &[Option<Support>] {
        let is_changed: Vec<bool> =
            motions.iter().zip(&self.motions).map(|(now, before)| now != before).collect();
        let changes = is_changed.iter().filter(|changed| **changed).count();
        self.motions = motions;
        let is_affected = if changes * MIN_UNCHANGED > self.motions.len() {
            vec![true; self.motions.len()]
        } else {
            let mut is_affected = vec![false; self.motions.len()];
            for k in (0..is_changed.len()).filter(|&k| is_changed[k]) {
                let at = &self.positions[k];
                self.neighbors.each_within(at, SUPPORT_RADIUS_PX, |n| is_affected[n] = true);
            }
            is_affected
        };
        let judged = is_affected.par_iter().zip(&self.support).enumerate();
        self.support = judged
            .map(|(k, (affected, known))| if *affected { self.judge(k) } else { *known })
            .collect();
        &self.support
    }

    fn judge(&self, k: usize) -> Option<Support> {
        let own = self.motions[k].as_ref()?;
        let wanted = self.options.consistency().support;
        let limit = SUPPORT_PX + SUPPORT_FRACTION * own.motion.norm();
        let at_least = |wanted, test: &dyn Fn(usize, &Moved) -> bool| {
            let test = |n: usize| self.motions[n].as_ref().is_some_and(|other| test(n, other));
            self.neighbors.at_least_within(&own.at, SUPPORT_RADIUS_PX, wanted, test)
        };
        let agree = at_least(wanted, &|n, other| n != k && own.distance(other) <= limit);
        // The point itself is one of them.
        let is_alone = || !at_least(wanted + 1, &|_, _| true);
        let support =
            if !agree && is_alone() { Support::Alone } else { Support::Neighbors { agree } };
        Some(support)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_judged_again_is_judged_as_anew() {
        let options = RegistrationOptions::default();
        let noise = |k: usize, seed: f64| (k as f64 * seed).sin() * 0.5 + 0.5;
        let at: Vec<_> = (0..200)
            .map(|k| Point2::new(320.0 * noise(k, 12.9898), 240.0 * noise(k, 78.233)))
            .collect();
        let motion_of = |k: usize, round: usize| {
            let moves = noise(k, 3.7 + round as f64) > 0.2;
            let motion = Vector2::new(0.0, if noise(k, 5.1) > 0.7 { 9.0 } else { 0.0 });
            moves.then_some(Moved { at: at[k], motion, deformation: Matrix2::identity() })
        };
        let mut again = Consensus::new(at.iter().copied(), &options);
        let mut kinds = [0; 3];
        // A few change at a time, then all.
        for round in 0..6 {
            let step = if round == 5 { 1 } else { 7 };
            let motions: Vec<_> = (0..at.len())
                .map(|k| motion_of(k, if k % step == 0 { round } else { 0 }))
                .collect();
            let mut anew = Consensus::new(at.iter().copied(), &options);
            let expected = anew.update(motions.clone());
            assert_eq!(again.update(motions), expected);
            for support in expected.iter().flatten() {
                kinds[match support {
                    Support::Alone => 0,
                    Support::Neighbors { agree: true } => 1,
                    Support::Neighbors { agree: false } => 2,
                }] += 1;
            }
        }
        assert!(kinds.iter().all(|n| *n > 0), "{kinds:?}");
    }
}
