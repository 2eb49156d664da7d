//! The Python module `stlfr`, which is built with the Cargo feature `python`. Each function converts its arguments,
//! releases the GIL, makes one call of the library, and converts the result. Bad input raises `ValueError` with the
//! sentence that the command line would print.

mod capture;
mod convert;
mod functions;
mod path;
mod view_settings;

use pyo3::prelude::*;

/// The compiled part of the Python module `stlfr`. The Python package in `blender/module/stlfr` exports it under the
/// public name, with type stubs.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use super::capture::{PyCapture, PyMoment, open, project};
    #[pymodule_export]
    use super::functions::{
        check_rig, colmap_text, compare, displays, generate_rig, methods, options, read_rig,
        run_command,
    };
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
