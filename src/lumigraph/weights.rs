//! The weight of each camera in a pixel.
//!
//! Buehler et al. weigh the k best cameras by `(1 − p / p_{k+1}) / p`, normalized, which is discontinuous where the
//! k+1 best penalties are equal (0/0). Here the threshold in place of p_{k+1} is at least a little above the best
//! penalty, so that weights are continuous functions of the penalties.

use crate::method::methods;
use crate::simd::multiversion;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Methods to weigh the cameras that see a point, the cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlendMethod {
    /// Equal weights of all cameras that see the point (the paper's Fig. 14).
    Uniform,
    /// Unstructured lumigraph rendering (Buehler et al., SIGGRAPH 2001; §6): by angle and resolution.
    #[default]
    Lumigraph,
    /// By angle, resolution, and the error of temporal interpolation.
    SpaceTime,
}

methods!(BlendMethod {
    Uniform = "uniform": "All cameras that see the point, with equal weights",
    Lumigraph = "lumigraph": "The paper's: the cameras with the nearest rays, by angle and resolution",
    SpaceTime = "space-time": "By angle, resolution, and the expected error of interpolation in time",
});

/// Smallest distance of the threshold above the best penalty, as a fraction of it.
pub(super) const THRESHOLD_MARGIN: f32 = 0.05;

/// Penalties and confidences of some sources at `count` neighbouring pixels.
///
/// A penalty is infinite where the camera doesn't see the point, and 0 where the camera stands at the view's centre:
/// then only such cameras count, in proportion to their confidence.
pub(super) struct Penalties<'a> {
    /// Indices of the sources, ascending.
    pub sources: &'a [usize],
    /// Penalties; those of a source start at `width` times its index.
    pub penalty: &'a [f32],
    /// Confidences, likewise.
    pub confidence: &'a [f32],
    pub width: usize,
    pub count: usize,
}

impl Penalties<'_> {
    /// Indices of a source's values.
    #[inline(always)]
    fn indices(&self, source: usize) -> Range<usize> {
        source * self.width..source * self.width + self.count
    }
}

/// The weights that follow from [`Penalties`].
#[derive(Default)]
pub(super) struct Weights {
    /// Weights, at the indices of the penalties. They sum to 1, or to 0 where no camera sees the point. Sources without
    /// penalties have undefined weights.
    pub weights: Vec<f32>,
    /// The k+1 smallest penalties of every pixel, ascending, rank by rank.
    ranks: Vec<f32>,
    /// Scratch: sums of every pixel.
    sum: Vec<f32>,
    /// Scratch: penalties of one source.
    inserted: Vec<f32>,
}

impl Weights {
    /// Room for this many weights.
    pub fn with_room(count: usize) -> Self {
        Self { weights: vec![0.0; count], ..Self::default() }
    }

    /// Computes the weights of the k best cameras; `k` = 0 counts as 1.
    pub fn lumigraph(&mut self, penalties: &Penalties, k: usize) {
        self.weights.resize(penalties.penalty.len(), 0.0);
        lumigraph(penalties, k.clamp(1, penalties.sources.len().max(1)), self);
    }

    /// Computes weights in proportion to the confidences.
    pub fn uniform(&mut self, penalties: &Penalties) {
        self.weights.resize(penalties.penalty.len(), 0.0);
        for &source in penalties.sources {
            let own = penalties.indices(source);
            self.weights[own.clone()].copy_from_slice(&penalties.confidence[own]);
        }
        self.normalize(penalties);
    }

    /// Sorts the smallest penalties of every pixel.
    #[inline(always)]
    fn rank(&mut self, penalties: &Penalties, count: usize) {
        self.ranks.clear();
        self.ranks.resize(count * penalties.count, f32::INFINITY);
        // Insertion by exchanges, side by side for all pixels.
        for &source in penalties.sources {
            self.inserted.clear();
            self.inserted.extend_from_slice(&penalties.penalty[penalties.indices(source)]);
            for rank in self.ranks.chunks_exact_mut(penalties.count) {
                for (rank, inserted) in rank.iter_mut().zip(&mut self.inserted) {
                    let (a, b) = (*rank, *inserted);
                    *rank = if b < a { b } else { a };
                    *inserted = if b < a { a } else { b };
                }
            }
        }
    }

