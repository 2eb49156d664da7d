//! Reading and writing of LLFF's `poses_bounds.npy`, an array with 17 numbers per camera.
//!
//! The first 15 numbers are a 3×5 matrix, row by row. Its columns are the camera's down, right and back axes in the
//! world, the camera's centre, and (height, width, focal length) in pixels. The last two numbers are the nearest and
//! the farthest depth. Cameras have no names. They have the order of the numbers in the names of their images.

use super::pairing::numbered_order;
use super::{ExchangeError, NamedCamera, axes_and_center, checked, content, pose_from_axes};
use super::{read_bytes, whole_size, write};
use crate::camera::CameraModel;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

const COLUMNS: usize = 17;
/// Size limit of the file, in bytes. It is large enough for a hundred thousand cameras.
const MAX_BYTES: u64 = 16 << 20;
/// Largest allowed deviation, in pixels, from two assumptions of LLFF's format: the principal point is in the middle of
/// the image, and the two focal lengths are equal.
const MAX_OFF_PX: f64 = 1e-6;

/// Reads the cameras of LLFF's `poses_bounds.npy` in the order of the file, and names them `0`, `1` and so on. An array
/// of another shape or type, an invalid pose and an invalid lens are errors.
pub fn read_llff(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let rows = rows(&read_bytes(path, MAX_BYTES)?).map_err(|reason| content(path, reason))?;
    let cameras = rows.iter().enumerate().map(|(k, row)| {
        camera(row)
            .map(|camera| NamedCamera { name: k.to_string(), time_ns: None, camera })
            .map_err(|reason| content(path, format!("row {k}: {reason}")))
    });
    cameras.collect()
}

fn camera(row: &[f64; COLUMNS]) -> Result<crate::camera::Camera, String> {
    let column = |c: usize| Vector3::new(row[c], row[5 + c], row[10 + c]);
    let (down, right, back, center) = (column(0), column(1), column(2), column(3));
    let [height, width, f] = [row[4], row[9], row[14]];
    let size = whole_size(width, height)?;
    let pose = pose_from_axes(&Matrix3::from_columns(&[right, down, -back]), center)?;
    let model = CameraModel::Pinhole { fx: f, fy: f, cx: 0.5 * width, cy: 0.5 * height };
    checked(size, &model, &pose)
}

/// Parses an npy file of float32 or float64, and returns its rows: one camera each. The caller adds the file's name to
/// the error message.
fn rows(bytes: &[u8]) -> Result<Vec<[f64; COLUMNS]>, String> {
    let (rest, version) = match bytes {
        [0x93, b'N', b'U', b'M', b'P', b'Y', version @ 1..=3, _, rest @ ..] => (rest, *version),
        _ => return Err("is no npy file".into()),
    };
    let length_bytes = if version == 1 { 2 } else { 4 };
    let (length, rest) = rest.split_at_checked(length_bytes).ok_or("is cut short")?;
    let length = length.iter().rev().fold(0, |length, byte| length << 8 | usize::from(*byte));
    let (header, data) = rest.split_at_checked(length).ok_or("is cut short")?;
    let header = std::str::from_utf8(header).map_err(|_| "has no readable header")?;
    if !header.contains("'fortran_order': False") {
        return Err("must be in C order".into());
    }
    let values: Vec<f64> = if header.contains("'<f8'") {
        let (values, []) = data.as_chunks() else { return Err("is cut short".into()) };
        values.iter().map(|b| f64::from_le_bytes(*b)).collect()
    } else if header.contains("'<f4'") {
        let (values, []) = data.as_chunks() else { return Err("is cut short".into()) };
        values.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
    } else {
        return Err("must hold little-endian floats".into());
    };
    let shape = header.split_once('(').and_then(|(_, rest)| rest.split_once(')'));
    let shape: Vec<usize> = shape
        .map(|(shape, _)| shape.split(',').filter_map(|n| n.trim().parse().ok()).collect())
        .unwrap_or_default();
    let (rows, rest) = values.as_chunks::<COLUMNS>();
    if shape != [rows.len(), COLUMNS] || !rest.is_empty() || rows.is_empty() {
        return Err(format!("has the shape {shape:?}, must be (cameras, {COLUMNS})"));
    }
    Ok(rows.to_vec())
}

/// Writes LLFF's `poses_bounds.npy`. All cameras get the same nearest depth `near_m` and farthest depth `far_m`, in
/// metres. The format has no names, so the rows are sorted by the numbers in the cameras' names. If the names differ in
/// more than numbers, the rows keep the order of `cameras`.
///
/// A lens that the format can't represent is an error: a lens with distortion, a principal point off the image's
/// middle, or two focal lengths.
pub fn write_llff(
    path: &Path,
    cameras: &[NamedCamera],
    (near_m, far_m): (f64, f64),
) -> Result<(), ExchangeError> {
    let mut data = Vec::new();
    let names: Vec<String> = cameras.iter().map(|camera| camera.name.clone()).collect();
    let order = numbered_order(&names).unwrap_or_else(|| (0..cameras.len()).collect());
    for NamedCamera { name, camera, .. } in order.iter().map(|&k| &cameras[k]) {
        let (fx, fy, cx, cy) = camera.model.intrinsics();
        let (width, height) = (camera.width as f64, camera.height as f64);
        let off = [fx - fy, cx - 0.5 * width, cy - 0.5 * height];
        if !camera.model.is_pinhole() || off.iter().any(|d| d.abs() > MAX_OFF_PX) {
            let reason = "it knows one focal length and a centred image";
            return Err(content(path, format!("can't describe {name}: {reason}")));
        }
        let (axes, center) = axes_and_center(camera);
        for (row, size) in [height, width, fx].into_iter().enumerate() {
            data.extend([axes[(row, 1)], axes[(row, 0)], -axes[(row, 2)], center[row], size]);
        }
        data.extend([near_m, far_m]);
    }
    let count = cameras.len();
    let fields = format!("'descr': '<f8', 'fortran_order': False, 'shape': ({count}, {COLUMNS}), ");
    // The magic number, the version and the header length take 10 bytes. The data starts at a multiple of 64 bytes.
    let width = (10 + fields.len() + 3).next_multiple_of(64) - 11;
    let header = format!("{:width$}\n", format!("{{{fields}}}"));
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes()); // some 80 characters and the padding
    bytes.extend(header.as_bytes());
    bytes.extend(data.iter().flat_map(|v| v.to_le_bytes()));
    write(path, &bytes)
}
