//! Fits a line, the offset as a function of time, robustly to the offset candidates of many features. The fit maximizes
//! the likelihood under a mixture model of inliers and outliers, by expectation maximization (EM).
//!
//! Beyond the paper. RANSAC counts all candidates within a tolerance in time alike, although a slow feature's candidate
//! is far less certain than a fast feature's. The weights of eqs. (11) to (13) depend only on the agreement of the
//! candidates. Here the error of an inlier is a scale mixture of three Gaussians in pixels, so a candidate's
//! information is proportional to the square of its speed across the epipolar line. The offset of an outlier is
//! uniformly distributed. EM starts at the candidate with the highest consensus, measured by MSAC's truncated squared
//! residuals.
//!
//! Known limit: EM converges to a local maximum. If two groups of candidates are equally large, the start decides
//! between them.

use crate::offset::recording::Sample;
use nalgebra::{Matrix2, Vector2};

/// Observation to which the line is fitted: the offset that one feature implies, at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The observed offset, seconds.
    pub value_s: f64,
    /// The time of the observation, seconds: the abscissa of the line.
    pub at_s: f64,
    /// The feature's signed speed perpendicular to the epipolar line, pixels per second. It converts a
    /// residual in seconds to pixels.
    pub across_px_s: f64,
}

impl From<&Sample> for Observation {
    /// Returns the offset `offset_b − offset_a` that a sample implies, as an observation at time 0.
    fn from(sample: &Sample) -> Self {
        Self { value_s: sample.offset_s(), at_s: 0.0, across_px_s: sample.across_px_s }
    }
}

/// Fitted mixture model: a line (offset over time), and the distribution of the residuals.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixture {
    /// The line's offset at time 0, seconds.
    pub value_s: f64,
    /// The line's slope, seconds per second; 0 if no slope was fitted.
    pub rate: f64,
    /// The standard deviation of the narrowest inlier component, pixels.
    pub sigma_px: f64,
    /// The expected fraction of inliers among the observations, 0 to 1.
    pub inlier_fraction: f64,
    /// The expected number of inliers.
    pub inliers: f64,
    /// The weight of each observation's squared residual, 1 / px².
    pub weights: Vec<f64>,
}

/// The standard deviations of the mixture model's three inlier components, relative to the narrowest component. Errors
/// of features on depth edges and under changing light are several times as large as errors of other features. Errors
/// on thin structures are many times as large.
const SCALES: [f64; 3] = [1.0, SCALE_RATIO, SCALE_RATIO * SCALE_RATIO];
/// The ratio of the standard deviations of successive inlier components. Its square is an integer, since `gaussians`
/// uses the square as an exponent.
const SCALE_RATIO: f64 = 4.0;
/// The initial standard deviation of the narrowest inlier component, pixels: the expected distance of features from
/// their epipolar lines.
const START_PX: f64 = 0.5;
/// The lower bound of the standard deviation of the narrowest inlier component, pixels. Trackers are not more precise.
const MIN_PX: f64 = 0.01;
/// The upper bound of the standard deviation of the narrowest inlier component, pixels.
const MAX_PX: f64 = 2.0;
/// The width of the uniform distribution of the outliers' offsets, in frames. Only its order of magnitude matters.
const OUTLIER_RANGE_FRAMES: f64 = 3.0;
/// The initial fractions of observations in the three inlier components and among the outliers, in this order.
const INITIAL_FRACTIONS: Fractions = [0.5, 0.15, 0.05, 0.3];
/// The lower bound of the fraction of observations in a component. EM would never raise a fraction of 0.
const MIN_FRACTION: f64 = 1e-3;
/// The maximum number of EM iterations.
const MAX_ITERATIONS: usize = 60;
/// The change of the line's coefficients in one EM iteration, relative to the width of the outliers' distribution,
/// below which the line has converged.
const LINE_TOLERANCE: f64 = 1e-9;
/// The relative change of the narrowest component's standard deviation in one EM iteration, below which it has
/// converged.
const SIGMA_TOLERANCE: f64 = 1e-4;
/// The maximum number of observed offsets that are tried as the start of the fit.
const MAX_STARTS: usize = 400;
/// The absolute residual at which the MSAC score truncates squared residuals, pixels.
const MSAC_BOUND_PX: f64 = 3.0 * START_PX;

