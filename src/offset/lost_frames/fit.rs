//! Fits the clock model of one camera to observations of its lag. The lag is the time on the common clock of all
//! cameras minus the camera's nominal time.
//!
//! A lag, in frames, is modelled as `offset + rate · elapsed + lost(image)`: a line plus a step function. The loss
//! count `lost` is the number of frames missing before an image, and never decreases. Two steps alternate. The first
//! finds the loss counts for a given line (a shortest path, by dynamic programming). The second finds the line for
//! given loss counts (least squares over the inliers).
//!
//! Costs and penalties are multiples of the cost of an outlier, which is 1.

use crate::capture::MAX_DRIFT_PPM;
use crate::offset::clock::{ClockModel, NominalClock};
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;

/// The standard deviation of the error of an inlier's lag (common time minus nominal time), frames.
const SIGMA_FRAMES: f64 = 0.08;
/// The residual of a lag (common time minus nominal time) beyond which an observation is an outlier, frames: three
/// standard deviations.
pub const INLIER_BOUND_FRAMES: f64 = 3.0 * SIGMA_FRAMES;
/// The length of an interval between two images, in frames, above which [`robust_loss`] no longer increases the
/// standard deviation of the interval's observations.
const MAX_LENGTH_FRAMES: f64 = 2.0;
/// The maximum length of an interval between two images, in frames. Observations in longer intervals are not used to
/// fit offset and rate. Intervals without a lost frame are shorter, even if the time stamps jitter.
const MAX_INTERVAL_FRAMES: f64 = 1.5;
/// The standard deviation of the prior on a drifting clock's rate, seconds per second.
const RATE_SIGMA: f64 = 5e-4;
/// The standard deviation of the prior on the rate of a clock that does not drift, seconds per second. It is so small
/// that the fitted rate is 0.
const NO_DRIFT_SIGMA: f64 = 1e-9;
/// The largest absolute rate of a clock from which a fit is started, seconds per second.
const MAX_RATE: f64 = 1e-6 * MAX_DRIFT_PPM;
/// The maximum number of clock rates on either side of 0 from which a fit is started.
const MAX_RATE_STEPS: f64 = 1e3;
/// The inverse variance of the prior on the offset, frames⁻². The prior's mean is the offset of the previous
/// iteration. The offset thus does not change if no observation is an inlier.
const OFFSET_PRIOR_WEIGHT: f64 = 1e-3;
/// The penalty of each further frame lost directly before the same image, as a multiple of an outlier's cost.
const FURTHER_LOSS_PENALTY: f64 = 0.3;
/// The maximum absolute value of a loss count. A camera's lag is fitted by a line plus loss counts: the numbers of
/// frames missing before each image, up to a common constant. The computing time grows with the square of this maximum.
const MAX_LOST: i32 = 40;
/// The maximum number of observed lags (common time minus nominal time) that are tried as the initial offset.
const MAX_STARTS: usize = 64;
/// The maximum number of alternations between two fits: that of the loss counts (numbers of frames missing before each
/// image), and that of the line (offset and rate).
const MAX_ALTERNATIONS: usize = 12;
/// The decrease of the cost in one alternation below which the fit has converged.
const COST_TOLERANCE: f64 = 1e-9;

/// Returns the penalty of `frames` frames lost between two successive images, as a multiple of an outlier's cost.
/// `loss_penalty` is the penalty of the first lost frame.
pub fn gap_penalty(frames: u32, loss_penalty: f64) -> f64 {
    match frames {
        0 => 0.0,
        _ => loss_penalty + FURTHER_LOSS_PENALTY * f64::from(frames - 1),
    }
}

/// Lags (common time minus nominal time) to which a camera's clock model is fitted, and the constraints on the
/// camera's lost frames.
pub struct LagProblem<'a> {
    pub lags: &'a [LagObservation],
    pub clock: &'a NominalClock<'a>,
    /// The penalty of the first frame lost between two images, as a multiple of an outlier's cost.
    pub loss_penalty: f64,
    /// Whether the loss count (number of frames missing before an image) may also decrease from one image to the
    /// next. It decreases where other cameras have lost frames that their models do not contain.
    pub allow_steps_back: bool,
}

/// Fitted clock model with its cost.
pub struct ClockFit {
    pub clock: ClockModel,
    /// The sum of the truncated squared residuals and of the penalties, as a multiple of an outlier's cost.
    pub cost: f64,
    /// The indices of the images directly before which the loss count (number of missing frames) decreases, one entry
    /// for each frame of the decrease; empty unless [`LagProblem::allow_steps_back`] is set.
    pub steps_back: Vec<usize>,
}

impl ClockFit {
    /// Returns the nominal clock: offset, rate and cost are 0, and no frames are lost.
    pub fn nominal(clock: &NominalClock) -> Self {
        let clock = ClockModel { reference_s: clock.times_s[0], ..ClockModel::default() };
        Self { clock, cost: 0.0, steps_back: Vec::new() }
    }
}

/// Lag of a camera (common time minus nominal time) at one point of its recording. The point lies at `fraction` of
/// the interval from `image` to the next image; 0 is `image` itself.
#[derive(Clone, Copy, Debug)]
pub struct LagObservation {
    pub image: usize,
    pub fraction: f64,
    /// The lag: common time minus nominal time, in frame periods of the camera.
    pub lag_frames: f64,
    /// The nominal time since the camera's first image, in frame periods of the camera.
    pub elapsed_frames: f64,
    /// The length of the interval between two images in which the point's time was interpolated, frames. If the two
    /// images are the camera's own, frames lost between them are not counted.
    pub interval_frames: f64,
}

