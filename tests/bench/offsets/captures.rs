//! Offset errors and error bars on captures with ground truth, method by method.

use super::{median, percentile};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::{Capture, CaptureError, Truth};
use stlfr::method::Method;
use stlfr::offset::{Estimate, OffsetMethod, OffsetOptions, Offsets, estimate};
use stlfr::progress::Reporter;
use stlfr::registration::{FrameStore, RegistrationOptions};

/// A capture's offsets by the default options.
pub fn by_default(capture: &Arc<Capture>) -> Result<Estimate, CaptureError> {
    let (options, registration) = (OffsetOptions::default(), RegistrationOptions::default());
    estimate(&FrameStore::new(capture.clone(), &registration), &options, &Reporter::silent())
}

/// The error and the standard error of one camera's offset, in frames.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub error_frames: f64,
    pub std_err_frames: f64,
}

impl Outcome {
    /// The error in standard errors.
    pub fn z(&self) -> f64 {
        self.error_frames / self.std_err_frames.max(1e-12)
    }
}

/// The outcomes of all cameras but the reference, by their true offsets in seconds, and the number of
/// cameras without an offset.
pub fn outcomes(
    offsets: &Offsets,
    frame_s: f64,
    truth_s: impl Fn(&str) -> Option<f64>,
) -> (Vec<Outcome>, usize) {
    let mut outcomes = Vec::new();
    let mut unknown = 0;
    for camera in offsets.cameras.iter().filter(|c| c.id != offsets.reference) {
        let known = camera.offset_s.zip(camera.std_err_s).zip(truth_s(&camera.id));
        match known {
            Some(((offset, std_err), truth)) => outcomes.push(Outcome {
                error_frames: (offset - truth) / frame_s,
                std_err_frames: std_err / frame_s,
            }),
            None => unknown += 1,
        }
    }
    (outcomes, unknown)
}

/// One line: the errors, and the fraction within two standard errors.
pub fn summary(outcomes: &[Outcome]) -> String {
    if outcomes.is_empty() {
        return "none known".into();
    }
    let errors: Vec<f64> = outcomes.iter().map(|o| o.error_frames.abs()).collect();
    let z: Vec<f64> = outcomes.iter().map(|o| o.z().abs()).collect();
    let within_fraction = z.iter().filter(|z| **z <= 2.0).count() as f64 / z.len() as f64;
    let bars: Vec<f64> = outcomes.iter().map(|o| o.std_err_frames).collect();
    format!(
        "{} offsets: error median {:.5} worst {:.5} frame, std. error median {:.5}; \
         within 2: {:.1} %, median |z| {:.2}, max {:.1}",
        outcomes.len(),
        median(&errors),
        percentile(&errors, 1.0),
        median(&bars),
        100.0 * within_fraction,
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
            let (known, unknown) =
                outcomes(&estimate.offsets, capture.frame_s(), |id| truth.offset_s(id));
            println!(
                "  {method:12?} {}; {unknown} unknown; {} pairs, {seconds:.2} s",
                summary(&known),
                estimate.pairs.len()
            );
            let each: Vec<String> =
                known.iter().map(|o| format!("{:+.4} ({:+.1}σ)", o.error_frames, o.z())).collect();
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

/// Error bars over many sub-sampled captures: windows of frames and subsets of cameras of captures with
/// ground truth.
pub fn calibration(folders: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    let mut all = Vec::new();
    println!("folder, offsets; errors and standard errors, frames");
    for folder in folders {
        let whole = Capture::open(Path::new(folder))?;
        let truth = Truth::open(Path::new(folder))?.ok_or("has no truth")?;
        let mut of_capture = Vec::new();
        let frames = whole.cameras.iter().map(|c| c.frames.len()).min().unwrap_or(0);
        let mut unknown = 0;
        for part in parts(&whole, frames) {
            let part = Arc::new(part);
            let reference = part.cameras[part.reference].id.clone();
            let reference_s = truth.offset_s(&reference).ok_or("the truth lacks a camera")?;
            let estimate = by_default(&part)?;
            let truth_s = |id: &str| Some(truth.offset_s(id)? - reference_s);
            let (part_outcomes, part_unknown) =
                outcomes(&estimate.offsets, part.frame_s(), truth_s);
            of_capture.extend(part_outcomes);
            unknown += part_unknown;
        }
        println!("{folder}: {}; {unknown} unknown", summary(&of_capture));
        let beyond = of_capture.iter().filter(|o| o.z().abs() > 3.0);
        for o in beyond {
            println!("    over 3: {:+.5} ± {:.5}", o.error_frames, o.std_err_frames);
        }
        all.extend(of_capture);
    }
    println!("all: {}", summary(&all));
    Ok(())
}

/// Sub-sampled captures: windows of a third, half, two thirds and all of the frames, of the even and of
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
                select_frames(&mut part, start..start + length);
                parts.push(part);
            }
        }
    }
    parts
}

/// Restricts a capture to a range of frames, which every camera must have.
pub fn select_frames(capture: &mut Capture, frames: std::ops::Range<usize>) {
    for camera in &mut capture.cameras {
        camera.frames = camera.frames[frames.clone()].to_vec();
        camera.clock.times_s = camera.clock.times_s[frames.clone()].to_vec();
    }
}

/// The error of every pair by the default method against the ground truth, in frames, with its standard
/// error. A number among the folders restricts the captures after it to as many first frames.
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
            select_frames(&mut capture, 0..count);
        }
        let capture = Arc::new(capture);
        let truth = Truth::open(Path::new(folder))?.ok_or("has no truth")?;
        let start = Instant::now();
        let estimate = by_default(&capture)?;
        let (known, unknown) =
            outcomes(&estimate.offsets, capture.frame_s(), |id| truth.offset_s(id));
        println!(
            "{folder}: {}; {unknown} unknown; {:.1} s",
            summary(&known),
            start.elapsed().as_secs_f64()
        );
        let each: Vec<String> =
            known.iter().map(|o| format!("{:+.4} ({:+.1}σ)", o.error_frames, o.z())).collect();
        println!("    {}", each.join(" "));
        for camera in &estimate.offsets.cameras {
            if let Some(reason) = &camera.reason {
                println!("    {}: {reason}", camera.id);
            }
        }
        for pair in &estimate.pairs {
            let [i, j] = pair.cameras.map(|c| &capture.cameras[c].id);
            let (Some(true_i_s), Some(true_j_s)) = (truth.offset_s(i), truth.offset_s(j)) else {
                continue;
            };
            let error = (pair.clock.offset_s - (true_j_s - true_i_s)) / capture.frame_s();
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
