//! Fits the clock models of all cameras to timing observations by block-coordinate descent.
//!
//! One camera's model is fitted at a time, while all other models stay fixed, until no model changes. For a given
//! offset and rate, the optimal set of lost frames is a shortest path through a trellis of images and loss counts
//! (numbers of frames lost before an image). Dynamic programming finds this path ([`super::fit`]).
//!
//! The objective is a sum of truncated squared residuals plus a penalty for each lost frame. An outlier costs 1 under
//! any model; penalties are multiples of this cost. An observation in an interval with lost frames has a larger
//! standard deviation than other observations ([`super::fit::robust_loss`]). Further frames lost at the same image
//! have a smaller penalty than the first.
//!
//! If several cameras lose frames at about the same time, shifting their image times together by a frame hardly changes
//! the objective. Such a shift of the times of any set of images is a jump move ([`super::jumps`]). A jump move that
//! lowers the objective is applied. If a jump move raises the objective by less than an outlier costs, the cameras
//! whose images it shifts are undecided.
//!
//! Known limits: frames that all cameras lose at the same time leave no trace. If observations contradict each other,
//! a move of low cost may be missed. The camera that defines the common clock keeps its offset of 0 even if it is
//! undecided.

use super::fit::{ClockFit, LagObservation, LagProblem, gap_penalty};
use super::jumps::{Component, Jumps};
use super::{FittedClock, TimingObservation};
use crate::offset::clock::{ClockModel, NominalClock};
use nalgebra::Vector2;

/// The penalty of one lost frame while cameras are added to the fit one after the other, as a multiple of an outlier's
/// cost. It is higher than [`LOSS_PENALTY`], since only few fitted cameras could contradict a false loss.
const START_LOSS_PENALTY: f64 = 1.8;
/// The penalty of one lost frame in the final models, as a multiple of an outlier's cost. It is the log odds
/// against a lost frame at a given image, divided by the log odds against an outlier.
const LOSS_PENALTY: f64 = 0.75;
/// The increase of the objective below which a jump move makes the cameras that it shifts undecided, as a multiple of
/// an outlier's cost. A jump move shifts some image times by whole frames. At 1, the evidence of a single observation
/// is not sufficient.
const DECISIVE_OUTLIERS: f64 = 1.0;
/// The numbers of frames by which a jump move shifts the times of a set of images.
const JUMPS: [i32; 4] = [1, -1, 2, -2];
/// The minimum decrease of the objective, as a multiple of an outlier's cost, for which a jump move (a shift of some
/// image times by whole frames) is applied.
const MIN_IMPROVEMENT: f64 = 1e-6;
/// The maximum number of sweeps, each of which updates every camera's model once. It is also the maximum number of
/// jump moves.
const MAX_SWEEPS: usize = 12;
/// The change of an offset in one sweep, in frames, below which a clock model has converged.
const OFFSET_TOLERANCE_FRAMES: f64 = 1e-3;
/// The fraction of outliers among a camera's observations above which the camera's model is ambiguous.
const MAX_OUTLIER_FRACTION: f64 = 0.4;

/// Fits the clock model of every camera to all timing observations. `clocks` holds the nominal clock of each camera;
/// `reference` is the index of the reference camera. Returns a model for each camera, `None` for a camera without
/// observations.
///
/// Cameras that are connected by observations form a component. The models of a component are relative to the clock
/// of one camera: the reference camera if it is a member, otherwise the component's first camera.
pub fn fit_clock_models(
    clocks: &[NominalClock],
    reference: usize,
    observations: &[TimingObservation],
) -> Vec<Option<FittedClock>> {
    let mut of_camera = vec![Vec::new(); clocks.len()];
    for observation in observations {
        for c in observation.cameras {
            of_camera[c].push(*observation);
        }
    }
    let mut fitted: Vec<Option<FittedClock>> = vec![None; clocks.len()];
    let mut component = 0;
    for root in std::iter::once(reference).chain(0..clocks.len()) {
        if fitted[root].is_some() || of_camera[root].is_empty() {
            continue;
        }
        let mut fitting = Component::new(clocks, &of_camera, root);
        while let Some(camera) = fitting.next_camera() {
            fitting.add_camera(camera);
        }
        fitting.converge();
        fitting.improve_by_jumps();
        let undecided = fitting.undecided();
        for c in fitting.members() {
            let (clock, ambiguous) = (fitting.rebased(c), fitting.is_ambiguous(c));
            fitted[c] = Some(FittedClock { clock, ambiguous, undecided: undecided[c], component });
        }
        component += 1;
    }
    fitted
}

