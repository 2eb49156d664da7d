//! A printed wall that goes around an ellipse before a grid of cameras: of any size, number of
//! cameras and length. Its motion repeats itself after a period, so that a recording of thousands of
//! frames has no more images than that, linked again and again, and every image is a formula.

use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::path::Path;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::raster::{BitDepth, Image, write_image};

/// The wall, its motion, and the rig that films it.
#[derive(Clone, Debug)]
pub struct Swing {
    pub width: usize,
    pub height: usize,
    /// 1, or 3: red, and green and blue that follow it fainter.
    pub channels: usize,
    pub cameras: usize,
    /// Cameras in a row of the grid.
    pub columns: usize,
    pub frames: usize,
    /// Frames after which all repeats itself.
    pub period: usize,
    /// How large the print is, its motion with it; 1: waves of 6 to 20 px, 2 px a frame.
    pub print: f64,
    /// Pixels that the wall moves from one camera's image to the next one's.
    pub disparity_px: f64,
    /// Whether the clocks are known and agree.
    pub synchronized: bool,
}

pub const RATE_HZ: f64 = 25.0;
/// Between neighbours, metres.
const SPACING_M: f64 = 0.06;
const WAVES: usize = 9;

impl Default for Swing {
    fn default() -> Self {
        Self {
            width: 96,
            height: 72,
            channels: 1,
            cameras: 3,
            columns: 3,
            frames: 5,
            period: 30,
            print: 1.0,
            disparity_px: 4.0,
            synchronized: false,
        }
    }
}

impl Swing {
    pub fn reference(&self) -> usize {
        (self.cameras - 1) / 2
    }

    /// Frames that a camera opens after the reference.
    pub fn delay_frames(&self, camera: usize) -> f64 {
        let golden = |c: usize| (0.618_034 * c as f64).fract();
        if self.synchronized || camera == self.reference() {
            0.0
        } else {
            0.8 * (golden(camera) - 0.5)
        }
    }

    /// Where a camera stands, in cameras from the reference.
    pub fn place(&self, camera: usize) -> [f64; 2] {
        let at = |c: usize| [(c % self.columns) as f64, (c / self.columns) as f64];
        let (own, reference) = (at(camera), at(self.reference()));
        [own[0] - reference[0], own[1] - reference[1]]
    }

    /// The wall's way at a time in frames, pixels.
    fn moved_px(&self, frames: f64) -> [f64; 2] {
        let angle = TAU * frames / self.period as f64;
        let radius = self.print * 2.0 * self.period as f64 / TAU;
        [0.9 * radius * angle.cos(), radius * angle.sin()]
    }

    /// The image of a camera at a place, in cameras from the reference, at a time in frames.
    pub fn image(&self, place: [f64; 2], frames: f64) -> Image {
        let moved = self.moved_px(frames);
        let origin = [0, 1].map(|n| place[n] * self.disparity_px - moved[n]);
        let (w, h) = (self.width, self.height);
        // sin(a + b) = sin a · cos b + cos a · sin b: a of the column, b of the row.
        let table = |size: usize, axis: usize| -> Vec<[[f32; 2]; WAVES]> {
            let at = |v: usize| (v as f64 + 0.5 - 0.5 * size as f64 + origin[axis]) / self.print;
            (0..size).map(|v| std::array::from_fn(|k| wave(k, axis, at(v)))).collect()
        };
        let (columns, rows) = (table(w, 0), table(h, 1));
        let mut data = Vec::with_capacity(w * h * self.channels);
        for row in &rows {
            for column in &columns {
                let terms = column.iter().zip(row).map(|(a, b)| a[0] * b[1] + a[1] * b[0]);
                let value = (0.5 + 0.09 * terms.sum::<f32>()).clamp(0.0, 1.0);
                let tints = [value, 0.1 + 0.8 * value, 0.3 + 0.4 * value];
                data.extend(&tints[..self.channels]);
            }
        }
        Image::from_data(w, h, self.channels, data)
    }

    /// What a camera has at a time in frames of the reference's.
    pub fn truth(&self, camera: usize, frames: f64) -> Image {
        self.image(self.place(camera), frames)
    }

    /// A camera at such a place, as a view file has it.
    pub fn view(&self, place: [f64; 2]) -> Value {
        let focal = self.focal_px();
        json!({"width": self.width, "height": self.height, "model": "PINHOLE",
            "params": [focal, focal, 0.5 * self.width as f64, 0.5 * self.height as f64],
            "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0],
                "translation": [-SPACING_M * place[0], -SPACING_M * place[1], 0.0]}})
    }

    /// The same for the stages.
    pub fn camera(&self, place: [f64; 2]) -> Camera {
        let format: CameraFormat = serde_json::from_value(self.view(place)).expect("a view");
        format.camera().expect("a camera")
    }

    fn focal_px(&self) -> f64 {
        self.width.max(self.height) as f64
    }

    /// Of the wall, metres.
    pub fn depth_m(&self) -> f64 {
        self.focal_px() * SPACING_M / self.disparity_px
    }

    /// Writes the capture.
    pub fn film(&self, folder: &Path) {
        let mut cameras = Vec::new();
        for c in 0..self.cameras {
            let mut camera = self.view(self.place(c));
            camera["id"] = json!(format!("cam{c}"));
            camera["frames"] = json!(format!("cam{c}/%d.png"));
            camera["color"] = json!(if self.channels == 1 { "gray" } else { "rgb" });
            camera["clock"] =
                json!({"rate_hz": RATE_HZ, "first_s": 0.0, "shared": self.synchronized});
            cameras.push(camera);
            let file = |k: usize| folder.join(format!("cam{c}/{k}.png"));
            for k in 0..self.frames {
                if let Some(before) = k.checked_sub(self.period) {
                    std::fs::hard_link(file(before), file(k)).expect("an image can be linked");
                } else {
                    let image = self.truth(c, k as f64 + self.delay_frames(c));
                    write_image(&file(k), &image, None, BitDepth::Eight).expect("an image");
                }
            }
        }
        let capture = json!({"format": "stlfr-capture", "version": 1, "name": "swing",
            "reference": format!("cam{}", self.reference()), "cameras": cameras});
        std::fs::write(folder.join("capture.json"), capture.to_string()).expect("a capture");
    }
}

/// sin and cos of a wave's phase at a position along an axis; the phase's constant is in the first
/// axis alone.
fn wave(k: usize, axis: usize, at: f64) -> [f32; 2] {
    let k = k as f64 + 1.0;
    let direction = 2.399 * k;
    let per_px = TAU * (0.05 + 0.11 * (0.618 * k).fract());
    let (along, start) =
        if axis == 0 { (direction.cos(), 1.7 * k) } else { (direction.sin(), 0.0) };
    let phase = per_px * along * at + start;
    [phase.sin() as f32, phase.cos() as f32]
}
