//! Views by scene flow of a prepared capture: from moving viewpoints, at moving instants, and both.

use super::{Error, median, middle_s, path};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth, TruthView};
use stlfr::light_field::{Context, LightField, RenderError, Request, Viewpoint, render};
use stlfr::lumigraph::Rendered;
use stlfr::offset::Offsets;
use stlfr::options::{Preset, ProxyMethod, RenderOptions};
use stlfr::raster::{Image, read_image};
use stlfr::scene_flow::Detail;

/// Frame intervals of the reference camera over which instants move.
const INTERVALS: f64 = 2.0;

/// Median milliseconds of a view in a sequence.
struct Sequence {
    name: &'static str,
    /// Quick views ([`Detail::Quick`]): the first time through, when the frames of most instants are new, and the second
    /// time.
    quick_ms: [f64; 2],
    /// Views of full detail, likewise.
    full_ms: [f64; 2],
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
    println!(
        "| sequence | quick view | views a second | the first time | full view | views a second | the first time |"
    );
    println!("|---|---|---|---|---|---|---|");
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
        let Sequence { name, quick_ms, full_ms } = measured(&capture, name, &steps, &options)?;
        let columns = |[first, again]: [f64; 2]| {
            format!("{again:.1} ms | {:.1} | {first:.1} ms", 1000.0 / again)
        };
        println!("| {name} | {} | {} |", columns(quick_ms), columns(full_ms));
    }
    quality(&capture, &options)
}

/// Prints what quick views lose: PSNR, dB, of full and of quick views beside true images, and of quick views beside full
/// ones. It is over the pixels that both cover, and the mean over instants.
fn quality(capture: &Arc<Capture>, options: &RenderOptions) -> Result<(), Error> {
    let Some(truth) = Truth::open(&capture.folder)? else { return Ok(()) };
    let field = field(capture)?;
    println!("| true view | full | quick | quick beside full |\n|---|---|---|---|");
    // The views of one place are `t0-NAME`, `t1-NAME` and so on.
    let place =
        |view: &TruthView| view.id.split_once('-').map_or(view.id.clone(), |(_, n)| n.into());
    let mut sums: BTreeMap<String, ([f64; 3], f64)> = BTreeMap::new();
    for view in &truth.views {
        let camera = view.camera.camera()?;
        let (image, _) = read_image(&truth.file(&view.image)?)?;
        let time_s = view.time_s - capture.time_origin_s;
        let of = |detail| seen(&field, (&camera, time_s), options, detail);
        let (full, quick) = (of(Detail::Full)?, of(Detail::Quick)?);
        let covered: Vec<bool> =
            full.coverage.iter().zip(&quick.coverage).map(|(a, b)| *a && *b).collect();
        let pairs = [(&full, &image), (&quick, &image), (&quick, &full.image)];
        let (sum, count) = sums.entry(place(view)).or_default();
        for (sum, (seen, other)) in sum.iter_mut().zip(pairs) {
            *sum += psnr_db(&seen.image, other, &covered);
        }
        *count += 1.0;
    }
    for (place, (sum, count)) in sums {
        let [full, quick, beside] = sum.map(|sum| sum / count);
        println!("| {place} | {full:.2} | {quick:.2} | {beside:.2} |");
    }
    Ok(())
}

fn seen(
    field: &LightField,
    (camera, time_s): (&Camera, f64),
    options: &RenderOptions,
    detail: Detail,
) -> Result<Rendered, RenderError> {
    let request = Request::new(Viewpoint::View(camera), time_s, options);
    render(field, &Request { detail, ..request }, &Context::unattended())
}

/// PSNR over the pixels that are `covered`, dB.
fn psnr_db(a: &Image, b: &Image, covered: &[bool]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    let pixels = a.data().chunks_exact(a.channels()).zip(b.data().chunks_exact(b.channels()));
    for ((a, b), _) in pixels.zip(covered).filter(|(_, covered)| **covered) {
        sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        count += a.len() as f64;
    }
    -10.0 * (sum / f64::max(count, 1.0)).log10()
}

fn measured(
    capture: &Arc<Capture>,
    name: &'static str,
    steps: &[(Camera, f64)],
    options: &RenderOptions,
) -> Result<Sequence, Error> {
    let turn = |field: &LightField, detail: Detail| -> Result<f64, Error> {
        let mut all = Vec::new();
        for (view, time_s) in steps {
            let start = Instant::now();
            seen(field, (view, *time_s), options, detail)?;
            all.push(1000.0 * start.elapsed().as_secs_f64());
        }
        Ok(median(all))
    };
    let twice = |detail: Detail| -> Result<[f64; 2], Error> {
        let field = field(capture)?;
        Ok([turn(&field, detail)?, turn(&field, detail)?])
    };
    Ok(Sequence { name, quick_ms: twice(Detail::Quick)?, full_ms: twice(Detail::Full)? })
}

/// The capture with true clocks, or clocks as recorded if it has no truth, and nothing in memory.
fn field(capture: &Arc<Capture>) -> Result<LightField, Error> {
    let mut offsets = Offsets::known(capture);
    let truth = Truth::open(&capture.folder)?;
    for camera in &mut offsets.cameras {
        let known = truth.as_ref().map_or(camera.offset_s, |truth| truth.offset_s(&camera.id));
        camera.offset_s = Some(known.unwrap_or(0.0));
    }
    let field = LightField::new(capture.clone(), offsets);
    // As `stlfr view` does.
    field.enlarge_cache();
    Ok(field)
}
