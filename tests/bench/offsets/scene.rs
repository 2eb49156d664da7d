//! Synthetic captures with exact ground truth: textured rectangles that move in front of a textured
//! wall, ray cast for a row or grid of cameras at any instant, as in the paper's synthetic sequences.

use nalgebra::{Point3, Rotation3, Vector3};
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;
use stlfr::capture::RowTimes;
use stlfr::random::Random;
use stlfr::raster::Image;
use stlfr::raster::{BitDepth, write_image};
use stlfr::rig::{FieldError, Loss, LossStamps, RigCamera, RigOptions};

/// A textured rectangle in motion; metres, seconds and radians.
#[derive(Clone, Debug)]
pub struct Board {
    pub center: Point3<f64>,
    pub velocity: Vector3<f64>,
    /// The amplitude of an oscillation about the straight motion.
    pub swing: Vector3<f64>,
    /// The frequency of the oscillation, hertz.
    pub swing_hz: f64,
    /// The phase of the oscillation at time 0.
    pub phase: f64,
    /// The rotation about the viewing direction at time 0, and its rate per second.
    pub roll: [f64; 2],
    /// The rotation about the vertical at time 0, and its rate per second.
    pub yaw: [f64; 2],
    pub half_size: [f64; 2],
    /// The position of its centre on the texture.
    pub texture: [f64; 2],
}

impl Board {
    fn center_at(&self, t: f64) -> Point3<f64> {
        let swing = (std::f64::consts::TAU * self.swing_hz * t + self.phase).sin();
        self.center + self.velocity * t + self.swing * swing
    }

    fn rotation_at(&self, t: f64) -> Rotation3<f64> {
        Rotation3::from_axis_angle(&Vector3::y_axis(), self.yaw[0] + self.yaw[1] * t)
            * Rotation3::from_axis_angle(&Vector3::z_axis(), self.roll[0] + self.roll[1] * t)
    }

    pub fn at_rest(center: Point3<f64>, half_size: [f64; 2], texture: [f64; 2]) -> Self {
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

/// A scene with the cameras that record it, all of which look along z from the plane z = 0.
#[derive(Clone, Debug)]
pub struct SyntheticCapture {
    pub boards: Vec<Board>,
    /// Image width and height, pixels.
    pub size: [usize; 2],
    /// The number of images of each camera.
    pub frames: usize,
    /// By camera: the time of its first frame, seconds.
    pub delays_s: Vec<f64>,
    pub rate_hz: f64,
    /// By camera: how much slower its clock runs, parts per million.
    pub drift_ppm: Vec<f64>,
    /// By camera: the frames that it loses, by their number if none were lost.
    pub lost: Vec<Vec<usize>>,
    /// Whether the capture declares that frames may be lost, even if none is.
    pub may_lose: bool,
    /// Whether it declares so for the reference, the middle camera, too.
    pub reference_loses: bool,
    /// The standard deviation of every frame's time about its regular one, seconds.
    pub jitter_s: f64,
    /// Whether the capture's time stamps contain the jitter.
    pub stamped: bool,
    /// The standard deviation of the pixels' noise, of full scale.
    pub noise: f64,
    pub exposure_s: f64,
    /// By camera: the readout of its rolling shutter, seconds; 0 for a global shutter.
    pub readouts_s: Vec<f64>,
    pub bits: BitDepth,
    /// The distance of a second row of cameras below the first, metres; 0: one row.
    pub second_row_m: f64,
    pub seed: u64,
}

pub const SPACING_M: f64 = 0.06;

impl SyntheticCapture {
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
            reference_loses: true,
            jitter_s: 0.0,
            stamped: true,
            noise: 0.002,
            exposure_s: 0.0,
            readouts_s: vec![0.0; delays_frames.len()],
            bits: BitDepth::Eight,
            second_row_m: 0.0,
            seed: 1,
        }
    }

