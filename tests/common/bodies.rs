//! Rigid textured bodies in motion, filmed by ray casting: what every surface point does, in every
//! camera and at every instant, is a formula, hidden or seen. Recordings have the noise of a path
//! tracer: a few random samples a pixel, and a grain.

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, write_image};

#[derive(Clone, Copy)]
pub enum Shape {
    /// The rectangle |x| ≤ a, |y| ≤ b of the body's plane z = 0, metres.
    Rectangle(f64, f64),
    /// A ball around the body's origin, metres.
    Ball(f64),
}

/// A rigid body: its shape, its texture, and its pose in the world at a time in frames.
pub struct Body {
    pub shape: Shape,
    pub texture: Texture,
    pub pose: fn(f64) -> Isometry3<f64>,
    /// Brightness at a time in frames.
    pub light: fn(f64) -> f64,
}

/// Bodies, and what a point of them looks like.
pub struct World {
    pub bodies: Vec<Body>,
}

/// A surface point: of which body, where in its frame.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub body: usize,
    pub point: Point3<f64>,
}

impl Body {
    /// The nearest hit of a ray in the body's frame, as its parameter.
    fn hit(&self, origin: &Point3<f64>, ray: &Vector3<f64>) -> Option<f64> {
        match self.shape {
            Shape::Rectangle(a, b) => {
                let s = -origin.z / ray.z;
                let p = origin + ray * s;
                (s > 0.0 && p.x.abs() <= a && p.y.abs() <= b).then_some(s)
            }
            Shape::Ball(radius) => {
                let (a, b) = (ray.norm_squared(), origin.coords.dot(ray));
                let root = b * b - a * (origin.coords.norm_squared() - radius * radius);
                (root >= 0.0).then(|| (-b - root.sqrt()) / a).filter(|s| *s > 0.0)
            }
        }
    }

    fn color(&self, p: &Point3<f64>) -> [f32; 3] {
        match self.shape {
            Shape::Rectangle(..) => self.texture.at(p.x, p.y),
            Shape::Ball(radius) => {
                self.texture.at(radius * p.x.atan2(-p.z), radius * (p.y / radius).asin())
            }
        }
    }
}

impl World {
    /// What a pixel shows at a time.
    pub fn seen(&self, camera: &Camera, pixel: &Point2<f64>, time: f64) -> Option<Surface> {
        let poses: Vec<_> = self.bodies.iter().map(|b| (b.pose)(time).inverse()).collect();
        self.cast(&poses, &camera.center(), &camera.ray_world(pixel)?).map(|(surface, _)| surface)
    }

    fn cast(
        &self,
        body_from_world: &[Isometry3<f64>],
        origin: &Point3<f64>,
        ray: &Vector3<f64>,
    ) -> Option<(Surface, f64)> {
        let mut nearest: Option<(Surface, f64)> = None;
        for (body, pose) in body_from_world.iter().enumerate() {
            let (o, r) = (pose * origin, pose * ray);
            if let Some(s) = self.bodies[body].hit(&o, &r)
                && nearest.is_none_or(|(_, other)| s < other)
            {
                nearest = Some((Surface { body, point: o + r * s }, s));
            }
        }
        nearest
    }

    /// Where a surface point is in a camera at a time, whether or not something hides it.
    pub fn position(&self, surface: &Surface, camera: &Camera, time: f64) -> Option<Point2<f64>> {
        camera.project(&((self.bodies[surface.body].pose)(time) * surface.point))
    }

    /// Whether the camera sees that point at a time.
    pub fn is_seen(&self, surface: &Surface, camera: &Camera, time: f64) -> bool {
        self.position(surface, camera, time).is_some_and(|pixel| {
            camera.contains(&pixel)
                && self.seen(camera, &pixel, time).is_some_and(|s| {
                    s.body == surface.body && (s.point - surface.point).norm() < 1e-3
                })
        })
    }

