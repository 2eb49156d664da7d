//! Detects mismatched features by their neighbours: a feature whose motion differs from the motion of nearby
//! features is a mismatch. This assumes that every surface has several features.

use super::{Match, Neighbors, RegistrationOptions, Start};
use nalgebra::{Matrix2, Point2, Vector2};
use rayon::prelude::*;

/// Radius around a point, in pixels, within which the motions of other points are compared with the point's motion.
const SUPPORT_RADIUS_PX: f64 = 20.0;
/// Constant term, in pixels, of the maximum difference between the motion of a point and the motion of a neighbour that
/// supports it. The maximum is this value plus [`SUPPORT_FRACTION`] times the length of the point's motion.
const SUPPORT_PX: f64 = 1.5;
const SUPPORT_FRACTION: f64 = 0.2;

/// A tracked point, its motion, and the deformation of the image around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moved {
    pub at: Point2<f64>,
    /// Displacement of the point between two frames, or its displacement from an initial guess ([`innovations`]),
    /// pixels.
    pub motion: Vector2<f64>,
    /// Linear part (2×2 matrix) of the affine motion around the point. It is the identity if the motion is a
    /// translation.
    pub deformation: Matrix2<f64>,
}

impl Moved {
    /// Returns the deviation of two points' motions from a common affine motion, in pixels. Each point's
    /// deformation predicts the difference between the two motions. The smaller of the two prediction errors is
    /// returned.
    pub fn distance(&self, other: &Self) -> f64 {
        let (apart, change) = (other.at - self.at, other.motion - self.motion);
        let by = |deformation: &Matrix2<f64>| (change - (deformation * apart - apart)).norm();
        by(&self.deformation).min(by(&other.deformation))
    }
}

/// Returns, for each start, the displacement from its initial guess to its match. `None` for a start without a match.
/// The [`Moved`] are at the source points. Their deformations are the identity, because windows were tracked by
/// translation only, or because the initial guesses already account for deformation.
pub(super) fn innovations(starts: &[Start], matches: &[Option<Match>]) -> Vec<Option<Moved>> {
    let of = |(start, m): (&Start, &Option<Match>)| {
        let deformation = Matrix2::identity();
        m.map(|m| Moved { at: start.0, motion: m.target - start.1, deformation })
    };
    starts.iter().zip(matches).map(of).collect()
}

/// Result of comparing a point's motion with the motions of nearby points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Support {
    /// The point has too few neighbours for a comparison.
    Alone,
    /// At least the required number of neighbours move like the point.
    Agrees,
    /// The point is an outlier: it has enough neighbours, but too few of them move like the point.
    Differs,
}

/// Compares each point's motion with the motions of nearby points. Returns one result per point; `None` for a point
/// without a motion.
pub(super) fn consensus(
    motions: &[Option<Moved>],
    options: &RegistrationOptions,
) -> Vec<Option<Support>> {
    let neighbors = Neighbors::new(motions.iter().flatten().map(|m| m.at));
    let moved: Vec<&Moved> = motions.iter().flatten().collect();
    let wanted = options.consistency().support;
    let judge = |own: &Moved| {
        let limit = SUPPORT_PX + SUPPORT_FRACTION * own.motion.norm();
        let at_least = |count: usize, test: &dyn Fn(&Moved) -> bool| {
            let test = |n: usize| test(moved[n]);
            neighbors.at_least_within(&own.at, SUPPORT_RADIUS_PX, count, test)
        };
        if at_least(wanted, &|other| !std::ptr::eq(own, other) && own.distance(other) <= limit) {
            Support::Agrees
        } else if at_least(wanted + 1, &|_| true) {
            // The count includes the point itself.
            Support::Differs
        } else {
            Support::Alone
        }
    };
    motions.par_iter().map(|own| own.as_ref().map(judge)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_alone_or_agree_or_differ() {
        let options = RegistrationOptions::default();
        let noise = |k: usize, seed: f64| (k as f64 * seed).sin() * 0.5 + 0.5;
        let motions: Vec<Option<Moved>> = (0..200)
            .map(|k| {
                let at = Point2::new(320.0 * noise(k, 12.9898), 240.0 * noise(k, 78.233));
                let motion = Vector2::new(0.0, if noise(k, 5.1) > 0.7 { 9.0 } else { 0.0 });
                (noise(k, 3.7) > 0.2).then_some(Moved {
                    at,
                    motion,
                    deformation: Matrix2::identity(),
                })
            })
            .collect();
        let mut kinds = [0; 3];
        for (k, support) in consensus(&motions, &options).into_iter().enumerate() {
            let near = |own: &Moved, other: &Moved| (own.at - other.at).norm() <= 20.0;
            let expected = motions[k].as_ref().map(|own| {
                let others = || {
                    let others = motions.iter().enumerate().filter(|(n, _)| *n != k);
                    others.filter_map(|(_, m)| m.as_ref()).filter(|m| near(own, m))
                };
                let alike = others().filter(|m| m.motion == own.motion).count();
                match (alike >= 2, others().count() >= 2) {
                    (true, _) => Support::Agrees,
                    (false, true) => Support::Differs,
                    (false, false) => Support::Alone,
                }
            });
            assert_eq!(support, expected, "{k}");
            support.into_iter().for_each(|s| kinds[s as usize] += 1);
        }
        assert!(kinds.iter().all(|n| *n > 0), "{kinds:?}");
    }
}
