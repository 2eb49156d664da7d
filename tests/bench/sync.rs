//! Synchronized images against the truth, method by method: PSNR over the whole image and over its moving part, and
//! milliseconds an image.
//!
//! `cargo bench --bench sync -- CAPTURE… [--sync=METHOD]`; without METHOD, of all.

use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, Truth, read_array};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::method::Method;
use stlfr::metrics::moving_part;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::Image;
use stlfr::raster::read_image;

struct Target {
    camera: usize,
    time_s: f64,
    image: Image,
    moving: Vec<bool>,
}

fn mean_square(a: &Image, b: &Image, mask: Option<&[bool]>) -> (f64, f64) {
    let (mut sum, mut n) = (0.0, 0.0);
    let channels = a.channels();
    for (k, (x, y)) in a.data().iter().zip(b.data()).enumerate() {
        if mask.is_none_or(|m| m[k / channels]) {
            sum += f64::from(x - y).powi(2);
            n += 1.0;
        }
    }
    (sum, n)
}

fn score(field: &LightField, view: &RenderOptions, targets: &[Target]) -> (f64, f64, f64) {
    let (mut whole, mut moving, mut seconds) = ((0.0, 0.0), (0.0, 0.0), 0.0);
    for t in targets {
        field.synchronized(t.camera, t.time_s, view).expect("the truth is inside the film");
        let start = Instant::now();
        let image = field.synchronized(t.camera, t.time_s, view).expect("as before").image.clone();
        seconds += start.elapsed().as_secs_f64();
        let (s, n) = mean_square(&image, &t.image, None);
        whole = (whole.0 + s, whole.1 + n);
        let (s, n) = mean_square(&image, &t.image, Some(&t.moving));
        moving = (moving.0 + s, moving.1 + n);
    }
    let psnr = |(s, n): (f64, f64)| -10.0 * (s / n).log10();
    (psnr(whole), psnr(moving), 1e3 * seconds / targets.len() as f64)
}

type Error = Box<dyn std::error::Error>;

/// The images that the truth has of the capture's cameras.
fn targets(capture: &Capture, truth: &Truth) -> Result<Vec<Target>, Error> {
    let mut targets = Vec::new();
    for view in &truth.views {
        let Some(camera) = view.like.as_ref().and_then(|id| capture.camera_index(id)) else {
            continue;
        };
        let (image, _) = read_image(&truth.file(&view.image)?)?;
        let (w, _, motion) = read_array(&truth.file(&view.motion)?)?;
        let moving = moving_part(&motion, w, 0.5, 2);
        let time_s = view.time_s - capture.time_origin_s;
        targets.push(Target { camera, time_s, image, moving });
    }
    Ok(targets)
}

fn bench(folder: &str, methods: &[SyncMethod]) -> Result<(), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    let targets = targets(&capture, &truth)?;
    // The truth's offsets: this benchmark is about interpolation alone.
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    println!("{folder}: PSNR whole, moving [dB]; ms an image, registration cached");
    let options = RenderOptions::default();
    let field = LightField::new(capture, offsets);
    for &sync in methods {
        let (whole, moving, ms) = score(&field, &options.clone().with_sync(sync), &targets);
        println!("  {:32} {whole:6.2} {moving:6.2} {ms:8.1}", format!("{sync:?}"));
    }
    Ok(())
}

fn main() -> Result<(), Error> {
    let method = std::env::args().find_map(|a| a.strip_prefix("--sync=").map(str::to_owned));
    let methods: Vec<SyncMethod> = match method {
        Some(name) => vec![SyncMethod::from_name(&name).ok_or("--sync: no such method")?],
        None => SyncMethod::ALL.to_vec(),
    };
    for folder in std::env::args().skip(1).filter(|a| !a.starts_with("--")) {
        bench(&folder, &methods)?;
    }
    Ok(())
}