/// Returns the MSAC score of a constant line with the offset `value_s`. Each observation contributes a value that
/// falls from 1, at a residual of 0, to 0 at [`MSAC_BOUND_PX`] and beyond.
fn score(observations: &[Observation], value_s: f64) -> f64 {
    let squares = observations.iter().map(|o| {
        let r = (o.value_s - value_s) * o.across_px_s / MSAC_BOUND_PX;
        (1.0 - r * r).max(0.0)
    });
    squares.sum()
}

/// Returns the observed offset with the highest MSAC score, seconds, and this score. `None` without observations. If
/// there are more than 400 observations, only evenly spread quantiles of the offsets are tried.
pub fn consensus_value(observations: &[Observation]) -> Option<(f64, f64)> {
    let mut values: Vec<f64> = observations.iter().map(|o| o.value_s).collect();
    values.sort_by(f64::total_cmp);
    let count = values.len().min(MAX_STARTS);
    (0..count)
        .map(|k| values[(2 * k + 1) * values.len() / (2 * count)])
        .map(|value| (value, score(observations, value)))
        .reduce(|best, other| if other.1 > best.1 { other } else { best })
}

impl Mixture {
    /// Fits the mixture by EM, starting from a line with the constant offset `start_s`, seconds. A slope is fitted if
    /// `with_rate` is true. `frame_s` is the frame period, seconds, which determines the range of the outliers'
    /// offsets.
    ///
    /// `None` if the observations do not determine the line: there are none, all have a speed of 0, or all have the
    /// same time although a slope is fitted.
    pub fn fit(
        observations: &[Observation],
        frame_s: f64,
        start_s: f64,
        with_rate: bool,
    ) -> Option<Self> {
        let range_s = OUTLIER_RANGE_FRAMES * frame_s;
        let mut line = Vector2::new(start_s, 0.0);
        let mut sigma = START_PX;
        let mut fractions = INITIAL_FRACTIONS;
        for _ in 0..MAX_ITERATIONS {
            let sums = expect(observations, &line, sigma, fractions, range_s);
            let next = weighted_line(observations, &sums.weights, with_rate)?;
            let n = observations.len() as f64;
            fractions = sums.counts.map(|c| (c / n).max(MIN_FRACTION));
            let total: f64 = fractions.iter().sum();
            fractions = fractions.map(|f| f / total);
            let variance = sums.squares / sums.inliers().max(1e-12);
            let next_sigma = variance.sqrt().clamp(MIN_PX, MAX_PX);
            let converged = (next - line).amax() < LINE_TOLERANCE * range_s
                && (next_sigma - sigma).abs() < SIGMA_TOLERANCE * sigma;
            (line, sigma) = (next, next_sigma);
            if converged {
                break;
            }
        }
        let sums = expect(observations, &line, sigma, fractions, range_s);
        let inliers = sums.inliers();
        Some(Self {
            value_s: line.x,
            rate: line.y,
            sigma_px: sigma,
            inlier_fraction: inliers / observations.len() as f64,
            inliers,
            weights: sums.weights,
        })
    }
}

/// Performs the expectation step. Computes the weight of each observation under the current mixture, and the sums
/// that the maximization step needs.
fn expect(
    observations: &[Observation],
    line: &Vector2<f64>,
    sigma: f64,
    fractions: Fractions,
    range_s: f64,
) -> MixtureSums {
    let mut sums = MixtureSums::default();
    let outlier = fractions[SCALES.len()] / range_s;
    for o in observations {
        let r = (o.value_s - line.x - line.y * o.at_s) * o.across_px_s;
        // A density per second is the density per pixel times the speed.
        let peak = o.across_px_s.abs() / (sigma * std::f64::consts::TAU.sqrt());
        let gaussians = gaussians(r / sigma);
        let densities: [f64; SCALES.len()] =
            std::array::from_fn(|k| fractions[k] * peak / SCALES[k] * gaussians[k]);
        // The total is positive, since the fraction of outliers is positive.
        let total = outlier + densities.iter().sum::<f64>();
        // The expected precision (inverse variance) of the observation, relative to that of the narrowest component.
        let mut precision = 0.0;
        for (k, density) in densities.iter().enumerate() {
            sums.counts[k] += density / total;
            precision += density / total / (SCALES[k] * SCALES[k]);
        }
        sums.counts[SCALES.len()] += outlier / total;
        sums.squares += precision * r * r;
        sums.weights.push(precision / (sigma * sigma));
    }
    sums
}