    /// A recording by the rig of eight cameras that `stlfr rig line --lost COUNT --lost-within WITHIN
    /// --lost-stamps hidden --jitter 0 --seed SEED` writes; `lost` holds both numbers. With 2 and 9, seed
    /// 6 gives the delays and losses of `rigs/lost-frames.json`.
    pub fn losing_together(
        boards: Vec<Board>,
        frames: usize,
        [count, within]: [usize; 2],
        seed: u64,
    ) -> Result<Self, FieldError> {
        let rig = RigOptions {
            jitters_s: vec![0.0],
            loss: (count > 0).then_some(Loss { count, within, stamps: LossStamps::Hidden }),
            seed,
            ..RigOptions::default()
        }
        .generate()?;
        let delays: Vec<f64> = rig.cameras.iter().map(|c| c.delay_s * 30.0).collect();
        let lost = |c: &RigCamera| c.lost_frames.iter().map(|n| *n as usize).collect();
        Ok(Self {
            size: [160, 120],
            lost: rig.cameras.iter().map(lost).collect(),
            may_lose: true,
            reference_loses: false,
            seed,
            ..Self::new(boards, &delays, frames)
        })
    }

    fn center_m(&self, camera: usize) -> [f64; 2] {
        let n = self.delays_s.len();
        let (columns, row) =
            if self.second_row_m > 0.0 { (n.div_ceil(2), camera / n.div_ceil(2)) } else { (n, 0) };
        let column = (camera % columns) as f64 - (columns as f64 - 1.0) / 2.0;
        [SPACING_M * column, self.second_row_m * row as f64]
    }

