//! Films in closed form: textured rectangles that move before a textured wall, seen by a row of
//! cameras at any instant. As the paper's synthetic sequences, with the truth exactly known.

use nalgebra::{Point3, Rotation3, Vector3};
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;
use stlfr::random::Random;
use stlfr::raster::Image;
use stlfr::raster::{BitDepth, write_image};

/// A textured rectangle in motion. Metres, seconds.
#[derive(Clone, Debug)]
pub struct Board {
    pub center: Point3<f64>,
    pub velocity: Vector3<f64>,
    /// A swing about the straight motion: amplitude, cycles a second, and the phase.
    pub swing: Vector3<f64>,
    pub swing_hz: f64,
    pub phase: f64,
    /// Turn about the viewing direction at the start, radians, and its rate; and about the vertical.
    pub roll: [f64; 2],
    pub yaw: [f64; 2],
    pub half_size: [f64; 2],
    /// Where on the texture it lies.
    pub texture: [f64; 2],
}

impl Board {
    fn origin(&self, t: f64) -> Point3<f64> {
        let swing = (std::f64::consts::TAU * self.swing_hz * t + self.phase).sin();
        self.center + self.velocity * t + self.swing * swing
    }

    fn turn(&self, t: f64) -> Rotation3<f64> {
        Rotation3::from_axis_angle(&Vector3::y_axis(), self.yaw[0] + self.yaw[1] * t)
            * Rotation3::from_axis_angle(&Vector3::z_axis(), self.roll[0] + self.roll[1] * t)
    }

    pub fn still(center: Point3<f64>, half_size: [f64; 2], texture: [f64; 2]) -> Self {
        Self {
            center,
            velocity: Vector3::zeros(),
            swing: Vector3::zeros(),
            swing_hz: 1.0,
            phase: 0.0,
            roll: [0.0; 2],
            yaw: [0.0; 2],
            half_size,
            texture,
        }
    }
}

/// What stands before the cameras, and how they film it.
#[derive(Clone, Debug)]
pub struct Film {
    pub boards: Vec<Board>,
    pub size: [usize; 2],
    pub frames: usize,
    /// When each camera opens, seconds.
    pub delays_s: Vec<f64>,
    pub rate_hz: f64,
    /// Each camera's clock's rate, parts in a million: it shows fewer seconds by so much.
    pub drift_ppm: Vec<f64>,
    /// Frames that each camera loses, by their number had none been lost.
    pub lost: Vec<Vec<usize>>,
    /// Whether the capture says that frames may be lost, even if none is.
    pub may_lose: bool,
    /// Standard deviation of every frame's time about its due one, seconds, and whether the clock
    /// says so.
    pub jitter_s: f64,
    pub stamped: bool,
    /// Standard deviation of a pixel, of full scale.
    pub noise: f64,
    pub exposure_s: f64,
    pub bits: BitDepth,
    /// Further cameras in a second row, this far below; 0: none.
    pub second_row_m: f64,
    pub seed: u64,
}

pub const SPACING_M: f64 = 0.06;

impl Film {
    pub fn new(boards: Vec<Board>, delays_frames: &[f64], frames: usize) -> Self {
        Self {
            boards,
            size: [320, 240],
            frames,
            delays_s: delays_frames.iter().map(|d| d / 30.0).collect(),
            rate_hz: 30.0,
            drift_ppm: vec![0.0; delays_frames.len()],
            lost: vec![Vec::new(); delays_frames.len()],
            may_lose: false,
            jitter_s: 0.0,
            stamped: true,
            noise: 0.002,
            exposure_s: 0.0,
            bits: BitDepth::Eight,
            second_row_m: 0.0,
            seed: 1,
        }
    }

    fn place(&self, camera: usize) -> [f64; 2] {
        let n = self.delays_s.len();
        let (columns, row) =
            if self.second_row_m > 0.0 { (n.div_ceil(2), camera / n.div_ceil(2)) } else { (n, 0) };
        let column = (camera % columns) as f64 - (columns as f64 - 1.0) / 2.0;
        [SPACING_M * column, self.second_row_m * row as f64]
    }

