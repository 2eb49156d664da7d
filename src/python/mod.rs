//! The Python module `stlfr` (feature `python`): converts, releases the GIL, makes one call, and
//! converts back. Bad input is a `ValueError` with the sentence that the command line prints.

mod capture;
mod convert;
mod functions;

use pyo3::prelude::*;

/// The compiled half of the module; `blender/module/stlfr` gives it its name and its types.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use super::capture::{PyCapture, PyMoment, open, project};
    #[pymodule_export]
    use super::functions::{
        check_rig, colmap_text, compare, generate_rig, methods, options, read_rig, run_command,
    };
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
