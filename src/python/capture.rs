//! The Python function `stlfr.open`, and the classes `stlfr.Capture` and `stlfr.Moment`.

use super::convert::{
    camera_to_python, checked, file_error, image_to_python, to_python, value_error, view_to_python,
};
use super::path::{PathKeys, PathSettings};
use super::view_settings::{ViewSettings, camera_of};
use crate::camera::Camera;
use crate::capture::{Capture, NamedView, Opening};
use crate::light_field::{Context, LightField, RenderError, Request, Viewpoint, render};
use crate::offset::offsets_from_images;
use crate::options::{ProxyMethod, RenderOptions, TrailOptions};
use crate::pipeline::{self, ready_made_path};
use crate::progress::Reporter;
use crate::raster::BitDepth;
use crate::registration::FrameStore;
use crate::scene_flow::Detail;
use crate::toolchain::find_ffmpeg;
use nalgebra::Point3;
use numpy::{AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArrayLikeDyn, ndarray};
use pyo3::exceptions::{PyInterruptedError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// What a preview requires.
struct Previewed {
    camera: Camera,
    options: RenderOptions,
    field: Arc<LightField>,
    alpha: Option<bool>,
}

/// Opens and checks a capture's folder.
///
/// Raises FileNotFoundError if there is no capture, and ValueError with one sentence if the capture is invalid.
#[pyfunction]
pub fn open(py: Python<'_>, path: PathBuf) -> PyResult<PyCapture> {
    let capture = py.detach(|| {
        let (ffmpeg, reporter) = (find_ffmpeg(), &Reporter::silent());
        Capture::open_with(&path, &Opening { ffmpeg: ffmpeg.as_deref(), reporter })
    });
    let capture = capture.map_err(file_error)?;
    Ok(PyCapture { capture: Arc::new(capture), opened: Mutex::default() })
}

/// A capture: calibrated cameras and their recorded frames.
#[pyclass(name = "Capture", module = "stlfr", frozen)]
pub struct PyCapture {
    capture: Arc<Capture>,
    /// LRU cache of open light fields, the most recently used first. Each light field caches registered frames for
    /// later views.
    opened: Mutex<Vec<Opened>>,
}

/// Maximum number of open light fields of a capture, one for each set of options. Each open light field takes memory
/// for its cache. With a smaller maximum, a viewer that alternates between a fast and an accurate method would register
/// frames again each time.
const MAX_OPENED: usize = 2;

/// A light field that is open in Python, and the options with which it was opened.
#[derive(Clone)]
struct Opened {
    options: RenderOptions,
    /// Options of the light field after the automatic choice of methods ([`pipeline::resolved`]).
    resolved: RenderOptions,
    field: Arc<LightField>,
}

#[pymethods]
impl PyCapture {
    #[new]
    #[pyo3(signature = (*_arguments))]
    fn new(_arguments: &Bound<'_, PyTuple>) -> PyResult<Self> {
        Err(PyTypeError::new_err("a capture is opened with stlfr.open(path)"))
    }

    /// Name of the capture.
    #[getter]
    fn name(&self) -> &str {
        &self.capture.name
    }

    /// Ids of the cameras, in the order of capture.json.
    #[getter]
    fn camera_ids(&self) -> Vec<&str> {
        self.capture.cameras.iter().map(|c| c.id.as_str()).collect()
    }

    /// All cameras of the capture, in the order of capture.json. Each is a dict in the form that the method `camera`
    /// returns.
    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        self.capture.cameras.iter().map(|c| camera_to_python(py, Some(&c.id), &c.camera)).collect()
    }

    /// Returns a camera as a dict with id, width, height, model, params and cam_from_world. `name` is the id of a
    /// camera, or the name of a view of the ground truth.
    fn camera<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        match self.capture.named_view(name).map_err(value_error)? {
            NamedView::Filming(index) => {
                camera_to_python(py, Some(name), &self.capture.cameras[index].camera)
            }
            NamedView::Free(camera) => camera_to_python(py, Some(name), &camera),
        }
    }

    /// Returns the first and the last time at which a camera has images, seconds on the reference camera's clock.
    /// Without `camera_id`, returns the first and the last time at which any camera has images. Unknown clock offsets
    /// are estimated first.
    #[pyo3(signature = (camera_id=None))]
    fn covered_s(&self, py: Python<'_>, camera_id: Option<&str>) -> PyResult<(f64, f64)> {
        let camera = camera_id.map(|id| self.index(id)).transpose()?;
        let opened = py.detach(|| self.opened(RenderOptions::default())).map_err(file_error)?;
        let times_s = opened.field.offsets().common_times_s(&self.capture);
        let is_asked = |index: usize| camera.is_none_or(|camera| camera == index);
        let asked = times_s.iter().enumerate().filter(|(index, _)| is_asked(*index));
        let spans = asked.filter_map(|(_, times)| {
            let times = times.as_ref()?;
            Some((*times.first()?, *times.last()?))
        });
        let origin_s = self.capture.time_origin_s;
        let span = spans.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let span = span.map(|(first, last)| (first + origin_s, last + origin_s));
        span.ok_or_else(|| value_error("the clock is unknown"))
    }

    /// Id of the reference camera. The times of views are seconds on this camera's clock.
    #[getter]
    fn reference(&self) -> &str {
        &self.capture.cameras[self.capture.reference].id
    }

    /// Projects world points (N, 3), in metres, to pixels (N, 2) of a camera.
    ///
    /// The centre of the top-left pixel is (0.5, 0.5). A point without a projection, such as a point behind the camera,
    /// gives a row of NaN. Pixels may lie outside of the image.
    fn project<'py>(
        &self,
        py: Python<'py>,
        camera_id: &str,
        points: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = &self.capture.cameras[self.index(camera_id)?].camera;
        projected(py, camera, &points)
    }

    /// Returns the time of every frame of a camera: the middle of the frame's exposure, seconds on the camera's own
    /// clock.
    fn times<'py>(&self, py: Python<'py>, camera_id: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.capture.times_in_file_s(self.index(camera_id)?).into_pyarray(py))
    }

    /// Returns a camera's recorded frame as an array (H, W, channels) in the camera's bit depth. The channels are RGB
    /// or grey, depending on the camera's field `color` in capture.json.
    fn frame<'py>(
        &self,
        py: Python<'py>,
        camera_id: &str,
        index: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let camera = self.index(camera_id)?;
        let filmed = &self.capture.cameras[camera];
        let count = filmed.clock.times_s.len();
        if index >= count {
            return Err(value_error(format!(
                "index: is {index}, and {camera_id} has {count} frames"
            )));
        }
        let image = py.detach(|| self.capture.read_frame(camera, index)).map_err(value_error)?;
        image_to_python(py, &image, None, filmed.bit_depth)
    }

    /// Returns the clock offset of every camera, in the form that `stlfr offsets --json` prints. Earlier estimates are
    /// read from the capture's folder; otherwise, offsets are estimated and saved there. An offsets.json that was
    /// edited by hand is neither used nor replaced.
    #[pyo3(signature = (options=None, *, preset=None))]
    fn offsets<'py>(
        &self,
        py: Python<'py>,
        options: Option<&Bound<'py, PyAny>>,
        preset: Option<&str>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let options = checked(options, preset)?;
        let offsets = py.detach(|| {
            self.capture.require_two_cameras()?;
            let frames = FrameStore::new(self.capture.clone(), &options.registration);
            offsets_from_images(&frames, &options.offset, &Reporter::silent())
        });
        to_python(py, &offsets.map_err(value_error)?)
    }

    /// Renders the view of a camera at a time in seconds on the reference camera's clock. Either `camera` or `like`
    /// must be given: `camera` is a dict in the form that `Capture.camera` returns; `like` is the id of a camera of the
    /// capture, or the name of a view of the ground truth.
    ///
    /// Returns an array (H, W, channels) in the capture's bit depth. The channels are RGB or grey. If `alpha` is true,
    /// an alpha channel follows. By default, an alpha channel follows if there are pixels that no camera sees.
    ///
    /// `options` has the contents of a file for `stlfr render --options`. Its values override those of `preset`. The
    /// name of an option may be a path, such as `blend.cameras`. The value of `proxy` or `blend` may be the name of a
    /// method.
    ///
    /// `proceed(done, total)` is called before every step of the work, with the number of finished instants and of all
    /// instants; only a motion trail has more than one instant. If the call returns a false value, rendering stops with
    /// an InterruptedError.
    #[pyo3(
        signature = (time_s, **settings),
        text_signature = "($self, time_s, *, camera=None, like=None, options=None, preset=None, alpha=None, proceed=None)"
    )]
    fn render<'py>(
        slf: &Bound<'py, Self>,
        time_s: f64,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (py, this) = (slf.py(), slf.get());
        let ViewSettings { camera, like, options, alpha, proceed } =
            ViewSettings::of("render", settings)?;
        let time_s = time_s - this.capture.time_origin_s;
        let view = match (camera, &like) {
            (Some(camera), None) => NamedView::Free(camera),
            (None, Some(name)) => this.capture.named_view(name).map_err(value_error)?,
            _ => return Err(value_error("either camera or like must be given")),
        };
        let from = match &view {
            NamedView::Filming(index) => Viewpoint::Like(*index),
            NamedView::Free(camera) => Viewpoint::View(camera),
        };
        let failed = Mutex::new(None);
        let proceed = |done, total| {
            goes_on(proceed.as_ref(), done, total).unwrap_or_else(|error| {
                *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                false
            })
        };
        let rendered = py.detach(|| {
            let opened = this.opened(options)?;
            let request = Request::new(from, time_s, &opened.resolved);
            render(&opened.field, &request, &Context::new(&proceed))
        });
        let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
        let rendered = match (failed, rendered) {
            (Some(error), _) => return Err(error),
            (None, Err(RenderError::Stopped)) => {
                return Err(PyInterruptedError::new_err(RenderError::Stopped.to_string()));
            }
            (None, rendered) => rendered.map_err(value_error)?,
        };
        view_to_python(py, &rendered, this.capture.bit_depth(), alpha)
    }

    /// Returns the frames of a camera path, as `stlfr render --path` renders them: a list of dicts with the arguments
    /// `time_s` and `camera` of `render`.
    ///
    /// `path` is one of these: the name of a ready-made path, which is fitted to this capture; the name of a path's
    /// file; a dict with the content of such a file. `rate_hz` is the frame rate, by default the path's own, or else
    /// 30. `duration_s` is the duration to which the path is stretched; a ready-made path lasts 4 s by default.
    /// `time_s` is an instant at which time is frozen for the whole path.
    #[pyo3(
        signature = (path, **settings),
        text_signature = "($self, path, *, rate_hz=None, duration_s=None, time_s=None, options=None, preset=None)"
    )]
    fn path<'py>(
        &self,
        py: Python<'py>,
        path: &Bound<'py, PyAny>,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let mut settings = PathSettings::of(settings)?;
        let path = match PathKeys::of(path)? {
            PathKeys::Given(path) => path,
            PathKeys::ReadyMade(kind) => {
                let origin_s = self.capture.time_origin_s;
                let frozen_s = settings.time_s.take().map(|time_s| time_s - origin_s);
                let options = std::mem::take(&mut settings.options);
                let duration_s = settings.ready_made_s();
                let fitted = py.detach(|| {
                    let Opened { resolved, field, .. } = self.opened(options)?;
                    ready_made_path(&field, &resolved, kind, duration_s, frozen_s)
                });
                let fitted = fitted.map_err(value_error)?;
                fitted.later(origin_s)
            }
        };
        settings.frames_to_python(py, &path)
    }

    /// Prepares one instant of the recording, so that many views of it can be rendered quickly. The cameras' images at
    /// this instant are computed once, here.
    ///
    /// A motion trail in `options` is ignored.
    #[pyo3(signature = (time_s, *, options=None, preset=None))]
    fn moment(
        &self,
        py: Python<'_>,
        time_s: f64,
        options: Option<&Bound<'_, PyAny>>,
        preset: Option<&str>,
    ) -> PyResult<PyMoment> {
        let options = checked(options, preset)?;
        let depth = self.capture.bit_depth();
        let time_s = time_s - self.capture.time_origin_s;
        let moment = py.detach(|| {
            let Opened { resolved, field, .. } = self.opened(options)?;
            // The views of a `Moment` show one instant, without a trail.
            let options = RenderOptions { trail: TrailOptions::default(), ..resolved };
            field.corrected_all(time_s, &options, &Context::unattended())?;
            Ok::<_, RenderError>(PyMoment { field, time_s, options, depth })
        });
        moment.map_err(value_error)
    }

    /// Renders the view of a camera quickly, for a viewpoint or a time that changes: by scene flow, with small losses
    /// at outlines. `camera`, `options` and `preset` are those of `render`; a motion trail is ignored.
    ///
    /// Returns a view if three things hold: `render` was called with the same options before, these options choose scene
    /// flow, and depth and motion of the frames are in memory or stored by `stlfr prepare`. Otherwise returns None.
    #[pyo3(
        signature = (time_s, **settings),
        text_signature = "($self, time_s, *, camera, options=None, preset=None, alpha=None)"
    )]
    fn preview<'py>(
        &self,
        py: Python<'py>,
        time_s: f64,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        let previewed = self.previewed("preview", settings)?;
        let Some(Previewed { camera, options, field, alpha }) = previewed else {
            return Ok(None);
        };
        let time_s = time_s - self.capture.time_origin_s;
        let rendered = py.detach(|| {
            if !field.has_flow(&camera, time_s, &options) {
                return Ok(None);
            }
            field.enlarge_cache();
            let request = Request::new(Viewpoint::View(&camera), time_s, &options);
            let request = Request { detail: Detail::Quick, ..request };
            render(&field, &request, &Context::unattended()).map(Some)
        });
        let rendered = rendered.map_err(value_error)?;
        rendered.map(|seen| view_to_python(py, &seen, self.capture.bit_depth(), alpha)).transpose()
    }

    /// Loads into memory what `preview` needs for this view. Returns whether `preview` can then render it. The arguments
    /// are the same; `alpha` makes no difference. Loading takes as long for a small view as for a large one.
    #[pyo3(
        signature = (time_s, **settings),
        text_signature = "($self, time_s, *, camera, options=None, preset=None)"
    )]
    fn load_preview(
        &self,
        py: Python<'_>,
        time_s: f64,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<bool> {
        let previewed = self.previewed("load_preview", settings)?;
        let Some(Previewed { camera, options, field, .. }) = previewed else { return Ok(false) };
        let time_s = time_s - self.capture.time_origin_s;
        field.enlarge_cache();
        py.detach(|| field.load_flow(&camera, time_s, &options)).map_err(value_error)
    }

    fn __repr__(&self) -> String {
        format!("<stlfr.Capture '{}': {} cameras>", self.capture.name, self.capture.cameras.len())
    }
}

