//! NeRF's `transforms.json`, as instant-ngp and nerfstudio read it: a world-from-camera matrix a
//! frame, with OpenGL's axes (x right, y up, z back), and the lens for all frames or each its own.

use super::{ExchangeError, NamedCamera, axes_and_center, check_count, checked, content};
use super::{pose_from_axes, write};
use crate::camera::CameraModel;
use crate::host::read_text;
use crate::json;
use nalgebra::Matrix3;
use serde::de::{Deserializer, Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The frames of the file.
#[derive(Debug, Serialize, Deserialize)]
struct Frames {
    #[serde(deserialize_with = "bounded")]
    frames: Vec<FrameEntry>,
}

/// Fields of a frame, or of the file as a whole: both may have a lens. Other fields are skipped.
///
/// Serde's `flatten` would hold the skipped fields in memory, at 16 times their length in the file.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct FrameEntry {
    #[serde(skip_serializing_if = "Option::is_none")]
    file_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    transform_matrix: Option<[[f64; 4]; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    w: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    h: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_angle_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fl_y: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cx: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cy: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
}

/// Reads a list, and stops with an error at more than [`MAX_ENTRIES`].
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

impl FrameEntry {
    /// The frame's lens; fields that it lacks are those of the file.
    fn lens_or(&self, all: &Self) -> Self {
        Self {
            camera_model: self.camera_model.clone().or_else(|| all.camera_model.clone()),
            w: self.w.or(all.w),
            h: self.h.or(all.h),
            camera_angle_x: self.camera_angle_x.or(all.camera_angle_x),
            fl_x: self.fl_x.or(all.fl_x),
            fl_y: self.fl_y.or(all.fl_y),
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
            ..Self::default()
        }
    }

    /// Image size in pixels, and lens; the error is a reason.
    fn model(&self) -> Result<((u64, u64), CameraModel), String> {
        let (Some(w), Some(h)) = (self.w, self.h) else {
            return Err("w and h, the images' size, are missing".into());
        };
        for side in [w, h] {
            if !(side >= 1.0 && side <= f64::from(u32::MAX) && side.fract() == 0.0) {
                return Err(format!("an image can't be {w}×{h} pixels"));
            }
        }
        let by_angle = self.camera_angle_x.map(|angle| 0.5 * w / (0.5 * angle).tan());
        let fx = self.fl_x.or(by_angle).ok_or("fl_x (or camera_angle_x) is missing")?;
        let fy = self.fl_y.unwrap_or(fx);
        let (cx, cy) = (self.cx.unwrap_or(0.5 * w), self.cy.unwrap_or(0.5 * h));
        let [k1, k2, k3, k4, p1, p2] =
            [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].map(|v| v.unwrap_or(0.0));
        let name = self.camera_model.as_deref().unwrap_or("OPENCV");
        let model = match name {
            "OPENCV_FISHEYE" => CameraModel::OpenCvFisheye { fx, fy, cx, cy, k: [k1, k2, k3, k4] },
            "PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "RADIAL" | "SIMPLE_RADIAL" => {
                if [k1, k2, k3, k4, p1, p2] == [0.0; 6] {
                    CameraModel::Pinhole { fx, fy, cx, cy }
                } else if [k3, k4] == [0.0; 2] {
                    CameraModel::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 }
                } else {
                    CameraModel::FullOpenCv {
                        fx,
                        fy,
                        cx,
                        cy,
                        k: [k1, k2, k3, k4, 0.0, 0.0],
                        p: [p1, p2],
                    }
                }
            }
            _ => return Err(format!("camera_model can't be '{name}'")),
        };
        Ok(((w as u64, h as u64), model))
    }

    /// The inverse of [`Self::model`]; `None` for a lens that the format can't hold.
    fn of(camera: &crate::camera::Camera) -> Option<Self> {
        let (fx, fy, cx, cy) = camera.model.intrinsics();
        let lens = Self {
            w: Some(camera.width as f64),
            h: Some(camera.height as f64),
            fl_x: Some(fx),
            fl_y: Some(fy),
            cx: Some(cx),
            cy: Some(cy),
            ..Self::default()
        };
        let brown = |k1, k2, p1, p2| Self {
            camera_model: Some("OPENCV".into()),
            k1: Some(k1),
            k2: Some(k2),
            p1: Some(p1),
            p2: Some(p2),
            ..lens.clone()
        };
        let fisheye = |[k1, k2, k3, k4]: [f64; 4]| Self {
            camera_model: Some("OPENCV_FISHEYE".into()),
            k1: Some(k1),
            k2: Some(k2),
            k3: Some(k3),
            k4: Some(k4),
            ..lens.clone()
        };
        match camera.model {
            CameraModel::SimplePinhole { .. } | CameraModel::Pinhole { .. } => {
                Some(Self { camera_model: Some("PINHOLE".into()), ..lens })
            }
            CameraModel::SimpleRadial { k, .. } => Some(brown(k, 0.0, 0.0, 0.0)),
            CameraModel::Radial { k, .. } => Some(brown(k[0], k[1], 0.0, 0.0)),
            CameraModel::OpenCv { k1, k2, p1, p2, .. } => Some(brown(k1, k2, p1, p2)),
            CameraModel::FullOpenCv { .. } => None,
            CameraModel::SimpleRadialFisheye { k, .. } => Some(fisheye([k, 0.0, 0.0, 0.0])),
            CameraModel::RadialFisheye { k, .. } => Some(fisheye([k[0], k[1], 0.0, 0.0])),
            CameraModel::OpenCvFisheye { k, .. } => Some(fisheye(k)),
        }
    }
}

