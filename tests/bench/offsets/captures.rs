//! Offset errors and error bars on captures with truth, rung by rung.

use super::{median, percentile};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, CaptureError, Truth};
use stlfr::method::Method;
use stlfr::offset::{Estimate, OffsetMethod, OffsetOptions, Offsets, estimate};
use stlfr::progress::Reporter;
use stlfr::registration::{FrameStore, RegistrationOptions};

/// A capture's offsets as the program estimates them unless told otherwise.
pub fn by_default(capture: &Arc<Capture>) -> Result<Estimate, CaptureError> {
    let (options, registration) = (OffsetOptions::default(), RegistrationOptions::default());
    estimate(&FrameStore::new(capture.clone(), &registration), &options, &Reporter::silent())
}

/// One camera's error, in frames and in its standard errors.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub error_frames: f64,
    pub std_err_frames: f64,
}

impl Outcome {
    pub fn z(&self) -> f64 {
        self.error_frames / self.std_err_frames.max(1e-12)
    }
}

/// The estimated cameras but the reference against their true offsets, and how many are unknown.
pub fn outcomes(
    offsets: &Offsets,
    frame_s: f64,
    truth_s: impl Fn(&str) -> Option<f64>,
) -> (Vec<Outcome>, usize) {
    let mut found = Vec::new();
    let mut unknown = 0;
    for camera in offsets.cameras.iter().filter(|c| c.id != offsets.reference) {
        let known = camera.offset_s.zip(camera.std_err_s).zip(truth_s(&camera.id));
        match known {
            Some(((offset, std_err), truth)) => found.push(Outcome {
                error_frames: (offset - truth) / frame_s,
                std_err_frames: std_err / frame_s,
            }),
            None => unknown += 1,
        }
    }
    (found, unknown)
}

/// One line: errors, and how well the error bars cover them.
pub fn summary(outcomes: &[Outcome]) -> String {
    if outcomes.is_empty() {
        return "none known".into();
    }
    let errors: Vec<f64> = outcomes.iter().map(|o| o.error_frames.abs()).collect();
    let z: Vec<f64> = outcomes.iter().map(|o| o.z().abs()).collect();
    let within = z.iter().filter(|z| **z <= 2.0).count() as f64 / z.len() as f64;
    let bars: Vec<f64> = outcomes.iter().map(|o| o.std_err_frames).collect();
    format!(
        "{} offsets: error median {:.5} worst {:.5} frame, std. error median {:.5}; \
         within 2: {:.1} %, median |z| {:.2}, most {:.1}",
        outcomes.len(),
        median(&errors),
        percentile(&errors, 1.0),
        median(&bars),
        100.0 * within,
        median(&z),
        percentile(&z, 1.0)
    )
}

pub fn run(folders: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    for folder in folders {
        let capture = Arc::new(Capture::open(Path::new(folder))?);
        let truth = Truth::open(Path::new(folder))?.ok_or("has no truth")?;
        println!("{folder}: errors in frames");
        for &method in OffsetMethod::ALL {
            let options = OffsetOptions { method, ..Default::default() };
            let start = Instant::now();
            let frames = FrameStore::new(capture.clone(), &RegistrationOptions::default());
            let estimate = estimate(&frames, &options, &Reporter::silent())?;
            let seconds = start.elapsed().as_secs_f64();
            let (found, unknown) =
                outcomes(&estimate.offsets, capture.frame_s(), |id| truth.offset_s(id));
            println!(
                "  {method:12?} {}; {unknown} unknown; {} pairs, {seconds:.2} s",
                summary(&found),
                estimate.pairs.len()
            );
            let each: Vec<String> =
                found.iter().map(|o| format!("{:+.4} ({:+.1}σ)", o.error_frames, o.z())).collect();
            println!("    {}", each.join(" "));
            for camera in estimate.offsets.cameras.iter() {
                if let Some(reason) = &camera.reason {
                    println!("    {}: {reason}", camera.id);
                }
            }
        }
    }
    Ok(())
}

