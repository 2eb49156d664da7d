//! Ground truth of a simulated capture, in the capture's folder `truth/`. Only the commands `compare` and `tradeoff`
//! read its images and clocks. `render --like` reads the lenses and poses of its views.
//!
//! # A benchmark of sub-frame synchronization
//!
//! A capture with ground truth is a test case for any method that synchronizes cameras. `stlfr capture RIG --scene NAME
//! --tracks 1000 -o CAPTURE` films such a capture. The rig's file delays each shutter by a fraction of a frame and adds
//! jitter.
//!
//! | where | what |
//! |---|---|
//! | `capture.json` | the input of a method: frames, cameras, nominal clocks |
//! | `truth/truth.json` `offsets` | time on the reference's clock = time on the camera's clock + `offset_s` |
//! | `shutter` | the true middle of every exposure, including random jitter, which the time stamps may omit |
//! | `views` | images of all cameras and of views beside them at common instants, with depth (metres along +z, +inf where there is no surface) and motion (pixels that a surface point moves within one frame before or after, whichever is larger) |
//! | `video` | images of one view at regular times |
//! | `tracks` | 3D points on the surfaces, their pixels and their visibility at every frame of every camera |
//!
//! The file `truth/tracks/tracks.json` describes the tracks:
//!
//! ```json
//! { "format": "stlfr-tracks", "version": 1, "objects": ["wall", "ball"], "object": [0, 1, 1],
//!   "cameras": [ { "id": "cam0", "times_s": [0.0103, 0.0437],
//!                  "world": "cam0.world.npy", "pixels": "cam0.pixels.npy",
//!                  "visible": "cam0.visible.npy" } ] }
//! ```
//!
//! `object` has one entry per point: the index of the point's object in `objects`. A point stays at its place on the
//! surface, which may move and bend. For each camera, with F frames and P points:
//!
//! | file | type | shape | |
//! |---|---|---|---|
//! | `world` | f64 | F, P, 3 | metres |
//! | `pixels` | f64 | F, P, 2 | the point's projection, also outside of the image or occluded; NaN behind the camera |
//! | `visible` | u8 | F, P | 1 where the point is inside the image and nothing occludes it |
//!
//! `times_s` are the true middles of the exposures. With a rolling shutter (`readout_s` of the camera's clock in
//! `capture.json`), `times_s` are the middles of the exposure of the middle row, but a point's position, pixel and
//! visibility are those at the exposure time of the point's own row. Images, depth and motion of `views` are always of
//! one instant. File names are relative to `truth/tracks/`.
//!
//! A synchronization method writes its results into a file with the contents `{"reference": "cam3", "cameras": [{"id":
//! "cam0", "offset_s": 0.0123, "std_err_s": 0.0001}, …]}`. Both numbers are `null` for a camera whose offset is
//! unknown. The command `stlfr compare CAPTURE --offsets FILE` then prints each camera's error, in frame intervals and
//! in standard errors, with the median and the maximum.

use super::{CaptureError, require_size};
use crate::camera::{Camera, CameraFormat};
use crate::host::{file_hash, lock, read_bytes, read_hashed};
use crate::json::{self, JsonError};
use crate::raster::{Image, read_hashed_image};
use crate::text::{check_id, check_name};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex};

/// The contents of `truth/truth.json`. Paths are relative to `truth/`. Times are on the reference camera's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Always `stlfr-truth`.
    pub format: String,
    /// Always 1.
    pub version: u32,
    /// Name of the scene.
    pub scene: String,
    /// Name of the rig.
    pub rig: String,
    /// True clock of every camera.
    pub offsets: Vec<TruthOffset>,
    /// True exposure times of every camera.
    pub shutter: Vec<TruthShutter>,
    /// Ground-truth images of views at single instants.
    pub views: Vec<TruthView>,
    /// Ground-truth images of one view over time. `None` if no such images were filmed.
    #[serde(default)]
    pub video: Option<TruthVideo>,
    /// Path of the file with the point tracks, `tracks/tracks.json`, relative to `truth/`. `None` if no points were
    /// tracked.
    #[serde(default)]
    pub tracks: Option<String>,
    #[serde(skip)]
    folder: PathBuf,
    /// Hash of each file that was read. A file that is read again must have the same bytes.
    #[serde(skip)]
    hashes: Arc<Mutex<HashMap<PathBuf, blake3::Hash>>>,
}

