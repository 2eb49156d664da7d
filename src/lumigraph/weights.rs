//! How much each camera contributes to a pixel.
//!
//! Buehler et al.: the k best cameras by penalty, weights `(1 − p / p_{k+1}) / p`. As written,
//! that is discontinuous where the k+1 best are equally good (0/0: the middle of a square of
//! four cameras with k = 3). Here the threshold is a little above p_{k+1}, so that the best k+1
//! never all reach zero, and every camera under it counts: weights are then continuous
//! functions of the penalties, whatever ties there are.

use serde::{Deserialize, Serialize};

/// The rungs of the blend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlendRung {
    /// Every camera that sees the point, all alike (the paper's Fig. 14: 1/8 each).
    Uniform,
    /// Unstructured lumigraph.
    Lumigraph,
}

/// How far above the (k+1)-th penalty the weights reach zero, as a share of it. Larger lets the
/// (k+1)-th camera in (its weight is about this share of the others'); smaller sharpens the
/// passage between cameras that tie, to a jump at 0.
const SOFT: f32 = 0.02;

/// Writes the weights, which sum to 1; false (and all 0) if no camera has a finite penalty.
///
/// `penalties`: angular deviation, raised by poor resolution and towards the image's border;
/// infinite where the camera doesn't see the point. A penalty of 0 is the target's own centre:
/// then only such cameras count, in proportion to `trust` (0 at the image's border to 1).
/// `nearest` is scratch space.
pub(super) fn lumigraph_weights(
    penalties: &[f32],
    trust: &[f32],
    k: usize,
    nearest: &mut Vec<f32>,
    weights: &mut [f32],
) -> bool {
    smallest(penalties, k.max(1) + 1, nearest);
    weights.fill(0.0);
    let Some(&best) = nearest.first().filter(|p| p.is_finite()) else { return false };
    let mut sum = 0.0;
    if best == 0.0 {
        for ((w, &p), &t) in weights.iter_mut().zip(penalties).zip(trust) {
            if p == 0.0 {
                *w = t;
                sum += t;
            }
        }
    } else {
        // With k cameras or fewer in sight nothing need fade out: the threshold is infinite.
        let threshold = nearest
            .get(k.max(1))
            .map_or(f32::INFINITY, |p| p * (1.0 + SOFT))
            .max(best * (1.0 + SOFT));
        for (w, &p) in weights.iter_mut().zip(penalties) {
            if p < threshold {
                // best / p instead of 1 / p: at most 1, and never an overflow.
                *w = (1.0 - p / threshold) * (best / p);
                sum += *w;
            }
        }
    }
    if !(sum > 0.0) {
        return false;
    }
    weights.iter_mut().for_each(|w| *w /= sum);
    true
}

/// Writes equal weights for the cameras that see the point, less towards their borders; false
/// (and all 0) if none does.
pub(super) fn uniform_weights(trust: &[f32], weights: &mut [f32]) -> bool {
    let sum: f32 = trust.iter().sum();
    for (w, t) in weights.iter_mut().zip(trust) {
        *w = if sum > 0.0 { t / sum } else { 0.0 };
    }
    sum > 0.0
}

/// The `count` smallest values (or all there are), ascending.
fn smallest(values: &[f32], count: usize, out: &mut Vec<f32>) {
    out.clear();
    for &v in values {
        if out.len() == count {
            if v >= out[count - 1] {
                continue;
            }
            out.pop();
        }
        let at = out.iter().position(|&o| v < o).unwrap_or(out.len());
        out.insert(at, v);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    fn weights(penalties: &[f32], k: usize) -> Vec<f32> {
        let mut out = vec![0.0; penalties.len()];
        lumigraph_weights(penalties, &vec![1.0; penalties.len()], k, &mut Vec::new(), &mut out);
        out
    }

    const INF: f32 = f32::INFINITY;

    #[test]
    fn weights_fall_with_the_penalty_and_end_at_the_next_camera() {
        let w = weights(&[0.1, 0.2, 0.3, 0.4], 2);
        assert!(w[0] > w[1] && w[1] > w[2] && w[2] < 0.01 && w[3] == 0.0, "{w:?}");
        let formula = (1.0 - 0.2 / 0.3) / 0.2 / ((1.0 - 0.1 / 0.3) / 0.1);
        assert!((w[1] / w[0] - formula).abs() < 0.02, "{w:?}");
    }

    #[test]
    fn few_or_no_cameras() {
        assert!(weights(&[], 4).is_empty());
        assert_eq!(weights(&[INF, INF], 4), [0.0, 0.0]);
        assert_eq!(weights(&[INF, 0.3], 4), [0.0, 1.0]);
        assert_eq!(weights(&[INF, 0.0, 0.1], 4), [0.0, 1.0, 0.0]);
        assert_eq!(weights(&[0.3], 0), [1.0], "k = 0 is k = 1");
        assert_eq!(weights(&[1e-38, 1e38], 1), [1.0, 0.0]);
    }

    #[test]
    fn ties_are_shared() {
        assert_eq!(weights(&[0.2; 4], 3), [0.25; 4]);
        assert_eq!(weights(&[0.2; 4], 1), [0.25; 4]);
    }

    #[test]
    fn continuous_in_the_penalties() {
        let mut random = Random::new(21);
        for _ in 0..3000 {
            let n = 1 + (random.unit() * 8.0) as usize;
            let k = 1 + (random.unit() * 5.0) as usize;
            // Many ties, and cameras that leave the image.
            let level = |r: &mut Random| (r.unit() * 4.0).ceil() as f32 * 0.1;
            let p: Vec<f32> = (0..n)
                .map(|_| if random.unit() < 0.1 { 1e6 } else { level(&mut random) })
                .collect();
            let q: Vec<f32> =
                p.iter().map(|p| p * (1.0 + random.in_range(-1e-5, 1e-5) as f32)).collect();
            let gone: Vec<f32> = q.iter().map(|&p| if p > 1e5 { INF } else { p }).collect();
            let a = weights(&p, k);
            if p.iter().any(|&p| p < 1e5) {
                for b in [weights(&q, k), weights(&gone, k)] {
                    let moved: f32 = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum();
                    assert!(moved < 0.01, "{p:?} {a:?} {b:?}");
                }
            }
        }
    }
}
