//! Planes in a view: inverse depth is linear in the image, `1/z = g · (x, y, 1)` at
//! (x, y) of the plane z = 1, exactly where `g · p_cam = 1`. Disparity between neighbouring
//! cameras is proportional to inverse depth, so least squares in it is least squares in pixels.

use super::rays::ViewBounds;
use nalgebra::{Matrix3, Point2, Vector3};

/// A point's projection in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProjectedPoint {
    /// Position on the plane z = 1.
    pub at: Point2<f64>,
    /// 1/m, positive.
    pub inverse_depth: f64,
    /// Weight in a fit, positive.
    pub weight: f64,
}

impl ProjectedPoint {
    pub fn ray(&self) -> Vector3<f64> {
        Vector3::new(self.at.x, self.at.y, 1.0)
    }
}

/// Weight of a prior of no tilt, as a fraction of the points'. Larger: true tilts are flattened.
/// Smaller: points that lie within a pixel or on a line tilt the plane by their noise.
const TILT_PRIOR: f64 = 1e-6;
/// Rounds of reweighting at most; it converges in about ten. Larger: slower where it alternates.
/// Smaller: outliers are not discounted fully.
const ROUNDS: usize = 20;
/// Smallest inverse depth of the plane anywhere in the view, as a fraction of that at the points' mean:
/// at 0 the plane would pass through infinity. Larger: steep planes are flattened. Smaller: corners
/// are far away.
const MIN_FRACTION: f64 = 0.1;

/// The points that a plane passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Through {
    /// All of them, outliers discounted by Cauchy's weights at the residuals' median.
    Middle,
    /// The farthest of them: points in front of the plane have this weight, those behind it 1.
    Back(f64),
}

/// The plane's g; `None` if the weights don't sum to a positive number.
pub(super) fn fit_plane(
    points: &[ProjectedPoint],
    through: Through,
    bounds: &ViewBounds,
) -> Option<Vector3<f64>> {
    let total: f64 = points.iter().map(|p| p.weight).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let mut g = Vector3::new(0.0, 0.0, weighted_median(points, |p| p.inverse_depth));
    for _ in 0..ROUNDS {
        let scale = match through {
            Through::Middle => weighted_median(points, |p| residual(p, &g).abs()),
            Through::Back(_) => 0.0,
        };
        let next = least_squares(points, |p| {
            let residual = residual(p, &g);
            match through {
                Through::Middle if scale > 0.0 => 1.0 / (1.0 + (residual / scale).powi(2)),
                Through::Back(weight) if residual > 0.0 => weight,
                _ => 1.0,
            }
        })?;
        if next == g {
            break;
        }
        g = next;
    }
    Some(flattened(g, points, bounds))
}

fn residual(p: &ProjectedPoint, g: &Vector3<f64>) -> f64 {
    p.inverse_depth - g.dot(&p.ray())
}

fn least_squares(
    points: &[ProjectedPoint],
    factor: impl Fn(&ProjectedPoint) -> f64,
) -> Option<Vector3<f64>> {
    let (mut normal, mut right, mut total) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for p in points {
        let (w, ray) = (p.weight * factor(p), p.ray());
        normal += ray * ray.transpose() * w;
        right += ray * (p.inverse_depth * w);
        total += w;
    }
    normal[(0, 0)] += TILT_PRIOR * total;
    normal[(1, 1)] += TILT_PRIOR * total;
    normal.cholesky().map(|c| c.solve(&right))
}

/// The plane with its tilt about the points' mean reduced until it lies in front of the whole view.
fn flattened(g: Vector3<f64>, points: &[ProjectedPoint], bounds: &ViewBounds) -> Vector3<f64> {
    let total: f64 = points.iter().map(|p| p.weight).sum();
    let mean_of = |f: &dyn Fn(&ProjectedPoint) -> f64| {
        points.iter().map(|p| p.weight * f(p)).sum::<f64>() / total
    };
    let ray = Vector3::new(mean_of(&|p| p.at.x), mean_of(&|p| p.at.y), 1.0);
    let nearest = points.iter().map(|p| p.inverse_depth).fold(f64::INFINITY, f64::min);
    // A fit to positive inverse depths is positive at their middle but for rounding.
    let middle = g.dot(&ray).max(nearest);
    let mut fraction: f64 = 1.0;
    for corner in bounds.corners() {
        let change = g.x * (corner.x - ray.x) + g.y * (corner.y - ray.y);
        if change < 0.0 {
            fraction = fraction.min(middle * (1.0 - MIN_FRACTION) / -change);
        }
    }
    let tilt = g.xy() * fraction;
    Vector3::new(tilt.x, tilt.y, middle - tilt.dot(&ray.xy()))
}

/// The lower weighted median.
fn weighted_median(points: &[ProjectedPoint], value: impl Fn(&ProjectedPoint) -> f64) -> f64 {
    let mut sorted: Vec<(f64, f64)> = points.iter().map(|p| (value(p), p.weight)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * sorted.iter().map(|p| p.1).sum::<f64>();
    let mut sum = 0.0;
    for &(value, weight) in &sorted {
        sum += weight;
        if sum >= half {
            return value;
        }
    }
    sorted.last().map_or(f64::NAN, |p| p.0)
}
