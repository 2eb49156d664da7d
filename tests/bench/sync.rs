//! Synchronized images against the truth, method by method and option by option: PSNR over the whole
//! image and over its moving part, and milliseconds an image.
//!
//! `cargo bench --bench sync -- CAPTURE… [--sync=METHOD] [--sweep | --sweep=NAME]`; without METHOD, of all.

use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, Truth, read_array};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::method::Method;
use stlfr::metrics::moving_part;
use stlfr::offset::Offsets;
use stlfr::options::{RenderOptions, ViewOptions};
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

fn score(field: &LightField, view: &ViewOptions, targets: &[Target]) -> (f64, f64, f64) {
    let (mut whole, mut moving, mut seconds) = ((0.0, 0.0), (0.0, 0.0), 0.0);
    for t in targets {
        field.synchronized(t.camera, t.time_s, view).expect("the truth is inside the film");
        let start = Instant::now();
        let image = field.synchronized(t.camera, t.time_s, view).expect("as before").image;
        seconds += start.elapsed().as_secs_f64();
        let (s, n) = mean_square(&image, &t.image, None);
        whole = (whole.0 + s, whole.1 + n);
        let (s, n) = mean_square(&image, &t.image, Some(&t.moving));
        moving = (moving.0 + s, moving.1 + n);
    }
    let psnr = |(s, n): (f64, f64)| -10.0 * (s / n).log10();
    (psnr(whole), psnr(moving), 1e3 * seconds / targets.len() as f64)
}

/// A change of the options, under a name.
type Case = (String, Change);
type Change = Box<dyn Fn(&mut RenderOptions)>;

/// What can be switched off.
fn general_cases(cases: &mut Vec<Case>) {
    cases.push(("straight".into(), Box::new(|o| o.interpolation.curved = false)));
    cases.push(("no epipolar".into(), Box::new(|o| o.registration.epipolar_test = false)));
    cases.push(("ends only".into(), Box::new(|o| o.interpolation.edges.all_features = false)));
}

/// Options of the refinement.
fn refine_cases(cases: &mut Vec<Case>) {
    for s in [0.01, 0.02, 0.03] {
        for c in [0.06, 0.1, 0.14] {
            cases.push((
                format!("refine softness {s} one frame {c}"),
                Box::new(move |o| {
                    o.interpolation.refine.softness = s;
                    o.interpolation.refine.one_frame_cost = c;
                }),
            ));
        }
    }
    for r in [1, 3] {
        cases.push((
            format!("refine window {r}"),
            Box::new(move |o| o.interpolation.refine.window_radius_px = r),
        ));
    }
    for d in [0.02, 0.05] {
        cases.push((
            format!("refine difference {d}"),
            Box::new(move |o| o.interpolation.refine.min_difference = d),
        ));
    }
    for d in [0.75, 3.0] {
        cases.push((
            format!("refine same {d}"),
            Box::new(move |o| o.interpolation.refine.same_motion_px = d),
        ));
    }
    for r in [20.0, 40.0] {
        cases.push((
            format!("refine search {r}"),
            Box::new(move |o| o.interpolation.refine.search_radius_px = r),
        ));
    }
    cases.push(("refine outer 0".into(), Box::new(|o| o.interpolation.refine.outer_share = 0.0)));
    for n in [2, 3, 4] {
        cases.push((
            format!("refine motions {n}"),
            Box::new(move |o| o.interpolation.refine.max_motions = n),
        ));
    }
}

/// Options of the morph and its edges.
fn morph_cases(cases: &mut Vec<Case>) {
    for b in [2.0, 3.0, 4.0] {
        for a in [0.5, 1.0, 2.0, 4.0] {
            cases.push((
                format!("a {a} b {b}"),
                Box::new(move |o| {
                    o.interpolation.morph.a = a;
                    o.interpolation.morph.b = b;
                }),
            ));
        }
    }
    for tau in [0.0, 2.0, 4.0, 6.0] {
        cases.push((format!("tau {tau}"), Box::new(move |o| o.interpolation.morph.tau = tau)));
    }
    for grid in [1, 2, 8] {
        cases.push((
            format!("grid {grid}"),
            Box::new(move |o| o.interpolation.morph.grid_px = grid),
        ));
    }
    for f in [0.04, 0.12, 0.2] {
        cases.push((
            format!("fitness {f}"),
            Box::new(move |o| o.interpolation.edges.min_fitness = f),
        ));
    }
}

