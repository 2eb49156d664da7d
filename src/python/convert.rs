//! Conversions between Rust values and Python values.

use crate::camera::{Camera, CameraFormat};
use crate::json::JsonError;
use crate::lumigraph::Rendered;
use crate::method::Method;
use crate::options::{Preset, RenderOptions};
use crate::raster::{BitDepth, Image, Quantized, Samples};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use std::error::Error;
use std::io::ErrorKind;

/// Returns a Python `ValueError` for bad input. Its message is the text of `error`, as the command line would print it.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Converts a Python value to a Rust value, through JSON. The Python value consists of dicts, lists, numbers and
/// strings. Error messages start with `what`, the name of the argument.
pub fn from_python<T: DeserializeOwned>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<T> {
    crate::json::parse(&json_of(value)?).map_err(|e| value_error(format!("{what}: {e}")))
}

/// Returns a Python `FileNotFoundError` if the cause of an error is a missing file, otherwise a [`value_error`].
pub fn file_error(error: impl Error + 'static) -> PyErr {
    let mut cause: Option<&(dyn Error + 'static)> = Some(&error);
    while let Some(found) = cause {
        let io = match found.downcast_ref() {
            Some(JsonError::Read(io)) => Some(io),
            _ => found.downcast_ref::<std::io::Error>(),
        };
        if io.is_some_and(|io| io.kind() == ErrorKind::NotFound) {
            return PyFileNotFoundError::new_err(error.to_string());
        }
        cause = found.source();
    }
    value_error(error)
}

/// Returns the options of a Python call: a preset's options, overridden by the dict `options`. If `preset` is `None`,
/// the preset is the one that `options` names, or else the default preset. All values are checked as on the command
/// line. The name of an option may be a path, such as `blend.cameras`. The value of `proxy` or `blend` may be the name
/// of a method.
pub fn checked(
    options: Option<&Bound<'_, PyAny>>,
    preset: Option<&str>,
) -> PyResult<RenderOptions> {
    let preset = preset.map(|name| {
        Preset::from_name(name).ok_or_else(|| {
            value_error(format!("preset: '{name}' is none of {}", names::<Preset>()))
        })
    });
    let preset = preset.transpose()?;
    let text = options.map_or_else(|| Ok("{}".to_owned()), json_of)?;
    let wrong = |error: String| value_error(format!("options: {error}"));
    let value: Value = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
    let text = nested(value).to_string();
    RenderOptions::parse(&text, preset).map_err(|e| wrong(e.to_string()))
}

pub fn names<M: Method>() -> String {
    M::ALL.iter().map(|method| method.name()).collect::<Vec<_>>().join(", ")
}

/// Converts a JSON object of options whose names may be paths, such as `blend.cameras`, to the nested form of an
/// options file.
fn nested(options: Value) -> Value {
    let Value::Object(options) = options else { return options };
    let mut found = Map::new();
    for (name, value) in options {
        let name = match (&*name, &value) {
            ("proxy" | "blend", Value::String(_)) => format!("{name}.method"),
            _ => name,
        };
        match name.split_once('.') {
            Some((group, option)) => {
                let group = found.entry(group).or_insert_with(|| json!({}));
                if let Value::Object(group) = group {
                    group.insert(option.to_owned(), value);
                }
            }
            None => {
                found.insert(name, value);
            }
        }
    }
    Value::Object(found)
}

/// Converts a Python value to JSON text.
pub fn json_of(value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.py().import("json")?.call_method1("dumps", (value,))?.extract()
}

/// Converts a Rust value to Python dicts, lists, numbers and strings, through JSON.
pub fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let json = serde_json::to_string(value).map_err(value_error)?;
    py.import("json")?.call_method1("loads", (json,))
}

/// Converts a rendered view to an array (H, W, channels) of integers with the bit depth `depth`. An alpha channel is
/// added if `alpha` is true. If `alpha` is `None`, an alpha channel is added only if there are pixels that no camera
/// sees.
pub fn view_to_python<'py>(
    py: Python<'py>,
    view: &Rendered,
    depth: BitDepth,
    alpha: Option<bool>,
) -> PyResult<Bound<'py, PyAny>> {
    let has_alpha = alpha.unwrap_or_else(|| view.coverage.contains(&false));
    let coverage = has_alpha.then_some(view.coverage.as_slice());
    image_to_python(py, &view.image, coverage, depth)
}

/// Converts an image to an array (H, W, channels) of integers with the bit depth `depth`. If `coverage` is given, an
/// alpha channel is added, which is 0 where `coverage` is false.
pub fn image_to_python<'py>(
    py: Python<'py>,
    image: &Image,
    coverage: Option<&[bool]>,
    depth: BitDepth,
) -> PyResult<Bound<'py, PyAny>> {
    let Quantized { channels, samples, .. } = py.detach(|| Quantized::new(image, coverage, depth));
    let shape = [image.height(), image.width(), channels];
    Ok(match samples {
        Samples::Eight(raw) => raw.into_pyarray(py).reshape(shape)?.into_any(),
        Samples::Sixteen(raw) => raw.into_pyarray(py).reshape(shape)?.into_any(),
    })
}

/// Converts a camera to a Python dict in the form of a camera in `capture.json`. If `id` is given, it becomes the
/// dict's field `id`.
pub fn camera_to_python<'py>(
    py: Python<'py>,
    id: Option<&str>,
    camera: &Camera,
) -> PyResult<Bound<'py, PyAny>> {
    let mut value = serde_json::to_value(CameraFormat::from(camera)).map_err(value_error)?;
    if let (Some(fields), Some(id)) = (value.as_object_mut(), id) {
        fields.insert("id".to_owned(), json!(id));
    }
    to_python(py, &value)
}
