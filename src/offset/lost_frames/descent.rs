//! Block-coordinate fitting of the clock models of all cameras to timing observations.
//!
//! The models are fitted in turn, each to all others, until none changes (block-coordinate descent). For
//! a given offset and rate, the optimal set of lost frames is a shortest path through a trellis of
//! images and loss counts, found by dynamic programming ([`super::fit`]).
//!
//! The objective is a sum of truncated squared residuals plus a penalty per lost frame. An outlier
//! costs 1 under any model, so that penalties are counted in outliers. Residuals within an interval
//! with lost frames are weighted by its length. Further frames lost in one place cost less than the
//! first.
//!
//! Neighbours that lose frames at about the same time hide each other's losses: their images can move
//! by a frame together at little cost. [`super::jumps`] finds such moves, for any set of images. A move
//! that lowers the objective is made. If a move costs less than an outlier, its cameras are undecided.
//!
//! Known limits: frames that all cameras lose at the same time leave no trace. If observations
//! contradict each other, a cheap move may be missed. The camera of the common clock keeps its offset
//! of 0 even if it is undecided.

use super::fit::{ClockFit, FitOptions, LagObservation, fit_clock_model, gap_penalty};
use super::jumps::{Jumps, Move, MoveProblem};
use super::{FittedClock, TimingObservation};
use crate::offset::clock::NominalClock;
use nalgebra::Vector2;

/// The penalty of one lost frame while cameras are added one after the other, in outliers. It is higher
/// than the final one, since few other cameras contradict a false loss yet.
const START_LOSS_PENALTY: f64 = 1.8;
/// The penalty of one lost frame in the final models, in outliers: the log odds against a loss at a
/// given image over the log odds against an outlier.
const LOSS_PENALTY: f64 = 0.75;
/// The outliers by which a model must be better than any other with images a frame off: a single
/// outlier must not decide.
const DECISIVE_OUTLIERS: f64 = 1.0;
/// The frames by which images move at once.
const JUMPS: [i32; 4] = [1, -1, 2, -2];
/// The minimum decrease of the objective by a move, in outliers.
const MIN_IMPROVEMENT: f64 = 1e-6;
/// The maximum number of sweeps over all cameras, and of jump moves.
const MAX_SWEEPS: usize = 12;
/// The change of an offset, frames, below which a model has converged.
const OFFSET_TOLERANCE_FRAMES: f64 = 1e-3;
/// The fraction of outliers among the observations beyond which a model is ambiguous.
const MAX_OUTLIER_FRACTION: f64 = 0.4;

/// Fits the clock model of every camera to all timing observations.
///
/// The common clock of a connected component is that of its first camera: the reference, if it is a
/// member. The result is `None` for a camera without observations.
pub fn fit_clock_models(
    clocks: &[NominalClock],
    reference: usize,
    observations: &[TimingObservation],
) -> Vec<Option<FittedClock>> {
    let mut descent = CoordinateDescent::new(clocks, observations);
    let mut component = 0;
    for root in std::iter::once(reference).chain(0..clocks.len()) {
        if descent.models[root].is_some() || descent.observations[root].is_empty() {
            continue;
        }
        descent.loss_penalty = START_LOSS_PENALTY;
        let clock = ClockFit::nominal(&clocks[root]).clock;
        descent.models[root] = Some(FittedClock::new(clock, component));
        while let Some(camera) = descent.next_camera() {
            descent.add_camera(camera, component);
        }
        descent.converge(component);
        descent.improve_by_jumps(root, component);
        descent.flag_ambiguous(component);
        descent.flag_undecided(root, component);
        descent.rebase(root, component);
        component += 1;
    }
    descent.models
}

/// Block-coordinate descent over the cameras' clock models.
struct CoordinateDescent<'a> {
    clocks: &'a [NominalClock<'a>],
    /// By camera: the observations that it takes part in.
    observations: Vec<Vec<TimingObservation>>,
    models: Vec<Option<FittedClock>>,
    /// The penalty of one lost frame, in outliers.
    loss_penalty: f64,
}

