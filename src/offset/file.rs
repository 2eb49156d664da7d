//! `CAPTURE/offsets.json`: temporal offsets, stored by the program for later commands, or edited by hand.
//!
//! | field | content |
//! |---|---|
//! | `reference` | the reference camera's id |
//! | `cameras` | a [`CameraOffset`] for each camera |
//! | `options` | the options with which the offsets were estimated |
//! | `hash` | hash of the program's version, the capture's content and these options |
//! | `checksum` | checksum of all fields above |
//!
//! If the checksum matches, the offsets are the program's own estimate. They are used if `hash` matches the capture
//! and the options, and are estimated anew otherwise. A file with a hash but no checksum was written by an earlier
//! version. Its offsets are estimated anew too.
//!
//! If the checksum does not match, or if `checksum` and `hash` are both missing, the file was edited by hand. The
//! commands `render`, `compare` and `plan` then use its offsets as given, whatever the options and the frames, and
//! print a note. `stlfr offsets` estimates the offsets from the images, and leaves the file unchanged.
//!
//! Every field of an edited file is validated. The first violation ends the command with a message that names the
//! file and the field:
//!
//! | field | requirement |
//! |---|---|
//! | the file | a regular file of at most 16 MiB, JSON, with no other fields than these |
//! | `reference` | the id of the capture's reference camera |
//! | `id` | the id of a camera of the capture; every camera occurs once, in any order |
//! | `offset_s` | a number or null; 0 for the reference. Image times within [`Capture::reach_s`] of the reference's |
//! | `std_err_s` | null if `offset_s` is null; otherwise from 0 to [`Capture::reach_s`]; 0 for the reference |
//! | `rate_ppm` | from −1000 to 1000, only if `offset_s` is a number; 0 or absent for a clock without drift |
//! | `rate_std_err_ppm` | from 0 to 1000; present if and only if `rate_ppm` is |
//! | `readout_s` | from 0 to the time between frames, only for a clock with `readout_std_s`; absent: the capture's |
//! | `readout_std_err_s` | from 0 to 1 s; present if and only if `readout_s` is |
//! | `lost_before` | image indices, ascending, at most as many as there are images; absent or empty for none |
//! | `reason` | one line of text; present if and only if `offset_s` is null |

use super::offsets::{CameraOffset, Offsets};
use crate::capture::{Capture, CaptureError, FilmedCamera, MAX_DRIFT_PPM, are_frame_times};
use crate::host::{CacheKind, read_text, write_json};
use crate::json::{self, JsonError};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::ErrorKind;
use std::path::PathBuf;

/// The maximum size of `offsets.json`, bytes. Parsing a file takes many times its size in memory.
pub const MAX_OFFSETS_BYTES: u64 = 16 << 20;
/// The maximum length of the reason of an unknown offset, characters.
const MAX_REASON_CHARS: usize = 500;
/// The end of every error message about an invalid file. It tells the user that the offsets are estimated if the file
/// is deleted.
const REMEDY: &str = "without the file, offsets are estimated";

/// The name and version that enter the hash of estimated offsets. If the version changes, offsets that an earlier
/// version stored are estimated again.
const ESTIMATED_OFFSETS: CacheKind = CacheKind { name: "offsets", version: 2 };

/// Content of a capture's `offsets.json`.
#[derive(Clone, Debug, PartialEq)]
pub enum SavedOffsets {
    /// There is no file, an earlier version of the program wrote it, or its estimate does not fit the capture's
    /// cameras.
    Missing,
    /// The program's own estimate, with the options it was made with and the hash that identifies it.
    Estimated { offsets: Offsets, options: Value, hash: String },
    /// Offsets that were edited by hand. They are valid, and their cameras are sorted into the capture's order.
    Edited(Offsets),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OffsetsFile {
    reference: String,
    cameras: Vec<CameraOffset>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    options: Option<Value>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    hash: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    checksum: Option<String>,
}

impl OffsetsFile {
    /// Returns the hash of the values of all fields except `checksum`. It does not depend on the file's formatting.
    fn checksum(&self) -> String {
        let fields = (&self.reference, &self.cameras, &self.options, &self.hash);
        // Serializing strings, numbers and lists can't fail.
        let text = serde_json::to_string(&fields).unwrap_or_default();
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }
}

impl Offsets {
    fn path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.json")
    }