    /// The camera's image at a time, 4×4 random samples a pixel and a grain of `noise`.
    pub fn film(&self, camera: &Camera, time: f64, noise: f64, seed: u64) -> Image {
        const SIDE: usize = 4;
        let poses: Vec<_> = self.bodies.iter().map(|b| (b.pose)(time).inverse()).collect();
        let lights: Vec<_> = self.bodies.iter().map(|b| (b.light)(time) as f32).collect();
        let origin = camera.center();
        let rows: Vec<Vec<f32>> = (0..camera.height)
            .into_par_iter()
            .map(|y| {
                let mut random = Random::new(seed ^ (y as u64) << 32);
                let mut row = Vec::with_capacity(3 * camera.width);
                for x in 0..camera.width {
                    let mut sum = [0.0; 3];
                    for k in 0..SIDE * SIDE {
                        let mut offset = |k: usize| (k as f64 + random.unit()) / SIDE as f64;
                        let at =
                            Point2::new(x as f64 + offset(k % SIDE), y as f64 + offset(k / SIDE));
                        let ray = camera.ray_world(&at).expect("pixels of the image have rays");
                        let Some((hit, _)) = self.cast(&poses, &origin, &ray) else { continue };
                        let color = self.bodies[hit.body].color(&hit.point);
                        for (sum, c) in sum.iter_mut().zip(color) {
                            *sum += c * lights[hit.body];
                        }
                    }
                    row.extend(
                        sum.map(|s| s / (SIDE * SIDE) as f32 + (noise * random.gaussian()) as f32),
                    );
                }
                row
            })
            .collect();
        Image::from_data(camera.width, camera.height, 3, rows.concat())
    }
}

/// A square of colours that repeats.
#[derive(Clone)]
pub struct Texture {
    texels: Arc<[[f32; 3]]>,
    texels_per_m: f64,
}

const TEXELS: usize = 1024;

impl Texture {
    /// Cloudy colours of all sizes, with dark print on them; a texel is `texel_m` wide.
    pub fn print(seed: u64, texel_m: f64, contrast: f64) -> Self {
        let mut random = Random::new(seed);
        let mut texels = vec![[0.5_f32; 3]; TEXELS * TEXELS];
        for (cell, strength) in [(8, 0.09), (16, 0.12), (40, 0.14), (128, 0.16)] {
            let cells = TEXELS.div_ceil(cell);
            let grid: Vec<[f64; 3]> =
                (0..cells * cells).map(|_| [0; 3].map(|_| random.unit() - 0.5)).collect();
            for (k, texel) in texels.iter_mut().enumerate() {
                let smooth = |v: usize| {
                    let f = (v % cell) as f64 / cell as f64;
                    (v / cell, f * f * (3.0 - 2.0 * f))
                };
                let ((cx, fx), (cy, fy)) = (smooth(k % TEXELS), smooth(k / TEXELS));
                let at = |x: usize, y: usize| &grid[y % cells * cells + x % cells];
                for (c, t) in texel.iter_mut().enumerate() {
                    let top = at(cx, cy)[c] * (1.0 - fx) + at(cx + 1, cy)[c] * fx;
                    let low = at(cx, cy + 1)[c] * (1.0 - fx) + at(cx + 1, cy + 1)[c] * fx;
                    *t += (2.0 * contrast * strength * (top * (1.0 - fy) + low * fy)) as f32;
                }
            }
        }
        // Strokes in rows, as print has them.
        for line in 0..TEXELS / 48 {
            let mut x = 20 + (random.unit() * 200.0) as usize;
            while x < TEXELS - 30 {
                let (w, h) = (4.0 + 14.0 * random.unit(), 4.0 + 22.0 * random.unit());
                let y = line * 48 + (random.unit() * 12.0) as usize;
                for ty in y..(y + h as usize).min(TEXELS) {
                    for tx in x..(x + w as usize).min(TEXELS) {
                        texels[ty * TEXELS + tx] =
                            texels[ty * TEXELS + tx].map(|v| v * (1.0 - 0.7 * contrast as f32));
                    }
                }
                x += w as usize + 3 + (random.unit() * random.unit() * 160.0) as usize;
            }
        }
        Self { texels: texels.into(), texels_per_m: 1.0 / texel_m }
    }