impl<'a> CoordinateDescent<'a> {
    fn new(clocks: &'a [NominalClock<'a>], observations: &[TimingObservation]) -> Self {
        let mut of_camera = vec![Vec::new(); clocks.len()];
        for observation in observations {
            for c in observation.cameras {
                of_camera[c].push(*observation);
            }
        }
        let models = vec![None; clocks.len()];
        Self { clocks, observations: of_camera, models, loss_penalty: START_LOSS_PENALTY }
    }

    /// The next camera to fit: among the cameras without a model that are observed together with a
    /// fitted one, those that lose no frames first, then the one with the most observations.
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

    /// Fits a further camera to the models of its component.
    ///
    /// If an unconstrained fit steps back by a frame, all cameras fitted so far may have lost a frame
    /// there. This alternative replaces the constrained fit if its total cost is lower.
    fn add_camera(&mut self, camera: usize, component: usize) {
        let unconstrained = self.fit(camera, true);
        let before = self.models.clone();
        self.models[camera] = Some(FittedClock::new(self.fit(camera, false).clock, component));
        if unconstrained.steps_back.is_empty() {
            return;
        }
        self.converge(component);
        let (constrained_cost, constrained_models) =
            (self.total_cost(component), std::mem::replace(&mut self.models, before));
        self.attribute_steps_back(camera, &unconstrained, component);
        self.models[camera] = Some(FittedClock::new(unconstrained.clock, component));
        self.converge(component);
        if self.total_cost(component) >= constrained_cost {
            self.models = constrained_models;
        }
    }

    /// Adds a lost frame to every fitted camera of the component that may lose frames, at each of the
    /// times at which the fit of `camera` steps back.
    fn attribute_steps_back(&mut self, camera: usize, fit: &ClockFit, component: usize) {
        let clock = &self.clocks[camera];
        // The other cameras are one frame late there, and one more after each further step.
        let step_time_s = |(n, image): (usize, &usize)| {
            Some(fit.clock.image_time_s(clock, *image)? - (n + 1) as f64 * clock.frame_s)
        };
        let step_times_s: Vec<f64> =
            fit.steps_back.iter().enumerate().filter_map(step_time_s).collect();
        for c in self.members(component) {
            let may_lose_frames = self.clocks[c].may_lose_frames;
            let Some(model) = self.models[c].as_mut().filter(|_| may_lose_frames) else {
                continue;
            };
            let times = model.clock.image_times_s(&self.clocks[c]);
            let first_after = |t: &f64| times.partition_point(|own| own < t).min(times.len() - 1);
            model.clock.lost_before.extend(step_times_s.iter().map(first_after));
            model.clock.lost_before.sort_unstable();
        }
    }

    /// The cameras of a component, ascending.
    fn members(&self, component: usize) -> Vec<usize> {
        let is_member =
            |c: &usize| self.models[*c].as_ref().is_some_and(|m| m.component == component);
        (0..self.clocks.len()).filter(is_member).collect()
    }

    /// Sweeps over the component's cameras, fitting each to all others, until no model changes.
    fn converge(&mut self, component: usize) {
        let members = self.members(component);
        for _ in 0..MAX_SWEEPS {
            let mut converged = true;
            for &c in &members {
                let clock = self.fit(c, false).clock;
                let before = self.models[c].take().unwrap_or_default().clock;
                converged &= clock.lost_before == before.lost_before
                    && (clock.offset_s - before.offset_s).abs()
                        < OFFSET_TOLERANCE_FRAMES * self.clocks[c].frame_s;
                self.models[c] = Some(FittedClock::new(clock, component));
            }
            if converged {
                break;
            }
        }
    }

    /// Flags the models that explain too few observations.
    fn flag_ambiguous(&mut self, component: usize) {
        for c in self.members(component) {
            let fitted = self.fit(c, false);
            let count = self.observations[c].len() as f64;
            if let Some(model) = &mut self.models[c] {
                let losses = self.loss_penalty * model.clock.lost_before.len() as f64;
                model.ambiguous = fitted.cost - losses > MAX_OUTLIER_FRACTION * count;
            }
        }
    }

    /// The models of a component's cameras; `None` for all other cameras.
    fn models_of(&self, component: usize) -> Vec<Option<FittedClock>> {
        let of = |m: &Option<FittedClock>| m.clone().filter(|m| m.component == component);
        self.models.iter().map(of).collect()
    }

    /// Moves images of several cameras at once by a frame, as long as that lowers the objective.
    fn improve_by_jumps(&mut self, origin: usize, component: usize) {
        let observations = self.component_observations(component);
        self.loss_penalty = LOSS_PENALTY;
        self.converge(component);
        for _ in 0..MAX_SWEEPS {
            let cost = self.total_cost(component);
            let models = self.models_of(component);
            let improved = JUMPS.into_iter().find_map(|frames| {
                let problem = self.problem(&models, &observations, origin);
                let jumps = Jumps::new(problem, frames);
                let improvement = jumps.cheapest(None).filter(|m| m.cost < -MIN_IMPROVEMENT)?;
                Some(jumps.apply(&improvement))
            });
            let Some(improved) = improved else { return };
            let before = self.models.clone();
            for (model, improved) in self.models.iter_mut().zip(improved) {
                *model = improved.or(model.take());
            }
            self.converge(component);
            if self.total_cost(component) > cost - MIN_IMPROVEMENT {
                self.models = before;
                return;
            }
        }
    }

    /// Flags the cameras with images that could move by whole frames, alone or together with others, at
    /// nearly the same objective.
    fn flag_undecided(&mut self, origin: usize, component: usize) {
        let observations = self.component_observations(component);
        let models = self.models_of(component);
        let mut undecided = vec![false; self.models.len()];
        for frames in JUMPS {
            let problem = self.problem(&models, &observations, origin);
            let jumps = Jumps::new(problem, frames);
            let best = jumps.cheapest(None);
            let lowest = best.as_ref().map_or(0.0, |m| m.cost.min(0.0));
            let mut flag = |of: Option<Move>| {
                let moved = of.map(|m| jumps.moved_cameras(&m)).unwrap_or_default();
                moved.into_iter().for_each(|c| undecided[c] = true);
                undecided.clone()
            };
            let mut flagged = flag(best);
            for camera in self.members(component) {
                for node in jumps.decisive_nodes(camera) {
                    if flagged[camera] {
                        break;
                    }
                    let cheapest = jumps.cheapest(Some(node));
                    flagged = flag(cheapest.filter(|m| m.cost - lowest < DECISIVE_OUTLIERS));
                }
            }
        }
        for (model, undecided) in self.models.iter_mut().zip(undecided) {
            if let Some(model) = model.as_mut().filter(|m| m.component == component) {
                model.undecided = undecided;
            }
        }
    }

    fn problem<'b>(
        &'b self,
        models: &'b [Option<FittedClock>],
        observations: &'b [TimingObservation],
        origin: usize,
    ) -> MoveProblem<'b> {
        let loss_penalty = self.loss_penalty;
        MoveProblem { clocks: self.clocks, models, observations, origin, loss_penalty }
    }

    /// The observations of a component, each once.
    fn component_observations(&self, component: usize) -> Vec<TimingObservation> {
        let as_second = |c: usize| self.observations[c].iter().filter(move |o| o.cameras[1] == c);
        self.members(component).into_iter().flat_map(as_second).copied().collect()
    }

    /// The objective of a connected component of cameras: the cost of its observations and of its lost frames. An
    /// observation between two cameras is added once, not once a camera.
    fn total_cost(&self, component: usize) -> f64 {
        let camera_cost = |c: usize| {
            let line = self.models[c].as_ref().map_or_else(Vector2::zeros, |model| {
                Vector2::new(model.clock.offset_s / self.clocks[c].frame_s, model.clock.rate)
            });
            let loss_count = |o: &LagObservation| {
                let before = self.models[c].iter().flat_map(|m| &m.clock.lost_before);
                before.filter(|n| **n <= o.image).count() as i32
            };
            let as_second = self.observations[c].iter().filter(|o| o.cameras[1] == c);
            let lags = as_second.filter_map(|o| self.lag(c, o));
            let lost_before =
                self.models[c].iter().flat_map(|m| m.clock.lost_before.chunk_by(usize::eq));
            let penalty = |gap: &[usize]| gap_penalty(gap.len() as u32, self.loss_penalty);
            let sum: f64 = lags.map(|o| o.cost(&line, [loss_count(&o); 2])).sum();
            sum + lost_before.map(penalty).sum::<f64>()
        };
        self.members(component).into_iter().map(camera_cost).sum()
    }

    /// Makes the clock of the camera `root` the common clock of its component.
    fn rebase(&mut self, root: usize, component: usize) {
        let Some(origin) = self.models[root].clone() else { return };
        for c in self.members(component) {
            if let Some(model) = &mut self.models[c] {
                model.clock.offset_s -= origin.clock.offset_s;
                model.clock.rate -= origin.clock.rate;
            }
        }
    }

    /// Fits a camera's clock model, given the models of all others.
    fn fit(&self, camera: usize, allow_steps_back: bool) -> ClockFit {
        let lags: Vec<LagObservation> =
            self.observations[camera].iter().filter_map(|o| self.lag(camera, o)).collect();
        let options = FitOptions { loss_penalty: self.loss_penalty, allow_steps_back };
        fit_clock_model(&lags, &self.clocks[camera], options)
    }

    /// Converts a timing observation to the lag of one of its cameras behind the common clock, given the
    /// other camera's model; `None` if the other camera has no model yet.
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

    /// The time of a camera's image on the common clock, seconds; `None` without a model.
    fn time_s(&self, camera: usize, image: usize) -> Option<f64> {
        self.models[camera].as_ref()?.clock.image_time_s(&self.clocks[camera], image)
    }
}
