//! Maps of scene flow beside the truth: depth and velocity of points that the simulator tracked, and their standard
//! errors.
//!
//! `cargo bench --bench maps -- CAPTURE… [--frames N]`: filmed captures with `truth/tracks`, whose clocks are the true
//! ones; N frames around the middle of each camera, 1 by default. Errors of the disparity are pixels at the baseline of
//! neighbouring cameras; errors of the velocity are pixels per frame. |z| is the error in standard errors. A point is at
//! an edge if another point within 12 pixels differs by over 2 pixels in disparity. Where a point's path has a jump in
//! velocity at the frame, as at a bounce, it is left out.

#[path = "tracks/points.rs"]
mod points;

use nalgebra::Point2;
use points::{CameraPoints, TrackedPoint};
use std::sync::Arc;

use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth};
use stlfr::light_field::{LightField, LoadedFrame};
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;

type Error = Box<dyn std::error::Error>;

/// Within this distance, pixels, another point that differs by more than [`EDGE_PX`] makes an edge.
const NEAR_PX: f64 = 12.0;
const EDGE_PX: f64 = 2.0;
/// One-sided velocities may differ by this many pixels per frame, and by this part of the speed.
const MAX_JUMP: [f64; 2] = [2.0, 0.5];
/// Upper bounds of the classes of speed, pixels per frame.
const SPEEDS_PX: [f64; 4] = [0.3, 5.0, 20.0, f64::INFINITY];

/// A tracked point at a frame.
struct Known {
    px: [f64; 2],
    disparity_px: f64,
    /// Pixels per frame of the reference camera.
    velocity: Option<[f64; 2]>,
}

/// The errors at one point.
struct Sample {
    speed: f64,
    is_edge: bool,
    disparity_px: f64,
    velocity_px: f64,
    /// Errors in standard errors, absolute: of the disparity, and of each component of the velocity.
    z: [f64; 3],
}

/// The derivative at `t` of the parabola through three points `(time, value)`.
fn derivative(points: [(f64, f64); 3], t: f64) -> f64 {
    let [a, b, c] = points;
    let slope = |a: (f64, f64), b: (f64, f64)| (b.1 - a.1) / (b.0 - a.0);
    let curvature = (slope(b, c) - slope(a, b)) / (c.0 - a.0);
    slope(a, b) + curvature * (2.0 * t - a.0 - b.0)
}

/// The velocity in the middle of five frames, pixels per frame; `None` where it jumps, or where a position is unknown.
fn velocity(times: [f64; 5], places: [Point2<f64>; 5]) -> Option<[f64; 2]> {
    let of = |first: usize| {
        [0, 1].map(|c| {
            let points = [0, 1, 2].map(|k| (times[first + k], places[first + k][c]));
            derivative(points, times[2])
        })
    };
    let [before, around, after] = [of(0), of(1), of(2)];
    let jump = (after[0] - before[0]).hypot(after[1] - before[1]);
    let is_smooth = jump <= MAX_JUMP[0] + MAX_JUMP[1] * around[0].hypot(around[1]);
    is_smooth.then_some(around)
}

/// The points that are visible at a camera's frame, with their velocities by the frames around.
fn known(
    (points, frame): (&CameraPoints, usize),
    camera: &Camera,
    [disparity_px, frame_s]: [f64; 2],
) -> Vec<Known> {
    let times = [0, 1, 2, 3, 4].map(|k| points.times_s[frame + k - 2] / frame_s);
    let of = |(n, point): (usize, &TrackedPoint)| {
        let places = [0, 1, 2, 3, 4].map(|k| points.frames[frame + k - 2][n].px);
        point.visible.then(|| Known {
            px: [point.px.x, point.px.y],
            disparity_px: disparity_px / (camera.cam_from_world * point.world).z,
            velocity: velocity(times, places),
        })
    };
    points.frames[frame].iter().enumerate().filter_map(of).collect()
}

fn is_edge(point: &Known, all: &[Known]) -> bool {
    all.iter().any(|other| {
        let distance = (other.px[0] - point.px[0]).hypot(other.px[1] - point.px[1]);
        distance < NEAR_PX && (other.disparity_px - point.disparity_px).abs() > EDGE_PX
    })
}