/// Returns the values of the three inlier components' Gaussians at a residual of `z` standard deviations of the
/// narrowest component. Each Gaussian has a maximum of 1.
fn gaussians(z: f64) -> [f64; SCALES.len()] {
    const POWER: i32 = (SCALE_RATIO * SCALE_RATIO) as i32;
    let z = z / SCALES[2];
    // Each Gaussian is a power of the next wider one. A power costs less than another exponential.
    let wide = (-0.5 * z * z).exp();
    let middle = wide.powi(POWER);
    [middle.powi(POWER), middle, wide]
}

/// Fractions of observations in the three inlier components and, last, among the outliers.
type Fractions = [f64; SCALES.len() + 1];

/// Sums over the observations that the maximization step of EM needs.
#[derive(Default)]
struct MixtureSums {
    /// The expected number of observations in each inlier component and, last, among the outliers.
    counts: Fractions,
    /// The sum of the squared residuals, px². Each is multiplied by the observation's expected precision (inverse
    /// variance) relative to that of the narrowest component.
    squares: f64,
    /// The weight of each observation's squared residual, 1 / px².
    weights: Vec<f64>,
}

impl MixtureSums {
    fn inliers(&self) -> f64 {
        self.counts[..SCALES.len()].iter().sum()
    }
}

/// Returns the weighted least-squares line as (offset at time 0, slope). The slope is 0 unless `with_rate` is true.
/// `None` if the observations do not determine the line.
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

    /// Checks the errors of 3000 random problems with as many outliers as inliers. The standard error of an efficient
    /// estimate is √(σ² / Σ v²), where v is the speed of an inlier. The root-mean-square error is at most a quarter
    /// larger than this standard error.
    #[test]
    fn thousands_of_random_problems_are_solved_efficiently() {
        let random = &mut Random::new(1);
        let (mut squares, mut wrong) = (0.0, 0);
        for _ in 0..3000 {
            let observations = problem(random, 60, 60, 0.0);
            let start = consensus_value(&observations).unwrap().0;
            let mixture = Mixture::fit(&observations, 1.0, start, false).unwrap();
            let information: f64 =
                observations[..60].iter().map(|o| o.across_px_s.powi(2)).sum::<f64>() / 0.09;
            let z = (mixture.value_s - 0.3) * information.sqrt();
            squares += z * z;
            wrong += usize::from(z.abs() > 6.0);
        }
        assert_eq!(wrong, 0);
        let rms = (squares / 3000.0).sqrt();
        assert!(rms < 1.25, "{rms}");
    }

    #[test]
    fn slopes_are_estimated() {
        let random = &mut Random::new(2);
        for _ in 0..1000 {
            let observations = problem(random, 100, 40, 0.01);
            let start = consensus_value(&observations).unwrap().0;
            let mixture = Mixture::fit(&observations, 1.0, start, true).unwrap();
            assert!((mixture.rate - 0.01).abs() < 0.008, "{mixture:?}");
            assert!((mixture.value_s - 0.3).abs() < 0.04);
        }
    }

    #[test]
    fn gaussians_are_exponentials() {
        for k in -4000..4000 {
            let z = 0.01 * f64::from(k);
            for (gaussian, scale) in gaussians(z).into_iter().zip(SCALES) {
                let expected = (-0.5 * (z / scale) * (z / scale)).exp();
                assert!((gaussian - expected).abs() <= 1e-12 * expected + 1e-300, "{z} {scale}");
            }
        }
    }

    #[test]
    fn degenerate_observations() {
        assert_eq!(consensus_value(&[]), None);
        assert_eq!(Mixture::fit(&[], 1.0, 0.0, false), None);
        let one = Observation { value_s: 0.4, at_s: 1.0, across_px_s: 5.0 };
        let mixture = Mixture::fit(&[one; 3], 1.0, 0.4, false).unwrap();
        assert!((mixture.value_s - 0.4).abs() < 1e-12 && mixture.sigma_px == MIN_PX);
        // All observations have the same time, so the slope is undetermined.
        assert_eq!(Mixture::fit(&[one; 3], 1.0, 0.4, true), None);
        let still = Observation { across_px_s: 0.0, ..one };
        assert_eq!(Mixture::fit(&[still; 3], 1.0, 0.4, false), None);
    }
}
