//! The same scenes filmed by two arrays: one whose cameras are synchronized, and one whose are not.
//!
//! Between frames, a synchronized array has no camera that is near the instant; the other has some. Which array
//! gives the better view, by how much, against how fast things move.

use super::truth::{True, psnr_db};
use super::{Error, cameras_at, instants_s, open};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth};
use stlfr::chart::{Chart, Label, Series, svg};
use stlfr::light_field::LightField;
use stlfr::lumigraph::BlendMethod;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;

/// Distance from the synchronized array's nearest frame, in frames, from which an instant counts as between its
/// frames. Smaller: that array hardly interpolates; larger: instants are left out.
const BETWEEN_FRAMES: f64 = 0.1;
/// Largest difference of the two arrays' cameras, metres.
const SAME_M: f64 = 1e-6;
/// How views are rendered: over depth per pixel by two weights, and by scene flow.
const METHODS: [&str; 3] = ["depth, by place", "depth, by place and time", "scene flow"];
/// Motion over which bodies count as fast, pixels per frame.
const FAST_PX: f64 = 20.0;

/// The two arrays' views at one instant of one scene.
struct Pair {
    scene: String,
    /// Median and 90th percentile of the motion of what moves, pixels a frame.
    motion_px: [f64; 2],
    /// Of each method: PSNR of the moving part, synchronized and not.
    db: [[f64; 2]; METHODS.len()],
}

impl Pair {
    /// PSNR that the array which is not synchronized gives by a method, minus the best that the synchronized one gives by
    /// any: each array by what suits it.
    fn gain_db(&self, method: usize) -> f64 {
        let best = self.db.iter().map(|[synchronized, _]| *synchronized).fold(f64::MIN, f64::max);
        self.db[method][1] - best
    }
}

/// Compares each capture with the one of the same name in a folder; draws an SVG.
pub fn bench(folders: &[String], synchronized: &Path, out: &Path) -> Result<(), Error> {
    let mut pairs = Vec::new();
    println!(
        "PSNR of the moving part, dB: synchronized, not synchronized, gain over the best of the synchronized\n\
         | scene | instant | frames from the synchronized | motion, median and 90 %, px a frame | {} |",
        METHODS.join(" | ")
    );
    println!("|---|---|---|---|{}", "---|".repeat(METHODS.len()));
    std::fs::create_dir_all(out.parent().ok_or("has no folder")?)?;
    for folder in folders {
        let name = Path::new(folder).file_name().ok_or("has no name")?;
        pairs.extend(compare(folder, &synchronized.join(name))?);
        // After every scene: what was measured isn't lost if the run is stopped.
        std::fs::write(out, svg(&[chart(&pairs)], 1))?;
    }
    for (k, method) in METHODS.iter().enumerate() {
        let gains = || pairs.iter().map(|p| p.gain_db(k));
        let fast = pairs.iter().filter(|p| p.motion_px[0] > FAST_PX).map(|p| p.gain_db(k));
        println!(
            "gain, {method}: mean {:+.2} dB, over {FAST_PX} px {:+.2} dB, worst {:+.2} dB",
            super::summary::mean(gains()),
            super::summary::mean(fast),
            gains().fold(f64::INFINITY, f64::min)
        );
    }
    println!("{}", out.display());
    Ok(())
}

/// The light field of the synchronized array: its clocks are one.
fn open_synchronized(folder: &Path) -> Result<LightField, Error> {
    let capture = Arc::new(Capture::open(folder)?);
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = Some(0.0);
    }
    Ok(LightField::new(capture, offsets))
}

fn compare(folder: &str, synchronized: &Path) -> Result<Vec<Pair>, Error> {
    let (field, truth) = open(folder)?;
    let together = open_synchronized(synchronized)?;
    let cameras = |f: &LightField| -> Vec<Camera> {
        f.capture().cameras.iter().map(|c| c.camera.clone()).collect()
    };
    let differ = |(a, b): (&Camera, &Camera)| (a.center() - b.center()).norm() > SAME_M;
    if cameras(&field).iter().zip(&cameras(&together)).any(differ) {
        return Err(format!("{folder}: {} has other cameras", synchronized.display()).into());
    }
    let name = Path::new(folder).file_name().unwrap_or_default().to_string_lossy().into_owned();
    instants_s(&truth)
        .into_iter()
        .filter(|t| from_frames(together.capture(), *t) >= BETWEEN_FRAMES)
        .map(|t| pair(&name, [&together, &field], &truth, t))
        .collect()
}

