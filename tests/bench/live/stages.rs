//! Where the time of a view goes, stage by stage, beside what moving its bytes through memory takes.

use super::{Error, each_ms, median, middle_s};
use rayon::prelude::*;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::host::on_workers;
use stlfr::light_field::{Context, Geometry, LightField};
use stlfr::options::RenderOptions;

/// Number of values that bandwidth is measured over: 256 MiB. Larger: memory; smaller: caches hold them.
const VALUE_COUNT: usize = 1 << 26;
/// Bytes of a value of an image or a map.
const VALUE_BYTES: f64 = 4.0;
/// Number of times that bandwidth and a camera's image are timed. Larger: time; smaller: noise.
const RUNS: usize = 5;

/// Bytes a second that all threads read together: the best of a few sums over a large array.
fn read_bandwidth() -> f64 {
    let values = vec![1.0_f32; VALUE_COUNT];
    let part = VALUE_COUNT / (16 * rayon::current_num_threads());
    let sum = |part: &[f32]| -> f32 {
        let mut lanes = [0.0_f32; 32];
        for values in part.chunks_exact(32) {
            lanes.iter_mut().zip(values).for_each(|(lane, value)| *lane += value);
        }
        lanes.iter().sum()
    };
    let run = |_| {
        let start = Instant::now();
        let total: f32 = values.par_chunks(part).map(sum).sum();
        assert!(black_box(total) > 0.0);
        VALUE_BYTES * VALUE_COUNT as f64 / start.elapsed().as_secs_f64()
    };
    (0..RUNS).map(run).fold(0.0, f64::max)
}

/// A stage of one method's views.
pub struct StageTime {
    method: &'static str,
    stage: &'static str,
    ms: f64,
    /// Bytes of colour images and of the view's depths that it must read or write at least once; without the
    /// cameras' own depths.
    bytes: f64,
}

/// The stages of one method's views at an instant.
pub fn of(
    method: &'static str,
    field: &LightField,
    geometry: &dyn Fn(&Camera) -> Result<Geometry, Error>,
    views: &[Camera],
    options: &RenderOptions,
) -> Result<Vec<StageTime>, Error> {
    let (capture, time_s) = (field.capture(), middle_s(field.capture()));
    let images = field.corrected_all(time_s, options, &Context::unattended())?;
    let shapes: Vec<Geometry> = views.iter().map(geometry).collect::<Result<_, Error>>()?;
    let shape_ms = each_ms(views, |v| geometry(v).map(drop))?;
    let blend_of = |(view, geometry): (&Camera, &Geometry)| {
        let start = Instant::now();
        on_workers(|| drop(black_box(field.blend(images.all(), geometry, view, &options.blend))));
        1000.0 * start.elapsed().as_secs_f64()
    };
    let blend_ms = median(views.iter().zip(&shapes).map(blend_of).collect());
    let image = |_| -> Result<f64, Error> {
        let fresh = LightField::new(Arc::new(capture.clone()), field.offsets().clone());
        fresh.register(time_s, options)?;
        let start = Instant::now();
        fresh.synchronized(capture.reference, time_s, options)?;
        Ok(1000.0 * start.elapsed().as_secs_f64())
    };
    let image_ms = median((0..RUNS).map(image).collect::<Result<_, _>>()?);

    let pixels = (views[0].width * views[0].height) as f64;
    let blended = options.blend.cameras as f64;
    let stage = |(stage, ms, values): (&'static str, f64, f64)| {
        let bytes = VALUE_BYTES * values * pixels;
        StageTime { method, stage, ms, bytes }
    };
    // Values a pixel: two frames and an image; depths; depths, the images' samples and the view.
    let stages = [
        ("a camera's image at the instant", image_ms, 9.0),
        ("geometry: depths in the view", shape_ms, 1.0),
        ("places, weights, samples and their sum", blend_ms, 1.0 + 3.0 * blended + 3.0),
    ];
    Ok(stages.map(stage).into())
}

/// Prints the table.
pub fn print(stages: &[StageTime]) {
    let bandwidth = read_bandwidth();
    println!("Reading reaches {:.1} GB a second.", 1e-9 * bandwidth);
    println!("| method | stage | takes | its bytes through memory | times as long |");
    println!("|---|---|---|---|---|");
    for StageTime { method, stage, ms, bytes } in stages {
        let least_ms = 1000.0 * bytes / bandwidth;
        println!("| {method} | {stage} | {ms:.1} ms | {least_ms:.2} ms | {:.0} |", ms / least_ms);
    }
}
