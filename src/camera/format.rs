//! JSON format of a camera: an entry of `capture.json`, or the file of a view to render.
//!
//! The file of a view holds one camera, in the same format as a camera in `capture.json`. The fields `id`, `frames`,
//! `color` and `clock` are optional and ignored. Lengths are in metres. The axes are COLMAP's: x right, y down, z
//! forward.
//!
//! ```json
//! { "width": 320, "height": 240, "model": "PINHOLE", "params": [343.1, 343.1, 160.0, 120.0],
//!   "cam_from_world": { "rotation_wxyz": [0.70710678, 0.70710678, 0, 0],
//!                       "translation": [0.02, 1.2, 0] } }
//! ```

use super::{Camera, CameraModel};
use crate::raster::MAX_PIXELS;
use crate::text::number;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use schemars::JsonSchema;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

/// Pose in JSON: the rigid transform from world coordinates to camera coordinates. In a rig's file, it is the transform
/// from rig coordinates to camera coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseFormat {
    /// Rotation from world to camera coordinates, as a quaternion (w, x, y, z). The quaternion's length differs from 1
    /// by at most [`MAX_QUATERNION_ERROR`].
    pub rotation_wxyz: [f64; 4],
    /// Translation from world to camera coordinates: the world's origin in camera coordinates, metres.
    pub translation: [f64; 3],
}

/// Image size, lens model and pose of a camera, in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraFormat {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// COLMAP's name of the camera model.
    pub model: String,
    /// The camera model's parameters, in COLMAP's order.
    pub params: Vec<f64>,
    /// Pose: the rigid transform from world coordinates to camera coordinates.
    pub cam_from_world: PoseFormat,
}

/// A view to render, in JSON: image size, lens model and pose. Other fields of a camera in `capture.json` are allowed
/// and ignored.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewFormat {
    width: u32,
    height: u32,
    model: String,
    params: Vec<f64>,
    cam_from_world: PoseFormat,
    #[serde(default, rename = "id")]
    _id: IgnoredAny,
    #[serde(default, rename = "frames")]
    _frames: IgnoredAny,
    #[serde(default, rename = "color")]
    _color: IgnoredAny,
    #[serde(default, rename = "clock")]
    _clock: IgnoredAny,
}

/// Error in a camera's JSON. The message starts with the name of the wrong field.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CameraFormatError {
    /// The width or the height is 0 or larger than `max`, pixels.
    #[error("{field}: is {value}, must be from 1 to {max}")]
    Size { field: &'static str, value: u32, max: u32 },
    /// The image has more than [`MAX_PIXELS`] pixels, or a view to render has more than 8192×4320 pixels.
    #[error("width: {width}×{height} are more pixels than {max}")]
    Pixels { width: u32, height: u32, max: u64 },
    /// The camera model's name is unknown, or its number of parameters is wrong.
    #[error("model: '{name}' with {count} params is not a known model ({})", known_models())]
    Model { name: String, count: usize },
    /// A parameter is not finite, or a focal length is not positive.
    #[error("params: must be finite, and the focal lengths positive")]
    Params,
    /// The length of the quaternion differs from 1 by more than [`MAX_QUATERNION_ERROR`].
    #[error("cam_from_world.rotation_wxyz: has length {}, must be of unit length to 1e-3", number(.length))]
    Quaternion { length: f64 },
    /// A coordinate of the translation is not finite, or its absolute value is larger than 1e12 m.
    #[error("cam_from_world.translation: must be within {MAX_TRANSLATION_M:e} of 0")]
    Translation,
}

/// Lists the camera models with their numbers of parameters, for error messages: `PINHOLE has 4, …`.
fn known_models() -> String {
    CameraModel::KNOWN.map(|(name, _, count)| format!("{name} has {count}")).join(", ")
}

/// Maximum width and height of an image, pixels.
const MAX_SIZE_PX: u32 = 65_536;
/// Maximum absolute value of a translation's coordinate, metres. With this limit, the powers of distances in rendering
/// don't overflow.
const MAX_TRANSLATION_M: f64 = 1e12;
/// Maximum number of pixels of a view: 8K of digital cinema. Rendering takes about 32 bytes per pixel.
const MAX_VIEW_PIXELS: u64 = 8192 * 4320;
/// Maximum accepted difference of a quaternion's length from 1. The quaternion is then normalized. Quaternions from
/// Blender have single precision.
pub const MAX_QUATERNION_ERROR: f64 = 1e-3;

impl ViewFormat {
    /// Checks every field and converts the view to a camera. The largest allowed number of pixels is smaller for a view
    /// than for an input image.
    pub fn camera(self) -> Result<Camera, CameraFormatError> {
        let format = CameraFormat::from(self);
        let camera = format.camera()?;
        let CameraFormat { width, height, .. } = format;
        if u64::from(width) * u64::from(height) > MAX_VIEW_PIXELS {
            return Err(CameraFormatError::Pixels { width, height, max: MAX_VIEW_PIXELS });
        }
        Ok(camera)
    }
}

impl From<ViewFormat> for CameraFormat {
    fn from(view: ViewFormat) -> Self {
        let ViewFormat { width, height, model, params, cam_from_world, .. } = view;
        Self { width, height, model, params, cam_from_world }
    }
}

