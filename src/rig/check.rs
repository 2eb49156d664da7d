//! Checks a rig file: every field must be within its limits, and fields must not contradict each other.

use super::limits::*;
use super::{Rig, RigCamera, RigView};
use crate::camera::{MAX_QUATERNION_ERROR, PoseFormat};
use crate::host::read_text;
use crate::json::{self, JsonError};
use crate::raster::MAX_PIXELS;
use crate::text::{MAX_ID_LENGTH, number};
use nalgebra::Point2;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Error of a rig file that can't be read or is invalid: one sentence with the file's path and the field.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}")]
pub struct RigError {
    path: PathBuf,
    source: JsonError,
}

/// An invalid value of a rig's field, or of an option of the rig generator: the field and the reason. Together they are
/// one sentence.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("{field} {reason}")]
pub struct FieldError {
    /// Path of the field, such as `cameras[1].rate_hz`, or the option in words, such as `the list of rates`.
    pub field: String,
    /// Rest of the sentence, such as "must be a number from …".
    pub reason: String,
}

impl Rig {
    /// Reads and checks a rig file.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let text = read_text(path, json::MAX_BYTES).map_err(JsonError::from);
        text.and_then(|text| Self::parse(&text).map_err(JsonError::Content))
            .map_err(|source| RigError { path: path.to_owned(), source })
    }

    /// Parses and checks the text of a rig file. The error message is one sentence. It starts with the name of the
    /// invalid field, if the field is known.
    pub fn parse(text: &str) -> Result<Self, String> {
        let rig: Self = json::parse(text)?;
        rig.check().map_err(|wrong| wrong.to_string())?;
        Ok(rig)
    }

    /// Checks every field against its limit in [`super::limits`], and checks that fields don't contradict each other.
    /// Returns the error of the first invalid field, in the order of the file.
    pub fn check(&self) -> FieldCheck {
        if self.format != FORMAT {
            return wrong("format", format!("must be {FORMAT:?}, not {:?}", self.format));
        }
        if self.version != VERSION {
            return wrong("version", format!("must be {VERSION}, not {}", self.version));
        }
        identifier("name", &self.name)?;
        within("seed", self.seed, &(0..=MAX_SEED))?;
        if self.cameras.is_empty() {
            return wrong("cameras", "must hold at least one camera");
        }
        for (index, camera) in self.cameras.iter().enumerate() {
            self::camera(&format!("cameras[{index}]"), camera, &self.reference)?;
        }
        for (index, view) in self.views.iter().enumerate() {
            self::view(&format!("views[{index}]"), view)?;
        }
        let ids = || self.cameras.iter().map(|c| &c.id).chain(self.views.iter().map(|v| &v.id));
        if let Some((_, twice)) = ids().enumerate().find(|(k, id)| ids().take(*k).any(|i| i == *id))
        {
            return wrong("cameras and views", format!("have two entries with id {twice:?}"));
        }
        if !self.cameras.iter().any(|c| c.id == self.reference) {
            return wrong("reference", format!("names no camera of the rig: {:?}", self.reference));
        }
        Ok(())
    }
}

pub(super) type FieldCheck = Result<(), FieldError>;

pub(super) fn wrong(field: impl Into<String>, reason: impl Into<String>) -> FieldCheck {
    Err(FieldError { field: field.into(), reason: reason.into() })
}

fn within<T: PartialOrd + Display>(field: &str, value: T, range: &RangeInclusive<T>) -> FieldCheck {
    // NaN is in no range.
    if range.contains(&value) {
        return Ok(());
    }
    let (min, max) = (range.start(), range.end());
    wrong(field, format!("must be a number from {min} to {max}, not {}", number(value)))
}

fn identifier(field: &str, value: &str) -> FieldCheck {
    let length = value.chars().count();
    if length > MAX_ID_LENGTH {
        let reason = format!("has {length} characters, at most {MAX_ID_LENGTH} are allowed");
        return wrong(field, reason);
    }
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let starts = value.starts_with(|c: char| c.is_ascii_alphanumeric());
    if starts && value.chars().all(word) && !RESERVED.contains(&value) {
        return Ok(());
    }
    wrong(field, format!("can't be {value:?}: it names a folder or file of the capture"))
}

