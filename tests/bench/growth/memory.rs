//! The peak memory of each command, over films of growing length.

use super::{Done, folder, root};
use crate::peak;
use crate::swing::{RATE_HZ, Swing};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use stlfr::chart::{Chart, Series};

/// Instants of a view for which all cameras are synchronized: four frames of each camera and instant
/// are more than the caches hold.
const INSTANTS: usize = 4;
/// Frames of the film for each instant at which one camera's image is made.
const FRAMES_AN_INSTANT: usize = 10;

/// The commands' peaks over these lengths: prints a table, and returns its plot.
pub fn grow(lengths: &[usize]) -> Done<Chart> {
    let commands = ["offsets", "render --like", "render --camera", "compare --video"];
    let mut series = commands.map(|label| Series {
        label: label.into(),
        line: true,
        dots: true,
        ..Series::default()
    });
    println!("640×480, 8 cameras: resident at most [MiB] (wall time [s])");
    println!("| frames | {} |", commands.join(" | "));
    println!("|---|{}", "---|".repeat(commands.len()));
    for &frames in lengths {
        let swing = Swing {
            width: 640,
            height: 480,
            channels: 3,
            cameras: 8,
            columns: 8,
            frames,
            print: 1.5,
            disparity_px: 12.0,
            ..Swing::default()
        };
        let capture = folder(&format!("memory-{frames}"))?;
        swing.film(&capture);
        truth(&swing, &capture, Prepared::Pairs.options())?;
        print!("| {frames} |");
        for (command, series) in commands.into_iter().zip(&mut series) {
            let run = peak::run(&mut of(command, &swing, &capture));
            if !run.status.success() {
                return Err(format!("stlfr {command} of {frames} frames: {}", run.status).into());
            }
            print!(" {:.0} ({:.0}) |", run.peak_mib, run.seconds);
            std::io::Write::flush(&mut std::io::stdout())?;
            series.points.push((frames as f64, run.peak_mib).into());
        }
        println!();
        std::fs::remove_dir_all(&capture)?;
    }
    Ok(Chart {
        title: "Memory: 640×480, 8 cameras".into(),
        x_label: "frames a camera".into(),
        y_label: "resident at most, MiB".into(),
        log_x: true,
        y_shows: Some((0.0, 700.0)),
        series: series.into(),
        rules: vec![(500.0, "target".into())],
        ..Chart::default()
    })
}

/// What is prepared of a film.
#[derive(Clone, Copy)]
pub enum Prepared {
    /// Registered pairs of frames, for the cheapest method that needs them.
    Pairs,
    /// The same, and maps of scene flow.
    Maps,
}

impl Prepared {
    fn options(self) -> &'static str {
        match self {
            // The cheapest method that registers frames: hundreds of images in minutes, from as many frames.
            Self::Pairs => r#"{"sync": "triangulation"}"#,
            Self::Maps => r#"{"proxy": {"method": "scene-flow"}}"#,
        }
    }

    fn swing(self, frames: usize) -> Swing {
        let [width, height] = match self {
            Self::Pairs => [320, 240],
            Self::Maps => [96, 72],
        };
        Swing { width, height, channels: 3, frames, print: 1.5, ..Swing::default() }
    }
}

/// The peaks of preparing a film, and of a view of the prepared one, over these lengths: prints a table.
pub fn of_prepared(what: Prepared, lengths: &[usize]) -> Done<()> {
    let Swing { width, height, .. } = what.swing(0);
    let options = what.options();
    println!("\n{options}, {width}×{height}, 3 cameras: resident at most [MiB] (wall time [s])");
    println!("| frames | prepare | bytes on disk [MiB] | render --camera, prepared |");
    println!("|---|---|---|---|");
    for &frames in lengths {
        let swing = what.swing(frames);
        let capture = folder(&format!("prepared-{frames}"))?;
        swing.film(&capture);
        truth(&swing, &capture, options)?;
        let peak = |command| -> Done<String> {
            let run = peak::run(&mut of(command, &swing, &capture));
            if !run.status.success() {
                return Err(format!("stlfr {command} of {frames} frames: {}", run.status).into());
            }
            Ok(format!("{:.0} ({:.0})", run.peak_mib, run.seconds))
        };
        let prepared = peak("prepare")?;
        let bytes = bytes_in(&capture.join(".stlfr"))?;
        let rendered = peak("render --camera")?;
        println!("| {frames} | {prepared} | {:.0} | {rendered} |", bytes as f64 / 1048576.0);
        std::fs::remove_dir_all(&capture)?;
    }
    Ok(())
}

/// The bytes of all files in a folder and those in it.
fn bytes_in(folder: &Path) -> Done<u64> {
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        bytes += if kind.is_dir() { bytes_in(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(bytes)
}

/// The program with the arguments of a command.
fn of(command: &str, swing: &Swing, capture: &Path) -> Command {
    let mut stlfr = Command::new(env!("CARGO_BIN_EXE_stlfr"));
    stlfr.current_dir(root()).arg("--quiet");
    // All cameras have images a frame after the start, and a frame before the end.
    let times = |n: usize| {
        let last = (swing.frames - 2) as f64 / RATE_HZ;
        format!("{}:{last}:{n}", 1.0 / RATE_HZ)
    };
    let like = format!("cam{}", swing.reference());
    match command {
        "offsets" | "prepare" => stlfr.arg(command).arg(capture),
        "render --like" => {
            let times = times(swing.frames / FRAMES_AN_INSTANT);
            let images = capture.join("out/%d.png");
            stlfr.arg("render").arg(capture).args(["--like", &like, "--times", &times, "-o"]);
            stlfr.arg(images)
        }
        "render --camera" => {
            stlfr.arg("render").arg(capture).arg("--camera").arg(capture.join("view.json"));
            stlfr.args(["--times", &times(INSTANTS), "-o"]).arg(capture.join("view/%d.png"))
        }
        _ => stlfr.args(["compare", "--video"]).arg(capture),
    };
    if command != "offsets" {
        stlfr.arg("--options").arg(capture.join("options.json"));
    }
    stlfr
}

/// A view, options, and what `compare` needs: the clocks' truth and a video's true images.
fn truth(swing: &Swing, capture: &Path, options: &str) -> Done<()> {
    std::fs::write(capture.join("options.json"), options)?;
    let place = [0.5, 0.0];
    let view = swing.view(place);
    std::fs::write(capture.join("view.json"), view.to_string())?;
    let offsets: Vec<_> = (0..swing.cameras)
        .map(|c| json!({"id": format!("cam{c}"), "offset_s": swing.delay_frames(c) / RATE_HZ}))
        .collect();
    // Times far apart, so that each asks for other frames.
    let step = ((swing.frames - 3) / INSTANTS).max(1);
    let frames: Vec<f64> = (0..INSTANTS).map(|k| (1 + k * step) as f64 + 0.4).collect();
    let times_s: Vec<f64> = frames.iter().map(|f| f / RATE_HZ).collect();
    for (k, frames) in frames.into_iter().enumerate() {
        let path = capture.join(format!("truth/video/{k}.png"));
        let depth = stlfr::raster::BitDepth::Eight;
        stlfr::raster::write_image(&path, &swing.image(place, frames), None, depth)?;
    }
    let truth = json!({"format": "stlfr-truth", "version": 1, "scene": "swing", "rig": "row",
        "offsets": offsets, "shutter": [], "views": [],
        "video": {"view": "new", "times_s": times_s, "camera": view, "images": "video/%d.png"}});
    Ok(std::fs::write(capture.join("truth/truth.json"), truth.to_string())?)
}
