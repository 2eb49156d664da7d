//! Functions of the Python module `stlfr` that don't need an open capture.

use super::convert::{checked, file_error, from_python, json_of, to_python, value_error};
use crate::camera::{CameraFormat, ViewFormat};
use crate::capture::{Capture, Opening, OutputGuard, Truth};
use crate::cli;
use crate::compare::{CompareOptions, ComparedLightField, FILES, Renderer, compare as compared};
use crate::display::QuiltLayout;
use crate::exchange;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::option::choices;
use crate::options::{Preset, ProxyMethod, RenderOptions, TrailMode};
use crate::progress::Reporter;
use crate::rig::{Rig, RigOptions};
use crate::toolchain::find_ffmpeg;
use pyo3::prelude::*;
use serde_json::{Value, json};
use std::error::Error;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Returns the methods that the options `sync`, `proxy`, `trail` and `preset` can name. The result is a dict with one
/// entry per option: the name of the default method, and the list of all methods.
#[pyfunction]
pub fn methods(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let stages = json!({
        "sync": stage::<SyncMethod>(),
        "proxy": stage::<ProxyMethod>(),
        "trail": stage::<TrailMode>(),
        "preset": stage::<Preset>(),
    });
    to_python(py, &stages)
}

/// Returns a list of all options, each with its default, range, unit and help text.
#[pyfunction]
pub fn options(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    to_python(py, &RenderOptions::default().declared())
}

/// Returns a list of the quilt layouts of known light-field displays, each with the display's name.
#[pyfunction]
pub fn displays(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let display = |(name, layout): &(&str, QuiltLayout)| {
        let &QuiltLayout { columns, rows, size_px: [width, height], aspect, cone_deg } = layout;
        json!({ "name": name, "columns": columns, "rows": rows, "width": width, "height": height,
            "aspect": aspect, "cone_deg": cone_deg, "suffix": layout.name() })
    };
    to_python(py, &QuiltLayout::of_displays().iter().map(display).collect::<Vec<_>>())
}

/// Runs the command line of `stlfr` with `arguments`, and returns the exit code. `program` is the path of the program
/// `stlfr`. If `lines` is true, progress is printed on standard output, one JSON object per line.
#[pyfunction]
#[pyo3(signature = (program, arguments, *, lines=false))]
pub fn run_command(py: Python<'_>, program: PathBuf, arguments: Vec<OsString>, lines: bool) -> u8 {
    let arguments = std::iter::once(OsString::from("stlfr")).chain(arguments);
    py.detach(|| cli::main(&program, arguments, lines))
}

fn stage<M: Method>() -> Value {
    json!({ "default": M::default().name(), "methods": choices::<M>() })
}

/// Reads and checks a rig file, which describes a simulated camera rig. Returns its contents as a dict. Fields with
/// their default values are omitted.
#[pyfunction]
pub fn read_rig(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let rig = py.detach(|| Rig::read(&path)).map_err(file_error)?;
    to_python(py, &rig)
}

/// Raises ValueError if `stlfr rig --check` would refuse a rig. `rig` is a dict with the contents of a rig file.
#[pyfunction]
pub fn check_rig(py: Python<'_>, rig: &Bound<'_, PyAny>) -> PyResult<()> {
    let text = json_of(rig)?;
    py.detach(|| Rig::parse(&text)).map(drop).map_err(value_error)
}

/// Returns the contents of the rig file that `stlfr rig` would write with the same options. `options` is a dict, and
/// includes the random seed.
#[pyfunction]
#[pyo3(signature = (options=None))]
pub fn generate_rig<'py>(
    py: Python<'py>,
    options: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let options = options.map(|options| from_python::<RigOptions>(options, "options"));
    let options = options.transpose()?.unwrap_or_default();
    to_python(py, &py.detach(|| options.generate()).map_err(value_error)?)
}

/// Returns the files of a COLMAP text model, as a dict from file name to contents. `images` are pairs of image name and
/// camera. A camera is a dict in the format of capture.json.
#[pyfunction]
pub fn colmap_text<'py>(
    py: Python<'py>,
    images: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let images: Vec<(String, ViewFormat)> = from_python(images, "images")?;
    let named = |(name, view): (String, ViewFormat)| (name, CameraFormat::from(view));
    let images: Vec<(String, CameraFormat)> = images.into_iter().map(named).collect();
    for (k, (name, _)) in images.iter().enumerate() {
        if name.is_empty() || name.contains(char::is_control) {
            return Err(value_error(format!("images[{k}]: {name:?} is no name of an image")));
        }
    }
    to_python(py, &py.detach(|| exchange::colmap_text(&images)))
}

/// Compares rendered views of a capture with the capture's ground truth, like `stlfr compare`. The results are written
/// into the capture's folder `review`. Returns the paths of the report and of `review.json`. If `lines` is true,
/// progress is printed on standard output, one JSON object per line.
#[pyfunction]
#[pyo3(signature = (path, *, options=None, lines=false))]
pub fn compare<'py>(
    py: Python<'py>,
    path: PathBuf,
    options: Option<&Bound<'py, PyAny>>,
    lines: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let options = checked(options, None)?;
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
