//! The fields of `capture.json`, and their checks.

use super::calibration::{CalibrationCovarianceFormat, CalibrationStdFormat};
use super::clock::MAX_TIME_S;
use super::video::VideoFile;
use super::{CaptureError, CaptureSource, Clock, FilmedCamera, frames, require_size};
use crate::camera::{CameraFormat, PoseFormat};
use crate::raster::{BitDepth, read_header};
use crate::text::{ID_PATTERN, MAX_ID_LENGTH, MAX_NAME_LENGTH, check_id, check_name, short};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// The contents of `capture.json`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CaptureFormat {
    /// Always `stlfr-capture`.
    pub format: String,
    /// Always 1.
    pub version: u32,
    /// The capture's name, at most 1000 characters.
    #[schemars(length(max = MAX_NAME_LENGTH))]
    pub name: String,
    /// Id of the reference camera. By default the middle camera, `cameras[(n − 1) / 2]` of n cameras.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// The cameras, at least one.
    pub cameras: Vec<FilmedCameraFormat>,
    /// Estimated covariance of the errors of all cameras' calibration. `stlfr offsets` includes these errors in the
    /// standard errors of the offsets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration_covariance: Option<CalibrationCovarianceFormat>,
}

/// A camera in `capture.json`: its lens, its pose, its clock, and the path of its frames.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmedCameraFormat {
    /// Name of the camera, unique among the cameras. Allowed are letters, digits, `_`, `-`, `.` and spaces, but no
    /// space at the start or the end. At most 100 characters, and neither `.` nor `..`.
    #[schemars(regex(pattern = ID_PATTERN), length(max = MAX_ID_LENGTH))]
    pub id: String,
    /// Path of an image sequence such as `cam0/%04d.png`, or of a video such as `cam0.mkv`.
    pub frames: String,
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
    /// Standard deviations of the errors of this camera's calibration, stated by hand. Not allowed together with the
    /// capture's `calibration_covariance`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration_std: Option<CalibrationStdFormat>,
    /// Whether the frames are read as RGB or as grey.
    #[serde(default)]
    pub color: Color,
    /// Times of the frames on the camera's own clock, and how this clock may differ from the reference camera's clock.
    pub clock: ClockFormat,
}

/// Whether a camera's frames are RGB colours or luminance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Color {
    #[default]
    Rgb,
    Gray,
}

/// A camera's clock. The times of the frames are given either by `rate_hz` and `first_s`, or by `times_s`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClockFormat {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    /// Frame rate, hertz. Absent if `times_s` is given.
    pub rate_hz: Option<f64>,
    /// Time of the first frame on the camera's own clock, seconds. Absent if `times_s` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_s: Option<f64>,
    /// Time of each frame on the camera's own clock, seconds, ascending: the middle of the frame's exposure. With
    /// `readout_s`, it is the middle of the exposure of the frame's middle row. Absent if `rate_hz` and `first_s` are
    /// given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times_s: Option<Vec<f64>>,
    /// Whether the camera runs on the common clock. All cameras with this flag share one clock.
    pub shared: bool,
    /// Whether the clock's rate may differ from the rate of the reference camera's clock.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drift: bool,
    /// Whether the camera may have lost frames although its times show no gap.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub lost: bool,
    /// Readout time of a rolling shutter: the time from the exposure of the first row to the exposure of the last row,
    /// seconds. At most the median time between frames. 0 or absent for a global shutter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0))]
    pub readout_s: Option<f64>,
    /// Standard error of `readout_s`, seconds. If it is positive, the readout time is estimated together with the
    /// temporal offsets, as far as the images show it. Where no offsets are estimated, as between cameras that share one
    /// clock, `readout_s` is used as given. 0 or absent for an exact readout time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0))]
    pub readout_std_s: Option<f64>,
}

