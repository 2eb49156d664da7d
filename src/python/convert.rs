//! Conversions between Rust's values and Python's.

use crate::lumigraph::Rendered;
use crate::options::RenderOptions;
use crate::raster::{BitDepth, Image, Samples, quantize};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A `ValueError` about bad input, with the sentence that the command line prints.
pub fn value_error(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Converts a Python value of dicts, lists, numbers and strings by way of its JSON. Errors start with `what`.
pub fn from_python<T: DeserializeOwned>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<T> {
    crate::json::parse(&json_of(value)?).map_err(|e| value_error(format!("{what}: {e}")))
}

/// The options of a call, checked as the command line checks an options file; the defaults if none are given.
pub fn checked(options: Option<&Bound<'_, PyAny>>) -> PyResult<RenderOptions> {
    let Some(options) = options else { return Ok(RenderOptions::default()) };
    RenderOptions::parse(&json_of(options)?, None).map_err(|e| value_error(format!("options: {e}")))
}

/// The JSON text of a value.
pub fn json_of(value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.py().import("json")?.call_method1("dumps", (value,))?.extract()
}

/// Converts a value to Python's dicts, lists, numbers and strings by way of its JSON.
pub fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let json = serde_json::to_string(value).map_err(value_error)?;
    py.import("json")?.call_method1("loads", (json,))
}

/// An array (H, W, channels) of the samples that a PNG of this view would hold.
pub fn view_to_python<'py>(
    py: Python<'py>,
    view: &Rendered,
    depth: BitDepth,
) -> PyResult<Bound<'py, PyAny>> {
    let coverage = view.coverage.contains(&false).then_some(view.coverage.as_slice());
    image_to_python(py, &view.image, coverage, depth)
}

/// An array (H, W, channels) of the samples that a PNG of this image would hold.
pub fn image_to_python<'py>(
    py: Python<'py>,
    image: &Image,
    coverage: Option<&[bool]>,
    depth: BitDepth,
) -> PyResult<Bound<'py, PyAny>> {
    let (channels, samples) = py.detach(|| quantize(image, coverage, depth));
    let shape = [image.height(), image.width(), channels];
    Ok(match samples {
        Samples::Eight(raw) => raw.into_pyarray(py).reshape(shape)?.into_any(),
        Samples::Sixteen(raw) => raw.into_pyarray(py).reshape(shape)?.into_any(),
    })
}
