//! A capture of four cameras with truth at one instant: a board that moves before a wall.

use crate::common::bodies::{Recording, World, board_before_wall, pose};
use crate::common::worlds::line_rig;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::OnceLock;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::raster::{BitDepth, write_image};
use tempfile::TempDir;

/// The instant of the truth, seconds.
pub const TRUE_S: f64 = 2.4 / 30.0;

fn world() -> World {
    board_before_wall(|frames| pose([0.0; 3], [0.02 * frames, 0.0, 1.3]))
}

fn camera_between() -> Camera {
    let mut camera = line_rig(4, 160).remove(1);
    camera.cam_from_world.translation.x -= 0.03;
    camera
}

fn write(folder: &Path) {
    let (world, cameras) = (world(), line_rig(4, 160));
    let first_frames = &[0.0, 0.25, 0.5, 0.75];
    Recording { world: &world, cameras: &cameras, first_frames, frames: 5, noise: 0.004 }
        .write(folder);
    let views = [("t0-cam1", cameras[1].clone()), ("t0-between", camera_between())];
    let described: Vec<Value> = views
        .iter()
        .map(|(id, camera)| {
            let image = world.film(camera, 30.0 * TRUE_S, 0.0, 9);
            let path = folder.join(format!("truth/{id}.png"));
            write_image(&path, &image, None, BitDepth::Eight).expect("the truth can be written");
            json!({"id": id, "time_s": TRUE_S, "like": null, "camera": CameraFormat::from(camera),
                "image": format!("{id}.png"), "depth": "none.npy", "motion": "none.npy"})
        })
        .collect();
    let truth = json!({"format": "stlfr-truth", "version": 1, "scene": "board", "rig": "line",
        "offsets": [], "shutter": [], "views": described});
    std::fs::write(folder.join("truth/truth.json"), truth.to_string())
        .expect("the truth can be written");
}

/// The capture, made once for all tests of this program.
pub fn capture() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let made = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        write(folder.path());
        folder
    });
    made.path()
}

/// A copy, to be deleted while it is served.
pub fn copy() -> TempDir {
    let copy = tempfile::tempdir().expect("a temporary folder");
    crate::common::copy_folder(capture(), copy.path());
    copy
}
