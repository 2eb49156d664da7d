//! The clock model of one camera, fitted to its lag observations. Two exact steps alternate: lost frames for
//! a given line (a shortest path, by dynamic programming), and the line for given lost frames (least squares
//! over the inliers).
//!
//! A lag, in frames, is modelled as `offset + rate · elapsed + lost(image)`, where `lost` counts the frames
//! missing up to an image: a step function that never descends.
//!
//! Costs and penalties are in units of outliers: an outlier costs 1.

use crate::capture::MAX_DRIFT_PPM;
use crate::offset::clock::{ClockModel, NominalClock};
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;

/// The standard deviation of an inlier's lag, frames.
const SIGMA_FRAMES: f64 = 0.08;
/// The residual beyond which an observation is an outlier, frames: three standard deviations.
pub const INLIER_BOUND_FRAMES: f64 = 3.0 * SIGMA_FRAMES;
/// The length of an interval, frames, above which the uncertainty of its observations no longer grows.
const MAX_LENGTH_FRAMES: f64 = 2.0;
/// The maximum length of an interval, frames, whose observations are used to fit offset and rate. It allows
/// for jitter of time stamps.
const MAX_INTERVAL_FRAMES: f64 = 1.5;
/// The standard deviation of the prior on a drifting clock's rate, seconds per second.
const RATE_SIGMA: f64 = 5e-4;
/// The standard deviation that holds the rate of a clock without drift at 0.
const NO_DRIFT_SIGMA: f64 = 1e-9;
/// The largest rate from which a fit is started, seconds per second.
const MAX_RATE: f64 = 1e-6 * MAX_DRIFT_PPM;
/// The maximum number of starting rates on either side of 0.
const MAX_RATE_STEPS: f64 = 1e3;
/// The weight, in observations, of the prior that holds the offset if no observation is an inlier.
const OFFSET_PRIOR_WEIGHT: f64 = 1e-3;
/// The penalty of each further frame lost at the same image, in outliers.
const FURTHER_LOSS_PENALTY: f64 = 0.3;
/// The maximum loss count relative to the line. Computing time grows with its square.
const MAX_LOST: i32 = 40;
/// The maximum number of observed lags that are tried as initial offsets.
const MAX_STARTS: usize = 64;
/// The maximum number of iterations of the two steps.
const MAX_ALTERNATIONS: usize = 12;
/// The decrease of the cost below which the alternation has converged.
const COST_TOLERANCE: f64 = 1e-9;

/// The penalty of a gap in which this number of frames is lost, in outliers.
pub fn gap_penalty(frames: u32, loss_penalty: f64) -> f64 {
    match frames {
        0 => 0.0,
        _ => loss_penalty + FURTHER_LOSS_PENALTY * f64::from(frames - 1),
    }
}

/// The lags to which a camera's clock model is fitted, and the constraints on its lost frames.
pub struct LagProblem<'a> {
    pub lags: &'a [LagObservation],
    pub clock: &'a NominalClock<'a>,
    /// The penalty of one lost frame, in outliers.
    pub loss_penalty: f64,
    /// Whether the loss count may also descend. It does where the other cameras lost a frame.
    pub allow_steps_back: bool,
}

/// A fitted clock model with its cost.
pub struct ClockFit {
    pub clock: ClockModel,
    /// The sum of truncated squared residuals and penalties, in outliers.
    pub cost: f64,
    /// The images before which the loss count descends, one entry for each frame; empty unless
    /// [`LagProblem::allow_steps_back`] is set.
    pub steps_back: Vec<usize>,
}

impl ClockFit {
    /// The nominal clock: offset and cost are 0.
    pub fn nominal(clock: &NominalClock) -> Self {
        let clock = ClockModel { reference_s: clock.times_s[0], ..ClockModel::default() };
        Self { clock, cost: 0.0, steps_back: Vec::new() }
    }
}

/// The lag of a camera at one point of its recording. The point is at `fraction` of the interval from `image`
/// to the next image (0: at `image` itself).
#[derive(Clone, Copy, Debug)]
pub struct LagObservation {
    pub image: usize,
    pub fraction: f64,
    /// Common time minus nominal time, frames.
    pub lag_frames: f64,
    /// Nominal time since the camera's first image, frames.
    pub elapsed_frames: f64,
    /// The length of the interval in which the point's time was interpolated, frames. For an interval of the
    /// camera itself, frames lost in it are not counted.
    pub interval_frames: f64,
}

impl LagObservation {
    /// The lag minus the lag of the line, frames.
    fn lag_beyond(&self, line: &Vector2<f64>) -> f64 {
        self.lag_frames - line.x - line.y * self.elapsed_frames
    }

    /// The residual, frames, for the loss counts `lost`: the numbers of frames missing up to the image, and
    /// up to the next one.
    pub fn residual(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let [before, after] = lost.map(f64::from);
        self.lag_beyond(line) - before - self.fraction * (after - before)
    }

