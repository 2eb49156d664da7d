//! Rolling shutters: errors of offsets, and views beside the truth, by readout, with and without the readout known.
//!
//! Without captures, two synthetic scenes are recorded by four cameras in a row: once with the same readout in all of
//! them, once with it in every second one, the others having global shutters. Captures are those of `stlfr rig
//! --readout` and `stlfr capture`, with truth.

use super::captures::outcomes;
use super::scene::{self, Board, SPACING_M, SyntheticCapture};
use super::{median, save};
use nalgebra::Isometry3;
use std::path::Path;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth};
use stlfr::chart::{Chart, Series};
use stlfr::light_field::LightField;
use stlfr::offset::{OffsetOptions, estimate};
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::progress::Reporter;
use stlfr::raster::{Image, read_image};
use stlfr::registration::{FrameStore, RegistrationOptions};

type Failure = Box<dyn std::error::Error>;

const READOUTS_MS: [f64; 6] = [0.0, 5.0, 10.0, 15.0, 20.0, 30.0];
const DELAYS: [f64; 4] = [0.0, 0.27, 0.61, 0.84];
const FRAMES: usize = 8;
/// The instants of the views, frames of the reference camera.
const INSTANTS: [f64; 3] = [2.4, 3.75, 5.2];

/// A capture with what is true of it.
struct Case {
    capture: Arc<Capture>,
    /// By camera: its offset, seconds.
    offsets_s: Vec<Option<f64>>,
    views: Vec<TrueView>,
}

struct TrueView {
    camera: Camera,
    time_s: f64,
    image: Image,
}

/// Figures with the readout known, or without.
struct Figures {
    median_frames: f64,
    worst_frames: f64,
    unknown: usize,
    /// Mean over the views, dB: blended by depth per pixel, and by scene flow.
    psnr_db: [f64; 2],
}

pub fn run(captures: &[String], output: &Path) -> Result<(), Failure> {
    println!(
        "| recording | readout, ms | | offset error, frames: median, worst | unknown | depth, dB | scene flow, dB |"
    );
    println!("|---|---|---|---|---|---|---|");
    for folder in captures {
        let case = filmed(folder.as_ref())?;
        let readout_ms = case.capture.cameras.iter().map(|c| 1e3 * c.clock.readout_s);
        both(folder, readout_ms.fold(0.0, f64::max), &case)?;
    }
    if !captures.is_empty() {
        return Ok(());
    }
    let mut charts = Vec::new();
    let scenes = [("boards", scene::random_boards(3)), ("swing", scene::aperiodic_boards(5))];
    for (name, boards) in &scenes {
        for (which, step) in [("all", 1), ("every second", 2)] {
            let lines = sweep(&format!("{name}, {which}"), boards, step)?;
            charts.extend(drawn(&format!("{name}, {which} rolling"), lines));
        }
    }
    save(output, "rolling", &charts)
}

/// The figures by readout, each with and without the readout known.
fn sweep(name: &str, boards: &[Board], step: usize) -> Result<Vec<(f64, [Figures; 2])>, Failure> {
    let mut lines = Vec::new();
    for readout_ms in READOUTS_MS {
        let mut synthetic = SyntheticCapture::new(boards.to_vec(), &DELAYS, FRAMES);
        synthetic.readouts_s.iter_mut().step_by(step).for_each(|s| *s = 1e-3 * readout_ms);
        let folder = tempfile::tempdir()?;
        let case = synthesized(&synthetic, folder.path())?;
        lines.push((readout_ms, both(name, readout_ms, &case)?));
    }
    Ok(lines)
}

/// The charts of offsets' errors and of views.
fn drawn(title: &str, lines: Vec<(f64, [Figures; 2])>) -> [Chart; 2] {
    let series = |labels: [&str; 2], value: &dyn Fn(&Figures) -> f64| {
        [0, 1].map(|known| Series {
            label: labels[known].into(),
            points: lines.iter().map(|(ms, both)| (*ms, value(&both[known])).into()).collect(),
            line: true,
            dots: true,
            ..Series::default()
        })
    };
    let labels = ["readout known", "readout unknown"];
    let chart = |what: &str, y_label: &str, series: Vec<Series>, log_y: bool| Chart {
        title: format!("{title}: {what}"),
        x_label: "readout, ms".into(),
        y_label: y_label.into(),
        log_y,
        series,
        ..Chart::default()
    };
    let errors = series(labels, &|f| f.worst_frames);
    let depth = series(["depth, readout known", "depth, unknown"], &|f| f.psnr_db[0]);
    let flow = series(["scene flow, readout known", "scene flow, unknown"], &|f| f.psnr_db[1]);
    [
        chart("worst offset error", "frames", errors.into(), true),
        chart("views", "PSNR, dB", depth.into_iter().chain(flow).collect(), false),
    ]
}