/// True clock of one camera. It converts a time on the camera's clock, t_cam, to the reference's clock: t_ref = t_cam +
/// `offset_s` + (t_cam − t_first) · `rate_ppm` · 1e-6. Here t_first is the time of the camera's first frame, on the
/// camera's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthOffset {
    /// The camera's id.
    pub id: String,
    /// Offset at the time of the camera's first frame, seconds: time on the reference's clock minus time on the
    /// camera's clock.
    pub offset_s: f64,
    /// Drift of the camera's clock, parts per million: the microseconds per second by which (time on the reference's
    /// clock − time on the camera's clock) grows.
    #[serde(default)]
    pub rate_ppm: f64,
    /// For each lost frame, the index of the next image that was recorded. Recorded images are counted from 0.
    #[serde(default)]
    pub lost_before: Vec<u32>,
}

/// True middle of every exposure of one camera, seconds on the reference's clock.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthShutter {
    /// The camera's id.
    pub id: String,
    /// Middle of the exposure of each frame, seconds on the reference's clock, in ascending order.
    pub times_s: Vec<f64>,
}

/// Largest number of ground-truth images in [`Truth::views`].
const MAX_VIEWS: usize = 10_000;

/// A ground-truth image of a view at an instant.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthView {
    /// The view's id.
    pub id: String,
    /// The instant, seconds on the reference's clock.
    pub time_s: f64,
    /// Id of the filming camera with the same lens and pose as this view. `None` if there is no such camera.
    pub like: Option<String>,
    /// Image size, lens and pose of the view.
    pub camera: CameraFormat,
    /// Image file, relative to `truth/`.
    pub image: String,
    /// npy file of the depth, relative to `truth/`: f32, H×W, metres along the camera's +z.
    pub depth: String,
    /// npy file of the motion, relative to `truth/`: f32, H×W, pixels. The motion is the displacement of a surface
    /// point within one frame before the instant or one frame after it, whichever is larger.
    pub motion: String,
}

/// Ground-truth images of one view over time.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthVideo {
    /// The view's id.
    pub view: String,
    /// Times of the images, seconds on the reference's clock.
    pub times_s: Vec<f64>,
    /// Image size, lens and pose of the view.
    pub camera: CameraFormat,
    /// Pattern of the image files relative to `truth/`, such as `video/%04d.png`.
    pub images: String,
}

impl Truth {
    /// Reads `CAPTURE/truth/truth.json`. `None` if the capture has no ground truth.
    pub fn open(capture: &Path) -> Result<Option<Self>, CaptureError> {
        let folder = capture.join("truth");
        let path = folder.join("truth.json");
        let mut truth: Self = match json::read(&path) {
            Err(JsonError::Read(e)) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(CaptureError::Json { path, source }),
            Ok(truth) => truth,
        };
        truth.check().map_err(|reason| CaptureError::Content { path, reason })?;
        truth.folder = folder;
        Ok(Some(truth))
    }