    /// The robust loss for the loss counts `lost`: the numbers of frames missing up to the image, and up to
    /// the next one.
    pub fn cost(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let interval_frames = self.interval_frames + f64::from(lost[1] - lost[0]);
        robust_loss(self.residual(line, lost), interval_frames)
    }
}

/// The robust loss of a residual, frames, whose time was interpolated in an interval of `interval_frames`. It
/// is the negative log-likelihood of a Gaussian relative to that of an outlier, truncated at 1.
///
/// Trajectories are cubic curves, fitted as if no frame were missing. In a longer interval the standard
/// deviation of times therefore grows with the third power of the interval's length.
pub fn robust_loss(residual: f64, interval_frames: f64) -> f64 {
    let factor = interval_frames.clamp(1.0, MAX_LENGTH_FRAMES).powi(3);
    let variance_term = 2.0 * factor.ln() / (INLIER_BOUND_FRAMES / SIGMA_FRAMES).powi(2);
    ((residual / (factor * INLIER_BOUND_FRAMES)).powi(2) + variance_term).min(1.0)
}

/// A camera's lags as a line plus a step function.
struct StepFit {
    /// Offset in frames, and rate in frames per frame.
    line: Vector2<f64>,
    /// The images at which lags are observed, ascending.
    images: Vec<usize>,
    /// The number of frames lost up to each of these images, relative to the line.
    loss_counts: Vec<i32>,
    cost: f64,
}

