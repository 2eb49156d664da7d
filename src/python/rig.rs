//! `stlfr.read_rig`, `stlfr.check_rig` and `stlfr.generate_rig`.

use super::convert::{from_python, json_of, to_python, value_error};
use crate::rig::{Rig, RigOptions};
use pyo3::prelude::*;
use std::path::PathBuf;

/// The content of a rig file, checked; fields that have their default values are left out.
#[pyfunction]
pub fn read_rig(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let rig = py.detach(|| Rig::read(&path)).map_err(value_error)?;
    to_python(py, &rig)
}

/// Refuses a rig that `stlfr rig --check` would refuse.
#[pyfunction]
pub fn check_rig(py: Python<'_>, rig: &Bound<'_, PyAny>) -> PyResult<()> {
    let text = json_of(rig)?;
    py.detach(|| Rig::parse(&text)).map(drop).map_err(value_error)
}

/// The rig that `stlfr rig` writes for the same options and seed.
#[pyfunction]
#[pyo3(signature = (options=None))]
pub fn generate_rig<'py>(
    py: Python<'py>,
    options: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let options: Option<RigOptions> = from_python(options, "options")?;
    let options = options.unwrap_or_default();
    to_python(py, &py.detach(|| options.generate()).map_err(value_error)?)
}
