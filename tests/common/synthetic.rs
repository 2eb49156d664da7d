//! A capture in closed form: parallel cameras in a line before a textured plane that slides at a
//! constant velocity, mostly across the epipolar lines. Its image from anywhere, at any instant, is
//! a formula.

use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::path::Path;
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, write_image};

pub const WIDTH: usize = 160;
pub const HEIGHT: usize = 120;
pub const RATE_HZ: f64 = 30.0;
const FOCAL_PX: f64 = 170.0;
const DEPTH_M: f64 = 2.0;
/// 1.4 and 4.5 pixels a frame.
const VELOCITY_M_PER_S: [f64; 2] = [0.5, 1.6];
const SPACING_M: f64 = 0.06;
const WAVES: usize = 40;

/// Where camera `index` of `count` stands, metres to the right of the middle.
pub fn place_m(index: usize, count: usize) -> f64 {
    SPACING_M * (index as f64 - (count as f64 - 1.0) / 2.0)
}

/// The image of a camera at (x, y) metres at a time in seconds.
pub fn image(x_m: f64, y_m: f64, time_s: f64) -> Image {
    let waves = waves();
    let at =
        |pixel: usize, size: usize| (pixel as f64 + 0.5 - size as f64 / 2.0) * DEPTH_M / FOCAL_PX;
    // sin(a + b) = sin a · cos b + cos a · sin b: a of the column and the channel, b of the row.
    let columns: Vec<[[(f64, f64); WAVES]; 3]> = (0..WIDTH)
        .map(|column| {
            let u = x_m + at(column, WIDTH) - VELOCITY_M_PER_S[0] * time_s;
            [0, 1, 2].map(|channel| waves.map(|w| (w.along_u * u + w.phases[channel]).sin_cos()))
        })
        .collect();
    let mut data = Vec::with_capacity(3 * WIDTH * HEIGHT);
    for row in 0..HEIGHT {
        let v = y_m + at(row, HEIGHT) - VELOCITY_M_PER_S[1] * time_s;
        let row = waves.map(|w| (w.along_v * v).sin_cos());
        for column in columns.iter().flatten() {
            let terms = column.iter().zip(&row).map(|(a, b)| a.0 * b.1 + a.1 * b.0);
            data.push((0.5 + 0.045 * terms.sum::<f64>()).clamp(0.0, 1.0) as f32);
        }
    }
    Image::from_data(WIDTH, HEIGHT, 3, data)
}

/// A wave of the plane's texture: its wave numbers, radians a metre, and each channel's phase.
#[derive(Clone, Copy)]
struct Wave {
    along_u: f64,
    along_v: f64,
    phases: [f64; 3],
}

/// Waves 6 to 45 pixels long, in all directions.
fn waves() -> [Wave; WAVES] {
    let mut random = Random::new(1);
    std::array::from_fn(|_| {
        let angle = TAU * random.unit();
        let length_m = 0.07 * (0.53_f64 / 0.07).powf(random.unit());
        let phase = TAU * random.unit();
        let number = TAU / length_m;
        Wave {
            along_u: number * angle.cos(),
            along_v: number * angle.sin(),
            phases: [phase, phase + 0.7, phase - 0.5],
        }
    })
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
    super::describe(folder, &capture);
}

/// A capture in a temporary folder.
pub fn capture(delays_frames: &[f64], frames: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    write(folder.path(), delays_frames, frames);
    folder
}
