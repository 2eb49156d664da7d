//! `stlfr.compare`.

use super::capture::checked;
use super::convert::{to_python, value_error};
use crate::capture::{Capture, Opening, OutputGuard, Truth};
use crate::compare::{CompareOptions, ComparedLightField, FILES, Renderer, compare as compared};
use crate::progress::Reporter;
use crate::toolchain::find_ffmpeg;
use pyo3::prelude::*;
use serde_json::json;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Compares a capture with its truth, as `stlfr compare` does, into its folder `review`; gives the report's file
/// and the layout's. With `lines`, progress goes to standard output, one JSON object a line.
#[pyfunction]
#[pyo3(signature = (path, *, options=None, lines=false))]
pub fn compare<'py>(
    py: Python<'py>,
    path: PathBuf,
    options: Option<&Bound<'py, PyAny>>,
    lines: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let options = checked(options)?;
    let reporter = if lines { Reporter::lines() } else { Reporter::silent() };
    let work = || -> Result<_, Box<dyn Error + Send + Sync>> {
        let ffmpeg = find_ffmpeg();
        let opening = Opening { ffmpeg: ffmpeg.as_deref(), reporter: &reporter };
        let capture = Capture::open_with(&path, &opening)?;
        let out = capture.folder.join("review");
        OutputGuard::new(Some(&capture.folder)).check_folder(&out, &FILES)?;
        let truth = Truth::open(&capture.folder)?;
        let field = ComparedLightField::open(Arc::new(capture), &options, &reporter)?;
        let sync = Renderer::options(&field).sync;
        let compare_options = CompareOptions { sync, ..CompareOptions::default() };
        Ok(compared(&field, truth.as_ref(), &out, &compare_options, &reporter)?)
    };
    let summary = py.detach(work).map_err(value_error)?;
    let shown = |path: &Path| path.to_string_lossy().into_owned();
    to_python(py, &json!({ "report": shown(&summary.report), "review": shown(&summary.review) }))
}
