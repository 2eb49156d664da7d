//! `truth/tracks/`: points of the scene's surfaces, with positions and visibility at every frame of
//! every camera.
//!
//! `tracks.json`:
//!
//! ```json
//! { "format": "stlfr-tracks", "version": 1, "objects": ["wall", "ball"], "object": [0, 1, 1],
//!   "cameras": [ { "id": "cam0", "times_s": [0.0103, 0.0437],
//!                  "world": "cam0.world.npy", "pixels": "cam0.pixels.npy",
//!                  "visible": "cam0.visible.npy" } ] }
//! ```
//!
//! `object` has for each point the index of its object in `objects`. A point stays at its place on
//! the surface, which may move and bend. For each camera, with F frames and P points:
//!
//! | file | type | shape | |
//! |---|---|---|---|
//! | `world` | f64 | F, P, 3 | metres |
//! | `pixels` | f64 | F, P, 2 | the point's projection, also outside of the image or hidden; NaN behind the camera |
//! | `visible` | u8 | F, P | 1 where the point is inside the image and nothing occludes it |
//!
//! `times_s` are the true middles of the exposures, on the reference's clock, as in `truth.json`.
//! Files are relative to `truth/tracks/`.

use super::npy::{Element, read_npy};
use super::truth::{Truth, TruthError};
use crate::json;
use nalgebra::{Point2, Point3};
use serde::Deserialize;

/// The tracked points.
#[derive(Clone, Debug)]
pub struct Tracks {
    /// Names of the objects that the points lie on.
    pub objects: Vec<String>,
    /// For each point, an index into `objects`.
    pub object: Vec<usize>,
    /// The cameras in the order of the file, which is the rig's.
    pub cameras: Vec<CameraTracks>,
}

/// The tracked points at the frames of one camera.
#[derive(Clone, Debug)]
pub struct CameraTracks {
    /// The camera's id.
    pub id: String,
    /// The true middle of each frame's exposure, seconds on the reference's clock.
    pub times_s: Vec<f64>,
    /// The points of each frame, in the order of [`Tracks::object`].
    pub frames: Vec<Vec<TrackedPoint>>,
}

/// One point at one frame of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPoint {
    /// Position in the world.
    pub world_m: Point3<f64>,
    /// Projection, pixels: also outside of the image or where occluded. NaN behind the camera.
    pub px: Point2<f64>,
    /// Whether the point is inside the image and not occluded.
    pub visible: bool,
}