/// Block-coordinate descent over the clock models of a component (cameras that are connected by common observations):
/// one camera's model is fitted at a time.
impl<'a> Component<'a> {
    fn new(
        clocks: &'a [NominalClock<'a>],
        observations: &'a [Vec<TimingObservation>],
        root: usize,
    ) -> Self {
        let mut models = vec![None; clocks.len()];
        models[root] = Some(ClockFit::nominal(&clocks[root]).clock);
        Self { clocks, observations, root, models, loss_penalty: START_LOSS_PENALTY }
    }

    /// Returns the next camera to fit: a camera without a model that has an observation together with a fitted
    /// camera. Cameras that lose no frames come first, then the camera with the most such observations. `None` if
    /// there is no such camera.
    fn next_camera(&self) -> Option<usize> {
        let observation_count = |c: usize| {
            let to_fitted =
                |o: &&TimingObservation| o.cameras.iter().any(|c| self.models[*c].is_some());
            self.observations[c].iter().filter(to_fitted).count()
        };
        (0..self.clocks.len())
            .filter(|&c| self.models[c].is_none())
            .map(|c| (observation_count(c), c))
            .filter(|(count, _)| *count > 0)
            .max_by_key(|&(count, c)| {
                (!self.clocks[c].may_lose_frames, count, std::cmp::Reverse(c))
            })
            .map(|(_, c)| c)
    }

    /// Fits the clock model of another camera, given the models fitted so far.
    ///
    /// At first, the camera's loss count (number of frames missing before an image) may also decrease from one image to
    /// the next. A decrease may mean that all cameras fitted so far lost a frame at that time. These losses are added
    /// to their models if the total cost is then lower.
    fn add_camera(&mut self, camera: usize) {
        let unconstrained = self.fit(camera, true);
        let before = self.models.clone();
        self.models[camera] = Some(self.fit(camera, false).clock);
        if unconstrained.steps_back.is_empty() {
            return;
        }
        self.converge();
        let constrained_cost = self.total_cost();
        let constrained_models = std::mem::replace(&mut self.models, before);
        self.attribute_steps_back(camera, &unconstrained);
        self.models[camera] = Some(unconstrained.clock);
        self.converge();
        if self.total_cost() >= constrained_cost {
            self.models = constrained_models;
        }
    }

    /// Adds lost frames to every fitted camera that may lose frames: one at each time at which the loss count of
    /// `fit` (number of frames missing before an image) decreases. `fit` is the fit of `camera`.
    fn attribute_steps_back(&mut self, camera: usize, fit: &ClockFit) {
        let clock = &self.clocks[camera];
        // The common clock does not include the new losses yet. On it, this image is one frame earlier than in `fit`,
        // and one more for each earlier decrease.
        let step_time_s = |(n, image): (usize, &usize)| {
            Some(fit.clock.image_time_s(clock, *image)? - (n + 1) as f64 * clock.frame_s)
        };
        let step_times_s: Vec<f64> =
            fit.steps_back.iter().enumerate().filter_map(step_time_s).collect();
        for (model, clock) in self.models.iter_mut().zip(self.clocks) {
            let Some(model) = model.as_mut().filter(|_| clock.may_lose_frames) else { continue };
            let times = model.image_times_s(clock);
            let first_after = |t: &f64| times.partition_point(|own| own < t).min(times.len() - 1);
            model.lost_before.extend(step_times_s.iter().map(first_after));
            model.lost_before.sort_unstable();
        }
    }

    /// Fits each camera's model to the models of all other cameras, in repeated sweeps over all cameras, until no
    /// model changes.
    fn converge(&mut self) {
        for _ in 0..MAX_SWEEPS {
            let mut converged = true;
            for c in self.members() {
                let clock = self.fit(c, false).clock;
                let before = self.models[c].replace(clock.clone()).unwrap_or_default();
                converged &= clock.lost_before == before.lost_before
                    && (clock.offset_s - before.offset_s).abs()
                        < OFFSET_TOLERANCE_FRAMES * self.clocks[c].frame_s;
            }
            if converged {
                break;
            }
        }
    }

    /// Returns whether a camera's clock model is ambiguous: the total cost of the camera's observations, as a multiple
    /// of an outlier's cost, exceeds [`MAX_OUTLIER_FRACTION`] times their number. Penalties of lost frames do not
    /// count.
    fn is_ambiguous(&self, camera: usize) -> bool {
        let losses = self.models[camera].as_ref().map_or(0.0, |model| self.loss_penalties(model));
        let count = self.observations[camera].len() as f64;
        self.fit(camera, false).cost - losses > MAX_OUTLIER_FRACTION * count
    }

    /// Applies jump moves (shifts of some image times by whole frames, [`Jumps`]), each followed by [`Self::converge`],
    /// until no jump move lowers the objective.
    fn improve_by_jumps(&mut self) {
        self.loss_penalty = LOSS_PENALTY;
        self.converge();
        for _ in 0..MAX_SWEEPS {
            let cost = self.total_cost();
            let improved = JUMPS.into_iter().find_map(|frames| {
                let jumps = Jumps::new(self, frames);
                let improvement = jumps.cheapest(None).filter(|m| m.cost < -MIN_IMPROVEMENT)?;
                Some(jumps.apply(&improvement))
            });
            let Some(improved) = improved else { return };
            let before = std::mem::replace(&mut self.models, improved);
            self.converge();
            if self.total_cost() > cost - MIN_IMPROVEMENT {
                self.models = before;
                return;
            }
        }
    }

    /// Returns, for each camera, whether its image times are undecided. They are undecided if a jump move (a shift of
    /// image times by whole frames) of some of its images increases the objective by less than [`DECISIVE_OUTLIERS`].
    fn undecided(&self) -> Vec<bool> {
        let mut undecided = vec![false; self.clocks.len()];
        for frames in JUMPS {
            let jumps = Jumps::new(self, frames);
            let mut lowest: f64 = 0.0;
            if let Some(best) = jumps.cheapest(None) {
                lowest = lowest.min(best.cost);
                jumps.mark_moved(&best, &mut undecided);
            }
            for camera in self.members() {
                for node in jumps.decisive_nodes(camera) {
                    if undecided[camera] {
                        break;
                    }
                    let cheapest = jumps.cheapest(Some(node));
                    if let Some(rival) = cheapest.filter(|m| m.cost - lowest < DECISIVE_OUTLIERS) {
                        jumps.mark_moved(&rival, &mut undecided);
                    }
                }
            }
        }
        undecided
    }

    /// Returns the objective of the fit, as a multiple of an outlier's cost: the sum of the costs of all observations
    /// and of the penalties of all lost frames.
    fn total_cost(&self) -> f64 {
        let camera_cost = |(c, model): (usize, &ClockModel)| {
            let line = Vector2::new(model.offset_s / self.clocks[c].frame_s, model.rate);
            let loss_count = |o: &LagObservation| {
                model.lost_before.iter().filter(|n| **n <= o.image).count() as i32
            };
            let as_second = self.observations[c].iter().filter(|o| o.cameras[1] == c);
            let lags = as_second.filter_map(|o| self.lag(c, o));
            let sum: f64 = lags.map(|o| o.cost(&line, [loss_count(&o); 2])).sum();
            sum + self.loss_penalties(model)
        };
        let models = self.models.iter().enumerate();
        models.filter_map(|(c, model)| Some((c, model.as_ref()?))).map(camera_cost).sum()
    }

    /// Returns the sum of the penalties of a model's lost frames, as a multiple of an outlier's cost.
    fn loss_penalties(&self, model: &ClockModel) -> f64 {
        let gaps = model.lost_before.chunk_by(usize::eq);
        gaps.map(|gap| gap_penalty(gap.len() as u32, self.loss_penalty)).sum()
    }

    /// Returns a camera's model relative to the clock of the camera [`Component::root`].
    fn rebased(&self, camera: usize) -> ClockModel {
        let [model, root] = [camera, self.root].map(|c| self.models[c].clone().unwrap_or_default());
        let (offset_s, rate) = (model.offset_s - root.offset_s, model.rate - root.rate);
        ClockModel { offset_s, rate, ..model }
    }

    /// Fits a camera's clock model, given the models of all other cameras. If `allow_steps_back` is true, the loss
    /// count (number of frames missing before an image) may also decrease ([`LagProblem::allow_steps_back`]).
    fn fit(&self, camera: usize, allow_steps_back: bool) -> ClockFit {
        let lags: Vec<LagObservation> =
            self.observations[camera].iter().filter_map(|o| self.lag(camera, o)).collect();
        let (clock, loss_penalty) = (&self.clocks[camera], self.loss_penalty);
        LagProblem { lags: &lags, clock, loss_penalty, allow_steps_back }.fit()
    }

    /// Converts a timing observation to a lag of `camera`: the time on the common clock minus the camera's nominal
    /// time. The common time comes from the other camera's model. `None` if the other camera has no model yet.
    fn lag(&self, camera: usize, observation: &TimingObservation) -> Option<LagObservation> {
        let [a, b] = observation.cameras;
        let [k, m] = observation.images;
        let clock = &self.clocks[camera];
        let (image, fraction, time_s, interval_s) = if b == camera {
            let (start_s, end_s) = (self.time_s(a, k)?, self.time_s(a, k + 1)?);
            let interval_s = end_s - start_s;
            (m, 0.0, start_s + observation.fraction * interval_s, interval_s)
        } else if a == camera {
            let interval_s = clock.times_s.get(k + 1)? - clock.times_s[k];
            (k, observation.fraction, self.time_s(b, m)?, interval_s)
        } else {
            return None;
        };
        let own_s = match clock.times_s.get(image + 1) {
            Some(next_s) => clock.times_s[image] + fraction * (next_s - clock.times_s[image]),
            None => clock.times_s[image],
        };
        Some(LagObservation {
            image,
            fraction,
            lag_frames: (time_s - own_s) / clock.frame_s,
            elapsed_frames: (own_s - clock.times_s[0]) / clock.frame_s,
            interval_frames: interval_s / self.clocks[a].frame_s,
        })
    }

    /// Returns the time of a camera's image on the common clock, seconds. `None` if the camera has no model.
    fn time_s(&self, camera: usize, image: usize) -> Option<f64> {
        self.models[camera].as_ref()?.image_time_s(&self.clocks[camera], image)
    }
}
