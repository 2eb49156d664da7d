//! Five moving worlds before a printed wall, after the paper's: a magazine, a book that turns, a
//! thing that comes nearer while the light changes, a swinging ball, and one too fast to follow
//! without an initial position. Times are in frames; motion at 640×480.

use super::bodies::{Body, Shape, Texture, World, pose, steady};
use nalgebra::Isometry3;
use std::f64::consts::TAU;
use std::sync::OnceLock;
use stlfr::camera::{Camera, CameraModel};

pub struct Case {
    pub name: &'static str,
    pub world: World,
}

/// Cameras in a line, `width`×3/4, 60 mm apart, that look straight ahead.
pub fn line_rig(count: usize, width: usize) -> Vec<Camera> {
    let height = width * 3 / 4;
    let focal = 686.24 * width as f64 / 640.0;
    (0..count)
        .map(|c| Camera {
            width,
            height,
            model: CameraModel::Pinhole {
                fx: focal,
                fy: focal,
                cx: width as f64 / 2.0,
                cy: height as f64 / 2.0,
            },
            cam_from_world: Isometry3::translation(
                -0.06 * (c as f64 - (count as f64 - 1.0) / 2.0),
                0.0,
                0.0,
            ),
        })
        .collect()
}

fn wall() -> Body {
    static PRINT: OnceLock<Texture> = OnceLock::new();
    Body {
        shape: Shape::Rectangle(3.0, 2.0),
        texture: PRINT.get_or_init(|| Texture::print(1, 0.002, 0.8)).clone(),
        pose: |_| pose([3.0, 8.0, 0.0], [0.0, 0.0, 2.4]),
        light: steady,
    }
}

fn rectangle(seed: u64, contrast: f64, pose: fn(f64) -> Isometry3<f64>) -> Body {
    Body {
        shape: Shape::Rectangle(0.30, 0.22),
        texture: Texture::print(seed, 0.0015, contrast),
        pose,
        light: steady,
    }
}

/// An ellipse that a body goes around, metres, once in `frames`.
fn around(t: f64, frames: f64, x: f64, y: f64) -> (f64, f64) {
    let angle = TAU * t / frames;
    (x * angle.cos(), y * angle.sin())
}

/// A body of a world, made when it is asked for: its print takes a while.
type Maker = fn() -> Body;

const BODIES: [(&str, Maker); 5] = [
    ("magazine", magazine),
    ("turning", turning),
    ("nearing", nearing),
    ("ball", ball),
    ("fast", fast),
];

/// All five.
pub fn cases() -> Vec<Case> {
    BODIES.map(|(name, _)| case(name)).into()
}

/// The world of that name.
///
/// # Panics
/// If there is none.
pub fn case(name: &str) -> Case {
    let is_it = |body: &&(&str, Maker)| body.0 == name;
    let &(name, body) = BODIES.iter().find(is_it).expect("one of the worlds");
    Case { name, world: World { bodies: vec![wall(), body()] } }
}

fn magazine() -> Body {
    rectangle(2, 1.0, |t| {
        let (x, y) = around(t, 24.0, 0.10, 0.14);
        pose([10.0 * (t * 0.2).sin(), 12.0 * (t * 0.15).cos(), 3.0 * (t * 0.25).sin()], [x, y, 1.7])
    })
}

fn turning() -> Body {
    rectangle(3, 1.0, |t| {
        let (x, y) = around(t + 6.0, 40.0, 0.05, 0.05);
        pose([0.0, 10.0, 5.0 * t], [x, y, 1.7])
    })
}

fn nearing() -> Body {
    let pose = |t: f64| {
        pose(
            [20.0 * (t * 0.3).sin(), -25.0 + 3.0 * t, 2.0 * t],
            [-0.05 + 0.01 * t, 0.03, 2.0 - 0.045 * t],
        )
    };
    Body { light: |t| 1.0 - 0.012 * t, ..rectangle(4, 0.6, pose) }
}

fn ball() -> Body {
    Body {
        shape: Shape::Ball(0.2),
        texture: Texture::print(5, 0.0014, 1.0),
        pose: |t| {
            let swing = 0.5 * (TAU * t / 30.0).sin();
            pose(
                [2.0 * t, 3.0 * t, swing.to_degrees()],
                [0.8 * swing.sin(), 0.8 * swing.cos() - 0.75, 1.7],
            )
        },
        light: steady,
    }
}

fn fast() -> Body {
    rectangle(6, 1.0, |t| {
        let (x, y) = around(t, 30.0, 0.5, 0.25);
        pose([0.0, 5.0, 1.5 * t], [x, y, 1.7])
    })
}
