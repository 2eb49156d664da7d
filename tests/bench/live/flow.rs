//! Views by scene flow of a prepared capture: from moving viewpoints, at moving instants, and both.

use super::{Error, median, middle_s, path};
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth};
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::{Preset, ProxyMethod, RenderOptions};

/// Frame intervals of the reference camera over which instants move.
const INTERVALS: f64 = 2.0;

/// Median milliseconds of a view in a sequence.
struct Sequence {
    name: &'static str,
    /// The first time through, when the frames of most instants are new.
    first_ms: f64,
    /// The second time.
    again_ms: f64,
}

/// Prepares a capture, and prints its table.
pub fn bench(folder: &str, count: usize) -> Result<(), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let mut options = Preset::Best.options();
    options.proxy.method = ProxyMethod::SceneFlow;
    let count = count.max(1);
    let views = path(&capture, count);
    let (width, height) = (views[0].width, views[0].height);
    println!("{folder}: {} cameras, views of {width}×{height}", capture.cameras.len());
    let start = Instant::now();
    let prepared = field(&capture)?.prepare(&options, |_| ())?;
    println!(
        "{} maps, {:.1} MB with all else that is prepared, {:.1} s",
        prepared.maps,
        1e-6 * prepared.bytes as f64,
        start.elapsed().as_secs_f64()
    );
    println!("| sequence | a view | views a second | the first time |");
    println!("|---|---|---|---|");
    let middle_s = middle_s(&capture);
    let times_s = &capture.cameras[capture.reference].clock.times_s;
    let [first_s, second_s] = times_s.first_chunk().ok_or("has a single frame")?;
    let interval_s = second_s - first_s;
    let moved =
        |k: usize| middle_s + INTERVALS * interval_s * ((k as f64 + 0.5) / count as f64 - 0.5);
    let still = views[count / 3].clone();
    let places: Vec<(Camera, f64)> = views.iter().map(|v| (v.clone(), middle_s)).collect();
    let instants = (0..count).map(|k| (still.clone(), moved(k))).collect();
    let both = views.iter().enumerate().map(|(k, v)| (v.clone(), moved(k))).collect();
    for (name, steps) in
        [("moving viewpoints", places), ("moving instants", instants), ("both", both)]
    {
        let Sequence { name, first_ms, again_ms } = measured(&capture, name, &steps, &options)?;
        println!("| {name} | {again_ms:.1} ms | {:.1} | {first_ms:.1} ms |", 1000.0 / again_ms);
    }
    Ok(())
}

fn measured(
    capture: &Arc<Capture>,
    name: &'static str,
    steps: &[(Camera, f64)],
    options: &RenderOptions,
) -> Result<Sequence, Error> {
    let field = field(capture)?;
    let turn = || -> Result<f64, Error> {
        let mut all = Vec::new();
        for (view, time_s) in steps {
            let start = Instant::now();
            field.view(view, *time_s, options)?;
            all.push(1000.0 * start.elapsed().as_secs_f64());
        }
        Ok(median(all))
    };
    Ok(Sequence { name, first_ms: turn()?, again_ms: turn()? })
}

/// The capture with true clocks, or clocks as recorded if it has no truth, and nothing in memory.
fn field(capture: &Arc<Capture>) -> Result<LightField, Error> {
    let mut offsets = Offsets::known(capture);
    let truth = Truth::open(&capture.folder)?;
    for camera in &mut offsets.cameras {
        let known = truth.as_ref().map_or(camera.offset_s, |truth| truth.offset_s(&camera.id));
        camera.offset_s = Some(known.unwrap_or(0.0));
    }
    Ok(LightField::new(capture.clone(), offsets))
}
