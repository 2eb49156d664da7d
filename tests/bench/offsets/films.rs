//! All films at once: every scene, every rig, and shorter films of the same frames.

use super::captures::{Outcome, by_default, keep_frames, outcomes, summary};
use super::{median, percentile};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, Truth};
use stlfr::offset::Offsets;

type Failure = Box<dyn std::error::Error>;

/// What is asked of 12 frames, in frames, and what the paper has.
const LIMITS: [f64; 2] = [0.002, 0.005];
const PAPER: f64 = 0.06;
/// Frames of the shorter films, which start where the whole ones do.
const SHORTER: [usize; 2] = [8, 3];

/// Every folder of these, or of `.captures/films`, that is a capture with truth.
pub fn run(folders: &[String]) -> Result<(), Failure> {
    let films = Path::new(env!("CARGO_MANIFEST_DIR")).join(".captures/films");
    let folders: Vec<PathBuf> = match folders {
        [] => captures_in(&films)?,
        given => given.iter().map(PathBuf::from).collect(),
    };
    println!(
        "errors in frames; asked of 12 frames: median {} worst {}; the paper: {PAPER}",
        LIMITS[0], LIMITS[1]
    );
    println!(
        "{:24} {:>6} {:>5} {:>7} {:>8} {:>8} {:>9} {:>6} {:>6} {:>6}",
        "film", "frames", "known", "unknown", "median", "worst", "std. err.", "|z|", "most", "s"
    );
    let (mut whole, mut shorter) = (Vec::new(), Vec::new());
    for folder in &folders {
        let capture = Capture::open(folder)?;
        let truth = Truth::open(folder)?.ok_or("has no truth")?;
        let frames = capture.cameras.iter().map(|c| c.frames.len()).min().unwrap_or(0);
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        whole.extend(row(&name, capture.clone(), &truth)?);
        for count in SHORTER.into_iter().filter(|c| *c < frames) {
            let mut part = capture.clone();
            keep_frames(&mut part, 0..count);
            shorter.extend(row(&name, part, &truth)?);
        }
    }
    println!("whole films: {}", summary(&whole));
    println!("shorter ones: {}", summary(&shorter));
    whole.extend(shorter);
    println!("all: {}", summary(&whole));
    Ok(())
}

fn captures_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.join("capture.json").exists() && path.join("truth").exists() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn row(name: &str, capture: Capture, truth: &Truth) -> Result<Vec<Outcome>, Failure> {
    let frames = capture.cameras.iter().map(|c| c.frames.len()).max().unwrap_or(0);
    let capture = Arc::new(capture);
    let start = Instant::now();
    let offsets = by_default(&capture)?.offsets;
    let seconds = start.elapsed().as_secs_f64();
    let (found, unknown) = outcomes(&offsets, capture.frame_s(), |id| truth.offset_s(id));
    let errors: Vec<f64> = found.iter().map(|o| o.error_frames.abs()).collect();
    let z: Vec<f64> = found.iter().map(|o| o.z().abs()).collect();
    let bars: Vec<f64> = found.iter().map(|o| o.std_err_frames).collect();
    let (middle, worst) = (median(&errors), percentile(&errors, 1.0));
    let verdict = if found.is_empty() || (middle <= LIMITS[0] && worst <= LIMITS[1]) {
        ""
    } else if worst <= PAPER {
        "over the limit"
    } else {
        "over the paper's"
    };
    println!(
        "{name:24} {frames:>6} {:>5} {unknown:>7} {middle:>8.5} {worst:>8.5} {:>9.5} {:>6.2} \
         {:>6.1} {seconds:>6.1} {verdict}",
        found.len(),
        median(&bars),
        median(&z),
        percentile(&z, 1.0),
    );
    clocks(&capture, &offsets, truth);
    Ok(found)
}

/// What is said of rates and lost frames, and why cameras are unknown.
fn clocks(capture: &Capture, offsets: &Offsets, truth: &Truth) {
    let mut reasons: Vec<&str> = Vec::new();
    for (camera, filmed) in offsets.cameras.iter().zip(&capture.cameras) {
        let Some(of_truth) = truth.offsets.iter().find(|o| o.id == camera.id) else { continue };
        if let Some((rate, bar)) = camera.rate_ppm.zip(camera.rate_std_err_ppm) {
            println!("    {}: {rate:.0} ± {bar:.0} ppm, truth {}", camera.id, of_truth.rate_ppm);
        }
        if let Some(lost) = &camera.lost_before {
            let there =
                of_truth.lost_before.iter().filter(|n| (**n as usize) < filmed.frames.len());
            let there: Vec<u32> = there.copied().collect();
            println!("    {}: lost before {lost:?}, truth {there:?}", camera.id);
        }
        reasons.extend(camera.reason.as_deref());
    }
    if offsets.cameras.iter().any(|c| c.lost_before.is_some()) {
        let (wrong, all) = images_off(capture, offsets, truth);
        println!("    {wrong} of {all} images over 0.1 frame off");
    }
    let count = reasons.len();
    reasons.sort_unstable();
    reasons.dedup();
    for reason in reasons {
        println!("    unknown ({count}): {reason}");
    }
}

/// How many images' times are wrong by over a tenth of a frame, of all that have one.
fn images_off(capture: &Capture, offsets: &Offsets, truth: &Truth) -> (usize, usize) {
    let times = offsets.common_times_s(capture);
    let errors = times.iter().zip(&capture.cameras).flat_map(|(times, camera)| {
        let shutter = truth.shutter_s(&camera.id).unwrap_or_default();
        times.iter().flatten().zip(shutter).map(|(found, there)| found - there)
    });
    let errors: Vec<f64> = errors.collect();
    let wrong = errors.iter().filter(|e| e.abs() > 0.1 * capture.frame_s()).count();
    (wrong, errors.len())
}