impl LagObservation {
    /// Returns the lag minus the value of `line` at this observation, frames. `line` holds the offset in frames and the
    /// rate in frames per frame.
    fn lag_beyond(&self, line: &Vector2<f64>) -> f64 {
        self.lag_frames - line.x - line.y * self.elapsed_frames
    }

    /// Returns the residual, frames: the lag minus the line ([`StepFit::line`]) and minus the loss count. `lost`
    /// holds the numbers of frames missing before the image and before the next image. The loss count is interpolated
    /// between these two.
    pub fn residual(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let [before, after] = lost.map(f64::from);
        self.lag_beyond(line) - before - self.fraction * (after - before)
    }

    /// Returns the robust loss of the lag for a line ([`StepFit::line`]) and the loss counts `lost`: the numbers of
    /// frames missing before the image and before the next image.
    pub fn cost(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let interval_frames = self.interval_frames + f64::from(lost[1] - lost[0]);
        robust_loss(self.residual(line, lost), interval_frames)
    }
}

/// Returns the robust loss of a residual in frames. The residual's time was interpolated between two images that are
/// `interval_frames` frame periods apart. The loss is the negative log-likelihood of a Gaussian, truncated at 1, the
/// cost of an outlier. It is scaled so that a residual of [`INLIER_BOUND_FRAMES`] in an interval of one frame costs 1.
///
/// The observed times are interpolated by features' trajectories, which are cubic curves, fitted as if no frame were
/// missing. In a longer interval, the standard deviation of times therefore grows with the third power of the
/// interval's length.
pub fn robust_loss(residual: f64, interval_frames: f64) -> f64 {
    let factor = interval_frames.clamp(1.0, MAX_LENGTH_FRAMES).powi(3);
    let variance_term = 2.0 * factor.ln() / (INLIER_BOUND_FRAMES / SIGMA_FRAMES).powi(2);
    ((residual / (factor * INLIER_BOUND_FRAMES)).powi(2) + variance_term).min(1.0)
}

/// Fit of a camera's lags (common time minus nominal time): a line plus a step function, which is the loss count
/// (number of frames missing before an image).
struct StepFit {
    /// The line of the fit, as (offset in frames, rate in frames per frame).
    line: Vector2<f64>,
    /// The indices of the images at which lags are observed, ascending.
    images: Vec<usize>,
    /// The loss count of each of `images`: the number of frames missing before the image, up to a common constant. The
    /// constant belongs to the line's offset.
    loss_counts: Vec<i32>,
    cost: f64,
}

impl LagProblem<'_> {
    /// Fits the camera's clock model to the lags, starting from each initial rate, and returns the fit of minimum cost.
    /// Without observations, the result is the nominal clock.
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

    /// Returns the initial rates of the fit, seconds per second, from −[`MAX_RATE`] to [`MAX_RATE`]; only 0 for a
    /// clock that does not drift. The step between two rates changes the lag by about [`INLIER_BOUND_FRAMES`] over
    /// the duration of the observations.
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

    /// Returns the initial offset of the fit for a given rate, frames. Up to [`MAX_STARTS`] of the observed lags are
    /// tried, after the effect of the rate is subtracted. The lag with the minimum sum of robust losses over all
    /// observations is returned. For a camera that may lose frames, residuals are taken modulo whole frames. `None`
    /// without observations.
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

    /// Alternates the fit of the loss counts ([`Self::shortest_path`]) and the fit of the line ([`Self::refit_line`])
    /// until the cost no longer decreases. Returns the fit of minimum cost.
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

    /// Finds the loss counts (numbers of frames missing before each image) of minimum cost for a given line. They are
    /// the shortest path through a trellis with one column for each observed image and, in each column, one node for
    /// each possible loss count. Observations at an image are costs of nodes. Observations between two images, and
    /// the penalties of lost frames, are costs of edges.
    fn shortest_path(&self, line: Vector2<f64>) -> StepFit {
        let mut by_image: BTreeMap<usize, [Vec<LagObservation>; 2]> = BTreeMap::new();
        for o in self.lags {
            let is_between = o.fraction != 0.0;
            by_image.entry(o.image).or_default()[usize::from(is_between)].push(*o);
            by_image.entry(o.image + usize::from(is_between)).or_default();
        }
        let counts = self.candidate_loss_counts(&line);
        let rate = if self.clock.drifts { line.y / RATE_SIGMA } else { 0.0 };
        // The cost of the prior on the rate, scaled as in `robust_loss`: a rate of 3 σ costs 1.
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
                // Unless steps back are allowed, the loss count never decreases.
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

    /// Returns the possible loss counts for a given line. A loss count is the number of frames missing before an image,
    /// up to a common constant. An observed count is the lag minus the line, rounded and limited to ±[`MAX_LOST`]. The
    /// possible counts are all integers from the smallest to the largest of 0 and the observed counts. Only 0 for a
    /// camera that loses no frames.
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

    /// Fits the least-squares line (offset and rate) through the inliers of a fit, with Gaussian priors on offset and
    /// rate. The loss counts of the fit (numbers of frames missing before each image) are subtracted first.
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
    /// Returns the loss counts (numbers of frames missing) at an observation's image and at the next image. For an
    /// observation at an image instead of between two images, both are the loss count at this image.
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
