//! Blending weights of the cameras at a pixel.
//!
//! Buehler et al. blend the k cameras with the smallest penalties. Let p be a camera's penalty, and p_{k+1} the
//! (k+1)-th smallest penalty of all cameras. The camera's weight is `(1 − p / p_{k+1}) / p`, normalized to a sum of 1.
//! These weights are discontinuous where the k+1 smallest penalties are equal, since they become 0/0. Here p_{k+1} is
//! therefore replaced by a threshold, which exceeds the smallest penalty by at least the fraction [`THRESHOLD_MARGIN`].
//! With this threshold, weights are continuous functions of the penalties.

use crate::method::methods;
use crate::simd::multiversion;
use serde::{Deserialize, Serialize};

/// Methods to compute the blending weights of the cameras that see a point, the cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlendMethod {
    /// All cameras that see the point have equal weights (the paper's Fig. 14).
    Uniform,
    /// Weights depend on angle and resolution: unstructured lumigraph rendering (Buehler et al., SIGGRAPH 2001), as in
    /// §6 of the paper.
    #[default]
    Lumigraph,
    /// Weights depend on angle, resolution, and the expected error of temporal interpolation.
    SpaceTime,
}

methods!(BlendMethod {
    Uniform = "uniform": "All cameras that see the point, with equal weights",
    Lumigraph = "lumigraph": "The paper's: the cameras with the nearest rays, by angle and resolution",
    SpaceTime = "space-time": "By angle, resolution, and the expected error of interpolation in time",
});

/// Minimum difference between the penalty threshold, at which weights reach 0, and a pixel's smallest penalty, as a
/// fraction of the smallest penalty.
const THRESHOLD_MARGIN: f32 = 0.05;

/// Maximum number of neighbouring pixels in a row whose blending weights are computed together.
pub(super) const SPAN_PX: usize = 64;

/// Positions, penalties, confidences and weights, in one source camera, of the surface points that a span of
/// neighbouring pixels of the view shows.
pub(super) struct SourceSpan {
    /// Horizontal positions of the span's surface points in the source's image, pixels.
    pub x: [f32; SPAN_PX],
    /// Vertical positions of the span's surface points in the source's image, pixels.
    pub y: [f32; SPAN_PX],
    /// Penalties of the source at the span's surface points: infinite where the source doesn't see the point, and 0 if
    /// the source stands at the view's centre. Where any source has the penalty 0, only the sources with the penalty 0
    /// are blended, weighted by their confidence.
    pub penalty: [f32; SPAN_PX],
    /// Confidences of the source in the span's surface points: 1 inside the image, 0 outside, and less than 1 near the
    /// image's border and for occluded points.
    pub confidence: [f32; SPAN_PX],
    /// Blending weights of the source at the span's surface points. Over all sources, the weights of a pixel sum to 1,
    /// or to 0 where no source sees the point.
    pub weight: [f32; SPAN_PX],
}

impl SourceSpan {
    pub const ZERO: Self = Self {
        x: [0.0; SPAN_PX],
        y: [0.0; SPAN_PX],
        penalty: [0.0; SPAN_PX],
        confidence: [0.0; SPAN_PX],
        weight: [0.0; SPAN_PX],
    };
}

/// A span of neighbouring pixels, with the blending weights of all sources. Values beyond the last pixel are undefined.
pub(super) struct WeighedSpan {
    /// Number of pixels in the span, at most [`SPAN_PX`].
    pub count: usize,
    /// Indices of the sources that may have a positive weight, ascending. The values of other sources are undefined.
    pub active: Vec<usize>,
    pub of_source: Vec<SourceSpan>,
    /// The k+1 smallest penalties of each pixel, where k sources are blended. The first array holds the smallest
    /// penalty of every pixel, and later arrays hold larger penalties.
    ranks: Vec<[f32; SPAN_PX]>,
}

impl WeighedSpan {
    pub fn new(sources: usize) -> Self {
        let of_source = (0..sources).map(|_| SourceSpan::ZERO).collect();
        Self { count: 0, active: Vec::new(), of_source, ranks: Vec::new() }
    }

    /// Computes the weights of the `k` sources with the smallest penalties at each pixel. `k` = 0 counts as 1.
    pub fn weigh_best(&mut self, k: usize) {
        lumigraph(self, k.clamp(1, self.active.len().max(1)));
    }

