//! Calibration files of other programs, and the import of recordings as captures.
//!
//! | file | camera axes | pose | lens | pixel coordinates |
//! |---|---|---|---|---|
//! | COLMAP | x right, y down, z forward | camera from world | all of [`crate::camera::CameraModel`] | centre of the first pixel at 0.5 |
//! | `poses_bounds.npy` | columns down, right, back | world from camera | one focal length, centred | no principal point |
//! | `transforms.json` | x right, y up, z back | world from camera | pinhole, OpenCV, OpenCV fisheye | as in COLMAP |
//! | `Calib.toml`, `camera_array.toml` | as in COLMAP | camera from world | OpenCV, OpenCV fisheye | centre of the first pixel at 0 |
//! | `.qca.txt` | x right, y up, z back | world from camera, mm | OpenCV | centre of the first pixel at 0 |
//!
//! World axes are not converted. Every count and size in a file is checked against the file's length before memory is
//! allocated for it.
//!
//! Known limit: points and tracks are neither read nor written.

mod anipose;
mod colmap;
mod colmap_rigs;
mod colmap_values;
mod csv;
mod dataset;
mod footage;
mod import;
mod llff;
mod nerf;
mod pairing;
mod qualisys;
mod recalibrate;
mod request;
mod times;
mod undistort;

pub use anipose::read_anipose;
pub use colmap::{COLMAP_BINARY_FILES, COLMAP_TEXT_FILES, colmap_text, read_colmap};
pub use colmap::{write_colmap_binary, write_colmap_text};
pub use dataset::{Dataset, DatasetFormat};
pub use import::{import, require_new};
pub use llff::{read_llff, write_llff};
pub use nerf::{read_nerf, write_nerf};
pub use qualisys::read_qualisys;
pub use recalibrate::{Draft, NewCalibration, recalibrate};
pub use request::{ImportClock, ImportRequest};
pub use times::{RecordingTimes, read_times};
pub use undistort::Undistortion;

use crate::camera::{Camera, CameraFormat, CameraModel, PoseFormat};
use crate::capture::{CaptureFormat, FilmedCameraFormat};
use crate::json;
use crate::text::number;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

/// The camera of an image in a calibration file, with the image's name and time.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name of the image, such as `cam0/0000.png`. If the format has no names, it is the camera's number in the file.
    pub name: String,
    /// Time of the image, in nanoseconds; `None` if the file has no times.
    pub time_ns: Option<i64>,
    pub camera: Camera,
}

/// An error in a calibration or a recording. The message is one sentence that starts with the path of the file.
#[derive(Debug, thiserror::Error)]
pub enum ExchangeError {
    /// The file can't be read.
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// The file can't be written.
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    /// A file can't be copied into a folder.
    #[error("{path}: can't be copied to {to} ({source})")]
    Copy { path: PathBuf, to: PathBuf, source: std::io::Error },
    /// A video can't be read without ffmpeg.
    #[error("{path}: is a video, and reading one needs ffmpeg: install it, or run stlfr setup")]
    NoFfmpeg { path: PathBuf },
    /// The contents of the file are invalid, or the format can't represent a camera.
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
}

/// Reads a calibration from the folder of a COLMAP model, or from a file whose extension determines its format. If
/// `path` is a `capture.json`, the calibration is that of its cameras. Lengths in the file are in units of `unit_m`
/// metres. Qualisys files are always in millimetres, and `unit_m` is ignored.
pub fn read_calibration(path: &Path, unit_m: f64) -> Result<Vec<NamedCamera>, ExchangeError> {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let mut cameras = match extension.as_deref() {
        Some("npy") => read_llff(path)?,
        Some("json") if is_capture(path) => read_capture(path)?,
        Some("json") => read_nerf(path)?,
        Some("toml") => read_anipose(path)?,
        Some("txt" | "qca" | "xml") => return read_qualisys(path),
        _ if path.is_file() => {
            let reason =
                "is none of .npy, .json, .toml, .txt, .xml, nor the folder of a COLMAP model";
            return Err(content(path, reason));
        }
        _ => read_colmap(path)?,
    };
    cameras.iter_mut().for_each(|c| c.camera.cam_from_world.translation.vector *= unit_m);
    Ok(cameras)
}

/// Returns whether a JSON file describes a capture.
fn is_capture(path: &Path) -> bool {
    #[derive(serde::Deserialize)]
    struct Head {
        format: Option<String>,
    }
    let head = json::read::<Head>(path);
    head.is_ok_and(|head| head.format.as_deref() == Some("stlfr-capture"))
}

/// Reads the cameras of a `capture.json` and names them by their ids. The cameras can serve as the calibration of
/// another recording by the same array.
fn read_capture(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let format: CaptureFormat = json::read(path).map_err(|error| content(path, error))?;
    let named = |(k, camera): (usize, FilmedCameraFormat)| {
        let wrong = |error| content(path, format!("cameras[{k}].{error}"));
        let FilmedCameraFormat { id, width, height, model, params, cam_from_world, .. } = camera;
        let format = CameraFormat { width, height, model, params, cam_from_world };
        Ok(NamedCamera { name: id, time_ns: None, camera: format.camera().map_err(wrong)? })
    };
    format.cameras.into_iter().enumerate().map(named).collect()
}

