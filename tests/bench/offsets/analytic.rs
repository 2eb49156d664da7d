//! Synthetic captures: accuracy and error bars over many, unobservable offsets, drift and lost frames,
//! errors against noise, jitter, exposure and bits, and time.

use super::captures::{Outcome, by_default, outcomes, summary};
use super::scene::{self, Board, SyntheticCapture};
use super::{save, sweep};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::Capture;
use stlfr::host::process_cpu_s;
use stlfr::offset::Estimate;
use stlfr::raster::BitDepth;

type Failure = Box<dyn std::error::Error>;

/// When the four cameras start, frames.
const DELAYS: [f64; 4] = [0.31, -0.22, 0.0, 0.47];

/// The estimate of a synthetic capture, beside its truth.
struct Measured {
    estimate: Estimate,
    outcomes: Vec<Outcome>,
    /// The number of cameras without an offset.
    unknown: usize,
    /// Elapsed and processor time, seconds.
    seconds: [f64; 2],
}

fn measure(synthetic: &SyntheticCapture) -> Result<Measured, Failure> {
    let folder = tempfile::tempdir()?;
    let truth = synthetic.write(folder.path())?;
    let capture = Arc::new(Capture::open(folder.path())?);
    let (start, cpu) = (Instant::now(), process_cpu_s());
    let estimate = by_default(&capture)?;
    let seconds = [start.elapsed().as_secs_f64(), process_cpu_s() - cpu];
    let truth_s = |id: &str| truth.get(capture.camera_index(id)?).copied();
    let (outcomes, unknown) = outcomes(&estimate.offsets, capture.frame_s(), truth_s);
    Ok(Measured { estimate, outcomes, unknown, seconds })
}

/// Error bars over captures of random boards.
fn calibration(count: u64) -> Result<(), Failure> {
    println!("error bars: captures of 320×240, 6 to 12 frames, 4 cameras");
    let mut all = Vec::new();
    let mut unknown = 0;
    for seed in 0..count {
        let mut synthetic =
            SyntheticCapture::new(scene::random_boards(seed), &DELAYS, 6 + (seed % 7) as usize);
        synthetic.seed = seed;
        synthetic.jitter_s = 0.001;
        let measured = measure(&synthetic)?;
        all.extend(measured.outcomes);
        unknown += measured.unknown;
        if (seed + 1) % 10 == 0 {
            println!("{} captures: {}; {unknown} unknown", seed + 1, summary(&all));
        }
    }
    Ok(())
}

/// Captures whose offsets are not or hardly determined.
fn unobservable() -> Result<(), Failure> {
    let report = |name: &str, synthetic: &SyntheticCapture| -> Result<(), Failure> {
        let Measured { estimate, outcomes, unknown, .. } = measure(synthetic)?;
        let reason = estimate.offsets.cameras.iter().find_map(|c| c.reason.clone());
        println!(
            "{name}: {} known, {unknown} unknown: {}",
            outcomes.len(),
            reason.unwrap_or_default()
        );
        if !outcomes.is_empty() {
            println!("  {}", summary(&outcomes));
        }
        Ok(())
    };
    report(
        "motion along the epipolar lines",
        &SyntheticCapture::new(scene::rectangle([0.6, 0.0]), &DELAYS, 10),
    )?;
    report("no motion", &SyntheticCapture::new(scene::rectangle([0.0, 0.0]), &DELAYS, 10))?;
    report(
        "almost no motion",
        &SyntheticCapture::new(scene::rectangle([0.003, 0.003]), &DELAYS, 10),
    )?;
    let small = SyntheticCapture {
        size: [240, 180],
        ..SyntheticCapture::new(scene::small_turning_board(0), &DELAYS, 9)
    };
    report("a small body alone, moving along the epipolar lines and rotating", &small)?;
    let mut grid = SyntheticCapture::new(scene::rectangle([0.6, 0.0]), &DELAYS, 10);
    grid.second_row_m = 0.09;
    report("motion along a grid's rows, with its second row", &grid)?;
    Ok(())
}