    /// Divides weights by their sums.
    #[inline(always)]
    fn normalize(&mut self, penalties: &Penalties) {
        self.sum.clear();
        self.sum.resize(penalties.count, 0.0);
        for &source in penalties.sources {
            for (sum, w) in self.sum.iter_mut().zip(&self.weights[penalties.indices(source)]) {
                *sum += w;
            }
        }
        for &source in penalties.sources {
            for (w, &sum) in self.weights[penalties.indices(source)].iter_mut().zip(&self.sum) {
                let fraction = *w / sum;
                *w = if sum > 0.0 { fraction } else { 0.0 };
            }
        }
    }
}

multiversion! {
    /// Weights of the k best cameras (module head).
    fn lumigraph(penalties: &Penalties, k: usize, out: &mut Weights) = lumigraph_by
}

#[inline(always)]
fn lumigraph_by(penalties: &Penalties, k: usize, out: &mut Weights) {
    let count = penalties.count;
    out.rank(penalties, k + 1);
    let (best, next) = out.ranks.split_at_mut(count);
    let threshold = &mut next[(k - 1) * count..];
    for (threshold, &best) in threshold.iter_mut().zip(&*best) {
        // Infinite where k cameras or fewer see the point: none has to fade out.
        *threshold = threshold.max(best * (1.0 + THRESHOLD_MARGIN));
    }
    out.sum.clear();
    // Not sums yet: the decrease of the weights at the threshold.
    out.sum.extend(best.iter().zip(&*threshold).map(|(best, threshold)| best / threshold));
    for &source in penalties.sources {
        let own = penalties.indices(source);
        let pixels = out.weights[own.clone()].iter_mut().zip(&penalties.penalty[own.clone()]);
        let pixels = pixels.zip(&penalties.confidence[own]);
        let limits = best.iter().zip(&*threshold).zip(&out.sum);
        for (((w, &p), &confidence), ((&best, &threshold), &fall)) in pixels.zip(limits) {
            // (1 − p / threshold) / p, times the best p: at most 1, and never an overflow.
            // Where no camera sees the point it is NaN, which is below no threshold.
            let blended = best / p - fall;
            let alone = if p == 0.0 { confidence } else { 0.0 };
            let counted = if p < threshold { blended } else { 0.0 };
            *w = if best == 0.0 { alone } else { counted };
        }
    }
    out.normalize(penalties);
}

multiversion! {
    /// Interpolates weights between nodes every `step` pixels, from the first pixel on, multiplies them by the
    /// confidence, and adds them to `sum`.
    pub(super) fn weigh_between(
        nodes: &[f32],
        step: usize,
        confidence: &[f32],
        weights: &mut [f32],
        sum: &mut [f32],
    ) = weigh_between_by
}

#[inline(always)]
fn weigh_between_by(
    nodes: &[f32],
    step: usize,
    confidence: &[f32],
    weights: &mut [f32],
    sum: &mut [f32],
) {
    let cells = weights.chunks_mut(step).zip(nodes.windows(2));
    for (weights, ends) in cells {
        let slope = (ends[1] - ends[0]) / step as f32;
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = ends[0] + slope * k as f32;
        }
    }
    for ((weight, confidence), sum) in weights.iter_mut().zip(confidence).zip(sum) {
        *weight *= confidence;
        *sum += *weight;
    }
}

multiversion! {
    /// Divides weights by their sum.
    pub(super) fn divide(weights: &mut [f32], sum: &[f32]) = divide_by
}

