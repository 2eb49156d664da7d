//! Reading and writing of single values in COLMAP's text and binary files.

use crate::camera::{Camera, CameraModel, MAX_QUATERNION_ERROR};
use crate::text::number;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::str::{FromStr, SplitWhitespace};

/// Size limit of a file of a COLMAP model, in bytes. It is large enough for thousands of images with their points.
pub(super) const MAX_MODEL_BYTES: u64 = 768 << 20;

/// Creates a pose from a unit quaternion (w, x, y, z) and a translation. The caller adds the file's name to the error
/// message.
pub(super) fn pose(wxyz: [f64; 4], translation: [f64; 3]) -> Result<Isometry3<f64>, String> {
    let [w, x, y, z] = wxyz;
    let rotation = Quaternion::new(w, x, y, z);
    if !((rotation.norm() - 1.0).abs() <= MAX_QUATERNION_ERROR) {
        let length = number(rotation.norm());
        return Err(format!("its quaternion has length {length}, must be of 1"));
    }
    let translation = Translation3::from(translation);
    Ok(Isometry3::from_parts(translation, UnitQuaternion::from_quaternion(rotation)))
}

pub(super) fn text(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|_| "is no text".into())
}

/// Parses the next value of a line. `what` is the name of the value in the error message.
pub(super) fn value<T: FromStr>(fields: &mut SplitWhitespace, what: &str) -> Result<T, String> {
    let field = fields.next().ok_or_else(|| format!("{what} is missing"))?;
    field.parse().map_err(|_| format!("{what} can't be '{field}'"))
}

/// Returns whether a line of a text file has values, that is, whether it is neither empty nor a comment.
pub(super) fn has_values(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

/// Reader of little-endian values from the front of a byte slice. Values that were read are removed from the slice.
pub(super) struct Bytes<'a>(pub &'a [u8]);

impl Bytes<'_> {
    pub fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) = self.0.split_first_chunk().ok_or("is cut short")?;
        self.0 = rest;
        Ok(*head)
    }

    pub fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    pub fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    pub fn f64(&mut self) -> Result<f64, String> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    pub fn name(&mut self) -> Result<String, String> {
        let end = self.0.iter().position(|&b| b == 0).ok_or("is cut short")?;
        let name = std::str::from_utf8(&self.0[..end]).map_err(|_| "a name is no text")?;
        self.0 = &self.0[end + 1..];
        Ok(name.to_owned())
    }

    /// Skips `count` records of `size` bytes each. Fewer remaining bytes are an error.
    pub fn skip(&mut self, count: u64, size: u64) -> Result<(), String> {
        let bytes = count.checked_mul(size).and_then(|n| usize::try_from(n).ok());
        self.0 = bytes.and_then(|n| self.0.get(n..)).ok_or("is cut short")?;
        Ok(())
    }

    pub fn is_at_end(&self) -> Result<(), String> {
        if self.0.is_empty() { Ok(()) } else { Err("goes on after its last entry".into()) }
    }
}

/// Encodes the length of a list as 8 bytes, as COLMAP writes it before the list's entries.
pub(super) fn counted(entries: usize) -> Vec<u8> {
    (entries as u64).to_le_bytes().to_vec()
}

/// Encodes a camera as an entry of `cameras.bin`.
pub(super) fn camera_bytes(number: u32, camera: &Camera) -> Vec<u8> {
    let name = camera.model.name();
    let model = CameraModel::KNOWN.iter().find(|(known, ..)| *known == name);
    let mut bytes = number.to_le_bytes().to_vec();
    bytes.extend(model.map_or(-1, |(_, number, _)| *number).to_le_bytes());
    for side in [camera.width, camera.height] {
        bytes.extend((side as u64).to_le_bytes());
    }
    bytes.extend(camera.model.params().iter().flat_map(|p| p.to_le_bytes()));
    bytes
}

/// Encodes an image without points as an entry of `images.bin`.
pub(super) fn image_bytes(number: u32, camera_number: u32, camera: &Camera, name: &str) -> Vec<u8> {
    let mut bytes = number.to_le_bytes().to_vec();
    bytes.extend(pose_bytes(&camera.cam_from_world));
    bytes.extend(camera_number.to_le_bytes());
    bytes.extend(name.as_bytes());
    bytes.push(0);
    bytes.extend(0_u64.to_le_bytes());
    bytes
}

/// Encodes a pose as in COLMAP's binary files: quaternion (w, x, y, z) and translation.
pub(super) fn pose_bytes(pose: &Isometry3<f64>) -> Vec<u8> {
    let (q, t) = (pose.rotation, pose.translation);
    [q.w, q.i, q.j, q.k, t.x, t.y, t.z].iter().flat_map(|v| v.to_le_bytes()).collect()
}