/// Error bars over many sub-sampled films: windows of frames and subsets of cameras of captures
/// with truth.
pub fn calibration(folders: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    let mut all = Vec::new();
    println!("folder, offsets; errors and standard errors, frames");
    for folder in folders {
        let whole = Capture::open(Path::new(folder))?;
        let truth = Truth::open(Path::new(folder))?.ok_or("has no truth")?;
        let mut of_one = Vec::new();
        let frames = whole.cameras.iter().map(|c| c.frames.len()).min().unwrap_or(0);
        let mut unknown = 0;
        for part in parts(&whole, frames) {
            let part = Arc::new(part);
            let reference = part.cameras[part.reference].id.clone();
            let reference_s = truth.offset_s(&reference).ok_or("the truth lacks a camera")?;
            let estimate = by_default(&part)?;
            let truth_s = |id: &str| Some(truth.offset_s(id)? - reference_s);
            let (found, blind) = outcomes(&estimate.offsets, part.frame_s(), truth_s);
            of_one.extend(found);
            unknown += blind;
        }
        println!("{folder}: {}; {unknown} unknown", summary(&of_one));
        let wrong = of_one.iter().filter(|o| o.z().abs() > 3.0);
        for o in wrong {
            println!("    over 3: {:+.5} ± {:.5}", o.error_frames, o.std_err_frames);
        }
        all.extend(of_one);
    }
    println!("all: {}", summary(&all));
    Ok(())
}

/// Sub-sampled films: windows of a third, half, two thirds and all of the frames, of the even and of
/// the odd cameras.
fn parts(whole: &Capture, frames: usize) -> Vec<Capture> {
    let mut parts = Vec::new();
    for thirds in [2, 3, 4, 6] {
        let length = (frames * thirds / 6).max(4);
        let starts = (0..).map(|n| n * length).take_while(|s| s + length <= frames);
        for start in starts {
            for parity in 0..2 {
                let mut part = whole.clone();
                let mut number = 0;
                part.cameras.retain(|_| {
                    number += 1;
                    number % 2 == parity
                });
                if part.cameras.len() < 2 {
                    continue;
                }
                part.reference = (part.cameras.len() - 1) / 2;
                keep_frames(&mut part, start..start + length);
                parts.push(part);
            }
        }
    }
    parts
}

/// Leaves out all other frames; every camera must have these.
pub fn keep_frames(capture: &mut Capture, frames: std::ops::Range<usize>) {
    for camera in &mut capture.cameras {
        camera.frames = camera.frames[frames.clone()].to_vec();
        camera.clock.times_s = camera.clock.times_s[frames.clone()].to_vec();
    }
}

/// Every pair of the best rung: its error against the truth, in frames and in its standard errors.
/// A number among the folders: only as many frames of those after it, from the first.
pub fn pairs(arguments: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    let mut count = usize::MAX;
    for folder in arguments {
        if let Ok(frames) = folder.parse() {
            count = frames;
            continue;
        }
        let mut capture = Capture::open(Path::new(folder))?;
        let frames = capture.cameras.iter().map(|c| c.frames.len()).min().unwrap_or(0);
        if count < frames {
            keep_frames(&mut capture, 0..count);
        }
        let capture = Arc::new(capture);
        let truth = Truth::open(Path::new(folder))?.ok_or("has no truth")?;
        let start = Instant::now();
        let found = by_default(&capture)?;
        let (known, unknown) = outcomes(&found.offsets, capture.frame_s(), |id| truth.offset_s(id));
        println!(
            "{folder}: {}; {unknown} unknown; {:.1} s",
            summary(&known),
            start.elapsed().as_secs_f64()
        );
        let each: Vec<String> =
            known.iter().map(|o| format!("{:+.4} ({:+.1}σ)", o.error_frames, o.z())).collect();
        println!("    {}", each.join(" "));
        for camera in &found.offsets.cameras {
            if let Some(reason) = &camera.reason {
                println!("    {}: {reason}", camera.id);
            }
        }
        for pair in &found.pairs {
            let [i, j] = pair.cameras.map(|c| &capture.cameras[c].id);
            let (Some(of_i), Some(of_j)) = (truth.offset_s(i), truth.offset_s(j)) else { continue };
            let error = (pair.offset_s - (of_j - of_i)) / capture.frame_s();
            println!(
                "    {i}–{j}: {:+.4} ± {:.4} frame, {} of {} candidates, {:.3} px",
                error,
                pair.std_err_s / capture.frame_s(),
                pair.inliers,
                pair.candidates,
                pair.sigma_px
            );
        }
    }
    Ok(())
}
