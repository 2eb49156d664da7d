//! Arguments and result of the Python method `Capture.path`, which returns the frames of a camera path.

use super::convert::{
    camera_to_python, checked, file_error, from_python, names, to_python, value_error,
};
use crate::json;
use crate::method::Method;
use crate::options::RenderOptions;
use crate::path::{
    CameraPath, PATH_RATE_HZ, PathError, PathFormat, PathFrame, READY_MADE_S, ReadyMadePath,
    is_rate_hz,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// The camera path that the argument `path` of the Python method `Capture.path` describes.
pub enum PathKeys {
    Given(CameraPath),
    /// A ready-made path, whose keys are still to be fitted to the capture.
    ReadyMade(ReadyMadePath),
}

impl PathKeys {
    /// Reads the argument `path`: the name of a ready-made path such as `"orbit"`, the name of a path's JSON file, or a
    /// dict with the content of such a file.
    pub fn of(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let wrong = |error: String| value_error(format!("path: {error}"));
        if source.is_instance_of::<PyDict>() {
            let format: PathFormat = from_python(source, "path")?;
            return Ok(Self::Given(format.path().map_err(wrong)?));
        }
        let file: PathBuf = source.extract()?;
        let name = file.to_str().unwrap_or_default();
        if let Some(kind) = ReadyMadePath::from_name(name) {
            return Ok(Self::ReadyMade(kind));
        }
        if file.extension().is_none_or(|extension| extension != "json") {
            let names = names::<ReadyMadePath>();
            return Err(wrong(format!("'{name}' is no .json and none of {names}")));
        }
        let format: PathFormat = json::read(&file).map_err(file_error)?;
        let of_file = |error| value_error(format!("{}: {error}", file.display()));
        Ok(Self::Given(format.path().map_err(of_file)?))
    }
}

/// The keyword arguments of the Python method `Capture.path`.
#[derive(Default)]
pub struct PathSettings {
    rate_hz: Option<f64>,
    duration_s: Option<f64>,
    /// The instant that all frames show, seconds on the reference camera's clock. `None` if the path's keys determine
    /// the instant of each frame.
    pub time_s: Option<f64>,
    pub options: RenderOptions,
}

impl PathSettings {
    pub fn of(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut read = Self::default();
        let (mut options, mut preset) = (None, None);
        for (name, value) in settings.into_iter().flatten() {
            let name: String = name.extract()?;
            match &*name {
                "rate_hz" => read.rate_hz = value.extract()?,
                "duration_s" => read.duration_s = value.extract()?,
                "time_s" => read.time_s = value.extract()?,
                "options" => options = Some(value).filter(|value| !value.is_none()),
                "preset" => preset = value.extract::<Option<String>>()?,
                _ => {
                    let sentence = format!("path() has no argument '{name}'");
                    return Err(PyTypeError::new_err(sentence));
                }
            }
        }
        if !read.rate_hz.is_none_or(is_rate_hz) {
            return Err(value_error(PathError::Rate));
        }
        let positive = |seconds: f64| seconds.is_finite() && seconds > 0.0;
        if !read.duration_s.is_none_or(positive) {
            return Err(value_error("duration_s: must be positive"));
        }
        if !read.time_s.is_none_or(f64::is_finite) {
            return Err(value_error("time_s: must be finite"));
        }
        read.options = checked(options.as_ref(), preset.as_deref())?;
        Ok(read)
    }

    /// Returns the duration of a ready-made path, seconds: the argument `duration_s`, or else [`READY_MADE_S`].
    pub fn ready_made_s(&self) -> f64 {
        self.duration_s.unwrap_or(READY_MADE_S)
    }

    /// Converts a camera path to the list of its frames. Each frame is a dict: `time_s` is its instant, seconds on the
    /// reference camera's clock, and `camera` is its view.
    pub fn frames_to_python<'py>(
        &self,
        py: Python<'py>,
        path: &CameraPath,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let lasting = |seconds| path.lasting(seconds).map_err(value_error);
        let path = self.duration_s.map_or_else(|| Ok(path.clone()), lasting)?;
        let rate_hz = self.rate_hz.or(path.rate_hz).unwrap_or(PATH_RATE_HZ);
        let frames = path.frames(rate_hz).map_err(value_error)?;
        let frame = |PathFrame { camera, time_s }: &PathFrame| {
            let frame = PyDict::new(py);
            frame.set_item("time_s", to_python(py, &self.time_s.unwrap_or(*time_s))?)?;
            frame.set_item("camera", camera_to_python(py, None, camera)?)?;
            Ok(frame)
        };
        frames.iter().map(frame).collect()
    }
}
