//! Rolling shutters: errors of offsets, and views beside the truth, by readout: with the readout known, estimated with
//! the offsets from a guess, and ignored.
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

/// The guessed readout and its standard error, if it is estimated.
const GUESS_MS: [f64; 2] = [15.0, 10.0];
const LABELS: [&str; 3] = ["known", "estimated", "ignored"];

/// Figures with the readout known, estimated or ignored.
struct Figures {
    median_frames: f64,
    worst_frames: f64,
    /// Offsets within two standard errors, of those that are known.
    within: [usize; 2],
    unknown: usize,
    /// Median error of the readout's differences from the reference camera's, milliseconds; NaN unless estimated.
    readout_error_ms: f64,
    /// Mean over the views, dB: blended by depth per pixel, and by scene flow.
    psnr_db: [f64; 2],
}

pub fn run(captures: &[String], output: &Path) -> Result<(), Failure> {
    println!(
        "| recording | readout, ms | | offset error, frames: median, worst | within 2 std. errors | unknown | readout difference off by, ms | depth, dB | scene flow, dB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for folder in captures {
        let case = filmed(folder.as_ref())?;
        let readout_ms = case.capture.cameras.iter().map(|c| 1e3 * c.clock.readout_s);
        all(folder, readout_ms.fold(0.0, f64::max), &case)?;
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

/// The figures by readout.
fn sweep(name: &str, boards: &[Board], step: usize) -> Result<Vec<(f64, [Figures; 3])>, Failure> {
    let mut lines = Vec::new();
    for readout_ms in READOUTS_MS {
        let mut synthetic = SyntheticCapture::new(boards.to_vec(), &DELAYS, FRAMES);
        synthetic.readouts_s.iter_mut().step_by(step).for_each(|s| *s = 1e-3 * readout_ms);
        let folder = tempfile::tempdir()?;
        let case = synthesized(&synthetic, folder.path())?;
        lines.push((readout_ms, all(name, readout_ms, &case)?));
    }
    Ok(lines)
}

/// The charts of offsets' errors and of views.
fn drawn(title: &str, lines: Vec<(f64, [Figures; 3])>) -> [Chart; 2] {
    let series = |of: &str, value: &dyn Fn(&Figures) -> f64| {
        [0, 1, 2].map(|k| Series {
            label: format!("{of}readout {}", LABELS[k]),
            points: lines.iter().map(|(ms, all)| (*ms, value(&all[k])).into()).collect(),
            line: true,
            dots: true,
            ..Series::default()
        })
    };
    let chart = |what: &str, y_label: &str, series: Vec<Series>, log_y: bool| Chart {
        title: format!("{title}: {what}"),
        x_label: "readout, ms".into(),
        y_label: y_label.into(),
        log_y,
        series,
        ..Chart::default()
    };
    let errors = series("", &|f| f.worst_frames);
    let flow = series("", &|f| f.psnr_db[1]);
    [
        chart("worst offset error", "frames", errors.into(), true),
        chart("views, scene flow", "PSNR, dB", flow.into(), false),
    ]
}

/// Measures a capture with its readouts, with guessed ones, and without, and prints all.
fn all(name: &str, readout_ms: f64, case: &Case) -> Result<[Figures; 3], Failure> {
    let with = |readout_ms: f64, std_ms: f64| {
        let mut changed = (*case.capture).clone();
        for camera in &mut changed.cameras {
            camera.clock.readout_s = 1e-3 * readout_ms;
            camera.clock.readout_std_s = 1e-3 * std_ms;
        }
        Arc::new(changed)
    };
    let captures = [case.capture.clone(), with(GUESS_MS[0], GUESS_MS[1]), with(0.0, 0.0)];
    let mut all = Vec::new();
    for (label, capture) in LABELS.iter().zip(captures) {
        let f = figures(case, capture)?;
        let Figures { median_frames, worst_frames, unknown, psnr_db: [depth, flow], .. } = &f;
        let ([within, of], off_ms) = (f.within, f.readout_error_ms);
        let off = if off_ms.is_nan() { String::new() } else { format!("{off_ms:.2}") };
        println!(
            "| {name} | {readout_ms:.0} | {label} | {median_frames:.4}, {worst_frames:.4} | {within} of {of} | {unknown} | {off} | {depth:.2} | {flow:.2} |"
        );
        all.push(f);
    }
    all.try_into().map_err(|_| "three figures".into())
}

fn figures(case: &Case, capture: Arc<Capture>) -> Result<Figures, Failure> {
    let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
    let found = estimate(&frames, &OffsetOptions::default(), &Reporter::silent())?;
    let truth_s = |id: &str| case.offsets_s[capture.camera_index(id)?];
    let (outcomes, unknown) = outcomes(&found.offsets, capture.frame_s(), truth_s);
    let errors: Vec<f64> = outcomes.iter().map(|o| o.error_frames.abs()).collect();
    let within = outcomes.iter().filter(|o| o.z().abs() <= 2.0).count();
    let estimated = found.offsets.cameras.iter().map(|c| c.readout_s);
    let true_s = case.capture.cameras.iter().map(|c| c.clock.readout_s);
    let off: Vec<Option<f64>> =
        estimated.zip(true_s).map(|(s, true_s)| Some(1e3 * (s? - true_s))).collect();
    let differences = off.iter().enumerate().filter(|(c, _)| *c != capture.reference);
    let differences: Vec<f64> =
        differences.filter_map(|(_, d)| Some(((*d)? - off[capture.reference]?).abs())).collect();
    let readout_error_ms = if differences.is_empty() { f64::NAN } else { median(&differences) };
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
    let (median_frames, within) = (median(&errors), [within, errors.len()]);
    Ok(Figures { median_frames, worst_frames, within, unknown, readout_error_ms, psnr_db })
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