    /// Checks the format, the version, and all names, ids and cameras. The rules for names and ids are those of
    /// `capture.json`. The caller adds the file's name to the error message.
    fn check(&self) -> Result<(), String> {
        if self.format != "stlfr-truth" || self.version != 1 {
            return Err("format and version must be 'stlfr-truth' and 1".into());
        }
        if self.views.len() > MAX_VIEWS {
            return Err(format!("views: are {}, at most {MAX_VIEWS} are read", self.views.len()));
        }
        for (field, name) in [("scene", &self.scene), ("rig", &self.rig)] {
            check_name(name).map_err(|reason| format!("{field}: {reason}"))?;
        }
        let offsets = self.offsets.iter().map(|o| &o.id).enumerate();
        let shutter = self.shutter.iter().map(|s| &s.id).enumerate();
        let views = self.views.iter().map(|v| &v.id).enumerate();
        let ids = offsets.map(|(n, id)| (format!("offsets[{n}].id"), id));
        let ids = ids.chain(shutter.map(|(n, id)| (format!("shutter[{n}].id"), id)));
        let ids = ids.chain(views.map(|(n, id)| (format!("views[{n}].id"), id)));
        let video = self.video.iter().map(|video| ("video.view".into(), &video.view));
        for (field, id) in ids.chain(video) {
            check_id(id).map_err(|reason| format!("{field}: {reason}"))?;
        }
        for (index, view) in self.views.iter().enumerate() {
            view.camera.camera().map_err(|error| format!("views[{index}].camera.{error}"))?;
        }
        Ok(())
    }

    /// Returns a camera's true offset at its first frame, seconds: time on the reference's clock minus time on the
    /// camera's clock. `None` if the ground truth has no camera with this id.
    pub fn offset_s(&self, id: &str) -> Option<f64> {
        self.clock(id).map(|o| o.offset_s)
    }

    /// Returns a camera's true clock. `None` if the ground truth has no camera with this id.
    pub fn clock(&self, id: &str) -> Option<&TruthOffset> {
        self.offsets.iter().find(|o| o.id == id)
    }

    /// Returns the canonical path of a file of the ground truth. `relative` is its path relative to `truth/`. Returns
    /// an error if the file doesn't exist or lies outside of `truth/`.
    pub fn file(&self, relative: &str) -> Result<PathBuf, CaptureError> {
        let path = self.folder.join(relative);
        let inside = Path::new(relative).components().all(|c| matches!(c, Component::Normal(_)));
        let root = self.folder.canonicalize();
        let real = path.canonicalize();
        match (inside, root, real) {
            (true, Ok(root), Ok(real)) if real.starts_with(&root) => Ok(real),
            (true, _, Err(source)) => Err(CaptureError::Read { path, source }),
            _ => Err(CaptureError::content(&path, "must stay inside truth/")),
        }
    }

    /// Returns an error if a file, which now has the given hash, has changed since it was first read.
    fn require_unchanged(&self, path: &Path, hash: blake3::Hash) -> Result<(), CaptureError> {
        match *lock(&self.hashes).entry(path.to_owned()).or_insert(hash) == hash {
            true => Ok(()),
            false => Err(CaptureError::Changed { path: path.to_owned() }),
        }
    }

    /// Returns the hash of a file of the ground truth. `relative` is its path relative to `truth/`. Later reads of the
    /// file return an error if its bytes have changed.
    pub(crate) fn hash(&self, relative: &str) -> Result<blake3::Hash, CaptureError> {
        let path = self.file(relative)?;
        let hash =
            file_hash(&path).map_err(|source| CaptureError::Read { path: path.clone(), source })?;
        self.require_unchanged(&path, hash).map(|()| hash)
    }

    /// Reads an image of the ground truth. `relative` is its path relative to `truth/`. Returns an error if the image's
    /// size differs from the size of `camera`.
    pub(crate) fn image(&self, relative: &str, camera: &Camera) -> Result<Image, CaptureError> {
        let path = self.file(relative)?;
        let (image, read) = read_hashed_image(&path)?;
        self.require_unchanged(&path, read.hash)?;
        require_size(&path, [image.width(), image.height()], camera)?;
        Ok(image)
    }