/// Largest allowed number of images or cameras in a calibration.
const MAX_ENTRIES: usize = 100_000;
/// Largest allowed absolute value of an entry of RᵀR − I for a rotation matrix R from a file. In files with few printed
/// digits, entries reach 1e-4.
const MAX_ROTATION_ERROR: f64 = 1e-3;

fn content(path: &Path, reason: impl std::fmt::Display) -> ExchangeError {
    ExchangeError::Content { path: path.to_owned(), reason: reason.to_string() }
}

fn read_bytes(path: &Path, max_bytes: u64) -> Result<Vec<u8>, ExchangeError> {
    crate::host::read_bytes(path, max_bytes)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })
}

/// Returns an error if there are more than [`MAX_ENTRIES`] entries. `what` is the plural that names the entries in the
/// message, such as `cameras`. The caller adds the file's name to the message.
fn check_count(entries: usize, what: &str) -> Result<(), String> {
    if entries <= MAX_ENTRIES {
        return Ok(());
    }
    Err(format!("holds more than {MAX_ENTRIES} {what}"))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), ExchangeError> {
    crate::host::write_atomically(path, bytes)
        .map_err(|source| ExchangeError::Write { path: path.to_owned(), source })
}

/// Converts an image size that a file holds as two floats, in pixels. A side that is not a whole number of at least 1
/// is an error. The caller adds the file's name to the error message.
fn whole_size(width: f64, height: f64) -> Result<(u64, u64), String> {
    for side in [width, height] {
        if !(side >= 1.0 && side <= f64::from(u32::MAX) && side.fract() == 0.0) {
            let [width, height] = [width, height].map(number);
            return Err(format!("an image can't be {width}×{height} pixels"));
        }
    }
    Ok((width as u64, height as u64))
}

/// Largest absolute value of a time, in seconds: 127 years. In nanoseconds, it fits into an `i64`.
const MAX_TIME_S: f64 = 4e9;

/// Converts seconds to nanoseconds. A time beyond [`MAX_TIME_S`] is an error. The caller adds the file's name to the
/// error message.
fn seconds_in_ns(time_s: f64) -> Result<i64, String> {
    if !(time_s.abs() <= MAX_TIME_S) {
        return Err(format!("time {} must be within {MAX_TIME_S:e} s of 0", number(time_s)));
    }
    Ok((time_s * 1e9).round() as i64)
}

/// Returns the simplest camera model with these intrinsics (fx, fy, cx, cy; pixels) and these coefficients of Brown's
/// distortion model: radial `k` and tangential `p`.
fn opencv_model([fx, fy, cx, cy]: [f64; 4], k: [f64; 6], p: [f64; 2]) -> CameraModel {
    let ([k1, k2, rest @ ..], [p1, p2]) = (k, p);
    if k == [0.0; 6] && p == [0.0; 2] {
        CameraModel::Pinhole { fx, fy, cx, cy }
    } else if rest == [0.0; 4] {
        CameraModel::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 }
    } else {
        CameraModel::FullOpenCv { fx, fy, cx, cy, k, p }
    }
}

/// Creates a camera from the numbers of a file, and returns an error if the camera would be invalid in a capture. The
/// image size is (width, height) in pixels. The caller adds the file's name to the error message.
fn checked(
    (width, height): (u64, u64),
    model: &CameraModel,
    cam_from_world: &Isometry3<f64>,
) -> Result<Camera, String> {
    let (q, t) = (cam_from_world.rotation, cam_from_world.translation);
    let size = |v: u64| u32::try_from(v).unwrap_or(u32::MAX); // refused as too large
    let format = CameraFormat {
        width: size(width),
        height: size(height),
        model: model.name().to_owned(),
        params: model.params(),
        cam_from_world: PoseFormat {
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            translation: [t.x, t.y, t.z],
        },
    };
    format.camera().map_err(|e| e.to_string())
}

/// Returns the camera-from-world pose of a camera whose centre is at `center` in the world. The columns of `axes` are
/// the camera's right, down and forward axes in the world. The caller adds the file's name to the error message.
fn pose_from_axes(axes: &Matrix3<f64>, center: Vector3<f64>) -> Result<Isometry3<f64>, String> {
    if !axes.iter().chain(center.iter()).all(|v| v.is_finite()) {
        return Err("a pose must be finite".into());
    }
    let error = (axes.transpose() * axes - Matrix3::identity()).amax();
    if error > MAX_ROTATION_ERROR || axes.determinant() < 0.0 {
        return Err(format!("a pose's rotation is no rotation (off by {error:.1e})"));
    }
    // The nearest rotation matrix is U Vᵀ, from the singular value decomposition.
    let svd = axes.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else {
        return Err("a pose's rotation is no rotation".into());
    };
    let world_from_cam =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * vt));
    let cam_from_world = world_from_cam.inverse();
    Ok(Isometry3::from_parts(Translation3::from(-(cam_from_world * center)), cam_from_world))
}

/// Returns a camera's right, down and forward axes in the world, as the columns of a matrix, and the camera's centre.
/// This is the inverse of [`pose_from_axes`].
fn axes_and_center(camera: &Camera) -> (Matrix3<f64>, Vector3<f64>) {
    let world_from_cam = camera.cam_from_world.rotation.inverse().to_rotation_matrix();
    (world_from_cam.into_inner(), camera.center().coords)
}

#[cfg(test)]
mod tests;
