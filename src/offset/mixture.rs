//! The best rung's robust estimate: a line through candidates by maximum likelihood, each weighted
//! by its information, outliers modelled instead of cut off.
//!
//! RANSAC counts candidates within a tolerance in time, although a slow feature's candidate is far
//! less certain than a fast one's; eqs. (11) to (13) weight by agreement alone. Here a candidate's
//! error is Gaussian in pixels, so that it weighs with the square of its speed across the epipolar
//! line, and an outlier's time is uniform over what candidates may be: the mixture of narrow, wider
//! and uniform errors is fitted by expectation maximization, from the start that most candidates
//! agree with (scored as MSAC scores: truncated squares).

use nalgebra::{Matrix2, Vector2};

/// A candidate as the mixture sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// What is observed, seconds.
    pub value_s: f64,
    /// Where on the line it is: the rate's factor, seconds.
    pub at_s: f64,
    /// How fast the feature crosses the epipolar line, pixels a second.
    pub across_px_s: f64,
}

/// The fitted mixture.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixture {
    /// The line's value at 0, seconds,
    pub value_s: f64,
    /// and its slope, seconds a second; 0 if none is asked.
    pub rate: f64,
    /// Standard deviation of the narrow component, pixels.
    pub sigma_px: f64,
    /// Share of the candidates that are no outliers.
    pub inlier_share: f64,
    /// Expected number of inliers.
    pub inliers: f64,
    /// The weight of each observation's squared residual in pixels, in units of 1 / px².
    pub weights: Vec<f64>,
}

/// What is expected of residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residuals {
    /// The narrow component's standard deviation before it is known, pixels: also the scale of the
    /// score that chooses the start.
    pub start_px: f64,
    /// What a tracker can't be better than,
    pub min_px: f64,
    /// and what is no inlier any more.
    pub max_px: f64,
    /// The range of times that candidates were looked for in, seconds.
    pub range_s: f64,
}

/// The inliers' components' standard deviations, in the narrow one's: features on depth edges and
/// under changing light are off by several times of what the others are, and where all is thin, by
/// many times. Without the widest, those would set the scale and weigh as much as good ones.
const SCALES: [f64; 3] = [1.0, 4.0, 16.0];
const ITERATIONS: usize = 60;
/// Starts that are scored against all observations.
const MAX_STARTS: usize = 400;

impl Residuals {
    /// MSAC's score of a value with no slope: 1 for each perfect agreement.
    fn score(&self, observations: &[Observation], value_s: f64) -> f64 {
        let reach = 3.0 * self.start_px;
        observations
            .iter()
            .map(|o| {
                let r = (o.value_s - value_s) * o.across_px_s / reach;
                (1.0 - r * r).max(0.0)
            })
            .sum()
    }

    /// The observed value that agrees best with all others, and its score; `None` without
    /// observations. Of many, evenly spread quantiles are tried.
    pub fn start(&self, observations: &[Observation]) -> Option<(f64, f64)> {
        let mut values: Vec<f64> = observations.iter().map(|o| o.value_s).collect();
        values.sort_by(f64::total_cmp);
        let count = values.len().min(MAX_STARTS);
        (0..count)
            .map(|k| values[(2 * k + 1) * values.len() / (2 * count)])
            .map(|value| (value, self.score(observations, value)))
            .fold(None, |best: Option<(f64, f64)>, (value, score)| match best {
                Some((_, most)) if score <= most => best,
                _ => Some((value, score)),
            })
    }

    /// Fits the mixture from a start; with a slope if `with_rate`, which needs observations at two
    /// places at least.
    ///
    /// `None` where the weighted observations determine no line: none, or all without speed.
    pub fn fit(
        &self,
        observations: &[Observation],
        start_s: f64,
        with_rate: bool,
    ) -> Option<Mixture> {
        let mut line = Vector2::new(start_s, 0.0);
        let mut sigma = self.start_px;
        // Shares of the components, and of outliers.
        let mut shares = [0.5, 0.15, 0.05, 0.3];
        let mut weights = vec![0.0; observations.len()];
        for _ in 0..ITERATIONS {
            let sums = self.expect(observations, &line, sigma, shares, &mut weights);
            let next = weighted_line(observations, &weights, with_rate)?;
            let n = observations.len() as f64;
            // No component dies out: one that did could not come back.
            shares = sums.counts.map(|c| (c / n).max(1e-3));
            let total: f64 = shares.iter().sum();
            shares = shares.map(|s| s / total);
            let variance = sums.squares / sums.inliers().max(1e-12);
            let next_sigma = variance.sqrt().clamp(self.min_px, self.max_px);
            let rests = (next - line).amax() < 1e-9 * self.range_s
                && (next_sigma - sigma).abs() < 1e-4 * sigma;
            (line, sigma) = (next, next_sigma);
            if rests {
                break;
            }
        }
        let sums = self.expect(observations, &line, sigma, shares, &mut weights);
        let inliers = sums.inliers();
        Some(Mixture {
            value_s: line.x,
            rate: line.y,
            sigma_px: sigma,
            inlier_share: inliers / observations.len() as f64,
            inliers,
            weights,
        })
    }

