//! Import of real recordings, and export of what other programs read.

#[path = "../common/mod.rs"]
mod common;

mod calibrations;
mod damage;
mod datasets;
mod films;

use common::{ffmpeg, read_json, run, text};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use stlfr::capture::{Capture, Opening};
use stlfr::progress::Reporter;
use tempfile::TempDir;

/// Encodes a video with ffmpeg's own arguments.
#[track_caller]
fn encode(arguments: &str, path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let status = Command::new(ffmpeg())
        .args(["-v", "error", "-y"])
        .args(arguments.split(' '))
        .arg(path)
        .status()
        .unwrap();
    assert!(status.success(), "{arguments}");
}

/// A table of Anipose's calibration: a camera of this size, `x_m` to the right.
fn camera_toml(name: &str, [width, height]: [usize; 2], x_m: f64) -> String {
    format!(
        "[{name}]\nname = \"{name}\"\nsize = [ {width}, {height}.0 ]\n\
         matrix = [[ 60, 0.0, 31.5 ], [ 0.0, 60.0, 23.5 ], [ 0.0, 0.0, 1.0 ]]\n\
         distortions = [ 0.0, 0.0, 0.0, 0.0, 0.0 ]\nrotation = [ 0.0, 0.0, 0.0 ]\n\
         translation = [ {}, 0.0, 0.0 ]\nfisheye = false\n\n",
        -x_m
    )
}

/// A folder with `Calib.toml` of cameras of 64×48 pixels, and an empty folder `film`.
fn array(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let tables = names.iter().enumerate();
    let toml: String = tables.map(|(k, name)| camera_toml(name, [64, 48], k as f64)).collect();
    let toml = format!("{toml}[metadata]\nadjusted = false\nerror = 0.0\n");
    std::fs::write(folder.path().join("Calib.toml"), toml).unwrap();
    std::fs::create_dir(folder.path().join("film")).unwrap();
    folder
}

/// `stlfr import` of such a folder.
fn import(folder: &Path, more: &[&str]) -> std::process::Output {
    let [toml, film, out] = ["Calib.toml", "film", "capture"].map(|name| folder.join(name));
    let arguments = ["import", text(&toml), "--images", text(&film), "-o", text(&out)];
    run(&[&arguments, more].concat())
}

fn open(folder: &Path) -> Capture {
    let reporter = &Reporter::silent();
    Capture::open_with(folder, &Opening { ffmpeg: Some(&ffmpeg()), reporter }).unwrap()
}

fn clocks(capture: &Path) -> Vec<Value> {
    let json = read_json(&capture.join("capture.json"));
    json["cameras"].as_array().unwrap().iter().map(|c| c["clock"].clone()).collect()
}

const TEST: &str = "-f lavfi -i testsrc2=size=64x48:rate=30:duration=1";