/// One instant of a capture, prepared for rendering many views of it.
#[pyclass(name = "Moment", module = "stlfr", frozen)]
pub struct PyMoment {
    field: Arc<LightField>,
    time_s: f64,
    options: RenderOptions,
    depth: BitDepth,
}

#[pymethods]
impl PyMoment {
    /// Renders the view of a camera, given as a dict in the form that `Capture.camera` returns, at this instant. The
    /// pixels equal those of `Capture.render` with the same options, except that a motion trail is ignored.
    #[pyo3(signature = (camera, *, alpha=None))]
    fn view<'py>(
        &self,
        py: Python<'py>,
        camera: &Bound<'py, PyAny>,
        alpha: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let camera = camera_of(camera)?;
        let request = Request::new(Viewpoint::View(&camera), self.time_s, &self.options);
        let rendered = py.detach(|| render(&self.field, &request, &Context::unattended()));
        view_to_python(py, &rendered.map_err(value_error)?, self.depth, alpha)
    }
}

/// Projects world points (N, 3), in metres, to pixels (N, 2) of a camera. `camera` is a dict in the form that
/// `Capture.camera` returns. A point without a projection, such as a point behind the camera, gives a row of NaN.
#[pyfunction]
pub fn project<'py>(
    py: Python<'py>,
    camera: &Bound<'py, PyAny>,
    points: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    projected(py, &camera_of(camera)?, &points)
}

