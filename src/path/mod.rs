//! Camera paths: position, direction, lens and time of a view as continuous functions of a video's seconds.
//!
//! A path is given by keys. All four are interpolated between the keys, with continuous first derivatives:
//!
//! - position by cubic Hermite splines, with tangents from parabolas through three keys; between keys at the same
//!   position, it doesn't move;
//! - direction by a spline of unit quaternions along the shorter arc, with tangents computed in the same way;
//! - lens and time by monotone splines, which never overshoot: time stands still between keys of equal times.
//!
//! A path's file ([`PathFormat`]):
//!
//! ```json
//! { "format": "stlfr-path", "version": 1, "rate_hz": 30,
//!   "keys": [
//!     { "at_s": 0, "time_s": 0.05, "camera": { "width": 640, "height": 480, "model": "PINHOLE",
//!       "params": [686, 686, 320, 240],
//!       "cam_from_world": { "rotation_wxyz": [1, 0, 0, 0], "translation": [0.1, 0, 0] } } },
//!     { "at_s": 2, "time_s": 0.05, "rest": true, "camera": { "…": "a camera as in capture.json" } } ] }
//! ```
//!
//! `at_s` is the second of the video, and `time_s` the instant that the video shows then. Equal `time_s` stop time,
//! descending ones reverse it; their differences set its speed. At a key with `rest`, all four come to rest.
//! `"constant_speed": true` moves the position at constant speed. `rate_hz`, `rest` and `constant_speed` are optional.
//!
//! | file | what |
//! |---|---|
//! | `format.rs` | the JSON file of a path |
//! | `curve.rs` | tangents, cubic Hermite splines |
//! | `rotation.rs` | splines of rotations |
//! | `arc_length.rs` | motion at constant speed |
//! | `ready_made.rs` | paths by name, fitted to a rig |

mod arc_length;
mod curve;
mod format;
mod ready_made;
mod rotation;

pub use format::PathFormat;
pub use ready_made::{PathScene, ReadyMadePath};

use crate::camera::{Camera, CameraModel};
use crate::text::number;
use arc_length::ArcLength;
use curve::{Hermite, monotone_tangents, resting, tangents};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rotation::{cumulative, rotation_tangents};

/// A key of a path: the view and its instant at a second of the video.
#[derive(Clone, Debug, PartialEq)]
pub struct PathKey {
    /// Time of the key in the video, seconds.
    pub at_s: f64,
    /// The instant that is shown, seconds on the reference camera's clock.
    pub time_s: f64,
    /// Position, direction and lens.
    pub camera: Camera,
    /// Whether position, direction, lens and time come to rest here: their derivatives are 0.
    pub rest: bool,
}

/// A frame of a video along a path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathFrame {
    pub camera: Camera,
    /// The instant that is shown, seconds on the reference camera's clock.
    pub time_s: f64,
}

/// A continuous path that passes through its keys.
#[derive(Clone, Debug)]
pub struct CameraPath {
    keys: Vec<PathKey>,
    /// Frame rate of the video that the path was made for, hertz, if it is given.
    pub rate_hz: Option<f64>,
    /// The cameras' centres in the world, metres, with their tangents (derivatives by the video's seconds).
    places: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Rotations `world_from_cam`, with the angular velocities in the camera's frame, radians per second.
    rotations: Vec<(UnitQuaternion<f64>, Vector3<f64>)>,
    /// For each parameter of the camera model, its value and slope at every key.
    lenses: Vec<Vec<(f64, f64)>>,
    /// The instants of the keys, with their slopes.
    times: Vec<(f64, f64)>,
    /// Arc lengths of the positions, if the speed is constant.
    lengths: Option<ArcLength>,
}

/// Why keys don't form a path. The message starts with the field.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PathError {
    #[error("keys: there are none")]
    NoKeys,
    #[error("keys: there are {count}, must be at most {MAX_KEYS}")]
    Keys { count: usize },
    #[error("keys[{key}].{field}: must be within {max:e} of 0")]
    Range { key: usize, field: &'static str, max: f64 },
    #[error("keys[{key}].at_s: is {}, must be at least {MIN_INTERVAL_S} s after {}", number(*.at_s), number(*.before_s))]
    Order { key: usize, at_s: f64, before_s: f64 },
    #[error(
        "keys[{key}].camera: is {model}, {width}×{height}, but keys[0] is {first}: a path keeps model and size"
    )]
    Lens { key: usize, model: &'static str, width: usize, height: usize, first: String },
    #[error("rate_hz: must be from {MIN_RATE_HZ} to {MAX_RATE_HZ}")]
    Rate,
    #[error("a path of {} s has {} frames at {} a second, must be at most {MAX_FRAMES}", number(*.duration_s), number(*.frames), number(*.rate_hz))]
    Frames { duration_s: f64, frames: f64, rate_hz: f64 },
}

