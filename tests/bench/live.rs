//! Views a second while one looks around, beside OpenCV's remap and blend.
//!
//! `cargo bench --bench live -- CAPTURE… [--views N] [--method NAME]` prints three tables a capture, by preset; NAME is
//! what a row begins with.
//!
//! - A fixed instant, halfway through the recording, and a viewpoint that moves along the rig, up and ahead: seconds
//!   from the opened capture to the first view, views a second (from the median), how much of it is the geometry, and
//!   the same of the peer: `cv2.remap` of as many cameras as the preset blends, bicubic, over maps that are computed
//!   beforehand, and their weighted sum.
//! - A fixed viewpoint, and instants that move: the first view from the folder's name on, of a capture that is not
//!   prepared and of one that is (`stlfr prepare`); views a second; and what one thread reaches of two threads' speed.
//!   Then what the preparation takes, beside OpenCV's DIS in both directions for the same pairs.
//!
//! Between them, the stages of a view at the fixed instant, beside how long its bytes take through memory at the
//! bandwidth that reading a large array reaches.
//!
//! `cargo bench --bench live -- scene-flow CAPTURE… [--views N]` prepares captures, and prints views by scene flow:
//! from moving viewpoints, at moving instants, and both; quick views and full ones, and what quick ones lose. Clocks are
//! the true ones. What is prepared stays.
//!
//! All use all cores. The peers are left out where the project's Python environment is missing. Otherwise, what is prepared
//! is deleted again, and a capture that is prepared already is refused.

#[path = "live/flow.rs"]
mod flow;
#[path = "live/moving.rs"]
mod moving;
#[path = "live/peer.rs"]
mod peer;
#[path = "live/stages.rs"]
mod stages;

use nalgebra::Vector3;
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::light_field::{Context, LightField, Request, Viewpoint};
use stlfr::offset::Offsets;
use stlfr::options::{Preset, ProxyMethod, RenderOptions};

type Error = Box<dyn std::error::Error>;

/// How far the viewpoint moves up and ahead, metres.
const ASIDE_M: f64 = 0.05;

/// Options by name: the presets, and `best` over depth per pixel.
fn methods() -> Vec<(&'static str, RenderOptions)> {
    let of = |preset: Preset| preset.options();
    let mut depth = of(Preset::Best);
    depth.proxy.method = ProxyMethod::Depth;
    vec![
        ("draft", of(Preset::Draft)),
        ("balanced", of(Preset::Balanced)),
        ("best, mesh", of(Preset::Best)),
        ("best, depth", depth),
    ]
}

/// Viewpoints on a path between the first and the last camera, which also rises and goes ahead.
fn path(capture: &Capture, count: usize) -> Vec<Camera> {
    let cameras = &capture.cameras;
    let [first, last] = [0, cameras.len() - 1].map(|c| cameras[c].camera.center());
    let reference = &cameras[capture.reference].camera;
    let [right_to_left, ahead] = [-Vector3::y(), Vector3::z()]
        .map(|axis| reference.cam_from_world.rotation.inverse() * axis);
    let at = |k: usize| {
        let s = (k as f64 + 0.5) / count as f64;
        let turn = std::f64::consts::TAU * s;
        let aside = right_to_left * (ASIDE_M * turn.sin()) + ahead * (ASIDE_M * (1.0 - turn.cos()));
        let center = first + (last - first) * s + aside;
        let mut camera = reference.clone();
        camera.cam_from_world.translation =
            (-(camera.cam_from_world.rotation * center.coords)).into();
        camera
    };
    (0..count).map(at).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The median of how long `f` takes for each of the viewpoints, milliseconds.
fn each_ms(
    views: &[Camera],
    mut f: impl FnMut(&Camera) -> Result<(), Error>,
) -> Result<f64, Error> {
    let mut all = Vec::new();
    for view in views {
        let start = Instant::now();
        f(view)?;
        all.push(1000.0 * start.elapsed().as_secs_f64());
    }
    Ok(median(all))
}

fn bench(
    folder: &str,
    count: usize,
    methods: &[(&'static str, RenderOptions)],
) -> Result<(), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let views = path(&capture, count);
    let size = (views[0].width, views[0].height);
    println!("{folder}: {} cameras, views of {}×{}", capture.cameras.len(), size.0, size.1);
    println!(
        "| method | first view | a view | views a second | geometry | OpenCV's remap and blend |"
    );
    println!("|---|---|---|---|---|---|");
    let mut stages = vec![];
    for (name, options) in methods {
        // Clocks as recorded: times don't depend on how right they are.
        let mut offsets = Offsets::known(&capture);
        offsets.cameras.iter_mut().for_each(|c| c.offset_s = Some(c.offset_s.unwrap_or(0.0)));
        let field = LightField::new(capture.clone(), offsets);
        let start = Instant::now();
        let time_s = middle_s(&capture);
        let view = |target: &Camera| field.view(target, time_s, options);
        let images = field.corrected_all(time_s, options, &Context::unattended())?;
        view(&views[0])?;
        let prepared_s = start.elapsed().as_secs_f64();
        // Once, so that what views share is cached.
        each_ms(&views, |v| Ok(view(v).map(drop)?))?;
        let view_ms = each_ms(&views, |v| Ok(view(v).map(drop)?))?;
        let geometry =
            |v: &Camera| Ok(field.geometry(v, &Request::new(Viewpoint::View(v), time_s, options))?);
        let geometry_ms = each_ms(&views, |v| geometry(v).map(drop))?;
        let peer = peer::remap_ms(&images, &geometry, &capture, &views, options.blend.cameras)?;
        let peer = peer.map_or("-".to_owned(), |ms| format!("{ms:.1} ms"));
        println!(
            "| {name} | {prepared_s:.1} s | {view_ms:.1} ms | {:.1} | {geometry_ms:.1} ms | {peer} |",
            1000.0 / view_ms
        );
        stages.extend(stages::of(name, &field, &geometry, &views, options)?);
    }
    stages::print(&stages);
    moving::bench(folder, &views[count / 3], methods).map_err(|error| -> Error { error })
}

/// The middle of the recording, between frames.
fn middle_s(capture: &Capture) -> f64 {
    let clock = &capture.cameras[capture.reference].clock.times_s;
    let k = clock.len() / 2;
    0.5 * (clock[k - 1] + clock[k]) - capture.time_origin_s
}

fn main() -> Result<(), Error> {
    // As the program does.
    stlfr::host::reuse_freed_memory();
    let mut folders = Vec::new();
    let mut count = 40;
    let mut methods = methods();
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} lacks a value"));
        match argument.as_str() {
            "--views" => count = value()?.parse()?,
            "--method" => {
                let name = value()?;
                methods.retain(|(method, _)| method.starts_with(&name));
            }
            _ => folders.push(argument),
        }
    }
    if methods.is_empty() {
        return Err("--method: no row begins so".into());
    }
    if folders.first().is_some_and(|word| word == "scene-flow") {
        return folders[1..].iter().try_for_each(|folder| flow::bench(folder, count));
    }
    folders.iter().try_for_each(|folder| bench(folder, count, &methods))
}