    /// Reads a depth or motion image of the ground truth. `relative` is its path relative to `truth/`. Returns H×W
    /// values row by row, or an error if the image's size differs from the size of `camera`.
    pub(crate) fn array(&self, relative: &str, camera: &Camera) -> Result<Vec<f32>, CaptureError> {
        let path = self.file(relative)?;
        let (bytes, read) = read_hashed(&path, MAX_ARRAY_BYTES)
            .map_err(|source| CaptureError::Read { path: path.clone(), source })?;
        self.require_unchanged(&path, read.hash)?;
        let (width, height, values) =
            parse_array(&bytes).map_err(|reason| CaptureError::content(&path, reason))?;
        require_size(&path, [width, height], camera)?;
        Ok(values)
    }
}

/// Largest npy file that is read, bytes: an array of 8192×8192 float32 values, and a header.
const MAX_ARRAY_BYTES: u64 = (256 << 20) + 10 + 0xffff;

/// Reads a depth or motion image: an H×W array in numpy's file format, version 1. Returns the width, the height, and
/// the values row by row.
///
/// # Errors
/// If the file can't be read, if the array isn't float32 in C order with two axes, or if the file's size contradicts
/// its header.
pub fn read_array(path: &Path) -> Result<(usize, usize, Vec<f32>), CaptureError> {
    let bytes = read_bytes(path, MAX_ARRAY_BYTES)
        .map_err(|source| CaptureError::Read { path: path.to_owned(), source })?;
    parse_array(&bytes).map_err(|reason| CaptureError::content(path, reason))
}

/// Parses an H×W array of little-endian float32 in numpy's file format. Returns the width, the height, and the values
/// row by row. The caller adds the file's name to the error message.
fn parse_array(file: &[u8]) -> Result<(usize, usize, Vec<f32>), String> {
    let rest = file.strip_prefix(b"\x93NUMPY\x01\x00").ok_or("is no npy file")?;
    let (length, rest) = rest.split_first_chunk().ok_or("is cut short")?;
    let (header, data) =
        rest.split_at_checked(u16::from_le_bytes(*length).into()).ok_or("is cut short")?;
    let header = std::str::from_utf8(header).map_err(|_| "has no readable header")?;
    if !header.contains("'<f4'") || !header.contains("'fortran_order': False") {
        return Err("must hold little-endian float32 in C order".into());
    }
    let shape: Vec<usize> = header
        .split_once('(')
        .and_then(|(_, rest)| rest.split_once(')'))
        .map(|(shape, _)| shape.split(',').filter_map(|n| n.trim().parse().ok()).collect())
        .unwrap_or_default();
    let &[height, width] = shape.as_slice() else { return Err("must have 2 axes".into()) };
    let (values, tail) = data.as_chunks();
    if height.checked_mul(width) != Some(values.len()) || !tail.is_empty() {
        return Err("has another size than its header says".into());
    }
    Ok((width, height, values.iter().map(|value| f32::from_le_bytes(*value)).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the bytes of an npy file with this type, this shape and these data, as numpy writes it.
    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
        while (header.len() + 11) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
        file.extend(header.as_bytes());
        file.extend(data);
        file
    }

    #[test]
    fn an_array_is_read_and_a_wrong_one_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let data: Vec<u8> = (0..6).flat_map(|i| (i as f32).to_le_bytes()).collect();
        std::fs::write(&path, npy("<f4", "3, 2", &data)).unwrap();
        let values = vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(read_array(&path).unwrap(), (2, 3, values));

        let complaint = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read_array(&path).unwrap_err().to_string()
        };
        assert!(complaint(b"text").ends_with("is no npy file"));
        assert!(complaint(&npy("<f8", "3, 2", &data)).ends_with("float32 in C order"));
        assert!(complaint(&npy("<f4", "1, 3, 2", &data)).ends_with("must have 2 axes"));
        assert!(complaint(&npy("<f4", "3, 3", &data)).contains("another size"));
        assert!(complaint(&npy("<f4", "3, 2", &data[1..])).contains("another size"));
        let huge = format!("{}, {}", usize::MAX, usize::MAX);
        assert!(complaint(&npy("<f4", &huge, &data)).contains("another size"));
        assert!(complaint(&npy("<f4", "3, 2", &data)[..40]).ends_with("is cut short"));
    }
}