    /// Returns the path of the plot `offsets.svg`, in the folder of `offsets.json`.
    pub fn plot_path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.svg")
    }

    /// Returns the hexadecimal hash that identifies the offsets of a capture as estimated with these options. Returns
    /// an error if a frame file cannot be read.
    pub fn hash(capture: &Capture, options: &impl Serialize) -> Result<String, CaptureError> {
        // The options are hashed as they are stored in the file. Serializing them can't fail.
        let options = serde_json::to_value(options).unwrap_or_default();
        let key = capture.cache()?.key(ESTIMATED_OFFSETS, &options);
        Ok(key.map(|key| key.to_string()).unwrap_or_default())
    }

    /// Reads `offsets.json` from the capture's folder. Returns an error if the file cannot be read or parsed, or if
    /// it was edited by hand and fails the validation.
    pub fn saved(capture: &Capture) -> Result<SavedOffsets, CaptureError> {
        let path = Self::path(capture);
        let text = match read_text(&path, MAX_OFFSETS_BYTES) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(SavedOffsets::Missing),
            Err(source) => return Err(CaptureError::Read { path, source }),
            Ok(text) => text,
        };
        let file: OffsetsFile = json::parse(&text).map_err(|reason| {
            let source = JsonError::Content(format!("{reason} ({REMEDY})"));
            CaptureError::Json { path, source }
        })?;
        let is_own = file.checksum.as_deref() == Some(&file.checksum());
        let OffsetsFile { reference, cameras, options, hash, checksum } = file;
        let offsets = Self { reference, cameras };
        match (hash, checksum) {
            (Some(hash), Some(_)) if is_own && offsets.fits(capture) => {
                let options = options.unwrap_or_default();
                Ok(SavedOffsets::Estimated { offsets, options, hash })
            }
            (Some(_), checksum) if is_own || checksum.is_none() => Ok(SavedOffsets::Missing),
            _ => Ok(SavedOffsets::Edited(validated(offsets, capture)?)),
        }
    }

    /// Writes estimated offsets to `offsets.json` in the capture's folder, atomically. `options` are the options of
    /// the estimate, and `hash` is the hash that identifies it ([`Self::hash`]).
    pub fn save(
        &self,
        capture: &Capture,
        options: &impl Serialize,
        hash: &str,
    ) -> Result<(), CaptureError> {
        let path = Self::path(capture);
        let mut file = OffsetsFile {
            reference: self.reference.clone(),
            cameras: self.cameras.clone(),
            options: serde_json::to_value(options).ok(),
            hash: Some(hash.to_owned()),
            checksum: None,
        };
        file.checksum = Some(file.checksum());
        write_json(&path, &file).map_err(|source| CaptureError::Write { path, source })
    }
}

type FieldResult = Result<(), CaptureError>;

/// Returns the error of an invalid field. `reason` completes the sentence that starts with the field's name.
fn invalid(
    capture: &Capture,
    field: impl Into<String>,
    reason: impl std::fmt::Display,
) -> CaptureError {
    let reason = format!("{}: {reason} ({REMEDY})", field.into());
    CaptureError::Content { path: Offsets::path(capture), reason }
}