    /// Writes the capture; the true offsets against the reference, the middle camera.
    pub fn write(&self, folder: &Path) -> std::io::Result<Vec<f64>> {
        let texture = Texture::new();
        let mut random = Random::new(self.seed);
        let mut cameras = Vec::new();
        let mut shots = Vec::new();
        let mut means = Vec::new();
        for (c, delay_s) in self.delays_s.iter().enumerate() {
            let [x, y] = self.place(c);
            let due = |n: usize| n as f64 / self.rate_hz;
            let slow = 1.0 + 1e-6 * self.drift_ppm[c];
            let kept: Vec<usize> =
                (0..).filter(|n| !self.lost[c].contains(n)).take(self.frames).collect();
            let errors: Vec<f64> = kept.iter().map(|_| self.jitter_s * random.gaussian()).collect();
            for (image, (n, error)) in kept.iter().zip(&errors).enumerate() {
                shots.push((
                    c,
                    image,
                    [x, y],
                    delay_s + due(*n) * slow + error * slow,
                    random.unit(),
                ));
            }
            let hidden =
                if self.stamped { 0.0 } else { errors.iter().sum::<f64>() / self.frames as f64 };
            means.push(delay_s + hidden);
            let drift = self.drift_ppm.iter().any(|d| *d != 0.0);
            let lost = self.may_lose || self.lost.iter().any(|l| !l.is_empty());
            let clock = if self.stamped && self.jitter_s > 0.0 {
                let times: Vec<f64> = errors.iter().enumerate().map(|(k, e)| due(k) + e).collect();
                json!({"times_s": times, "shared": false})
            } else {
                json!({"rate_hz": self.rate_hz, "first_s": 0.0, "shared": false, "drift": drift, "lost": lost})
            };
            let [w, h] = self.size;
            let focal = self.focal_px();
            cameras.push(json!({"id": format!("cam{c}"), "frames": format!("cam{c}/%04d.png"),
                "width": w, "height": h, "model": "PINHOLE",
                "params": [focal, focal, w as f64 / 2.0, h as f64 / 2.0],
                "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [-x, -y, 0.0]},
                "color": "gray", "clock": clock}));
            std::fs::create_dir_all(folder.join(format!("cam{c}")))?;
        }
        shots.par_iter().try_for_each(|&(c, image, place, time_s, seed)| {
            let picture = self.image(&texture, place, time_s, (seed * 1e15) as u64);
            let path = folder.join(format!("cam{c}/{image:04}.png"));
            write_image(&path, &picture, None, self.bits).map_err(std::io::Error::other)
        })?;
        let capture =
            json!({"format": "stlfr-capture", "version": 1, "name": "boards", "cameras": cameras});
        std::fs::write(folder.join("capture.json"), capture.to_string())?;
        let reference = means[(means.len() - 1) / 2];
        Ok(means.iter().map(|m| m - reference).collect())
    }

    fn focal_px(&self) -> f64 {
        1.07 * self.size[0] as f64
    }

    fn image(&self, texture: &Texture, place: [f64; 2], time_s: f64, seed: u64) -> Image {
        let instants = if self.exposure_s > 0.0 { 8 } else { 1 };
        let [w, h] = self.size;
        let mut sum = vec![0.0_f64; w * h];
        for n in 0..instants {
            let share = (n as f64 + 0.5) / f64::from(instants) - 0.5;
            self.expose(texture, place, time_s + share * self.exposure_s, &mut sum);
        }
        let mut random = Random::new(seed);
        let scale = 1.0 / f64::from(instants);
        let noisy =
            |v: f64, random: &mut Random| (scale * v + self.noise * random.gaussian()) as f32;
        let data = sum.into_iter().map(|v| noisy(v, &mut random).clamp(0.0, 1.0)).collect();
        Image::from_data(w, h, 1, data)
    }

    fn expose(&self, texture: &Texture, [x, y]: [f64; 2], t: f64, sum: &mut [f64]) {
        let [w, h] = self.size;
        let focal = self.focal_px();
        let eye = Point3::new(x, y, 0.0);
        let boards: Vec<_> = self
            .boards
            .iter()
            .map(|b| {
                let back = b.turn(t).inverse();
                (b, back, back * (eye - b.origin(t)))
            })
            .collect();
        for (k, out) in sum.iter_mut().enumerate() {
            // Four rays a pixel: edges must not alias.
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let ray = Vector3::new(
                    ((k % w) as f64 + dx - w as f64 / 2.0) / focal,
                    ((k / w) as f64 + dy - h as f64 / 2.0) / focal,
                    1.0,
                );
                let mut nearest = (f64::INFINITY, 0.5);
                for (board, back, from) in &boards {
                    let ray = back * ray;
                    let distance = -from.z / ray.z;
                    let (u, v) = (from.x + distance * ray.x, from.y + distance * ray.y);
                    let inside = u.abs() < board.half_size[0] && v.abs() < board.half_size[1];
                    if inside && distance > 0.0 && distance < nearest.0 {
                        nearest =
                            (distance, texture.at(u + board.texture[0], v + board.texture[1]));
                    }
                }
                *out += 0.25 * nearest.1;
            }
        }
    }
}

/// Smooth noise of several scales, tiled.
struct Texture(Vec<f32>);

const TEXELS: usize = 1024;
const TEXELS_PER_M: f64 = 512.0;

