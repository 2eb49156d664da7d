//! Camera paths: position, direction, lens and instant of a view as continuous functions of the time in a video. The
//! lens of a view is its intrinsic parameters. The instant is the time in the recording that the view shows.
//!
//! A path is given by key frames, here called keys. Position, direction, lens and instant are interpolated between the
//! keys, with continuous first derivatives:
//!
//! - The position follows cubic Hermite splines, with tangents from parabolas through three keys. It does not move
//!   between keys at the same position.
//! - The direction follows a spline of unit quaternions, always along the shorter arc, with tangents from parabolas
//!   too.
//! - Lens and instant follow monotone splines, which never overshoot. Time thus stands still between keys with the same
//!   instant.
//!
//! The JSON file of a path ([`PathFormat`]):
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
//! `at_s` is the time of the key in the video. `time_s` is the instant of the recording that the video then shows. Both
//! are in seconds. Between keys with equal `time_s`, time stands still. Between keys with descending `time_s`, time
//! runs backwards. At a key with `rest`, position, direction, lens and instant come to rest: their derivatives are 0.
//! With `"constant_speed": true`, the position moves at constant speed, and only the instant rests at such a key.
//! `rate_hz`, `rest` and `constant_speed` are optional.
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

/// A key frame of a camera path: the view at one time in the video, and the instant of the recording that this view
/// shows.
#[derive(Clone, Debug, PartialEq)]
pub struct PathKey {
    /// Time of the key in the video, seconds.
    pub at_s: f64,
    /// Instant of the recording that the video shows at this key, seconds on the reference camera's clock.
    pub time_s: f64,
    /// Pose, lens model and image size of the view.
    pub camera: Camera,
    /// Whether the derivatives of the camera's position, direction, lens and instant are 0 at this key, so that the
    /// motion comes to rest. On a path with constant speed, only the instant's derivative is 0.
    pub rest: bool,
}

/// A frame of a video along a camera path.
#[derive(Clone, Debug, PartialEq)]
pub struct PathFrame {
    /// Pose, lens model and image size of the view.
    pub camera: Camera,
    /// Instant of the recording that the frame shows, seconds on the reference camera's clock.
    pub time_s: f64,
}

/// A continuous camera path, which passes through all of its keys.
#[derive(Clone, Debug)]
pub struct CameraPath {
    keys: Vec<PathKey>,
    /// Frame rate of the video for which the path was made, hertz. `None` if the path doesn't specify a frame rate.
    pub rate_hz: Option<f64>,
    /// Camera centre and tangent of the centre's curve at every key. Centres are in the world, metres. Tangents are
    /// derivatives with respect to the time in the video, metres per second.
    places: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Rotation `world_from_cam` and angular velocity at every key. Angular velocities are in the camera's frame,
    /// radians per second of the video.
    rotations: Vec<(UnitQuaternion<f64>, Vector3<f64>)>,
    /// For each parameter of the camera model, one pair per key: the parameter's value, and its derivative with respect
    /// to the time in the video.
    lenses: Vec<Vec<(f64, f64)>>,
    /// One pair per key: the instant of the recording, seconds, and its derivative with respect to the time in the
    /// video.
    times: Vec<(f64, f64)>,
    /// Arc lengths of the curve of camera centres. `None` if the path has no constant speed, or if this curve has no
    /// length.
    lengths: Option<ArcLength>,
}

/// Reason why keys don't form a camera path, or why a path can't be divided into frames. The message names the invalid
/// field.
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

/// Maximum number of key frames of a camera path: enough for an hour with 27 keys per second.
const MAX_KEYS: usize = 100_000;
/// Maximum absolute value of a time in the video and of an instant of the recording, seconds: more than a century.
/// Within this range, differences of times are precise to microseconds.
const MAX_SECONDS: f64 = 4e9;
/// Minimum time in the video between two keys, seconds. Smaller differences would be dominated by rounding errors.
const MIN_INTERVAL_S: f64 = 1e-6;
/// Maximum absolute value of a lens parameter. Within this range, derivatives stay finite.
const MAX_PARAM: f64 = 1e9;
/// Minimum frame rate of a video, hertz: one frame every 17 minutes, for time lapses.
pub const MIN_RATE_HZ: f64 = 1e-3;
/// Maximum frame rate of a video, hertz.
pub const MAX_RATE_HZ: f64 = 1e3;
/// Default frame rate of a video along a camera path, hertz. It is used if neither the path nor the user specifies one.
pub const PATH_RATE_HZ: f64 = 30.0;
/// Default duration of a ready-made path, seconds.
pub const READY_MADE_S: f64 = 4.0;
/// Maximum number of frames of a video along a path.
const MAX_FRAMES: usize = 1_000_000;