/// Validates offsets that were edited by hand, by the table in the module's documentation, and sorts the cameras into
/// the capture's order. Returns the first violation as an error.
fn validated(given: Offsets, capture: &Capture) -> Result<Offsets, CaptureError> {
    let refuse = |field: &str, reason: String| Err(invalid(capture, field, reason));
    let reference = &capture.cameras[capture.reference].id;
    if given.reference != *reference {
        let reason = format!("is '{}', the capture's is '{reference}'", given.reference);
        return refuse("reference", reason);
    }
    let mut in_order: Vec<Option<(usize, CameraOffset)>> = vec![None; capture.cameras.len()];
    for (k, camera) in given.cameras.into_iter().enumerate() {
        let field = format!("cameras[{k}].id");
        let Some(index) = capture.camera_index(&camera.id) else {
            return refuse(&field, format!("no camera of the capture has the id '{}'", camera.id));
        };
        if in_order[index].is_some() {
            return refuse(&field, format!("'{}' is there twice", camera.id));
        }
        in_order[index] = Some((k, camera));
    }
    let (mut indices, mut cameras) = (Vec::new(), Vec::new());
    for (index, entry) in in_order.into_iter().enumerate() {
        let Some((k, camera)) = entry else {
            return refuse("cameras", format!("'{}' is missing", capture.cameras[index].id));
        };
        let fields = CameraFields { k, camera: &camera, capture };
        let filmed = &capture.cameras[index];
        fields.offset(capture.reach_s(), capture.has_reference_clock(index))?;
        fields.rate(filmed.clock.drift && index != capture.reference)?;
        fields.readout(filmed)?;
        fields.lost_before(filmed)?;
        fields.reason()?;
        indices.push(k);
        cameras.push(camera);
    }
    let offsets = Offsets { reference: given.reference, cameras };
    validate_times(&offsets, &indices, capture)?;
    Ok(offsets)
}

/// The fields of one camera in `offsets.json`, to be validated. `k` is the camera's index in the file.
struct CameraFields<'a> {
    k: usize,
    camera: &'a CameraOffset,
    capture: &'a Capture,
}