impl CaptureFormat {
    /// Checks the format, the version, the capture's name and the cameras' ids. Returns the index of the reference
    /// camera. The caller adds the file's name to the error message.
    pub(super) fn check(&self) -> Result<usize, String> {
        if self.format != "stlfr-capture" {
            return Err(format!("format: is '{}', must be 'stlfr-capture'", short(&self.format)));
        }
        if self.version != 1 {
            return Err(format!("version: is {}, this program reads version 1", self.version));
        }
        if self.cameras.is_empty() {
            return Err("cameras: a capture has at least one camera".into());
        }
        check_name(&self.name).map_err(|reason| format!("name: {reason}"))?;
        let mut ids = HashSet::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            check_id(&camera.id).map_err(|reason| format!("cameras[{index}].id: {reason}"))?;
            if !ids.insert(&camera.id) {
                return Err(format!("cameras: two cameras have the id '{}'", camera.id));
            }
        }
        let Some(id) = &self.reference else { return Ok((self.cameras.len() - 1) / 2) };
        let index = self.cameras.iter().position(|camera| camera.id == *id);
        index.ok_or_else(|| format!("reference: no camera has the id '{}'", short(id)))
    }
}

impl FilmedCameraFormat {
    pub(super) fn open(
        &self,
        index: usize,
        source: &CaptureSource,
    ) -> Result<FilmedCamera, CaptureError> {
        let root = source.root;
        let name = format!("cameras[{index}] ({})", self.id);
        let refused = |reason: String| CaptureError::content(source.description, reason);
        let wrong = |field: &str, reason: String| refused(format!("{name}.{field}: {reason}"));
        let std = self.calibration_std.unwrap_or_default();
        std.check().map_err(|e| wrong("calibration_std", e))?;
        let camera = CameraFormat {
            width: self.width,
            height: self.height,
            model: self.model.clone(),
            params: self.params.clone(),
            cam_from_world: self.cam_from_world.clone(),
        }
        .camera()
        .map_err(|error| refused(format!("{name}.{error}")))?;
        let video = frames::video(root, &self.frames).map_err(|e| wrong("frames", e))?;
        let size = [camera.width, camera.height];
        let video = video.map(|path| VideoFile::open(source, path, size, |e| wrong("frames", e)));
        let video = video.transpose()?;
        let files = match &video {
            Some(video) => video.files(),
            None => frames::find(root, &self.frames).map_err(|e| wrong("frames", e))?,
        };
        let mut bit_depth = BitDepth::Eight;
        for frame in &files {
            let header = read_header(frame)?;
            let path = video.as_ref().map_or(frame, |v| &v.path);
            require_size(path, [header.width, header.height].map(|n| n as usize), &camera)?;
            bit_depth = bit_depth.max(header.bit_depth);
        }
        let clock = self.clock.open(files.len(), video.as_ref()).map_err(|e| wrong("clock", e))?;
        Ok(FilmedCamera {
            id: self.id.clone(),
            camera,
            color: self.color,
            clock,
            frames: files,
            video,
            bit_depth,
        })
    }
}

impl ClockFormat {
    /// Checks the fields, and returns the clock of a camera with `frames` frames. `video` is the camera's video file,
    /// whose time stamps must not contradict `rate_hz`; `None` for an image sequence. The caller adds the file's name
    /// to the error message.
    fn open(&self, frames: usize, video: Option<&VideoFile>) -> Result<Clock, String> {
        let offer = || video.map_or(String::new(), |v| format!("; {}", v.offer()));
        let times_s = match (self.rate_hz, self.first_s, &self.times_s) {
            (Some(rate), Some(first), None) => {
                if !(rate.is_finite() && rate > 0.0 && first.is_finite()) {
                    return Err("rate_hz must be positive and first_s finite".into());
                }
                video.map_or(Ok(()), |v| v.agrees_with_rate(rate))?;
                (0..frames).map(|k| first + k as f64 / rate).collect()
            }
            (None, None, Some(times)) => {
                if times.len() != frames {
                    let (entries, offer) = (times.len(), offer());
                    return Err(format!(
                        "times_s has {entries} entries for {frames} frames{offer}"
                    ));
                }
                times.clone()
            }
            _ => return Err(format!("needs either rate_hz and first_s, or times_s{}", offer())),
        };
        if times_s.iter().any(|t| !(t.abs() <= MAX_TIME_S)) {
            return Err(format!("the times must be within {MAX_TIME_S:?} s of 0"));
        }
        if self.shared && (self.drift || self.lost) {
            return Err("a shared clock can't have drift or lost frames".into());
        }
        let (shared, drift, lost) = (self.shared, self.drift, self.lost);
        let readout_s = self.readout_s.unwrap_or_default();
        let readout_std_s = self.readout_std_s.unwrap_or_default();
        let clock = Clock { times_s, shared, drift, lost, readout_s, readout_std_s };
        clock.ascends()?;
        clock.readout_fits()?;
        Ok(clock)
    }
}