/// Options of registration.
fn registration_cases(cases: &mut Vec<Case>) {
    for r in [3, 4, 7] {
        cases.push((format!("radius {r}"), Box::new(move |o| o.registration.klt.radius_px = r)));
    }
    for d in [3.0, 6.0] {
        cases.push((
            format!("distance {d}"),
            Box::new(move |o| o.registration.corners.min_distance_px = d),
        ));
    }
    for q in [1e-4, 1e-2] {
        cases.push((
            format!("quality {q}"),
            Box::new(move |o| o.registration.corners.min_quality = q),
        ));
    }
    for e in [1.0, 1.5, 5.0] {
        cases.push((format!("epsilon {e}"), Box::new(move |o| o.registration.epsilon_px = e)));
    }
    for e in [0.3, 1.5] {
        cases.push((
            format!("forward-backward error {e}"),
            Box::new(move |o| o.registration.max_back_error_px = e),
        ));
    }
    for s in [0, 4] {
        cases.push((format!("support {s}"), Box::new(move |o| o.registration.min_support = s)));
    }
}

/// All cases, in the order of the stages they change; of a name, those that contain it.
fn cases(only: Option<&str>) -> Vec<Case> {
    let mut cases = Vec::new();
    general_cases(&mut cases);
    refine_cases(&mut cases);
    morph_cases(&mut cases);
    registration_cases(&mut cases);
    cases.retain(|(name, _)| only.is_none_or(|only| name.contains(only)));
    cases
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

fn bench(folder: &str, methods: &[SyncMethod], cases: &[Case]) -> Result<(), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    let targets = targets(&capture, &truth)?;
    // The truth's offsets: this benchmark is about interpolation alone.
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    let field = |change: &dyn Fn(&mut RenderOptions)| {
        let mut options = RenderOptions::default();
        change(&mut options);
        let field = LightField::new(capture.clone(), offsets.clone(), &options.registration);
        (field, options.view())
    };
    println!("{folder}: PSNR whole, moving [dB]; ms an image, registration cached");
    let (default, view) = field(&|_| ());
    for &sync in methods {
        let (whole, moving, ms) = score(&default, &view.clone().with_sync(sync), &targets);
        println!("  {:32} {whole:6.2} {moving:6.2} {ms:8.1}", format!("{sync:?}"));
    }
    for (name, change) in cases {
        let sync =
            if name.starts_with("refine") { SyncMethod::Refined } else { SyncMethod::EdgeMorph };
        let (field, view) = field(change);
        let (whole, moving, ms) = score(&field, &view.with_sync(sync), &targets);
        println!("  {name:32} {whole:6.2} {moving:6.2} {ms:8.1}");
    }
    Ok(())
}

fn main() -> Result<(), Error> {
    let sweep = std::env::args().any(|a| a.starts_with("--sweep"));
    let only = std::env::args().find_map(|a| a.strip_prefix("--sweep=").map(str::to_owned));
    let cases = if sweep { cases(only.as_deref()) } else { Vec::new() };
    let method = std::env::args().find_map(|a| a.strip_prefix("--sync=").map(str::to_owned));
    let methods: Vec<SyncMethod> = match method {
        Some(name) => vec![SyncMethod::from_name(&name).ok_or("--sync: no such method")?],
        None => SyncMethod::ALL.to_vec(),
    };
    for folder in std::env::args().skip(1).filter(|a| !a.starts_with("--")) {
        bench(&folder, &methods, &cases)?;
    }
    Ok(())
}