/// Largest number of a camera's frames times the points. Larger: a mistake takes more than half a
/// gigabyte a camera. Smaller: a thousand points of an hour are refused.
const MAX_TRACKED: usize = 1 << 22;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TracksFormat {
    format: String,
    version: u32,
    objects: Vec<String>,
    object: Vec<usize>,
    cameras: Vec<CameraFormat>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFormat {
    id: String,
    times_s: Vec<f64>,
    world: String,
    pixels: String,
    visible: String,
}

impl Truth {
    /// Reads the point tracks; `None` if the truth has none.
    pub fn tracks(&self) -> Result<Option<Tracks>, TruthError> {
        let Some(relative) = &self.tracks else { return Ok(None) };
        let path = self.file(relative)?;
        let format: TracksFormat =
            json::read(&path).map_err(|source| TruthError::Json { path: path.clone(), source })?;
        let wrong =
            |reason: &str| TruthError::Content { path: path.clone(), reason: reason.into() };
        if format.format != "stlfr-tracks" || format.version != 1 {
            return Err(wrong("format and version must be 'stlfr-tracks' and 1"));
        }
        if format.object.iter().any(|&o| o >= format.objects.len()) {
            return Err(wrong("object: has a number that is none of objects"));
        }
        let folder = relative.rsplit_once('/').map_or("", |(folder, _)| folder);
        let cameras = format
            .cameras
            .into_iter()
            .map(|camera| self.camera_tracks(camera, folder, format.object.len()))
            .collect::<Result<_, _>>()?;
        Ok(Some(Tracks { objects: format.objects, object: format.object, cameras }))
    }

    fn camera_tracks(
        &self,
        camera: CameraFormat,
        folder: &str,
        points: usize,
    ) -> Result<CameraTracks, TruthError> {
        let frames = camera.times_s.len();
        if frames.checked_mul(points).is_none_or(|n| n > MAX_TRACKED) {
            let path = self.file(if folder.is_empty() { "." } else { folder })?;
            let reason = format!(
                "{}: has more than {MAX_TRACKED} tracked positions (frames × points)",
                camera.id
            );
            return Err(TruthError::Content { path, reason });
        }
        let world = self.array(folder, &camera.world, [frames, points, 3])?;
        let pixels = self.array(folder, &camera.pixels, [frames, points, 2])?;
        let visible: Vec<u8> = self.array(folder, &camera.visible, [frames, points])?;
        let (world, _) = world.as_chunks::<3>();
        let (pixels, _) = pixels.as_chunks::<2>();
        let tracked: Vec<TrackedPoint> = world
            .iter()
            .zip(pixels)
            .zip(&visible)
            .map(|((world, px), visible)| TrackedPoint {
                world_m: Point3::from(*world),
                px: Point2::from(*px),
                visible: *visible != 0,
            })
            .collect();
        let frames =
            (0..frames).map(|frame| tracked[frame * points..][..points].to_vec()).collect();
        Ok(CameraTracks { id: camera.id, times_s: camera.times_s, frames })
    }

    fn array<T: Element, const AXES: usize>(
        &self,
        folder: &str,
        name: &str,
        expected: [usize; AXES],
    ) -> Result<Vec<T>, TruthError> {
        let relative = if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") };
        let path = self.file(&relative)?;
        let (shape, values) = read_npy(&path)?;
        if shape != expected {
            let reason = format!("has the shape {shape:?}, but tracks.json says {expected:?}");
            return Err(TruthError::Content { path, reason });
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::super::npy::tests::npy;
    use super::*;
    use crate::host::write_atomically;
    use std::path::Path;

    const TRUTH: &str = r#"{"format": "stlfr-truth", "version": 1, "scene": "s", "rig": "r",
        "offsets": [], "shutter": [], "views": [], "tracks": "tracks/tracks.json"}"#;
    const TRACKS: &str = r#"{"format": "stlfr-tracks", "version": 1, "objects": ["wall", "ball"],
        "object": [1, 0], "cameras": [{"id": "cam0", "times_s": [0.1, 0.2], "world": "w.npy",
        "pixels": "p.npy", "visible": "v.npy"}]}"#;

    fn doubles(count: u32) -> Vec<u8> {
        (0..count).flat_map(|i| f64::from(i).to_le_bytes()).collect()
    }

    fn written(folder: &Path, tracks: &str) -> Truth {
        let write = |name: &str, bytes: &[u8]| {
            write_atomically(&folder.join("truth").join(name), bytes).unwrap();
        };
        write("truth.json", TRUTH.as_bytes());
        write("tracks/tracks.json", tracks.as_bytes());
        write("tracks/w.npy", &npy("<f8", "2, 2, 3", &doubles(12)));
        write("tracks/p.npy", &npy("<f8", "2, 2, 2", &doubles(8)));
        write("tracks/v.npy", &npy("|u1", "2, 2", &[0, 1, 1, 0]));
        Truth::open(folder).unwrap().unwrap()
    }

    #[test]
    fn every_point_is_at_its_frame() {
        let folder = tempfile::tempdir().unwrap();
        let tracks = written(folder.path(), TRACKS).tracks().unwrap().unwrap();
        assert_eq!((tracks.object[0], tracks.objects[1].as_str()), (1, "ball"));
        let camera = &tracks.cameras[0];
        assert_eq!((camera.id.as_str(), camera.times_s.as_slice()), ("cam0", &[0.1, 0.2][..]));
        assert_eq!(
            camera.frames[1][0],
            TrackedPoint {
                world_m: Point3::new(6.0, 7.0, 8.0),
                px: Point2::new(4.0, 5.0),
                visible: true,
            }
        );
        assert!(!camera.frames[1][1].visible && camera.frames[0][1].visible);
    }

    #[test]
    fn wrong_tracks_are_refused_with_their_file() {
        let complaint = |from: &str, to: &str| {
            let folder = tempfile::tempdir().unwrap();
            let truth = written(folder.path(), &TRACKS.replace(from, to));
            truth.tracks().unwrap_err().to_string()
        };
        assert!(complaint("-tracks\"", "-paths\"").contains("must be 'stlfr-tracks' and 1"));
        assert!(complaint("[1, 0]", "[2, 0]").contains("none of objects"));
        assert!(complaint("[1, 0]", "[1]").contains("w.npy: has the shape [2, 2, 3]"));
        assert!(complaint("\"w.npy\"", "\"../../w.npy\"").contains("must stay inside truth/"));
        assert!(complaint("\"w.npy\"", "\"none.npy\"").contains("none.npy"));
        assert!(complaint("\"id\"", "\"name\"").contains("name"));
    }
}