impl CameraFields<'_> {
    /// Returns an error with the field's name and the reason, unless `valid` is true.
    fn require(&self, valid: bool, field: &str, reason: impl std::fmt::Display) -> FieldResult {
        let field = format!("cameras[{}] ({}).{field}", self.k, self.camera.id);
        if valid { Ok(()) } else { Err(invalid(self.capture, field, reason)) }
    }

    fn offset(&self, reach_s: f64, is_on_reference: bool) -> FieldResult {
        let CameraOffset { offset_s, std_err_s, .. } = *self.camera;
        if is_on_reference {
            let reason = "must be 0 on the reference camera's clock";
            self.require(offset_s == Some(0.0), "offset_s", reason)?;
            return self.require(std_err_s == Some(0.0), "std_err_s", reason);
        }
        let Some(offset_s) = offset_s else {
            let reason = "must be null where offset_s is";
            return self.require(std_err_s.is_none(), "std_err_s", reason);
        };
        self.require(std_err_s.is_some(), "std_err_s", "is missing")?;
        self.require(offset_s.is_finite(), "offset_s", "must be finite")?;
        let error_s = std_err_s.unwrap_or_default();
        let reason = format!("is {error_s:?}, must be from 0 to {reach_s} s");
        self.require((0.0..=reach_s).contains(&error_s), "std_err_s", reason)
    }

    fn rate(&self, may_drift: bool) -> FieldResult {
        const MAX: f64 = MAX_DRIFT_PPM;
        let (rate, error) = (self.camera.rate_ppm, self.camera.rate_std_err_ppm);
        let Some(rate) = rate else {
            let reason = "is there without a rate_ppm";
            return self.require(error.is_none(), "rate_std_err_ppm", reason);
        };
        self.require(self.camera.offset_s.is_some(), "rate_ppm", "is there without an offset_s")?;
        let reason = "must be 0: the capture says nothing of a drift";
        self.require(may_drift || rate == 0.0, "rate_ppm", reason)?;
        let reason = format!("is {rate:?}, must be from -{MAX} to {MAX}");
        self.require(rate.abs() <= MAX, "rate_ppm", reason)?;
        self.require(error.is_some(), "rate_std_err_ppm", "is missing")?;
        let error = error.unwrap_or_default();
        let reason = format!("is {error:?}, must be from 0 to {MAX}");
        self.require((0.0..=MAX).contains(&error), "rate_std_err_ppm", reason)
    }

    fn readout(&self, filmed: &FilmedCamera) -> FieldResult {
        let (readout_s, error_s) = (self.camera.readout_s, self.camera.readout_std_err_s);
        let Some(readout_s) = readout_s else {
            let reason = "is there without a readout_s";
            return self.require(error_s.is_none(), "readout_std_err_s", reason);
        };
        let reason = "must be absent: the capture states the readout time as exact";
        self.require(filmed.clock.readout_std_s > 0.0, "readout_s", reason)?;
        let longest_s = filmed.clock.longest_readout_s().unwrap_or_default();
        let reason = format!("is {readout_s:?}, must be from 0 to {longest_s:?} s");
        self.require((0.0..=longest_s).contains(&readout_s), "readout_s", reason)?;
        self.require(error_s.is_some(), "readout_std_err_s", "is missing")?;
        let error_s = error_s.unwrap_or_default();
        let reason = format!("is {error_s:?}, must be from 0 to 1 s");
        self.require((0.0..=1.0).contains(&error_s), "readout_std_err_s", reason)
    }

    fn lost_before(&self, filmed: &FilmedCamera) -> FieldResult {
        let Some(lost) = &self.camera.lost_before else { return Ok(()) };
        let require = |valid, reason: String| self.require(valid, "lost_before", reason);
        let frames = filmed.frames.len();
        let reason = "must be empty: the capture says nothing of lost frames";
        require(filmed.clock.lost || lost.is_empty(), reason.into())?;
        let reason = format!("has {} entries, and the camera {frames} images", lost.len());
        require(lost.len() <= frames, reason)?;
        if let Some(pair) = lost.windows(2).find(|pair| pair[0] > pair[1]) {
            require(false, format!("must ascend, and {} is before {}", pair[0], pair[1]))?;
        }
        let last = lost.last().copied().unwrap_or(0);
        let reason =
            format!("has image {last}, and the camera's are 0 to {}", frames.saturating_sub(1));
        require(last < frames, reason)
    }

    fn reason(&self) -> FieldResult {
        let is_known = self.camera.offset_s.is_some();
        let Some(reason) = &self.camera.reason else {
            return self.require(is_known, "reason", "is missing, and offset_s is null");
        };
        self.require(!is_known, "reason", "is there although offset_s is known")?;
        let is_line = !reason.trim().is_empty() && !reason.contains(char::is_control);
        let valid = is_line && reason.chars().count() <= MAX_REASON_CHARS;
        let rule = format!("must be a line of at most {MAX_REASON_CHARS} characters");
        self.require(valid, "reason", rule)
    }
}

/// Checks that each camera's images have ascending times on the reference camera's clock, within the widest time span
/// that the capture allows ([`Capture::widest_span_s`]). `indices` holds the index of each of the capture's cameras
/// in the file.
fn validate_times(offsets: &Offsets, indices: &[usize], capture: &Capture) -> FieldResult {
    let all = offsets.common_times_s(capture);
    let reach_s = capture.reach_s();
    for (index, (times, camera)) in all.iter().zip(&offsets.cameras).enumerate() {
        let (Some(times), Some(offset_s)) = (times, camera.offset_s) else { continue };
        let fields = CameraFields { k: indices[index], camera, capture };
        let (first_s, last_s) = capture.widest_span_s(Some(index));
        let is_within = first_s <= times[0] && times[times.len() - 1] <= last_s;
        let reason = format!(
            "is {offset_s:?}, which puts its images further from the reference's than all recordings last, {reach_s:.3} s"
        );
        fields.require(is_within, "offset_s", reason)?;
        let reason = format!(
            "is {offset_s:?}, so large that the times of successive frames are equal once rounded"
        );
        fields.require(are_frame_times(times), "offset_s", reason)?;
    }
    Ok(())
}
