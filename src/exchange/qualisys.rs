//! Reader of Qualisys' calibrations, `.qca.txt`, which are XML files.
//!
//! Lengths are in millimetres. Focal lengths and principal points are in units of 1/64 pixel. The centre of the
//! sensor's first pixel is at 0, so half a pixel is added to principal points. The rows of `transform` are the camera's
//! right, up and back axes in the world. `fov_video` is the recorded part of the sensor. Distortion coefficients are
//! those of OpenCV.

use super::{
    ExchangeError, NamedCamera, checked, content, opencv_model, pose_from_axes, whole_size,
};
use crate::host::read_text;
use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};
use std::path::Path;

/// Size limit of the file, in bytes. It is large enough for two thousand cameras.
const MAX_BYTES: u64 = 4 << 20;
/// Number of units per pixel of image coordinates in the file: its unit is 1/64 pixel.
const PARTS: f64 = 64.0;
const MM_PER_M: f64 = 1000.0;

/// Reads the active cameras of a Qualisys calibration in the order of the file, and names them by their serial numbers.
///
/// Errors: no camera, a field that is missing or isn't a number, an invalid pose or lens.
pub fn read_qualisys(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let text = read_text(path, MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    let wrong = |reason: String| content(path, reason);
    let document = Document::parse(&text).map_err(|e| wrong(format!("is no XML ({e})")))?;
    let is_active = |node: &Node| node.attribute("active") != Some("0");
    let nodes = document.descendants().filter(|node| node.has_tag_name("camera")).filter(is_active);
    let cameras: Vec<NamedCamera> = nodes
        .enumerate()
        .map(|(k, node)| {
            camera(node).map_err(|reason| wrong(format!("camera {}: {reason}", k + 1)))
        })
        .collect::<Result<_, _>>()?;
    if cameras.is_empty() {
        return Err(wrong("holds no camera".into()));
    }
    Ok(cameras)
}

fn camera(node: Node) -> Result<NamedCamera, String> {
    let name = node.attribute("serial").ok_or("serial is missing")?.to_owned();
    let part = |name: &str| {
        let found = node.children().find(|child| child.has_tag_name(name));
        found.ok_or_else(|| format!("{name} is missing"))
    };
    let (film, pose, lens) = (part("fov_video")?, part("transform")?, part("intrinsic")?);
    let film = |name| number(film, name);
    let [left, top, right, bottom] = [film("left")?, film("top")?, film("right")?, film("bottom")?];
    let size = whole_size(right - left + 1.0, bottom - top + 1.0)?;

    let mut rows = [[0.0; 3]; 3];
    for (r, row) in rows.iter_mut().enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            *value = number(pose, &format!("r{}{}", r + 1, c + 1))?;
        }
    }
    let center = Vector3::new(number(pose, "x")?, number(pose, "y")?, number(pose, "z")?);
    let [right, up, back] = rows.map(Vector3::from);
    let pose = pose_from_axes(&Matrix3::from_columns(&[right, -up, -back]), center / MM_PER_M)?;

    let pixels = |name| Ok::<f64, String>(number(lens, name)? / PARTS);
    if number(lens, "skew").unwrap_or(0.0) != 0.0 {
        return Err("skew must be 0".into());
    }
    let k = |name| number(lens, name);
    let model = opencv_model(
        [
            pixels("focalLengthU")?,
            pixels("focalLengthV")?,
            pixels("centerPointU")? - left + 0.5,
            pixels("centerPointV")? - top + 0.5,
        ],
        [
            k("radialDistortion1")?,
            k("radialDistortion2")?,
            k("radialDistortion3").unwrap_or(0.0),
            0.0,
            0.0,
            0.0,
        ],
        [k("tangentalDistortion1")?, k("tangentalDistortion2")?],
    );
    Ok(NamedCamera { name, time_ns: None, camera: checked(size, &model, &pose)? })
}

/// Returns the value of an XML element's numeric attribute. The caller adds the file's name to the error message.
fn number(node: Node, name: &str) -> Result<f64, String> {
    let text = node.attribute(name).ok_or_else(|| format!("{name} is missing"))?;
    let wrong = || format!("{name} can't be '{}'", crate::text::short(text));
    text.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong)
}