#[inline(always)]
fn divide_by(weights: &mut [f32], sum: &[f32]) {
    weights.iter_mut().zip(sum).for_each(|(weight, sum)| *weight /= sum);
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    fn weights(penalties: &[f32], k: usize) -> Vec<f32> {
        of_pixels(penalties, penalties.len(), k)
    }

    /// The weights of these pixels' penalties by `n` sources.
    fn of_pixels(penalty: &[f32], n: usize, k: usize) -> Vec<f32> {
        let width = penalty.len() / n.max(1);
        let confidence = &vec![1.0; penalty.len()];
        let sources = &(0..n).collect::<Vec<_>>();
        let mut weights = Weights::default();
        weights.lumigraph(&Penalties { sources, penalty, confidence, width, count: width }, k);
        weights.weights
    }

    /// The formula, one pixel, with a sort.
    fn naive(penalties: &[f32], k: usize) -> Vec<f32> {
        let mut sorted = penalties.to_vec();
        sorted.sort_by(f32::total_cmp);
        let threshold =
            sorted.get(k).copied().unwrap_or(INF).max(sorted[0] * (1.0 + THRESHOLD_MARGIN));
        let weight = |p: &f32| if *p < threshold { (1.0 - p / threshold) / p } else { 0.0 };
        let sum: f32 = penalties.iter().map(weight).sum();
        penalties.iter().map(|p| if sum > 0.0 { weight(p) / sum } else { 0.0 }).collect()
    }

    #[test]
    fn weights_between_nodes_are_linear_with_and_without_avx2() {
        let mut random = Random::new(21);
        for (step, count) in [(2, 64_usize), (4, 64), (4, 61), (5, 60), (7, 3), (64, 64)] {
            let mut some = |n: usize| (0..n).map(|_| random.unit() as f32).collect::<Vec<_>>();
            let (nodes, trust, before) = (some(count.div_ceil(step) + 1), some(count), some(count));
            let all = [weigh_between, weigh_between_by].map(|weigh| {
                let (mut weights, mut sum) = (vec![f32::NAN; count], before.clone());
                weigh(&nodes, step, &trust, &mut weights, &mut sum);
                [weights, sum]
            });
            assert_eq!(all[0], all[1]);
            let [weights, sum] = &all[0];
            for k in 0..count {
                let (cell, t) = (k / step, (k % step) as f32 / step as f32);
                let expected = (nodes[cell] * (1.0 - t) + nodes[cell + 1] * t) * trust[k];
                assert!((weights[k] - expected).abs() < 1e-6);
                assert_eq!(sum[k], before[k] + weights[k]);
            }
            let divided = [divide, divide_by].map(|divide| {
                let mut weights = weights.clone();
                divide(&mut weights, sum);
                weights
            });
            assert_eq!(divided[0], divided[1]);
        }
    }

    const INF: f32 = f32::INFINITY;

    #[test]
    fn rows_equal_the_formula() {
        let mut random = Random::new(20);
        for k in 1..6 {
            let (width, n) = (37, 7);
            let level = |r: &mut Random| if r.unit() < 0.2 { INF } else { r.unit() as f32 + 0.01 };
            let penalties: Vec<f32> = (0..width * n).map(|_| level(&mut random)).collect();
            let weights = of_pixels(&penalties, n, k);
            for x in 0..width {
                let at = |v: &[f32]| (0..n).map(|i| v[i * width + x]).collect::<Vec<_>>();
                for (a, b) in at(&weights).iter().zip(naive(&at(&penalties), k)) {
                    assert!((a - b).abs() < 1e-5, "{a} {b}");
                }
            }
        }
    }

    #[test]
    fn weights_fall_with_the_penalty_and_end_at_the_next_camera() {
        let w = weights(&[0.1, 0.2, 0.3, 0.4], 2);
        assert!(w[0] > w[1] && w[1] > w[2] && w[2] == 0.0 && w[3] == 0.0, "{w:?}");
        let formula = (1.0 - 0.2 / 0.3) / 0.2 / ((1.0 - 0.1 / 0.3) / 0.1);
        assert!((w[1] / w[0] - formula).abs() < 1e-5, "{w:?}");
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
        assert_eq!(weights(&[0.0; 4], 1), [0.25; 4]);
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

    #[test]
    fn weights_are_alike_with_and_without_avx2() {
        let mut random = Random::new(21);
        let (width, n) = (61, 5);
        let level = |r: &mut Random| if r.unit() < 0.2 { INF } else { r.unit() as f32 };
        let penalty: Vec<f32> = (0..width * n).map(|_| level(&mut random)).collect();
        let (trust, sources) = (vec![1.0; width * n], [0, 1, 3, 4]);
        let penalties = Penalties {
            sources: &sources,
            penalty: &penalty,
            confidence: &trust,
            width,
            count: width - 3,
        };
        for k in 1..4 {
            let zeros = || Weights { weights: vec![0.0; width * n], ..Weights::default() };
            let [mut a, mut b] = [zeros(), zeros()];
            lumigraph(&penalties, k, &mut a);
            lumigraph_by(&penalties, k, &mut b);
            assert_eq!(a.weights, b.weights);
            assert!(a.weights.iter().any(|w| *w > 0.0));
        }
    }
}
