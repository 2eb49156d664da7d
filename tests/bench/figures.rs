//! The paper's figures, from the project's own scenes: one PNG sheet each.
//!
//! `cargo bench --bench figures [-- FIGURE…] [--out DIR]`: figures by their number, all without one. Sheets
//! go to `.captures/figures`, unless DIR is given; what is written beneath their panels is printed too. Scenes lie in `.captures/views`; those that are missing
//! are filmed there.
//!
//! | figure | sheet |
//! |---|---|
//! | 1 | the array; traditional and space-time light field rendering; motion trails |
//! | 5 to 7 | gradients, real edges, flow before and after the epipolar test, the edge set |
//! | 9, 10 | interpolation without and with virtual edges; by four schemes |
//! | 14, 15, 24 | views by traditional and by space-time light field rendering |
//! | 16, 17 | a plane and the mesh |
//!
//! Clocks are the true ones, as in the paper, but for Fig. 24: its offsets are estimated.

#[path = "figures/array.rs"]
mod array;
#[path = "figures/draw.rs"]
mod draw;
#[path = "figures/interpolation.rs"]
mod interpolation;
#[path = "figures/page.rs"]
mod page;
#[path = "figures/proxies.rs"]
mod proxies;
#[path = "picture/rig.rs"]
#[allow(dead_code)]
mod rig;
#[path = "figures/scene.rs"]
mod scene;
#[path = "figures/synthesis.rs"]
mod synthesis;

use page::Page;
use std::path::PathBuf;
use stlfr::raster::{BitDepth, write_image};

type Error = Box<dyn std::error::Error>;

/// A figure's number, and what draws it.
type Figure = (u32, fn() -> Result<Page, Error>);

const FIGURES: [Figure; 11] = [
    (1, array::figure_1),
    (5, interpolation::figure_5),
    (6, interpolation::figure_6),
    (7, interpolation::figure_7),
    (9, interpolation::figure_9),
    (10, interpolation::figure_10),
    (14, synthesis::figure_14),
    (15, synthesis::figure_15),
    (16, proxies::figure_16),
    (17, proxies::figure_17),
    (24, synthesis::figure_24),
];

fn main() -> Result<(), Error> {
    let mut out = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(".captures/figures");
    let mut chosen = Vec::new();
    let mut args = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = args.next().ok_or("--out lacks a folder")?.into(),
            number => {
                let number = number.parse().map_err(|_| format!("'{number}' is no figure"))?;
                if FIGURES.iter().all(|(n, _)| *n != number) {
                    return Err(format!("figure {number} is not among those drawn here").into());
                }
                chosen.push(number);
            }
        }
    }
    std::fs::create_dir_all(&out)?;
    for (number, draw) in FIGURES.iter().filter(|(n, _)| chosen.is_empty() || chosen.contains(n)) {
        let path = out.join(format!("figure-{number:02}.png"));
        let page = draw()?;
        write_image(&path, &page.draw(), None, BitDepth::Eight)?;
        println!("{}", path.display());
        for panel in page.rows.iter().flatten().filter(|p| !p.note.is_empty()) {
            println!("  {}: {}", panel.title, panel.note);
        }
    }
    Ok(())
}
