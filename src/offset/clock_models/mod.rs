//! Which frames each camera lost, from the timing observations of all pairs: block-coordinate
//! fitting of clock models, each block solved by dynamic programming.
//!
//! A camera's [`ClockModel`] maps its nominal times to a common clock: an offset, a rate where
//! clocks drift, and one frame period for each frame that is missing. A [`TimingObservation`] says
//! that an image of one camera was taken at a given fraction of the interval between two images of
//! another. The models are fitted in turn, each to all others, until none changes (block-coordinate
//! descent). For a given offset and rate, the optimal set of lost frames is a shortest path through
//! a trellis of images and loss counts, found by dynamic programming ([`fit`]).
//!
//! The objective is a sum of truncated squared residuals plus a penalty per lost frame. An outlier
//! costs 1 under any model, so that the penalty is counted in outliers: a loss is accepted only if
//! it explains several observations. A model whose losses would differ under a lower penalty is
//! flagged as ambiguous.
//!
//! Known limit: frames that both cameras of a pair lose at the same time leave no trace in that
//! pair's observations.

mod fit;

use fit::{FitOptions, FittedModel, LagObservation, fit_clock_model, truncated_square};
use nalgebra::Vector2;

/// The relative timing of three images: image `images[1]` of camera `cameras[1]` was taken at
/// `fraction` of the interval from image `images[0]` of camera `cameras[0]` to its next image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimingObservation {
    pub cameras: [usize; 2],
    pub images: [usize; 2],
    /// 0 to 1, or slightly outside where the trajectory was extrapolated.
    pub fraction: f64,
}

/// A camera's clock as the capture states it.
#[derive(Clone, Copy, Debug)]
pub struct NominalClock<'a> {
    /// The time of every image on the camera's own clock, ascending, seconds.
    pub times_s: &'a [f64],
    /// The frame period, seconds.
    pub frame_s: f64,
    /// Whether frames may be missing without a gap in `times_s`.
    pub may_lose_frames: bool,
    /// Whether the clock's rate may be off.
    pub drifts: bool,
}

/// A camera's time on the common clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// Common time minus own time at the camera's first image, seconds.
    pub offset_s: f64,
    /// The change of the offset, seconds a second of the camera's own clock.
    pub rate: f64,
    /// The images before which a frame is missing, ascending; one entry for each missing frame.
    pub lost_before: Vec<usize>,
    /// Whether the observations leave the lost frames undecided: a lower penalty per loss gives
    /// other losses, or the model explains less than half of the observations.
    pub ambiguous: bool,
    /// The connected component of the observation graph that the camera belongs to. Only models of
    /// the same component share a clock.
    pub component: usize,
}

impl ClockModel {
    /// The time of an image on the common clock, seconds; `None` beyond the last image.
    pub fn time_s(&self, clock: &NominalClock, image: usize) -> Option<f64> {
        let time_s = *clock.times_s.get(image)?;
        let lost = self.lost_before.iter().filter(|n| **n <= image).count() as f64;
        let own_s = time_s + lost * clock.frame_s;
        Some(own_s + self.offset_s + self.rate * (own_s - clock.times_s[0]))
    }

    /// The times of all images on the common clock, seconds.
    pub fn times_s(&self, clock: &NominalClock) -> Vec<f64> {
        (0..clock.times_s.len()).map_while(|image| self.time_s(clock, image)).collect()
    }
}

/// The penalty of one lost frame, in outliers that it has to explain. Larger: frames lost near the
/// ends of a recording, where few observations see them, are missed. Smaller: losses are invented
/// where motion repeats itself.
const LOSS_PENALTY: f64 = 1.8;
/// The lower penalty at which a model's losses must stay the same for the model to be unambiguous.
/// Larger, up to [`LOSS_PENALTY`]: wrong losses pass as certain. Smaller: single outliers make
/// correct models ambiguous, and the camera's offset is withheld.
const AMBIGUOUS_LOSS_PENALTY: f64 = 1.2;
/// The maximum number of sweeps over all cameras, and of alternations within one camera's fit.
/// Larger costs time where the models cycle between solutions of equal cost; smaller stops long
/// chains of cameras before they converge.
const MAX_SWEEPS: usize = 12;
/// The change of an offset, in frames, below which a model counts as converged. Larger stops before
/// the minimum; smaller only adds sweeps.
const OFFSET_TOLERANCE_FRAMES: f64 = 1e-3;
/// The fraction of observations that may be outliers before a model is ambiguous. Larger accepts
/// models that most observations contradict; smaller rejects models of scenes with many mismatches.
const MAX_OUTLIER_FRACTION: f64 = 0.5;