fn camera(at: &str, camera: &RigCamera, reference: &str) -> FieldCheck {
    let field = |name: &str| format!("{at}.{name}");
    view(at, &camera.view())?;
    within(&field("rate_hz"), camera.rate_hz, &RATE_HZ)?;
    within(&field("delay_s"), camera.delay_s, &TIME_S)?;
    let max = MAX_JITTER_FRAMES / camera.rate_hz;
    within(&field("jitter_s"), camera.jitter_s, &(0.0..=max))?;
    within(&field("drift_ppm"), camera.drift_ppm, &DRIFT_PPM)?;
    let max = 1.0 / camera.rate_hz;
    within(&field("exposure_s"), camera.exposure_s, &(0.0..=max))?;
    within(&field("readout_s"), camera.readout_s, &(0.0..=max))?;
    within(&field("gain"), camera.gain, &GAIN)?;
    for &drift in &camera.gain_drift_per_s {
        within(&field("gain_drift_per_s"), drift, &GAIN_DRIFT_PER_S)?;
    }
    within(&field("noise"), camera.noise, &NOISE)?;
    if camera.bit_depth != 8 && camera.bit_depth != 16 {
        return wrong(field("bit_depth"), format!("must be 8 or 16, not {}", camera.bit_depth));
    }
    for &lost in &camera.lost_frames {
        within(&field("lost_frames"), lost, &LOST_FRAME)?;
    }
    if camera.lost_frames.windows(2).any(|w| w[0] >= w[1]) {
        return wrong(field("lost_frames"), "must ascend");
    }
    clock(at, camera, camera.id == reference)?;
    distortion(at, camera)
}

/// Checks that the fields of a camera's clock don't contradict each other. `at` is the camera's path in the rig file,
/// such as `cameras[1]`, for the error message.
fn clock(at: &str, camera: &RigCamera, is_reference: bool) -> FieldCheck {
    let known = if is_reference { "the reference camera" } else { "a camera with a shared clock" };
    if is_reference || camera.clock_shared {
        if camera.drift_ppm != 0.0 {
            return wrong(format!("{at}.drift_ppm"), format!("must be 0 for {known}"));
        }
        if !camera.lost_stamped {
            return wrong(format!("{at}.lost_stamped"), format!("must be true for {known}"));
        }
    }
    if !camera.lost_stamped && camera.jitter_stamped && camera.jitter_s > 0.0 {
        let reason = "must be true where the jitter is stamped: stamps show what is lost";
        return wrong(format!("{at}.lost_stamped"), reason);
    }
    Ok(())
}

fn distortion(at: &str, camera: &RigCamera) -> FieldCheck {
    let d = camera.distortion;
    for (name, value) in [("k1", d.k1), ("k2", d.k2), ("p1", d.p1), ("p2", d.p2)] {
        within(&format!("{at}.distortion.{name}"), value, &DISTORTION)?;
    }
    if d.is_none() {
        return Ok(());
    }
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let (mut min, mut max) = (Point2::new(width, height), Point2::new(0.0, 0.0));
    let model = camera.model();
    for k in 0..=BORDER_STEPS {
        let fraction = f64::from(k) / f64::from(BORDER_STEPS);
        let (x, y) = (fraction * width, fraction * height);
        for pixel in [[x, 0.0], [x, height], [0.0, y], [width, y]] {
            let Some(ideal) = model.ideal_from_pixel(&Point2::from(pixel)) else {
                let reason = format!("has no inverse at pixel ({}, {})", pixel[0], pixel[1]);
                return wrong(format!("{at}.distortion"), reason);
            };
            min = min.inf(&ideal);
            max = max.sup(&ideal);
        }
    }
    if max.x - min.x > MAX_SPREAD * width || max.y - min.y > MAX_SPREAD * height {
        let reason = format!("sees more than a pinhole's image {MAX_SPREAD} times as large holds");
        return wrong(format!("{at}.distortion"), reason);
    }
    Ok(())
}

fn view(at: &str, view: &RigView) -> FieldCheck {
    let field = |name: &str| format!("{at}.{name}");
    identifier(&field("id"), &view.id)?;
    within(&field("width"), view.width, &SIZE_PX)?;
    within(&field("height"), view.height, &SIZE_PX)?;
    if u64::from(view.width) * u64::from(view.height) > MAX_PIXELS {
        let reason = format!("times the height must be at most {MAX_PIXELS}");
        return wrong(field("width"), reason);
    }
    within(&field("lens_mm"), view.lens_mm, &LENS_MM)?;
    within(&field("sensor_width_mm"), view.sensor_width_mm, &SENSOR_MM)?;
    within(&field("shift_x"), view.shift_x, &SHIFT)?;
    within(&field("shift_y"), view.shift_y, &SHIFT)?;
    pose(&field("cam_from_rig"), &view.cam_from_rig)
}

fn pose(at: &str, pose: &PoseFormat) -> FieldCheck {
    let [w, x, y, z] = pose.rotation_wxyz;
    let length = (w * w + x * x + y * y + z * z).sqrt();
    if !((length - 1.0).abs() <= MAX_QUATERNION_ERROR) {
        return wrong(format!("{at}.rotation_wxyz"), format!("must have length 1, not {length}"));
    }
    pose.translation.iter().try_for_each(|t| within(&format!("{at}.translation"), *t, &LENGTH_M))
}

impl RigCamera {
    /// Returns a virtual camera with this camera's pose, and with its lens without distortion.
    pub fn view(&self) -> RigView {
        RigView {
            id: self.id.clone(),
            width: self.width,
            height: self.height,
            lens_mm: self.lens_mm,
            sensor_width_mm: self.sensor_width_mm,
            shift_x: self.shift_x,
            shift_y: self.shift_y,
            cam_from_rig: self.cam_from_rig.clone(),
        }
    }
}
