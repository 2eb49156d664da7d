//! Reading and writing of NeRF's `transforms.json`, as instant-ngp and nerfstudio read it. Each frame has a
//! world-from-camera matrix with OpenGL's camera axes (x right, y up, z back). The lens is given once for all frames,
//! or for each frame. A frame's `time` is in seconds.

use super::{ExchangeError, NamedCamera, axes_and_center, check_count, checked, content};
use super::{opencv_model, pose_from_axes, seconds_in_ns, whole_size, write};
use crate::camera::CameraModel;
use crate::host::read_text;
use crate::json;
use nalgebra::Matrix3;
use serde::de::{Deserializer, Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The list of frames of a `transforms.json`. The lens at the top level of the file is read separately, as a
/// [`FrameEntry`].
#[derive(Debug, Deserialize)]
struct TransformsFile {
    #[serde(deserialize_with = "bounded")]
    frames: Vec<FrameEntry>,
}

/// The fields of a frame in `transforms.json`. The top level of the file may have the same fields: they describe the
/// lens of the frames that lack these fields. Other fields are skipped.
///
/// Serde's `flatten` is not used, because it would keep the skipped fields in memory, at 16 times their length in the
/// file.
#[derive(Debug, Deserialize)]
struct FrameEntry {
    file_path: Option<String>,
    time: Option<f64>,
    transform_matrix: Option<[[f64; 4]; 4]>,
    camera_model: Option<String>,
    w: Option<f64>,
    h: Option<f64>,
    camera_angle_x: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// A frame as it is written to `transforms.json`, with its own lens.
#[derive(Debug, Serialize)]
struct WrittenFrame<'a> {
    file_path: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<f64>,
    transform_matrix: [[f64; 4]; 4],
    camera_model: &'static str,
    w: f64,
    h: f64,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    #[serde(flatten)]
    distortion: BTreeMap<&'static str, f64>,
}

/// Deserializes the list of frames in `transforms.json`. More than `MAX_ENTRIES` entries are an error.
fn bounded<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<FrameEntry>, D::Error> {
    struct EntryList;
    impl<'de> Visitor<'de> for EntryList {
        type Value = Vec<FrameEntry>;

        fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
            f.write_str("a list")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
            let mut entries = Vec::new();
            while let Some(entry) = list.next_element()? {
                entries.push(entry);
                check_count(entries.len(), "frames").map_err(A::Error::custom)?;
            }
            Ok(entries)
        }
    }
    deserializer.deserialize_seq(EntryList)
}

/// Returns the image size (width, height; pixels) and the lens of a frame. Fields that the frame lacks are taken from
/// `all`, the top level of the file. The caller adds the file's name to the error message.
fn lens(frame: &FrameEntry, all: &FrameEntry) -> Result<((u64, u64), CameraModel), String> {
    let either = |field: fn(&FrameEntry) -> Option<f64>| field(frame).or(field(all));
    let (Some(w), Some(h)) = (either(|f| f.w), either(|f| f.h)) else {
        return Err("w and h, the images' size, are missing".into());
    };
    let size = whole_size(w, h)?;
    let by_angle = either(|f| f.camera_angle_x).map(|angle| 0.5 * w / (0.5 * angle).tan());
    let fx = either(|f| f.fl_x).or(by_angle).ok_or("fl_x (or camera_angle_x) is missing")?;
    let fy = either(|f| f.fl_y).unwrap_or(fx);
    let cx = either(|f| f.cx).unwrap_or(0.5 * w);
    let cy = either(|f| f.cy).unwrap_or(0.5 * h);
    let k = [either(|f| f.k1), either(|f| f.k2), either(|f| f.k3), either(|f| f.k4)];
    let k @ [k1, k2, k3, k4] = k.map(Option::unwrap_or_default);
    let p = [either(|f| f.p1), either(|f| f.p2)].map(Option::unwrap_or_default);
    let name = frame.camera_model.as_deref().or(all.camera_model.as_deref()).unwrap_or("OPENCV");
    let model = match name {
        "OPENCV_FISHEYE" => CameraModel::OpenCvFisheye { fx, fy, cx, cy, k },
        "PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "RADIAL" | "SIMPLE_RADIAL" => {
            opencv_model([fx, fy, cx, cy], [k1, k2, k3, k4, 0.0, 0.0], p)
        }
        _ => return Err(format!("camera_model can't be '{name}'")),
    };
    Ok((size, model))
}

