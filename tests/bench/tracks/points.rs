//! The points of `truth/tracks/`: where they are in each frame of each camera. Of a film that the program made: anything
//! else panics.

use nalgebra::{Point2, Point3};
use serde::Deserialize;
use std::path::Path;
use stlfr::capture::Truth;

/// The tracked points at the frames of one camera.
pub struct CameraPoints {
    /// The true middle of each frame's exposure, seconds on the reference's clock.
    pub times_s: Vec<f64>,
    /// The points of each frame, all in the same order.
    pub frames: Vec<Vec<TrackedPoint>>,
}

/// One point at one frame of one camera.
pub struct TrackedPoint {
    /// Projection, pixels; NaN behind the camera.
    pub px: Point2<f64>,
    /// Whether the point is inside the image and not occluded.
    pub visible: bool,
    /// Metres.
    #[allow(dead_code)] // One of the two benchmarks needs it.
    pub world: Point3<f64>,
}

/// `tracks.json`.
#[derive(Deserialize)]
struct Description {
    object: Vec<usize>,
    cameras: Vec<CameraFiles>,
}

#[derive(Deserialize)]
struct CameraFiles {
    times_s: Vec<f64>,
    world: String,
    pixels: String,
    visible: String,
}

/// By camera, in the order of the file, which is the rig's.
pub fn read(truth: &Truth) -> Vec<CameraPoints> {
    let relative = truth.tracks.as_ref().expect("tracks in the truth");
    let path = truth.file(relative).expect("a file of tracks");
    let text = std::fs::read_to_string(&path).expect("readable tracks");
    let description: Description = serde_json::from_str(&text).expect("tracks");
    let folder = path.parent().expect("a folder");
    let points = description.object.len();
    let camera = |files: CameraFiles| {
        let frames = files.times_s.len();
        let world = array(&folder.join(files.world), 24 * frames * points);
        let pixels = array(&folder.join(files.pixels), 16 * frames * points);
        let visible = array(&folder.join(files.visible), frames * points);
        let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().expect("eight bytes"));
        let tracked = |k: usize| TrackedPoint {
            px: Point2::new(number(&pixels[16 * k..][..8]), number(&pixels[16 * k + 8..][..8])),
            visible: visible[k] != 0,
            world: Point3::from([0, 1, 2].map(|c| number(&world[24 * k + 8 * c..][..8]))),
        };
        let frame = |frame: usize| (frame * points..(frame + 1) * points).map(tracked).collect();
        CameraPoints { times_s: files.times_s, frames: (0..frames).map(frame).collect() }
    };
    description.cameras.into_iter().map(camera).collect()
}

/// The data of numpy's file of an array, which are its last bytes.
fn array(path: &Path, bytes: usize) -> Vec<u8> {
    let file = std::fs::read(path).expect("an array");
    file[file.len() - bytes..].to_vec()
}
