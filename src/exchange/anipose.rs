//! Reader of calibrations in TOML with OpenCV's conventions: `Calib.toml` of Anipose and Pose2Sim, and
//! `camera_array.toml` of caliscope.
//!
//! Each camera is a table, either at the top level or under `cameras`. The fields of a camera are `size`, `matrix` (of
//! the intrinsics), `distortions` (k1 k2 p1 p2 k3 k4 k5 k6, or the four coefficients of a fisheye lens), `rotation` (a
//! Rodrigues vector or a matrix) and `translation`. Rotation and translation are from the world to the camera. In
//! OpenCV, the centre of the first pixel is at 0, so half a pixel is added to the principal point. Other tables are
//! skipped.

use super::{
    ExchangeError, NamedCamera, checked, content, opencv_model, pose_from_axes, whole_size,
};
use crate::camera::CameraModel;
use crate::host::read_text;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Deserialize;
use std::path::Path;
use toml::{Table, Value};

/// Size limit of the file, in bytes. It is large enough for two thousand cameras. Parsing takes up to a hundred times
/// the file's size in memory.
const MAX_BYTES: u64 = 2 << 20;

/// The fields of a camera's table in the TOML file. Fields that are not listed here are skipped.
#[derive(Debug, Deserialize)]
struct CameraTable {
    name: Option<Value>,
    size: Option<[f64; 2]>,
    matrix: Option<[[f64; 3]; 3]>,
    #[serde(default)]
    distortions: Vec<f64>,
    rotation: Option<Rotation>,
    translation: Option<[f64; 3]>,
    #[serde(default)]
    fisheye: bool,
    #[serde(default)]
    ignore: bool,
}

/// The rotation from the world to the camera.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Rotation {
    /// Rodrigues vector: its direction is the rotation axis, and its length is the angle in radians.
    Vector([f64; 3]),
    Matrix([[f64; 3]; 3]),
}

/// Reads the cameras of a TOML calibration in the order of the file. A camera's name is its field `name`. If this field
/// is missing, the name is that of the table, or `cam_0` for the table `0` under `cameras`. Cameras whose field
/// `ignore` is true are skipped.
///
/// Errors: no camera, two cameras with the same name, a camera without size, lens or pose, an intrinsic matrix with
/// skew, an unknown lens.
pub fn read_anipose(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let text = read_text(path, MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    let wrong = |reason: String| content(path, reason);
    let root: Table = text.parse().map_err(|e: toml::de::Error| wrong(one_line(e.message())))?;
    let mut found = Vec::new();
    for (key, value) in &root {
        let Value::Table(table) = value else { continue };
        if key == "cameras" {
            found.extend(table.iter().map(|(key, value)| (format!("cam_{key}"), value)));
        } else {
            found.push((key.clone(), value));
        }
    }
    let is_camera = |value: &Value| value.as_table().is_some_and(|t| t.contains_key("matrix"));
    let mut cameras = Vec::new();
    for (key, value) in found.into_iter().filter(|(_, value)| is_camera(value)) {
        let wrong = |reason: String| wrong(format!("{}: {reason}", crate::text::short(&key)));
        let table: CameraTable =
            value.clone().try_into().map_err(|e: toml::de::Error| wrong(one_line(e.message())))?;
        if !table.ignore {
            cameras.push(camera(&key, &table).map_err(wrong)?);
        }
    }
    let names = cameras.iter().map(|c| &c.name).collect::<std::collections::BTreeSet<_>>();
    if cameras.is_empty() || names.len() != cameras.len() {
        let reason = if cameras.is_empty() { "holds no camera" } else { "has a name twice" };
        return Err(wrong(reason.into()));
    }
    Ok(cameras)
}

/// Converts a parser's error message to one line. Its line breaks only serve to mark the position of the error.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn camera(key: &str, table: &CameraTable) -> Result<NamedCamera, String> {
    let name = match &table.name {
        Some(Value::String(name)) => name.clone(),
        Some(Value::Integer(number)) => number.to_string(),
        _ => key.to_owned(),
    };
    let [width, height] = table.size.ok_or("size is missing")?;
    let size = whole_size(width, height)?;
    let matrix = table.matrix.ok_or("matrix is missing")?;
    let model = model(&matrix, &table.distortions, table.fisheye)?;
    let rotation = match table.rotation.as_ref().ok_or("rotation is missing: it has no pose")? {
        Rotation::Vector(v) => Rotation3::new(Vector3::from(*v)).into_inner(),
        Rotation::Matrix(rows) => Matrix3::from_fn(|r, c| rows[r][c]),
    };
    let translation = Vector3::from(table.translation.ok_or("translation is missing")?);
    let center = -(rotation.transpose() * translation);
    let pose = pose_from_axes(&rotation.transpose(), center)?;
    Ok(NamedCamera { name, time_ns: None, camera: checked(size, &model, &pose)? })
}

fn model(
    matrix: &[[f64; 3]; 3],
    distortions: &[f64],
    fisheye: bool,
) -> Result<CameraModel, String> {
    let [[fx, skew, cx], [zero, fy, cy], last] = *matrix;
    if skew != 0.0 || zero != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err("matrix must be fx 0 cx, 0 fy cy, 0 0 1".into());
    }
    let mut d = [0.0; 8];
    let used = distortions.iter().rposition(|d| *d != 0.0).map_or(0, |last| last + 1);
    if used > if fisheye { 4 } else { 8 } {
        return Err(format!("{used} distortions are more than are known"));
    }
    d[..used].copy_from_slice(&distortions[..used]);
    let [k1, k2, p1, p2, k3, k4, k5, k6] = d;
    let intrinsics = [fx, fy, cx + 0.5, cy + 0.5];
    Ok(if fisheye {
        let [fx, fy, cx, cy] = intrinsics;
        CameraModel::OpenCvFisheye { fx, fy, cx, cy, k: [k1, k2, p1, p2] }
    } else {
        opencv_model(intrinsics, [k1, k2, k3, k4, k5, k6], [p1, p2])
    })
}
