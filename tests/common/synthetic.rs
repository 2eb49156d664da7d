//! A capture in closed form: parallel cameras in a line before a textured plane that slides at a
//! constant velocity, mostly across the epipolar lines. Its image from anywhere, at any instant, is
//! a formula.

use serde_json::{Value, json};
use std::path::Path;
use stlfr::raster::Image;
use stlfr::raster::{BitDepth, write_image};

pub const WIDTH: usize = 160;
pub const HEIGHT: usize = 120;
pub const RATE_HZ: f64 = 30.0;
const FOCAL_PX: f64 = 170.0;
const DEPTH_M: f64 = 2.0;
/// 1.4 and 4.5 pixels a frame.
const VELOCITY_M_PER_S: [f64; 2] = [0.5, 1.6];
const SPACING_M: f64 = 0.06;

/// Where camera `index` of `count` stands, metres to the right of the middle.
pub fn place_m(index: usize, count: usize) -> f64 {
    SPACING_M * (index as f64 - (count as f64 - 1.0) / 2.0)
}

/// The image of a camera at (x, y) metres at a time in seconds.
pub fn image(x_m: f64, y_m: f64, time_s: f64) -> Image {
    let waves = waves();
    let mut data = Vec::with_capacity(3 * WIDTH * HEIGHT);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let u = x_m + (column as f64 + 0.5 - WIDTH as f64 / 2.0) * DEPTH_M / FOCAL_PX;
            let v = y_m + (row as f64 + 0.5 - HEIGHT as f64 / 2.0) * DEPTH_M / FOCAL_PX;
            let (u, v) = (u - VELOCITY_M_PER_S[0] * time_s, v - VELOCITY_M_PER_S[1] * time_s);
            for channel in 0..3 {
                let sum: f64 =
                    waves.iter().map(|w| (w[0] * u + w[1] * v + w[2 + channel]).sin()).sum();
                data.push((0.5 + 0.045 * sum).clamp(0.0, 1.0) as f32);
            }
        }
    }
    Image::from_data(WIDTH, HEIGHT, 3, data)
}

/// Forty waves, 6 to 45 pixels long, in all directions: wave number along u and v, and a phase for
/// each channel.
fn waves() -> Vec<[f64; 5]> {
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..40)
        .map(|_| {
            let (angle, share) = (std::f64::consts::TAU * uniform(), uniform());
            let length_m = 0.07 * (0.53_f64 / 0.07).powf(share);
            let number = std::f64::consts::TAU / length_m;
            let phase = std::f64::consts::TAU * uniform();
            [number * angle.cos(), number * angle.sin(), phase, phase + 0.7, phase - 0.5]
        })
        .collect()
}

/// A camera at (x, y) metres, as a view file has it.
pub fn view(x_m: f64, y_m: f64) -> Value {
    json!({"width": WIDTH, "height": HEIGHT, "model": "PINHOLE",
        "params": [FOCAL_PX, FOCAL_PX, WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0],
        "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [-x_m, -y_m, 0.0]}})
}

/// Writes a capture: one camera for each delay (frames after the scene's start, unknown to its
/// clock, which starts at 0), with that many frames.
pub fn write(folder: &Path, delays_frames: &[f64], frames: usize) {
    let mut cameras = Vec::new();
    for (index, delay_frames) in delays_frames.iter().enumerate() {
        let x_m = place_m(index, delays_frames.len());
        let mut camera = view(x_m, 0.0);
        camera["id"] = json!(format!("cam{index}"));
        camera["frames"] = json!(format!("cam{index}/%04d.png"));
        camera["clock"] = json!({"rate_hz": RATE_HZ, "first_s": 0.0, "shared": false});
        cameras.push(camera);
        for frame in 0..frames {
            let image = image(x_m, 0.0, (frame as f64 + delay_frames) / RATE_HZ);
            let path = folder.join(format!("cam{index}/{frame:04}.png"));
            write_image(&path, &image, None, BitDepth::Eight).expect("a frame can be written");
        }
    }
    let capture = json!({"format": "stlfr-capture", "version": 1, "name": "sliding-plane",
        "cameras": cameras});
    std::fs::write(folder.join("capture.json"), capture.to_string())
        .expect("capture.json can be written");
}

/// A capture in a temporary folder.
pub fn capture(delays_frames: &[f64], frames: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    write(folder.path(), delays_frames, frames);
    folder
}