    /// Computes equal weights of all sources, multiplied by the confidences and normalized to a sum of 1.
    pub fn weigh_uniformly(&mut self) {
        for &i in &self.active {
            let own = &mut self.of_source[i];
            own.weight = own.confidence;
        }
        normalize(self);
    }

    /// Writes the `count` smallest penalties of each pixel to `ranks`, ascending.
    #[inline(always)]
    fn rank(&mut self, count: usize) {
        self.ranks.clear();
        self.ranks.resize(count, [f32::INFINITY; SPAN_PX]);
        // This is an insertion sort by exchanges, vectorized over the pixels.
        for &i in &self.active {
            let mut inserted = self.of_source[i].penalty;
            for rank in &mut self.ranks {
                for (rank, inserted) in rank.iter_mut().zip(&mut inserted) {
                    let (a, b) = (*rank, *inserted);
                    *rank = if b < a { b } else { a };
                    *inserted = if b < a { a } else { b };
                }
            }
        }
    }

    /// Returns the largest penalty threshold of any pixel of the span. A source's weight is 0 if its penalty reaches
    /// the threshold. `sources` are the indices of k+1 sources, where k is the number of blended sources. The result is
    /// an upper bound: further sources can only lower a pixel's threshold.
    pub fn max_threshold(&self, sources: &[usize]) -> f32 {
        let (mut best, mut worst) = ([f32::INFINITY; SPAN_PX], [0.0_f32; SPAN_PX]);
        for &i in sources {
            for ((best, worst), &p) in
                best.iter_mut().zip(&mut worst).zip(&self.of_source[i].penalty)
            {
                *best = best.min(p);
                *worst = worst.max(p);
            }
        }
        let thresholds = best.iter().zip(&worst).map(|(best, worst)| threshold(*worst, *best));
        thresholds.take(self.count).fold(0.0, f32::max)
    }
}

/// Computes the penalty threshold of a pixel, at which a source's weight reaches 0. `best` is the smallest penalty of
/// any source at the pixel. `next` is the (k+1)-th smallest penalty, where k is the number of blended sources.
#[inline(always)]
fn threshold(next: f32, best: f32) -> f32 {
    next.max(best * (1.0 + THRESHOLD_MARGIN))
}

multiversion! {
    /// Divides each pixel's weights by their sum over the sources. Returns false if the sum is 0 at any pixel.
    pub(super) fn normalize(span: &mut WeighedSpan) -> bool = normalize_by
}

#[inline(always)]
fn normalize_by(span: &mut WeighedSpan) -> bool {
    let mut sum = [0.0; SPAN_PX];
    for &i in &span.active {
        for (sum, w) in sum.iter_mut().zip(&span.of_source[i].weight) {
            *sum += w;
        }
    }
    for &i in &span.active {
        for (w, &sum) in span.of_source[i].weight.iter_mut().zip(&sum) {
            let fraction = *w / sum;
            *w = if sum > 0.0 { fraction } else { 0.0 };
        }
    }
    sum[..span.count].iter().all(|sum| *sum > 0.0)
}

multiversion! {
    /// Computes the weights of the `k` sources with the smallest penalties at each pixel. The module's documentation
    /// gives the formula.
    fn lumigraph(span: &mut WeighedSpan, k: usize) = lumigraph_by
}

#[inline(always)]
fn lumigraph_by(span: &mut WeighedSpan, k: usize) {
    span.rank(k + 1);
    let (best, mut limit) = (span.ranks[0], span.ranks[k]);
    for (limit, &best) in limit.iter_mut().zip(&best) {
        // The threshold is infinite where at most k cameras see the point. No camera has to fade out there.
        *limit = threshold(*limit, best);
    }
    // This ratio is subtracted from best / p, so that weights are 0 at the threshold.
    let mut fall = best;
    fall.iter_mut().zip(&limit).for_each(|(fall, limit)| *fall /= limit);
    for &i in &span.active {
        let own = &mut span.of_source[i];
        for x in 0..SPAN_PX {
            let p = own.penalty[x];
            // This is (1 − p / threshold) / p, multiplied by the smallest penalty. It is at most 1, so it can't
            // overflow. It is NaN where no camera sees the point; p is then not below the threshold, and the weight
            // becomes 0.
            let blended = best[x] / p - fall[x];
            let alone = if p == 0.0 { own.confidence[x] } else { 0.0 };
            let counted = if p < limit[x] { blended } else { 0.0 };
            own.weight[x] = if best[x] == 0.0 { alone } else { counted };
        }
    }
    normalize_by(span);
}

