//! All captures at once: every scene and rig, whole and cut to fewer frames.

use super::captures::{Outcome, by_default, outcomes, select_frames, summary};
use super::{median, percentile};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, Truth};
use stlfr::offset::Offsets;

type Failure = Box<dyn std::error::Error>;

/// The targets for the median and the worst error of 12 frames, in frames.
const LIMITS: [f64; 2] = [0.002, 0.005];
/// The paper's error, in frames.
const PAPER: f64 = 0.06;
/// The numbers of frames of the shortened captures, which start with the first frame.
const SHORTENED: [usize; 2] = [8, 3];

/// Measures the given captures, or all in `.captures/films` that have a ground truth.
pub fn run(folders: &[String]) -> Result<(), Failure> {
    let default_folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(".captures/films");
    let folders: Vec<PathBuf> = match folders {
        [] => captures_in(&default_folder)?,
        given => given.iter().map(PathBuf::from).collect(),
    };
    println!(
        "errors in frames; targets for 12 frames: median {} worst {}; the paper: {PAPER}",
        LIMITS[0], LIMITS[1]
    );
    println!(
        "{:24} {:>6} {:>5} {:>7} {:>8} {:>8} {:>9} {:>6} {:>6} {:>6}",
        "capture", "frames", "known", "unknown", "median", "worst", "std. err.", "|z|", "max", "s"
    );
    let (mut whole, mut shortened) = (Vec::new(), Vec::new());
    for folder in &folders {
        let capture = Capture::open(folder)?;
        let truth = Truth::open(folder)?.ok_or("has no truth")?;
        let frames = capture.cameras.iter().map(|c| c.frames.len()).min().unwrap_or(0);
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        whole.extend(row(&name, capture.clone(), &truth)?);
        for count in SHORTENED.into_iter().filter(|c| *c < frames) {
            let mut part = capture.clone();
            select_frames(&mut part, 0..count);
            shortened.extend(row(&name, part, &truth)?);
        }
    }
    println!("whole captures: {}", summary(&whole));
    println!("shortened captures: {}", summary(&shortened));
    whole.extend(shortened);
    println!("all: {}", summary(&whole));
    Ok(())
}

fn captures_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.join("capture.json").exists() && path.join("truth").exists() {
            folders.push(path);
        }
    }
    folders.sort();
    Ok(folders)
}

/// Prints one capture's row; returns its outcomes.
fn row(name: &str, capture: Capture, truth: &Truth) -> Result<Vec<Outcome>, Failure> {
    let frames = capture.cameras.iter().map(|c| c.frames.len()).max().unwrap_or(0);
    let capture = Arc::new(capture);
    let start = Instant::now();
    let offsets = by_default(&capture)?.offsets;
    let seconds = start.elapsed().as_secs_f64();
    let (known, unknown) = outcomes(&offsets, capture.frame_s(), |id| truth.offset_s(id));
    let errors: Vec<f64> = known.iter().map(|o| o.error_frames.abs()).collect();
    let z: Vec<f64> = known.iter().map(|o| o.z().abs()).collect();
    let bars: Vec<f64> = known.iter().map(|o| o.std_err_frames).collect();
    let (middle, worst) = (median(&errors), percentile(&errors, 1.0));
    let verdict = if known.is_empty() || (middle <= LIMITS[0] && worst <= LIMITS[1]) {
        ""
    } else if worst <= PAPER {
        "over the limit"
    } else {
        "over the paper's"
    };
    println!(
        "{name:24} {frames:>6} {:>5} {unknown:>7} {middle:>8.5} {worst:>8.5} {:>9.5} {:>6.2} \
         {:>6.1} {seconds:>6.1} {verdict}",
        known.len(),
        median(&bars),
        median(&z),
        percentile(&z, 1.0),
    );
    clocks(&capture, &offsets, truth);
    Ok(known)
}

/// Prints rates and lost frames beside the truth, and the reasons of unknown offsets.
fn clocks(capture: &Capture, offsets: &Offsets, truth: &Truth) {
    let mut reasons: Vec<&str> = Vec::new();
    for (camera, recording) in offsets.cameras.iter().zip(&capture.cameras) {
        let Some(true_clock) = truth.offsets.iter().find(|o| o.id == camera.id) else { continue };
        if let Some((rate, bar)) = camera.rate_ppm.zip(camera.rate_std_err_ppm) {
            println!("    {}: {rate:.0} ± {bar:.0} ppm, truth {}", camera.id, true_clock.rate_ppm);
        }
        if let Some(lost) = &camera.lost_before {
            let true_lost =
                true_clock.lost_before.iter().filter(|n| (**n as usize) < recording.frames.len());
            let true_lost: Vec<u32> = true_lost.copied().collect();
            println!("    {}: lost before {lost:?}, truth {true_lost:?}", camera.id);
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

/// The number of images whose time is off by more than a tenth of a frame, and that of all images with
/// a time.
fn images_off(capture: &Capture, offsets: &Offsets, truth: &Truth) -> (usize, usize) {
    let times = offsets.common_times_s(capture);
    let errors = times.iter().zip(&capture.cameras).flat_map(|(times, camera)| {
        let shutter = truth.shutter.iter().filter(|s| s.id == camera.id).flat_map(|s| &s.times_s);
        times.iter().flatten().zip(shutter).map(|(estimated, true_s)| estimated - true_s)
    });
    let errors: Vec<f64> = errors.collect();
    let wrong = errors.iter().filter(|e| e.abs() > 0.1 * capture.frame_s()).count();
    (wrong, errors.len())
}