    /// Writes the capture into a folder; returns the true offsets relative to the reference, the middle
    /// camera, seconds.
    pub fn write(&self, folder: &Path) -> std::io::Result<Vec<f64>> {
        let texture = Texture::new();
        let mut random = Random::new(self.seed);
        let mut cameras = Vec::new();
        let mut shots = Vec::new();
        let mut means = Vec::new();
        for (c, delay_s) in self.delays_s.iter().enumerate() {
            let [x, y] = self.center_m(c);
            let regular_s = |n: usize| n as f64 / self.rate_hz;
            let slow = 1.0 + 1e-6 * self.drift_ppm[c];
            let recorded: Vec<usize> =
                (0..).filter(|n| !self.lost[c].contains(n)).take(self.frames).collect();
            let errors: Vec<f64> =
                recorded.iter().map(|_| self.jitter_s * random.gaussian()).collect();
            for (image, (n, error)) in recorded.iter().zip(&errors).enumerate() {
                shots.push((
                    c,
                    image,
                    [x, y],
                    delay_s + regular_s(*n) * slow + error * slow,
                    random.unit(),
                ));
            }
            let hidden =
                if self.stamped { 0.0 } else { errors.iter().sum::<f64>() / self.frames as f64 };
            means.push(delay_s + hidden);
            let drift = self.drift_ppm.iter().any(|d| *d != 0.0);
            let is_reference = c == (self.delays_s.len() - 1) / 2;
            let lost = (self.may_lose || self.lost.iter().any(|l| !l.is_empty()))
                && (self.reference_loses || !is_reference);
            let mut clock = if self.stamped && self.jitter_s > 0.0 {
                let times: Vec<f64> =
                    errors.iter().enumerate().map(|(k, e)| regular_s(k) + e).collect();
                json!({"times_s": times, "shared": false})
            } else {
                json!({"rate_hz": self.rate_hz, "first_s": 0.0, "shared": false, "drift": drift, "lost": lost})
            };
            if self.readouts_s[c] > 0.0 {
                clock["readout_s"] = self.readouts_s[c].into();
            }
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
            let rows = RowTimes::new(self.readouts_s[c], self.size[1]);
            let picture = self.image(&texture, place, (time_s, rows), (seed * 1e15) as u64);
            let path = folder.join(format!("cam{c}/{image:04}.png"));
            write_image(&path, &picture, None, self.bits).map_err(std::io::Error::other)
        })?;
        let capture =
            json!({"format": "stlfr-capture", "version": 1, "name": "boards", "cameras": cameras});
        std::fs::write(folder.join("capture.json"), capture.to_string())?;
        let reference = means[(means.len() - 1) / 2];
        Ok(means.iter().map(|m| m - reference).collect())
    }

    /// The image of a camera at a place of the plane z = 0, metres, at an instant, seconds: without noise, exposure and
    /// readout.
    pub fn true_view(&self, place: [f64; 2], time_s: f64) -> Image {
        let exact = Self { noise: 0.0, exposure_s: 0.0, ..self.clone() };
        exact.image(&Texture::new(), place, (time_s, RowTimes::default()), 0)
    }

    fn focal_px(&self) -> f64 {
        1.07 * self.size[0] as f64
    }

    fn image(
        &self,
        texture: &Texture,
        place: [f64; 2],
        (time_s, rows): (f64, RowTimes),
        seed: u64,
    ) -> Image {
        let instants = if self.exposure_s > 0.0 { 8 } else { 1 };
        let [w, h] = self.size;
        let mut sum = vec![0.0_f64; w * h];
        for n in 0..instants {
            let fraction = (n as f64 + 0.5) / f64::from(instants) - 0.5;
            let time_s = time_s + fraction * self.exposure_s;
            for (y, row) in sum.chunks_exact_mut(w).enumerate() {
                self.expose_row(texture, place, (y, time_s + rows.offset_s(y as f64 + 0.5)), row);
            }
        }
        let mut random = Random::new(seed);
        let scale = 1.0 / f64::from(instants);
        let noisy =
            |v: f64, random: &mut Random| (scale * v + self.noise * random.gaussian()) as f32;
        let data = sum.into_iter().map(|v| noisy(v, &mut random).clamp(0.0, 1.0)).collect();
        Image::from_data(w, h, 1, data)
    }

    fn expose_row(
        &self,
        texture: &Texture,
        [x, y]: [f64; 2],
        (row, t): (usize, f64),
        sum: &mut [f64],
    ) {
        let [w, h] = self.size;
        let focal = self.focal_px();
        let eye = Point3::new(x, y, 0.0);
        let boards: Vec<_> = self
            .boards
            .iter()
            .map(|b| {
                let back = b.rotation_at(t).inverse();
                (b, back, back * (eye - b.center_at(t)))
            })
            .collect();
        for (k, out) in sum.iter_mut().enumerate() {
            // Four rays per pixel against aliasing at edges.
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let ray = Vector3::new(
                    (k as f64 + dx - w as f64 / 2.0) / focal,
                    (row as f64 + dy - h as f64 / 2.0) / focal,
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

/// Smooth noise of several scales, periodic.
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
    Board::at_rest(Point3::new(0.0, 0.0, 2.6), [3.0, 2.5], [10.0, 10.0])
}

/// Three boards of random size, position and motion, 4 to 20 pixels a frame at 640×480.
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
            Board::at_rest(center, [0.12 + 0.1 * random.unit(), 0.15], [f64::from(n), 0.3]);
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

/// The paper's synthetic scene: a textured rectangle in front of a textured wall. Its velocity is in
/// metres a second, to the right and down.
pub fn rectangle(velocity: [f64; 2]) -> Vec<Board> {
    let mut board = Board::at_rest(Point3::new(-0.1, -0.15, 1.8), [0.25, 0.2], [0.0, 0.3]);
    board.velocity = Vector3::new(velocity[0], velocity[1], 0.0);
    vec![wall(), board]
}

/// A magazine that oscillates: twice in each period it is at rest, and no feature crosses its epipolar
/// line.
pub fn rotating_magazine() -> Vec<Board> {
    let turn = |swing: Vector3<f64>, phase: f64| {
        let mut board = Board::at_rest(Point3::new(0.0, 0.0, 1.7), [0.22, 0.28], [0.0, 0.3]);
        (board.swing, board.swing_hz, board.phase) = (swing, 1.1, phase);
        board
    };
    vec![wall(), turn(Vector3::new(0.03, 0.09, 0.0), 0.4)]
}

/// Boards that oscillate at incommensurable frequencies: the motion of the scene never repeats, however
/// long the recording.
pub fn aperiodic_boards(seed: u64) -> Vec<Board> {
    let random = &mut Random::new(seed);
    let mut boards = vec![wall()];
    for (x, hz) in [(-0.45, 0.71), (0.05, 1.13), (0.5, 1.57)] {
        let mut board = Board::at_rest(Point3::new(x, 0.0, 1.8), [0.22, 0.28], [x, 0.3]);
        board.swing = Vector3::new(0.08 * random.signed(), 0.16, 0.0);
        board.swing_hz = hz;
        board.phase = 6.0 * random.unit();
        boards.push(board);
    }
    boards
}

/// A small board that translates fast along a row of cameras and rotates. Only few tracker windows move
/// across the epipolar lines, and most of them contain the board's outline.
pub fn small_turning_board(seed: u64) -> Vec<Board> {
    let random = &mut Random::new(seed);
    let mut turns =
        Board::at_rest(Point3::new(-0.3, -0.1, 1.6), [0.11; 2], [random.unit(), random.unit()]);
    turns.velocity.x = 0.8 + 0.6 * random.unit();
    turns.roll = [random.signed(), 2.5 + 1.5 * random.unit()];
    vec![wall(), turns]
}