fn projected<'py>(
    py: Python<'py>,
    camera: &Camera,
    points: &PyArrayLikeDyn<'py, f64, AllowTypeChange>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let points = points.as_array();
    let wrong =
        || value_error(format!("points: have the shape {:?}, must be (N, 3)", points.shape()));
    let points = points.view().into_dimensionality::<ndarray::Ix2>().map_err(|_| wrong())?;
    if points.ncols() != 3 {
        return Err(wrong());
    }
    let pixels = py.detach(|| {
        let mut pixels = ndarray::Array2::from_elem((points.nrows(), 2), f64::NAN);
        for (point, mut pixel) in points.rows().into_iter().zip(pixels.rows_mut()) {
            if let Some(p) = camera.project(&Point3::new(point[0], point[1], point[2])) {
                (pixel[0], pixel[1]) = (p.x, p.y);
            }
        }
        pixels
    });
    Ok(pixels.into_pyarray(py))
}

/// Returns whether rendering continues: the truth value of the result of the caller's Python function `proceed`, or
/// true if `proceed` is `None`.
fn goes_on(proceed: Option<&Py<PyAny>>, done: usize, total: usize) -> PyResult<bool> {
    let Some(proceed) = proceed else { return Ok(true) };
    Python::attach(|py| proceed.call1(py, (done, total))?.is_truthy(py))
}