/// Returns the name and the distortion coefficients of a lens model as in `transforms.json`; `None` if the format can't
/// represent the lens.
fn name_and_distortion(model: &CameraModel) -> Option<(&'static str, BTreeMap<&'static str, f64>)> {
    let brown = |k1, k2, p1, p2| {
        Some(("OPENCV", BTreeMap::from([("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2)])))
    };
    let fisheye = |[k1, k2, k3, k4]: [f64; 4]| {
        Some(("OPENCV_FISHEYE", BTreeMap::from([("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4)])))
    };
    match *model {
        CameraModel::SimplePinhole { .. } | CameraModel::Pinhole { .. } => {
            Some(("PINHOLE", BTreeMap::new()))
        }
        CameraModel::SimpleRadial { k, .. } => brown(k, 0.0, 0.0, 0.0),
        CameraModel::Radial { k, .. } => brown(k[0], k[1], 0.0, 0.0),
        CameraModel::OpenCv { k1, k2, p1, p2, .. } => brown(k1, k2, p1, p2),
        CameraModel::SimpleFisheye { .. } | CameraModel::Fisheye { .. } => fisheye([0.0; 4]),
        CameraModel::FullOpenCv { .. }
        | CameraModel::Fov { .. }
        | CameraModel::ThinPrismFisheye { .. }
        | CameraModel::RadTanThinPrismFisheye { .. }
        | CameraModel::SimpleDivision { .. }
        | CameraModel::Division { .. }
        | CameraModel::Eucm { .. } => None,
        CameraModel::SimpleRadialFisheye { k, .. } => fisheye([k, 0.0, 0.0, 0.0]),
        CameraModel::RadialFisheye { k, .. } => fisheye([k[0], k[1], 0.0, 0.0]),
        CameraModel::OpenCvFisheye { k, .. } => fisheye(k),
    }
}

/// Reads the frames of a `transforms.json` in the order of the file, and names them by their image paths. A file
/// without frames, an invalid pose and an invalid lens are errors.
pub fn read_nerf(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let text = read_text(path, json::MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    let wrong = |reason: String| content(path, reason);
    let all: FrameEntry = json::parse(&text).map_err(wrong)?;
    let TransformsFile { frames } = json::parse(&text).map_err(wrong)?;
    if frames.is_empty() {
        return Err(content(path, "frames: there is none"));
    }
    let cameras = frames.into_iter().enumerate().map(|(k, frame)| {
        camera(frame, &all).map_err(|reason| content(path, format!("frames[{k}]: {reason}")))
    });
    cameras.collect()
}

fn camera(frame: FrameEntry, all: &FrameEntry) -> Result<NamedCamera, String> {
    let (size, model) = lens(&frame, all)?;
    let time_ns = frame.time.map(seconds_in_ns).transpose()?;
    let name = frame.file_path.ok_or("file_path is missing")?;
    let m = frame.transform_matrix.ok_or("transform_matrix is missing")?;
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err("transform_matrix's last row must be 0, 0, 0, 1".into());
    }
    let axes = Matrix3::from_fn(|r, c| if c == 0 { m[r][c] } else { -m[r][c] });
    let pose = pose_from_axes(&axes, [m[0][3], m[1][3], m[2][3]].into())?;
    Ok(NamedCamera { name, time_ns, camera: checked(size, &model, &pose)? })
}

/// Writes the cameras as the frames of a `transforms.json`, each with its own lens. A lens that the format can't
/// represent, such as `FULL_OPENCV`, is an error.
pub fn write_nerf(path: &Path, cameras: &[NamedCamera]) -> Result<(), ExchangeError> {
    let mut frames = Vec::new();
    for NamedCamera { name, time_ns, camera } in cameras {
        let (camera_model, distortion) = name_and_distortion(&camera.model).ok_or_else(|| {
            content(path, format!("can't describe {name}, a {}", camera.model.name()))
        })?;
        let (fl_x, fl_y, cx, cy) = camera.model.intrinsics();
        let (axes, center) = axes_and_center(camera);
        let mut transform_matrix = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (r, row) in transform_matrix.iter_mut().enumerate().take(3) {
            *row = [axes[(r, 0)], -axes[(r, 1)], -axes[(r, 2)], center[r]];
        }
        frames.push(WrittenFrame {
            file_path: name,
            time: time_ns.map(|ns| ns as f64 / 1e9),
            transform_matrix,
            camera_model,
            w: camera.width as f64,
            h: camera.height as f64,
            fl_x,
            fl_y,
            cx,
            cy,
            distortion,
        });
    }
    let transforms = BTreeMap::from([("frames", frames)]);
    let mut text = serde_json::to_string_pretty(&transforms).map_err(|e| content(path, e))?;
    text.push('\n');
    write(path, text.as_bytes())
}