    fn at(&self, x_m: f64, y_m: f64) -> [f32; 3] {
        let (x, y) = (x_m * self.texels_per_m, y_m * self.texels_per_m);
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let wrap = |v: f64| (v.floor() as i64).rem_euclid(TEXELS as i64) as usize;
        let (x0, y0) = (wrap(x), wrap(y));
        let (x1, y1) = ((x0 + 1) % TEXELS, (y0 + 1) % TEXELS);
        let at = |x: usize, y: usize| &self.texels[y * TEXELS + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        std::array::from_fn(|k| {
            let top = a[k] + (b[k] - a[k]) * fx;
            let low = c[k] + (d[k] - c[k]) * fx;
            top + (low - top) * fy
        })
    }
}

/// The pose with Euler angles in degrees and a place in metres.
pub fn pose(degrees: [f64; 3], place: [f64; 3]) -> Isometry3<f64> {
    let [roll, pitch, yaw] = degrees.map(f64::to_radians);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(place)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

/// Steady light.
pub fn steady(_: f64) -> f64 {
    1.0
}

/// A printed board of 30 cm by 25 cm that moves before a still printed wall, 2.4 m away.
pub fn board_before_wall(board_pose: fn(f64) -> Isometry3<f64>) -> World {
    let print = |seed, texel_m| Texture::print(seed, texel_m, 0.8);
    let wall = Body {
        shape: Shape::Rectangle(3.0, 2.0),
        texture: print(1, 0.008),
        pose: |_| pose([0.0; 3], [0.0, 0.0, 2.4]),
        light: steady,
    };
    let board = Body {
        shape: Shape::Rectangle(0.30, 0.25),
        texture: print(2, 0.006),
        pose: board_pose,
        light: steady,
    };
    World { bodies: vec![wall, board] }
}

/// A recording of a world, in frames of 30 a second; clocks are shared.
pub struct Recording<'a> {
    pub world: &'a World,
    pub cameras: &'a [Camera],
    /// When each camera opens, frames on the world's clock.
    pub first_frames: &'a [f64],
    /// How many each camera has.
    pub frames: usize,
    /// The standard deviation of the images' grain.
    pub noise: f64,
}

impl Recording<'_> {
    /// Films it, and writes the capture.
    pub fn write(&self, folder: &Path) {
        let mut described = Vec::new();
        for (c, (camera, first)) in self.cameras.iter().zip(self.first_frames).enumerate() {
            let rotation = camera.cam_from_world.rotation;
            let place = camera.cam_from_world.translation;
            described.push(json!({
                "id": format!("cam{c}"), "frames": format!("cam{c}/%04d.png"),
                "width": camera.width, "height": camera.height,
                "model": camera.model.name(), "params": camera.model.params(),
                "cam_from_world": {
                    "rotation_wxyz": [rotation.w, rotation.i, rotation.j, rotation.k],
                    "translation": [place.x, place.y, place.z]},
                "clock": {"rate_hz": 30.0, "first_s": first / 30.0, "shared": true}}));
            for k in 0..self.frames {
                let seed = 1 + (c * self.frames + k) as u64 * 7919;
                let image = self.world.film(camera, first + k as f64, self.noise, seed);
                let path = folder.join(format!("cam{c}/{k:04}.png"));
                write_image(&path, &image, None, BitDepth::Eight).expect("a frame can be written");
            }
        }
        let capture = json!({"format": "stlfr-capture", "version": 1, "name": "bodies",
            "reference": "cam0", "cameras": described});
        std::fs::write(folder.join("capture.json"), capture.to_string())
            .expect("capture.json can be written");
    }
}