impl PyCapture {
    /// Returns the light field for these options, with the options after the automatic choice of methods. Light field
    /// and options are cached for later calls.
    fn opened(&self, options: RenderOptions) -> Result<Opened, RenderError> {
        let mut cached = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(k) = cached.iter().position(|opened| opened.options == options) {
            let opened = cached.remove(k);
            cached.insert(0, opened.clone());
            return Ok(opened);
        }
        let reporter = Reporter::silent();
        let shares_field = |opened: &&Opened| {
            let other = &opened.options;
            other.registration == options.registration && other.offset == options.offset
        };
        let field = match cached.iter().find(shares_field) {
            Some(opened) => opened.field.clone(),
            None => Arc::new(pipeline::open_field(self.capture.clone(), &options, &reporter)?),
        };
        let resolved = pipeline::resolved(&field, &options, &reporter)?;
        let opened = Opened { options, resolved, field };
        cached.insert(0, opened.clone());
        cached.truncate(MAX_OPENED);
        Ok(opened)
    }

    /// Returns what a preview requires, from the arguments of the Python method `method`. `None` if no light field is open for the
    /// options, or they don't choose scene flow.
    fn previewed(
        &self,
        method: &str,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Option<Previewed>> {
        let settings = ViewSettings::of(method, settings)?;
        let ViewSettings { camera, like: None, options, alpha, proceed: None } = settings else {
            let sentence = format!("{method}() has no arguments 'like' and 'proceed'");
            return Err(PyTypeError::new_err(sentence));
        };
        let camera = camera.ok_or_else(|| value_error("camera must be given"))?;
        let opened = self.opened_before(&options);
        let opened = opened.filter(|o| o.resolved.proxy.method == ProxyMethod::SceneFlow);
        Ok(opened.map(|Opened { resolved, field, .. }| {
            let options = RenderOptions { trail: TrailOptions::default(), ..resolved };
            Previewed { camera, options, field, alpha }
        }))
    }

    /// Returns what [`Self::opened`] has cached for these options. `None` if there is nothing, or if another thread
    /// opens a light field at the moment.
    fn opened_before(&self, options: &RenderOptions) -> Option<Opened> {
        let cached = self.opened.try_lock().ok()?;
        cached.iter().find(|opened| opened.options == *options).cloned()
    }

    fn index(&self, camera_id: &str) -> PyResult<usize> {
        self.capture.camera_index(camera_id).ok_or_else(|| {
            value_error(format!("no camera of this capture has the id '{camera_id}'"))
        })
    }
}
