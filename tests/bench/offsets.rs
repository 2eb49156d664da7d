//! Temporal offsets: the paper's experiments (Figs. 18 to 22), and accuracy, calibration of error bars
//! and robustness beyond them.
//!
//! `cargo bench --bench offsets -- COMMAND`:
//!
//! | command | measurement |
//! |---|---|
//! | `fig18` | simulated tracks with outliers |
//! | `frames [CAPTURE ROTATING]` | Figs. 19 to 22, frame by frame |
//! | `all [CAPTURE…]` | errors and error bars of every capture in `.captures/films`, beside the targets |
//! | `captures CAPTURE…` | errors by method, against the ground truth |
//! | `pairs [FRAMES] CAPTURE…` | errors pair by pair, with the default method |
//! | `calibration CAPTURE…` | error bars over sub-sampled captures |
//! | `analytic [PART…]` | synthetic captures: accuracy, error bars, noise, jitter, exposure, bits, time |
//! | `worse CAPTURE…` | recorded frames with added noise, blur, jitter and quantization |
//! | `lost` | 60 synthetic captures with lost frames |
//! | `rolling [CAPTURE…]` | rolling shutters of 0 to 30 ms: offsets and views, with and without the readout |
//! | `together [CASE [SEEDS]]` | synthetic captures whose cameras lose frames at about the same time |
//!
//! Plots go to `.captures/bench-offsets/`.

#[path = "offsets/all_captures.rs"]
mod all_captures;
#[path = "offsets/analytic.rs"]
mod analytic;
#[path = "offsets/captures.rs"]
mod captures;
#[path = "offsets/degraded.rs"]
mod degraded;
#[path = "offsets/fig18.rs"]
mod fig18;
#[path = "offsets/frames.rs"]
mod frames;
#[path = "offsets/lost.rs"]
mod lost;
#[path = "offsets/noise.rs"]
mod noise;
#[path = "offsets/rolling.rs"]
mod rolling;
#[path = "offsets/scene.rs"]
mod scene;
#[path = "offsets/sweep.rs"]
mod sweep;
#[path = "offsets/together.rs"]
mod together;
#[path = "offsets/zhou_tao.rs"]
mod zhou_tao;

use std::path::Path;
use stlfr::chart::{Chart, svg};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let output = Path::new(env!("CARGO_MANIFEST_DIR")).join(".captures/bench-offsets");
    let (command, rest) = match arguments.split_first() {
        Some((command, rest)) => (command.as_str(), rest),
        None => ("fig18", &[][..]),
    };
    match command {
        "fig18" => fig18::run(&output),
        "frames" => frames::run(rest, &output),
        "all" => all_captures::run(rest),
        "captures" => captures::run(rest),
        "pairs" => captures::pairs(rest),
        "calibration" => captures::calibration(rest),
        "analytic" => analytic::run(rest, &output),
        "worse" => degraded::run(rest, &output),
        "lost" => lost::run(),
        "rolling" => rolling::run(rest, &output),
        "together" => together::run(rest),
        other => Err(format!("there is no command '{other}'").into()),
    }
}

/// The quantile at a fraction of 0 to 1; NaN without values.
fn percentile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((fraction * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
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
