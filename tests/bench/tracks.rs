//! Tracks against the truth, scene by scene.
//!
//! `cargo bench --bench tracks`

#[path = "../common/bodies.rs"]
#[allow(dead_code)]
mod bodies;
mod cpu;
#[path = "../common/worlds.rs"]
mod worlds;

use nalgebra::{Point2, Vector2};
use std::path::PathBuf;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::registration::{FrameStore, RegistrationOptions, Run, Track, temporal_flow};
use worlds::Case;

const FRAMES: usize = 8;
const DELAYS: [f64; 3] = [0.0, 0.37, 0.71];

fn filmed(case: &Case) -> (PathBuf, Vec<Camera>) {
    let cameras = worlds::line_rig(3, 640);
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(".captures/bodies").join(case.name);
    if !folder.join("capture.json").exists() {
        bodies::film(&case.world, &cameras, &DELAYS, FRAMES, 0.009, &folder);
    }
    (folder, cameras)
}

/// Whether everything within a radius shows the same body.
fn is_interior(case: &Case, camera: &Camera, p: &Point2<f64>, time: f64, radius: f64) -> bool {
    let body = |p: &Point2<f64>| case.world.seen(camera, p, time).map(|s| s.body);
    let middle = body(p);
    (0..8).all(|k| {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_4;
        body(&(p + radius * Vector2::new(angle.cos(), angle.sin()))) == middle
    })
}

fn quantile(v: &mut [f64], q: f64) -> f64 {
    if v.is_empty() {
        return f64::NAN;
    }
    v.sort_by(f64::total_cmp);
    v[((v.len() - 1) as f64 * q) as usize]
}

struct Scores {
    /// All, then interior of the moving body: end to end and at the middle.
    all: Vec<f64>,
    moving: Vec<f64>,
    middle: Vec<f64>,
    /// Path at the middle with the true positions: curvature's error alone.
    ideal: Vec<f64>,
    seconds: f64,
}

fn score(case: &Case, options: &RegistrationOptions) -> Scores {
    let (folder, cameras) = filmed(case);
    let capture = Arc::new(Capture::open(&folder).expect("a capture"));
    let mut scores =
        Scores { all: vec![], moving: vec![], middle: vec![], ideal: vec![], seconds: 0.0 };
    let store = FrameStore::new(capture.clone(), options);
    let (c, world) = (1, &case.world);
    let times: Vec<f64> = (0..FRAMES).map(|k| DELAYS[c] + k as f64).collect();
    for k in [2] {
        for n in k - 1..=k + 2 {
            let _ = store.get(c, n).expect("a frame").corners(options);
        }
        let start = cpu::seconds();
        let tracks = temporal_flow(&store, c, k).expect("tracks");
        scores.seconds += cpu::seconds() - start;
        for t in &tracks {
            let (from, at, to) =
                if t.run == Run::Backward { (k + 1, t.later, k) } else { (k, t.earlier, k + 1) };
            let Some(surface) = world.seen(&cameras[c], &at, times[from]) else { continue };
            let place = |time: f64| world.position(&surface, &cameras[c], time);
            let found = if t.run == Run::Backward { t.earlier } else { t.later };
            let Some(truth) = place(times[to]) else { continue };
            let error = (found - truth).norm();
            scores.all.push(error);
            if surface.body == 0
                || !is_interior(case, &cameras[c], &at, times[from], 14.0)
                || !is_interior(case, &cameras[c], &truth, times[to], 14.0)
            {
                continue;
            }
            scores.moving.push(error);
            let mid = 0.5 * (times[k] + times[k + 1]);
            let truth_mid = place(mid).expect("in front");
            scores.middle.push((t.path(&times, k).expect("a path").at(mid) - truth_mid).norm());
            let ideal = Track {
                before: t.before.and(place(times[k - 1])),
                earlier: place(times[k]).expect("in front"),
                later: place(times[k + 1]).expect("in front"),
                after: t.after.and(place(times[k + 2])),
                ..t.clone()
            };
            scores.ideal.push((ideal.path(&times, k).expect("a path").at(mid) - truth_mid).norm());
        }
    }
    scores
}

fn main() {
    let only = std::env::args().skip(1).find(|a| !a.starts_with("--"));
    let cases = worlds::cases();
    let mut variants: Vec<(String, RegistrationOptions)> =
        vec![("default".into(), RegistrationOptions::default())];
    let mut vary = |name: &str, change: &dyn Fn(&mut RegistrationOptions)| {
        let mut o = RegistrationOptions::default();
        change(&mut o);
        variants.push((name.to_owned(), o));
    };
    vary("off", &|o| o.klt.affine.radius_px = 0);
    println!(
        "{:10} {:18} | all n  median <.1 <1 | moving n median p90 p99 | middle median p90 p99 | ideal | ms",
        "", ""
    );
    for case in &cases {
        for (name, options) in &variants {
            if only.as_ref().is_some_and(|o| !name.contains(o.as_str())) {
                continue;
            }
            let mut s = score(case, options);
            let share = |v: &[f64], b: f64| {
                100.0 * v.iter().filter(|e| **e < b).count() as f64 / v.len() as f64
            };
            println!(
                "{:10} {name:18} | {:5} {:.3} {:4.1} {:4.1} | {:4} {:.3} {:.3} {:.3} | {:.3} {:.3} {:.3} | {:.3} | {:.0}",
                case.name,
                s.all.len(),
                quantile(&mut s.all.clone(), 0.5),
                share(&s.all, 0.1),
                share(&s.all, 1.0),
                s.moving.len(),
                quantile(&mut s.moving.clone(), 0.5),
                quantile(&mut s.moving.clone(), 0.9),
                quantile(&mut s.moving, 0.99),
                quantile(&mut s.middle.clone(), 0.5),
                quantile(&mut s.middle.clone(), 0.9),
                quantile(&mut s.middle, 0.99),
                quantile(&mut s.ideal, 0.5),
                1e3 * s.seconds,
            );
        }
    }
}
