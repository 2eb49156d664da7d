//! OpenCV as the peer: `live_peer.py` is given the cameras, their images, and the depths of each view, or
//! a capture's frames.

use super::Error;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::Command;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::light_field::{Geometry, GivenImages};
use stlfr::raster::{BitDepth, write_image};
use tempfile::TempDir;

/// The median time of a view, milliseconds; `None` without the environment.
pub fn remap_ms(
    images: &GivenImages,
    geometry: &dyn Fn(&Camera) -> Result<Geometry, Error>,
    capture: &Capture,
    views: &[Camera],
    blended: usize,
) -> Result<Option<f64>, Error> {
    if python().is_none() {
        return Ok(None);
    }
    let scratch = tempfile::tempdir()?;
    let file = |name: String| scratch.path().join(name);
    let mut cameras = Vec::new();
    for (n, (filmed, image)) in capture.cameras.iter().zip(images.all()).enumerate() {
        let Some(image) = image else { continue };
        let path = file(format!("{n}.png"));
        write_image(&path, &image.image, None, BitDepth::Eight)?;
        cameras.push(json!({"camera": of(&filmed.camera), "image": path}));
    }
    let mut places = Vec::new();
    for (n, view) in views.iter().enumerate() {
        let path = file(format!("{n}.f32"));
        let depths = geometry(view)?.view;
        let bytes: Vec<u8> = depths.data().iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(&path, bytes)?;
        places.push(json!({"camera": of(view), "depths": path}));
    }
    let body = json!({"cameras": cameras, "views": places, "blended": blended});
    asked(&scratch, &body).map(Some)
}

/// The seconds of DIS in both directions for all frame pairs, without decoding; `None` without the environment.
pub fn dis_s(capture: &Capture) -> Result<Option<f64>, Error> {
    if python().is_none() {
        return Ok(None);
    }
    let frames: Vec<_> = capture.cameras.iter().map(|c| &c.frames).collect();
    asked(&tempfile::tempdir()?, &json!({"frames": frames})).map(Some)
}

fn python() -> Option<PathBuf> {
    let python = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
    python.exists().then_some(python)
}

/// What the script prints for a request.
fn asked(scratch: &TempDir, body: &serde_json::Value) -> Result<f64, Error> {
    let request = scratch.path().join("request.json");
    std::fs::write(&request, serde_json::to_vec(body)?)?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bench/live_peer.py");
    let python = python().ok_or("the project's Python environment is missing")?;
    let output = Command::new(python).arg("-I").arg(script).arg(&request).output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
    }
    Ok(String::from_utf8(output.stdout)?.trim().parse()?)
}

/// Size, pinhole intrinsics, and the rows of `[R | t]`, camera from world.
fn of(camera: &Camera) -> serde_json::Value {
    let (fx, fy, cx, cy) = camera.model.intrinsics();
    let matrix = camera.cam_from_world.to_homogeneous();
    let rows: Vec<Vec<f64>> = (0..3).map(|r| (0..4).map(|c| matrix[(r, c)]).collect()).collect();
    json!({"size": [camera.width, camera.height], "intrinsics": [fx, fy, cx, cy], "rows": rows})
}