/// Returns whether a number is a valid frame rate, from [`MIN_RATE_HZ`] to [`MAX_RATE_HZ`].
pub fn is_rate_hz(rate_hz: f64) -> bool {
    (MIN_RATE_HZ..=MAX_RATE_HZ).contains(&rate_hz)
}

impl CameraPath {
    /// Creates a path through key frames, which must ascend in `at_s`. If `constant_speed` is true, the position moves
    /// at constant speed from the first to the last key. Direction and lens then follow the position along the path,
    /// but the instant remains a function of the time in the video.
    ///
    /// # Errors
    /// If `keys` is empty or too long, if a number is out of range, if `at_s` doesn't ascend, or if the keys' cameras
    /// differ in lens model or image size.
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

    /// Returns the path's key frames, ascending in `at_s`.
    pub fn keys(&self) -> &[PathKey] {
        &self.keys
    }

    /// Returns the path's duration: the time in the video from the first to the last key, seconds.
    pub fn duration_s(&self) -> f64 {
        self.keys[self.keys.len() - 1].at_s - self.keys[0].at_s
    }

    /// Returns the path, stretched or compressed in time to `duration_s` seconds. Its first key is then at 0 s. A path
    /// with one key is unchanged.
    ///
    /// # Errors
    /// If the new times are out of range or too close together.
    pub fn lasting(&self, duration_s: f64) -> Result<Self, PathError> {
        if self.keys.len() == 1 {
            return Ok(self.clone());
        }
        let factor = duration_s / self.duration_s();
        let mut keys = self.keys.clone();
        keys.iter_mut().for_each(|key| key.at_s = (key.at_s - self.keys[0].at_s) * factor);
        Ok(Self { rate_hz: self.rate_hz, ..Self::new(keys, self.lengths.is_some())? })
    }

    /// Returns the path with `seconds` added to the instant of the recording that each view shows. If `seconds` is
    /// positive, the path shows later instants.
    #[must_use]
    pub fn later(mut self, seconds: f64) -> Self {
        self.keys.iter_mut().for_each(|key| key.time_s += seconds);
        self.times.iter_mut().for_each(|(time_s, _)| *time_s += seconds);
        self
    }

    /// Returns the view and its instant at `passed_s` seconds of the video after the first key. Times before the first
    /// key give the view of the first key. Times after the last key give the view of the last key.
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
        // The model's name and number of parameters are the path's own, so that this can't fail.
        let model = CameraModel::from_params(first.model.name(), &params).unwrap_or(first.model);
        PathFrame { camera: Camera { model, cam_from_world, ..first.clone() }, time_s }
    }

    /// Returns the number of frames of a video with this duration and frame rate. The first frame is at the start. The
    /// last frame is at the end, or less than one frame interval before it.
    ///
    /// # Errors
    /// If the number exceeds the maximum of a million frames.
    pub fn frame_count(duration_s: f64, rate_hz: f64) -> Result<usize, PathError> {
        // A small margin, so that rounding errors don't drop the last frame.
        let frames = (duration_s * rate_hz + 1e-6).floor() + 1.0;
        if !(frames <= MAX_FRAMES as f64) {
            return Err(PathError::Frames { duration_s, frames, rate_hz });
        }
        Ok(frames as usize)
    }

    /// Returns the frames of a video along the path, with this frame rate in hertz. The first frame is at the first
    /// key. The last frame is at the last key, or less than one frame interval before it.
    ///
    /// # Errors
    /// If the number of frames exceeds the maximum of a million.
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