/// Measures a capture with its readout, then without, and prints both.
fn both(name: &str, readout_ms: f64, case: &Case) -> Result<[Figures; 2], Failure> {
    let mut global = (*case.capture).clone();
    global.cameras.iter_mut().for_each(|c| c.clock.readout_s = 0.0);
    let figures = [figures(case, case.capture.clone())?, figures(case, Arc::new(global))?];
    for (known, f) in ["known", "unknown"].iter().zip(&figures) {
        let Figures { median_frames, worst_frames, unknown, psnr_db: [depth, flow] } = f;
        println!(
            "| {name} | {readout_ms:.0} | {known} | {median_frames:.4}, {worst_frames:.4} | {unknown} | {depth:.2} | {flow:.2} |"
        );
    }
    Ok(figures)
}

fn figures(case: &Case, capture: Arc<Capture>) -> Result<Figures, Failure> {
    let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let found = estimate(&frames, &OffsetOptions::default(), &Reporter::silent())?;
    let truth_s = |id: &str| case.offsets_s[capture.camera_index(id)?];
    let (outcomes, unknown) = outcomes(&found.offsets, capture.frame_s(), truth_s);
    let errors: Vec<f64> = outcomes.iter().map(|o| o.error_frames.abs()).collect();
    let field = LightField::with_frames(&frames, found.offsets);
    let mut psnr_db = [0.0; 2];
    for (db, method) in psnr_db.iter_mut().zip([ProxyMethod::Depth, ProxyMethod::SceneFlow]) {
        let mut options = RenderOptions::default();
        options.proxy.method = method;
        for view in &case.views {
            let rendered = field.view(&view.camera, view.time_s, &options)?;
            *db += psnr(&rendered.image, &view.image) / case.views.len() as f64;
        }
    }
    let worst_frames = errors.iter().copied().fold(0.0, f64::max);
    Ok(Figures { median_frames: median(&errors), worst_frames, unknown, psnr_db })
}

/// Without a border, where fewer cameras see the scene.
fn psnr(image: &Image, truth: &Image) -> f64 {
    let (image, truth) = (image.to_gray(), truth.to_gray());
    let (w, h) = (truth.width(), truth.height());
    let (mut sum, mut count) = (0.0, 0.0);
    for y in h / 10..h - h / 10 {
        for x in w / 10..w - w / 10 {
            sum += f64::from(image.pixel(x, y)[0] - truth.pixel(x, y)[0]).powi(2);
            count += 1.0;
        }
    }
    -10.0 * (sum / count).log10()
}

fn synthesized(synthetic: &SyntheticCapture, folder: &Path) -> Result<Case, Failure> {
    let offsets_s = synthetic.write(folder)?;
    let capture = Arc::new(Capture::open(folder)?);
    let reference = &capture.cameras[capture.reference];
    let delay_s = synthetic.delays_s[capture.reference];
    let views = INSTANTS.map(|frames| {
        let time_s = frames * capture.frame_s();
        // A quarter of the distance between two cameras, off their line by a tenth.
        let [x, y] = [0.25 * SPACING_M, -0.1 * SPACING_M];
        let cam_from_world = Isometry3::translation(-x, -y, 0.0);
        let camera = Camera { cam_from_world, ..reference.camera.clone() };
        TrueView { camera, time_s, image: synthetic.true_view([x, y], time_s + delay_s) }
    });
    let offsets_s = offsets_s.into_iter().map(Some).collect();
    Ok(Case { capture, offsets_s, views: views.into() })
}

fn filmed(folder: &Path) -> Result<Case, Failure> {
    let capture = Arc::new(Capture::open(folder)?);
    let truth = Truth::open(folder)?.ok_or("the capture has no truth")?;
    let offsets_s = capture.cameras.iter().map(|c| truth.offset_s(&c.id)).collect();
    let mut views = Vec::new();
    for view in truth.views.iter().filter(|v| v.like.is_none()) {
        let (image, _) = read_image(&truth.file(&view.image)?)?;
        let time_s = view.time_s - capture.time_origin_s;
        views.push(TrueView { camera: view.camera.clone().camera()?, time_s, image });
    }
    Ok(Case { capture, offsets_s, views })
}