    /// Each observation's weight under the current mixture, and the sums that the next one is
    /// made of.
    fn expect(
        &self,
        observations: &[Observation],
        line: &Vector2<f64>,
        sigma: f64,
        shares: Shares,
        weights: &mut [f64],
    ) -> Sums {
        let mut sums = Sums::default();
        let outlier = shares[SCALES.len()] / self.range_s;
        for (o, weight) in observations.iter().zip(weights) {
            let r = (o.value_s - line.x - line.y * o.at_s) * o.across_px_s;
            // Densities in time.
            let at_peak = o.across_px_s.abs() / (sigma * std::f64::consts::TAU.sqrt());
            let z = r / sigma;
            let densities: [f64; SCALES.len()] = std::array::from_fn(|k| {
                let z = z / SCALES[k];
                shares[k] * at_peak / SCALES[k] * (-0.5 * z * z).exp()
            });
            // The outliers' part is positive: the shares are.
            let total = outlier + densities.iter().sum::<f64>();
            // Of the squared residual's weight, in units of the narrow component's.
            let mut part = 0.0;
            for (k, density) in densities.iter().enumerate() {
                sums.counts[k] += density / total;
                part += density / total / (SCALES[k] * SCALES[k]);
            }
            sums.counts[SCALES.len()] += outlier / total;
            sums.squares += part * r * r;
            *weight = part / (sigma * sigma);
        }
        sums
    }
}

/// One number for each component, and for the outliers.
type Shares = [f64; SCALES.len() + 1];

#[derive(Default)]
struct Sums {
    counts: Shares,
    /// Squared residuals, each in units of its component's variance over the narrow one's.
    squares: f64,
}

impl Sums {
    fn inliers(&self) -> f64 {
        self.counts[..SCALES.len()].iter().sum()
    }
}

/// The line of least weighted squares; `None` where it is not determined.
fn weighted_line(
    observations: &[Observation],
    weights: &[f64],
    with_rate: bool,
) -> Option<Vector2<f64>> {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for (o, w) in observations.iter().zip(weights) {
        let w = w * o.across_px_s * o.across_px_s;
        let row = Vector2::new(1.0, if with_rate { o.at_s } else { 0.0 });
        normal += row * row.transpose() * w;
        right += row * (w * o.value_s);
    }
    if !with_rate {
        let value = right.x / normal[(0, 0)];
        return value.is_finite().then(|| Vector2::new(value, 0.0));
    }
    let line = normal.cholesky()?.solve(&right);
    line.iter().all(|v| v.is_finite()).then_some(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const RESIDUALS: Residuals =
        Residuals { start_px: 0.5, min_px: 1e-3, max_px: 2.0, range_s: 3.0 };

    fn problem(
        random: &mut Random,
        inliers: usize,
        outliers: usize,
        rate: f64,
    ) -> Vec<Observation> {
        (0..inliers + outliers)
            .map(|k| {
                let across_px_s = 1.0 + 15.0 * random.unit();
                let at_s = 10.0 * random.unit();
                let value_s = if k < inliers {
                    0.3 + rate * at_s + 0.3 * random.gaussian() / across_px_s
                } else {
                    3.0 * random.unit() - 1.0
                };
                Observation { value_s, at_s, across_px_s }
            })
            .collect()
    }

    /// The error of an efficient estimate is √(σ² / Σ v²); over thousands of problems, half of
    /// them outliers, this one's is no more than a quarter above it.
    #[test]
    fn thousands_of_random_problems_are_solved_efficiently() {
        let random = &mut Random::new(1);
        let (mut squares, mut wrong) = (0.0, 0);
        for _ in 0..3000 {
            let observations = problem(random, 60, 60, 0.0);
            let start = RESIDUALS.start(&observations).unwrap().0;
            let found = RESIDUALS.fit(&observations, start, false).unwrap();
            let information: f64 =
                observations[..60].iter().map(|o| o.across_px_s.powi(2)).sum::<f64>() / 0.09;
            let z = (found.value_s - 0.3) * information.sqrt();
            squares += z * z;
            wrong += usize::from(z.abs() > 6.0);
        }
        assert_eq!(wrong, 0);
        let rms = (squares / 3000.0).sqrt();
        assert!(rms < 1.25, "{rms}");
    }

    #[test]
    fn slopes_are_found() {
        let random = &mut Random::new(2);
        for _ in 0..1000 {
            let observations = problem(random, 100, 40, 0.01);
            let start = RESIDUALS.start(&observations).unwrap().0;
            let found = RESIDUALS.fit(&observations, start, true).unwrap();
            assert!((found.rate - 0.01).abs() < 0.008, "{found:?}");
            assert!((found.value_s - 0.3).abs() < 0.04);
        }
    }

    #[test]
    fn degenerate_observations() {
        assert_eq!(RESIDUALS.start(&[]), None);
        assert_eq!(RESIDUALS.fit(&[], 0.0, false), None);
        let one = Observation { value_s: 0.4, at_s: 1.0, across_px_s: 5.0 };
        let found = RESIDUALS.fit(&[one; 3], 0.4, false).unwrap();
        assert!((found.value_s - 0.4).abs() < 1e-12 && found.sigma_px == RESIDUALS.min_px);
        // All at one place: a value, but no slope.
        assert_eq!(RESIDUALS.fit(&[one; 3], 0.4, true), None);
        let still = Observation { across_px_s: 0.0, ..one };
        assert_eq!(RESIDUALS.fit(&[still; 3], 0.4, false), None);
    }
}