impl Texture {
    fn new() -> Self {
        let mut random = Random::new(99);
        let mut data = vec![0.5_f32; TEXELS * TEXELS];
        for (cell, strength) in [(64, 0.10), (32, 0.12), (16, 0.14), (8, 0.14)] {
            let n = TEXELS / cell;
            let lattice: Vec<f64> = (0..n * n).map(|_| random.signed()).collect();
            for (k, value) in data.iter_mut().enumerate() {
                let at = |v: usize| {
                    let (whole, part) = (v / cell, (v % cell) as f64 / cell as f64);
                    (whole, part * part * part * (part * (6.0 * part - 15.0) + 10.0))
                };
                let ((x, fx), (y, fy)) = (at(k % TEXELS), at(k / TEXELS));
                let corner = |dx: usize, dy: usize| lattice[((y + dy) % n) * n + (x + dx) % n];
                let top = corner(0, 0) + fx * (corner(1, 0) - corner(0, 0));
                let bottom = corner(0, 1) + fx * (corner(1, 1) - corner(0, 1));
                *value += (strength * (top + fy * (bottom - top))) as f32;
            }
        }
        Self(data)
    }

    fn at(&self, u: f64, v: f64) -> f64 {
        let (x, y) = (u * TEXELS_PER_M, v * TEXELS_PER_M);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let wrap = |v: f64| (v as i64).rem_euclid(TEXELS as i64) as usize;
        let texel = |dx: f64, dy: f64| {
            f64::from(self.0[wrap(y.floor() + dy) * TEXELS + wrap(x.floor() + dx)])
        };
        let top = texel(0.0, 0.0) + fx * (texel(1.0, 0.0) - texel(0.0, 0.0));
        let bottom = texel(0.0, 1.0) + fx * (texel(1.0, 1.0) - texel(0.0, 1.0));
        top + fy * (bottom - top)
    }
}

fn wall() -> Board {
    Board::still(Point3::new(0.0, 0.0, 2.6), [3.0, 2.5], [10.0, 10.0])
}

/// Three boards of random size, place and motion, 4 to 20 pixels a frame at 640×480.
pub fn random_boards(seed: u64) -> Vec<Board> {
    let random = &mut Random::new(seed);
    let mut boards = vec![wall()];
    for n in 0..3 {
        let center = Point3::new(
            0.35 * (f64::from(n) - 1.0) + 0.1 * random.signed(),
            0.2 * random.signed(),
            1.5 + 0.5 * random.unit(),
        );
        let mut board =
            Board::still(center, [0.12 + 0.1 * random.unit(), 0.15], [f64::from(n), 0.3]);
        board.velocity =
            Vector3::new(0.5 * random.signed(), 0.6 * random.signed(), 0.3 * random.signed());
        board.swing = Vector3::new(0.05, 0.06, 0.02) * random.signed();
        board.swing_hz = 0.5 + 1.5 * random.unit();
        board.phase = 6.0 * random.unit();
        board.roll = [random.signed(), 1.5 * random.signed()];
        board.yaw = [0.3 * random.signed(), 0.8 * random.signed()];
        boards.push(board);
    }
    boards
}

/// The paper's synthetic pair: a textured rectangle before a textured wall.
pub fn rectangle(velocity: [f64; 2]) -> Vec<Board> {
    let mut board = Board::still(Point3::new(-0.1, -0.15, 1.8), [0.25, 0.2], [0.0, 0.3]);
    board.velocity = Vector3::new(velocity[0], velocity[1], 0.0);
    vec![wall(), board]
}

/// A magazine that is waved in a circle, so that at two instants of each turn it moves along the
/// epipolar lines; and turned.
pub fn rotating_magazine() -> Vec<Board> {
    let turn = |swing: Vector3<f64>, phase: f64| {
        let mut board = Board::still(Point3::new(0.0, 0.0, 1.7), [0.22, 0.28], [0.0, 0.3]);
        (board.swing, board.swing_hz, board.phase) = (swing, 1.1, phase);
        board
    };
    vec![wall(), turn(Vector3::new(0.03, 0.09, 0.0), 0.4)]
}

/// A board that moves for as long as a film may take, never the same way twice: a swing of two
/// incommensurable periods made by a board before another one.
pub fn restless(seed: u64) -> Vec<Board> {
    let random = &mut Random::new(seed);
    let mut boards = vec![wall()];
    for (x, hz) in [(-0.45, 0.71), (0.05, 1.13), (0.5, 1.57)] {
        let mut board = Board::still(Point3::new(x, 0.0, 1.8), [0.22, 0.28], [x, 0.3]);
        board.swing = Vector3::new(0.08 * random.signed(), 0.16, 0.0);
        board.swing_hz = hz;
        board.phase = 6.0 * random.unit();
        boards.push(board);
    }
    boards
}

/// A small board that slides along a row of cameras, fast, and turns: what moves across the epipolar
/// lines is a few windows' worth of pixels, most of them with an outline in it.
pub fn small_turning_board(seed: u64) -> Vec<Board> {
    let random = &mut Random::new(seed);
    let mut turns =
        Board::still(Point3::new(-0.3, -0.1, 1.6), [0.11; 2], [random.unit(), random.unit()]);
    turns.velocity.x = 0.8 + 0.6 * random.unit();
    turns.roll = [random.signed(), 2.5 + 1.5 * random.unit()];
    vec![wall(), turns]
}