/// Largest number of keys: an hour with 27 keys per second.
const MAX_KEYS: usize = 100_000;
/// Largest absolute time in the video and of an instant, seconds (a century). Differences then have microseconds of
/// precision.
const MAX_SECONDS: f64 = 4e9;
/// Smallest time between two keys, seconds. Smaller differences would be dominated by rounding.
const MIN_INTERVAL_S: f64 = 1e-6;
/// Largest absolute value of a lens parameter. Derivatives then stay finite.
const MAX_PARAM: f64 = 1e9;
/// Smallest frame rate, hertz: a frame in 17 minutes, for time lapses.
pub const MIN_RATE_HZ: f64 = 1e-3;
/// Largest frame rate, hertz.
pub const MAX_RATE_HZ: f64 = 1e3;
/// Frame rate of a path that has none of its own, hertz.
pub const PATH_RATE_HZ: f64 = 30.0;
/// Default duration of a ready-made path, seconds.
pub const READY_MADE_S: f64 = 4.0;
/// Maximum number of frames.
const MAX_FRAMES: usize = 1_000_000;

/// Whether a number is a valid frame rate: within [`MIN_RATE_HZ`] and [`MAX_RATE_HZ`].
pub fn is_rate_hz(rate_hz: f64) -> bool {
    (MIN_RATE_HZ..=MAX_RATE_HZ).contains(&rate_hz)
}

impl CameraPath {
    /// A path through keys, ascending in `at_s`. With `constant_speed`, the position moves at constant speed from the
    /// first to the last key. Direction and lens follow the position along the path; the instant remains a function of
    /// the video's time.
    ///
    /// # Errors
    /// If there is no key or too many, if a number is out of range, if keys don't ascend, or if their lenses differ in
    /// model or size.
    pub fn new(keys: Vec<PathKey>, constant_speed: bool) -> Result<Self, PathError> {
        check(&keys)?;
        let at_s: Vec<f64> = keys.iter().map(|key| key.at_s).collect();
        let rests: Vec<bool> = keys.iter().map(|key| key.rest).collect();
        let centers: Vec<Vector3<f64>> =
            keys.iter().map(|key| key.camera.center().coords).collect();
        let place_tangents = resting(&rests, tangents(&at_s, &centers));
        let rotations: Vec<_> =
            keys.iter().map(|key| key.camera.cam_from_world.rotation.inverse()).collect();
        let velocities = resting(&rests, rotation_tangents(&at_s, &rotations));
        let with_tangents = |values: Vec<f64>| -> Vec<(f64, f64)> {
            let slopes = resting(&rests, monotone_tangents(&at_s, &values));
            values.into_iter().zip(slopes).collect()
        };
        let params: Vec<Vec<f64>> = keys.iter().map(|key| key.camera.model.params()).collect();
        let param = |p: usize| params.iter().map(|params| params[p]).collect();
        let lenses = (0..params[0].len()).map(|p| with_tangents(param(p))).collect();
        let times = with_tangents(keys.iter().map(|key| key.time_s).collect());
        let places: Vec<_> = centers.into_iter().zip(place_tangents).collect();
        let lengths = if constant_speed { ArcLength::new(&at_s, &places) } else { None };
        let rotations = rotations.into_iter().zip(velocities).collect();
        Ok(Self { keys, rate_hz: None, places, rotations, lenses, times, lengths })
    }

    /// The keys, ascending in `at_s`.
    pub fn keys(&self) -> &[PathKey] {
        &self.keys
    }

    /// Time from the first to the last key, seconds.
    pub fn duration_s(&self) -> f64 {
        self.keys[self.keys.len() - 1].at_s - self.keys[0].at_s
    }

