//! The clock model of one camera, fitted to its lag observations by alternating two exact steps:
//! lost frames for a given line (a shortest path, by dynamic programming), and the line for given
//! lost frames (least squares over the inliers).
//!
//! A lag, in frames, is modelled as `offset + rate · elapsed + lost(image)`, where `lost` counts the
//! frames missing up to an image. It is a step function of the image that only ascends.

use crate::capture::MAX_DRIFT_PPM;
use crate::offset::clock::{ClockModel, NominalClock};
use nalgebra::{Matrix2, Vector2};

/// The standard deviation of an inlier's lag, frames.
const SIGMA_FRAMES: f64 = 0.08;
/// The residual beyond which an observation is an outlier, frames: three standard deviations.
pub const INLIER_BOUND_FRAMES: f64 = 3.0 * SIGMA_FRAMES;
/// The interval, frames, up to which the uncertainty of observations grows with its length.
const MAX_LENGTH_FRAMES: f64 = 2.0;
/// The longest interval whose observations determine a camera's offset and rate, frames. It allows for
/// jitter of time stamps.
const MAX_INTERVAL_FRAMES: f64 = 1.5;
/// The standard deviation of the prior on a drifting clock's rate, seconds a second.
const RATE_SIGMA: f64 = 5e-4;
/// The standard deviation that holds the rate of a clock without drift at 0.
const NO_DRIFT_SIGMA: f64 = 1e-9;
/// The largest rate that is tried as a start, seconds a second.
const MAX_RATE: f64 = 1e-6 * MAX_DRIFT_PPM;
/// The maximum number of rate steps to either side of 0.
const MAX_RATE_STEPS: f64 = 1e3;
/// The weight, in observations, of the prior that holds the offset if no observation is an inlier.
const OFFSET_PRIOR_WEIGHT: f64 = 1e-3;
/// The penalty of each further frame lost at the same image, in outliers.
const FURTHER_LOSS_PENALTY: f64 = 0.3;
/// The largest loss count relative to the line. Time grows with its square.
const MAX_LOST: i32 = 40;
/// The maximum number of observed lags that are tried as initial offsets.
const MAX_STARTS: usize = 64;
/// The maximum number of alternations of the two steps.
const MAX_ALTERNATIONS: usize = 12;
/// The decrease of the cost below which the alternation has converged.
const COST_TOLERANCE: f64 = 1e-9;

/// The penalty of a number of frames lost between two images, in outliers.
pub fn gap_penalty(frames: u32, loss_penalty: f64) -> f64 {
    match frames {
        0 => 0.0,
        _ => loss_penalty + FURTHER_LOSS_PENALTY * f64::from(frames - 1),
    }
}

/// Fits the clock model of minimum cost over all starting rates; the nominal clock without
/// observations.
pub fn fit_clock_model(
    lags: &[LagObservation],
    clock: &NominalClock,
    options: FitOptions,
) -> ClockFit {
    let mut best: Option<StepFit> = None;
    for rate in rate_grid(clock, lags) {
        let Some(offset) = initial_offset(lags, rate, clock.may_lose_frames) else { continue };
        let fit = StepFit::alternating(lags, clock, Vector2::new(offset, rate), options);
        if best.as_ref().is_none_or(|b| fit.cost < b.cost) {
            best = Some(fit);
        }
    }
    best.map_or_else(|| ClockFit::nominal(clock), |fit| fit.into_clock_fit(clock))
}

/// The admissible loss sequences, and their penalty.
#[derive(Clone, Copy)]
pub struct FitOptions {
    /// The penalty of one lost frame, in outliers.
    pub loss_penalty: f64,
    /// Whether the loss count may also descend, where the other cameras lost a frame.
    pub allow_steps_back: bool,
}

/// A fitted clock model with its cost.
pub struct ClockFit {
    pub clock: ClockModel,
    /// The sum of truncated squares and penalties, in outliers.
    pub cost: f64,
    /// The images before which the loss count descends, one entry for each frame; empty unless
    /// [`FitOptions::allow_steps_back`] is set.
    pub steps_back: Vec<usize>,
}