/// Errors against one varied parameter of the captures.
fn sweeps(output: &Path) -> Result<(), Failure> {
    type Change = fn(&mut SyntheticCapture, f64);
    let sweeps: [(&str, &[f64], Change); 5] = [
        ("noise, % of full scale", &[0.0, 0.5, 1.0, 2.0, 4.0, 8.0], |f, v| f.noise = 0.01 * v),
        ("jitter, stamped, ms", &[0.0, 0.5, 1.0, 2.0, 4.0], |f, v| f.jitter_s = 1e-3 * v),
        ("jitter, hidden, ms", &[0.0, 0.5, 1.0, 2.0, 4.0], |f, v| {
            (f.jitter_s, f.stamped) = (1e-3 * v, false);
        }),
        ("exposure, frames", &[0.0, 0.25, 0.5, 0.75, 1.0], |f, v| f.exposure_s = v / f.rate_hz),
        ("bits", &[8.0, 16.0], |f, v| {
            f.bits = if v > 8.0 { BitDepth::Sixteen } else { BitDepth::Eight };
            f.noise = 0.0;
        }),
    ];
    let mut charts = Vec::new();
    for (name, values, change) in sweeps {
        charts.push(sweep::chart("Boards", (name, values), |value| -> Result<_, Failure> {
            let (mut all, mut unknown) = (Vec::new(), 0);
            for seed in 100..103 {
                let mut synthetic = SyntheticCapture::new(scene::random_boards(seed), &DELAYS, 10);
                synthetic.seed = seed;
                change(&mut synthetic, value);
                let measured = measure(&synthetic)?;
                all.extend(measured.outcomes);
                unknown += measured.unknown;
            }
            Ok((all, unknown))
        })?);
    }
    save(output, "growth", &charts)
}

/// Drift, lost frames, and recordings that start seconds apart.
fn clocks() -> Result<(), Failure> {
    let boards = scene::aperiodic_boards(3);
    let mut synthetic = SyntheticCapture::new(boards, &[0.3, 0.0, -0.2], 150);
    synthetic.size = [160, 120];
    synthetic.drift_ppm = vec![80.0, 0.0, -150.0];
    synthetic.lost[0] = vec![61];
    synthetic.lost[2] = vec![20, 101];
    // Camera 0 starts 3 s late.
    synthetic.delays_s[0] += 3.0;
    let Measured { estimate, seconds, .. } = measure(&synthetic)?;
    println!(
        "drift 80 and −150 ppm, frames 61 and 20, 101 lost, 3 s apart, 5 s at 160×120 ({:.1} s):",
        seconds[0]
    );
    for (c, camera) in estimate.offsets.cameras.iter().enumerate() {
        let truth_s = synthetic.delays_s[c] - synthetic.delays_s[1];
        println!(
            "  {}: offset {:?} ± {:?} s (truth {truth_s:.6}), rate {:?} ± {:?} ppm (truth {}), lost before {:?} {}",
            camera.id,
            camera.offset_s,
            camera.std_err_s,
            camera.rate_ppm,
            camera.rate_std_err_ppm,
            synthetic.drift_ppm[c],
            camera.lost_before,
            camera.reason.as_deref().unwrap_or_default()
        );
    }
    Ok(())
}

/// The time of 8 cameras with 31 frames each.
fn time() -> Result<(), Failure> {
    let delays: Vec<f64> = (0..8).map(|c| (0.37 * f64::from(c)) % 1.0).collect();
    let mut synthetic = SyntheticCapture::new(scene::random_boards(7), &delays, 31);
    synthetic.size = [640, 480];
    let slower: Vec<Board> = synthetic
        .boards
        .iter()
        .map(|b| Board { velocity: b.velocity * 0.3, ..b.clone() })
        .collect();
    synthetic.boards = slower;
    let Measured { outcomes, unknown, seconds: [wall_s, cpu_s], .. } = measure(&synthetic)?;
    let threads = rayon::current_num_threads();
    println!(
        "8 cameras × 31 frames at 640×480: {wall_s:.1} s on {threads} threads, {cpu_s:.1} s of \
         processor time; {}; {unknown} unknown",
        summary(&outcomes)
    );
    Ok(())
}

/// Runs the named parts, or all: `unobservable`, `clocks`, `calibration`, `growth`, `time`.
pub fn run(parts: &[String], output: &Path) -> Result<(), Failure> {
    let selected = |name: &str| parts.is_empty() || parts.iter().any(|p| p == name);
    if selected("unobservable") {
        unobservable()?;
    }
    if selected("clocks") {
        clocks()?;
    }
    if selected("calibration") {
        calibration(70)?;
    }
    if selected("growth") {
        sweeps(output)?;
    }
    if selected("time") {
        time()?;
    }
    Ok(())
}
