//! Keyword arguments of Python methods that render views.

use super::convert::{checked, from_python, value_error};
use crate::camera::{Camera, ViewFormat};
use crate::options::RenderOptions;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Keyword arguments of the Python methods `Capture.render`, `Capture.preview` and `Capture.load_preview`.
pub struct ViewSettings {
    pub camera: Option<Camera>,
    pub like: Option<String>,
    pub options: RenderOptions,
    pub alpha: Option<bool>,
    pub proceed: Option<Py<PyAny>>,
}

impl ViewSettings {
    /// Reads the arguments of the method `method`.
    pub fn of(method: &str, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let (mut camera, mut like, mut options, mut preset) = (None, None, None, None);
        let (mut alpha, mut proceed) = (None, None);
        for (name, value) in settings.into_iter().flatten() {
            if value.is_none() {
                continue;
            }
            match &*name.extract::<String>()? {
                "camera" => camera = Some(camera_of(&value)?),
                "like" => like = Some(value.extract()?),
                "options" => options = Some(value),
                "preset" => preset = Some(value.extract::<String>()?),
                "alpha" => alpha = Some(value.extract()?),
                "proceed" => proceed = Some(value.unbind()),
                other => {
                    let sentence = format!("{method}() has no argument '{other}'");
                    return Err(PyTypeError::new_err(sentence));
                }
            }
        }
        let options = checked(options.as_ref(), preset.as_deref())?;
        Ok(Self { camera, like, options, alpha, proceed })
    }
}

/// Converts a Python dict to a camera. The dict has the form of a camera in `capture.json`.
pub fn camera_of(object: &Bound<'_, PyAny>) -> PyResult<Camera> {
    let format: ViewFormat = from_python(object, "camera")?;
    format.camera().map_err(|e| value_error(format!("camera: {e}")))
}
