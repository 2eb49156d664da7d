//! Computes the robust mean of the offset candidates of one frame triple (two frames of one camera, one frame of
//! another; §7): exhaustive RANSAC, then weighted least squares (WLS), eqs. (11) to (13).
//!
//! Known limit: the weights do not depend on the speeds of the features, although a slow feature's candidate is less
//! certain.

/// Returns the largest set of values within `tolerance` of one of the values (the RANSAC inliers), as an index range
/// of `values`.
///
/// `values` must be ascending. `tolerance` has the same unit; a negative tolerance counts as 0. Every value is tried
/// as the model. Of several models with equally many inliers, the first is taken. Without values the range is empty.
pub fn ransac(values: &[f64], tolerance: f64) -> std::ops::Range<usize> {
    let tolerance = tolerance.max(0.0);
    let mut best = 0..0;
    let (mut low, mut high) = (0, 0);
    for &candidate in values {
        while values[low] < candidate - tolerance {
            low += 1;
        }
        while high < values.len() && values[high] <= candidate + tolerance {
            high += 1;
        }
        if high - low > best.len() {
            best = low..high;
        }
    }
    best
}

/// Maximum number of iterations of weighted least squares.
const MAX_ITERATIONS: usize = 100;
/// Convergence threshold of [`weighted_least_squares`]: the change |t̃_new − t̃_old| · γ of the mean t̃ by one iteration.
const TOLERANCE: f64 = 1e-9;

/// Returns the mean by iterated weighted least squares, eqs. (11) to (13). The iteration starts at the unweighted mean
/// t̃. Each step computes the mean of the values t̃_k with the weights `exp(−γ |t̃ − t̃_k|)`, until it converges.
///
/// `gamma` is γ, in the inverse unit of `values`; at 0 the result is the unweighted mean. `None` if there are no
/// values. If all weights underflow, the result is the mean of the last iteration.
pub fn weighted_least_squares(values: &[f64], gamma: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let mut mean = values.iter().sum::<f64>() / values.len() as f64;
    for _ in 0..MAX_ITERATIONS {
        let (mut sum, mut weights) = (0.0, 0.0);
        for v in values {
            let w = (-gamma * (mean - v).abs()).exp();
            sum += w * v;
            weights += w;
        }
        if weights <= 0.0 {
            break;
        }
        let next = sum / weights;
        let converged = (next - mean).abs() * gamma < TOLERANCE;
        mean = next;
        if converged {
            break;
        }
    }
    Some(mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ransac_equals_an_exhaustive_search() {
        let mut values: Vec<f64> = (0..200).map(|k| (f64::from(k) * 12.9898).sin() * 3.0).collect();
        values.extend((0..30).map(|k| 0.7 + 0.001 * f64::from(k)));
        values.sort_by(f64::total_cmp);
        let naive = values
            .iter()
            .map(|c| values.iter().filter(|v| (*v - c).abs() <= 0.05).count())
            .max()
            .unwrap();
        let range = ransac(&values, 0.05);
        assert_eq!(range.len(), naive);
        assert!(values[range].contains(&0.7));
    }

    #[test]
    fn no_values_and_equal_values() {
        assert_eq!(ransac(&[], 0.1), 0..0);
        assert_eq!(ransac(&[2.0; 5], 0.0), 0..5);
        assert_eq!(ransac(&[1.0, 2.0], -1.0), 0..1);
        assert_eq!(weighted_least_squares(&[], 70.0), None);
        assert_eq!(weighted_least_squares(&[2.0; 5], 70.0), Some(2.0));
        assert!(weighted_least_squares(&[0.0, 1e9], 70.0).unwrap().is_finite());
    }

    #[test]
    fn wls_reduces_the_weight_of_an_outlier() {
        let mut values = vec![0.300, 0.301, 0.299, 0.3005, 0.2995];
        values.push(0.34);
        let mean = weighted_least_squares(&values, 70.0).unwrap();
        assert!((mean - 0.3).abs() < 0.003, "{mean}");
    }
}
