//! Where the time of a view goes, stage by stage, beside what moving its bytes through memory takes.

use super::{Error, each_ms, median, middle_s};
use rayon::prelude::*;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, FilmedCamera};
use stlfr::host::on_workers;
use stlfr::interpolation::Synchronized;
use stlfr::light_field::{Geometry, LightField, Moment};
use stlfr::lumigraph::{DepthMap, Source, blend};
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

/// The images that views are blended from, with what hides what in them.
fn sources<'a>(
    capture: &'a Capture,
    moment: &'a Moment,
    geometry: &'a Geometry,
) -> Vec<Source<'a>> {
    let of = |((filmed, image), depth): ((&'a FilmedCamera, &'a Option<Synchronized>), _)| {
        let Synchronized { image, interpolation_error_px } = image.as_ref()?;
        let depth: &Option<Arc<DepthMap>> = depth;
        let (camera, interpolation_error_px) = (&filmed.camera, interpolation_error_px.as_deref());
        Some(Source { camera, image, depth: depth.as_deref(), interpolation_error_px })
    };
    capture.cameras.iter().zip(moment.images()).zip(&geometry.sources).filter_map(of).collect()
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

/// The stages of one method's views at the instant of `moment`.
pub fn of(
    method: &'static str,
    field: &LightField,
    moment: &Moment,
    views: &[Camera],
    options: &RenderOptions,
) -> Result<Vec<StageTime>, Error> {
    let (capture, options) = (field.capture(), options.view());
    let shapes: Vec<Geometry> =
        views.iter().map(|v| Ok(moment.geometry(v)?)).collect::<Result<_, Error>>()?;
    let shape_ms = each_ms(views, |v| Ok(moment.geometry(v).map(drop)?))?;
    let blend_of = |(view, geometry): (&Camera, &Geometry)| {
        let sources = sources(capture, moment, geometry);
        let start = Instant::now();
        on_workers(|| drop(black_box(blend(&sources, &geometry.view, view, &options.blend))));
        1000.0 * start.elapsed().as_secs_f64()
    };
    let blend_ms = median(views.iter().zip(&shapes).map(blend_of).collect());
    let time_s = middle_s(capture);
    let image = |_| -> Result<f64, Error> {
        let start = Instant::now();
        field.synchronized(capture.reference, time_s, &options)?;
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
