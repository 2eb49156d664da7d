//! Films in closed form: accuracy and error bars over many, and errors as the film gets worse.

use super::captures::{Outcome, by_default, outcomes, summary};
use super::scene::{self, Board, Film};
use super::{growth, save};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use stlfr::capture::Capture;
use stlfr::host::process_cpu_s;
use stlfr::offset::Estimate;
use stlfr::raster::BitDepth;

type Failure = Box<dyn std::error::Error>;

const DELAYS: [f64; 4] = [0.31, -0.22, 0.0, 0.47];

/// The estimate, its errors, how many cameras are unknown; seconds on the clock and of processors.
fn estimated(film: &Film) -> Result<(Estimate, Vec<Outcome>, usize, [f64; 2]), Failure> {
    let folder = tempfile::tempdir()?;
    let truth = film.write(folder.path())?;
    let capture = Arc::new(Capture::open(folder.path())?);
    let (start, cpu) = (Instant::now(), process_cpu_s());
    let estimate = by_default(&capture)?;
    let seconds = [start.elapsed().as_secs_f64(), process_cpu_s() - cpu];
    let truth_s = |id: &str| truth.get(capture.camera_index(id)?).copied();
    let (found, unknown) = outcomes(&estimate.offsets, capture.frame_s(), truth_s);
    Ok((estimate, found, unknown, seconds))
}

/// Error bars over films of random boards.
fn calibration(films: u64) -> Result<(), Failure> {
    println!("error bars: films of 320×240, 6 to 12 frames, 4 cameras");
    let mut all = Vec::new();
    let mut unknown = 0;
    for seed in 0..films {
        let mut film = Film::new(scene::random_boards(seed), &DELAYS, 6 + (seed % 7) as usize);
        film.seed = seed;
        film.jitter_s = 0.001;
        let (_, found, blind, _) = estimated(&film)?;
        all.extend(found);
        unknown += blind;
        if (seed + 1) % 10 == 0 {
            println!("{} films: {}; {unknown} unknown", seed + 1, summary(&all));
        }
    }
    Ok(())
}

/// What can't be seen.
fn blind() -> Result<(), Failure> {
    let tell = |name: &str, film: &Film| -> Result<(), Failure> {
        let (estimate, found, unknown, _) = estimated(film)?;
        let reason = estimate.offsets.cameras.iter().find_map(|c| c.reason.clone());
        println!(
            "{name}: {} known, {unknown} unknown: {}",
            found.len(),
            reason.unwrap_or_default()
        );
        if !found.is_empty() {
            println!("  {}", summary(&found));
        }
        Ok(())
    };
    tell("motion along the epipolar lines", &Film::new(scene::rectangle([0.6, 0.0]), &DELAYS, 10))?;
    tell("no motion", &Film::new(scene::rectangle([0.0, 0.0]), &DELAYS, 10))?;
    tell("nearly none", &Film::new(scene::rectangle([0.003, 0.003]), &DELAYS, 10))?;
    let small = Film { size: [240, 180], ..Film::new(scene::small_turning_board(0), &DELAYS, 9) };
    tell("a small body alone, sliding along them and turning", &small)?;
    let mut grid = Film::new(scene::rectangle([0.6, 0.0]), &DELAYS, 10);
    grid.second_row_m = 0.09;
    tell("motion along a grid's rows, with its second row", &grid)?;
    Ok(())
}

/// The error as one thing about the film grows.
fn grown(output: &Path) -> Result<(), Failure> {
    type Change = fn(&mut Film, f64);
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
        charts.push(growth::chart("Boards", (name, values), |value| -> Result<_, Failure> {
            let (mut all, mut unknown) = (Vec::new(), 0);
            for seed in 100..103 {
                let mut film = Film::new(scene::random_boards(seed), &DELAYS, 10);
                film.seed = seed;
                change(&mut film, value);
                let (_, found, blind, _) = estimated(&film)?;
                all.extend(found);
                unknown += blind;
            }
            Ok((all, unknown))
        })?);
    }
    save(output, "growth", &charts)
}

/// Drift, a lost frame, and recordings seconds apart.
fn clocks() -> Result<(), Failure> {
    let boards = scene::restless(3);
    let mut film = Film::new(boards, &[0.3, 0.0, -0.2], 150);
    film.size = [160, 120];
    film.drift_ppm = vec![80.0, 0.0, -150.0];
    film.lost[0] = vec![61];
    film.lost[2] = vec![20, 101];
    // Started by hand: camera 0 is 3 s late.
    film.delays_s[0] += 3.0;
    let (estimate, _, _, seconds) = estimated(&film)?;
    println!(
        "drift 80 and −150 ppm, frames 61 and 20, 101 lost, 3 s apart, 5 s at 160×120 ({:.1} s):",
        seconds[0]
    );
    for (c, camera) in estimate.offsets.cameras.iter().enumerate() {
        let truth_s = film.delays_s[c] - film.delays_s[1];
        println!(
            "  {}: offset {:?} ± {:?} s (truth {truth_s:.6}), rate {:?} ± {:?} ppm (truth {}), lost before {:?} {}",
            camera.id,
            camera.offset_s,
            camera.std_err_s,
            camera.rate_ppm,
            camera.rate_std_err_ppm,
            film.drift_ppm[c],
            camera.lost_before,
            camera.reason.as_deref().unwrap_or_default()
        );
    }
    Ok(())
}

fn time() -> Result<(), Failure> {
    let delays: Vec<f64> = (0..8).map(|c| (0.37 * f64::from(c)) % 1.0).collect();
    let mut film = Film::new(scene::random_boards(7), &delays, 31);
    film.size = [640, 480];
    let slower: Vec<Board> =
        film.boards.iter().map(|b| Board { velocity: b.velocity * 0.3, ..b.clone() }).collect();
    film.boards = slower;
    let (_, found, unknown, [wall_s, cpu_s]) = estimated(&film)?;
    let threads = rayon::current_num_threads();
    println!(
        "8 cameras × 31 frames at 640×480: {wall_s:.1} s on {threads} threads, {cpu_s:.1} s of \
         processor time; {}; {unknown} unknown",
        summary(&found)
    );
    Ok(())
}

pub fn run(parts: &[String], output: &Path) -> Result<(), Failure> {
    let wanted = |name: &str| parts.is_empty() || parts.iter().any(|p| p == name);
    if wanted("blind") {
        blind()?;
    }
    if wanted("clocks") {
        clocks()?;
    }
    if wanted("calibration") {
        calibration(70)?;
    }
    if wanted("growth") {
        grown(output)?;
    }
    if wanted("time") {
        time()?;
    }
    Ok(())
}
