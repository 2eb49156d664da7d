//! The largest of everything: 8192×4320 images, 256 cameras, 10,000 frames, 100,000 edges; the right
//! answer, in how much time and memory.

use super::{Done, folder, root};
use crate::peak;
use crate::swing::{RATE_HZ, Swing};
use nalgebra::{Point2, Vector2};
use std::process::Command;
use stlfr::host::process_cpu_s;
use stlfr::interpolation::{EdgeFeature, edge_set, morph_warp};
use stlfr::json;
use stlfr::offset::Offsets;
use stlfr::random::Random;
use stlfr::raster::Image;
use stlfr::raster::read_image;

pub fn run() -> Done<()> {
    println!("\n| the largest | wall [s] | resident at most [MiB] | off the truth |");
    println!("|---|---|---|---|");
    rendered(
        "256 cameras of 160×120, a synchronized image",
        Swing {
            width: 160,
            height: 120,
            cameras: 256,
            columns: 16,
            disparity_px: 2.0,
            frames: 6,
            ..Swing::default()
        },
        &["--like", "cam127"],
    )?;
    rendered(
        "10,000 frames of 160×120, 3 cameras, a synchronized image",
        Swing { width: 160, height: 120, frames: 10_000, ..Swing::default() },
        &["--like", "cam1"],
    )?;
    edges(100_000)?;
    rendered(
        "8192×4320, 2 cameras, a synchronized image",
        Swing {
            width: 8192,
            height: 4320,
            cameras: 2,
            columns: 2,
            frames: 4,
            print: 12.8,
            disparity_px: 50.0,
            synchronized: true,
            ..Swing::default()
        },
        &["--like", "cam0"],
    )
}

/// Offsets, if the clocks are unknown, and an image, by the program.
fn rendered(name: &str, swing: Swing, view: &[&str]) -> Done<()> {
    let film = folder("largest")?;
    swing.film(&film);
    let at = 0.5 * swing.frames as f64 - 0.6;
    let image = film.join("out.png");
    let mut stlfr = Command::new(env!("CARGO_BIN_EXE_stlfr"));
    stlfr.current_dir(root()).args(["--quiet", "render"]).arg(&film).args(view);
    stlfr.args(["--time", &(at / RATE_HZ).to_string(), "-o"]).arg(&image);
    let run = peak::run(&mut stlfr);
    if !run.status.success() {
        return Err(format!("{name}: {}", run.status).into());
    }
    let (rendered, _) = read_image(&image)?;
    let mut off = format!("{:.1} dB", psnr_db(&rendered, &swing.truth(swing.reference(), at)));
    if !swing.synchronized {
        let offsets: Offsets = json::read(&film.join("offsets.json"))?;
        let known: Vec<f64> = offsets
            .cameras
            .iter()
            .enumerate()
            .filter_map(|(c, o)| Some(o.offset_s? * RATE_HZ - swing.delay_frames(c)))
            .map(f64::abs)
            .collect();
        let worst = known.iter().fold(0.0, |a, b| f64::max(a, *b));
        off += &format!(", {} of {} offsets, worst {worst:.4} frame", known.len(), swing.cameras);
    }
    println!("| {name} | {:.1} | {:.0} | {off} |", run.seconds, run.peak_mib);
    Ok(std::fs::remove_dir_all(&film)?)
}

/// Over all but a border, which another frame may not show.
fn psnr_db(a: &Image, b: &Image) -> f64 {
    let margin = a.width().min(a.height()) / 12;
    let rows = margin..a.height() - margin;
    let squares = rows.flat_map(|y| {
        (margin..a.width() - margin)
            .map(move |x| f64::from(a.pixel(x, y)[0] - b.pixel(x, y)[0]).powi(2))
    });
    let (sum, n) = squares.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    -10.0 * (sum / n).log10()
}

/// The edge set of so many edges, and its morph of a small image, against the motion that all have.
fn edges(count: usize) -> Done<()> {
    let (w, h) = (4096, 2160);
    let mut random = Random::new(1);
    let moved = Vector2::new(3.0, -2.0);
    let features: Vec<EdgeFeature> = (0..count / 3)
        .map(|_| {
            let at = [random.in_range(1.0, w as f64 - 1.0), random.in_range(1.0, h as f64 - 1.0)];
            let target = Point2::from(at);
            EdgeFeature { source: target + moved, other: target - moved, target }
        })
        .collect();
    let start = process_cpu_s();
    // The image's corners move with all that is in it here.
    let edges: Vec<_> = edge_set(&features, &[], w, h)
        .into_iter()
        .filter(|e| e.ends.iter().all(|f| f.source != f.target))
        .collect();
    let built = process_cpu_s() - start;
    let start = process_cpu_s();
    let warp = morph_warp(&edges, [w, h], 4.0, 32);
    let warped = process_cpu_s() - start;
    let off = warp
        .source
        .iter()
        .enumerate()
        .map(|(k, s)| {
            let at = Point2::new((k % w) as f64 + 0.5, (k / w) as f64 + 0.5);
            (Point2::from(*s).cast::<f64>() - at - moved).norm()
        })
        .fold(0.0, f64::max);
    println!(
        "| {} edges on 4096×2160: built in {built:.1} s, morphed (every 32nd pixel) in {warped:.1} s | | | {off:.4} px |",
        edges.len()
    );
    Ok(())
}