/// The errors of a map at a point: bilinear between the pixels around it that are on the surface of the nearest.
fn sample(loaded: &LoadedFrame, point: &Known, all: &[Known], baseline: f64) -> Option<Sample> {
    let map = &loaded.map;
    let [x, y] = point.px;
    let at = |u: usize, v: usize| {
        let pixel = &map.pixels()[v * map.width + u];
        let element = map.element(pixel);
        let disparity = f64::from(element.inverse_depth * map.disparity_px) * baseline;
        (
            [disparity, f64::from(element.velocity[0]), f64::from(element.velocity[1])],
            pixel.errors(),
        )
    };
    if !(x >= 0.0 && y >= 0.0 && x < map.width as f64 && y < map.height as f64) {
        return None;
    }
    let (nearest, errors) = at(x as usize, y as usize);
    let (mut sums, mut weights) = ([0.0; 3], 0.0);
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let [u, v] = [((x - 0.5).floor() as i64 + dx), ((y - 0.5).floor() as i64 + dy)];
        if u < 0 || v < 0 || u >= map.width as i64 || v >= map.height as i64 {
            continue;
        }
        let (values, _) = at(u as usize, v as usize);
        let differs = values.iter().zip(&nearest).any(|(a, b)| (a - b).abs() > 1.0);
        let weight = |p: f64, q: i64| 1.0 - (p - 0.5 - q as f64).abs();
        let weight = if differs { 0.0 } else { (weight(x, u) * weight(y, v)).max(1e-9) };
        (0..3).for_each(|c| sums[c] += weight * values[c]);
        weights += weight;
    }
    let [disparity, vx, vy] = sums.map(|s| s / weights);
    let disparity_px = disparity - point.disparity_px;
    let known = point.velocity?;
    let velocity = [vx - known[0], vy - known[1]];
    let [of_disparity, of_velocity] =
        [f64::from(errors.disparity_px) * baseline, f64::from(errors.velocity_px)];
    Some(Sample {
        speed: known[0].hypot(known[1]),
        is_edge: is_edge(point, all),
        disparity_px: disparity_px.abs(),
        velocity_px: velocity[0].hypot(velocity[1]),
        z: [disparity_px / of_disparity, velocity[0] / of_velocity, velocity[1] / of_velocity]
            .map(f64::abs),
    })
}

fn samples(folder: &str, frames: usize) -> Result<Vec<Sample>, Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    let field = LightField::new(capture.clone(), offsets);
    let (points, options) = (points::read(&truth), RenderOptions::default());
    let mut samples = Vec::new();
    for n in 0..frames {
        let wanted: Vec<(usize, usize)> = (0..capture.cameras.len())
            .map(|c| (c, capture.cameras[c].frames.len() / 2 + n - frames / 2))
            .collect();
        for (&(camera, frame), loaded) in
            wanted.iter().zip(field.frames_with_flow(&wanted, &options)?)
        {
            // The map's disparities have twice the baseline of neighbouring cameras.
            let baseline = 0.5;
            let per_depth = f64::from(loaded.map.disparity_px) * baseline;
            let filming = &capture.cameras[camera].camera;
            let all = known((&points[camera], frame), filming, [per_depth, capture.frame_s()]);
            samples.extend(all.iter().filter_map(|p| sample(&loaded, p, &all, baseline)));
        }
    }
    Ok(samples)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn fraction_over(samples: &[&Sample], value: impl Fn(&Sample) -> f64, limit: f64) -> f64 {
    let over = samples.iter().filter(|s| value(s) > limit).count();
    100.0 * over as f64 / samples.len() as f64
}

fn print_row(name: &str, class: &str, samples: &[&Sample]) {
    if samples.is_empty() {
        return;
    }
    let of = |value: fn(&Sample) -> f64| median(samples.iter().map(|s| value(s)).collect());
    let z_velocity = median(samples.iter().flat_map(|s| [s.z[1], s.z[2]]).collect());
    println!(
        "| {name} | {class} | {} | {:.3}, {:.1} % | {:.2}, {:.0} % | {:.3}, {:.1} % | {:.2}, {:.0} % |",
        samples.len(),
        of(|s| s.disparity_px),
        fraction_over(samples, |s| s.disparity_px, 1.0),
        of(|s| s.z[0]),
        fraction_over(samples, |s| s.z[0], 2.0),
        of(|s| s.velocity_px),
        fraction_over(samples, |s| s.velocity_px, 1.0),
        z_velocity,
        fraction_over(samples, |s| s.z[1].max(s.z[2]), 2.0),
    );
}

fn print_classes(name: &str, samples: &[Sample]) {
    for (is_edge, place) in [(false, "away from edges"), (true, "at edges")] {
        let mut min = 0.0;
        for max in SPEEDS_PX {
            let is_in = |s: &&Sample| s.is_edge == is_edge && s.speed >= min && s.speed < max;
            let class = if max.is_finite() {
                format!("{place}, {min} to {max} px")
            } else {
                format!("{place}, over {min} px")
            };
            print_row(name, &class, &samples.iter().filter(is_in).collect::<Vec<_>>());
            min = max;
        }
    }
    print_row(name, "all", &samples.iter().collect::<Vec<_>>());
}

fn main() -> Result<(), Error> {
    let (mut folders, mut frames) = (Vec::new(), 1);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--frames" => frames = arguments.next().ok_or("--frames lacks a value")?.parse()?,
            _ => folders.push(argument),
        }
    }
    println!(
        "| scene | points | number | disparity: median error, over 1 px | median |z|, over 2 | \
         velocity: median error, over 1 px | median |z|, over 2 |"
    );
    println!("|---|---|---|---|---|---|---|");
    let mut all = Vec::new();
    for folder in &folders {
        let samples = samples(folder, frames)?;
        let name = folder.trim_end_matches('/').rsplit('/').next().unwrap_or(folder);
        print_classes(name, &samples);
        all.extend(samples);
    }
    if folders.len() > 1 {
        print_classes("all", &all);
    }
    Ok(())
}
