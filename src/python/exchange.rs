//! `stlfr.colmap_text`.

use super::convert::{from_python, to_python, value_error};
use crate::camera::CameraFormat;
use crate::exchange;
use pyo3::prelude::*;

/// The files of COLMAP's text model by their names, from each image's name and camera.
#[pyfunction]
pub fn colmap_text<'py>(
    py: Python<'py>,
    images: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let images: Option<Vec<(String, CameraFormat)>> = from_python(Some(images), "images")?;
    let images = images.ok_or_else(|| value_error("images: are missing"))?;
    for (k, (name, _)) in images.iter().enumerate() {
        if name.is_empty() || name.contains(char::is_control) {
            return Err(value_error(format!("images[{k}]: {name:?} is no name of an image")));
        }
    }
    to_python(py, &py.detach(|| exchange::colmap_text(&images)))
}
