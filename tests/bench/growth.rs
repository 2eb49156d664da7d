//! The growth of time and memory with the capture: pixels, cameras, features and frames; and the
//! largest captures.
//!
//! `cargo bench --bench growth -- [pixels|area|cameras|features|frames|memory|prepared|maps|largest]`; all of them
//! without a word. Times are processor time, to which other processes add little; films are of
//! [`swing::Swing`]. Tables go to stdout, plots to `target/growth/growth.svg` and `memory.svg`.

#[path = "growth/fit.rs"]
mod fit;
#[path = "growth/largest.rs"]
mod largest;
#[path = "growth/memory.rs"]
mod memory;
#[path = "../common/peak.rs"]
mod peak;
#[path = "growth/stages.rs"]
mod stages;
#[path = "../common/swing.rs"]
#[allow(dead_code)]
mod swing;

use memory::Prepared;
use stages::Case;
use std::path::{Path, PathBuf};
use stlfr::chart::{Chart, svg};
use stlfr::options::RenderOptions;
use swing::Swing;

type Done<T> = Result<T, Box<dyn std::error::Error>>;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// An empty folder for a film, beside the other captures.
fn folder(name: &str) -> Done<PathBuf> {
    let folder = root().join(".captures/growth").join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder)?;
    }
    std::fs::create_dir_all(&folder)?;
    Ok(folder)
}

/// Writes charts as SVG and prints the file's path.
fn draw(name: &str, charts: &[Chart]) -> Done<()> {
    let folder = root().join("target/growth");
    std::fs::create_dir_all(&folder)?;
    let path = folder.join(name);
    std::fs::write(&path, svg(charts, 2))?;
    println!("{}", path.display());
    Ok(())
}

/// A film of two or three cameras in a few frames.
fn film(width: usize, height: usize, cameras: usize) -> Swing {
    Swing { width, height, cameras, columns: cameras, frames: 6, ..Swing::default() }
}

/// The same wall in finer and finer images: as many features, larger.
fn pixels() -> Done<Chart> {
    let cases: Vec<Case> = [1, 2, 4, 8]
        .map(|scale| {
            let print = scale as f64;
            let swing = film(160 * scale, 120 * scale, 3);
            let swing = Swing { print, disparity_px: 4.0 * print, ..swing };
            let mut options = RenderOptions::default();
            options.interpolation.max_edge_length_px *= print;
            Case { size: (swing.width * swing.height) as f64, swing, options }
        })
        .into();
    stages::series("pixels", "pixels", &cases)
}

/// More wall in larger images, by the defaults: features grow with the pixels, up to 4000.
fn area() -> Done<Chart> {
    let cases: Vec<Case> = [1, 2, 4, 8]
        .map(|scale| {
            let swing = film(160 * scale, 120 * scale, 3);
            let size = (swing.width * swing.height) as f64;
            Case { size, swing, options: RenderOptions::default() }
        })
        .into();
    stages::series("area", "pixels of an image with as much detail in each", &cases)
}

fn cameras() -> Done<Chart> {
    let cases: Vec<Case> = [4, 16, 64, 256]
        .map(|cameras| {
            let columns = (cameras as f64).sqrt() as usize;
            let swing = Swing { columns, disparity_px: 2.0, ..film(160, 120, cameras) };
            Case { size: cameras as f64, swing, options: RenderOptions::default() }
        })
        .into();
    stages::series("cameras", "cameras", &cases)
}

fn features() -> Done<Chart> {
    let cases: Vec<Case> = [500, 1000, 2000, 4000]
        .map(|count| {
            let mut options = RenderOptions::default();
            options.registration.max_corners = count;
            options.offset.max_features = count;
            Case { size: count as f64, swing: film(640, 480, 3), options }
        })
        .into();
    stages::series("features", "features", &cases)
}

fn frames() -> Done<Chart> {
    let cases: Vec<Case> = [30, 100, 300, 1000, 3000]
        .map(|frames| {
            let swing = Swing { frames, ..film(160, 120, 3) };
            Case { size: frames as f64, swing, options: RenderOptions::default() }
        })
        .into();
    stages::series("frames", "frames", &cases)
}

fn main() -> Done<()> {
    // As the program does.
    stlfr::host::reuse_freed_memory();
    let words: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    type Part = (&'static str, fn() -> Done<Chart>);
    let parts: [Part; 5] = [
        ("pixels", pixels),
        ("area", area),
        ("cameras", cameras),
        ("features", features),
        ("frames", frames),
    ];
    let names: Vec<&str> =
        parts.iter().map(|p| p.0).chain(["memory", "prepared", "maps", "largest"]).collect();
    if let Some(word) = words.iter().find(|w| !names.contains(&w.as_str())) {
        return Err(format!("{word}: is none of {names:?}").into());
    }
    let wanted = |name: &str| words.is_empty() || words.iter().any(|w| w == name);
    let mut charts = Vec::new();
    for (_, part) in parts.iter().filter(|p| wanted(p.0)) {
        charts.push(part()?);
    }
    if !charts.is_empty() {
        draw("growth.svg", &charts)?;
    }
    if wanted("memory") {
        draw("memory.svg", &[memory::grow(&[100, 300, 1000, 3000])?])?;
    }
    if wanted("prepared") {
        memory::of_prepared(Prepared::Pairs, &[100, 300, 1000, 3000])?;
    }
    if wanted("maps") {
        memory::of_prepared(Prepared::Maps, &[100, 300, 1000, 3000])?;
    }
    if wanted("largest") {
        largest::run()?;
    }
    Ok(())
}