/// Reads the frames of the file in order, named by their paths. Errors: no frames, an invalid pose or
/// lens.
pub fn read_nerf(path: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let text = read_text(path, json::MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    let wrong = |reason: String| content(path, reason);
    let all: FrameEntry = json::parse(&text).map_err(wrong)?;
    let Frames { frames } = json::parse(&text).map_err(wrong)?;
    if frames.is_empty() {
        return Err(content(path, "frames: there is none"));
    }
    let cameras = frames.into_iter().enumerate().map(|(k, frame)| {
        camera(frame, &all).map_err(|reason| content(path, format!("frames[{k}]: {reason}")))
    });
    cameras.collect()
}

fn camera(frame: FrameEntry, all: &FrameEntry) -> Result<NamedCamera, String> {
    let (size, model) = frame.lens_or(all).model()?;
    let name = frame.file_path.ok_or("file_path is missing")?;
    let m = frame.transform_matrix.ok_or("transform_matrix is missing")?;
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err("transform_matrix's last row must be 0, 0, 0, 1".into());
    }
    let axes = Matrix3::from_fn(|r, c| if c == 0 { m[r][c] } else { -m[r][c] });
    let pose = pose_from_axes(&axes, [m[0][3], m[1][3], m[2][3]].into())?;
    let camera = checked(size, &model, &pose).map_err(|e| e.to_string())?;
    Ok(NamedCamera { name, camera })
}

/// Writes the cameras, each frame with its own lens. `FULL_OPENCV` is an error: the format can't hold it.
pub fn write_nerf(path: &Path, cameras: &[NamedCamera]) -> Result<(), ExchangeError> {
    let mut transforms = Frames { frames: Vec::new() };
    for NamedCamera { name, camera } in cameras {
        let lens = FrameEntry::of(camera).ok_or_else(|| {
            content(path, format!("can't describe {name}, a {}", camera.model.name()))
        })?;
        let (axes, center) = axes_and_center(camera);
        let mut m = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (r, row) in m.iter_mut().enumerate().take(3) {
            *row = [axes[(r, 0)], -axes[(r, 1)], -axes[(r, 2)], center[r]];
        }
        let (file_path, transform_matrix) = (Some(name.clone()), Some(m));
        transforms.frames.push(FrameEntry { file_path, transform_matrix, ..lens });
    }
    let mut text = serde_json::to_string_pretty(&transforms).map_err(|e| content(path, e))?;
    text.push('\n');
    write(path, text.as_bytes())
}