/// Distance of an instant from the nearest frame of cameras that are synchronized, frames.
fn from_frames(capture: &Capture, time_s: f64) -> f64 {
    let times_s = &capture.cameras[0].clock.times_s;
    let distances = times_s.iter().map(|t| (t + capture.time_origin_s - time_s).abs());
    distances.fold(f64::MAX, f64::min) / capture.frame_s()
}

fn pair(name: &str, fields: [&LightField; 2], truth: &Truth, time_s: f64) -> Result<Pair, Error> {
    let view = truth.views.iter().find(|v| v.time_s == time_s && v.like.is_none());
    let target = True::read(truth, view.ok_or("the truth has no view")?)?;
    let cameras = cameras_at(fields[1].capture(), truth, time_s)?;
    let moving = target.moving_of(&target.seen(&cameras));
    let mut db = [[0.0; 2]; METHODS.len()];
    for (k, field) in fields.into_iter().enumerate() {
        let at_s = time_s - field.capture().time_origin_s;
        let images = views(field, &target.camera, at_s)?;
        for (db, image) in db.iter_mut().zip(&images) {
            db[k] = psnr_db(image, &target.image, &moving);
        }
    }
    let motion_px = motion(&target, &moving);
    let pair = Pair { scene: name.to_owned(), motion_px, db };
    let figures = pair.db.iter().enumerate();
    let figures: Vec<String> =
        figures.map(|(k, [a, b])| format!("{a:.2}, {b:.2}, {:+.2}", pair.gain_db(k))).collect();
    println!(
        "| {name} | {time_s:.4} | {:.2} | {:.1}, {:.1} | {} |",
        from_frames(fields[0].capture(), time_s),
        pair.motion_px[0],
        pair.motion_px[1],
        figures.join(" | "),
    );
    Ok(pair)
}

/// The final view at an instant, by each of [`METHODS`].
fn views(field: &LightField, target: &Camera, at_s: f64) -> Result<[Image; METHODS.len()], Error> {
    let mut options = RenderOptions::default();
    let mut of = |proxy, blend| {
        (options.proxy.method, options.blend.method) = (proxy, blend);
        field.view(target, at_s, &options)
    };
    let by_place = of(ProxyMethod::Depth, BlendMethod::Lumigraph)?;
    let by_time = of(ProxyMethod::Depth, BlendMethod::SpaceTime)?;
    let flow = of(ProxyMethod::SceneFlow, BlendMethod::SpaceTime)?;
    Ok([by_place, by_time, flow].map(|r| r.image))
}

/// Median and 90th percentile over the moving part.
fn motion(target: &True, moving: &[bool]) -> [f64; 2] {
    let counted = target.motion_px.iter().zip(moving).filter(|(m, moves)| **moves && m.is_finite());
    let mut px: Vec<f64> = counted.map(|(m, _)| f64::from(*m)).collect();
    px.sort_by(f64::total_cmp);
    [0.5, 0.9].map(|q| px.get((q * px.len() as f64) as usize).copied().unwrap_or(f64::NAN))
}

/// The gain of the array that is not synchronized, against motion.
fn chart(pairs: &[Pair]) -> Chart {
    let series = METHODS.iter().enumerate().map(|(k, method)| Series {
        label: (*method).to_owned(),
        points: pairs.iter().map(|p| (p.motion_px[0], p.gain_db(k)).into()).collect(),
        dots: true,
        ..Series::default()
    });
    let label = |p: &Pair| Label {
        x: p.motion_px[0],
        y: p.gain_db(METHODS.len() - 1),
        text: p.scene.clone(),
        bold: false,
    };
    Chart {
        title: "Views between the frames of a synchronized array".into(),
        x_label: "motion of the moving part, pixels a frame (median)".into(),
        y_label: "gain of unsynchronized cameras, dB".into(),
        rules: vec![(0.0, String::new())],
        series: series.collect(),
        labels: pairs.iter().map(label).collect(),
        ..Chart::default()
    }
}

/// Where the plot goes if nothing else is said.
pub fn default_out() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("target/picture/synchronized.svg")
}
