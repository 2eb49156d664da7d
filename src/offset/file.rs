//! `CAPTURE/offsets.json`: offsets that were estimated, kept for the next command, or edited by hand.
//!
//! | field | what |
//! |---|---|
//! | `reference` | the reference camera's id |
//! | `cameras` | a [`CameraOffset`] for each camera |
//! | `options` | the options that the offsets were estimated with |
//! | `hash` | of the program's version, the capture's content and these options |
//! | `checksum` | of all fields above |
//!
//! Where the checksum holds, the offsets are the program's own estimate: they are used while the hash
//! is that of the capture and the options, and are estimated anew otherwise.
//!
//! Where the checksum doesn't hold, or neither it nor `hash` is there, somebody has edited or written the
//! file. `render`, `compare` and `plan` then use its offsets as given, and say so; whatever the options
//! are, and without a look at the frames. `stlfr offsets` says what the images tell: it estimates, and
//! leaves the file as it is. Deleted, it is written anew. A file with a hash and without a checksum is
//! an earlier version's, and is estimated anew.
//!
//! Of a file that was edited, every field is validated. What doesn't pass ends the command, in a sentence
//! with the file and the field:
//!
//! | field | must be |
//! |---|---|
//! | the file | a regular file of at most 16 MiB, JSON, with no other fields than these |
//! | `reference` | the capture's reference camera |
//! | `id` | that of a camera of the capture; each once, all there, in any order |
//! | `offset_s` | a number, or null; 0 for the reference. It puts the camera's images no further from the reference's than all recordings last, one after the other ([`Capture::reach_s`]) |
//! | `std_err_s` | null where `offset_s` is; else from 0 to that length; 0 for the reference |
//! | `rate_ppm` | from −1000 to 1000; only where there is an offset; 0, if anything, for the reference |
//! | `rate_std_err_ppm` | from 0 to 1000, exactly where there is a rate |
//! | `lost_before` | numbers of the camera's images, ascending, at most as many as it has images |
//! | `reason` | a line of text exactly where `offset_s` is null |

use super::edited;
use super::store::{CameraOffset, Offsets};
use crate::capture::{Capture, CaptureError};
use crate::host::{CacheKind, read_text, write_json};
use crate::json::{self, JsonError};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::ErrorKind;
use std::path::PathBuf;

/// Largest file of offsets that is read, bytes. Larger: one of many empty cameras takes more than a
/// gigabyte of memory. Smaller: a thousand cameras that lost a thousand frames each are refused.
pub const MAX_OFFSETS_BYTES: u64 = 16 << 20;

/// The hash is a key like those of the capture's cache.
const ESTIMATED_OFFSETS: CacheKind = CacheKind { name: "offsets", version: 1 };

/// What a capture's `offsets.json` holds.
#[derive(Clone, Debug, PartialEq)]
pub enum SavedOffsets {
    /// There is no file, or one of an earlier version, or one in which frames vanish.
    Missing,
    /// The program's own estimate with these options, and the hash that identifies it.
    Estimated { offsets: Offsets, options: Value, hash: String },
    /// What somebody has edited or written, validated, the cameras in the capture's order.
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
    /// The hash of all other fields' values, however they are laid out in the file.
    fn checksum(&self) -> String {
        let fields = (&self.reference, &self.cameras, &self.options, &self.hash);
        // Strings, numbers and lists can't fail to be written.
        let text = serde_json::to_string(&fields).unwrap_or_default();
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }
}

impl Offsets {
    fn path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.json")
    }

    /// The path of the plot beside `offsets.json`.
    pub fn plot_path(capture: &Capture) -> PathBuf {
        capture.folder.join("offsets.svg")
    }

    /// The hash that identifies offsets of this capture estimated with these options, hexadecimal. The
    /// error is that of a frame file that cannot be read.
    pub fn hash(capture: &Capture, options: &impl Serialize) -> Result<String, CaptureError> {
        // As the file has them. Options can't fail to be written.
        let options = serde_json::to_value(options).unwrap_or_default();
        Ok(capture.cache()?.key(ESTIMATED_OFFSETS, &options).unwrap_or_default())
    }

    /// What `offsets.json` in the capture's folder holds. The error is that of a file that can't be
    /// read, or that was edited and doesn't pass the validation.
    pub fn saved(capture: &Capture) -> Result<SavedOffsets, CaptureError> {
        let path = Self::path(capture);
        let text = match read_text(&path, MAX_OFFSETS_BYTES) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(SavedOffsets::Missing),
            Err(source) => return Err(CaptureError::Read { path, source }),
            Ok(text) => text,
        };
        let file: OffsetsFile = match json::parse(&text) {
            Ok(file) => file,
            Err(reason) => {
                let reason = format!("{reason} ({WAY_OUT})");
                return Err(CaptureError::Json { path, source: JsonError::Content(reason) });
            }
        };
        let is_own = file.checksum.as_deref() == Some(&file.checksum());
        let OffsetsFile { reference, cameras, options, hash, checksum } = file;
        let offsets = Self { reference, cameras };
        match (hash, checksum) {
            (Some(hash), Some(_)) if is_own && offsets.fits(capture) => {
                let options = options.unwrap_or_default();
                Ok(SavedOffsets::Estimated { offsets, options, hash })
            }
            (Some(_), checksum) if is_own || checksum.is_none() => Ok(SavedOffsets::Missing),
            _ => match edited::checked(offsets, capture) {
                Ok(offsets) => Ok(SavedOffsets::Edited(offsets)),
                Err(edited::Refused { field, reason }) => {
                    let reason = format!("{reason} ({WAY_OUT})");
                    Err(CaptureError::Field { path, field, reason })
                }
            },
        }
    }

    /// Writes `offsets.json` into the capture's folder, atomically: an estimate with these options, and
    /// its hash.
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

/// What to do about a file that is refused.
const WAY_OUT: &str = "without the file, offsets are estimated";
