//! Temporal offsets: the paper's experiments, and beyond them.
//!
//! `cargo bench --bench offsets -- fig18`                 simulated tracks with outliers
//! `cargo bench --bench offsets -- frames [FILM TURNING]`  Figs. 19 to 22, frame by frame
//! `cargo bench --bench offsets -- all [CAPTURE…]`        every film of .captures/films: errors and
//!                                                        error bars beside what is asked
//! `cargo bench --bench offsets -- captures CAPTURE…`     errors rung by rung, against the truth
//! `cargo bench --bench offsets -- pairs [FRAMES] CAPTURE…`  pair by pair, the best rung
//! `cargo bench --bench offsets -- calibration CAPTURE…`  error bars over sub-sampled films
//! `cargo bench --bench offsets -- analytic`              films in closed form: accuracy, error
//!                                                        bars, noise, jitter, blur, bits, time
//! `cargo bench --bench offsets -- worse CAPTURE…`        filmed frames with noise, blur, fewer bits
//! `cargo bench --bench offsets -- lost`                  60 films in closed form that lose frames
//!
//! Plots go to `.captures/bench-offsets/`.

#[path = "offsets/analytic.rs"]
mod analytic;
#[path = "offsets/captures.rs"]
mod captures;
#[path = "offsets/fig18.rs"]
mod fig18;
#[path = "offsets/filmed.rs"]
mod filmed;
#[path = "offsets/films.rs"]
mod films;
#[path = "offsets/frames.rs"]
mod frames;
#[path = "offsets/growth.rs"]
mod growth;
#[path = "offsets/lost.rs"]
mod lost;
#[path = "offsets/scene.rs"]
mod scene;

use std::path::Path;
use stlfr::chart::{Chart, svg};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let output = Path::new(env!("CARGO_MANIFEST_DIR")).join(".captures/bench-offsets");
    let (what, rest) = match arguments.split_first() {
        Some((what, rest)) => (what.as_str(), rest),
        None => ("fig18", &[][..]),
    };
    match what {
        "fig18" => fig18::run(&output),
        "frames" => frames::run(rest, &output),
        "all" => films::run(rest),
        "captures" => captures::run(rest),
        "pairs" => captures::pairs(rest),
        "calibration" => captures::calibration(rest),
        "analytic" => analytic::run(rest, &output),
        "worse" => filmed::run(rest, &output),
        "lost" => lost::run(),
        other => Err(format!("there is no '{other}'").into()),
    }
}

/// The value that this share of them is at or below; NaN for none.
fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

fn median(values: &[f64]) -> f64 {
    percentile(values, 0.5)
}

/// Writes charts, two a row, as SVG.
fn save(folder: &Path, name: &str, charts: &[Chart]) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    let path = folder.join(format!("{name}.svg"));
    std::fs::write(&path, svg(charts, 2))?;
    println!("wrote {}", path.display());
    Ok(())
}
