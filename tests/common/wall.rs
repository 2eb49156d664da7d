//! A textured wall before three cameras in a row, and if wanted a board before it, each moving at a
//! constant velocity: images of the very instant by a formula, in any units, place and clock.

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::capture::Capture;
use stlfr::light_field::LightField;
use stlfr::offset::{self, Offsets};
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::progress::Reporter;
use stlfr::raster::{BitDepth, Image, write_image};
use stlfr::registration::FrameStore;
use tempfile::TempDir;

/// A textured wall before three cameras.
#[derive(Clone)]
pub struct Scene {
    /// The wall's, units of its print a second: 1 is 2 px a frame.
    pub velocity: [f64; 2],
    /// That of a board at half the wall's depth, a quarter of the image.
    pub board: Option<[f64; 2]>,
    /// Of the wall, metres. Its print grows with it, and shrinks with the focal length, so that
    /// the middle camera's images are the same for all.
    pub depth_m: f64,
    pub focal_px: f64,
    /// Where the cameras stand, metres; they look along +z. 6 cm apart in a row by default.
    pub centers_m: [[f64; 3]; 3],
    /// True offsets, seconds at [`FRAME_S`].
    pub offsets_s: [f64; 3],
    pub shared: [bool; 3],
    pub frames: usize,
    /// Metres of the file a metre of the scene, how the file has it turned, and where its origin.
    pub scale: f64,
    pub turn: UnitQuaternion<f64>,
    pub origin_m: f64,
    /// Seconds of the file a second of the scene, and what all clocks show at the start.
    pub slowness: f64,
    pub start_s: f64,
    /// The order of the cameras in the file.
    pub order: [usize; 3],
    /// Quarter turns of every image, counterclockwise, its camera turned with it.
    pub quarter_turns: usize,
    /// Of rolling shutters, from the first row to the last, seconds at [`FRAME_S`]. Images with them aren't turned.
    pub readouts_s: [f64; 3],
}

pub const FRAME_S: f64 = 0.04;
pub const FOCAL_PX: f64 = 100.0;
pub const W: usize = 96;
pub const H: usize = 72;

impl Default for Scene {
    fn default() -> Self {
        Self {
            velocity: [0.3, 1.0],
            board: None,
            depth_m: 2.0,
            focal_px: FOCAL_PX,
            centers_m: [[-0.06, 0.0, 0.0], [0.0; 3], [0.06, 0.0, 0.0]],
            offsets_s: [0.3 * FRAME_S, 0.0, -0.4 * FRAME_S],
            shared: [false; 3],
            frames: 5,
            scale: 1.0,
            turn: UnitQuaternion::identity(),
            origin_m: 0.0,
            slowness: 1.0,
            start_s: 0.0,
            order: [0, 1, 2],
            quarter_turns: 0,
            readouts_s: [0.0; 3],
        }
    }
}

/// Waves in many directions, 6 to 20 px long: corners everywhere, and nothing twice.
pub fn texture(x: f64, y: f64) -> f64 {
    let wave = |k: f64| {
        let (direction, per_m) = (2.399 * k, 2.5 + 5.5 * (0.618 * k).fract());
        (TAU * per_m * (x * direction.cos() + y * direction.sin()) + 1.7 * k).sin()
    };
    (0.5 + 0.09 * (1..=9).map(|k| wave(f64::from(k))).sum::<f64>()).clamp(0.0, 1.0)
}

impl Scene {
    /// The image of a camera at a place at an instant of the scene, upright.
    pub fn image(&self, center_m: [f64; 3], time_s: f64) -> Image {
        self.image_by_row(center_m, |_| time_s)
    }

    /// The image of a camera at a place, each row at its own instant.
    fn image_by_row(&self, center_m: [f64; 3], time_s: impl Fn(usize) -> f64) -> Image {
        let units_per_m = 2.0 / self.depth_m * self.focal_px / FOCAL_PX;
        let data = (0..W * H).map(|k| {
            let time_s = time_s(k / W);
            let slope =
                |v: usize, size: usize| (v as f64 + 0.5 - size as f64 / 2.0) / self.focal_px;
            let (u, v) = (slope(k % W, W), slope(k / W, H));
            let print = |depth_m: f64, velocity: [f64; 2]| {
                let z = depth_m - center_m[2];
                [(u, 0), (v, 1)].map(|(slope, n)| {
                    units_per_m * (slope * z + center_m[n]) - velocity[n] * time_s
                })
            };
            if let Some([x, y]) = self.board.map(|velocity| print(0.5 * self.depth_m, velocity))
                && x.abs() < 0.24
                && y.abs() < 0.18
            {
                return texture(2.0 * x + 9.0, 2.0 * y - 5.0) as f32;
            }
            let [x, y] = print(self.depth_m, self.velocity);
            texture(x, y) as f32
        });
        Image::from_data(W, H, 1, data.collect())
    }

    /// A camera at a place, as a view file has it.
    pub fn camera(&self, center_m: [f64; 3]) -> Value {
        let center = self.turn * (Vector3::from(center_m) * self.scale);
        let center = center + Vector3::repeat(self.origin_m);
        let angle = -0.25 * TAU * self.quarter_turns as f64;
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let q = quarter * self.turn.inverse();
        let t = -(q * center);
        let (w, h) = if self.quarter_turns.is_multiple_of(2) { (W, H) } else { (H, W) };
        json!({"width": w, "height": h, "model": "PINHOLE",
            "params": [self.focal_px, self.focal_px, w as f64 / 2.0, h as f64 / 2.0],
            "cam_from_world": {"rotation_wxyz": [q.w, q.i, q.j, q.k],
                "translation": [t.x, t.y, t.z]}})
    }

