//! `stlfr.open` and `stlfr.Capture`.

use crate::capture::{Capture, CaptureError};
use nalgebra::Point3;
use numpy::{AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArrayLikeDyn, ndarray};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Opens and checks a capture's folder.
#[pyfunction]
pub fn open(py: Python<'_>, path: PathBuf) -> PyResult<PyCapture> {
    py.detach(|| Capture::open(&path)).map(PyCapture).map_err(capture_error)
}

/// A capture: calibrated cameras and what they filmed.
#[pyclass(name = "Capture", module = "stlfr", frozen)]
pub struct PyCapture(Capture);

#[pymethods]
impl PyCapture {
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn camera_ids(&self) -> Vec<&str> {
        self.0.cameras.iter().map(|c| c.id.as_str()).collect()
    }

    #[getter]
    fn reference(&self) -> &str {
        &self.0.cameras[self.0.reference].id
    }

    /// Pixels of world points; NaN where a point has no image.
    fn project<'py>(
        &self,
        py: Python<'py>,
        camera_id: &str,
        points: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = &self.0.cameras[self.index(camera_id)?].camera;
        let points = points.as_array();
        let wrong = || {
            PyValueError::new_err(format!(
                "points: have the shape {:?}, must be (N, 3)",
                points.shape()
            ))
        };
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

    /// The middle of every frame's exposure, seconds on the camera's own clock.
    fn times<'py>(&self, py: Python<'py>, camera_id: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.0.times_in_file_s(self.index(camera_id)?).into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        format!("<stlfr.Capture '{}': {} cameras>", self.0.name, self.0.cameras.len())
    }
}

impl PyCapture {
    fn index(&self, camera_id: &str) -> PyResult<usize> {
        self.0.camera_index(camera_id).ok_or_else(|| {
            PyValueError::new_err(format!("camera_id: no camera has the id '{camera_id}'"))
        })
    }
}

fn capture_error(error: CaptureError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