impl CameraFormat {
    /// Checks every field and converts the JSON to a camera.
    pub fn camera(&self) -> Result<Camera, CameraFormatError> {
        for (field, value) in [("width", self.width), ("height", self.height)] {
            if value == 0 || value > MAX_SIZE_PX {
                return Err(CameraFormatError::Size { field, value, max: MAX_SIZE_PX });
            }
        }
        if u64::from(self.width) * u64::from(self.height) > MAX_PIXELS {
            let (width, height) = (self.width, self.height);
            return Err(CameraFormatError::Pixels { width, height, max: MAX_PIXELS });
        }
        let model = CameraModel::from_params(&self.model, &self.params).ok_or_else(|| {
            CameraFormatError::Model { name: self.model.clone(), count: self.params.len() }
        })?;
        let (fx, fy, ..) = model.intrinsics();
        if self.params.iter().any(|p| !p.is_finite()) || fx <= 0.0 || fy <= 0.0 {
            return Err(CameraFormatError::Params);
        }
        Ok(Camera {
            width: self.width as usize,
            height: self.height as usize,
            model,
            cam_from_world: self.cam_from_world.isometry()?,
        })
    }
}

impl PoseFormat {
    /// Checks the pose, normalizes its quaternion and converts the pose to a rigid transform.
    pub fn isometry(&self) -> Result<Isometry3<f64>, CameraFormatError> {
        let [w, x, y, z] = self.rotation_wxyz;
        let q = Quaternion::new(w, x, y, z);
        let length = q.norm();
        if !((length - 1.0).abs() <= MAX_QUATERNION_ERROR) {
            return Err(CameraFormatError::Quaternion { length });
        }
        if self.translation.iter().any(|t| !(t.abs() <= MAX_TRANSLATION_M)) {
            return Err(CameraFormatError::Translation);
        }
        let [tx, ty, tz] = self.translation;
        Ok(Isometry3::from_parts(Translation3::new(tx, ty, tz), UnitQuaternion::from_quaternion(q)))
    }
}

impl From<&Camera> for CameraFormat {
    fn from(camera: &Camera) -> Self {
        let q = camera.cam_from_world.rotation;
        let t = camera.cam_from_world.translation;
        Self {
            width: camera.width as u32,
            height: camera.height as u32,
            model: camera.model.name().to_owned(),
            params: camera.model.params(),
            cam_from_world: PoseFormat {
                rotation_wxyz: [q.w, q.i, q.j, q.k],
                translation: [t.x, t.y, t.z],
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format() -> CameraFormat {
        serde_json::from_str(
            r#"{"width": 640, "height": 480, "model": "PINHOLE",
                "params": [686.24, 686.24, 320.0, 240.0],
                "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}}"#,
        )
        .unwrap()
    }

    #[test]
    fn round_trips() {
        let camera = format().camera().unwrap();
        assert_eq!(CameraFormat::from(&camera), format());
    }

    #[test]
    fn wrong_fields_are_refused_by_name() {
        type Break = fn(&mut CameraFormat);
        let cases: [(Break, &str); 8] = [
            (|c| c.width = 0, "width"),
            (|c| (c.width, c.height) = (65_536, 65_536), "width"),
            (|c| c.model = "FISH".into(), "model"),
            (|c| c.params.push(0.0), "model"),
            (|c| c.params[0] = -1.0, "params"),
            (|c| c.cam_from_world.rotation_wxyz = [0.9, 0.0, 0.0, 0.0], "cam_from_world.rotation"),
            (|c| c.cam_from_world.translation[1] = f64::NAN, "cam_from_world.translation"),
            (|c| c.cam_from_world.translation[1] = 1e155, "cam_from_world.translation"),
        ];
        for (make_wrong, field) in cases {
            let mut wrong = format();
            make_wrong(&mut wrong);
            let message = wrong.camera().unwrap_err().to_string();
            assert!(message.starts_with(field), "{message}");
        }
    }

    #[test]
    fn a_view_has_at_most_the_pixels_of_8k() {
        let sized = |width, height| CameraFormat { width, height, ..format() };
        let view = |width, height| {
            let json = serde_json::to_value(sized(width, height)).unwrap();
            serde_json::from_value::<ViewFormat>(json).unwrap().camera()
        };
        assert!(view(8192, 4320).is_ok() && sized(8192, 8192).camera().is_ok());
        for wrong in [view(8192, 8192), view(65_536, 1024)] {
            let message = wrong.unwrap_err().to_string();
            assert!(message.ends_with("are more pixels than 35389440"), "{message}");
        }
    }

    #[test]
    fn numbers_of_a_hundred_digits_are_short() {
        let mut f = format();
        f.cam_from_world.rotation_wxyz = [1e150, 0.0, 0.0, 0.0];
        assert!(f.camera().unwrap_err().to_string().contains("has length 1e150, must"));
    }

    #[test]
    fn single_precision_quaternions_are_normalized() {
        let mut f = format();
        f.cam_from_world.rotation_wxyz = [0.999_4, 0.0, 0.0, 0.0];
        assert_eq!(f.camera().unwrap().cam_from_world.rotation, UnitQuaternion::identity());
    }
}
