//! The growth of a cost: the exponent of a power law, by least squares of logarithms.

/// cost ≈ c · size^exponent.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    pub exponent: f64,
    /// From the points' scatter about the line; NaN for two points, which have none.
    pub std_err: f64,
}

/// From (size, cost), at least two of them, all positive and the sizes not all alike.
pub fn growth(points: &[(f64, f64)]) -> Growth {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n;
    let (mx, my) = (mean(|l| l.0), mean(|l| l.1));
    let xx: f64 = logs.iter().map(|l| (l.0 - mx).powi(2)).sum();
    let xy: f64 = logs.iter().map(|l| (l.0 - mx) * (l.1 - my)).sum();
    let exponent = xy / xx;
    let residual: f64 = logs.iter().map(|l| (l.1 - my - exponent * (l.0 - mx)).powi(2)).sum();
    Growth { exponent, std_err: (residual / (n - 2.0) / xx).sqrt() }
}
