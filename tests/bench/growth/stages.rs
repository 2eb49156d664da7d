//! Processor time of each stage, over films that grow in one thing.

use super::fit::growth;
use super::{Done, folder};
use crate::swing::{RATE_HZ, Swing};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::chart::{Chart, Series};
use stlfr::host::process_cpu_s;
use stlfr::interpolation::{EdgeFeature, SyncMethod, edge_set, real_edges};
use stlfr::light_field::{Context, LightField, Request, Viewpoint};
use stlfr::offset::{self, Offsets};
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::registration::{FrameStore, epipolar_check, temporal_flow};

/// What is timed, in the order of the pipeline.
const STAGES: [&str; 8] = [
    "registration",
    "offsets",
    "triangulation",
    "edge-morph",
    "refined",
    "proxy",
    "blend",
    "a new view, all",
];

/// One film of a series.
pub struct Case {
    /// What grows.
    pub size: f64,
    pub swing: Swing,
    pub options: RenderOptions,
}

/// Runs a series of films, smallest first; prints a table with exponents, and returns its plot.
pub fn series(name: &str, what: &str, cases: &[Case]) -> Done<Chart> {
    println!("\nProcessor time [ms] by {what}");
    println!("| {what} | features | edges of the morph, real ones | {} |", STAGES.join(" | "));
    println!("|---|---|---|{}", "---|".repeat(STAGES.len()));
    let mut all: Vec<Vec<(f64, f64)>> = vec![Vec::new(); STAGES.len()];
    for case in cases {
        let (features, [edges, real], costs) = measure(name, case)?;
        let row: Vec<String> = costs.iter().map(|ms| format!("{ms:.1}")).collect();
        println!("| {} | {features} | {edges}, {real} | {} |", case.size, row.join(" | "));
        for (points, ms) in all.iter_mut().zip(costs) {
            points.push((case.size, ms));
        }
    }
    let fits: Vec<_> = all.iter().map(|points| growth(points)).collect();
    let row: Vec<String> =
        fits.iter().map(|f| format!("{:.2} ± {:.2}", f.exponent, f.std_err)).collect();
    println!("| exponent | | | {} |", row.join(" | "));
    let last = |points: &[(f64, f64)]| growth(&points[points.len() - 2..]).exponent;
    let row: Vec<String> = all.iter().map(|points| format!("{:.2}", last(points))).collect();
    println!("| of the last step | | | {} |", row.join(" | "));
    let costs = || all.iter().flatten().map(|p| p.1);
    let (min, max) = (costs().fold(f64::INFINITY, f64::min), costs().fold(0.0, f64::max));
    let series = STAGES
        .iter()
        .zip(&all)
        .zip(&fits)
        .map(|((stage, points), fit)| Series {
            label: format!("{stage}: {:.2}", fit.exponent),
            points: points.iter().map(|p| (*p).into()).collect(),
            line: true,
            dots: true,
            ..Series::default()
        })
        .collect();
    Ok(Chart {
        title: format!("Time by {what}, and its exponents"),
        x_label: what.into(),
        y_label: "processor time, ms".into(),
        log_x: true,
        log_y: true,
        // Room for the names above the lines.
        y_shows: Some((min, 100.0 * max)),
        series,
        ..Chart::default()
    })
}

/// All edges of `edge-morph` and the real ones, of a pair of frames warped halfway.
fn edges(
    field: &LightField,
    (camera, k): (usize, usize),
    options: &RenderOptions,
) -> Done<[usize; 2]> {
    let tracks = field.tracks(camera, k, &options.registration)?;
    let features: Vec<EdgeFeature> = (tracks.iter().filter(|track| track.in_forward_set()))
        .map(|track| {
            let (source, other) = (track.earlier, track.later);
            EdgeFeature { source, other, target: nalgebra::center(&source, &other) }
        })
        .collect();
    let [source, other] = [k, k + 1].map(|k| field.frames(&options.registration).get(camera, k));
    let (source, other) = (source?, other?);
    let [a, b] = [&source, &other].map(|frame| &frame.pyramid.levels[0]);
    let real = real_edges(&features, a, b, options.interpolation.max_edge_length_px);
    let (w, h) = (source.image.width(), source.image.height());
    let all = edge_set(&features, &real, w, h);
    Ok([all.len(), all.iter().filter(|edge| edge.mean_fitness.is_some()).count()])
}

/// Features of a frame, edges, and milliseconds of every stage.
fn measure(name: &str, case: &Case) -> Done<(usize, [usize; 2], [f64; STAGES.len()])> {
    let film = folder(name)?;
    case.swing.film(&film);
    let capture = Arc::new(Capture::open(&film)?);
    let (options, reference) = (&case.options, case.swing.reference());
    let frame_s = 1.0 / RATE_HZ;
    // Between two frames of the middle of the film.
    let k = case.swing.frames / 2 - 1;
    let time_s = (k as f64 + 0.45) * frame_s;

    let store = FrameStore::new(capture.clone(), &options.registration);
    let times: Vec<_> = capture.cameras.iter().map(|c| Some(c.clock.times_s.clone())).collect();
    let features = store.get(reference, k)?.corners(&options.registration).len();
    let (_, registration) = timed(|| {
        let tracks = temporal_flow(&store, reference, k)?;
        epipolar_check(&store, &times, reference, k, &tracks)
    });
    drop(store);
    let (_, offsets) = timed(|| {
        let frames = FrameStore::new(capture.clone(), &options.registration);
        offset::estimate(&frames, &options.offset, &Reporter::silent())
    });

    let known = true_offsets(&capture, &case.swing);
    let field = LightField::new(capture.clone(), known.clone());
    let mut costs = vec![registration, offsets];
    for sync in [SyncMethod::Triangulation, SyncMethod::EdgeMorph, SyncMethod::Refined] {
        // Frames and tracks are there already: registration has a column of its own.
        let view = RenderOptions { sync, ..options.clone() };
        field.synchronized(reference, time_s, &view)?;
        costs.push(timed(|| field.synchronized(reference, time_s, &view)).1);
    }
    let edges = edges(&field, (reference, k), options)?;
    let target = case.swing.camera([0.4, 0.0]);
    let images = field.synchronized_all(
        time_s,
        &RenderOptions { sync: SyncMethod::Crossfade, ..options.clone() },
        &Context::unattended(),
    )?;
    let request = Request::new(Viewpoint::View(&target), time_s, options);
    let (geometry, cost) = timed(|| field.geometry(&target, &request));
    costs.push(cost);
    let geometry = geometry?;
    costs.push(timed(|| field.blend(&images, &geometry, &target, &options.blend)).1);
    let fresh = LightField::new(capture, known);
    let (view, cost) = timed(|| fresh.view(&target, time_s, options));
    view?;
    costs.push(cost);
    std::fs::remove_dir_all(&film)?;
    Ok((features, edges, costs.try_into().expect("a cost for each stage")))
}

fn true_offsets(capture: &Capture, swing: &Swing) -> Offsets {
    let mut offsets = Offsets::known(capture);
    for (c, camera) in offsets.cameras.iter_mut().enumerate() {
        camera.offset_s = Some(swing.delay_frames(c) / RATE_HZ);
    }
    offsets
}

/// A result, and its milliseconds of processor time over all threads.
fn timed<T>(run: impl FnOnce() -> T) -> (T, f64) {
    let start = process_cpu_s();
    let result = run();
    (result, 1e3 * (process_cpu_s() - start))
}