    /// An instant of the scene, so many frames after its start, on the file's clock.
    pub fn time_s(&self, frames: f64) -> f64 {
        frames * FRAME_S * self.slowness
    }

    /// Writes the capture.
    pub fn film(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let rate_hz = 1.0 / (FRAME_S * self.slowness);
        let cameras: Vec<Value> = self
            .order
            .iter()
            .map(|&c| {
                let mut camera = self.camera(self.centers_m[c]);
                camera["id"] = json!(format!("cam{c}"));
                camera["frames"] = json!(format!("cam{c}/%d.png"));
                camera["color"] = json!("gray");
                camera["clock"] = json!({"rate_hz": rate_hz, "first_s": self.start_s,
                    "shared": self.shared[c]});
                if self.readouts_s[c] > 0.0 {
                    camera["clock"]["readout_s"] = json!(self.readouts_s[c] * self.slowness);
                }
                for k in 0..self.frames {
                    let time_s = k as f64 * FRAME_S + self.offsets_s[c];
                    let row_s = self.readouts_s[c] / (H - 1) as f64;
                    let at = |row: usize| time_s + (row as f64 - 0.5 * (H - 1) as f64) * row_s;
                    let image = self.image_by_row(self.centers_m[c], at);
                    let image = turned(&image, self.quarter_turns);
                    let path = folder.path().join(format!("cam{c}/{k}.png"));
                    write_image(&path, &image, None, BitDepth::Sixteen).unwrap();
                }
                camera
            })
            .collect();
        super::describe(
            folder.path(),
            &json!({"format": "stlfr-capture", "version": 1, "name": "wall", "reference": "cam1",
            "cameras": cameras}),
        );
        folder
    }
}

/// A grey image after quarter turns, counterclockwise.
pub fn turned(image: &Image, quarters: usize) -> Image {
    (0..quarters % 4).fold(image.clone(), |image, _| {
        let (w, h) = (image.width(), image.height());
        let data = (0..w * h).map(|k| image.pixel(w - 1 - k / h, k % h)[0]);
        Image::from_data(h, w, 1, data.collect())
    })
}

/// Opens a capture.
pub fn open(folder: &TempDir) -> Arc<Capture> {
    Arc::new(Capture::open(folder.path()).unwrap())
}

/// The light field of a capture, registered by the default options.
pub fn field_of(capture: &Arc<Capture>, offsets: Offsets) -> LightField {
    LightField::new(capture.clone(), offsets)
}

/// The default options of a view, but for the proxy.
pub fn by_proxy(method: ProxyMethod) -> RenderOptions {
    let mut options = RenderOptions::default();
    options.proxy.method = method;
    options
}

/// The same with a plane at a set depth as the proxy, metres.
pub fn by_plane(depth_m: f64) -> RenderOptions {
    let mut options = by_proxy(ProxyMethod::Plane);
    options.proxy.plane_depth_m = Some(depth_m);
    options
}

/// Offsets by the default options; every one is known with an error, or unknown with a reason.
pub fn estimate(capture: &Arc<Capture>) -> Offsets {
    estimate_by(capture, &RenderOptions::default())
}

/// The same with other options.
pub fn estimate_by(capture: &Arc<Capture>, options: &RenderOptions) -> Offsets {
    let silent = Reporter::silent();
    let frames = FrameStore::new(capture.clone(), &options.registration);
    let offsets = offset::estimate(&frames, &options.offset, &silent).unwrap().offsets;
    for camera in &offsets.cameras {
        let known = camera.offset_s.is_some();
        assert_eq!((camera.std_err_s.is_some(), camera.reason.is_none()), (known, known));
        assert!(camera.offset_s.is_none_or(f64::is_finite), "{camera:?}");
        assert!(camera.std_err_s.is_none_or(f64::is_finite), "{camera:?}");
    }
    offsets
}

/// The camera of a view.
pub fn view(camera: &Value) -> Camera {
    serde_json::from_value::<CameraFormat>(camera.clone()).unwrap().camera().unwrap()
}

/// Writes the truth of a view from the middle camera, with its depth and its motion, pixels a frame.
pub fn write_truth(root: &Path, scene: &Scene) {
    let image = scene.image(scene.centers_m[1], 0.05);
    write_image(&root.join("truth/0.png"), &image, None, BitDepth::Eight).unwrap();
    for (name, value) in [("0.npy", 2.0), ("depth.npy", scene.depth_m as f32)] {
        let values: Vec<u8> = (0..W * H).flat_map(|_| f32::to_le_bytes(value)).collect();
        std::fs::write(root.join("truth").join(name), [npy([H, W]), values].concat()).unwrap();
    }
    let offsets: Vec<Value> =
        (0..3).map(|c| json!({"id": format!("cam{c}"), "offset_s": 0.0})).collect();
    let truth = json!({"format": "stlfr-truth", "version": 1, "scene": "wall", "rig": "row",
        "offsets": offsets, "shutter": [], "views": [{"id": "a", "time_s": 0.05, "like": "cam1",
            "camera": scene.camera(scene.centers_m[1]), "image": "0.png", "depth": "depth.npy",
            "motion": "0.npy"}]});
    std::fs::write(root.join("truth/truth.json"), truth.to_string()).unwrap();
}

/// The head of an array of float32.
pub fn npy([height, width]: [usize; 2]) -> Vec<u8> {
    let header =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes
}