impl ClockFit {
    /// The nominal clock, with an offset of 0.
    pub fn nominal(clock: &NominalClock) -> Self {
        let clock = ClockModel { reference_s: clock.times_s[0], ..ClockModel::default() };
        Self { clock, cost: 0.0, steps_back: Vec::new() }
    }
}

/// The lag of a camera at a point of its recording: at `fraction` of the interval from `image` to the
/// next one (0: at the image itself).
#[derive(Clone, Copy, Debug)]
pub struct LagObservation {
    pub image: usize,
    pub fraction: f64,
    /// Common time minus nominal time, frames.
    pub lag_frames: f64,
    /// Nominal time since the camera's first image, frames.
    pub elapsed_frames: f64,
    /// The length of the interval in which the time was interpolated, frames. If the interval is the
    /// camera's own, frames lost in it do not count.
    pub interval_frames: f64,
}

impl LagObservation {
    /// The lag minus the line's offset and rate, frames.
    fn lag_beyond(&self, line: &Vector2<f64>) -> f64 {
        self.lag_frames - line.x - line.y * self.elapsed_frames
    }

    /// The residual, frames, for the given numbers of frames lost up to the image and up to the next
    /// one.
    pub fn residual(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let [before, after] = lost.map(f64::from);
        self.lag_beyond(line) - before - self.fraction * (after - before)
    }

    /// The robust loss for the given numbers of frames lost up to the image and up to the next one.
    pub fn cost(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let interval_frames = self.interval_frames + f64::from(lost[1] - lost[0]);
        robust_loss(self.residual(line, lost), interval_frames)
    }
}

/// The robust loss of a residual, frames, of a time interpolated in an interval of a number of frames:
/// the negative log-likelihood of a Gaussian over that of an outlier, truncated at 1.
///
/// Trajectories are curves of third order, fitted as if no frame were missing. The standard deviation
/// of times in a longer interval grows with the third power of its length.
pub fn robust_loss(residual: f64, interval_frames: f64) -> f64 {
    let factor = interval_frames.clamp(1.0, MAX_LENGTH_FRAMES).powi(3);
    let variance_term = 2.0 * factor.ln() / (INLIER_BOUND_FRAMES / SIGMA_FRAMES).powi(2);
    ((residual / (factor * INLIER_BOUND_FRAMES)).powi(2) + variance_term).min(1.0)
}

/// The starting rates, spaced so that one of them is within the inlier bound over the whole recording;
/// 0 alone for a clock without drift.
fn rate_grid(clock: &NominalClock, lags: &[LagObservation]) -> Vec<f64> {
    if !clock.drifts {
        return vec![0.0];
    }
    let (first, last) = lags.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), o| {
        (f.min(o.elapsed_frames), l.max(o.elapsed_frames))
    });
    let steps = (MAX_RATE * (last - first) / INLIER_BOUND_FRAMES).clamp(0.0, MAX_RATE_STEPS) as i32;
    let step = MAX_RATE / f64::from(steps.max(1));
    (-steps..=steps).map(|n| f64::from(n) * step).collect()
}

/// The observed lag of minimum robust loss at a given rate, frames; `None` without observations. For a
/// camera that may lose frames, residuals are modulo whole frames.
fn initial_offset(lags: &[LagObservation], rate: f64, may_lose_frames: bool) -> Option<f64> {
    let mut values: Vec<f64> =
        lags.iter().map(|o| o.lag_beyond(&Vector2::new(0.0, rate))).collect();
    values.sort_by(f64::total_cmp);
    let consensus = |offset: f64| {
        let residual = |v: &f64| {
            if may_lose_frames { v - offset - (v - offset).round() } else { v - offset }
        };
        values.iter().map(|v| 1.0 - robust_loss(residual(v), 1.0)).sum::<f64>()
    };
    let count = values.len().min(MAX_STARTS);
    (0..count)
        .map(|k| values[(2 * k + 1) * values.len() / (2 * count)])
        .map(|value| (consensus(value), value))
        .max_by(|x, y| x.0.total_cmp(&y.0))
        .map(|(_, value)| value)
}

