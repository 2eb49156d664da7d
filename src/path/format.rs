//! The JSON format of a camera path, and the checks of its fields.

use super::{CameraPath, PathError, PathKey, is_rate_hz};
use crate::camera::ViewFormat;
use serde::Deserialize;

const FORMAT: &str = "stlfr-path";
const VERSION: u32 = 1;

/// A camera path as read from a JSON file. Its fields are not checked yet ([`Self::path`] checks them).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathFormat {
    format: String,
    version: u32,
    /// Frame rate of the video for which the path was made, hertz. `None` if it is not in the file.
    rate_hz: Option<f64>,
    /// Whether the camera's position moves at constant speed.
    #[serde(default)]
    constant_speed: bool,
    keys: Vec<ReadKey>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReadKey {
    at_s: f64,
    time_s: f64,
    camera: ViewFormat,
    #[serde(default)]
    rest: bool,
}

impl PathFormat {
    /// Checks every field, and converts the file's contents to a camera path.
    ///
    /// # Errors
    /// A sentence that starts with the name of the invalid field.
    pub fn path(self) -> Result<CameraPath, String> {
        if self.format != FORMAT {
            return Err(format!("format: must be {FORMAT}"));
        }
        if self.version != VERSION {
            return Err(format!("version: is {}, must be {VERSION}", self.version));
        }
        if self.rate_hz.is_some_and(|rate_hz| !is_rate_hz(rate_hz)) {
            return Err(PathError::Rate.to_string());
        }
        let key = |(index, key): (usize, ReadKey)| {
            let camera = key.camera.camera().map_err(|e| format!("keys[{index}].camera.{e}"))?;
            Ok(PathKey { at_s: key.at_s, time_s: key.time_s, camera, rest: key.rest })
        };
        let keys = self.keys.into_iter().enumerate().map(key).collect::<Result<_, String>>()?;
        let path = CameraPath::new(keys, self.constant_speed).map_err(|e| e.to_string())?;
        Ok(CameraPath { rate_hz: self.rate_hz, ..path })
    }
}