/// Fits the clock model of every camera to all timing observations.
///
/// The common clock of a connected component is that of its first camera: the reference, if it is a
/// member. The result is `None` for a camera without observations.
pub fn fit_clock_models(
    clocks: &[NominalClock],
    reference: usize,
    observations: &[TimingObservation],
) -> Vec<Option<ClockModel>> {
    let mut descent = CoordinateDescent::new(clocks, observations);
    let mut component = 0;
    for root in std::iter::once(reference).chain(0..clocks.len()) {
        if descent.models[root].is_some() || descent.observations[root].is_empty() {
            continue;
        }
        descent.models[root] = Some(ClockModel { component, ..ClockModel::default() });
        while let Some(camera) = descent.next_camera() {
            descent.add_camera(camera, component);
        }
        descent.converge(component);
        descent.flag_ambiguous(component);
        descent.rebase(root, component);
        component += 1;
    }
    descent.models
}

/// Block-coordinate descent over the cameras' clock models.
struct CoordinateDescent<'a> {
    clocks: &'a [NominalClock<'a>],
    /// By camera: each observation is listed for both of its cameras.
    observations: Vec<Vec<TimingObservation>>,
    models: Vec<Option<ClockModel>>,
}

impl<'a> CoordinateDescent<'a> {
    fn new(clocks: &'a [NominalClock<'a>], observations: &[TimingObservation]) -> Self {
        let mut of_camera = vec![Vec::new(); clocks.len()];
        for observation in observations {
            for c in observation.cameras {
                of_camera[c].push(*observation);
            }
        }
        Self { clocks, observations: of_camera, models: vec![None; clocks.len()] }
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
    /// Where an unconstrained fit steps back by a frame, all cameras fitted so far may have lost a
    /// frame there. That alternative replaces the constrained fit if its total cost is lower.
    fn add_camera(&mut self, camera: usize, component: usize) {
        let loss_penalty = LOSS_PENALTY;
        let unconstrained = self.fit(camera, FitOptions { loss_penalty, allow_steps_back: true });
        let before = self.models.clone();
        let constrained = self.fit(camera, FitOptions::losses_only(loss_penalty)).model;
        self.models[camera] = Some(ClockModel { component, ..constrained });
        if unconstrained.steps_back.is_empty() {
            return;
        }
        self.converge(component);
        let (constrained_cost, constrained_models) =
            (self.total_cost(component), std::mem::replace(&mut self.models, before));
        let own = ClockModel { component, ..unconstrained.model };
        self.attribute_steps_back(camera, &own, &unconstrained.steps_back, component);
        self.models[camera] = Some(own);
        self.converge(component);
        if self.total_cost(component) >= constrained_cost {
            self.models = constrained_models;
        }
    }

    /// Gives every fitted camera of the component that may lose frames one more lost frame at each
    /// of the times at which `camera`'s model `own` steps back.
    fn attribute_steps_back(
        &mut self,
        camera: usize,
        own: &ClockModel,
        steps_back: &[usize],
        component: usize,
    ) {
        let clock = &self.clocks[camera];
        // The other cameras are one frame late there, and one more after each further step.
        let step_time_s = |(n, image): (usize, &usize)| {
            Some(own.time_s(clock, *image)? - (n + 1) as f64 * clock.frame_s)
        };
        let step_times_s: Vec<f64> =
            steps_back.iter().enumerate().filter_map(step_time_s).collect();
        for c in self.members(component) {
            let may_lose_frames = self.clocks[c].may_lose_frames;
            let Some(model) = self.models[c].as_mut().filter(|_| may_lose_frames) else {
                continue;
            };
            let times = model.times_s(&self.clocks[c]);
            // The first image after the step: an earlier one has the time that it had.
            let first_after = |t: &f64| times.partition_point(|own| own < t).min(times.len() - 1);
            model.lost_before.extend(step_times_s.iter().map(first_after));
            model.lost_before.sort_unstable();
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
                let fitted = self.fit(c, FitOptions::losses_only(LOSS_PENALTY)).model;
                let model = ClockModel { component, ..fitted };
                let before = self.models[c].replace(model.clone()).unwrap_or_default();
                converged &= model.lost_before == before.lost_before
                    && (model.offset_s - before.offset_s).abs()
                        < OFFSET_TOLERANCE_FRAMES * self.clocks[c].frame_s;
            }
            if converged {
                break;
            }
        }
    }

    /// Flags the models whose losses differ under [`AMBIGUOUS_LOSS_PENALTY`], or that explain too
    /// few observations.
    fn flag_ambiguous(&mut self, component: usize) {
        for c in self.members(component) {
            let alternative = self.fit(c, FitOptions::losses_only(AMBIGUOUS_LOSS_PENALTY));
            let count = self.observations[c].len() as f64;
            if let Some(model) = &mut self.models[c] {
                let losses = AMBIGUOUS_LOSS_PENALTY * model.lost_before.len() as f64;
                model.ambiguous = alternative.model.lost_before != model.lost_before
                    || alternative.cost - losses > MAX_OUTLIER_FRACTION * count;
            }
        }
    }

    /// The objective over all observations and losses of a component; each observation counts once.
    fn total_cost(&self, component: usize) -> f64 {
        let camera_cost = |c: usize| {
            let line = self.models[c].as_ref().map_or_else(Vector2::zeros, |model| {
                Vector2::new(model.offset_s / self.clocks[c].frame_s, model.rate)
            });
            let loss_count = |o: &LagObservation| {
                let before = self.models[c].iter().flat_map(|m| &m.lost_before);
                before.filter(|n| **n <= o.image).count() as i32
            };
            let as_second = self.observations[c].iter().filter(|o| o.cameras[1] == c);
            let lags = as_second.filter_map(|o| self.lag_observation(c, o));
            let losses = self.models[c].as_ref().map_or(0, |m| m.lost_before.len());
            let sum: f64 =
                lags.map(|o| truncated_square(o.residual(&line, [loss_count(&o); 2]))).sum();
            sum + LOSS_PENALTY * losses as f64
        };
        self.members(component).into_iter().map(camera_cost).sum()
    }

    /// Makes one camera's clock the common clock of its component.
    fn rebase(&mut self, root: usize, component: usize) {
        let Some(origin) = self.models[root].clone() else { return };
        for c in self.members(component) {
            if let Some(model) = &mut self.models[c] {
                model.offset_s -= origin.offset_s;
                model.rate -= origin.rate;
            }
        }
    }

    /// A camera's clock model, given those of all others.
    fn fit(&self, camera: usize, options: FitOptions) -> FittedModel {
        let clock = &self.clocks[camera];
        let lags: Vec<LagObservation> = self.observations[camera]
            .iter()
            .filter_map(|o| self.lag_observation(camera, o))
            .collect();
        fit_clock_model(&lags, clock, options)
    }

    /// A timing observation as the lag of one of its cameras behind the common clock, given the
    /// other camera's model; `None` if that is not known yet.
    fn lag_observation(
        &self,
        camera: usize,
        observation: &TimingObservation,
    ) -> Option<LagObservation> {
        let [a, b] = observation.cameras;
        let [k, m] = observation.images;
        let clock = &self.clocks[camera];
        let (image, fraction, time_s) = if b == camera {
            let time_s = self.time_s(a, k)?;
            (m, 0.0, time_s + observation.fraction * (self.time_s(a, k + 1)? - time_s))
        } else if a == camera {
            (k, observation.fraction, self.time_s(b, m)?)
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
        })
    }

    /// The time of a camera's image on the common clock, seconds; `None` without a model.
    fn time_s(&self, camera: usize, image: usize) -> Option<f64> {
        self.models[camera].as_ref()?.time_s(&self.clocks[camera], image)
    }
}

#[cfg(test)]
mod tests;
