//! Synchronized images by other programs: OpenCV's DIS flow and ffmpeg's minterpolate, by `picture_peer.py`.

use super::Error;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::Command;
use stlfr::capture::bracket;
use stlfr::interpolation::Synchronized;
use stlfr::light_field::LightField;
use stlfr::raster::{BitDepth, read_image, write_image};

/// Names of the peers, and the suffixes of their files.
pub const PEERS: [(&str, &str); 2] = [("DIS", "dis"), ("minterpolate", "minterpolate")];

/// Where the project's Python environment lies, if it is set up.
pub struct Python(PathBuf);

impl Python {
    /// The environment that `stlfr setup` makes, with what the peers import. Without it, a sentence says what
    /// is left out.
    pub fn find() -> Option<Self> {
        let python = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
        let imports = ["-I", "-c", "import cv2, imageio_ffmpeg"];
        let works = Command::new(&python).args(imports).status().is_ok_and(|s| s.success());
        if !works {
            println!("DIS and minterpolate are left out: `stlfr setup` has not been run.");
        }
        works.then_some(Self(python))
    }

    /// The images of all cameras at an instant, by each of [`PEERS`]; `None` of cameras that have none then.
    pub fn synchronized(
        &self,
        field: &LightField,
        time_s: f64,
    ) -> Result<[Vec<Option<Synchronized>>; 2], Error> {
        let scratch = tempfile::tempdir()?;
        let (mut jobs, mut prefixes) = (Vec::new(), Vec::new());
        for camera in 0..field.capture().cameras.len() {
            let job = job(field, camera, time_s, scratch.path())?;
            prefixes.push(job.is_some().then(|| prefix(scratch.path(), camera)));
            jobs.extend(job);
        }
        let request = scratch.path().join("request.json");
        std::fs::write(&request, serde_json::to_vec(&jobs)?)?;
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bench/picture_peer.py");
        let status = Command::new(&self.0).arg("-I").arg(script).arg(&request).status()?;
        if !status.success() {
            return Err(format!("picture_peer.py: {status}").into());
        }
        let read = |suffix: &str| -> Result<Vec<Option<Synchronized>>, Error> {
            let image = |prefix: &String| {
                let path = PathBuf::from(format!("{prefix}-{suffix}.png"));
                Ok(Synchronized::filmed(read_image(&path)?.0))
            };
            prefixes.iter().map(|p| p.as_ref().map(image).transpose()).collect()
        };
        Ok([read(PEERS[0].1)?, read(PEERS[1].1)?])
    }
}

fn prefix(scratch: &Path, camera: usize) -> String {
    scratch.join(format!("{camera}")).display().to_string()
}

/// What the script is asked for: the four frames around the instant, written to the scratch folder.
fn job(
    field: &LightField,
    camera: usize,
    time_s: f64,
    scratch: &Path,
) -> Result<Option<serde_json::Value>, Error> {
    let capture = field.capture();
    let Some(times_s) = field.offsets().common_times_s(capture).swap_remove(camera) else {
        return Ok(None);
    };
    let Some((k, later)) = bracket(&times_s, time_s) else { return Ok(None) };
    let span_s = times_s[later] - times_s[k];
    let fraction = if k == later { 0.0 } else { (time_s - times_s[k]) / span_s };
    let mut files = Vec::new();
    for frame in [k.saturating_sub(1), k, later, (later + 1).min(times_s.len() - 1)] {
        let file = scratch.join(format!("{camera}-frame-{frame}.png"));
        write_image(&file, &capture.read_frame(camera, frame)?, None, BitDepth::Sixteen)?;
        files.push(file);
    }
    let out = prefix(scratch, camera);
    Ok(Some(json!({"frames": files, "fraction": fraction, "out": out})))
}