impl LagProblem<'_> {
    /// Fits the clock model of minimum cost over all starting rates; the nominal clock without
    /// observations.
    pub fn fit(&self) -> ClockFit {
        let mut best: Option<StepFit> = None;
        for rate in self.rate_grid() {
            let Some(offset) = self.initial_offset(rate) else { continue };
            let fit = self.alternate(Vector2::new(offset, rate));
            if best.as_ref().is_none_or(|b| fit.cost < b.cost) {
                best = Some(fit);
            }
        }
        best.map_or_else(|| ClockFit::nominal(self.clock), |fit| fit.into_clock_fit(self.clock))
    }

    /// The starting rates. They are so close that one of them is within the inlier bound over the whole
    /// recording; only 0 for a clock without drift.
    fn rate_grid(&self) -> Vec<f64> {
        if !self.clock.drifts {
            return vec![0.0];
        }
        let (first, last) =
            self.lags.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), o| {
                (f.min(o.elapsed_frames), l.max(o.elapsed_frames))
            });
        let steps = MAX_RATE * (last - first) / INLIER_BOUND_FRAMES;
        let steps = steps.clamp(0.0, MAX_RATE_STEPS) as i32;
        let step = MAX_RATE / f64::from(steps.max(1));
        (-steps..=steps).map(|n| f64::from(n) * step).collect()
    }

    /// The observed lag of minimum robust loss at a given rate, frames; `None` without observations. For a
    /// camera that may lose frames, residuals are taken modulo whole frames.
    fn initial_offset(&self, rate: f64) -> Option<f64> {
        let line = Vector2::new(0.0, rate);
        let mut values: Vec<f64> = self.lags.iter().map(|o| o.lag_beyond(&line)).collect();
        values.sort_by(f64::total_cmp);
        let consensus = |offset: f64| {
            let whole = |residual: f64| {
                if self.clock.may_lose_frames { residual.round() } else { 0.0 }
            };
            let residuals = values.iter().map(|v| v - offset);
            residuals.map(|r| 1.0 - robust_loss(r - whole(r), 1.0)).sum::<f64>()
        };
        let count = values.len().min(MAX_STARTS);
        (0..count)
            .map(|k| values[(2 * k + 1) * values.len() / (2 * count)])
            .map(|value| (consensus(value), value))
            .max_by(|x, y| x.0.total_cmp(&y.0))
            .map(|(_, value)| value)
    }

    /// Alternates [`shortest_path`](Self::shortest_path) and [`refit_line`](Self::refit_line) until
    /// the cost no longer decreases.
    fn alternate(&self, line: Vector2<f64>) -> StepFit {
        let mut fit = self.shortest_path(line);
        for _ in 0..MAX_ALTERNATIONS {
            let next = self.shortest_path(self.refit_line(&fit));
            let converged = next.cost >= fit.cost - COST_TOLERANCE;
            if next.cost < fit.cost {
                fit = next;
            }
            if converged {
                break;
            }
        }
        fit
    }

    /// The loss counts of minimum cost for a given line. They are the shortest path through a trellis with
    /// one column for each observed image and one node for each loss count. Observations at an image are
    /// costs of nodes, those between two images are costs of edges.
    fn shortest_path(&self, line: Vector2<f64>) -> StepFit {
        let mut by_image: BTreeMap<usize, [Vec<LagObservation>; 2]> = BTreeMap::new();
        for o in self.lags {
            let is_between = o.fraction != 0.0;
            by_image.entry(o.image).or_default()[usize::from(is_between)].push(*o);
            by_image.entry(o.image + usize::from(is_between)).or_default();
        }
        let counts = self.candidate_loss_counts(&line);
        let rate = if self.clock.drifts { line.y / RATE_SIGMA } else { 0.0 };
        // The prior on the rate, scaled as in `robust_loss`, where 3 σ cost 1.
        let mut costs = vec![rate * rate / 9.0; counts.len()];
        let mut predecessors: Vec<Vec<usize>> = Vec::with_capacity(by_image.len());
        for [at_image, between] in by_image.values() {
            for (total, count) in costs.iter_mut().zip(&counts) {
                *total += at_image.iter().map(|o| o.cost(&line, [*count; 2])).sum::<f64>();
            }
            if predecessors.len() + 1 == by_image.len() {
                break;
            }
            let edge = |from: usize, to: usize| {
                let lost = [counts[from], counts[to]];
                let observed = between.iter().map(|o| o.cost(&line, lost)).sum::<f64>();
                let frames = (lost[1] - lost[0]).unsigned_abs();
                costs[from] + observed + gap_penalty(frames, self.loss_penalty)
            };
            let cheapest_edge = |to: usize| {
                // Without steps back, the loss count never descends.
                let end = if self.allow_steps_back { counts.len() } else { to + 1 };
                let edges = (0..end).map(|from| (edge(from, to), from));
                edges.min_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((0.0, to))
            };
            let (next, from) = (0..counts.len()).map(cheapest_edge).unzip();
            costs = next;
            predecessors.push(from);
        }
        let ends = costs.into_iter().enumerate().min_by(|x, y| x.1.total_cmp(&y.1));
        let (mut node, cost) = ends.unwrap_or((0, 0.0));
        let mut loss_counts = vec![counts[node]];
        for from in predecessors.iter().rev() {
            node = from[node];
            loss_counts.push(counts[node]);
        }
        loss_counts.reverse();
        StepFit { line, images: by_image.into_keys().collect(), loss_counts, cost }
    }

    /// All loss counts from the smallest to the largest observed, relative to the line, including 0; only 0
    /// for a camera that loses no frames.
    fn candidate_loss_counts(&self, line: &Vector2<f64>) -> Vec<i32> {
        if !self.clock.may_lose_frames {
            return vec![0];
        }
        let limit = f64::from(MAX_LOST);
        let count = |o: &LagObservation| o.lag_beyond(line).round().clamp(-limit, limit) as i32;
        let counts = self.lags.iter().map(count);
        let (min, max) = counts.fold((0, 0), |(min, max), n| (min.min(n), max.max(n)));
        (min..=max).collect()
    }

    /// The least-squares line through the inliers of a fit, with Gaussian priors on offset and rate.
    fn refit_line(&self, fit: &StepFit) -> Vector2<f64> {
        let rate_sigma = if self.clock.drifts { RATE_SIGMA } else { NO_DRIFT_SIGMA };
        let mut normal =
            Matrix2::from_diagonal(&Vector2::new(OFFSET_PRIOR_WEIGHT, rate_sigma.powi(-2)));
        let mut right = Vector2::new(OFFSET_PRIOR_WEIGHT * fit.line.x, 0.0);
        for o in self.lags {
            let lost = fit.lost_around(o);
            let residual = o.residual(&fit.line, lost);
            let interval_frames = o.interval_frames + f64::from(lost[1] - lost[0]);
            // Times in longer intervals are too uncertain to contribute.
            if residual.abs() < INLIER_BOUND_FRAMES && interval_frames < MAX_INTERVAL_FRAMES {
                let row = Vector2::new(1.0, o.elapsed_frames) / SIGMA_FRAMES;
                let value = (residual + fit.line.x + fit.line.y * o.elapsed_frames) / SIGMA_FRAMES;
                normal += row * row.transpose();
                right += row * value;
            }
        }
        // The priors keep the normal matrix positive definite.
        normal.cholesky().map_or(fit.line, |c| c.solve(&right))
    }
}

impl StepFit {
    /// The numbers of frames lost up to an observation's image, and up to the next one.
    fn lost_around(&self, o: &LagObservation) -> [i32; 2] {
        let n = self.images.partition_point(|n| *n < o.image);
        [n, n + usize::from(o.fraction != 0.0)].map(|n| self.loss_counts[n])
    }

    fn into_clock_fit(self, nominal: &NominalClock) -> ClockFit {
        let (mut lost_before, mut steps_back) = (Vec::new(), Vec::new());
        for (pair, image) in self.loss_counts.windows(2).zip(&self.images[1..]) {
            let step = pair[1] - pair[0];
            let images = std::iter::repeat_n(*image, step.unsigned_abs() as usize);
            if step > 0 { lost_before.extend(images) } else { steps_back.extend(images) }
        }
        let offset_s = nominal.frame_s * (self.line.x + f64::from(self.loss_counts[0]));
        let (rate, reference_s) = (self.line.y, nominal.times_s[0]);
        let clock = ClockModel { offset_s, rate, reference_s, lost_before };
        ClockFit { clock, cost: self.cost, steps_back }
    }
}