    /// The same path, stretched to another duration. A path with one key is unchanged.
    #[must_use]
    pub fn lasting(&self, duration_s: f64) -> Self {
        let factor = duration_s / self.duration_s();
        let mut keys = self.keys.clone();
        keys.iter_mut().for_each(|key| key.at_s = (key.at_s - self.keys[0].at_s) * factor);
        let played = Self::new(keys, self.lengths.is_some());
        played.map_or_else(|_| self.clone(), |path| Self { rate_hz: self.rate_hz, ..path })
    }

    /// The path, showing instants that are `seconds` later.
    #[must_use]
    pub fn later(mut self, seconds: f64) -> Self {
        self.keys.iter_mut().for_each(|key| key.time_s += seconds);
        self.times.iter_mut().for_each(|(time_s, _)| *time_s += seconds);
        self
    }

    /// The view at `passed_s` seconds after the first key. Before the first and after the last key, it is that key's
    /// view.
    pub fn at(&self, passed_s: f64) -> PathFrame {
        let at_s = self.keys[0].at_s + passed_s.clamp(0.0, self.duration_s());
        let moved_s = self.lengths.as_ref().map_or(at_s, |lengths| lengths.parameter(at_s));
        let moved = self.interval(moved_s);
        let place = moved.value(self.places[moved.key], self.places[moved.next]);
        let (before, after) = (self.rotations[moved.key], self.rotations[moved.next]);
        let rotation = cumulative(moved.passed, moved.length, before, after);
        let cam_from_world = Isometry3::from_parts(place.into(), rotation).inverse();
        let params: Vec<f64> =
            self.lenses.iter().map(|of| moved.monotone(of[moved.key], of[moved.next])).collect();
        let shown = self.interval(at_s);
        let time_s = shown.monotone(self.times[shown.key], self.times[shown.next]);
        let first = &self.keys[0].camera;
        // Name and number of parameters come from the path's own model, so that this can't fail.
        let model = CameraModel::from_params(first.model.name(), &params).unwrap_or(first.model);
        PathFrame { camera: Camera { model, cam_from_world, ..first.clone() }, time_s }
    }

    /// The number of frames of a video of this duration.
    ///
    /// # Errors
    /// If the number exceeds the maximum.
    pub fn frame_count(duration_s: f64, rate_hz: f64) -> Result<usize, PathError> {
        // A small margin keeps rounding from losing the last frame.
        let frames = (duration_s * rate_hz + 1e-6).floor() + 1.0;
        if !(frames <= MAX_FRAMES as f64) {
            return Err(PathError::Frames { duration_s, frames, rate_hz });
        }
        Ok(frames as usize)
    }

    /// The frames of a video with this frame rate. The first frame shows the first key. The last frame is less than
    /// one frame interval before the last key, or exactly there.
    ///
    /// # Errors
    /// If the number of frames exceeds the maximum.
    pub fn frames(&self, rate_hz: f64) -> Result<Vec<PathFrame>, PathError> {
        let count = Self::frame_count(self.duration_s(), rate_hz)?;
        Ok((0..count).map(|k| self.at(k as f64 / rate_hz)).collect())
    }

    fn interval(&self, at_s: f64) -> Hermite {
        Hermite::at(at_s, &self.keys, |key| key.at_s)
    }
}

fn check(keys: &[PathKey]) -> Result<(), PathError> {
    let first = &keys.first().ok_or(PathError::NoKeys)?.camera;
    if keys.len() > MAX_KEYS {
        return Err(PathError::Keys { count: keys.len() });
    }
    let lens = |camera: &Camera| (camera.model.name(), camera.width, camera.height);
    for (index, key) in keys.iter().enumerate() {
        let within = |field, max: f64, values: &[f64]| match values.iter().all(|v| v.abs() <= max) {
            true => Ok(()),
            false => Err(PathError::Range { key: index, field, max }),
        };
        within("at_s", MAX_SECONDS, &[key.at_s])?;
        within("time_s", MAX_SECONDS, &[key.time_s])?;
        within("camera.params", MAX_PARAM, &key.camera.model.params())?;
        let (model, width, height) = lens(&key.camera);
        if lens(first) != (model, width, height) {
            let (name, w, h) = lens(first);
            let first = format!("{name}, {w}×{h}");
            return Err(PathError::Lens { key: index, model, width, height, first });
        }
        if let Some(before) = index.checked_sub(1).map(|before| &keys[before])
            && !(key.at_s - before.at_s >= MIN_INTERVAL_S)
        {
            let (at_s, before_s) = (key.at_s, before.at_s);
            return Err(PathError::Order { key: index, at_s, before_s });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