/// A line plus a step function, fitted to a camera's lags.
struct StepFit {
    /// Offset in frames, and rate in frames a frame.
    line: Vector2<f64>,
    /// The images at which lags are observed, ascending.
    images: Vec<usize>,
    /// The number of frames lost up to each of these images, relative to the line.
    loss_counts: Vec<i32>,
    cost: f64,
}

impl StepFit {
    /// Alternates [`shortest_path`](Self::shortest_path) and [`refit_line`](Self::refit_line) until
    /// the cost no longer decreases.
    fn alternating(
        lags: &[LagObservation],
        clock: &NominalClock,
        line: Vector2<f64>,
        options: FitOptions,
    ) -> Self {
        let mut fit = Self::shortest_path(lags, clock, line, options);
        for _ in 0..MAX_ALTERNATIONS {
            let next = Self::shortest_path(lags, clock, fit.refit_line(lags, clock), options);
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

    /// The loss counts of minimum cost for a given line: the shortest path through a trellis with
    /// one column for each observed image and one node for each loss count.
    fn shortest_path(
        lags: &[LagObservation],
        clock: &NominalClock,
        line: Vector2<f64>,
        options: FitOptions,
    ) -> Self {
        let mut images: Vec<usize> =
            lags.iter().flat_map(|o| [o.image, o.image + usize::from(o.fraction != 0.0)]).collect();
        images.sort_unstable();
        images.dedup();
        let mut by_image = vec![Vec::new(); images.len()];
        for o in lags {
            by_image[images.partition_point(|n| *n < o.image)].push(*o);
        }
        let counts = candidate_loss_counts(lags, clock, &line);
        let rate = if clock.drifts { line.y / RATE_SIGMA } else { 0.0 };
        // The prior of the rate, in the units of `robust_loss`: the bound is 3 σ.
        let trellis = Trellis { line, counts, options, prior: rate * rate / 9.0 };
        let (loss_counts, cost) = trellis.shortest_path(&by_image);
        Self { line, images, loss_counts, cost }
    }

    /// The frames lost up to an observation's image, and up to the next one.
    fn lost_around(&self, o: &LagObservation) -> [i32; 2] {
        let n = self.images.partition_point(|n| *n < o.image);
        let next = if o.fraction == 0.0 { n } else { n + 1 };
        [self.loss_counts[n], self.loss_counts[next]]
    }

    /// The least-squares line through the inliers, with Gaussian priors on offset and rate.
    fn refit_line(&self, lags: &[LagObservation], clock: &NominalClock) -> Vector2<f64> {
        let rate_sigma = if clock.drifts { RATE_SIGMA } else { NO_DRIFT_SIGMA };
        let mut normal =
            Matrix2::from_diagonal(&Vector2::new(OFFSET_PRIOR_WEIGHT, rate_sigma.powi(-2)));
        let mut right = Vector2::new(OFFSET_PRIOR_WEIGHT * self.line.x, 0.0);
        for o in lags {
            let lost = self.lost_around(o);
            let residual = o.residual(&self.line, lost);
            let interval_frames = o.interval_frames + f64::from(lost[1] - lost[0]);
            // Times in longer intervals are too uncertain to add anything.
            if residual.abs() < INLIER_BOUND_FRAMES && interval_frames < MAX_INTERVAL_FRAMES {
                let row = Vector2::new(1.0, o.elapsed_frames) / SIGMA_FRAMES;
                let value =
                    (residual + self.line.x + self.line.y * o.elapsed_frames) / SIGMA_FRAMES;
                normal += row * row.transpose();
                right += row * value;
            }
        }
        // The priors keep the normal matrix positive definite.
        normal.cholesky().map_or(self.line, |c| c.solve(&right))
    }

    fn into_clock_fit(self, nominal: &NominalClock) -> ClockFit {
        let Some(&first) = self.loss_counts.first() else { return ClockFit::nominal(nominal) };
        let (mut lost_before, mut steps_back) = (Vec::new(), Vec::new());
        for (pair, image) in self.loss_counts.windows(2).zip(&self.images[1..]) {
            let step = pair[1] - pair[0];
            let images = std::iter::repeat_n(*image, step.unsigned_abs() as usize);
            if step > 0 { lost_before.extend(images) } else { steps_back.extend(images) }
        }
        let offset_s = nominal.frame_s * (self.line.x + f64::from(first));
        let (rate, reference_s) = (self.line.y, nominal.times_s[0]);
        let clock = ClockModel { offset_s, rate, reference_s, lost_before };
        ClockFit { clock, cost: self.cost, steps_back }
    }
}

/// The graph of the dynamic program: nodes are (image, loss count), edges connect successive images.
struct Trellis {
    line: Vector2<f64>,
    /// The loss counts of each column, ascending and without gaps.
    counts: Vec<i32>,
    options: FitOptions,
    /// The cost of the line itself.
    prior: f64,
}

impl Trellis {
    /// The loss count at each image on the path of minimum cost, and that cost. Observations at an
    /// image are costs of nodes, those between two images costs of edges.
    fn shortest_path(&self, by_image: &[Vec<LagObservation>]) -> (Vec<i32>, f64) {
        let mut costs = vec![self.prior; self.counts.len()];
        let mut predecessors: Vec<Vec<usize>> = Vec::with_capacity(by_image.len());
        for (n, lags) in by_image.iter().enumerate() {
            let (at_image, between): (Vec<LagObservation>, Vec<LagObservation>) =
                lags.iter().partition(|o| o.fraction == 0.0);
            for (total, count) in costs.iter_mut().zip(&self.counts) {
                *total += at_image.iter().map(|o| o.cost(&self.line, [*count; 2])).sum::<f64>();
            }
            if n + 1 == by_image.len() {
                break;
            }
            let steps = (0..self.counts.len()).map(|to| self.cheapest_edge(&costs, to, &between));
            let (next, from) = steps.unzip();
            costs = next;
            predecessors.push(from);
        }
        let ends = costs.iter().copied().enumerate().min_by(|x, y| x.1.total_cmp(&y.1));
        let (mut node, cost) = ends.unwrap_or((0, 0.0));
        let first = self.counts.first().copied().unwrap_or(0);
        let mut loss_counts = vec![first + node as i32];
        for from in predecessors.iter().rev() {
            node = from[node];
            loss_counts.push(first + node as i32);
        }
        loss_counts.reverse();
        (loss_counts, cost)
    }

    /// The minimum cost of the node `to` of the next column, and its predecessor, given the costs of
    /// this column and the observations between the two images.
    fn cheapest_edge(&self, costs: &[f64], to: usize, between: &[LagObservation]) -> (f64, usize) {
        // Lost frames do not come back: the count never descends.
        let predecessors =
            if self.options.allow_steps_back { 0..self.counts.len() } else { 0..to + 1 };
        predecessors
            .map(|from| {
                let lost = [self.counts[from], self.counts[to]];
                let edge = between.iter().map(|o| o.cost(&self.line, lost));
                let frames = (lost[1] - lost[0]).unsigned_abs();
                let penalty = gap_penalty(frames, self.options.loss_penalty);
                (costs[from] + edge.sum::<f64>() + penalty, from)
            })
            .min_by(|x, y| x.0.total_cmp(&y.0))
            .unwrap_or((0.0, to))
    }
}

/// The range of the observed loss counts, relative to the line; 0 alone for a camera that loses no
/// frames.
fn candidate_loss_counts(
    lags: &[LagObservation],
    clock: &NominalClock,
    line: &Vector2<f64>,
) -> Vec<i32> {
    if !clock.may_lose_frames {
        return vec![0];
    }
    let limit = f64::from(MAX_LOST);
    let (min, max) = lags
        .iter()
        .map(|o| o.lag_beyond(line).round().clamp(-limit, limit) as i32)
        .fold((0, 0), |(l, m), count| (l.min(count), m.max(count)));
    (min..=max).collect()
}