multiversion! {
    /// Interpolates a source's weights linearly between nodes, and multiplies them by the confidences. `nodes` are the
    /// weights at every `step`-th pixel of the span, starting with the first.
    pub(super) fn weigh_between(nodes: &[f32], step: usize, span: &mut SourceSpan) = weigh_between_by
}

#[inline(always)]
fn weigh_between_by(nodes: &[f32], step: usize, span: &mut SourceSpan) {
    for (weights, ends) in span.weight.chunks_mut(step).zip(nodes.windows(2)) {
        let slope = (ends[1] - ends[0]) / step as f32;
        for (k, weight) in weights.iter_mut().enumerate() {
            *weight = ends[0] + slope * k as f32;
        }
    }
    for (weight, confidence) in span.weight.iter_mut().zip(&span.confidence) {
        *weight *= confidence;
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    fn weights(penalties: &[f32], k: usize) -> Vec<f32> {
        of_pixels(penalties, penalties.len(), k)
    }

    /// Creates a span with `n` sources. `penalty` lists the first source's penalties at all pixels, then the second
    /// source's, and so on. All confidences are 1.
    fn span_of(penalty: &[f32], n: usize) -> WeighedSpan {
        let mut span = WeighedSpan::new(n);
        span.count = penalty.len() / n.max(1);
        span.active = (0..n).collect();
        for (own, penalty) in span.of_source.iter_mut().zip(penalty.chunks(span.count.max(1))) {
            own.penalty[..span.count].copy_from_slice(penalty);
            own.confidence = [1.0; SPAN_PX];
        }
        span
    }

    /// Returns the weights of the active sources: the first source's weights at all pixels, then the second source's,
    /// and so on.
    fn weights_of(span: &WeighedSpan) -> Vec<f32> {
        let of = |&i: &usize| &span.of_source[i].weight[..span.count];
        span.active.iter().flat_map(of).copied().collect()
    }

    /// Returns the weights of `n` sources, given their penalties. At each pixel, the `k` sources with the smallest
    /// penalties are blended. `penalty` lists the first source's penalties at all pixels, then the second source's, and
    /// so on. The weights are in the same order.
    fn of_pixels(penalty: &[f32], n: usize, k: usize) -> Vec<f32> {
        let mut span = span_of(penalty, n);
        span.weigh_best(k);
        weights_of(&span)
    }

    /// Reference implementation for one pixel: the formula of the module's documentation. It finds the threshold by
    /// sorting.
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
            let (nodes, trust) = (some(count.div_ceil(step) + 1), some(SPAN_PX));
            let [mut all, plain] = [weigh_between, weigh_between_by].map(|weigh| {
                let mut span = WeighedSpan::new(2);
                (span.count, span.active) = (count, vec![0, 1]);
                for own in &mut span.of_source {
                    own.confidence.copy_from_slice(&trust);
                    weigh(&nodes, step, own);
                }
                span
            });
            assert_eq!(weights_of(&all), weights_of(&plain));
            for (k, trust) in trust.iter().enumerate().take(count) {
                let (cell, t) = (k / step, (k % step) as f32 / step as f32);
                let expected = (nodes[cell] * (1.0 - t) + nodes[cell + 1] * t) * trust;
                assert!((all.of_source[0].weight[k] - expected).abs() < 1e-6);
            }
            let mut divided = plain;
            assert!(normalize(&mut all) && normalize_by(&mut divided));
            assert_eq!(weights_of(&all), weights_of(&divided));
            assert!(weights_of(&all).iter().all(|w| *w == 0.5));
            all.of_source.iter_mut().for_each(|own| own.weight[count - 1] = 0.0);
            assert!(!normalize(&mut all));
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
            // Many penalties are equal, and some cameras don't see the point.
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
        for k in 1..4 {
            let [mut a, mut b] = [(); 2].map(|()| span_of(&penalty, n));
            for span in [&mut a, &mut b] {
                (span.count, span.active) = (width - 3, vec![0, 1, 3, 4]);
            }
            lumigraph(&mut a, k);
            lumigraph_by(&mut b, k);
            assert_eq!(weights_of(&a), weights_of(&b));
            assert!(weights_of(&a).iter().any(|w| *w > 0.0));
        }
    }
}
